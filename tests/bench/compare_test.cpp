// SPDX-License-Identifier: Apache-2.0
#include "compare.hpp"

#include <sstream>

#include <doctest/doctest.h>

#include "made_up.hpp"

namespace {

using namespace ab;
using namespace ab::testing;

constexpr Shape kShape{1, 1, 20, 50};  // 1000 messages: p99 is judged

struct Medians {  // in nanoseconds
  double ring = 40'000;
  double tcp = 400'000;
  double floor = 30'000;
};

Run measured(const Medians& medians, std::uint64_t seed, const Shape& shape = kShape) {
  Cell cell;
  cell.conditions.messages = shape.blocks * shape.messages;
  cell.conditions.block = shape.messages;
  cell.arms = {arm_of("ring", stream_of(shape, noisy(medians.ring, 0.1, seed))),
               arm_of("tcp", stream_of(shape, noisy(medians.tcp, 0.1, seed + 1))),
               arm_of("floor-futex", stream_of(shape, noisy(medians.floor, 0.1, seed + 2)))};
  return run_of({cell});
}

std::string said;
int status_of(const Run& a, const Run& b) {
  std::ostringstream out;
  const int status = compare(out, a, b);
  said = out.str();
  return status;
}
bool says(const std::string& word) { return said.find(word) != std::string::npos; }

}  // namespace

TEST_SUITE("lot_ab compare") {
  TEST_CASE("a run is the same as itself and as one like it") {
    for (std::uint64_t seed = 10; seed < 40; seed += 3) {
      CAPTURE(seed);
      CHECK(status_of(measured({}, 1), measured({}, seed)) == 0);
      CHECK(says("2 compared: 0 slower, 0 faster"));
    }
    CHECK(status_of(measured({}, 1), measured({}, 1)) == 0);
  }

  TEST_CASE("an arm that got slower is found and ends in 1") {
    CHECK(status_of(measured({}, 1), measured({.ring = 48'000}, 5)) == 1);
    CAPTURE(said);
    CHECK(says("SLOWER"));
    CHECK(says("2 compared: 1 slower, 0 faster"));
  }

  TEST_CASE("an arm that got faster is found and ends in 0") {
    CHECK(status_of(measured({}, 1), measured({.tcp = 300'000}, 5)) == 0);
    CAPTURE(said);
    CHECK(says("faster"));
    CHECK(says("2 compared: 0 slower, 1 faster"));
  }

  TEST_CASE("a machine that got slower as a whole is not the arms' fault") {
    CHECK(status_of(measured({}, 1),
                    measured({.ring = 60'000, .tcp = 600'000, .floor = 45'000}, 5)) == 0);
    CAPTURE(said);
    CHECK(says("0 slower, 0 faster"));
    CHECK(says("1.5"));
  }

  TEST_CASE("an arm that a drift of the floor did not touch is the same") {
    CHECK(status_of(measured({}, 1), measured({.floor = 15'000}, 5)) == 0);
    CHECK(says("0 slower, 0 faster"));
  }

  TEST_CASE("what is no more than the floor's own drift is noise, what is more is not") {
    CHECK(status_of(measured({}, 1), measured({.ring = 72'000, .floor = 45'000}, 5)) == 0);
    CHECK(says("0 slower, 0 faster"));  // 1.2 relative to a drift of 1.5
    CHECK(status_of(measured({}, 1), measured({.ring = 120'000, .floor = 45'000}, 5)) == 1);
    CHECK(says("1 slower"));
  }

  TEST_CASE("in ping-pong the tail is that of messages, not of blocks") {
    const auto timed = [](std::uint64_t seed) {
      Run run = measured({}, seed);
      run.cells[0].conditions.mode = "ping-pong";
      for (Arm& arm : run.cells[0].arms) {
        for (std::uint32_t b = 0; b < 20; ++b) arm.streams[0].blocks.push_back({b, 50, 2'000'000});
      }
      return run;
    };
    Run after = timed(5);
    CHECK(status_of(timed(1), after) == 0);
    auto& samples = after.cells[0].arms[0].streams[0].subscribers[0].samples;
    for (std::size_t i = 0; i < samples.size(); i += 25) samples[i].entered_at += 200'000;
    CHECK(status_of(timed(1), after) == 1);
    CHECK(says("SLOWER (p99)"));
  }

  TEST_CASE("a longer tail alone is slower by its p99") {
    const Run before = measured({}, 1);
    Run after = measured({}, 5);
    auto& samples = after.cells[0].arms[0].streams[0].subscribers[0].samples;
    for (std::size_t i = 0; i < samples.size(); i += 25) samples[i].entered_at += 200'000;
    CHECK(status_of(before, after) == 1);
    CHECK(says("SLOWER (p99)"));
  }

  TEST_CASE("of another machine only what is relative to the floor counts") {
    // Twice as fast a machine, on which ring got only 1.3 times faster.
    Run other = measured({.ring = 30'800, .tcp = 200'000, .floor = 15'000}, 5);
    CHECK(status_of(measured({}, 1), other) == 0);
    other.machine.cpu = "Another CPU";
    CHECK(status_of(measured({}, 1), other) == 1);
    CHECK(says("machines differ"));
    CHECK(says("1 slower"));
  }

  TEST_CASE("with few blocks nothing is beyond noise") {
    CHECK(status_of(measured({}, 1, {1, 1, 3, 300}),
                    measured({.ring = 90'000}, 5, {1, 1, 3, 300})) == 0);
  }

  TEST_CASE("without a floor the plain ratio is judged") {
    Run before = measured({}, 1);
    Run after = measured({.ring = 48'000}, 5);
    before.cells[0].arms.pop_back();
    CHECK(status_of(before, after) == 1);
  }

  TEST_CASE("cells are the same however many messages they had") {
    CHECK(status_of(measured({}, 1, {1, 1, 10, 50}), measured({}, 5)) == 0);
    CHECK(says("2 compared"));
  }

  TEST_CASE("runs with nothing in common end in 3") {
    Run other = measured({}, 5);
    other.cells[0].conditions.size = 4096;
    CHECK(status_of(measured({}, 1), other) == 3);
    CHECK(says("Only in A: 1 cells; only in B: 1."));
    CHECK(status_of(Run{}, Run{}) == 3);
  }

  TEST_CASE("throughput is compared by time per message") {
    const auto timed = [](std::int64_t took) {
      Run run = measured({}, 1);
      for (Arm& arm : run.cells[0].arms) {
        for (std::uint32_t b = 0; b < 10; ++b) {
          const std::int64_t of_arm = arm.transport == "ring" ? took : 1'000'000;
          arm.streams[0].blocks.push_back({b, 10'000, of_arm + b * 100});
        }
      }
      return run;
    };
    CHECK(status_of(timed(2'000'000), timed(1'000'000)) == 0);
    CHECK(says("1 faster"));
    CHECK(status_of(timed(1'000'000), timed(2'000'000)) == 1);
  }

  TEST_CASE("the rule is stated with the numbers that are used") {
    const std::string rule = kCompareRule;
    for (const char* number : {"1.05", "1.25", "1000", "95 %", "4 blocks", "Exit status"}) {
      CHECK(rule.find(number) != std::string::npos);
    }
  }
}
