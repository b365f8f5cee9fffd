// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "segment/granules.hpp"

/// Says which memory the file system has given, in units of some hundred granules. Each unit has a
/// word:
///
///   0        none: a write there may be a SIGBUS
///   1        leaving: a process gives the memory back, or was killed while it did
///   2        unsure: a process has asked for the memory, or was killed while it did
///   3 + age  all of it; `age` looks in a row have found no granule of the unit in use
///   all ones all of it, for ever
///
/// Only a process that has a granule of the unit changes the word to 3 or more. Only a process that
/// has all granules of the unit changes it to less. So the granules' tags exclude one from the
/// other. Memory that was claimed after a look had found the unit unused is not taken away.
///
/// Progress: lock-free, except for what the file system does.
///
/// Edges
///   B1  unit = 3 in get (release) -> load in get (acquire)
///       carries: the file system has given the memory.
///   G1  (granules.hpp) carries 0 from give_back to the next process that has a granule of the
///   unit.
///
/// Crash: killed after it has stored 1 or 2: the next process that has a granule of the unit asks
///        for the memory once more, or the next look gives it back.
namespace lot::segment {

template <class P>
class Units {
 public:
  using Word = typename P::template Atomic<std::uint32_t>;

  Units() = default;
  Units(Word* words, std::uint32_t count) { reset(words, count); }

  void reset(Word* words, std::uint32_t count) {
    words_ = words;
    count_ = count;
  }
  std::uint32_t count() const { return count_; }

  /// Makes sure that the units from first to last have their memory. Calls ask(unit), which asks
  /// the file system, where it has not given the memory yet. False: the file system has none.
  /// REQUIRES: the caller has a granule of each unit.
  template <class Ask>
  bool get(std::uint32_t first, std::uint32_t last, Ask&& ask) {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      std::uint32_t said = words_[unit].load(std::memory_order_acquire);  // B1
      if (said < kGiven) {
        if (!attempt(unit, ask)) return false;
        said = words_[unit].load(std::memory_order_relaxed);  // this process has just asked itself
      }
      while (said != kGiven && said != kForEver &&
             !words_[unit].compare_exchange_weak(said, kGiven, std::memory_order_release,
                                                 std::memory_order_relaxed)) {  // B1
      }
    }
    return true;
  }
  /// As get(), for a caller that has no granule of the units. Only this caller learns whether there
  /// is memory: the words do not say so.
  template <class Ask>
  bool try_get(std::uint32_t first, std::uint32_t last, Ask&& ask) {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      if (!has(unit, unit) && !attempt(unit, ask)) return false;
    }
    return true;
  }
  /// The units' memory never goes back: processes that have no granule of it read it. REQUIRES:
  /// get(); the caller has a granule of each unit.
  void keep(std::uint32_t first, std::uint32_t last) {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      // An exchange, which continues the release sequence of B1.
      words_[unit].exchange(kForEver, std::memory_order_relaxed);
    }
  }
  /// True when the units have their memory: a hint, as is_old(). A process that claims there calls
  /// get().
  bool has(std::uint32_t first, std::uint32_t last) const {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      if (words_[unit].load(std::memory_order_relaxed) < kGiven) return false;  // a hint
    }
    return true;
  }

  /// One look at a unit. is_used(unit) says whether a granule of it is in use. Relaxed, as all
  /// looks: the process that acts on the result has the granules.
  template <class Used>
  void look(std::uint32_t unit, Used&& is_used) {
    std::uint32_t said = words_[unit].load(std::memory_order_relaxed);  // a look
    if (said < kGiven || said >= kOldest) return;
    const std::uint32_t now = is_used(unit) ? kGiven : said + 1;
    // If the word has changed meanwhile, it stays: it is newer. Relaxed: a look.
    if (now != said) {
      words_[unit].compare_exchange_strong(said, now, std::memory_order_relaxed,
                                           std::memory_order_relaxed);
    }
  }
  /// True when `looks` looks have found the unit unused, or when its word is leaving or unsure.
  bool is_old(std::uint32_t unit, std::uint32_t looks) const {
    const std::uint32_t said = words_[unit].load(std::memory_order_relaxed);  // a look
    if (said < kGiven) return said != kNone;
    return said != kForEver && said - kGiven >= looks;
  }

  /// Gives the memory of a unit back by punch(), unless the unit is in use, or was used since
  /// is_old(). Its granules are the `run` ones from `first` on. They carry `tag` meanwhile. False:
  /// the unit is in use, or the file system refuses. If it refuses, ask(unit) makes sure that the
  /// unit has its memory again.
  ///
  /// Crash: killed at any step, the granules carry the tag or none. The unit's word is leaving, or
  ///        as before.
  template <class Punch, class Ask>
  bool give_back(std::uint32_t unit, std::uint32_t looks, Granules<P>& granules,
                 std::uint32_t first, std::uint32_t run, std::uint32_t tag, Punch&& punch,
                 Ask&& ask) {
    if (!granules.extend(first, run, tag)) return false;
    bool gone = false;
    if (is_old(unit, looks)) {
      words_[unit].store(kLeaving, std::memory_order_relaxed);  // G1 carries it
      gone = punch();
      if (gone) {
        // A process that asks meanwhile makes the word unsure: then it stays. Relaxed: G1 carries
        // it.
        std::uint32_t leaving = kLeaving;
        words_[unit].compare_exchange_strong(leaving, kNone, std::memory_order_relaxed,
                                             std::memory_order_relaxed);
      } else if (ask(unit)) {
        words_[unit].store(kGiven, std::memory_order_relaxed);  // G1 carries it
      }
    }
    granules.put_back(first, run);
    return gone;
  }

 private:
  static constexpr std::uint32_t kNone = 0;
  static constexpr std::uint32_t kLeaving = 1;
  static constexpr std::uint32_t kUnsure = 2;
  static constexpr std::uint32_t kGiven = 3;
  static constexpr std::uint32_t kForEver = ~std::uint32_t{0};
  static constexpr std::uint32_t kOldest = kForEver - 1;

  /// Notes the attempt before it asks, for the case that it is killed, and once more afterwards:
  /// another process may have stored 0 meanwhile, for the memory that was there before.
  template <class Ask>
  bool attempt(std::uint32_t unit, Ask&& ask) {
    note_attempt(unit);
    const bool given = ask(unit);
    note_attempt(unit);
    return given;
  }
  /// Relaxed: an unsure word carries nothing. A process with a granule of the unit asks itself.
  void note_attempt(std::uint32_t unit) {
    std::uint32_t said = words_[unit].load(std::memory_order_relaxed);  // the next step checks it
    // Relaxed: as said above.
    while (said < kUnsure &&
           !words_[unit].compare_exchange_weak(said, kUnsure, std::memory_order_relaxed,
                                               std::memory_order_relaxed)) {
    }
  }

  Word* words_ = nullptr;
  std::uint32_t count_ = 0;
};

}  // namespace lot::segment
