// SPDX-License-Identifier: Apache-2.0
// Units of memory: asked for once, given back when nobody uses them, and never from under a user.

#include "segment/units.hpp"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <random>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/atomics.hpp"

#include "support/processes.hpp"

namespace {

using Atomics = lot::detail::HardwareAtomics;
using Granules = lot::segment::Granules<Atomics>;
using Units = lot::segment::Units<Atomics>;

constexpr std::uint32_t kInUnit = 8;  ///< granules

/// Units of a few granules over plain memory, and a file system that counts what it is asked.
struct Memory {
  explicit Memory(std::uint32_t count)
      : tags(kInUnit * count), words(count), bytes(tags.size()), has(count) {}

  bool get(std::uint32_t first, std::uint32_t last) {
    return units.get(first, last, [this](std::uint32_t unit) { return ask(unit); });
  }
  bool ask(std::uint32_t unit) {
    ++asked;
    if (is_full) return false;
    has[unit] = true;
    return true;
  }
  /// The memory of a unit that goes back is wiped.
  bool give_back(std::uint32_t unit, std::uint32_t looks, std::uint32_t tag) {
    return units.give_back(
        unit, looks, granules, kInUnit * unit, kInUnit, tag,
        [&] {
          if (refuses) return false;
          has[unit] = false;
          std::fill_n(bytes.begin() + kInUnit * unit, kInUnit, 0);
          return true;
        },
        [this](std::uint32_t u) { return ask(u); });
  }
  void look(std::uint32_t unit) {
    units.look(unit, [this](std::uint32_t u) { return !granules.is_free(kInUnit * u, kInUnit); });
  }

  std::vector<std::atomic<std::uint32_t>> tags;
  std::vector<std::atomic<std::uint32_t>> words;
  std::vector<std::uint32_t> bytes;  ///< one a granule
  std::vector<std::atomic<bool>> has;
  Granules granules{tags.data(), static_cast<std::uint32_t>(tags.size())};
  Units units{words.data(), static_cast<std::uint32_t>(words.size())};
  std::atomic<unsigned> asked{0};
  bool is_full = false;
  bool refuses = false;
};

}  // namespace

TEST_SUITE_BEGIN("segment");

TEST_CASE("the system is asked once for each unit, and again for one that went back") {
  Memory memory(4);
  CHECK(!memory.units.has(0, 0));
  CHECK(memory.get(0, 2));
  CHECK(memory.asked == 3);
  CHECK(memory.get(1, 3));
  CHECK(memory.asked == 4);
  CHECK(memory.units.has(0, 3));
  CHECK(memory.give_back(2, 0, 1));
  CHECK(!memory.units.has(0, 3));
  CHECK(memory.units.has(3, 3));
  CHECK(!memory.give_back(2, 0, 1));
  CHECK(memory.get(0, 3));
  CHECK(memory.asked == 5);
  CHECK(memory.granules.used() == 0);
}

TEST_CASE("only what was unused at so many looks goes back") {
  Memory memory(2);
  REQUIRE(memory.get(0, 1));
  const std::uint32_t run = memory.granules.claim(1, 7);
  REQUIRE(run == 0);
  for (std::uint32_t n = 0; n < 3; ++n) {
    CHECK(!memory.units.is_old(1, 3));
    memory.look(0);
    memory.look(1);
  }
  CHECK(memory.units.is_old(1, 3));
  CHECK(!memory.units.is_old(0, 1));
  CHECK(!memory.give_back(0, 0, 9));  // it is in use, whatever was seen
  CHECK(memory.granules.used() == 1);
  CHECK(memory.granules.tag(run) == 7);
  SUBCASE("it goes") { CHECK(memory.give_back(1, 3, 9)); }
  SUBCASE("a use that no look has seen counts") {
    REQUIRE(memory.granules.extend(kInUnit, 1, 7));
    CHECK(memory.get(1, 1));
    memory.granules.release(kInUnit, 1);
    CHECK(!memory.give_back(1, 3, 9));
    CHECK(memory.units.has(1, 1));
    CHECK(memory.give_back(1, 0, 9));
  }
  CHECK(memory.granules.used() == 1);
}

