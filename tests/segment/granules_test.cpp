// SPDX-License-Identifier: Apache-2.0
// Runs of granules: disjoint, found again, longer and shorter.

#include "segment/granules.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <random>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/atomics.hpp"

namespace {

using Granules = lot::segment::Granules<lot::detail::HardwareAtomics>;

/// Granules over plain memory.
struct Pool {
  explicit Pool(std::uint32_t count) : tags(count), granules(tags.data(), count) {}

  /// True when exactly the granules [first, first + run) have this tag.
  bool is_run(std::uint32_t first, std::uint32_t run, std::uint32_t tag) const {
    for (std::uint32_t i = 0; i < granules.count(); ++i) {
      if ((granules.tag(i) == tag) != (i >= first && i < first + run)) return false;
    }
    return true;
  }

  std::vector<std::atomic<std::uint32_t>> tags;
  Granules granules;
};

struct Run {
  std::uint32_t first;
  std::uint32_t length;
  std::uint32_t tag;
};

}  // namespace

TEST_SUITE_BEGIN("segment");

TEST_CASE("runs of one length fill the pool, whatever the length, and carry their tags") {
  for (const std::uint32_t run : {1U, 2U, 3U, 7U, 100U, 255U, 256U, 257U, 700U, 1499U, 1500U}) {
    CAPTURE(run);
    Pool pool(1500);
    for (std::uint32_t tag = 1;; ++tag) {
      const std::uint32_t first = pool.granules.claim(run, tag);
      if (first == Granules::kNone) {
        CHECK(tag - 1 == 1500U / run);
        break;
      }
      REQUIRE(pool.is_run(first, run, tag));
    }
  }
}

TEST_CASE("small runs come from the low end, large ones from the high end") {
  Pool pool(2000);
  CHECK(pool.granules.claim(3, 1) == 0);
  CHECK(pool.granules.claim(255, 2) == 3);
  CHECK(pool.granules.claim(256, 3) == 2000 - 256);
  CHECK(pool.granules.claim(300, 4) == 2000 - 256 - 300);
  CHECK(pool.granules.claim(1, 5) == 258);
}

TEST_CASE("the first place that fits is taken, also one that was given back since") {
  Pool pool(4000);
  std::vector<Run> runs;
  for (std::uint32_t tag = 1; tag <= 20; ++tag) {
    const std::uint32_t length = tag % 2 != 0 ? 10 : 300;
    runs.push_back({pool.granules.claim(length, tag), length, tag});
  }
  pool.granules.release(runs[4].first, 10);
  pool.granules.release(runs[2].first, 10);
  CHECK(pool.granules.claim(31, 30) == 100);  // too long for both
  CHECK(pool.granules.claim(4, 31) == runs[2].first);
  CHECK(pool.granules.claim(6, 32) == runs[2].first + 4);
  CHECK(pool.granules.claim(10, 33) == runs[4].first);
  pool.granules.release(runs[5].first, 300);
  pool.granules.release(runs[3].first, 300);
  CHECK(pool.granules.claim(290, 34) == runs[3].first + 10);  // from above, as near as it can
  CHECK(pool.granules.claim(260, 35) == runs[5].first + 50);
  Pool small(7);
  REQUIRE(small.granules.claim(1, 1) == 0);
  REQUIRE(small.granules.claim(4, 2) == 1);  // of the longest kind that goes in
  small.granules.release(0, 1);
  small.granules.release(1, 4);
  CHECK(small.granules.claim(4, 3) == 0);
}

TEST_CASE("what another process has given back is found as well") {
  Pool pool(600);
  Granules other(pool.tags.data(), 600);  // it knows nothing of our hints
  REQUIRE(pool.granules.claim(10, 1) == 0);
  REQUIRE(pool.granules.claim(300, 2) == 300);
  for (std::uint32_t tag = 3; pool.granules.claim(10, tag) != Granules::kNone;) ++tag;
  other.release(0, 10);
  CHECK(pool.granules.claim(10, 40) == 0);
  other.release(300, 300);
  CHECK(pool.granules.claim(290, 41) == 300);
}

