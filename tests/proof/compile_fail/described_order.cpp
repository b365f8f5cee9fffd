// SPDX-License-Identifier: Apache-2.0
#include <lot/description.hpp>

struct Frame {
  int width;
  int height;
};
LOT_DESCRIBE(Frame, height, width);