TEST_CASE("what the system refuses is not taken for given, nor for gone") {
  Memory memory(3);
  memory.is_full = true;
  CHECK(!memory.get(0, 0));
  CHECK(!memory.units.has(0, 0));
  CHECK(memory.units.is_old(0, 5));  // perhaps some of it was given
  memory.is_full = false;
  CHECK(memory.get(0, 0));
  CHECK(!memory.units.is_old(0, 5));
  memory.refuses = true;
  CHECK(!memory.give_back(0, 0, 1));
  CHECK(memory.granules.used() == 0);
  CHECK(memory.units.has(0, 0));  // it was asked for again
  CHECK(memory.asked == 3);
  memory.is_full = true;
  CHECK(!memory.give_back(0, 0, 1));
  CHECK(!memory.units.has(0, 0));
}

TEST_CASE("what other processes may read at any time never goes") {
  Memory memory(1);
  REQUIRE(memory.granules.claim(1, 7) == 0);
  CHECK(memory.get(0, 0));
  memory.units.keep(0, 0);
  memory.granules.release(0, 1);
  for (int n = 0; n < 5; ++n) memory.look(0);
  CHECK(!memory.units.is_old(0, 0));
  CHECK(!memory.give_back(0, 0, 1));
  CHECK(memory.units.has(0, 0));
  CHECK(memory.get(0, 0));
  CHECK(memory.asked == 1);
}

TEST_CASE("memory that is asked for while it leaves is not forgotten") {
  Memory memory(1);
  REQUIRE(memory.get(0, 0));
  CHECK(memory.units.give_back(
      0, 0, memory.granules, 0, kInUnit, 1,
      [&] { return memory.units.try_get(0, 0, [&](std::uint32_t u) { return memory.ask(u); }); },
      [](std::uint32_t) { return false; }));
  CHECK(!memory.units.has(0, 0));
  CHECK(memory.units.is_old(0, 5));  // the next look gives it back
}

TEST_CASE("a look for memory leaves it to the threads that claim it") {
  Memory memory(2);
  const auto ask = [&](std::uint32_t unit) { return memory.ask(unit); };
  CHECK(memory.units.try_get(0, 1, ask));
  CHECK(memory.asked == 2);
  CHECK(!memory.units.has(0, 0));
  CHECK(memory.get(0, 0));
  CHECK(memory.units.try_get(0, 0, ask));
  CHECK(memory.asked == 3);
  CHECK(memory.give_back(1, 5, 1));  // nobody has claimed it
}

TEST_CASE("memory in use never goes, whichever threads claim, look and give back at once") {
  const lot::testing::Watchdog watchdog(100);
  constexpr std::uint32_t kUnits = 6;
  constexpr std::uint32_t kWorkers = 3;
  Memory memory(kUnits);
  std::atomic<std::uint32_t> working{kWorkers};
  std::atomic<std::uint32_t> wrong{0};
  std::atomic<std::uint32_t> given_back{0};
  std::vector<std::thread> threads;
  const auto seed = lot::testing::seed();
  for (std::uint32_t w = 0; w < kWorkers; ++w) {
    threads.emplace_back([&, w] {
      std::mt19937_64 random(seed + w);
      for (std::uint32_t n = 1; n <= 4000 || given_back == 0; ++n) {
        const auto run = static_cast<std::uint32_t>(1 + random() % 12);
        const std::uint32_t first = memory.granules.claim(run, w + 1);
        if (first == Granules::kNone) {
          std::this_thread::yield();
          continue;
        }
        const std::uint32_t last = first + run - 1;
        wrong += !memory.get(first / kInUnit, last / kInUnit);
        const std::uint32_t text = w << 28 | n;
        for (std::uint32_t i = first; i <= last; ++i) memory.bytes[i] = text;
        if (random() % 4 == 0) std::this_thread::yield();
        for (std::uint32_t i = first; i <= last; ++i) {
          wrong += memory.bytes[i] != text || !memory.has[i / kInUnit];
        }
        memory.granules.release(first, run);
      }
      --working;
    });
  }
  for (std::uint32_t tag : {100U, 101U}) {
    threads.emplace_back([&, tag] {
      while (working != 0) {
        for (std::uint32_t unit = 0; unit < kUnits; ++unit) {
          memory.look(unit);
          if (memory.units.is_old(unit, 1)) given_back += memory.give_back(unit, 1, tag);
        }
        std::this_thread::yield();
      }
    });
  }
  for (auto& thread : threads) thread.join();
  CHECK(wrong == 0);
  CHECK(given_back > 0);
  CHECK(memory.granules.used() == 0);
}

TEST_SUITE_END();
