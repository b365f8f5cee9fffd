// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

struct Item {
  int number;
};

void wrong(lot::ShmEngine& engine) { engine.queue<lot::ShmSharedPtr<Item>>("q"); }
