// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

// Only src/refcount/ownership.hpp, and HoldWord for copied pointers, change a hold word.
void wrong(lot::detail::ControlBlock& cell) {
  cell.hold.store(0);
  cell.hold.fetch_add(1);
  cell.hold.exchange(1);
  cell.hold = 1;
}
