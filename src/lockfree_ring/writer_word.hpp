// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/changed_by.hpp"

#include "lockfree_ring/words.hpp"

/// The steps of a channel: free, claimed by a publisher, live, ended, the orphanage's, free.
///
/// Edges
///   R7, R9  see lockfree_ring/ring.hpp
namespace lot::ring {

/// The writer word of a channel (make_writer()): which publisher has it, and how far it is. All its
/// changes are here. The steps of one generation have one maker each, so only claim() can lose.
///
/// Threads: claim() may be called at once. The publisher, or its reaper, calls the rest.
/// Crash:   the owner in the word says whose reaper goes on (recovery/recovery.hpp).
template <class P>
class WriterWord : public detail::ChangedBy<typename P::template Atomic<Word>, WriterWord<P>> {
 public:
  /// Takes a free channel for the participant, in the generation after that of `seen`. False:
  /// another publisher was quicker.
  bool claim(Word seen, Word participant) {
    // Acquire: the process that set the entry free had recycled its ring.
    return this->compare_exchange_strong(
        seen, make_writer(Word{writer_generation(seen)} + 1, State::Init, participant),
        std::memory_order_acquire, std::memory_order_relaxed);
  }
  /// The ring is made. Readers may join it.
  void go_live(Word generation, Word participant) {
    this->store(make_writer(generation, State::Live, participant),
                std::memory_order_release);  // R7
  }
  /// The publisher has put its last message. The ring still names it.
  void end(Word generation, Word participant) {
    this->store(make_writer(generation, State::Orphan, participant),
                std::memory_order_release);  // R9
  }
  /// The ring becomes the orphanage's, which holds its messages. Release: a publisher that closes
  /// asks this word whether its ring is an orphan, and then gives its own holds up. It must see
  /// that the orphanage has holds.
  void give_to_orphanage(Word generation, Word orphanage) {
    this->store(make_writer(generation, State::Orphan, orphanage), std::memory_order_release);
  }
  /// Another publisher may claim the channel. Release: that publisher acquires that the ring was
  /// recycled; its former publisher, which may be closing, that the orphanage has holds.
  void free(Word generation) {
    this->store(make_writer(generation, State::Free, 0), std::memory_order_release);
  }
};

}  // namespace lot::ring
