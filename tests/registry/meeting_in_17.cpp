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
struct Point {
  float x, y;
};
struct Low {
  std::uint32_t low : 16;
  std::uint32_t high : 16;
};
struct alignas(64) BesideBits {
  Low low;
  float x, y;
  Point at;
};
struct alignas(64) PartlyNamed {
  Low low;
  float x, y;
  Point at;
};
LOT_DESCRIBE(PartlyNamed, low, x, y, at);
struct Inner {
  float x, y;
};
LOT_DESCRIBE(Inner, x, y);
struct alignas(64) InnerNamed {
  Low low;
  float x, y;
  Inner at;
};
struct __attribute__((packed)) Tight {
  std::uint8_t kind;
  std::uint32_t value;
};
LOT_DESCRIBE(Tight, kind, value);
struct alignas(64) BesideTight {
  Tight tight;
  float x, y;
};
LOT_DESCRIBE(BesideTight, tight, x, y);
struct alignas(64) Opaque {
  std::uint32_t id;
};

}  // namespace

template <>
struct lot::is_trusted_message<Opaque> : std::true_type {};
LOT_SAMPLE(Nameless, 0);
LOT_SAMPLE(Named, 0);
LOT_SAMPLE(BesideBits, 0);
LOT_SAMPLE(PartlyNamed, 0);
LOT_SAMPLE(InnerNamed, 0);
LOT_SAMPLE(BesideTight, 0);
LOT_SAMPLE(Opaque, 1);

meeting::Sample meeting::nameless_in_17() { return sample<Nameless>("nameless"); }
meeting::Sample meeting::named_in_17() { return sample<Named>("named in 17"); }
meeting::Sample meeting::opaque_in_17() { return sample<Opaque>("opaque in 17"); }
meeting::Sample meeting::beside_bits_in_17() { return sample<BesideBits>("beside bits in 17"); }
meeting::Sample meeting::partly_beside_bits_in_17() {
  return sample<PartlyNamed>("partly named in 17");
}
meeting::Sample meeting::inner_beside_bits_in_17() {
  return sample<InnerNamed>("inner named in 17");
}
meeting::Sample meeting::beside_tight_in_17() { return sample<BesideTight>("beside tight in 17"); }
