// SPDX-License-Identifier: Apache-2.0
// Runs of granules: aligned, disjoint, found again.

#include "segment/granules.hpp"

#include <atomic>
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

  /// True when exactly the run [first, first + 2^order) has this tag.
  bool is_run(std::uint32_t first, unsigned order, std::uint32_t tag) const {
    const std::uint32_t end = first + (std::uint32_t{1} << order);
    for (std::uint32_t i = 0; i < granules.count(); ++i) {
      if ((granules.tag(i) == tag) != (i >= first && i < end)) return false;
    }
    return true;
  }

  std::vector<std::atomic<std::uint32_t>> tags;
  Granules granules;
};

struct Run {
  std::uint32_t first;
  unsigned order;
  std::uint32_t tag;
};

}  // namespace

TEST_SUITE_BEGIN("segment");

TEST_CASE("a run is aligned to its size and carries its tag in every granule") {
  for (unsigned order = 0; order <= 10; ++order) {
    CAPTURE(order);
    Pool pool(1500);  // no power of two: what is left over at the end serves small runs
    for (std::uint32_t tag = 1;; ++tag) {
      const std::uint32_t first = pool.granules.claim(order, tag);
      if (first == Granules::kNone) {
        CHECK(tag - 1 == 1500U >> order);
        break;
      }
      REQUIRE(first % (1U << order) == 0);
      REQUIRE(pool.is_run(first, order, tag));
    }
  }
}

TEST_CASE("an exhausted pool says so, leaves no trace, and serves again after a release") {
  Pool pool(8);
  REQUIRE(pool.granules.claim(3, 1) == 0);
  CHECK(pool.granules.claim(0, 2) == Granules::kNone);
  CHECK(pool.granules.claim(3, 2) == Granules::kNone);
  CHECK(pool.is_run(0, 3, 1));
  pool.granules.release(0, 3);
  CHECK(pool.granules.used() == 0);
  CHECK(pool.granules.claim(3, 2) == 0);
}

TEST_CASE("a claim that does not fit gives back what it had taken of the run") {
  Pool pool(8);
  for (const std::uint32_t i : {3U, 6U}) pool.tags[i] = 9;  // two runs of four, each spoilt
  CHECK(pool.granules.claim(2, 1) == Granules::kNone);
  CHECK(pool.granules.used() == 2);
  CHECK(pool.granules.claim(1, 1) == 0);
  CHECK(pool.granules.claim(1, 2) == 4);
}

TEST_CASE("a run that is larger than the pool or than any order is refused") {
  Pool pool(5);
  CHECK(pool.granules.claim(3, 1) == Granules::kNone);
  CHECK(pool.granules.claim(Granules::kOrders, 1) == Granules::kNone);
  CHECK(pool.granules.claim(40, 1) == Granules::kNone);
  CHECK(pool.granules.claim(2, 1) == 0);
  Pool nothing(0);
  CHECK(nothing.granules.claim(0, 1) == Granules::kNone);
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
    const unsigned order = static_cast<unsigned>(random() % 10);
    const std::uint32_t first = pool.granules.claim(order, tag);
    if (first != Granules::kNone) runs.push_back({first, order, tag});
    if (first == Granules::kNone || random() % 2 == 0) {
      if (runs.empty()) continue;
      const std::size_t victim = random() % runs.size();
      pool.granules.release(runs[victim].first, runs[victim].order);
      runs.erase(runs.begin() + static_cast<std::ptrdiff_t>(victim));
    }
    std::uint32_t used = 0;
    for (const Run& run : runs) {
      REQUIRE(pool.is_run(run.first, run.order, run.tag));
      used += 1U << run.order;
    }
    REQUIRE(pool.granules.used() == used);
  }
}

TEST_CASE("a large run fits again after many small ones") {
  Pool pool(1024);
  const std::uint32_t seed = std::random_device{}();
  MESSAGE("seed " << seed);
  std::mt19937 random(seed);
  for (int round = 0; round < 5; ++round) {
    CAPTURE(seed);
    CAPTURE(round);
    std::vector<Run> runs;
    for (std::uint32_t tag = 1;; ++tag) {
      const unsigned order = static_cast<unsigned>(random() % 4);
      const std::uint32_t first = pool.granules.claim(order, tag);
      if (first == Granules::kNone) break;
      runs.push_back({first, order, tag});
    }
    CHECK(pool.granules.claim(10, 1) == Granules::kNone);
    for (const Run& run : runs) pool.granules.release(run.first, run.order);
    const std::uint32_t large = pool.granules.claim(10, 1);
    REQUIRE(large == 0);
    pool.granules.release(large, 10);
  }
}

TEST_CASE("a few small runs leave room for a large one") {
  Pool pool(1024);
  for (std::uint32_t tag = 1; tag <= 200; ++tag) {
    REQUIRE(pool.granules.claim(0, tag) != Granules::kNone);
  }
  CHECK(pool.granules.claim(9, 1000) == 512);
  CHECK(pool.granules.claim(8, 1001) == 256);
}

TEST_CASE("the granules of the dead are found by their tag, even half a run") {
  Pool pool(64);
  const std::uint32_t living = pool.granules.claim(2, 5);
  REQUIRE(pool.granules.claim(3, 6) != Granules::kNone);
  pool.tags[40] = 6;  // killed while claiming
  REQUIRE(pool.granules.claim(1, 7) != Granules::kNone);
  pool.granules.release_if([](std::uint32_t tag) { return tag >= 6; });
  CHECK(pool.granules.used() == 4);
  CHECK(pool.is_run(living, 2, 5));
  pool.granules.release_if([](std::uint32_t tag) { return tag == 0; });  // a free one has no owner
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
      const unsigned order = static_cast<unsigned>(random() % 6);
      const std::uint32_t tag = n * 2 + id + 1;
      const std::uint32_t first = pool.granules.claim(order, tag);
      if (first == Granules::kNone) continue;
      const std::uint32_t end = first + (1U << order);
      for (std::uint32_t i = first; i < end; ++i) contents[i] = tag;
      if (n % 16 == 0) std::this_thread::yield();
      for (std::uint32_t i = first; i < end; ++i) {
        if (contents[i] != tag || pool.granules.tag(i) != tag) ++overlaps;
      }
      pool.granules.release(first, order);
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
