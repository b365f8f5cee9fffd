// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <utility>

#include "lockfree_ring/ring.hpp"

namespace lot::ring {

inline bool precedes(Word sequence, Word bound) {
  return distance(sequence, bound_sequence(bound)) < 0;
}
/// Whether a message lies between a cell's words. Nothing: the writer has not said so yet, and may
/// still say it.
inline std::optional<bool> lies_between(Word sequence, Word from, Word to) {
  if (is_set(to) && !precedes(sequence, to)) return std::nullopt;
  if (!is_set(from)) return std::nullopt;
  return !precedes(sequence, from);
}

/// Which of a ring's messages are for this reader. Its publisher serves it by the ring from one
/// message to another, and over a second path (TCPROS) before and after that (docs/ros.md). The
/// writer says so in the reader's cell before it pushes the message, so a reader that has read the
/// message knows.
///
/// Threads: one, the reader's.
template <class P>
class Chosen {
 public:
  /// Whether a message is for this reader. If so, the caller delivers it. Nothing: the writer may
  /// still say so. It can happen with the last message, which the writer may keep for readers that
  /// come late. REQUIRES: the reader borrows the message, or this returned nothing when it did.
  /// Else the writer may have begun to serve anew meanwhile.
  std::optional<bool> is_ours(const Reader<P>& reader, Word sequence) {
    const Word to = reader.to();  // before `from`, which it carries (R11)
    const auto is_ours = lies_between(sequence, reader.from(), to);
    if (is_ours == true) end_ = next(sequence);
    return is_ours;
  }

  /// True when the writer has said which message is the last for this reader, and the reader has
  /// not read all of them.
  bool has_last_ones(const Reader<P>& reader) const {
    const Word to = reader.to();
    return is_set(to) && precedes(reader.cursor(), to) && reader.ready();
  }

  /// How many messages that were for this reader the writer has sent over the second path as well,
  /// when it stopped serving this reader. Returns the number once, then 0.
  std::size_t taken_back(const Reader<P>& reader) {
    const Word to = reader.to();
    if (!is_set(to) || std::exchange(seen_to_, to) == to || !end_) return 0;
    const auto n = distance(*end_, bound_sequence(to));
    return n > 0 ? static_cast<std::size_t>(n) : 0;
  }

 private:
  std::optional<Word> end_;  ///< behind the last message that was for this reader
  Word seen_to_ = 0;
};

}  // namespace lot::ring
