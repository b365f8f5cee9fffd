// SPDX-License-Identifier: Apache-2.0

#include "segment/layout.hpp"

// Only src/refcount/ownership.hpp changes the shared words of a block.
void wrong(lot::segment::BlockWords& words) {
  words.own[0].fetch_or(1);
  words.life.fetch_add(1);
  words.home.store(0);
  words.home_points.store(1);
}
