// SPDX-License-Identifier: Apache-2.0
#include "mcap/crc.hpp"

#include <libdeflate.h>

namespace lot::mcap {
namespace {

// Polynomials over GF(2) modulo the CRC's, whose highest power is the lowest bit.
constexpr std::uint32_t kPolynomial = 0xedb88320;
constexpr std::uint32_t kOne = 0x80000000;

std::uint32_t product(std::uint32_t a, std::uint32_t b) {
  std::uint32_t sum = 0;
  for (std::uint32_t bit = kOne; bit != 0; bit >>= 1) {
    if ((a & bit) != 0) sum ^= b;
    b = (b & 1) != 0 ? (b >> 1) ^ kPolynomial : b >> 1;
  }
  return sum;
}

/// x to the power of 8 * bytes: what so many zero bytes behind it do to a CRC.
std::uint32_t shift_by(std::uint64_t bytes) {
  std::uint32_t result = kOne;
  std::uint32_t square = kOne >> 8;
  for (; bytes != 0; bytes >>= 1) {
    if ((bytes & 1) != 0) result = product(result, square);
    square = product(square, square);
  }
  return result;
}

}  // namespace

void Crc::add(View bytes) {
  if (bytes.empty()) return;  // of a null pointer libdeflate would begin anew
  value_ = libdeflate_crc32(value_, bytes.data(), bytes.size());
  bytes_ += bytes.size();
}

void Crc::add(const Crc& next) {
  value_ = product(shift_by(next.bytes_), value_) ^ next.value_;
  bytes_ += next.bytes_;
}

}  // namespace lot::mcap
