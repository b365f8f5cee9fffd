// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

/// How strings, vectors and references lie in a message: docs/layout.md has the same tables.
/// A reader knows both, whichever library has written the message: "libstdc++" or "libc++".
namespace lot::description {

/// A pointer is its distance to what it points to. This distance means null.
inline constexpr std::uint64_t kNull = 1;
inline constexpr std::uint64_t kWord = 8;

/// Offsets of the words of a vector.
struct VectorWords {
  std::uint64_t allocator;
  std::uint64_t begin;
  std::uint64_t end;
  std::uint64_t capacity;
};
inline constexpr std::uint64_t kVectorSize = 32;
inline constexpr VectorWords kStdVector{0, 8, 16, 24};
inline constexpr VectorWords kLibcxxVector{24, 0, 8, 16};

/// std::basic_string of libstdc++.
struct StdString {
  static constexpr std::uint64_t kSize = 40;
  static constexpr std::uint64_t kAllocator = 0;
  static constexpr std::uint64_t kData = 8;
  static constexpr std::uint64_t kLength = 16;
  static constexpr std::uint64_t kLocal = 24;     ///< 16 bytes of text: a short one's place
  static constexpr std::uint64_t kCapacity = 24;  ///< of a long one, without its zero
  static constexpr std::uint64_t kMostLocal = 15;
};

/// boost::container::basic_string, which ShmString is with libc++.
struct BoostString {
  static constexpr std::uint64_t kSize = 32;
  static constexpr std::uint64_t kAllocator = 0;
  static constexpr std::uint64_t kHead = 8;      ///< bit 0: it is short; short: a byte, length * 2
  static constexpr std::uint64_t kLocal = 9;     ///< 23 bytes of text: a short one's place
  static constexpr std::uint64_t kStorage = 16;  ///< of a long one: its bytes, with the zero
  static constexpr std::uint64_t kData = 24;
  static constexpr std::uint64_t kMostLocal = 22;
};

/// ShmRef.
struct ReferenceWords {
  static constexpr std::uint64_t kSize = 32;
  static constexpr std::uint64_t kAllocator = 0;
  static constexpr std::uint64_t kTarget = 8;
};

inline bool is_libcxx(std::string_view name) { return name == "libc++"; }
inline bool is_libstdcxx(std::string_view name) { return name == "libstdc++"; }

}  // namespace lot::description
