// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>

#include <lot/lot.hpp>

/// Types whose messages tests and the fuzzer carry as CDR.
namespace lot::testing {

struct Plain {
  std::uint8_t a;
  std::int16_t b;
  bool c;
  double d;
  ShmString s;
  ShmVector<std::uint16_t> v;
  std::uint8_t e;
};
/// A run where it lies at a multiple of 8.
struct Mixed {
  float x, y;
  double z;
};
struct Cloud {
  ShmString name;
  Mixed first;
  std::array<Mixed, 2> pair;
  ShmVector<Mixed> points;
};
struct Flags {
  std::uint16_t low : 3;
  std::int16_t high : 9;
};

}  // namespace lot::testing
