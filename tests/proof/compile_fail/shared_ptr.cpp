// SPDX-License-Identifier: Apache-2.0

#include <memory>

#include <lot/compliance.hpp>

struct Message {
  int stamp;
  std::shared_ptr<int> data;
};

static_assert(lot::assert_message<Message>());
