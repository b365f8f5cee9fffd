// SPDX-License-Identifier: Apache-2.0

#include <lot/lot.hpp>

// Only src/refcount/ownership.hpp, and HoldWord for copied pointers, change a hold word.
void wrong(lot::detail::ControlBlock& control) {
  control.hold.store(0);
  control.hold.fetch_add(1);
  control.hold.exchange(1);
  control.hold = 1;
}
