// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "mcap/bytes.hpp"

namespace lot::mcap {

/// The CRC-32 of bytes that come in pieces. The CRC of two pieces together follows from those of
/// each: so a payload that belongs to a chunk and to the file is read once.
class Crc {
 public:
  Crc() = default;
  explicit Crc(View bytes) { add(bytes); }

  void add(View bytes);
  /// What `next` has seen, behind what this has seen.
  void add(const Crc& next);
  std::uint32_t value() const { return value_; }

 private:
  std::uint32_t value_ = 0;
  std::uint64_t bytes_ = 0;
};

}  // namespace lot::mcap
