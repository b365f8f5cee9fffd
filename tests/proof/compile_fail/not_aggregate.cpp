// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

class Secret {
 public:
  int value() const { return value_; }

 private:
  int value_ = 0;
};
struct Message {
  int stamp;
  Secret secret;
};

static_assert(lot::assert_message<Message>());
