// SPDX-License-Identifier: Apache-2.0

#include <lot/boost_containers.hpp>

struct Message {
  int stamp;
  lot::ShmMap<int, int, bool (*)(int, int)> table;
};

static_assert(lot::assert_message<Message>());
