// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "segment/segment.hpp"

namespace lot::registry {

/// The bytes of descriptions, once for each type (docs/descriptions.md). A topic's word says where
/// its description lies; room that no topic's word names is free.
///
/// Crash:   bytes that no word names yet are free.
class TypeTable {
 public:
  explicit TypeTable(const segment::Segment& segment) noexcept : pieces_(segment.descriptions()) {}

  /// The word of these bytes: that of a topic that has the same ones, or one for free room, where
  /// this writes them. 0: there are no bytes, or there is no room. `words` are those of all topics
  /// that are there. Throws std::bad_alloc. REQUIRES: the registry's lock.
  std::uint64_t place(std::string_view bytes, std::span<const std::uint64_t> words);
  /// What a word names. Nothing: its bytes are not those that it was made for. They are damaged; or
  /// another process writes there, and the topic has another word by now. Throws std::bad_alloc.
  std::optional<std::string> copy(std::uint64_t word) const;

 private:
  std::optional<std::uint64_t> find_room(std::uint64_t bytes,
                                         std::span<const std::uint64_t> words) const;
  /// Whether the bytes of a word lie in the table.
  bool is_inside(std::uint64_t word) const noexcept;

  std::span<std::uint64_t> pieces_;
};

}  // namespace lot::registry
