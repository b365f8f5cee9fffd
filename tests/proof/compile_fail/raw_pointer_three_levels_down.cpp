// SPDX-License-Identifier: Apache-2.0

#include <array>

#include <lot/compliance.hpp>

struct Pixel {
  float value;
  const void* texture;
};
struct Row {
  std::array<Pixel, 4> pixels;
};
struct Image {
  int width;
  Row rows[2];
};
struct Message {
  int stamp;
  Image image;
};

static_assert(lot::assert_message<Message>());
