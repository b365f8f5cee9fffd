// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "mcap/bytes.hpp"

namespace lot::mcap {

enum class Compression { None, Lz4, Zstd };

/// As a file says it: "", "lz4" or "zstd".
std::string_view name_of(Compression compression);
/// Throws Malformed for a name that is none of these.
Compression compression_of(std::string_view name);

/// Bytes of a given number that begin as anything: memory that is not written is never touched, so
/// that a length that lies costs nothing.
class Buffer {
 public:
  Buffer() = default;
  explicit Buffer(std::size_t bytes)
      : data_(std::make_unique_for_overwrite<std::byte[]>(bytes)), size_(bytes) {}

  std::span<std::byte> bytes() { return {data_.get(), size_}; }
  View bytes() const { return {data_.get(), size_}; }

 private:
  std::unique_ptr<std::byte[]> data_;
  std::size_t size_ = 0;
};

/// Compresses chunks, one after the other.
///
/// Threads: one at a time.
/// Errors:  std::bad_alloc; std::runtime_error with the library's words for any other.
/// Memory:  a little more than its largest chunk, kept for the next one.
class Compressor {
 public:
  /// REQUIRES: Lz4 or Zstd. `level` is the library's own; 0: its default.
  Compressor(Compression compression, int level);
  ~Compressor();
  Compressor(Compressor&&) noexcept;
  Compressor& operator=(Compressor&&) noexcept;

  /// The pieces, one behind the other, as one frame; valid until the next call. REQUIRES: a piece.
  View compress(std::span<const View> pieces);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The largest number of bytes that so many compressed ones can stand for.
std::uint64_t most_uncompressed(Compression compression, std::uint64_t compressed_bytes);

/// Fills `to` with what the frames in `from` stand for. Throws Malformed when that is not exactly
/// so many bytes. REQUIRES: Lz4 or Zstd.
void uncompress(Compression compression, View from, std::span<std::byte> to);

}  // namespace lot::mcap
