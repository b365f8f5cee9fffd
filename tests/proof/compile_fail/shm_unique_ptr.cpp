// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

struct Frame {
  int stamp;
};
struct Message {
  int stamp;
  lot::ShmUniquePtr<Frame> frame;
};

static_assert(lot::assert_message<Message>());
