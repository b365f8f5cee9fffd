// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <new>
#include <string>
#include <sys/mman.h>
#include <sys/types.h>
#include <utility>
#include <vector>

#include <benchmark/benchmark.h>

#include "lot/detail/atomics.hpp"
#include "lot/lot.hpp"

/// What the benchmarks share.
///
/// Every figure is a ratio to a floor that is measured in the same run: a round is one block of the
/// arm and one of the floor, in alternating order, and a benchmark is as many rounds as its time
/// allows. These machines have slow phases that triple everything; a ratio within one round does
/// not see them.
///
/// The second process is forked before any engine exists; then each side makes its own.
namespace bench {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

inline constexpr std::size_t kLine = 64;

/// Aborts with the name of what went wrong: a benchmark that reads rubbish has no figure.
void expect(bool good, const char* what);

/// Options of the run's own segment.
lot::EngineOptions segment();

/// How many cores this process may use, and how it is tied to one of them.
unsigned cores();
void pin(unsigned which);
void unpin();

inline void spin() noexcept { lot::detail::HardwareAtomics::pause(); }

/// Nanoseconds of one of `count` steps that `body` does at once.
template <class F>
double time_ns(std::uint64_t count, F&& body) {
  const auto start = Clock::now();
  body();
  return std::chrono::duration<double, std::nano>(Clock::now() - start).count() /
         static_cast<double>(count);
}

/// A T in memory that a forked child shares.
template <class T>
class Shared {
 public:
  Shared()
      : place_(
            mmap(nullptr, sizeof(T), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0)) {
    expect(place_ != MAP_FAILED, "mmap");
    new (place_) T();
  }
  ~Shared() { munmap(place_, sizeof(T)); }
  Shared(const Shared&) = delete;
  Shared& operator=(const Shared&) = delete;
  T& operator*() const noexcept { return *static_cast<T*>(place_); }
  T* operator->() const noexcept { return static_cast<T*>(place_); }

 private:
  void* place_;
};

/// A second process. It sleeps between orders.
///
///     Companion other([](Companion& here) {
///       lot::ShmEngine engine(segment());
///       while (here.hear() != Companion::kStop) { ...; here.meet(); }
///     });
///     other.tell(1);   // the child has heard it when this returns
///     other.meet();    // and has done it
///
/// Crash: the child dies with its parent; the parent notices at the next meet() that it has died.
class Companion {
 public:
  static constexpr std::uint64_t kStop = 0;

  explicit Companion(const std::function<void(Companion&)>& body);
  ~Companion();
  Companion(const Companion&) = delete;
  Companion& operator=(const Companion&) = delete;

  /// In the parent: the processor time that the child's threads have used.
  std::chrono::nanoseconds cpu_time() const;

  /// Returns when the other side has come here too.
  void meet();
  void tell(std::uint64_t order);
  std::uint64_t hear();

 private:
  struct Page {
    alignas(kLine) std::atomic<std::uint32_t> came[2] = {};
    std::uint64_t order = kStop;
  };
  Shared<Page> page_;
  pid_t child_ = 0;  ///< 0 in the child
  std::uint32_t meetings_ = 0;
};

/// The rounds of one benchmark. `arm` and `floor` each run a block and return nanoseconds a step.
class Rounds {
 public:
  template <class Arm, class Floor>
  void run(Arm&& arm, Floor&& floor) {
    const bool arm_first = arm_.size() % 2 == 1;
    const double first = arm_first ? arm() : floor();
    const double second = arm_first ? floor() : arm();
    arm_.push_back(arm_first ? first : second);
    floor_.push_back(arm_first ? second : first);
  }

  /// Counters: medians `arm_ns`, `floor_ns` and `ratio` = arm / floor of a round, with its 95 %
  /// interval `lo` .. `hi`.
  void report(benchmark::State& state) const;
  /// The same, and `faster` = floor / arm.
  void report_faster(benchmark::State& state) const;
  /// The same, and `more_us` = arm - floor of a round, whose interval `lo` .. `hi` is.
  void report_difference(benchmark::State& state) const;
  /// The same as report(), and `M/s`, whose interval `lo` .. `hi` is.
  void report_rate(benchmark::State& state) const;
  /// The same as report(), and `M/s`.
  void report_with_rate(benchmark::State& state) const;

