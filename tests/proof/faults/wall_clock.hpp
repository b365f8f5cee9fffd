// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace lot::testing {

/// The wall clock of this process and its children, to be set at will: libfaketime shows what a
/// file says. The file has no name, so nothing can be left of it. The monotonic clock is left as
/// it is, as it is when somebody sets the real wall clock.
///
/// Source: faketime(1).
class WallClock {
 public:
  /// Starts this program again under libfaketime, in the same process. Comes back when that is
  /// done, or cannot be. To be called before there are threads.
  static bool take();
  /// Why it cannot be set, or "".
  static const std::string& lacking();
  /// Shows the true time, `years` later.
  static void set(int years);
  /// The year that it shows now.
  static int year();
};

}  // namespace lot::testing
