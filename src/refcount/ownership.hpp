// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "lot/detail/hold_word.hpp"

/// Robust ownership of blocks: who holds which block is said by one bit per participant, never by a
/// counter, so that a reaper repairs a death by clearing a bit.
///
/// Invariants
///   I1  A block in a ring, or overwritten but possibly still borrowed from that ring, is held by
///       that ring's owner. Hazards are the ring owner's business only.
///   I2  The home's own bit stands from alloc to give_back; at home only the hold word counts.
///   I3  A hold moves as "set the new bit, bump life, then clear the old one".
///   I4  The word that names the dead is erased after everything that it lets a reaper find is
///   done.
///
/// Edges
///   O1  clearing an own bit (release)         -> own scan in die() (acquire)
///       carries: "the holder has read all that it wanted to".
///   O2  life bump in acquire() (release)      -> life load in die() (acquire)
///       carries: the new own bit: whoever sees the bump sees the bit.
///   O3  home = 0 in give_back (release)       -> home claim in claim() (acquire)
///       carries: cleared bits and released extents.
///   O5  kWanted set in reclaim() (release)    -> own bit cleared in the same word by let_go() or
///       acquire_weak() (acquire)
///       carries: with E1, back to the home, what note_waiting() noted. Of two changes of one word
///       one is the later: the holder finds kWanted, or the home does not find the holder.
///   O4  hold word, edge released (release)    -> edge taken (acquire)
///       carries: the own bit, between threads of one process.
namespace lot::refcount {

namespace hold = detail::hold;

/// The shared words of one block, on a line of their own.
template <class P>
struct alignas(P::kLine) BlockWords {
  template <class T>
  using Atomic = typename P::template Atomic<T>;

  /// P::kBitsPerWord bits a word. Bit p: participant p holds the block. Bit 0: the orphanage does.
  /// Written by p, by p's reaper, and bit 0 by whoever has byte lock 0. Beside them kWanted.
  Atomic<std::uint64_t> own[P::kOwnWords];
  /// {version : 32 | generation : 32}. The version is bumped by each hand-over; the generation ends
  /// a message: its death is one compare-and-swap on this word.
  Atomic<std::uint64_t> life;
  /// 0: free; p + 1: participant p owns the memory; 1: the orphanage does.
  Atomic<std::uint32_t> home;
  /// 1 while pointers in the home process hold the block. Written by home, for use_count() of
  /// others.
  Atomic<std::uint32_t> home_points;
};

/// A bit of each ownership word: the home has looked in vain and wants to be told when a holder of
/// that word lets go. Set by home in reclaim() and cleared with the message's death; each process
/// that clears its own bit hears of it. Stale for a block that has got another home: that one is
/// told for nothing.
inline constexpr std::uint64_t kWanted = std::uint64_t{1} << 63;

/// What became of a hold that was let go.
enum class Left {
  Held,   ///< this process has more
  Home,   ///< it was the last one, and the block is at home here: the caller tries reclaim()
  Gone,   ///< it was the last one, elsewhere
  Wanted  ///< the same, and the home waits for it: the caller tells the home
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

/// The steps that one participant does on blocks. Each takes the block's shared words and, where
/// the participant itself is meant, its private hold word.
///
/// Threads: all may be called at once on the same block by threads of one process.
template <class P>
struct Ownership {
  using Hold = typename P::template Atomic<std::uint64_t>;
  using Words = BlockWords<P>;
  static_assert(P::kBitsPerWord < 64, "the last bit is kWanted");

  Ownership() = default;
  explicit Ownership(std::uint32_t participant)
      : self(participant), own_word_(participant / P::kBitsPerWord), own_bit_(bit(participant)) {}

  std::uint32_t self = 0;

  static std::uint64_t bit(std::uint32_t p) { return std::uint64_t{1} << (p % P::kBitsPerWord); }
  static auto& word(Words& b, std::uint32_t p) { return b.own[p / P::kBitsPerWord]; }
  /// The holders of a block in its ownership word `w`, without participant `except`.
  static std::uint64_t holders(std::uint64_t own, std::uint32_t w, std::uint32_t except) {
    return own & ~kWanted & ~(w == except / P::kBitsPerWord ? bit(except) : 0);
  }

