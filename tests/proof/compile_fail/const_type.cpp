// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Point {
  double x, y;
};
using Message = const Point;

static_assert(lot::assert_message<Message>());
