// SPDX-License-Identifier: Apache-2.0
#include "scenario.hpp"
#include "segment/units.hpp"
#include "world.hpp"

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

/// Four granules in two units, and what the file system has of them.
struct Backed : Memory {
  static constexpr std::uint32_t kInUnit = 2;
  static constexpr std::uint32_t kUnits = 2;
  using Units = segment::Units<Policy>;

  Backed() : words(kUnits), given(kUnits) {
    for (auto& unit : given) unit.write(0);
  }
  /// Claims a granule and gets its unit's memory, writes, reads, and gives the granule back. What
  /// the file system has not given is a race or an error.
  bool use_one(std::uint32_t tag, bool asks, bool keeps = false) {
    Granules granules(tags.data(), kInUnit * kUnits);
    Units units(words.data(), kUnits);
    const std::uint32_t first = granules.claim(1, tag);
    if (first == Granules::kNone) return false;
    const std::uint32_t unit = first / kInUnit;
    const bool got = units.get(unit, unit, [&](std::uint32_t u) {
      if (asks) given[u].write(1);
      return asks;
    });
    if (got) {
      if (keeps) units.keep(unit, unit);
      RL_ASSERT(given[unit].read() == 1);
      write(first, 1, static_cast<int>(tag));
      check(first, 1, static_cast<int>(tag));
    }
    granules.release(first, 1);
    return got;
  }
  bool give_back(std::uint32_t unit, std::uint32_t looks, std::uint32_t tag, bool refuses = false) {
    Granules granules(tags.data(), kInUnit * kUnits);
    Units units(words.data(), kUnits);
    return units.give_back(
        unit, looks, granules, kInUnit * unit, kInUnit, tag,
        [&] {
          if (refuses) return false;
          given[unit].write(0);
          write(kInUnit * unit, kInUnit, 0);
          return true;
        },
        [&](std::uint32_t u) {
          given[u].write(1);
          return true;
        });
  }

  std::vector<CheckedAtomic<std::uint32_t>> words;
  std::vector<Plain<int>> given;
};

/// A process gets a unit's memory, another one uses what it has got, a third one gives it back.
struct UnitsGoBack : SceneBegins, rl::test_suite<UnitsGoBack, 3> {
  void thread(unsigned t) {
    if (t == 2) {
      memory.give_back(0, 0, 9);
      return;
    }
    for (int n = 0; n < 2; ++n) memory.use_one(t + 1, t == 0, t == 0 && n == 1);
  }
  void after() {
    const Memory::Granules granules(memory.tags.data(), Memory::kGranules);
    RL_ASSERT(granules.used() == 0);
  }
  Backed memory;
};

/// A look and a claim at once: what was claimed since the looks does not go back.
struct UnitsAreLookedAt : SceneBegins, rl::test_suite<UnitsAreLookedAt, 3> {
  void before() { RL_ASSERT(memory.use_one(1, true)); }
  void thread(unsigned t) {
    if (t == 0) {
      memory.use_one(1, true);
      return;
    }
    Memory::Granules granules(memory.tags.data(), Backed::kInUnit * Backed::kUnits);
    Backed::Units units(memory.words.data(), Backed::kUnits);
    if (t == 1) {
      units.look(0, [&](std::uint32_t) { return !granules.is_free(0, Backed::kInUnit); });
      units.try_get(0, 1, [](std::uint32_t) { return true; });
    } else {
      memory.give_back(0, 0, 9, true);
      if (units.is_old(0, 1)) memory.give_back(0, 1, 9);
    }
  }
  void after() {
    RL_ASSERT(memory.use_one(1, true));
    Backed::Units units(memory.words.data(), Backed::kUnits);
    RL_ASSERT(units.has(0, 0));
  }
  Backed memory;
};

/// A look for memory asks for a unit that another process gives back: what it gets is not
/// forgotten.
template <bool kWasGiven>
struct AttemptsAreNoted : SceneBegins, rl::test_suite<AttemptsAreNoted<kWasGiven>, 2> {
  AttemptsAreNoted() : tags(2), words(1), given(1) {}
  void before() {
    Backed::Units units(words.data(), 1);
    if (kWasGiven) RL_ASSERT(units.get(0, 0, [&](std::uint32_t) { return ask(); }));
  }
  void thread(unsigned t) {
    Backed::Units units(words.data(), 1);
    if (t == 0) {
      units.try_get(0, 0, [&](std::uint32_t) { return ask(); });
      return;
    }
    Memory::Granules granules(tags.data(), 2);
    units.give_back(
        0, 0, granules, 0, 2, 9,
        [&] {
          given[0].exchange(0, std::memory_order_acq_rel);
          return true;
        },
        [](std::uint32_t) { return false; });
  }
  void after() {
    Backed::Units units(words.data(), 1);
    const bool is_there = given[0].load(std::memory_order_seq_cst) != 0;
    RL_ASSERT(is_there ? units.is_old(0, 0) : !units.has(0, 0));
  }
  bool ask() {
    given[0].exchange(1, std::memory_order_acq_rel);
    return true;
  }
  std::vector<CheckedAtomic<std::uint32_t>> tags;
  std::vector<CheckedAtomic<std::uint32_t>> words;
  /// By the system. Its calls take a lock of its own: a later one has seen what stood before an
  /// earlier one.
  std::vector<CheckedAtomic<std::uint32_t>> given;
};

/// The process that gives a unit back is killed anywhere, and reaped; a living one uses the unit
/// before, meanwhile or after.
struct GiverKilled : Scene<GiverKilled, 2> {
  void prepare() {
    start(2);
    RL_ASSERT(memory.use_one(1, true));
  }
  void thread(unsigned t) {
    if (t == 1) {
      while (!memory.use_one(3, true)) Policy::pause();
      return;
    }
    die_within(2, 12, [&] { memory.give_back(0, 0, 2); });
    RL_ASSERT(segment.try_lock(2, 4));
    Memory::Granules granules(memory.tags.data(), Backed::kInUnit * Backed::kUnits);
    granules.release_if([](std::uint32_t tag) { return tag == 2; });
  }
  void check() {
    const Memory::Granules granules(memory.tags.data(), Backed::kInUnit * Backed::kUnits);
    RL_ASSERT(granules.used() == 0);
    RL_ASSERT(memory.use_one(4, true));
    const Backed::Units units(memory.words.data(), Backed::kUnits);
    RL_ASSERT(units.has(0, 0));
  }
  Backed memory;
};

const Entered entered{
    {"runs_change_hands", "a granule has one owner after the other", cast_of<RunsChangeHands>, 1},
    {"runs_are_resized", "a run is made longer and shorter beside claims", cast_of<RunsAreResized>,
     1},
    {"run_is_undone", "a run that was not complete is handed on", cast_of<RunIsUndone>, 2},
    {"claimer_killed", "what a dead claimer has got is found by name", cast_of<ClaimerKilled>, 1},
    {"units_go_back", "memory goes back to the system only from under nobody", cast_of<UnitsGoBack>,
     1},
    {"units_are_looked_at", "looks, attempts and claims of a unit at once",
     cast_of<UnitsAreLookedAt>, 1},
    {"giver_killed", "what a process leaves that dies while it gives memory back",
     cast_of<GiverKilled>, 1},
    {"attempts_are_noted", "memory that is asked for while it goes back is not forgotten",
     cast_of<AttemptsAreNoted<true>>, 1},
    {"new_attempts_are_noted", "the same of memory that was never given",
     cast_of<AttemptsAreNoted<false>>, 1},
};

}  // namespace
}  // namespace lot::model
