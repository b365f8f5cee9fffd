// SPDX-License-Identifier: Apache-2.0

#include <string>

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  std::string text;
};

static_assert(lot::assert_message<Message>());
