// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <bit>
#include <cstdint>

#include "lot/detail/changed_by.hpp"

#include "lockfree_ring/words.hpp"

/// How one sleeper listens to many rings (docs/ear.md): a pure algorithm over memory that it is
/// given. It makes no system call. The caller makes those that the return values ask for.
///
/// No bit is evidence: one too many costs a wake-up for nothing. An ear without an owner may be
/// rung.
///
/// Edges
///   H1  the ear's bit in `listeners`, then the slot load in mark_sleeping() (both
///       seq_cst) <-> the slot exchange or clear_sleeper(), then the `listeners` load (all seq_cst)
///       either the sleeper sees that the slot has changed, or the waker sees the ear. The mutex
///       engine has the condition in place of the slot.
///   H2  bit in `news` (release) -> the exchange that takes it (acquire)
///       carries: what the waker has stored in the ring.
///   H3  count of `bell` (release) -> load of `bell` (acquire)
///       carries: the bit in `news`.
///   H4  `owner` = 0 (release) -> claim of `owner` (acquire)
///       carries: the former owner's bits have gone.
namespace lot::ring {

inline constexpr std::uint32_t kEars = 512;
/// Words that have a bit for each ear. The model has less.
template <class P>
inline constexpr std::uint32_t kEarWords = kEars / 64;

/// Which ears listen to a ring: a bit for each. It lies beside the ring's channel and not in the
/// ring, so that an ear may take its bit away when the ring has gone.
///
/// Threads: all members may be called at once. Only the ear's process changes the ear's bit, or the
/// reaper of that process.
/// Crash:   a bit that is left is taken away by the reaper, or by the ear's next owner.
template <class P>
class alignas(P::kLine) Listeners {
 public:
  static constexpr std::uint32_t kWords = kEarWords<P>;

  /// REQUIRES, as all of it: ear < kEars.
  void add(std::uint32_t ear) {
    auto& word = words_[ear / 64];
    // Relaxed: the bit is this process's own, which has set it by H1.
    if ((word.load(std::memory_order_relaxed) & bit(ear)) != 0) return;
    word.fetch_or(bit(ear), std::memory_order_seq_cst);  // H1
  }
  void remove(std::uint32_t ear) {
    auto& word = words_[ear / 64];
    // Relaxed, both: the bit is this process's own. Where the ear gets another owner, H4 carries
    // it.
    if ((word.load(std::memory_order_relaxed) & bit(ear)) == 0) return;
    word.fetch_and(~bit(ear), std::memory_order_relaxed);  // as above
  }
  /// Calls f(ear) for each ear that listens. The caller has changed the ring's word before.
  template <class F>
  void each(F&& f) const {
    for (std::uint32_t w = 0; w < kWords; ++w) {
      Word left = words_[w].load(std::memory_order_seq_cst);  // H1
      for (; left != 0; left &= left - 1) {
        f(w * 64 + static_cast<std::uint32_t>(std::countr_zero(left)));
      }
    }
  }

 private:
  static constexpr Word bit(std::uint32_t ear) { return Word{1} << ear % 64; }

  typename P::template Atomic<Word> words_[kWords];
};

/// Which participant has claimed the ear: 0, or participant + 1.
///
/// Threads: all members may be called at once.
/// Crash:   the reaper sets free what the dead one has.
template <class P>
class EarOwnerWord
    : public detail::ChangedBy<typename P::template Atomic<std::uint32_t>, EarOwnerWord<P>> {
 public:
  /// False: another participant has it.
  bool claim(std::uint32_t participant) {
    std::uint32_t none = 0;
    return this->compare_exchange_strong(none, participant + 1, std::memory_order_acquire,
                                         std::memory_order_relaxed);  // H4
  }
  /// REQUIRES: no channel has the ear's bit any more.
  void free() { this->store(0, std::memory_order_release); }  // H4
  /// Relaxed: a process, and its reaper, know what it has.
  bool is(std::uint32_t participant) const {
    return this->load(std::memory_order_relaxed) == participant + 1;
  }
};

/// The futex of an ear: {count : 31 | asleep : 1}. The count only differs: no process depends on
/// what it is.
///
/// Threads: ring() at once. All else by the ear's process.
/// Crash:   the bit that is left costs others a wake for nothing.
template <class P>
class Bell : public detail::ChangedBy<typename P::template Atomic<std::uint32_t>, Bell<P>> {
 public:
  /// True: the sleeper may be asleep, and the caller wakes word(). REQUIRES: the news stand.
  bool ring() { return (this->fetch_add(kOne, std::memory_order_release) & kAsleep) != 0; }  // H3

  /// How often it was rung before the news that the caller takes now, for sleep().
  std::uint32_t rung() const { return this->load(std::memory_order_acquire) & ~kAsleep; }  // H3
  /// Says that the caller is about to sleep. Returns the value to sleep on: another one than the
  /// word has, if it was rung since rung(). Relaxed: one word has both, and the kernel looks.
  std::uint32_t sleep(std::uint32_t rung) {
    this->fetch_or(kAsleep, std::memory_order_relaxed);
    return rung | kAsleep;
  }
  /// The sleep has ended. Relaxed: until then others make a call for nothing, at most.
  void wake_up() { this->fetch_and(~kAsleep, std::memory_order_relaxed); }

 private:
  static constexpr std::uint32_t kAsleep = 1;
  static constexpr std::uint32_t kOne = 2;
};

/// The words of one ear, without its news.
template <class P>
struct alignas(P::kLine) EarWords {
  EarOwnerWord<P> owner;
  Bell<P> bell;
};

/// A view of one ear in shared memory. Copyable; owns nothing.
template <class P>
struct Ear {
  EarWords<P>* words = nullptr;
  /// [news_words(channels)] a bit for each channel
  typename P::template Atomic<Word>* news = nullptr;

  static constexpr std::uint32_t news_words(std::uint32_t channels) { return (channels + 63) / 64; }

  /// Tells the ear of a ring. True: the caller wakes its bell.
  ///
  /// Crash: killed in between, it is told again by the reaper of the caller.
  bool tell(std::uint32_t channel) {
    news[channel / 64].fetch_or(Word{1} << channel % 64, std::memory_order_release);  // H2
    return words->bell.ring();
  }
  /// Calls f(channel) for all news, which are taken by that.
  template <class F>
  void take(std::uint32_t channels, F&& f) {
    for (std::uint32_t w = 0; w < news_words(channels); ++w) {
      if (news[w].load(std::memory_order_relaxed) == 0) continue;  // the exchange acquires
      Word left = news[w].exchange(0, std::memory_order_acquire);  // H2
      for (; left != 0; left &= left - 1) {
        const std::uint32_t channel = w * 64 + static_cast<std::uint32_t>(std::countr_zero(left));
        if (channel < channels) f(channel);  // else another process has damaged the word
      }
    }
  }
};

}  // namespace lot::ring
