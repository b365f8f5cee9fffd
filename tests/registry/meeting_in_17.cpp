// SPDX-License-Identifier: Apache-2.0
// As C++17.
#include "meeting.hpp"

static_assert(__cplusplus < 202002L);

namespace {

struct alignas(64) Nameless {
  std::uint32_t id;
  float x, y;
};
struct alignas(64) Named {
  std::uint32_t id;
  float x, y;
};
LOT_DESCRIBE(Named, id, x, y);
struct alignas(64) Opaque {
  std::uint32_t id;
};

}  // namespace

template <>
struct lot::is_trusted_message<Opaque> : std::true_type {};
LOT_SAMPLE(Nameless, 0);
LOT_SAMPLE(Named, 0);
LOT_SAMPLE(Opaque, 1);

meeting::Sample meeting::nameless_in_17() { return sample<Nameless>("nameless"); }
meeting::Sample meeting::named_in_17() { return sample<Named>("named in 17"); }
meeting::Sample meeting::opaque_in_17() { return sample<Opaque>("opaque in 17"); }
