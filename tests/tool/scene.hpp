// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "actor.hpp"
#include "command.hpp"

namespace lot::testing {

/// Two processes with all that there is to see: queues of both kinds, messages that are kept,
/// borrowed, loaned, and a publisher without room.
struct Scene {
  Scene() : publisher(options, "publisher"), reader(options, "reader") {
    for (const char* topic : {kLetters, kParcels}) {
      publisher.act(topic, "advertise", topic == kLetters ? 1 : 2);
      reader.act(topic, "subscribe");
      for (int n = 0; n < 6; ++n) {
        publisher.act(topic, "loan");
        publisher.act(topic, "push");
        if (n == 0) reader.act(topic, "pull");
        if (n == 1) reader.act(topic, "borrow");
      }
    }
  }
  void stop_all() const {
    stop(publisher.child());
    stop(reader.child());
  }

  Room room;
  lot::EngineOptions options = room.options();
  Actor publisher;
  Actor reader;
};

}  // namespace lot::testing