 private:
  std::vector<double> arm_;
  std::vector<double> floor_;
};

/// Skips the benchmark where two processes cannot run at once. False: skipped.
bool needs_two_cores(benchmark::State& state);

/// So many words that say by themselves whether they are whole.
template <std::uint64_t kWords>
struct BallOf {
  std::uint64_t words[kWords];

  void fill(std::uint64_t n) noexcept {
    for (std::uint64_t i = 0; i < kWords; ++i) words[i] = n + i;
  }
  bool is(std::uint64_t n) const noexcept {
    std::uint64_t sum = 0;
    for (const std::uint64_t w : words) sum += w;
    return sum == kWords * n + kWords * (kWords - 1) / 2;
  }
};
using Ball = BallOf<8>;
static_assert(sizeof(Ball) == kLine);

struct Frame {
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  lot::ShmVector<std::uint8_t> data;
};

// ---- floors -------------------------------------------------------------------------------------

struct alignas(kLine) Line {
  std::atomic<std::uint64_t> value{0};
};

/// Pairs of lines: one is written here and spun on there, the other the other way round. A run uses
/// one pair, and the next run the next one: how long a line takes depends on where it lies.
struct Lines {
  struct alignas(4 * kLine) Pair {
    Line ping, pong;
  };
  static constexpr std::size_t kPairs = 32;

  Pair pairs[kPairs];
  std::uint64_t served = 0;   ///< runs, counted by the end that serves
  std::uint64_t crossed = 0;  ///< the same of the end that measures
};
void serve_lines(Lines& lines, std::uint64_t count);
/// Nanoseconds one way.
double cross_lines(Lines& lines, std::uint64_t count);

/// The same with both ends asleep, each sleep with a time limit.
struct Futexes {
  alignas(kLine) std::atomic<std::uint32_t> ping{0};
  alignas(kLine) std::atomic<std::uint32_t> pong{0};
};
void serve_futexes(Futexes& futexes, std::uint64_t count);
double cross_futexes(Futexes& futexes, std::uint64_t count);

/// A queue that protects nothing: payloads in the slots, one writer, one reader, who must live.
class BareQueue {
 public:
  void send(std::uint64_t from, std::uint64_t count);
  void receive(std::uint64_t from, std::uint64_t count);

 private:
  static constexpr std::uint64_t kDepth = 64;
  Line tail_, head_;
  Ball slots_[kDepth];
};

/// A ring of messages of 48 bytes that lie in one line each: what LOT's fast lane is at least. The
/// publisher writes the message, and exchanges the word before it. The reader copies, and looks at
/// the word again. One writer and one reader, both alive; nothing is kept, and no process
/// sleeps.
class OneLineRing {
 public:
  using Message = BallOf<6>;

  void send(std::uint64_t from, std::uint64_t count);
  void receive(std::uint64_t from, std::uint64_t count);

 private:
  static constexpr std::uint64_t kDepth = 64;
  struct alignas(kLine) Slot {
    std::atomic<std::uint64_t> word{0};     ///< the number of its message, and one more
    std::atomic<std::uint64_t> sleeper{0};  ///< as in a ring with sleepers
    std::atomic<std::uint64_t> words[6] = {};
  };
  Line head_;
  alignas(kLine) std::uint64_t seen_head_ = 0;  ///< the publisher's own
  Slot slots_[kDepth];
};
/// A game of ping-pong over two of them.
struct OneLineTable {
  OneLineRing ping, pong;
  std::uint64_t served = 0;   ///< messages, counted by the end that serves
  std::uint64_t crossed = 0;  ///< the same of the end that measures
};
void serve_one_lines(OneLineTable& table, std::uint64_t count);
/// Nanoseconds one way.
double cross_one_lines(OneLineTable& table, std::uint64_t count);

/// One locked exchange on a line that nobody else has.
double exchange(std::uint64_t count);
/// std::make_shared of 128 bytes, and reset.
double make_shared(std::uint64_t count);

}  // namespace bench
