// SPDX-License-Identifier: Apache-2.0

#include <functional>

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  std::function<void()> callback;
};

static_assert(lot::assert_message<Message>());
