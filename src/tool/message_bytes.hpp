// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "lot/description.hpp"
#include "lot/value.hpp"

namespace lot::tool {

/// How large a message is by its memory alone. Memory that is what the type needs says that there
/// is nothing else: then the size of the type. Else the memory: whole granules, and up to 1/16 more
/// than what lies there.
std::uint64_t bytes_by_memory(std::uint64_t memory, std::uint64_t type_size);

/// How large the messages of a type are: the struct, and what its vectors and strings hold. A text
/// that lies in the struct counts once. Other messages that it refers to do not count.
///
/// Threads: one.
class MessageBytes {
 public:
  /// Of no type: messages of 0 bytes.
  MessageBytes() = default;
  /// `most`: so many values are looked at in one message, as `lot echo --full` prints.
  explicit MessageBytes(const Description& description,
                        std::uint64_t most = std::uint64_t{1} << 26);

  /// False: there are types that the description does not explain, such as Boost's containers. Then
  /// bytes_by_memory() is what can be said.
  bool is_exact() const noexcept { return is_exact_; }
  /// The description's own type has this size.
  std::uint64_t type_size() const noexcept { return size_; }
  /// True: each message has the size of the type.
  bool is_constant() const noexcept { return is_exact_ && (grows_.empty() || !grows_.front()); }
  /// REQUIRES: is_exact(); it is a message of that type. Throws as Value, and lot::Error (EBADMSG)
  /// for one with more vectors and strings than a message has: those of a forged one can be the
  /// same again and again.
  std::uint64_t of(const Value& message) const;

 private:
  std::uint64_t beside(const Value& value, std::uint32_t type, std::uint64_t& left) const;

  const Description* all_ = nullptr;
  std::uint64_t most_ = 0;
  std::uint64_t size_ = 0;
  bool is_exact_ = true;
  std::vector<bool> grows_;  ///< for each type: a value may hold more than its own bytes
};

}  // namespace lot::tool
