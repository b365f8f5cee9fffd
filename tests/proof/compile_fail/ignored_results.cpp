// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

struct Item {
  int number;
};

// A result each that means that something was lost, or is over at once, when the caller ignores it.
void wrong(lot::ShmEngine& engine, lot::ShmPusher<Item>& pusher, lot::ShmPuller<Item>& puller,
           lot::ShmQueue<Item>& queue) {
  pusher.push(pusher.loan());
  pusher.wait_for_readers(1, lot::Duration());
  puller.pull();
  puller.borrow();
  queue.put(Item());
  queue.wait_and_take();
  engine.listen<Item>("/t", [](const lot::ShmSharedPtr<const Item>&) {});
}
