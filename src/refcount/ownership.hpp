// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "lot/detail/changed_by.hpp"
#include "lot/detail/hold_word.hpp"

/// Robust ownership of blocks. One bit per participant says which participants hold a block, never
/// a counter. So a reaper repairs a death by clearing a bit.
///
/// Invariants
///   I1  A ring's owner holds each block in its ring, and each that was overwritten there while a
///       reader may still borrow it. Only the ring's owner looks at hazards.
///   I2  A living home's own bit stands from claim() to give_back(). At home only the hold word
///       counts.
///   I3  A hold moves in these steps: set the new bit, bump life, clear the old bit.
///   I4  A word that names the dead is erased last: after all that a reaper finds by it is done.
///
/// Edges
///   O1  clearing an own bit (release)         -> own scan in look() (acquire)
///       carries: "the holder has read all that it wanted to".
///   O2  life bump in acquire() (release)      -> life load in die() (acquire)
///       carries: the new own bit: a home that sees the bump sees the bit.
///   O3  home = 0 in give_back (release)       -> home claim in claim() (acquire)
///       carries: cleared bits and released extents.
///   O5  kWanted set in reclaim() (release)    -> own bit cleared in the same word by release() or
///       acquire_weak(), then its load there (acquire)
///       carries: with E1, back to the home, what note_waiting() noted. Both change one word, so
///       one of the changes is the later: the holder finds kWanted, or the home finds the holder's
///       bit gone.
///   O6  home_points = 1, pointer dropped (release) -> hold word in release() (acquire), then 0
///       home_points = 0, last pointer dropped (release) -> next pointer (acquire), then 1
///       carries: the order of the two stores. Only the first pointer stores 1. So while a thread
///       drops what is the only pointer, no other thread does.
///   O4  hold word, no longer busy (release)  -> hold word made busy (acquire)
///       carries: the own bit, between threads of one process.
namespace lot::refcount {

namespace hold = detail::hold;

/// The shared words of one block, on a line of their own. Ownership changes them. All code may read
/// them.
template <class P>
struct alignas(P::kLine) BlockWords {
  template <class T>
  using Atomic = detail::ChangedBy<typename P::template Atomic<T>, Ownership<P>>;

  /// P::kBitsPerWord bits a word. Bit p: participant p holds the block. Bit 0: the orphanage does.
  /// Bit p is written by p and by p's reaper. Bit 0 is written by the process that acts for the
  /// orphanage. The last bit is kWanted.
  Atomic<std::uint64_t> own[P::kOwnWords];
  /// {version : 32 | generation : 32}. Each hand-over bumps the version. The death of a message
  /// bumps the generation: it is one compare-and-swap on this word.
  Atomic<std::uint64_t> life;
  /// 0: free; p + 1: participant p owns the memory; 1: the orphanage does.
  Atomic<std::uint32_t> home;
  /// 1 while pointers in the home process hold the block. So use_count() in other processes counts
  /// the home. Edge O6 orders its changes. Between two steps it may be wrong; at rest it is right.
  Atomic<std::uint32_t> home_points;
};

/// A bit of each ownership word. The home has found that others still hold the block, and wants to
/// be told when a holder in that word lets go. The home sets it in reclaim(), and clears it when
/// the message dies. Each process that clears its own bit sees it, and tells the home. It may be
/// stale in a block that has another home by now: that home gets one needless errand.
inline constexpr std::uint64_t kWanted = std::uint64_t{1} << 63;

/// What is left after a process has let a hold go.
enum class Left {
  Held,   ///< this process has more holds
  Home,   ///< it was the last hold, and the block is at home here: the caller tries reclaim()
  Gone,   ///< it was the last hold, and the block is at home elsewhere
  Wanted  ///< as Gone, and the home waits for it: the caller tells the home
};

inline constexpr std::uint64_t kVersion = std::uint64_t{1} << 32;
inline constexpr std::uint32_t kOrphanage = 0;
inline constexpr std::uint32_t kHomeFree = 0;
inline constexpr std::uint32_t kHomeOrphanage = 1;

constexpr std::uint32_t generation_of(std::uint64_t life) {
  return static_cast<std::uint32_t>(life);
}
constexpr std::uint64_t next_generation(std::uint64_t life) {
  return (life & ~std::uint64_t{0xffffffff}) | static_cast<std::uint32_t>(generation_of(life) + 1);
}

/// The steps that a participant takes on blocks. Each step gets the block's shared words. A step
/// that changes the participant's own holds gets its private hold word, too. No other code changes
/// any of these words (but HoldWord, where a pointer is copied): their types see to it.
///
/// Threads: several threads of one process may call all of them at once on the same block.
template <class P>
struct Ownership {
  using Hold = detail::HoldWord<typename P::template Atomic<std::uint64_t>>;
  using Words = BlockWords<P>;
  static_assert(P::kBitsPerWord < 64, "the last bit is kWanted");

