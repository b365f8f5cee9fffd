// SPDX-License-Identifier: Apache-2.0

#include <functional>
#include <map>
#include <utility>

#include <lot/message.hpp>

struct Message {
  int stamp;
  std::map<int, int, std::less<int>, lot::ShmAllocator<std::pair<const int, int>>> table;
};

static_assert(lot::assert_message<Message>());
