// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "lockfree_ring/ring.hpp"
#include "refcount/ownership.hpp"
#include "refcount/participant_state.hpp"

/// The one place that repairs what a death leaves. A process that exits cleanly runs the same code
/// on itself.
///
/// Every step may be repeated. When a reaper is killed anywhere, another one begins again
/// (docs/crash.md).
///
/// What the dead participant has written is carried by its byte lock. What other reapers have
/// written is carried by the orphanage's locks (byte lock 0 and a mutex). So those words are read
/// relaxed. What living participants write is not.
///
/// "byte lock k" beside a relaxed load below means the first of these, "byte lock 0" the second.
///
/// The World is what is repaired:
///   participants()               -> number of indexes, 0 included
///   participant_state(k)         -> ParticipantState<P>&
///   blocks(), block(b)           -> BlockWords<P>&
///   channels()                   -> number of channels
///   channel_writer(c)            -> WriterWord<P>&
///   ring(c)                      -> Ring<P>; depth 0 when its maker has not finished it
///   each_reference(b, f)         -> f(block) for each block that the message in b refers to
///   lock_rings(), unlock_rings() -> the registry's lock, tried, against joiners
///   recycle_ring(c)              -> releases the ring's memory and names
///   release_extents(dead)        -> releases the memory of the blocks named in vector<bool> dead
///   unsubscribe(k)               -> participant k has no pullers any more (R13)
///   forget(k)                    -> clears what else names participant k (users of topics, ears)
///   renew_directory()            -> makes readers look for rings of their topics again
///   wake(word)                   -> wakes all threads that sleep on the word
///   ring_ears(c)                 -> rings all ears that listen to channel c, and wakes them
namespace lot::recovery {

template <class P, class World>
class Recovery {
 public:
  explicit Recovery(World& world) : world_(world) {}

