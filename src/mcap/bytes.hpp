// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

/// Numbers, texts and lists as MCAP has them in its records.
namespace lot::mcap {

static_assert(std::endian::native == std::endian::little, "as the numbers of the format");

using Bytes = std::vector<std::byte>;
using View = std::span<const std::byte>;

inline std::size_t size_of(std::span<const View> pieces) {
  std::size_t size = 0;
  for (const View piece : pieces) size += piece.size();
  return size;
}

/// The bytes are not what they should be. what() says in which way; readers add file and place.
struct Malformed : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Appends to a buffer.
class Encoder {
 public:
  explicit Encoder(Bytes& out) : out_(out) {}

  template <class Number>
  void number(Number n) {
    raw(std::as_bytes(std::span(&n, 1)));
  }
  void raw(View bytes) { out_.insert(out_.end(), bytes.begin(), bytes.end()); }
  void text(std::string_view text) {
    list([&] { raw(std::as_bytes(std::span(text))); });
  }
  /// A list of bytes or entries: its length in bytes, 4 bytes wide, and what `fill` appends. Throws
  /// std::length_error when these are too many.
  template <class Fill>
  void list(Fill&& fill) {
    measured<std::uint32_t>(fill);
  }
  /// A record: opcode, length, and what `fill` appends.
  template <class Fill>
  void record(std::uint8_t opcode, Fill&& fill) {
    number(opcode);
    measured<std::uint64_t>(fill);
  }

 private:
  template <class Length, class Fill>
  void measured(Fill& fill) {
    const std::size_t at = out_.size();
    number(Length{0});
    fill();
    const std::size_t bytes = out_.size() - at - sizeof(Length);
    if (bytes > std::numeric_limits<Length>::max()) throw std::length_error("more than 4 GiB");
    const auto length = static_cast<Length>(bytes);
    std::memcpy(out_.data() + at, &length, sizeof(length));
  }

  Bytes& out_;
};

/// Reads from the front of given bytes, and never behind their end: throws Malformed there.
class Decoder {
 public:
  explicit Decoder(View bytes) : bytes_(bytes) {}

  std::size_t left() const { return bytes_.size(); }

  template <class Number>
  Number number() {
    Number n;
    const View from = raw(sizeof(Number));
    std::memcpy(&n, from.data(), sizeof(n));
    return n;
  }
  View raw(std::uint64_t size) {
    if (size > bytes_.size()) throw Malformed("it ends too early");
    const View taken = bytes_.first(static_cast<std::size_t>(size));
    bytes_ = bytes_.subspan(taken.size());
    return taken;
  }
  /// A list: its length, and so many bytes.
  View list() { return raw(number<std::uint32_t>()); }
  std::string text() {
    const View bytes = list();
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }

 private:
  View bytes_;
};

}  // namespace lot::mcap
