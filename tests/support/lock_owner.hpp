// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <unistd.h>
#include <utility>

#include "liveness/death_notice.hpp"
#include "robust_mutex/robust_mutex.hpp"
#include "segment/segment.hpp"

namespace lot::testing {

/// Takes a segment's locks in the name of this process, which is a participant, as another thread
/// of the library would; and takes over none.
class InOurName final : public LockOwner {
 public:
  explicit InOurName(const segment::Segment& segment) {
    for (std::uint32_t k = 1; k < segment.capacity().participants && name_ == 0; ++k) {
      const auto& entry = segment.participants()[k];
      if (entry.state.load() == 0 || entry.pid != getpid()) continue;
      name_ = lock::make_name(k, liveness::seat::incarnation(segment.witnesses()[k].seat.load()));
    }
  }

  std::uint32_t name() const noexcept override { return name_; }
  bool is_gone(std::uint32_t) noexcept override { return false; }

 private:
  std::uint32_t name_ = 0;
};

/// Takes locks in the orphanage's name, and takes over those of whom the function says that they
/// are gone: for one who has a segment to himself, or knows who lives.
class Outsider final : public LockOwner {
 public:
  using IsGone = std::function<bool(std::uint32_t participant)>;

  explicit Outsider(IsGone is_gone = [](std::uint32_t) { return false; })
      : is_gone_(std::move(is_gone)) {}

  std::uint32_t name() const noexcept override { return lock::make_name(0, 1); }
  bool is_gone(std::uint32_t name) noexcept override { return is_gone_(lock::participant(name)); }

 private:
  IsGone is_gone_;
};

/// The registry's lock, in our name.
class RegistryLock {
 public:
  explicit RegistryLock(const segment::Segment& segment)
      : owner_(segment), mutex_(segment.directory().lock.word, owner_) {}
  RegistryLock(const RegistryLock&) = delete;
  RegistryLock& operator=(const RegistryLock&) = delete;

  bool lock() {
    return owner_.name() != 0 &&
           mutex_.lock_for(std::chrono::seconds(30)) == RobustMutex::Outcome::Locked;
  }
  void unlock() { mutex_.unlock(); }

 private:
  InOurName owner_;
  RobustMutex mutex_;
};

}  // namespace lot::testing
