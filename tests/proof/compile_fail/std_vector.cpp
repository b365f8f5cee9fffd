// SPDX-License-Identifier: Apache-2.0

#include <vector>

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  std::vector<int> data;
};

static_assert(lot::assert_message<Message>());
