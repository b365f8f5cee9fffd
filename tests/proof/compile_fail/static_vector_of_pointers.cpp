// SPDX-License-Identifier: Apache-2.0

#include <lot/boost_containers.hpp>

struct Message {
  int stamp;
  boost::container::static_vector<const char*, 4> names;
};

static_assert(lot::assert_message<Message>());