  Ownership() = default;
  explicit Ownership(std::uint32_t participant)
      : self(participant), own_word_(participant / P::kBitsPerWord), own_bit_(bit(participant)) {
    others_[own_word_] = ~own_bit_;
  }

  std::uint32_t self = 0;

  static std::uint64_t bit(std::uint32_t p) { return std::uint64_t{1} << (p % P::kBitsPerWord); }
  static auto& word(Words& b, std::uint32_t p) { return b.own[p / P::kBitsPerWord]; }
  /// The holders that ownership word `w` names, without participant `except`.
  static std::uint64_t holders(std::uint64_t own, std::uint32_t w, std::uint32_t except) {
    return own & ~kWanted & ~(w == except / P::kBitsPerWord ? bit(except) : 0);
  }

  /// True when a participant besides these two holds the block. Relaxed: a hint.
  static bool has_holder_besides(const Words& b, std::uint32_t one, std::uint32_t other) {
    for (std::uint32_t w = 0; w < P::kOwnWords; ++w) {
      const std::uint64_t own = holders(b.own[w].load(std::memory_order_relaxed), w, one);
      if (holders(own, w, other) != 0) return true;
    }
    return false;
  }
  /// True when the home had no hold of its own when it last looked, and waits until all holders
  /// have let go. Relaxed: a hint.
  static bool is_awaited(const Words& b) {
    for (const auto& own : b.own) {
      if ((own.load(std::memory_order_relaxed) & kWanted) != 0) return true;  // as above
    }
    return false;
  }

  /// Adds `amount` (hold::kPointer or hold::kRing) to this process's holds. REQUIRES: the caller
  /// protects the block by a hazard, a cursor or another hold.
  ///
  /// Crash: killed between bit and bump, or after the bump: the reaper clears the bit.
  void acquire(Words& b, Hold& h, std::uint64_t amount) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);  // the compare-and-swap checks it
    for (;;) {
      if ((v & hold::kBusy) != 0) {
        v = await_idle(h, v);
      } else if ((v & hold::kHeld) != 0) {  // the own bit stands, and has stood all the time
        // What a ring or another message has, other processes may see.
        const std::uint64_t seen = amount == hold::kRing ? v & ~hold::kUnseen : v;
        if (h.compare_exchange_weak(v, seen + amount, std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O4, O6
          if (amount == hold::kPointer) note_first_pointer(b, v);
          return;
        }
      } else if (h.compare_exchange_weak(v, busy(v), std::memory_order_acquire,
                                         std::memory_order_relaxed)) {  // O4
        own(b).fetch_or(own_bit_, std::memory_order_relaxed);           // O2 carries it
        b.life.fetch_add(kVersion, std::memory_order_release);          // O2
        h.store(hold::kHeld | amount, std::memory_order_release);       // O4
        P::passed();
        return;
      }
    }
  }

