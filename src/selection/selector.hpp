// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

#include "lockfree_ring/ring.hpp"
#include "selection/bounds.hpp"

namespace lot::selection {

/// The publisher's side: says to readers of its ring which messages are for them.
///
/// Threads: one at a time, with the writer.
template <class P>
class Selector {
 public:
  /// A reader that was selected: its cell, and its round there.
  struct Selected {
    std::uint32_t participant = 0;
    std::uint32_t cell = 0;
    Word round = 0;
  };

  /// REQUIRES: the writer's ring has extra memory.
  explicit Selector(ring::Writer<P>& writer) : writer_(writer), ring_(writer.ring()) {}

  /// Tells the only reader that this participant has in the ring that the next message and all
  /// later ones are for it, and the last `back` ones before. Returns nothing when the participant
  /// has no reader here or several, when the reader has not yet read all that was for it before,
  /// or when the last `back` messages are not all in the ring. Observers do not count.
  ///
  /// `still()` is asked after the look at the reader. It says whether the participant is still the
  /// one that is meant. `answer`: selects only a reader that joined with that answer.
  ///
  /// Crash: killed between the two bounds, or behind them: what is said of messages that never
  ///        come. The ring ends, and the reader knows it.
  template <class Still>
  std::optional<Selected> select(std::uint32_t participant, Word back, Still&& still,
                                 std::optional<Word> answer = {}) {
    if (!has_last(back)) return std::nullopt;
    const std::optional<std::uint32_t> cell = only_cell_of(participant);
    if (!cell) return std::nullopt;
    auto& [from, to] = bounds_of(ring_, *cell);
    // A reader that has not finished joining may not have begun its round yet.
    const Word position = ring_.cells[*cell].position.load(std::memory_order_acquire);  // R3
    if (!ring::is_place(position)) return std::nullopt;
    if (ring::is_observer(position)) return std::nullopt;  // it begins none
    Word begin = from.load(std::memory_order_acquire);     // S2
    Word end = to.load(std::memory_order_relaxed);  // its round is compared with that of `from`
    const Word round = bound_round(begin);
    if (answer && begin != make_unbound(round, *answer)) return std::nullopt;
    if (bound_round(end) != round || is_set(begin) != is_set(end)) return std::nullopt;
    if (is_set(end) && precedes(ring::sequence(position), end)) return std::nullopt;
    // Relaxed: S2 has brought the name that belongs to this round.
    if (!still() || ring_.who[*cell].load(std::memory_order_relaxed) != participant + 1) {
      return std::nullopt;
    }
    // If the cell has another reader by now, that reader has begun another round, and the
    // compare-and-swap fails. Relaxed: the message's slot carries it to the reader (R1), or S1.
    if (!from.compare_exchange_strong(begin, make_bound(round, before_next(back)),
                                      std::memory_order_relaxed, std::memory_order_relaxed)) {
      return std::nullopt;
    }
    if (is_set(end) &&
        !to.compare_exchange_strong(end, make_unbound(round), std::memory_order_release,
                                    std::memory_order_relaxed)) {  // S1
      return std::nullopt;
    }
    return Selected{participant, *cell, round};
  }

  /// True when the last n messages are all in the ring: there were n, and none was evicted or
  /// overwritten.
  bool has_last(Word n) const {
    const std::uint32_t depth = writer_.depth();
    if (n > depth) return false;
    if (static_cast<Word>(ring::distance(writer_.next_sequence(), ring_.first)) < n) return false;
    for (std::uint32_t i = 1; i <= n; ++i) {
      if (writer_.held(depth - i) == ring::kNoBlock) return false;
    }
    return true;
  }

