// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace lot::testing {

struct Numbered {
  std::uint64_t publisher;
  std::uint64_t number;
};

}  // namespace lot::testing
