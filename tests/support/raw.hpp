// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "lot/detail/changed_by.hpp"
#include "lot/detail/hold_word.hpp"

namespace lot::test {

/// The atomic behind a word that only its owner may change. A test writes there what a dead process
/// or a wild write could have left. The cast is one to a private base.
template <class Atomic, class Owner>
Atomic& raw(detail::ChangedBy<Atomic, Owner>& word) {
  return (Atomic&)word;
}
template <class Atomic>
Atomic& raw(detail::HoldWord<Atomic>& word) {
  return (Atomic&)word;
}

}  // namespace lot::test
