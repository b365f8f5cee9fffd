// SPDX-License-Identifier: Apache-2.0

// What a recorder that keeps the last seconds still has, and what it says of the rest.

#include "record/past.hpp"

#include <cstddef>
#include <cstdint>
#include <vector>

#include <doctest/doctest.h>

using lot::record::Past;

namespace {

constexpr std::uint64_t kSecond = 1'000'000'000;

Past::Kept message(std::uint64_t at, std::size_t bytes) {
  Past::Kept kept{};
  kept.head.log_time = at;
  kept.bytes.resize(bytes);
  return kept;
}

std::vector<std::uint64_t> times(Past& past) {
  std::vector<std::uint64_t> all;
  for (const auto& kept : past.take()) all.push_back(kept.head.log_time);
  return all;
}

}  // namespace

TEST_SUITE_BEGIN("past");

TEST_CASE("messages go when they are older than it keeps, to the nanosecond") {
  Past past(2 * kSecond, 1000);
  for (const std::uint64_t at : {1 * kSecond, 2 * kSecond, 3 * kSecond}) past.add(message(at, 10));
  CHECK(past.messages() == 3);
  CHECK(past.bytes() == 30);
  past.add(message(3 * kSecond + 1, 10));
  CHECK(past.messages() == 3);
  past.look(4 * kSecond);
  CHECK(past.messages() == 3);
  past.look(4 * kSecond + 1);
  CHECK(past.messages() == 2);
  CHECK(past.bytes() == 20);
  CHECK(past.cut_messages() == 0);
  CHECK(times(past) == std::vector<std::uint64_t>{3 * kSecond, 3 * kSecond + 1});
  CHECK(past.is_empty());
  CHECK(past.bytes() == 0);
  past.look(kSecond);  // a clock that went back
  CHECK(past.is_empty());
}

TEST_CASE("what has no room goes first, is counted, and it says how much time is left") {
  Past past(100 * kSecond, 25);
  for (std::uint64_t n = 1; n <= 2; ++n) past.add(message(n * kSecond, 10));
  CHECK(past.cut_messages() == 0);
  CHECK(past.cut_time() == 0);
  for (std::uint64_t n = 3; n <= 5; ++n) past.add(message(n * kSecond, 10));
  CHECK(past.cut_messages() == 3);
  CHECK(past.cut_time() == 1 * kSecond);
  CHECK(past.bytes() == 20);
  past.add(message(12 * kSecond, 5));
  CHECK(past.cut_messages() == 3);  // they fit, to the byte
  past.add(message(14 * kSecond, 1));
  CHECK(past.cut_messages() == 4);
  CHECK(past.cut_time() == 9 * kSecond);
  past.add(message(15 * kSecond, 100));  // the last one stays, however large
  CHECK(past.cut_messages() == 7);
  CHECK(past.cut_time() == 0);
  CHECK(times(past) == std::vector<std::uint64_t>{15 * kSecond});
}

TEST_CASE("a message from a clock that went back is not old, and has no time behind it") {
  Past past(kSecond, 25);
  past.add(message(9 * kSecond, 10));
  past.add(message(4 * kSecond, 10));
  CHECK(past.messages() == 2);
  past.add(message(3 * kSecond, 10));
  CHECK(past.cut_messages() == 1);
  CHECK(past.cut_time() == 0);
}

TEST_SUITE_END();
