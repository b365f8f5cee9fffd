// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Base {
  int id;
};
struct Message : Base {
  int stamp;
};

static_assert(lot::assert_message<Message>());
