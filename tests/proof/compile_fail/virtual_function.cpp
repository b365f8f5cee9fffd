// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

struct Message {
  virtual void print() const;
  int stamp;
};

static_assert(lot::assert_message<Message>());
