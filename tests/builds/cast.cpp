// SPDX-License-Identifier: Apache-2.0

// Without RTTI the compiler refuses this, and says what to use.

#include <lot/lot.hpp>

struct Base {
  int number;
};
struct Derived : Base {};

lot::ShmSharedPtr<Base> cast(const lot::ShmSharedPtr<Derived>& derived) {
  return lot::dynamic_pointer_cast<Base>(derived);
}
