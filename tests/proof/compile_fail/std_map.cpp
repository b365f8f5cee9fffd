// SPDX-License-Identifier: Apache-2.0

#include <map>

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  std::map<int, int> table;
};

static_assert(lot::assert_message<Message>());
