// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "transport/pool.hpp"

namespace lot::transport {

/// What one subscription holds, and how much it may hold (PullerOptions::max_held_bytes,
/// docs/memory.md).
///
/// What is kept is noted. What was let go is not. Instead the notes are looked through when there
/// are twice as many as after the last look, or when their sum reaches the limit. So a pointer that
/// goes costs nothing more, and one that comes costs a note.
///
/// A note counts while this process holds the message, for whatever part of it.
///
/// Threads: one at a time, that of the puller.
/// Crash:   nothing of it is shared.
class Quota {
 public:
  /// `limit` in bytes; 0: a quarter of the segment; kNone: all of it.
  static constexpr std::uint64_t kNone = ~std::uint64_t{0};
  Quota(segment::Segment& segment, const Holder& holder, std::uint64_t limit);

  /// True if one more message may be kept; it makes room for its note. Throws std::bad_alloc.
  bool allows_one_more() {
    if (notes_.size() < look_at_notes_ && granules_ < look_at_granules_) [[likely]]
      return true;
    return look();
  }
  /// Notes a message that this process has a pointer hold on. `granules`: its memory besides its
  /// block. Returns the generation of the block. REQUIRES: counts(), and allows_one_more() was true
  /// since the last note.
  std::uint32_t note(std::uint32_t block, std::uint64_t granules) noexcept;

  /// False: there is no limit, and no need for notes.
  bool counts() const noexcept { return limit_ != kNone; }
  bool is_full() const noexcept { return is_full_; }
  /// "holds 256 MiB in 16 messages, ..."
  std::string describe() const;

 private:
  struct Note {
    std::uint32_t block;
    std::uint32_t generation;
    std::uint64_t granules;
  };

  bool look();
  void forget_what_went() noexcept;
  bool is_held(const Note& note) const noexcept;
  bool has_pointers(std::uint32_t block) const noexcept;
  bool leaves_enough();
  void plan_next_look();

  segment::Segment& segment_;
  const Holder& holder_;
  std::vector<Note> notes_;
  std::uint64_t granules_ = 0;  ///< the sum of all notes
  std::size_t look_at_notes_ = 0;
  std::uint64_t look_at_granules_ = 0;
  bool is_full_ = false;
  bool is_shared_out_ = false;  ///< full because all subscriptions together hold too much

  const std::uint64_t limit_;      ///< in granules
  const std::size_t limit_notes_;  ///< a quarter of the blocks
  /// What was kept in the whole segment when it was last weighed, and what was held here then.
  struct Weighed {
    std::uint64_t granules = 0;
    std::uint64_t blocks = 0;
    std::uint64_t own_granules = 0;
    std::uint64_t own_notes = 0;
    futex::Clock::time_point at{};
  } weighed_;
};

}  // namespace lot::transport
