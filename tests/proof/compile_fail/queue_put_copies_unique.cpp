// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

struct Item {
  int number;
};

void wrong(lot::ShmQueue<lot::ShmUniquePtr<Item>>& queue) {
  const auto item = queue.make();
  queue.put(item);
}
