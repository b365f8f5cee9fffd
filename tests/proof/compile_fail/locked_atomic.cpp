// SPDX-License-Identifier: Apache-2.0

#include <atomic>

#include <lot/compliance.hpp>

struct Wide {
  char text[64];
};
struct Message {
  int stamp;
  std::atomic<Wide> shared;
};

static_assert(lot::assert_message<Message>());
