// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <type_traits>

#include "lot/compliance.hpp"

namespace lot::testing {

/// What no description explains: an opaque type.
class Secret {
 public:
  std::uint32_t get() const { return value_; }

 private:
  std::uint32_t value_ = 17;
};
/// A message with an opaque part.
struct HasSecret {
  std::uint32_t before = 1;
  Secret secret;
};

}  // namespace lot::testing

template <>
struct lot::is_trusted_message<lot::testing::Secret> : std::true_type {};
