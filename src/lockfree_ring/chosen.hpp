// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <utility>

#include "lockfree_ring/ring.hpp"

namespace lot::ring {

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
    const Word to = reader.to();
    if (is_set(to) && !is_before(sequence, to)) return std::nullopt;
    const Word from = reader.from();
    if (!is_set(from)) return std::nullopt;
    if (is_before(sequence, from)) return false;
    end_ = next(sequence);
    return true;
  }

  /// True when nothing more will be for us, and some of what is is not read yet.
  bool has_last_ones(const Reader<P>& reader) const {
    const Word to = reader.to();
    return is_set(to) && is_before(reader.cursor(), to) && reader.ready();
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
  static bool is_before(Word sequence, Word bound) {
    return distance(sequence, bound_sequence(bound)) < 0;
  }

  std::optional<Word> end_;  ///< behind the last one that was ours
  Word seen_to_ = 0;
};

}  // namespace lot::ring
