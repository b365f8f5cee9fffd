// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "segment/granules.hpp"

/// Runs of granules change hands, among the living and from the dead.
namespace lot::model {
namespace {

/// Five granules. What is written into one is a race with every other owner that is not ordered.
struct Memory {
  static constexpr std::uint32_t kGranules = 5;
  using Granules = segment::Granules<Policy>;

  Memory() : tags(kGranules), bytes(kGranules) {
    for (auto& byte : bytes) byte.write(0);
  }
  void write(std::uint32_t first, std::uint32_t run, int value) {
    for (std::uint32_t i = first; i < first + run; ++i) bytes[i].write(value);
  }
  void check(std::uint32_t first, std::uint32_t run, int value) {
    for (std::uint32_t i = first; i < first + run; ++i) RL_ASSERT(bytes[i].read() == value);
  }
  /// Claims, writes, reads; true if there was a run.
  bool use(Granules& granules, std::uint32_t run, std::uint32_t tag, std::uint32_t& first) {
    first = granules.claim(run, tag);
    if (first == Granules::kNone) return false;
    write(first, run, static_cast<int>(tag));
    check(first, run, static_cast<int>(tag));
    return true;
  }

  std::vector<CheckedAtomic<std::uint32_t>> tags;
  std::vector<Plain<int>> bytes;
};

/// Three processes claim runs of different sizes, use them, and give them back.
struct RunsChangeHands : SceneBegins, rl::test_suite<RunsChangeHands, 3> {
  void thread(unsigned t) {
    Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    for (const std::uint32_t run : {t + 1, 1U}) {
      std::uint32_t first = 0;
      if (memory.use(granules, run, t + 1, first)) granules.release(first, run);
    }
  }
  void after() {
    const Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    RL_ASSERT(granules.used() == 0);
  }
  Memory memory;
};

/// A run becomes longer where another process claims, and gives its end back to a third one.
struct RunsAreResized : SceneBegins, rl::test_suite<RunsAreResized, 3> {
  void before() {
    Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    RL_ASSERT(granules.claim(1, 1) == 0);
  }
  void thread(unsigned t) {
    Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    const std::uint32_t tag = t + 1;
    std::uint32_t first = 0;
    if (t != 0) {
      if (memory.use(granules, t, tag, first)) granules.release(first, t);
      return;
    }
    if (!granules.extend(1, 2, tag)) return;
    memory.write(0, 3, static_cast<int>(tag));
    memory.check(0, 3, static_cast<int>(tag));
    granules.release(1, 2);
    memory.check(0, 1, static_cast<int>(tag));
  }
  void after() {
    const Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    RL_ASSERT(granules.used() == 1 && granules.tag(0) == 1);
  }
  Memory memory;
};

/// One process gives a granule back, another one claims a run that it cannot have all of, and a
/// third one gets the granule.
struct RunIsUndone : SceneBegins, rl::test_suite<RunIsUndone, 3> {
  void before() {
    Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    for (std::uint32_t i = 0; i < Memory::kGranules; ++i) RL_ASSERT(granules.claim(1, 9) == i);
    memory.write(0, 1, 9);
  }
  void thread(unsigned t) {
    Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    std::uint32_t first = 0;
    if (t == 0) {
      memory.check(0, 1, 9);
      granules.release(0, 1);
    } else if (t == 1) {
      RL_ASSERT(granules.claim(2, 2) == Memory::Granules::kNone);
    } else {
      memory.use(granules, 1, 3, first);
    }
  }
  Memory memory;
};

/// Who claims is killed anywhere: its reaper frees what carries its name, and nothing else.
struct ClaimerKilled : Scene<ClaimerKilled, 2> {
  void prepare() { start(2); }
  void thread(unsigned t) {
    Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    std::uint32_t first = 0;
    if (t == 1) {
      while (!memory.use(granules, 2, 3, first)) Policy::pause();
      others = first;
      return;
    }
    die_within(2, 12, [&] {
      if (memory.use(granules, 2, 2, first)) granules.release(first, 2);
      if (memory.use(granules, 1, 2, first)) granules.extend(first + 1, 1, 2);
    });
    RL_ASSERT(segment.try_lock(2, 4));
    granules.release_if([](std::uint32_t tag) { return tag == 2; });
  }
  void check() {
    const Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    RL_ASSERT(others && granules.used() == 2);
    memory.check(*others, 2, 3);
  }
  Memory memory;
  std::optional<std::uint32_t> others;
};

const Entered entered{
    {"runs_change_hands", "a granule has one owner after the other", rl::simulate<RunsChangeHands>,
     1},
    {"runs_are_resized", "a run is made longer and shorter beside claims",
     rl::simulate<RunsAreResized>, 1},
    {"run_is_undone", "a run that was not complete is handed on", rl::simulate<RunIsUndone>, 2},
    {"claimer_killed", "what a dead claimer has got is found by name", rl::simulate<ClaimerKilled>,
     1},
};

}  // namespace
}  // namespace lot::model
