// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

namespace lot::refcount {
template <class P>
struct Ownership;
}

namespace lot::detail {

/// The fields of a hold word: what one process knows of its own holds on one block.
///
/// A hold word is private to a process; the shared fact "this process holds the block" is one
/// ownership bit, and flips only when the hold word goes from none to some or back. So a thread
/// that copies a pointer never touches a cache line that another process writes.
///
///     63           37 36        17 16     4  3      2    1    0
///    +---------------+------------+---------+------+----+----+----+
///    | pointers : 27 | rings : 20 | tag: 13 |unseen|home|held|busy|
///    +---------------+------------+---------+------+----+----+----+
///
///  - pointers: ShmSharedPtr, ShmUniquePtr (and the pool, for a block that is ready to be loaned)
///  - rings:    holds by rings and by messages that refer to this one
///  - tag:      low bits of the block's generation while this process is its home; makes a weak
///              lock's compare-and-swap fail on a block that has died meanwhile
///  - unseen:   only pointers of this process have, and had, the message: no ring, no other
///  message,
///              no weak pointer, no other process. So its last pointer ends it as a unique one does
///  - home:     this process owns the block's memory
///  - held:     our ownership bit stands in the shared word
///  - busy:     a thread is moving the ownership bit; the others wait for it
///
/// While a thread has the word busy, the word names that thread, so that a waiter can lend it its
/// priority:
///
///     63                        25 24     3    2    1    0
///    +----------------------------+--------+----+----+----+
///    |             0              | thread |home|held|  1 |
///    +----------------------------+--------+----+----+----+
///
/// A thread makes the word busy when this process has no holds on the block, or only the one ring's
/// hold that the thread itself gives up. A plain store ends that. So meanwhile no other thread may
/// add to the word or subtract from it blindly. Only a thread with a hold of its own does that, and
/// while it has that hold no thread can make the word busy. `home` and `held` stay readable at any
/// time, and pointers() is 0.
namespace hold {
inline constexpr std::uint64_t kBusy = 1;
inline constexpr std::uint64_t kHeld = 2;
inline constexpr std::uint64_t kHome = 4;
inline constexpr std::uint64_t kUnseen = 8;
inline constexpr unsigned kTagShift = 4;
inline constexpr std::uint64_t kTagMask = ((std::uint64_t{1} << 13) - 1) << kTagShift;
inline constexpr unsigned kThreadShift = 3;
inline constexpr std::uint64_t kThreadMask = ((std::uint64_t{1} << 22) - 1) << kThreadShift;
inline constexpr std::uint64_t kRing = std::uint64_t{1} << 17;
inline constexpr std::uint64_t kRingMask = ((std::uint64_t{1} << 20) - 1) << 17;
inline constexpr unsigned kPointerShift = 37;
inline constexpr std::uint64_t kPointer = std::uint64_t{1} << kPointerShift;
inline constexpr std::uint64_t kHolds = kRingMask | ~(kPointer - 1);

constexpr std::uint64_t pointers(std::uint64_t word) { return word >> kPointerShift; }
/// True when the one pointer to a message may end it as a unique pointer does. Never of a busy
/// word.
constexpr bool is_last_of_unseen(std::uint64_t word) {
  return (word & (kHolds | kUnseen)) == (kPointer | kUnseen);
}
/// The word while `thread` has it busy. The kernel's thread ids are below 2^22.
constexpr std::uint64_t busy_word(std::uint64_t word, std::uint32_t thread) {
  return (word & (kHome | kHeld)) | kBusy | ((std::uint64_t{thread} << kThreadShift) & kThreadMask);
}
/// The thread that has the word busy. REQUIRES: the word is busy.
constexpr std::uint32_t busy_thread(std::uint64_t word) {
  return static_cast<std::uint32_t>((word & kThreadMask) >> kThreadShift);
}
constexpr std::uint64_t tag_of(std::uint32_t generation) {
  return (std::uint64_t{generation} << kTagShift) & kTagMask;
}
}  // namespace hold

/// A hold word. Code outside this file and src/refcount/ownership.hpp can read it, and cannot
/// change it: the atomic is a private base. The two changes that a copied pointer makes stand here,
/// since the pointers are templates of their user's program.
///
/// Threads: all threads of the process may call all members at once.
/// Crash:   it is private to the process, and dies with it.
template <class Atomic>
class HoldWord : Atomic {
 public:
  using Atomic::load;

  /// Counts one more pointer of this process. REQUIRES: the caller has a pointer.
  /// Relaxed: the caller's pointer keeps the message, as in std::shared_ptr.
  void add_pointer() { this->fetch_add(hold::kPointer, std::memory_order_relaxed); }

  /// Counts one pointer less. False, and nothing has changed, when it may be the last one of this
  /// process: the caller then calls Ownership::release().
  bool drop_pointer_of_several() {
    std::uint64_t v = this->load(std::memory_order_relaxed);  // the compare-and-swap checks it
    while (hold::pointers(v) > 1) {
      // O4: this thread has read all that it wanted to. The thread that drops the last pointer
      // acquires. Relaxed on failure: the loop looks again.
      if (this->compare_exchange_weak(v, v - hold::kPointer, std::memory_order_release,
                                      std::memory_order_relaxed)) {
        return true;
      }
    }
    return false;
  }

 private:
  template <class P>
  friend struct refcount::Ownership;
};

}  // namespace lot::detail
