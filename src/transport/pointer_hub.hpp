// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "lot/detail/control.hpp"

#include "segment/segment.hpp"
#include "transport/lifetime.hpp"
#include "transport/membership.hpp"
#include "transport/pool.hpp"

namespace lot::transport {

/// What pointers to messages of a segment call: they come and go, and ask for counts.
///
/// Threads: all members may be called at once.
/// Crash:   a hold that is taken and not given back goes with the process's ownership bit.
class PointerHub : public detail::Hub {
 public:
  PointerHub(Membership& membership, Lifetime& lifetime, Holder& holder) noexcept;
  PointerHub(const PointerHub&) = delete;
  PointerHub& operator=(const PointerHub&) = delete;

  /// True when the pointer belongs to this segment, whichever copy of the library made it.
  bool same_segment(const detail::ControlBlock& control) const noexcept;

 private:
  static const PointerHub& of(const detail::ControlBlock* control) noexcept;
  void fill_pointers() noexcept;
  void fill_weak_pointers() noexcept;
  void fill_answers() noexcept;
  std::uint32_t index() const noexcept { return holder_.own.self; }
  /// True when the one pointer of this process is all that can see the message.
  bool is_alone(const detail::ControlBlock& control) const noexcept;
  void give_back(detail::ControlBlock& control) const noexcept;

  Membership& membership_;
  Lifetime& lifetime_;
  Holder& holder_;
  segment::Segment& segment_;
};

}  // namespace lot::transport
