// SPDX-License-Identifier: Apache-2.0

#include <atomic>

#include <lot/lot.hpp>

struct Item {
  std::atomic<int> count;
};

void wrong(lot::ShmEngine& engine) { engine.queue<Item>("q"); }
