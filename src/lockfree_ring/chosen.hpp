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
/// Whether a message lies between a cell's words. Nothing: that may be said yet.
inline std::optional<bool> lies_between(Word sequence, Word from, Word to) {
  if (is_set(to) && !precedes(sequence, to)) return std::nullopt;
  if (!is_set(from)) return std::nullopt;
  return !precedes(sequence, from);
}

/// A reader that is served by its ring from one message to another, and another way before and
/// after that (docs/ros.md): which messages are for it. The writer says it in the reader's cell
/// before it pushes the message; so who has read a message knows.
///
/// Threads: one, the reader's.
template <class P>
class Chosen {
 public:
  /// Whether a message is for us; who is told so delivers it. Nothing: that may be said yet, of the
  /// last message, which the writer may keep for those who come late. REQUIRES: it is borrowed, or
  /// it was answered by nothing then: else the writer may have begun anew meanwhile.
  std::optional<bool> is_ours(const Reader<P>& reader, Word sequence) {
    const Word to = reader.to();  // first: it carries `from` (R11)
    const auto is_ours = lies_between(sequence, reader.from(), to);
    if (is_ours == true) end_ = next(sequence);
    return is_ours;
  }

  /// True when nothing more will be for us, and some of what is is not read yet.
  bool has_last_ones(const Reader<P>& reader) const {
    const Word to = reader.to();
    return is_set(to) && precedes(reader.cursor(), to) && reader.ready();
  }

  /// How many messages that were ours the writer has sent another way as well, when it stopped
  /// serving us. Told once.
  std::size_t taken_back(const Reader<P>& reader) {
    const Word to = reader.to();
    if (!is_set(to) || std::exchange(seen_to_, to) == to || !end_) return 0;
    const auto n = distance(*end_, bound_sequence(to));
    return n > 0 ? static_cast<std::size_t>(n) : 0;
  }

 private:
  std::optional<Word> end_;  ///< behind the last one that was ours
  Word seen_to_ = 0;
};

}  // namespace lot::ring