TEST_CASE("an exhausted pool says so, leaves no trace, and serves again after a release") {
  Pool pool(8);
  REQUIRE(pool.granules.claim(8, 1) == 0);
  CHECK(pool.granules.claim(1, 2) == Granules::kNone);
  CHECK(pool.granules.claim(8, 2) == Granules::kNone);
  CHECK(pool.is_run(0, 8, 1));
  pool.granules.release(0, 8);
  CHECK(pool.granules.used() == 0);
  CHECK(pool.granules.claim(8, 2) == 0);
}

TEST_CASE("a claim that does not fit gives back what it had taken of the run") {
  Pool pool(8);
  for (const std::uint32_t i : {3U, 6U}) pool.tags[i] = 9;
  CHECK(pool.granules.claim(4, 1) == Granules::kNone);
  CHECK(pool.granules.used() == 2);
  CHECK(pool.granules.claim(3, 1) == 0);
  CHECK(pool.granules.claim(2, 2) == 4);
}

TEST_CASE("a run that is longer than the pool, or of nothing, is refused") {
  Pool pool(5);
  CHECK(pool.granules.claim(0, 1) == Granules::kNone);
  CHECK(pool.granules.claim(6, 1) == Granules::kNone);
  for (const std::uint32_t run : {255U, 256U, 300U, ~std::uint32_t{0}}) {
    CHECK(pool.granules.claim(run, 1) == Granules::kNone);
  }
  CHECK(pool.granules.used() == 0);
  CHECK(pool.granules.claim(5, 1) == 0);
  // Nor is one given back that there cannot be.
  struct Row {
    std::uint32_t first, run;
  };
  for (const Row& row : {Row{0, 0}, Row{0, 6}, Row{4, 2}, Row{5, 1}, Row{1, ~std::uint32_t{0}}}) {
    pool.granules.release(row.first, row.run);
    CHECK(pool.is_run(0, 5, 1));
  }
  CHECK_FALSE(pool.granules.extend(5, 1, 1));
  CHECK_FALSE(pool.granules.extend(5, 0, 1));
  pool.granules.release(4, 1);
  CHECK(pool.is_run(0, 4, 1));
  Pool nothing(0);
  CHECK(nothing.granules.claim(1, 1) == Granules::kNone);
}

TEST_CASE("only a run that may be taken is taken") {
  Pool pool(1000);
  for (const std::uint32_t run : {10U, 300U}) {
    CAPTURE(run);
    const std::uint32_t first =
        pool.granules.claim(run, run, [](std::uint32_t at) { return at % 128 == 77; });
    CHECK(first % 128 == 77);
    CHECK(pool.is_run(first, run, run));
  }
  CHECK(pool.granules.claim(10, 1, [](std::uint32_t) { return false; }) == Granules::kNone);
}

TEST_CASE("a run grows where the granules behind it are free, wholly or not at all") {
  Pool pool(20);
  REQUIRE(pool.granules.claim(4, 1) == 0);
  CHECK(pool.granules.extend(4, 6, 1));
  CHECK(pool.is_run(0, 10, 1));
  pool.tags[13] = 9;
  CHECK_FALSE(pool.granules.extend(10, 4, 1));
  CHECK(pool.is_run(0, 10, 1));
  CHECK(pool.granules.extend(10, 3, 1));
  pool.tags[13] = 0;
  CHECK_FALSE(pool.granules.extend(13, 8, 1));  // behind the end of the pool
  CHECK_FALSE(pool.granules.extend(21, 1, 1));
  CHECK(pool.granules.extend(13, 7, 1));
  CHECK(pool.is_run(0, 20, 1));
  pool.granules.release(7, 13);  // and shorter again
  CHECK(pool.is_run(0, 7, 1));
  CHECK(pool.granules.claim(13, 2) == 7);
}

TEST_CASE("runs of mixed sizes never overlap") {
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  std::mt19937 random(seed);
  Pool pool(1000);
  std::vector<Run> runs;
  for (std::uint32_t tag = 1; tag < 3000; ++tag) {
    CAPTURE(seed);
    CAPTURE(tag);
    const auto length = static_cast<std::uint32_t>(1 + random() % (random() % 3 == 0 ? 500 : 20));
    const std::uint32_t first = pool.granules.claim(length, tag);
    if (first != Granules::kNone) runs.push_back({first, length, tag});
    if (first == Granules::kNone || random() % 2 == 0) {
      if (runs.empty()) continue;
      const std::size_t victim = random() % runs.size();
      pool.granules.release(runs[victim].first, runs[victim].length);
      runs.erase(runs.begin() + static_cast<std::ptrdiff_t>(victim));
    }
    std::uint32_t used = 0;
    for (const Run& run : runs) {
      REQUIRE(pool.is_run(run.first, run.length, run.tag));
      used += run.length;
    }
    REQUIRE(pool.granules.used() == used);
  }
}

