// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>

/// What lies in every message: a head, and bytes that say by themselves whether they are whole.
namespace ab {

struct MessageHead {
  std::uint64_t number;  ///< the publisher's count, warming up included
  std::int64_t loaned_at;
  std::int64_t filled_at;
  std::int64_t pushed_at;
  std::uint32_t block;
  std::uint16_t publisher;
  std::uint16_t is_last;  ///< of its block
  std::uint64_t word;     ///< what the rest is filled with
};
static_assert(sizeof(MessageHead) <= 56, "a floor carries 56 bytes");

inline std::uint64_t payload_word(std::uint64_t number, unsigned publisher) {
  return (number * 0x9E3779B97F4A7C15U) ^ (std::uint64_t{publisher} << 32) ^ 0x5555555555555555U;
}

/// All of it, or only its last word.
inline void fill(std::byte* message, std::size_t size, std::uint64_t word, bool whole) {
  std::size_t i = whole ? sizeof(MessageHead) : size - sizeof word;
  for (; i < size; i += sizeof word) std::memcpy(message + i, &word, sizeof word);
}

/// Looks at 17 words, spread over the whole message: at each one it would measure reading.
inline bool is_whole(std::span<const std::byte> message, std::uint64_t word, bool whole) {
  const auto is = [&](std::size_t at) {
    return std::memcmp(message.data() + at, &word, sizeof word) == 0;
  };
  if (!is(message.size() - sizeof word)) return false;
  if (!whole) return true;
  const std::size_t words = (message.size() - sizeof(MessageHead)) / sizeof word;
  for (std::size_t n = 0; n < 16; ++n) {
    if (!is(sizeof(MessageHead) + words * n / 16 * sizeof word)) return false;
  }
  return true;
}

}  // namespace ab