  /// False when that reader has left its cell, also where an observer of its process has taken it:
  /// the round is the reader's then. Any thread may ask.
  static bool is_there(const ring::Ring<P>& ring, const Selected& selected) {
    // Relaxed, all: a hint. The reader may leave at any time.
    const Word from = bounds_of(ring, selected.cell).from.load(std::memory_order_relaxed);
    const Word position = ring.cells[selected.cell].position.load(std::memory_order_relaxed);
    return bound_round(from) == selected.round && !ring::is_observer(position) &&
           ring.who[selected.cell].load(std::memory_order_relaxed) == selected.participant + 1;
  }

  /// Ends what is for that reader: no later message is for it, nor are the last `back` messages,
  /// where it has not read them yet.
  void deselect(const Selected& selected, Word back) {
    Word open = make_unbound(selected.round);
    // Relaxed: the next message's slot carries it (R1).
    bounds_of(ring_, selected.cell)
        .to.compare_exchange_strong(open, make_bound(selected.round, before_next(back)),
                                    std::memory_order_relaxed, std::memory_order_relaxed);
  }

 private:
  /// The sequence of the message that is `back` before the next one.
  Word before_next(Word back) const {
    return ring::advance(writer_.next_sequence(), ring::kSequenceMask + 1 - back);
  }

  std::optional<std::uint32_t> only_cell_of(std::uint32_t participant) {
    std::optional<std::uint32_t> cell;
    bool several = false;
    writer_.each_reader([&](std::uint32_t p, std::uint32_t c) {
      if (p != participant) return;
      several = cell.has_value();
      cell = c;
    });
    return several ? std::nullopt : cell;
  }

  ring::Writer<P>& writer_;
  const ring::Ring<P>& ring_;
};

/// The reader's side: which messages of one ring are for this reader. A reader that joins the ring
/// anew begins with a new Selection.
///
/// Threads: one, the reader's.
template <class P>
class Selection {
 public:
  /// What the publisher has said to the reader. REQUIRES: the ring has extra memory.
  struct Said {
    Word from = 0;
    Word to = 0;
  };
  static Said said_to(const ring::Reader<P>& reader) {
    const Bounds<P>& bounds = bounds_of(reader.ring(), reader.cell());
    const Word to = bounds.to.load(std::memory_order_acquire);  // S1: before `from`
    // Relaxed: R1 or S1 carries it.
    return {bounds.from.load(std::memory_order_relaxed), to};
  }
  /// True when the publisher has selected the reader, and has not ended that.
  static bool is_selected(const ring::Reader<P>& reader) {
    const Said said = said_to(reader);
    return is_set(said.from) && !is_set(said.to);
  }

  /// Whether a message is for this reader. If so, the caller delivers it. Nothing: the publisher
  /// may still say so. It can happen with the last message, which the publisher may keep for
  /// readers that come late. REQUIRES: the reader borrows the message, or this returned nothing
  /// when it did. Else the publisher may have begun to select the reader anew meanwhile.
  std::optional<bool> is_ours(const ring::Reader<P>& reader, Word sequence) {
    const Said said = said_to(reader);
    const auto is_ours = lies_between(sequence, said.from, said.to);
    if (is_ours == true) end_ = ring::next(sequence);
    return is_ours;
  }

  /// True when the publisher has said which message is the last for this reader, and the reader has
  /// not read all of them.
  static bool has_remaining(const ring::Reader<P>& reader) {
    const Word to = said_to(reader).to;
    return is_set(to) && precedes(reader.cursor(), to) && reader.ready();
  }

  /// How many messages that were for this reader the publisher has sent over the second path as
  /// well, when it ended the selection. Returns the number once, then 0.
  std::size_t resent(const ring::Reader<P>& reader) {
    const Word to = said_to(reader).to;
    if (!is_set(to) || std::exchange(seen_to_, to) == to || !end_) return 0;
    const auto n = ring::distance(*end_, bound_sequence(to));
    return n > 0 ? static_cast<std::size_t>(n) : 0;
  }

 private:
  std::optional<Word> end_;  ///< behind the last message that was for this reader
  Word seen_to_ = 0;
};

}  // namespace lot::selection