TEST_CASE("after many runs of any length most of the pool serves before one is refused") {
  // A run has at most a sixteenth of all, as 64 MiB in 1 GiB; each power of two is as likely.
  constexpr std::uint32_t kCount = 16384;
  constexpr std::uint32_t kClaims = 2000;
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  std::vector<double> fills;
  for (std::uint32_t round = 0; round < 21; ++round) {
    std::mt19937_64 random(seed + round);
    Pool pool(kCount);
    std::vector<Run> runs;
    std::uint32_t used = 0;
    for (std::uint32_t tag = 1;; ++tag) {
      const double share = std::uniform_real_distribution<>(0, 1)(random);
      const auto length = static_cast<std::uint32_t>(std::exp(share * std::log(kCount / 16.0)));
      while (tag < kClaims && used + length > kCount / 2) {  // then nothing goes any more
        const std::size_t victim = random() % runs.size();
        pool.granules.release(runs[victim].first, runs[victim].length);
        used -= runs[victim].length;
        runs[victim] = runs.back();
        runs.pop_back();
      }
      const std::uint32_t first = pool.granules.claim(length, tag);
      if (first == Granules::kNone && tag >= kClaims) break;
      if (first == Granules::kNone) continue;
      runs.push_back({first, length, tag});
      used += length;
    }
    fills.push_back(static_cast<double>(used) / kCount);
  }
  std::sort(fills.begin(), fills.end());
  MESSAGE("filled at the first refusal: " << fills.front() << ", median " << fills[10]);
  CHECK(fills[10] >= 0.75);
}

TEST_CASE("the granules of the dead are found by their tag, even half a run") {
  Pool pool(64);
  const std::uint32_t living = pool.granules.claim(4, 5);
  REQUIRE(pool.granules.claim(8, 6) != Granules::kNone);
  pool.tags[40] = 6;  // killed while claiming
  REQUIRE(pool.granules.claim(2, 7) != Granules::kNone);
  pool.granules.release_if([](std::uint32_t tag) { return tag >= 6; });
  CHECK(pool.granules.used() == 4);
  CHECK(pool.is_run(living, 4, 5));
  pool.granules.release_if([](std::uint32_t tag) { return tag == 0; });  // a free one has no owner
  CHECK(pool.granules.used() == 4);
  REQUIRE(pool.granules.claim(3, 1) != Granules::kNone);
  pool.granules.release_if([](std::uint32_t tag) { return tag == 1; });
  CHECK(pool.granules.used() == 4);
}

TEST_CASE("claims of two threads never overlap") {
  alarm(60);  // a watchdog: SIGALRM ends the test
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  Pool pool(96);
  // Written by whoever owns the granule and by nobody else: plain memory, so that ThreadSanitizer
  // sees what this test might not.
  std::vector<std::uint32_t> contents(96);
  std::atomic<int> overlaps{0};
  auto work = [&](std::uint32_t id) {
    std::mt19937 random(seed + id);
    for (std::uint32_t n = 0; n < 20000; ++n) {
      const auto length = static_cast<std::uint32_t>(1 + random() % 32);
      const std::uint32_t tag = n * 2 + id + 1;
      const std::uint32_t first = pool.granules.claim(length, tag);
      if (first == Granules::kNone) continue;
      const std::uint32_t end =
          first + length + (pool.granules.extend(first + length, 3, tag) ? 3 : 0);
      for (std::uint32_t i = first; i < end; ++i) contents[i] = tag;
      if (n % 16 == 0) std::this_thread::yield();
      for (std::uint32_t i = first; i < end; ++i) {
        if (contents[i] != tag || pool.granules.tag(i) != tag) ++overlaps;
      }
      pool.granules.release(first, end - first);
    }
  };
  std::thread one(work, 0);
  std::thread two(work, 1);
  one.join();
  two.join();
  alarm(0);
  CHECK(overlaps == 0);
  CHECK(pool.granules.used() == 0);
}

TEST_SUITE_END();
