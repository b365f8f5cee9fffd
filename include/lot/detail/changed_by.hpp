// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::detail {

/// An atomic word that only the class Owner changes. All code may read it. So the compiler refuses
/// a second place where it changes: the atomic is a private base.
///
/// Threads: as the atomic.
template <class Atomic, class Owner>
class ChangedBy : Atomic {
 public:
  using Atomic::load;
  /// The word itself, to sleep on and to wake.
  const Atomic& word() const noexcept { return *this; }

 private:
  friend Owner;
};

}  // namespace lot::detail