  /// Repairs what participant k left. Returns false when there was nothing to do. REQUIRES: byte
  /// locks k and 0 are held; k is dead, or is the caller, which leaves.
  bool reap(std::uint32_t k) {
    if (world_.participant_state(k).load(std::memory_order_relaxed) == 0)
      return false;  // byte lock k
    wake_whom_it_announced_to(k);
    for (std::uint32_t c = 0; c < world_.channels(); ++c) orphan_ring(c, k);
    world_.unsubscribe(k);  // before its cells go: no new ring awaits it (R13)
    for (std::uint32_t c = 0; c < world_.channels(); ++c) take_claims_back(c, k);
    for (std::uint32_t c = 0; c < world_.channels(); ++c) free_cells(c, k);
    adopt_references(k);
    // All homes before the first hold. Else a reaper that is killed in between leaves a message of
    // k that does not count as the orphanage's, and its references without a holder (I4).
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) move_home(b, k);
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) Own::let_go(world_.block(b), k);
    world_.forget(k);
    // Before the name goes (I4): if the process that leaves is killed here, no other process would
    // look for what it left.
    collect();
    world_.participant_state(k).free();
    return true;
  }

  /// Ends the ring of channel c if k was its publisher. No reader joins it any more. The orphanage
  /// holds the messages in the ring and those that readers still borrow. Readers that sleep wake
  /// and find the end. REQUIRES: byte lock 0.
  void orphan_ring(std::uint32_t c, std::uint32_t k) {
    auto& writer = world_.channel_writer(c);
    const ring::Word w = writer.load(std::memory_order_relaxed);  // byte lock k
    if (ring::writer_owner(w) != k || ring::writer_state(w) == ring::State::Free) return;
    const auto generation = ring::writer_generation(w);
    if (ring::writer_state(w) == ring::State::Init) {
      // No other process knows this ring. Its memory may still hold what was in there before.
      world_.recycle_ring(c);
      writer.free(generation + 1);
      return;
    }
    writer.end(generation, k);
    ring::Ring<P> r = world_.ring(c);
    for (std::uint32_t i = 0; i < r.depth; ++i) {
      // Readers may take messages meanwhile: each is still in its slot, or has a holder or a
      // hazard.
      adopt(ring::block(r.slots[i].load(std::memory_order_seq_cst)));  // R2, R10
    }
    for (std::uint32_t i = 0; i < r.readers; ++i) {
      const ring::Word position = r.cells[i].position.load(std::memory_order_seq_cst);  // R2
      if (position != ring::kIdle) adopt(ring::block(position));
    }
    wake_readers(r);
    // The name goes last (I4): until here the next reaper finds the ring by it.
    writer.give_to_orphanage(generation, refcount::kOrphanage);
  }

  /// Wakes all readers that sleep on a ring, unconditionally. A conditional wake would lose a
  /// reader whose mark a publisher took away before it died, without the wake.
  void wake_readers(ring::Ring<P>& r) {
    r.clear_sleepers();
    r.wake_sleepers([this](auto& word) { world_.wake(word); });
    world_.ring_ears(r.channel);
  }

  /// Frees what no participant needs any more: rings without readers, adopted blocks that no orphan
  /// ring names, dead blocks of the orphanage. Returns false when the registry was locked: then the
  /// rings are left for the next time. REQUIRES: byte lock 0.
  bool collect() {
    const bool all = recycle_rings();
    mark_needed();
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      if (!needed_[b]) Own::let_go(world_.block(b), refcount::kOrphanage);
    }
    while (free_dead_messages()) {
    }
    return all;
  }

  /// True when collect() would recycle a ring among the first `channels`. REQUIRES: byte lock 0.
  bool has_deserted_ring(std::uint32_t channels) {
    for (std::uint32_t c = 0; c < channels; ++c) {
      if (is_deserted_orphan(c)) return true;
    }
    return false;
  }

  /// Takes a message out of an ended ring, unless a reader looks at it. False: it is not there, or
  /// a reader looks at it. Readers that have not read it count it as missed, where all readers get
  /// it. REQUIRES: byte lock 0; nothing else has the block. Then collect() frees it.
  ///
  /// Crash: killed after the fetch_or, the next collect() finds a block that no ring names.
  bool take_out(std::uint32_t c, ring::Word b) {
    const auto w = world_.channel_writer(c).load(std::memory_order_relaxed);  // byte lock 0
    if (ring::writer_state(w) != ring::State::Orphan ||
        ring::writer_owner(w) != refcount::kOrphanage) {
      return false;
    }
    const ring::Ring<P> r = world_.ring(c);
    if (r.blocking || r.is_looked_at(b)) return false;
    for (std::uint32_t i = 0; i < r.depth; ++i) {
      // Relaxed: byte lock 0. In an ended ring no process puts a block into a slot.
      if (ring::block(r.slots[i].load(std::memory_order_relaxed)) != b) continue;
      r.slots[i].fetch_or(ring::kNoBlock, std::memory_order_seq_cst);  // R2
      return true;
    }
    return false;
  }

 private:
  using Own = refcount::Ownership<P>;

  void adopt(ring::Word b) {
    if (b < world_.blocks()) Own::adopt(world_.block(static_cast<std::uint32_t>(b)));
  }

  /// Wakes the readers to whom k may have announced a ring. A publisher that announces a ring takes
  /// marks away in the rings of others, and then wakes. If it is killed in between, it leaves
  /// readers asleep without a mark. Its ring still names it then.
  void wake_whom_it_announced_to(std::uint32_t k) {
    bool published = false;
    for (std::uint32_t c = 0; c < world_.channels() && !published; ++c) {
      const auto w = world_.channel_writer(c).load(std::memory_order_relaxed);  // byte lock k
      published = ring::writer_owner(w) == k && ring::writer_state(w) > ring::State::Init;
    }
    if (!published) return;
    // k may have made a ring and died before it announced it. The ring awaits readers, which look
    // for it now.
    world_.renew_directory();
    for (std::uint32_t c = 0; c < world_.channels(); ++c) {
      // Relaxed: byte lock k carries each ring to which k announced, and ring() acquires the ring.
      const auto w = world_.channel_writer(c).load(std::memory_order_relaxed);
      if (ring::writer_state(w) != ring::State::Live) continue;
      ring::Ring<P> r = world_.ring(c);
      // A reader that left its mark before the new version, and is not asleep yet, must look again.
      wake_readers(r);
    }
  }

  /// Takes back the tasks that k has taken and not finished. Tells the readers of each ring that k
  /// reads, even if it finds no task: a reaper, or k itself, may have been killed before it told
  /// them.
  void take_claims_back(std::uint32_t c, std::uint32_t k) {
    ring::Ring<P> r = world_.ring(c);
    if (r.claims != nullptr && r.take_claims_back(k)) wake_readers(r);
  }

  void free_cells(std::uint32_t c, std::uint32_t k) {
    ring::Ring<P> r = world_.ring(c);  // also a ring that its maker still makes, if it has cells
    for (std::uint32_t i = 0; i < r.readers; ++i) {
      if (r.who[i].load(std::memory_order_seq_cst) != k + 1) continue;  // R13
      if (!make_idle(r, i, k)) continue;
      r.space->fetch_add(2, std::memory_order_release);  // R6
      world_.wake(*r.space);
      std::uint32_t dead = k + 1;
      r.who[i].compare_exchange_strong(dead, 0, std::memory_order_release,
                                       std::memory_order_relaxed);  // R3, R8
    }
  }

  /// Takes the place of the dead k out of its cell. False: the cell is not k's any more.
  ///
  /// The maker of a ring may free the same cell (R13), and a living joiner may get it at once. No
  /// cell becomes k's again: this caller has byte lock k, and byte lock 0 keeps the ring. So if the
  /// cell is k's after the load of the position, that position is k's. If a joiner has stored the
  /// position, the load brings the maker's who = 0 (R14). The maker may free the cell after the
  /// second look. Then the position is one of these:
  ///   awaited()         No joiner writes it, so this takes only k's place away.
  ///   kIdle             There is nothing to do.
  ///   any other         Only k itself has joined with it, so no maker can free the cell.
  /// Meanwhile the writer may give k a place instead of its wish. The loop takes that one, too.
  bool make_idle(ring::Ring<P>& r, std::uint32_t i, std::uint32_t k) {
    auto& word = r.cells[i].position;
    for (;;) {
      ring::Word position = word.load(std::memory_order_acquire);           // R14
      if (r.who[i].load(std::memory_order_relaxed) != k + 1) return false;  // R14
      if (position == ring::kIdle) return true;
      if (word.compare_exchange_strong(position, ring::kIdle, std::memory_order_release,
                                       std::memory_order_relaxed)) {  // R3
        return true;
      }
    }
  }

  /// The orphanage adopts what the messages of k refer to: others may still hold those messages.
  void adopt_references(std::uint32_t k) {
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      // Relaxed: byte lock k.
      if (world_.block(b).home.load(std::memory_order_relaxed) == k + 1) {
        world_.each_reference(b, [this](ring::Word target) { adopt(target); });
      }
    }
  }

  void move_home(std::uint32_t b, std::uint32_t k) {
    auto& words = world_.block(b);
    if (words.home.load(std::memory_order_relaxed) == k + 1) {  // byte lock k
      Own::move_to_orphanage(words);
    }
  }

  bool recycle_rings() {
    if (!has_deserted_ring(world_.channels())) return true;
    if (!world_.lock_rings()) return false;
    for (std::uint32_t c = 0; c < world_.channels(); ++c) {
      if (!is_deserted_orphan(c)) continue;
      const auto w = world_.channel_writer(c).load(std::memory_order_relaxed);  // byte lock 0
      world_.recycle_ring(c);
      world_.channel_writer(c).free(ring::writer_generation(w) + 1);
    }
    world_.unlock_rings();
    return true;
  }

  bool is_deserted_orphan(std::uint32_t c) {
    const auto w = world_.channel_writer(c).load(std::memory_order_relaxed);  // byte lock 0
    return ring::writer_state(w) == ring::State::Orphan &&
           ring::writer_owner(w) == refcount::kOrphanage && world_.ring(c).deserted();
  }

  /// Notes which blocks the orphanage must go on holding: those that an orphan ring or a reader's
  /// position in it names, and those that a living message of the orphanage refers to.
  void mark_needed() {
    needed_.assign(world_.blocks(), false);
    auto need = [this](ring::Word b) {
      if (b < needed_.size()) needed_[static_cast<std::size_t>(b)] = true;
    };
    for (std::uint32_t c = 0; c < world_.channels(); ++c) {
      const auto w = world_.channel_writer(c).load(std::memory_order_relaxed);  // byte lock 0
      if (ring::writer_state(w) != ring::State::Orphan) continue;
      ring::Ring<P> r = world_.ring(c);
      for (std::uint32_t i = 0; i < r.depth; ++i) {
        need(ring::block(r.slots[i].load(std::memory_order_seq_cst)));  // R2, R10
      }
      for (std::uint32_t i = 0; i < r.readers; ++i) {
        const ring::Word position = r.cells[i].position.load(std::memory_order_seq_cst);  // R2, R3
        if (position != ring::kIdle) need(ring::block(position));
      }
    }
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      // Relaxed: byte lock 0.
      if (world_.block(b).home.load(std::memory_order_relaxed) == refcount::kHomeOrphanage) {
        world_.each_reference(b, need);
      }
    }
  }

  /// Frees the orphanage's dead messages. Returns true when one of them referred to another block:
  /// that block may now be free as well.
  bool free_dead_messages() {
    std::vector<bool> dead(world_.blocks(), false);
    bool any = false;
    bool released = false;
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      auto& words = world_.block(b);
      // Relaxed: byte lock 0.
      if (words.home.load(std::memory_order_relaxed) != refcount::kHomeOrphanage ||
          !Own::die_in_orphanage(words)) {
        continue;
      }
      dead[b] = any = true;
    }
    if (!any) return false;
    std::vector<bool> referred(world_.blocks(), false);
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      if (!dead[b]) continue;
      world_.each_reference(b, [&](ring::Word target) {
        if (target < referred.size()) referred[static_cast<std::size_t>(target)] = released = true;
      });
    }
    world_.release_extents(dead);
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      if (dead[b]) Own::free_orphan(world_.block(b));
    }
    if (!released) return false;
    mark_needed();
    for (std::uint32_t b = 0; b < world_.blocks(); ++b) {
      if (referred[b] && !needed_[b]) Own::let_go(world_.block(b), refcount::kOrphanage);
    }
    return true;
  }

  World& world_;
  std::vector<bool> needed_;
};

}  // namespace lot::recovery