  /// Adds a pointer hold if the block still carries that generation: Held. Else the message has
  /// died: Gone, or Wanted. The caller need not protect the block.
  Left acquire_weak(Words& b, Hold& h, std::uint32_t generation) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);  // the compare-and-swap checks it
    for (;;) {
      if ((v & hold::kBusy) != 0) {
        v = await_idle(h, v);
      } else if ((v & hold::kHome) != 0) {
        // The tag in the hold word makes the compare-and-swap fail if the message dies meanwhile.
        // Relaxed: a thread that has a weak pointer has seen the message.
        if ((v & hold::kTagMask) != hold::tag_of(generation) ||
            generation_of(b.life.load(std::memory_order_relaxed)) != generation) {
          return Left::Gone;
        }
        if (h.compare_exchange_weak(v, v + hold::kPointer, std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O6
          note_first_pointer(b, v);
          return Left::Held;
        }
      } else if ((v & hold::kHeld) != 0) {
        if (!h.compare_exchange_weak(v, v + hold::kPointer, std::memory_order_acquire,
                                     std::memory_order_relaxed)) {  // O4
          continue;
        }
        // Relaxed: O4 brings the life as it was when the own bit was set, or a newer one. Since
        // then the message cannot have died.
        if (generation_of(b.life.load(std::memory_order_relaxed)) == generation) return Left::Held;
        return release(b, h, hold::kPointer) == Left::Wanted ? Left::Wanted : Left::Gone;
      } else if (h.compare_exchange_weak(v, busy(v), std::memory_order_acquire,
                                         std::memory_order_relaxed)) {  // O4
        own(b).fetch_or(own_bit_, std::memory_order_relaxed);           // O2 carries it
        const std::uint64_t old = b.life.fetch_add(kVersion, std::memory_order_release);  // O2
        if (generation_of(old) != generation) return clear_own_bit(b, h);
        h.store(hold::kHeld | hold::kPointer, std::memory_order_release);  // O4
        P::passed();
        return Left::Held;
      }
    }
  }

  /// Says that pointers of this process have a message that one unique pointer had. REQUIRES: the
  /// caller has that pointer.
  static void note_pointers(Words& b, const Hold& h) {
    // Relaxed, both: the caller's hold keeps the block at home, and no other thread has a pointer.
    if ((h.load(std::memory_order_relaxed) & hold::kHome) != 0) {
      b.home_points.store(1, std::memory_order_relaxed);  // see above
    }
  }

  /// The same of a message that no other process will see unless this one publishes it: the mark
  /// says so, until a ring or another message takes a hold, or a weak pointer comes. Not a locked
  /// operation: see hand_to_ring().
  static void keep_unseen(Words& b, Hold& h) {
    note_pointers(b, h);
    // Relaxed, both: no other thread has a pointer.
    h.store(h.load(std::memory_order_relaxed) | hold::kUnseen, std::memory_order_relaxed);  // above
  }
  /// A weak pointer to the message comes, and its generation must end in the way that others
  /// expect; or another copy of the library in this process publishes it, which has holds of its
  /// own. REQUIRES: the caller has a pointer, or the message has died and this changes nothing of
  /// worth.
  static void end_unseen(Hold& h) {
    std::uint64_t v = h.load(std::memory_order_relaxed);  // the compare-and-swap checks it
    while ((v & (hold::kUnseen | hold::kBusy)) == hold::kUnseen &&
           !h.compare_exchange_weak(v, v & ~hold::kUnseen, std::memory_order_relaxed,
                                    std::memory_order_relaxed)) {  // carries nothing
    }
  }
  /// The death of a message that no other process has seen, with its last pointer. The block is
  /// then exclusively owned, with that pointer's hold. False, and nothing has changed: others may
  /// have seen it, or it has more holds. REQUIRES: the caller has a pointer.
  ///
  /// Crash:   killed at any step: the reaper frees the block with its home.
  static bool die_unseen(Words& b, Hold& h) {
    // O4: the threads that have dropped the other pointers have read all that they wanted to.
    const std::uint64_t v = h.load(std::memory_order_acquire);
    if (!hold::is_last_of_unseen(v)) return false;
    // All is relaxed: no other thread or process can have this block. Not a locked operation: only
    // a weak pointer to an earlier message of the block may bump the version meanwhile. That bump
    // may be lost, as its process finds the message dead and holds nothing.
    b.home_points.store(0, std::memory_order_relaxed);                                   // as above
    const std::uint64_t life = next_generation(b.life.load(std::memory_order_relaxed));  // as above
    b.life.store(life, std::memory_order_relaxed);                                       // as above
    h.store(hold::kHome | hold::kHeld | hold::kPointer | hold::tag_of(generation_of(life)),
            std::memory_order_relaxed);  // as above
    return true;
  }

  /// Turns the pointer hold of an exclusively owned message into a hold of the ring.
  ///
  /// Not a locked operation: no other thread or process can have this block, and not even a weak
  /// pointer, since the tag keeps weak pointers of former messages away. What publishes the message
  /// carries the store.
  static void hand_to_ring(Hold& h) {
    // Relaxed, both: see above.
    const std::uint64_t v = h.load(std::memory_order_relaxed);
    h.store(v - hold::kPointer + hold::kRing, std::memory_order_relaxed);  // see above
  }

  /// Lets go of a ring's hold if this process has other holds. False, and nothing has changed, if
  /// it is the only hold. So a message that is pushed again and again has one entry in a ring after
  /// the other, but dies once.
  static bool drop_ring_hold_of_several(Hold& h) {
    std::uint64_t v = h.load(std::memory_order_relaxed);  // the compare-and-swap checks it
    while ((v & hold::kHolds) != hold::kRing) {
      if (h.compare_exchange_weak(v, v - hold::kRing, std::memory_order_release,
                                  std::memory_order_relaxed)) {  // O4
        return true;
      }
    }
    return false;
  }

  /// Takes `amount` from this process's holds. In a process that is not the home the last release
  /// clears the own bit.
  ///
  /// Crash: killed before the caller tells the home, it leaves a message without a holder. The home
  /// finds it by its own look, once a second.
  Left release(Words& b, Hold& h, std::uint64_t amount) const {
    std::uint64_t v = h.load(std::memory_order_acquire);  // O6
    for (;;) {
      const bool last = (v & hold::kHolds) == amount;
      if (last && (v & (hold::kHome | hold::kBusy)) == 0) {
        // The last hold becomes the busy bit in one step, so that no other thread can come in
        // between.
        if (h.compare_exchange_weak(v, busy(v), std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O4
          return clear_own_bit(b, h);
        }
        continue;
      }
      const bool only_pointer = amount == hold::kPointer && is_only_pointer_at_home(v);
      if (only_pointer) b.home_points.store(0, std::memory_order_relaxed);  // O6 carries it
      // Relaxed on failure: a thread stores home_points while it has the only pointer. So since the
      // load no other thread has.
      if (h.compare_exchange_weak(v, v - amount, std::memory_order_release,
                                  std::memory_order_relaxed)) {  // O4, O6
        // Release is enough: the thread that goes on makes the word busy, and that step acquires.
        return last && (v & hold::kHome) != 0 ? Left::Home : Left::Held;
      }
      // Another thread may have a pointer now. This one still has its own.
      if (only_pointer) b.home_points.store(1, std::memory_order_relaxed);  // O6 carries it
    }
  }

  /// The death of a message. True: only the home held the block, and no process can have taken a
  /// hold meanwhile. Where the orphanage is the home even its own bit must be gone.
  /// `seen`: gets kWanted if a word that was looked at has it.
  /// REQUIRES: at home, with the busy bit, or byte lock 0.
  bool die(Words& b, std::uint64_t& seen) const { return die(b, others_, seen); }
  static bool die_in_orphanage(Words& b) {
    std::uint64_t seen = 0;
    if (!die(b, kAll, seen)) return false;
    if ((seen & kWanted) != 0) ask_nobody(b);
    return true;
  }

  /// For the home: makes a block exclusively its own again, with one pointer hold. The holds of the
  /// home's process must equal `expected`: 0, or the one ring hold that the caller gives up. False:
  /// others still hold the block; the caller has given `expected` up all the same.
  ///
  /// Calls `note_waiting()` after the home has seen that it must wait, and before other processes
  /// can see that it waits. It notes the block where the home's warden will find it. It returns
  /// false when the block was noted before.
  template <class Note>
  bool reclaim(Words& b, Hold& h, std::uint64_t expected, Note&& note_waiting) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);  // the compare-and-swap checks it
    for (;;) {
      if ((v & hold::kBusy) != 0) {
        v = await_idle(h, v);
        continue;
      }
      // This thread is late: another one took a hold, let it go, and has given the block back.
      if ((v & hold::kHome) == 0) return false;
      if ((v & hold::kHolds) != expected) {  // this process has more holds
        if (expected == 0) return false;
        if (h.compare_exchange_weak(v, v - expected, std::memory_order_release,
                                    std::memory_order_relaxed)) {  // O4
          return false;
        }
        continue;
      }
      if (h.compare_exchange_weak(v, busy(v), std::memory_order_acquire,
                                  std::memory_order_relaxed)) {  // O4
        break;
      }
    }
    std::uint64_t seen = 0;
    bool dead = die(b, seen);
    if (!dead) [[unlikely]] {
      std::uint64_t all_seen = seen;  // so that `seen` itself may stay in a register
      dead = await_holders(b, all_seen, note_waiting);
      seen = all_seen;
    }
    if (dead && (seen & kWanted) != 0) [[unlikely]]
      ask_nobody(b);
    const std::uint64_t base = hold::kHome | hold::kHeld;
    if (dead) {
      // Both are relaxed: the block is only this thread's. Another thread gets it from this one by
      // a step that orders, and reads the word then.
      const std::uint32_t generation = generation_of(b.life.load(std::memory_order_relaxed));
      h.store(base | hold::kPointer | hold::tag_of(generation),
              std::memory_order_relaxed);  // as above
    } else {
      h.store(base | (v & hold::kTagMask), std::memory_order_release);  // O4
    }
    P::passed();
    return dead;
  }
  bool reclaim(Words& b, Hold& h, std::uint64_t expected) const {
    return reclaim(b, h, expected, [] { return false; });
  }

  /// Claims a free block for this process alone, with one pointer hold. False: it is not free.
  ///
  /// Crash: killed after the claim: the reaper gives the block to the orphanage, which frees it.
  bool claim(Words& b, Hold& h) const {
    std::uint32_t free = kHomeFree;
    if (b.home.load(std::memory_order_relaxed) != kHomeFree ||
        !b.home.compare_exchange_strong(free, self + 1, std::memory_order_acquire,
                                        std::memory_order_relaxed)) {  // O3
      return false;
    }
    // Relaxed: O3 carries it.
    const std::uint64_t generation = generation_of(b.life.load(std::memory_order_relaxed));
    const std::uint64_t mine = hold::kHome | hold::kHeld | hold::kPointer |
                               hold::tag_of(static_cast<std::uint32_t>(generation));
    std::uint64_t none = 0;
    // Another thread's weak lock or last release may have the word busy for a moment.
    while (!h.compare_exchange_weak(none, mine, std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O4
      if ((none & hold::kBusy) != 0) none = await_idle(h, none);
      if (none != 0) {  // this process holds it: another process has overwritten `home`
        P::damage_seen();
        b.home.store(kHomeFree, std::memory_order_release);  // O3
        return false;
      }
    }
    // Relaxed, both: no other process has the block yet.
    own(b).fetch_or(own_bit_, std::memory_order_relaxed);
    b.home_points.store(0, std::memory_order_relaxed);  // see above
    return true;
  }

  /// Sets an exclusively owned block free for all participants. The name goes last (I4).
  void give_back(Words& b, Hold& h) const {
    own(b).fetch_and(~own_bit_, std::memory_order_relaxed);  // O3 carries it
    h.store(0, std::memory_order_release);                   // O4
    b.home.store(kHomeFree, std::memory_order_release);      // O3
  }

  // What a reaper does. REQUIRES, in all of them: byte lock 0, and byte lock k where k is dead.

  /// Makes the orphanage a holder. REQUIRES: a participant still holds the block.
  static void adopt(Words& b) {
    b.own[0].fetch_or(1, std::memory_order_relaxed);        // O2 carries it
    b.life.fetch_add(kVersion, std::memory_order_release);  // O2: adopting is a hand-over too
  }

  /// Makes the orphanage the home of a block that was at home in a dead participant.
  static void move_to_orphanage(Words& b) {
    b.home_points.store(0, std::memory_order_relaxed);        // for use_count() only
    b.home.store(kHomeOrphanage, std::memory_order_relaxed);  // byte lock 0
  }

  /// Takes a block from the dead participant k, or from the orphanage, if it holds the block.
  static void let_go(Words& b, std::uint32_t k) {
    auto& own = word(b, k);
    if ((own.load(std::memory_order_relaxed) & bit(k)) != 0) {  // byte lock k
      own.fetch_and(~bit(k), std::memory_order_release);        // O1
    }
  }

  /// Sets a dead block of the orphanage free for all participants. REQUIRES: its extents are free.
  static void free_orphan(Words& b) { b.home.store(kHomeFree, std::memory_order_release); }  // O3

 private:
  auto& own(Words& b) const { return b.own[own_word_]; }

  static bool is_only_pointer_at_home(std::uint64_t v) {
    return (v & hold::kHome) != 0 && hold::pointers(v) == 1;
  }
  /// `v`: the hold word to which a pointer was added.
  static void note_first_pointer(Words& b, std::uint64_t v) {
    if ((v & hold::kHome) != 0 && hold::pointers(v) == 0) {
      b.home_points.store(1, std::memory_order_relaxed);  // O6 carries it
    }
  }

  /// By ownership word: the bits that count.
  using Masks = std::array<std::uint64_t, P::kOwnWords>;
  static constexpr Masks all() {
    Masks masks{};
    for (auto& mask : masks) mask = ~std::uint64_t{0};
    return masks;
  }
  static constexpr Masks kAll = all();

  static bool die(Words& b, const Masks& count, std::uint64_t& seen) {
    std::uint64_t life = b.life.load(std::memory_order_acquire);  // O2
    const std::uint64_t holders = look(b, count, std::make_index_sequence<P::kOwnWords>{});
    seen |= holders & kWanted;
    // The compare-and-swap fails if a process has bumped the version since the load. So the load
    // has acquired every bump, and the compare-and-swap may be relaxed. Killed after it: the block
    // is exclusively owned and unpublished, and the reaper frees it.
    return (holders & ~kWanted) == 0 &&
           b.life.compare_exchange_strong(life, next_generation(life), std::memory_order_relaxed,
                                          std::memory_order_relaxed);
  }
  /// The bits that count, of all words together. It has no loop: each instruction between two
  /// locked ones costs.
  template <std::size_t... W>
  static std::uint64_t look(const Words& b, const Masks& count, std::index_sequence<W...>) {
    std::uint64_t bits = 0;
    ((bits |= b.own[W].load(std::memory_order_acquire) & count[W]), ...);  // O1
    return bits;
  }

  /// The home has found that others hold the block: asks them to tell it when they let go. True:
  /// they have let go meanwhile, and the message has died.
  template <class Note>
  [[gnu::noinline]] bool await_holders(Words& b, std::uint64_t& seen, Note& note_waiting) const {
    if (ask_holders(b, note_waiting())) return false;
    // A holder may have let go before it was asked. So the home looks again, and twice. The first
    // look may fail only because such a holder has bumped the version. Its scan then has seen
    // that holder's bit gone, and with it the version. So the second look knows that version.
    return die(b, seen) || die(b, seen);
  }

  /// Clears the own bit. REQUIRES: the busy bit, and not at home.
  Left clear_own_bit(Words& b, Hold& h) const {
    own(b).fetch_and(~own_bit_, std::memory_order_release);  // O1
    // A second look is cheaper than the old value of the fetch_and, for which x86 has no single
    // instruction. It sees kWanted if the home set it before this bit was cleared, unless the home
    // has cleared kWanted since.
    const bool wanted = (own(b).load(std::memory_order_acquire) & kWanted) != 0;  // O5
    h.store(0, std::memory_order_release);                                        // O4
    P::passed();
    return wanted ? Left::Wanted : Left::Gone;
  }

  /// Asks all holders, also later ones, to tell the home when they let go. True when they had been
  /// asked before, and will tell it. `anew`: asks again even so, since the warden that they told
  /// may have looked before the block was noted.
  ///
  /// It changes each word and does not only read it. So a look after that change cannot find a bit
  /// that was cleared before it.
  static bool ask_holders(Words& b, bool anew) {
    bool asked = true;
    for (auto& own : b.own) {
      // Relaxed: the home itself sets and clears kWanted.
      if (!anew && (own.load(std::memory_order_relaxed) & kWanted) != 0) continue;
      own.fetch_or(kWanted, std::memory_order_release);  // O5
      asked = false;
    }
    return asked;
  }
  /// Clears kWanted. All is relaxed: the block is exclusively the caller's, and a bit that the next
  /// home finds costs only a needless errand.
  [[gnu::noinline]] static void ask_nobody(Words& b) {
    for (auto& own : b.own) {
      if ((own.load(std::memory_order_relaxed) & kWanted) != 0) {  // relaxed as said above
        own.fetch_and(~kWanted, std::memory_order_relaxed);        // relaxed as said above
      }
    }
  }

  static std::uint64_t busy(std::uint64_t v) { return hold::busy_word(v, P::this_thread()); }

  /// Waits until the word is not busy. Returns the hold word. The other thread has only a few
  /// instructions left; P::Patience makes sure that it gets to run.
  [[gnu::noinline]] static std::uint64_t await_idle(Hold& h, std::uint64_t v) {
    typename P::Patience patience;
    do {
      patience.wait(hold::busy_thread(v));
      v = h.load(std::memory_order_relaxed);  // the caller's compare-and-swap checks and acquires
    } while ((v & hold::kBusy) != 0);
    return v;
  }

  // All follow from `self`. They are kept, since each instruction between two locked ones costs.
  std::uint32_t own_word_ = 0;
  std::uint64_t own_bit_ = bit(0);
  Masks others_ = kAll;  ///< all bits but the own one
};

}  // namespace lot::refcount
