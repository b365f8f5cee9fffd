// SPDX-License-Identifier: Apache-2.0

#include <string_view>

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  std::string_view text;
};

static_assert(lot::assert_message<Message>());
