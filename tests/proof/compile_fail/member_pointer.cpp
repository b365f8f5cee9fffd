// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Point {
  double x, y;
};
struct Message {
  int stamp;
  double Point::*axis;
};

static_assert(lot::assert_message<Message>());
