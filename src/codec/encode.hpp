// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "lot/value.hpp"

#include "codec/program.hpp"

namespace lot::codec {

/// The bytes of one message after the other: a buffer that keeps its memory. Where the message has
/// many bytes in one piece, these may stay there.
///
///     lot::codec::Encoded bytes(64 << 10);
///     encode(program, message.root(), bytes);
///     for (const lot::Bytes& piece : bytes.pieces()) write(piece);   // while the message is held
///
/// Threads: one at a time.
/// Errors:  those of encode().
/// Memory:  on the heap. pieces() lead into it and into the message.
/// Crash:   nothing of it is shared.
class Encoded {
 public:
  static constexpr std::uint64_t kCopyAll = ~std::uint64_t{0};
  static constexpr std::uint64_t kUsualMost = std::uint64_t{1} << 30;

  /// What has `large` bytes in one piece, or more, stays in the message. A message takes `most`
  /// bytes: one that others have damaged may say that it has more than there is memory.
  explicit Encoded(std::uint64_t large = kCopyAll, std::uint64_t most = kUsualMost) noexcept
      : large_from_(large), most_(most) {}

  /// Bytes of the message, with the four of the head.
  std::uint64_t size() const noexcept { return size_; }
  /// All bytes in their order. Valid until the next message, and as long as the message. Throws
  /// std::bad_alloc.
  std::vector<Bytes> pieces() const;
  /// Adds zero bytes, up to a multiple of `bytes`, a power of two. A decoder takes up to three of
  /// them behind a message. Throws std::bad_alloc.
  void pad(std::uint64_t bytes);

 private:
  friend class Encoder;
  /// Bytes that stay where they are: so many of the buffer come before them.
  struct Large {
    std::size_t before = 0;
    Bytes bytes;
  };

  std::uint64_t large_from_;
  std::uint64_t most_;
  std::uint64_t size_ = 0;
  std::vector<std::byte> buffer_;
  std::vector<Large> large_;
};

/// Makes `into` the bytes of a message, in place of those of an earlier one. Throws lot::Error: as
/// Value; EINVAL for a message of another description, EBADMSG for a bool that is neither 0 nor 1,
/// ERANGE for a vector of 2^32 elements, EMSGSIZE for more than `into` takes; and std::bad_alloc.
/// Then `into` means nothing.
void encode(const Program& program, const Value& message, Encoded& into);

}  // namespace lot::codec
