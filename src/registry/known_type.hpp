// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include "lot/description.hpp"
#include "lot/detail/control.hpp"
#include "lot/detail/described.hpp"

#include "segment/segment.hpp"

namespace lot::registry {

/// A message type as a topic tells it, for a process that may not have it.
///
/// Threads: reading is safe from any thread.
/// Memory:  on the heap of this process.
class KnownType {
 public:
  /// What a topic says. `bytes`: its description, empty where it has none; nothing: it is damaged.
  /// Throws lot::Error (EBADMSG) where no type can be aligned like this, std::bad_alloc.
  KnownType(std::string name, const segment::TopicEntry& topic,
            const std::optional<std::string>& bytes);
  /// A type of this program. Throws std::bad_alloc.
  KnownType(const detail::MessageType& type, Description description);
  /// A type that was made while the program runs. REQUIRES: decode() would take the description.
  /// Throws std::bad_alloc.
  KnownType(std::string name, std::uint64_t align, std::uint64_t hash, Description description);
  /// The type of a queue of such items, each taken by one reader. REQUIRES: `item` lives as long.
  /// Throws std::bad_alloc.
  KnownType(std::string name, const KnownType& item);
  KnownType(const KnownType&) = delete;
  KnownType& operator=(const KnownType&) = delete;

  /// For a publisher or a reader of the type. Its messages have no destructor: what they refer to
  /// is in their lists.
  const detail::MessageType& type() const noexcept { return type_; }
  const std::string& name() const noexcept { return name_; }
  /// Of a topic that has none: one opaque value. Throws lot::Error (EBADMSG) where it is damaged.
  const Description& description() const;
  /// True when nothing tells the two apart, the names of fields neither. Throws nothing.
  bool is_equal(const KnownType& other) const noexcept;

 private:
  struct Type : detail::MessageType {
    detail::Described known;
  };
  void fill(std::uint64_t size, std::uint64_t align, std::uint64_t hash) noexcept;
  void describe(detail::Described known);

  std::string name_;
  Type type_{};
  std::optional<Description> description_;  ///< nothing: it is damaged
};

}  // namespace lot::registry
