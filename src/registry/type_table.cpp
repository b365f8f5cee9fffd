// SPDX-License-Identifier: Apache-2.0
#include "registry/type_table.hpp"

#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include "lot/detail/mapping.hpp"

#include "description/wire.hpp"

namespace lot::registry {
namespace {

constexpr std::uint64_t kPiece = segment::kDescriptionPiece;
using Number = std::uint64_t;

constexpr std::uint64_t pieces_of(std::uint64_t bytes) { return (bytes + kPiece - 1) / kPiece; }

/// FNV-1a.
std::uint32_t check_of(std::string_view bytes) {
  std::uint32_t hash = 0x811c9dc5;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x01000193;
  return hash;
}

}  // namespace

std::uint64_t TypeTable::place(std::string_view bytes, std::span<const std::uint64_t> words) {
  if (bytes.empty() || bytes.size() > description::kMostBytes) return 0;
  const std::uint32_t check = check_of(bytes);
  for (const std::uint64_t word : words) {
    if (segment::description_bytes(word) != bytes.size() ||
        segment::description_check(word) != check) {
      continue;
    }
    const auto there = copy(word);
    if (there && *there == bytes) return word;
  }
  const auto piece = find_room(bytes.size(), words);
  if (!piece) return 0;
  std::vector<Number> numbers(pieces_of(bytes.size()) * kPiece / sizeof(Number));
  std::memcpy(numbers.data(), bytes.data(), bytes.size());
  Number* to = &pieces_[*piece * kPiece / sizeof(Number)];
  for (const Number number : numbers) detail::write_once(*to++, number);
  return segment::make_description(*piece, bytes.size(), check);
}

std::optional<std::uint64_t> TypeTable::find_room(std::uint64_t bytes,
                                                  std::span<const std::uint64_t> words) const {
  std::vector<std::pair<std::uint64_t, std::uint64_t>> used;  // first piece, and the one behind
  for (const std::uint64_t word : words) {
    if (word == 0 || !is_inside(word)) continue;
    const std::uint64_t first = segment::description_offset(word) / kPiece;
    used.emplace_back(first, first + pieces_of(segment::description_bytes(word)));
  }
  std::sort(used.begin(), used.end());
  std::uint64_t free = 0;
  for (const auto& [first, end] : used) {
    if (first >= free + pieces_of(bytes)) break;
    free = std::max(free, end);
  }
  if (free + pieces_of(bytes) > pieces_.size_bytes() / kPiece) return std::nullopt;
  return free;
}

std::optional<std::string> TypeTable::copy(std::uint64_t word) const {
  if (!is_inside(word)) return std::nullopt;
  const std::uint64_t bytes = segment::description_bytes(word);
  std::vector<Number> numbers(pieces_of(bytes) * kPiece / sizeof(Number));
  const Number* from = &pieces_[segment::description_offset(word) / sizeof(Number)];
  for (Number& number : numbers) number = detail::read_once(*from++);
  std::string result(reinterpret_cast<const char*>(numbers.data()), bytes);
  if (check_of(result) != segment::description_check(word)) return std::nullopt;
  return result;
}

bool TypeTable::is_inside(std::uint64_t word) const noexcept {
  const std::uint64_t bytes = segment::description_bytes(word);
  const std::uint64_t offset = segment::description_offset(word);
  return bytes != 0 && bytes <= description::kMostBytes &&
         offset + pieces_of(bytes) * kPiece <= pieces_.size_bytes();
}

}  // namespace lot::registry
