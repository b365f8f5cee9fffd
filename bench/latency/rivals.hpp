// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "result.hpp"

/// A comparison is worth what its rivals are: what each of them is known to reach elsewhere, and
/// whether it does so in this run. One that does not is built or driven badly here; where the limit
/// is a time and not a ratio, this machine may also be slower than the one that is known.
namespace ab {

struct RivalCheck {
  std::string rival;
  std::string where;    ///< the cell
  std::string reached;  ///< "1.07 (1.05-1.09) floor-futex", "7.61 ms"
  std::string limit;    ///< "1.15 floor-futex", "8 ms"
  std::string verdict;  ///< "yes", "NO"; "unclear": the interval of the ratio has the limit in it
};

/// One for each cell of the run that a limit is known for: on the host, from one publisher to one
/// subscriber, and not while a profile was taken. Latencies from the stamp after filling.
std::vector<RivalCheck> check_rivals(const Run&);

}  // namespace ab
