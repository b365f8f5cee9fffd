// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

#include "segment/granules.hpp"

/// Which memory the file system has given, in units of some hundred granules, a word each:
///
///   0        none: what is written there may be a SIGBUS
///   1        leaving: a process gives it back, or was killed while it did
///   2        unsure: a process has asked for it, or was killed while it did
///   3 + age  all of it; so many looks in a row have found no granule of it in use
///   all ones all of it, for ever
///
/// A word becomes 3 or more only by a process that has a granule of the unit, and less only by one
/// that has all of them. So the two exclude each other by the granules' tags, and what has been
/// claimed since a unit was found unused is not taken away.
///
/// Progress: lock-free, but for what the file system does.
/// Edges
///   B1  unit = 3 in get (release) -> load in get (acquire)
///       carries: the file system has given the memory.
///   G1  (granules.hpp) carries 0 from give_back to the next one that has a granule of the unit.
/// Crash: killed behind 1 or 2: the next process that has a granule of the unit gets the memory
///        once more, or the next look gives it back.
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

  /// The units first to last have their memory: ask(unit) asks the file system for one's, where it
  /// has not given that yet. False: it has none. REQUIRES: the caller has a granule of each.
  template <class Ask>
  bool get(std::uint32_t first, std::uint32_t last, Ask&& ask) {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      std::uint32_t said = words_[unit].load(std::memory_order_acquire);  // B1
      if (said < kGiven) {
        if (!attempt(unit, ask)) return false;
        said = words_[unit].load(std::memory_order_relaxed);
      }
      while (said != kGiven && said != kForEver &&
             !words_[unit].compare_exchange_weak(said, kGiven, std::memory_order_release,
                                                 std::memory_order_relaxed)) {  // B1
      }
    }
    return true;
  }
  /// The same for a caller that has no granule of them: it learns whether there is memory, and no
  /// other process does.
  template <class Ask>
  bool try_get(std::uint32_t first, std::uint32_t last, Ask&& ask) {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      if (!has(unit, unit) && !attempt(unit, ask)) return false;
    }
    return true;
  }
  /// The units' memory never goes back: it is read by processes that have no granule of it.
  /// REQUIRES: get(), and the caller has a granule of each.
  void keep(std::uint32_t first, std::uint32_t last) {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      words_[unit].exchange(kForEver, std::memory_order_relaxed);  // so that B1 is carried on
    }
  }
  /// A hint, as is_old(): the process that claims there calls get().
  bool has(std::uint32_t first, std::uint32_t last) const {
    for (std::uint32_t unit = first; unit <= last; ++unit) {
      if (words_[unit].load(std::memory_order_relaxed) < kGiven) return false;
    }
    return true;
  }

  /// One look: is_used(unit) says whether a granule of it is in use. Relaxed, as all looks: the
  /// process that acts on it has the granules.
  template <class Used>
  void look(std::uint32_t unit, Used&& is_used) {
    std::uint32_t said = words_[unit].load(std::memory_order_relaxed);
    if (said < kGiven || said >= kOldest) return;
    const std::uint32_t now = is_used(unit) ? kGiven : said + 1;
    // What has changed meanwhile is newer.
    if (now != said) {
      words_[unit].compare_exchange_strong(said, now, std::memory_order_relaxed,
                                           std::memory_order_relaxed);
    }
  }
  /// So many looks have found it unused, or it is not known what became of it.
  bool is_old(std::uint32_t unit, std::uint32_t looks) const {
    const std::uint32_t said = words_[unit].load(std::memory_order_relaxed);
    if (said < kGiven) return said != kNone;
    return said != kForEver && said - kGiven >= looks;
  }

  /// Gives the memory of a unit back by punch(), unless it is in use, or was since is_old(). Its
  /// granules are `run` from `first` on; they carry `tag` meanwhile. False: it is in use, or the
  /// file system refuses; then ask(unit) sees to that it has what it had.
  ///
  /// Crash: killed anywhere in it, the granules carry the tag or none; the unit is leaving, or as
  ///        before.
  template <class Punch, class Ask>
  bool give_back(std::uint32_t unit, std::uint32_t looks, Granules<P>& granules,
                 std::uint32_t first, std::uint32_t run, std::uint32_t tag, Punch&& punch,
                 Ask&& ask) {
    if (!granules.extend(first, run, tag)) return false;
    bool gone = false;
    if (is_old(unit, looks)) {
      words_[unit].store(kLeaving, std::memory_order_relaxed);
      gone = punch();
      if (gone) {
        // One that asks meanwhile makes it unsure. G1 carries it.
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

  /// Said before, for one that is killed, and after: another process may have given back meanwhile
  /// what was there before.
  template <class Ask>
  bool attempt(std::uint32_t unit, Ask&& ask) {
    note_attempt(unit);
    const bool given = ask(unit);
    note_attempt(unit);
    return given;
  }
  void note_attempt(std::uint32_t unit) {
    std::uint32_t said = words_[unit].load(std::memory_order_relaxed);
    while (said < kUnsure &&
           !words_[unit].compare_exchange_weak(said, kUnsure, std::memory_order_relaxed,
                                               std::memory_order_relaxed)) {
    }
  }

  Word* words_ = nullptr;
  std::uint32_t count_ = 0;
};

}  // namespace lot::segment
