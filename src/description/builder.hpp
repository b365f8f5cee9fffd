// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "lot/mutable_value.hpp"

#include "description/reader.hpp"

namespace lot::description {

/// Writes the words of strings, vectors and references, as their own code writes them.
///
/// Invariants
///   - A word that says where something lies, or how much, is checked as a reader checks it
///     (ValueAccess), before it says where to write: other processes can change the message.
///   - What can throw comes before the first byte that changes. Only damage is found later.
class Builder {
 public:
  Builder(const Description& description, const detail::MessageMemory& memory)
      : all_(description), memory_(memory) {}

  /// REQUIRES: nothing in it has been made.
  void construct(const Value& value);
  void resize(const Value& vector, std::uint64_t count, bool zeroed);
  void set_text(const Value& string, std::string_view text);

 private:
  using Access = detail::ValueAccess;
  using Type = Description::Type;
  using Items = Access::Items;

  /// The types that need more than zero bytes: containers, and what no program can make without the
  /// type.
  struct Needs {
    bool words = false;
    bool opaque = false;
  };
  Needs needs(const Value& value, std::uint32_t place);
  void require_apart(const Value& value, const Type& type);
  /// Calls f(value) for each string, vector and reference that lies in a value's own bytes.
  template <class F>
  void each_container(const Value& value, F&& f);

  void require_makeable(const Value& value, std::uint32_t place);
  static void clear_bits(const Value& value, std::uint32_t bits);
  void construct_container(const Value& value) const;
  void grow(const Value& vector, const Items& has, std::uint64_t count, bool zeroed);
  void make_items(const Value& vector, const Items& items, std::uint64_t from, bool zeroed);
  /// Corrects the pointers of what was copied from elsewhere, byte for byte.
  static void moved(const Value& container, std::uint64_t distance);
  void require_no_references(const Value& value);
  void release(const Value& container);

  std::uint64_t capacity(const Value& vector, const Items& items) const;
  void tell(const Value& vector, const Items& items, const unsigned char* end_of_memory) const;
  void set_std_text(const Value& string, std::string_view text) const;
  void set_boost_text(const Value& string, std::string_view text) const;
  unsigned char* copy_of(std::string_view text) const;
  void give_back(const unsigned char* piece, std::uint64_t bytes) const noexcept;

  static constexpr std::uint64_t kMostLooks = std::uint64_t{1} << 26;

  const Description& all_;
  detail::MessageMemory memory_;
  std::uint64_t looks_left_ = kMostLooks;  ///< of require_no_references()
  std::vector<signed char> needs_;         ///< by place; -1: not asked yet
};

}  // namespace lot::description
