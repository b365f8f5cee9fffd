// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

namespace lot::segment {

/// What a warden is asked for: kOwn by its own process, the others by any participant.
namespace errand {
/// A message that the home waits for may be free. Only a hint: the warden looks once a second.
inline constexpr std::uint32_t kLook = 1;
/// Give idle memory back. Only a hint: memory that stays idle goes by itself.
inline constexpr std::uint32_t kTrim = 2;
/// The warden's own process has something for it to do.
inline constexpr std::uint32_t kOwn = 4;
/// Give messages up: request() says how much. A participant that is killed before it brings this
/// errand needs nothing more.
inline constexpr std::uint32_t kGive = 8;
/// A mark beside the errands, and none itself. The participant itself says that a signal ends it.
/// Then the last process, which removes the files, does not count it any more. Written and read in
/// the gate. Stays until the next participant gets this index.
inline constexpr std::uint32_t kEnding = 16;
}  // namespace errand

/// The errands of one participant, in shared memory. All changes of these words are here.
///
/// Edges
///   E1  bring() (release) -> take() (acquire)
///       carries: the ownership bit that was cleared before, and request().
///   E2  answer() (release) -> answers_acquired() (acquire)
///       carries nothing: G1 carries the memory that was given.
///
/// Threads: all participants may call bring() and ask(); the warden calls take() and answer(), its
///          process the rest.
/// Crash:   killed between bring() and the wake, the warden finds the errand at its next look,
/// within
///          a second.
class Errands {
 public:
  /// The futex that the warden sleeps on.
  const void* word() const noexcept { return &errands_; }

  /// Brings an errand. False: the warden had it already.
  bool bring(std::uint32_t errand) noexcept {
    return (errands_.fetch_or(errand, std::memory_order_release) & errand) != errand;  // E1
  }
  /// Takes the errands in `mine` away. Returns all that there were.
  std::uint32_t take(std::uint32_t mine) noexcept {
    return errands_.fetch_and(~mine, std::memory_order_acquire);  // E1
  }
  /// The errands that wait. Relaxed: a hint; take() acquires them.
  std::uint32_t waiting() const noexcept { return errands_.load(std::memory_order_relaxed); }
  /// The errands were meant for the former owner of the index. Relaxed: a participant that asks
  /// this one has seen its new state, or its name in a home word. Both come later.
  void forget() noexcept { errands_.store(0, std::memory_order_relaxed); }

  /// A signal ends this process. REQUIRES: the gate. Relaxed: the gate carries it.
  void note_ending() noexcept { errands_.fetch_or(errand::kEnding, std::memory_order_relaxed); }
  bool is_ending() const noexcept {
    // Relaxed: the gate carries it.
    return (errands_.load(std::memory_order_relaxed) & errand::kEnding) != 0;
  }

  /// What kGive asks for, and then the answer (transport/survey.hpp).
  std::uint64_t request() const noexcept {
    // Relaxed: E1 carries the question, and G1 the memory that was given.
    return request_.load(std::memory_order_relaxed);
  }
  /// Stores what the next kGive asks for. If several participants ask, the last one counts.
  void ask(std::uint64_t request) noexcept {
    // Relaxed: E1 carries it.
    request_.store(request, std::memory_order_relaxed);
  }
  /// Answers `request`, unless a newer one has come just now, which gets an answer of its own.
  void reply(std::uint64_t request, std::uint64_t answer) noexcept {
    // Relaxed: G1 carries the memory.
    request_.compare_exchange_strong(request, answer, std::memory_order_relaxed);
  }

  /// The warden has done kTrim or kGive.
  void answer() noexcept { answers_.fetch_add(1, std::memory_order_release); }  // E2
  /// How many answers there were. Relaxed: a number to compare with.
  std::uint32_t answers() const noexcept { return answers_.load(std::memory_order_relaxed); }
  std::uint32_t answers_acquired() const noexcept {
    return answers_.load(std::memory_order_acquire);  // E2
  }

 private:
  std::atomic<std::uint32_t> errands_;  ///< futex; bits of errand::
  std::atomic<std::uint32_t> answers_;
  std::atomic<std::uint64_t> request_;
};
static_assert(sizeof(Errands) == 16);

}  // namespace lot::segment
