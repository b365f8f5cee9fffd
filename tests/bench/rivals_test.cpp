// SPDX-License-Identifier: Apache-2.0
#include "rivals.hpp"

#include <sstream>

#include <doctest/doctest.h>

#include "made_up.hpp"
#include "report.hpp"

namespace {

using namespace ab;
using namespace ab::testing;

Cell parked(std::size_t size) {
  Cell cell;
  cell.conditions.size = size;
  cell.conditions.pool = 100;
  const auto add = [&](const char* name, std::int64_t ns) {
    cell.arms.push_back(arm_of(name, stream_of({}, always(ns), size)));
  };
  add("lot2021", 50'000);
  add("lot2021-direct", 34'000);
  add("tcp", 9'000'000);
  add("uds", 5'000'000);
  add("iceoryx", 36'000);
  add("floor-futex", 32'000);
  return cell;
}

}  // namespace

TEST_SUITE("lot_ab rivals") {
  TEST_CASE("each rival is held to what it is known to reach, in its better shape") {
    const auto checks = check_rivals(run_of({parked(16 << 20)}));
    REQUIRE(checks.size() == 3);
    CHECK(checks[0].rival == "lot2021-direct");
    CHECK(checks[0].reached.find("1.06") == 0);
    CHECK(checks[0].limit == "1.15 floor-futex");
    CHECK(checks[0].verdict == "yes");
    CHECK(checks[1].rival == "tcp");
    CHECK(checks[1].reached == "9.00 ms");
    CHECK(checks[1].verdict == "NO");
    CHECK(checks[2].rival == "uds");
    CHECK(checks[2].verdict == "yes");
  }

  TEST_CASE("only under the conditions that are known") {
    CHECK(check_rivals(run_of({parked(128)})).size() == 1);  // lot2021
    const auto under = [](auto&& change) {
      Cell cell = parked(16 << 20);
      change(cell);
      return check_rivals(run_of({cell})).size();
    };
    CHECK(under([](Cell& cell) { cell.conditions.pool = 0; }) == 0);
    CHECK(under([](Cell& cell) { cell.conditions.place = "containers"; }) == 0);
    CHECK(under([](Cell& cell) { cell.conditions.graph = "1p5s"; }) == 0);
    CHECK(under([](Cell& cell) { cell.conditions.pin = "same-core"; }) == 0);
    CHECK(under([](Cell& cell) { cell.conditions.fill = false; }) == 0);
    CHECK(under([](Cell& cell) {
            cell.arms[0].utilisation.push_back({"publisher 0", 1, 1});
          }) == 0);
    CHECK(under([](Cell& cell) { cell.arms[1].refused = "failed"; }) == 2);  // its better shape
  }

  TEST_CASE("what the interval leaves open is not judged") {
    Cell cell = parked(128);
    for (const auto& [arm, seed] : {std::pair{0, 1}, {1, 2}, {5, 3}}) {
      const double median = arm == 5 ? 32'000 : 37'500;
      cell.arms[static_cast<std::size_t>(arm)].streams[0] =
          stream_of({1, 1, 10, 4}, noisy(median, 0.4, static_cast<std::uint64_t>(seed)), 128);
    }
    const auto checks = check_rivals(run_of({cell}));
    REQUIRE(checks.size() == 1);
    CHECK(checks[0].verdict != "NO");
  }

  TEST_CASE("a rival that spins is held to the line between cores") {
    Cell cell = parked(128);
    cell.conditions.wait = "spin";
    cell.conditions.mode = "ping-pong";
    cell.conditions.pin = "other-core";
    CHECK(check_rivals(run_of({cell})).empty());  // without that floor nothing can be said
    cell.arms.push_back(arm_of("floor-spin", stream_of({}, always(2'000), 128)));
    const auto checks = check_rivals(run_of({cell}));
    REQUIRE(checks.size() == 1);
    CHECK(checks[0].rival == "iceoryx");
    CHECK(checks[0].verdict == "NO");  // 18
  }

  TEST_CASE("the report says so") {
    std::ostringstream out;
    print(out, run_of({parked(16 << 20)}));
    CHECK(out.str().find("tcp: 9.00 ms, at most 8.00 ms: NO") != std::string::npos);
    CHECK(out.str().find("lot2021-direct: 1.06") != std::string::npos);
  }
}
