// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <thread>

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "transport/pool.hpp"
#include "transport/survey.hpp"
#include "transport/world.hpp"

namespace lot::transport {

/// What this process asks of the others: memory. Their wardens answer.
///
/// Threads: all members may be called at once. The warden must not call those that wait.
/// Crash:   killed after a question, the other process gives something up and no process uses it at
///          once.
class Neighbours {
 public:
  /// How long to wait for one giver of a message. A busy machine runs its warden late.
  static constexpr std::chrono::milliseconds kGiverPatience{200};
  /// How long to wait for answers of all others at once.
  static constexpr std::chrono::milliseconds kAnswerPatience{10};

  Neighbours(segment::Segment& segment, World& world, const Holder& holder) noexcept
      : segment_(segment), world_(world), holder_(holder) {}

  enum class Gathered : std::uint8_t {
    Enough,  ///< enough() was true
    All,     ///< all have answered but the silent ones, and it was not
    Some     ///< the patience has ended before
  };
  /// Asks all other processes to give back the idle memory of their pools. Returns when enough() is
  /// true (it is asked now and then), when all have answered but the silent ones, or when the
  /// patience has ended. The giver's patience is the longest one: a process that has not answered
  /// in it is silent from then on, so that a stopped process delays the caller once.
  template <class Enough>
  Gathered gather(Enough&& enough, std::chrono::milliseconds patience = kAnswerPatience) noexcept {
    Questions questions;
    ask_others(questions);
    const auto until = futex::Clock::now() + patience;
    for (;;) {
      // Asked before enough(), so that the last answers count.
      const bool all = all_have_answered(questions);
      const bool is_late = futex::Clock::now() >= until;
      if (enough()) return Gathered::Enough;
      if (all) return Gathered::All;
      if (is_late) break;
      std::this_thread::sleep_for(kAnswerLook);
    }
    if (patience >= kGiverPatience) note_silent(questions);
    return Gathered::Some;
  }
  /// True when the other processes were not asked within the last 100 ms. While messages of this
  /// process can make room, the others are asked no more often.
  bool may_gather() noexcept;

  /// Asks participant k for messages. False: it has given nothing, or has not answered.
  bool ask_to_give(std::uint32_t k, const Request& request) noexcept;
  /// Brings participant k's warden an errand and waits until done() is true. False: k has not
  /// answered in time. It is then not asked again until it has answered something.
  template <class Done>
  bool ask_and_wait(std::uint32_t k, std::uint32_t errand, Done&& done) noexcept {
    const std::uint32_t before = segment_.witnesses()[k].errands.answers();
    holder_.ask(k, errand);
    const auto until = futex::Clock::now() + kGiverPatience;
    while (!done()) {
      if (futex::Clock::now() >= until) {
        note_silent(k, before);
        return false;
      }
      std::this_thread::sleep_for(kAnswerLook);
    }
    return true;
  }
  /// True when a wait for participant k has ended without an answer, and k has not answered since.
  bool is_silent(std::uint32_t k) const noexcept;

 private:
  static constexpr std::chrono::microseconds kAnswerLook{100};
  /// Whose answers are waited for, and how often these participants had answered before.
  struct Questions {
    std::array<bool, segment::kMaxParticipants> awaited{};
    std::array<std::uint32_t, segment::kMaxParticipants> answers;
  };

  void ask_others(Questions& questions) noexcept;
  bool has_answered(const Questions& questions, std::uint32_t k) const noexcept;
  bool all_have_answered(const Questions& questions) const noexcept;
  void note_silent(const Questions& questions) noexcept;
  void note_silent(std::uint32_t k, std::uint32_t answers) noexcept {
    // Relaxed: it only says how long to wait.
    silent_[k].store(std::uint64_t{answers} + 1, std::memory_order_relaxed);
  }

  segment::Segment& segment_;
  World& world_;
  const Holder& holder_;
  std::atomic<futex::Clock::rep> gathered_{0};  ///< when the other processes were asked last
  /// By participant: its count of answers plus 1 when a wait for it last ended without an answer;
  /// 0: that never happened. Private to the process.
  std::array<std::atomic<std::uint64_t>, segment::kMaxParticipants> silent_{};
};

}  // namespace lot::transport
