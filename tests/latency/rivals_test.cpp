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
  TEST_CASE("each is held to what it is known to reach, in its better shape") {
    const auto checks = check_rivals(run_of({parked(16 << 20)}));
    REQUIRE(checks.size() == 3);
    CHECK(checks[0].rival == "lot2021-direct");
    CHECK(checks[0].reached.find("1.06") == 0);
    CHECK(checks[0].limit == "1.15 floor-futex");
    CHECK(checks[0].good);
    CHECK(checks[1].rival == "tcp");
    CHECK(checks[1].reached == "9.00 ms");
    CHECK_FALSE(checks[1].good);
    CHECK(checks[2].rival == "uds");
    CHECK(checks[2].good);
  }

  TEST_CASE("only under the conditions that are known") {
    CHECK(check_rivals(run_of({parked(128)})).size() == 1);  // lot2021
    Cell cell = parked(16 << 20);
    cell.conditions.pool = 0;
    CHECK(check_rivals(run_of({cell})).size() == 2);
    cell.conditions.place = "containers";
    CHECK(check_rivals(run_of({cell})).empty());
    cell = parked(16 << 20);
    cell.conditions.graph = "1p5s";
    CHECK(check_rivals(run_of({cell})).empty());
  }

  TEST_CASE("who spins is held to the line between cores") {
    Cell cell = parked(128);
    cell.conditions.wait = "spin";
    CHECK(check_rivals(run_of({cell})).empty());  // without that floor nothing can be said
    cell.arms.push_back(arm_of("floor-spin", stream_of({}, always(2'000), 128)));
    const auto checks = check_rivals(run_of({cell}));
    REQUIRE(checks.size() == 1);
    CHECK(checks[0].rival == "iceoryx");
    CHECK_FALSE(checks[0].good);  // 18
  }

  TEST_CASE("the report says so") {
    std::ostringstream out;
    print(out, run_of({parked(16 << 20)}));
    CHECK(out.str().find("tcp: 9.00 ms, at most 8.00 ms: NO") != std::string::npos);
    CHECK(out.str().find("lot2021-direct: 1.06") != std::string::npos);
  }
}