  /// Adds `amount` (hold::kPointer or hold::kRing) to our holds. REQUIRES: the caller protects the
  /// block by a hazard, a cursor or another hold.
  ///
  /// Crash: killed between bit and bump, or after: the reaper clears the bit.
  void acquire(Words& b, Hold& h, std::uint64_t amount) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);
    for (;;) {
      if ((v & hold::kEdge) != 0) {
        v = await_edge(h, v);
      } else if ((v & hold::kHeld) != 0) {  // the bit stands and has stood all the time
        if (h.compare_exchange_weak(v, v + amount, std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O4
          return;
        }
      } else if (h.compare_exchange_weak(v, edge(v), std::memory_order_acquire,
                                         std::memory_order_relaxed)) {  // O4
        own(b).fetch_or(own_bit_, std::memory_order_relaxed);
        b.life.fetch_add(kVersion, std::memory_order_release);     // O2
        h.store(hold::kHeld | amount, std::memory_order_release);  // O4
        P::passed();
        return;
      }
    }
  }

  /// Adds a pointer hold if the block still carries that generation: Held. Else the message has
  /// died: Gone, or Wanted. The caller protects nothing.
  Left acquire_weak(Words& b, Hold& h, std::uint32_t generation) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);
    for (;;) {
      if ((v & hold::kEdge) != 0) {
        v = await_edge(h, v);
      } else if ((v & hold::kHome) != 0) {
        // The tag in the hold word makes the compare-and-swap fail if the message dies meanwhile.
        // Relaxed: who has a weak pointer has seen the message.
        if ((v & hold::kTagMask) != hold::tag_of(generation) ||
            generation_of(b.life.load(std::memory_order_relaxed)) != generation) {
          return Left::Gone;
        }
        if (h.compare_exchange_weak(v, v + hold::kPointer, std::memory_order_relaxed,
                                    std::memory_order_relaxed)) {
          return Left::Held;
        }
      } else if ((v & hold::kHeld) != 0) {
        if (!h.compare_exchange_weak(v, v + hold::kPointer, std::memory_order_acquire,
                                     std::memory_order_relaxed)) {  // O4
          continue;
        }
        // Relaxed: at least as new as when our bit was set (O4), and it has not died since.
        if (generation_of(b.life.load(std::memory_order_relaxed)) == generation) return Left::Held;
        return release(b, h, hold::kPointer) == Left::Wanted ? Left::Wanted : Left::Gone;
      } else if (h.compare_exchange_weak(v, edge(v), std::memory_order_acquire,
                                         std::memory_order_relaxed)) {  // O4
        own(b).fetch_or(own_bit_, std::memory_order_relaxed);
        const std::uint64_t old = b.life.fetch_add(kVersion, std::memory_order_release);  // O2
        if (generation_of(old) != generation) return let_go(b, h);
        h.store(hold::kHeld | hold::kPointer, std::memory_order_release);  // O4
        P::passed();
        return Left::Held;
      }
    }
  }

  /// Takes `amount` from our holds. Elsewhere than at home the last release clears our bit.
  ///
  /// Crash: killed before the caller tells the home, it leaves a message that nobody holds; the
  /// home looks by itself, once a second.
  Left release(Words& b, Hold& h, std::uint64_t amount) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);
    for (;;) {
      const bool last = (v & hold::kHolds) == amount;
      if (last && (v & (hold::kHome | hold::kEdge)) == 0) {
        // The last hold becomes the edge in one step, so that no other thread comes in between.
        if (h.compare_exchange_weak(v, edge(v), std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O4
          return let_go(b, h);
        }
      } else if (h.compare_exchange_weak(v, v - amount, std::memory_order_release,
                                         std::memory_order_relaxed)) {  // O4
        // Only release: the thread that goes on takes the edge, and with it acquires.
        return last && (v & hold::kHome) != 0 ? Left::Home : Left::Held;
      }
    }
  }

  /// The death of a message: only the home holds the block (of the orphanage not even that one),
  /// and nobody can have taken a hold meanwhile. `seen`: all bits of the words that were looked at.
  /// REQUIRES: at home under the edge, or byte lock 0.
  bool die(Words& b, std::uint64_t& seen) const { return die(b, own_word_, own_bit_, seen); }
  static bool die_in_orphanage(Words& b) {
    std::uint64_t seen = 0;
    if (!die(b, 0, 0, seen)) return false;
    if ((seen & kWanted) != 0) ask_nobody(b);
    return true;
  }

  /// Home only: makes a block whose holds here equal `expected` (0, or the one ring hold that the
  /// caller gives up) exclusively ours again, with one pointer hold. False: others still hold it,
  /// and `expected` is given up all the same.
  ///
  /// `note_waiting()` is called after the home has seen that it must wait, and before other
  /// processes can see that it does. It notes the block where the home's warden will find it. It
  /// returns false when the block was noted before.
  template <class Note>
  bool reclaim(Words& b, Hold& h, std::uint64_t expected, Note&& note_waiting) const {
    std::uint64_t v = h.load(std::memory_order_relaxed);
    for (;;) {
      if ((v & hold::kEdge) != 0) {
        v = await_edge(h, v);
        continue;
      }
      // Late: another thread took a hold, let it go and has given the block back meanwhile.
      if ((v & hold::kHome) == 0) return false;
      if ((v & hold::kHolds) != expected) {  // more holds here
        if (expected == 0) return false;
        if (h.compare_exchange_weak(v, v - expected, std::memory_order_release,
                                    std::memory_order_relaxed)) {  // O4
          return false;
        }
        continue;
      }
      if (h.compare_exchange_weak(v, edge(v), std::memory_order_acquire,
                                  std::memory_order_relaxed)) {  // O4
        break;
      }
    }
    std::uint64_t seen = 0;
    bool dead = die(b, seen);
    if (!dead && !ask_holders(b, note_waiting())) {
      // A holder may have let go before it was asked. Twice: the first one may fail by the version
      // alone, of such a holder. Its scan has seen that one's bit go, and with it the version: the
      // second one knows it.
      dead = die(b, seen) || die(b, seen);
    }
    if (dead && (seen & kWanted) != 0) ask_nobody(b);
    const std::uint64_t base = hold::kHome | hold::kHeld;
    if (dead) {
      const std::uint32_t generation = generation_of(b.life.load(std::memory_order_relaxed));
      // Relaxed: it is only ours, and who gets it from us has it in other ways.
      h.store(base | hold::kPointer | hold::tag_of(generation), std::memory_order_relaxed);
    } else {
      h.store(base | (v & hold::kTagMask), std::memory_order_release);  // O4
    }
    P::passed();
    return dead;
  }
  bool reclaim(Words& b, Hold& h, std::uint64_t expected) const {
    return reclaim(b, h, expected, [] { return false; });
  }

  /// Claims a free block for this process: exclusively ours, one pointer hold. False: not free.
  ///
  /// Crash: killed after the claim: the reaper makes it the orphanage's, which frees it.
  bool claim(Words& b, Hold& h) const {
    std::uint32_t free = kHomeFree;
    if (b.home.load(std::memory_order_relaxed) != kHomeFree ||
        !b.home.compare_exchange_strong(free, self + 1, std::memory_order_acquire,
                                        std::memory_order_relaxed)) {  // O3
      return false;
    }
    const std::uint64_t generation = generation_of(b.life.load(std::memory_order_relaxed));
    const std::uint64_t mine = hold::kHome | hold::kHeld | hold::kPointer |
                               hold::tag_of(static_cast<std::uint32_t>(generation));
    std::uint64_t none = 0;
    // A weak lock or a last release of another thread may have the edge for a moment.
    while (!h.compare_exchange_weak(none, mine, std::memory_order_acquire,
                                    std::memory_order_relaxed)) {  // O4
      if ((none & hold::kEdge) != 0) none = await_edge(h, none);
      if (none != 0) {  // held here: another process has overwritten `home`
        P::damage_seen();
        b.home.store(kHomeFree, std::memory_order_release);  // O3
        return false;
      }
    }
    own(b).fetch_or(own_bit_, std::memory_order_relaxed);
    return true;
  }

  /// Gives an exclusively owned block back to everybody. The name goes last.
  void give_back(Words& b, Hold& h) const {
    own(b).fetch_and(~own_bit_, std::memory_order_relaxed);  // O3 carries it
    h.store(0, std::memory_order_release);                   // O4
    b.home.store(kHomeFree, std::memory_order_release);      // O3
  }

  /// Makes the orphanage a holder. REQUIRES: byte lock 0; somebody still holds the block.
  static void adopt(Words& b) {
    b.own[0].fetch_or(1, std::memory_order_relaxed);
    b.life.fetch_add(kVersion, std::memory_order_release);  // O2: adopting is a hand-over too
  }

 private:
  auto& own(Words& b) const { return b.own[own_word_]; }

  static bool die(Words& b, std::uint32_t except_word, std::uint64_t except, std::uint64_t& seen) {
    std::uint64_t life = b.life.load(std::memory_order_acquire);  // O2
    std::uint64_t others = 0;
    for (std::uint32_t w = 0; w < P::kOwnWords; ++w) {
      const std::uint64_t own = b.own[w].load(std::memory_order_acquire);  // O1
      seen |= own;
      others |= w == except_word ? own & ~except : own;
    }
    // The second fails if a process bumped the version since it was read; so the load has acquired
    // all there is. Killed after it: an exclusively owned, unpublished block, which the reaper
    // frees.
    return (others & ~kWanted) == 0 &&
           b.life.compare_exchange_strong(life, next_generation(life), std::memory_order_relaxed,
                                          std::memory_order_relaxed);
  }

  /// Clears our bit. REQUIRES: the edge, and not at home.
  Left let_go(Words& b, Hold& h) const {
    own(b).fetch_and(~own_bit_, std::memory_order_release);  // O1
    // A second look is cheaper than the answer of the first one, for which x86 has no instruction.
    // It sees kWanted if that came before our change, unless the home has cleared it since.
    const bool wanted = (own(b).load(std::memory_order_acquire) & kWanted) != 0;  // O5
    h.store(0, std::memory_order_release);                                        // O4
    P::passed();
    return wanted ? Left::Wanted : Left::Gone;
  }

  /// Asks all holders, those to come too, to tell the home when they let go. True when they were
  /// asked before, and will do so. `anew`: that is not enough, since the warden that they tell may
  /// have looked before the block was noted.
  ///
  /// Each word is changed, and not only read: so no look behind it finds a bit that went before.
  static bool ask_holders(Words& b, bool anew) {
    bool asked = true;
    for (auto& own : b.own) {
      if (!anew && (own.load(std::memory_order_relaxed) & kWanted) != 0) continue;
      own.fetch_or(kWanted, std::memory_order_release);  // O5
      asked = false;
    }
    return asked;
  }
  /// Relaxed: the block is exclusively ours. Whether the next home finds a bit does not matter.
  static void ask_nobody(Words& b) {
    for (auto& own : b.own) {
      if ((own.load(std::memory_order_relaxed) & kWanted) != 0) {
        own.fetch_and(~kWanted, std::memory_order_relaxed);
      }
    }
  }

  static std::uint64_t edge(std::uint64_t v) { return hold::edge_of(v, P::this_thread()); }

  /// Waits until no thread has the edge; returns the hold word. That takes the few instructions
  /// that the other thread still has: P::Patience sees to it that this thread runs.
  static std::uint64_t await_edge(Hold& h, std::uint64_t v) {
    typename P::Patience patience;
    do {
      patience.wait(hold::edge_thread(v));
      v = h.load(std::memory_order_relaxed);
    } while ((v & hold::kEdge) != 0);
    return v;
  }

  std::uint32_t own_word_ = 0;      ///< of self; both are ready, since each step between two locked
  std::uint64_t own_bit_ = bit(0);  ///< operations costs
};

}  // namespace lot::refcount
