// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <lot/describe.hpp>
#include <lot/message.hpp>

/// A message that is compiled as C++17 and as C++20, and both descriptions of it.
namespace described {

struct Point {
  double x, y;
};
struct Frame {
  std::uint64_t stamp;
  lot::ShmString encoding;
  lot::ShmVector<Point> corners;
  Point centre[2];
};
struct Nameless {
  std::uint64_t stamp;
  Point at;
};

#if __cplusplus < 202002L
LOT_DESCRIBE(Point, x, y)
LOT_DESCRIBE(Frame, stamp, encoding, corners, centre)
#endif

const lot::Description& frame_in_17();
const lot::Description& nameless_in_17();

}  // namespace described
