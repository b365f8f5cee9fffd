// SPDX-License-Identifier: Apache-2.0
#include "resume.hpp"

#include <stdexcept>

#include <doctest/doctest.h>

namespace {

using namespace ab;

CellArms cell(std::size_t size, std::vector<std::string> arms) {
  CellArms one{{}, std::move(arms)};
  one.conditions.size = size;
  return one;
}

const std::vector<CellArms> kWanted{cell(128, {"ring", "tcp"}), cell(4096, {"ring", "tcp"})};

}  // namespace

TEST_SUITE("lot_ab resume") {
  TEST_CASE("what is not saved is measured") {
    CHECK(to_measure(kWanted, {}, {}) == kWanted);
    CHECK(to_measure(kWanted, {cell(256, {"uds"})}, {}) == kWanted);
  }

  TEST_CASE("a saved cell is not replaced unasked, and the refusal names it and the ways out") {
    const std::vector<CellArms> saved{cell(4096, {"ring", "udp"})};
    for (const char* word : {"4 KiB", "ring, udp", "--out", "--resume", "--replace"}) {
      CHECK_THROWS_WITH_AS(to_measure(kWanted, saved, {}), doctest::Contains(word),
                           std::invalid_argument);
    }
    CHECK(to_measure(kWanted, saved, {.replace = true}) == kWanted);
  }

  TEST_CASE("to resume is to leave out cells that have all wanted arms, and no others") {
    const SavedPolicy resume{.resume = true};
    CHECK(to_measure(kWanted, {cell(128, {"tcp", "uds", "ring"})}, resume) ==
          std::vector<CellArms>{kWanted[1]});
    CHECK(to_measure(kWanted, {cell(128, {"ring"})}, resume) == kWanted);
    CHECK(to_measure(kWanted, {cell(128, {})}, resume) == kWanted);  // all had failed
    CHECK(to_measure(kWanted, kWanted, resume).empty());
  }

  TEST_CASE("a cell that is completed has its saved arms measured again, not deleted") {
    const std::vector<CellArms> saved{cell(128, {"ring", "udp", "floor-futex"})};
    CHECK(to_measure(kWanted, saved, {.resume = true}) ==
          std::vector<CellArms>{cell(128, {"ring", "tcp", "udp", "floor-futex"}), kWanted[1]});
    CHECK(to_measure(kWanted, saved, {.resume = true, .replace = true}) == kWanted);
  }
}
