// SPDX-License-Identifier: Apache-2.0

#include <array>
#include <chrono>
#include <cstdint>

#include <lot/compliance.hpp>

// Nothing is wrong with this one: it shows that the other files fail for their own reasons.
struct Point {
  double x, y;
};
struct Message {
  std::uint64_t stamp;
  std::chrono::nanoseconds age;
  std::array<Point, 3> corners;
  std::uint8_t data[16 << 20];
};

static_assert(lot::assert_message<Message>());
