// SPDX-License-Identifier: Apache-2.0

#include "segment/layout.hpp"

// Each shared word of topics and their rings has one class that changes it.
void wrong(lot::segment::TopicEntry& topic, lot::segment::ChannelEntry& channel,
           lot::segment::Replies& replies) {
  topic.users[0].fetch_or(1);
  topic.pullers[1].store(0);
  channel.writer.store(0);
  channel.formed.store(1);
  replies.words[0].fetch_or(1);
}
