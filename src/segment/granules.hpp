// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstdint>

/// The pool of message memory: granules of 4 KiB, handed out in runs of any number, first fit.
///
/// Each granule's tag names its owner, and no other word says so. There are no free lists and no
/// tree to split and join. A run is free when its tags are 0. What a dead process owned is found by
/// its tags.
///
/// Progress: claim() is lock-free. A claim goes upwards, and is undone when it finds a granule
///           taken. So of the claims that collide, the one that has come furthest up succeeds.
///
/// Edges
///   G1  tag = 0 in release (release) -> tag compare-and-swap in claim (acquire)
///       carries: "the old owner and all its readers are done with the memory".
///
/// Crash: killed while claiming: the granules carry the tag of a block or ring whose home is dead.
///        They are freed with it.
namespace lot::segment {

template <class P>
class Granules {
 public:
  using Tag = typename P::template Atomic<std::uint32_t>;
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};

  Granules() = default;
  Granules(Tag* tags, std::uint32_t count) { reset(tags, count); }

  void reset(Tag* tags, std::uint32_t count) {
    tags_ = tags;
    count_ = count;
  }

  /// Claims a run of `run` granules, which then carries `tag`. kNone: there is no such run. Looks
  /// for small runs from the low end and for large ones from the high end, which keeps them apart.
  std::uint32_t claim(std::uint32_t run, std::uint32_t tag) {
    return claim(run, tag, [](std::uint32_t) { return true; });
  }
  /// The same, among the runs that may(first) allows.
  template <class May>
  std::uint32_t claim(std::uint32_t run, std::uint32_t tag, May&& may) {
    if (run == 0 || run > count_) return kNone;
    const std::uint32_t places = count_ - run + 1;
    Tag& hint = hint_[size_class(run)];
    const std::uint32_t begin = hint.load(std::memory_order_relaxed);  // a hint
    std::uint32_t first = kNone;
    if (run < kLarge) {
      const std::uint32_t from = std::min(begin, places - 1);
      first = seek_up(from, places, run, tag, may);
      if (first == kNone) first = seek_up(0, from, run, tag, may);
    } else {
      const std::uint32_t from = std::min(~begin, places - 1);
      first = seek_down(0, from + 1, run, tag, may);
      if (first == kNone) first = seek_down(from + 1, places, run, tag, may);
    }
    // Relaxed: a hint.
    if (first != kNone) hint.store(run < kLarge ? first : ~first, std::memory_order_relaxed);
    return first;
  }

  /// Claims `run` granules behind a run that the caller has. They then carry `tag`. False: one of
  /// them is in use.
  bool extend(std::uint32_t end, std::uint32_t run, std::uint32_t tag) {
    return run != 0 && end <= count_ && run <= count_ - end && take(end, run, tag);
  }

  /// Releases a run. Releases nothing if there can be no such run: then a wild write has hit the
  /// word that noted it.
  void release(std::uint32_t first, std::uint32_t run) {
    if (run == 0 || first >= count_ || run > count_ - first) return;
    put_back(first, run);
    for (unsigned c = 0; c < static_cast<unsigned>(std::bit_width(count_)); ++c) {
      // A run that begins before this one may be free now, if it ends in this one.
      const std::uint32_t longest = (2U << c) - 1;
      const std::uint32_t place = (1U << c) < kLarge ? first - std::min(first, longest - 1)  //
                                                     : ~(first + run - 1);
      if (hint_[c].load(std::memory_order_relaxed) > place) {  // a hint
        hint_[c].store(place, std::memory_order_relaxed);      // a hint
      }
    }
  }

  /// As release(), for granules that were free shortly before: the hints stay as they are.
  /// REQUIRES: there is such a run.
  void put_back(std::uint32_t first, std::uint32_t run) {
    for (std::uint32_t i = 0; i < run; ++i) {
      tags_[first + i].store(0, std::memory_order_release);  // G1
    }
  }

  /// Releases every granule for whose tag dead(tag) is true.
  template <class Dead>
  void release_if(Dead&& dead) {
    for (std::uint32_t i = 0; i < count_; ++i) {
      // Relaxed: no other process changes the tags that dead() accepts.
      const std::uint32_t tag = tags_[i].load(std::memory_order_relaxed);
      if (tag != 0 && dead(tag)) tags_[i].store(0, std::memory_order_release);  // G1
    }
  }

  std::uint32_t count() const { return count_; }
  /// Relaxed: a hint, or the tag of a block or ring that the caller keeps from being freed.
  std::uint32_t tag(std::uint32_t i) const { return tags_[i].load(std::memory_order_relaxed); }
  bool is_free(std::uint32_t first, std::uint32_t run) const {
    return last_used(first, run) == kNone;
  }
  std::uint32_t used() const {
    std::uint32_t n = 0;
    for (std::uint32_t i = 0; i < count_; ++i) n += tag(i) != 0;
    return n;
  }

 private:
  static constexpr std::uint32_t kLarge = 256;

  /// Runs of a similar size share a hint.
  static unsigned size_class(std::uint32_t run) {
    return static_cast<unsigned>(std::bit_width(run | 1)) - 1;
  }

  /// The first run in places begin to end - 1, upwards, or kNone.
  template <class May>
  std::uint32_t seek_up(std::uint32_t begin, std::uint32_t end, std::uint32_t run,
                        std::uint32_t tag, May&& may) {
    for (std::uint32_t first = begin; first < end;) {
      const std::uint32_t used = last_used(first, run);
      if (used != kNone) {
        first = used + 1;  // no run that has this granule is free
      } else if (may(first) && take(first, run, tag)) {
        return first;
      } else {
        ++first;
      }
    }
    return kNone;
  }
  /// The same, downwards.
  template <class May>
  std::uint32_t seek_down(std::uint32_t begin, std::uint32_t end, std::uint32_t run,
                          std::uint32_t tag, May&& may) {
    for (std::uint32_t last = end; last > begin;) {
      const std::uint32_t first = last - 1;
      const std::uint32_t used = first_used(first, run);
      if (used != kNone) {
        if (used < run) return kNone;
        last = used - run + 1;
      } else if (may(first) && take(first, run, tag)) {
        return first;
      } else {
        last = first;
      }
    }
    return kNone;
  }

  std::uint32_t last_used(std::uint32_t first, std::uint32_t run) const {
    for (std::uint32_t i = first + run; i-- > first;) {
      if (tag(i) != 0) return i;
    }
    return kNone;
  }
  std::uint32_t first_used(std::uint32_t first, std::uint32_t run) const {
    for (std::uint32_t i = first; i < first + run; ++i) {
      if (tag(i) != 0) return i;
    }
    return kNone;
  }

  bool take(std::uint32_t first, std::uint32_t run, std::uint32_t tag) {
    for (std::uint32_t i = 0; i < run; ++i) {
      std::uint32_t free = 0;
      if (tags_[first + i].load(std::memory_order_relaxed) != 0 ||
          !tags_[first + i].compare_exchange_strong(free, tag, std::memory_order_acquire,
                                                    std::memory_order_relaxed)) {  // G1
        // Release: hands on what the former owner has released (G1).
        while (i > 0) tags_[first + --i].store(0, std::memory_order_release);
        return false;
      }
    }
    return true;
  }

  Tag* tags_ = nullptr;
  std::uint32_t count_ = 0;
  /// By size class, private to the process: where a search begins. Before that place, seen from the
  /// end at which the class begins, this process has found no free run and has released none. It is
  /// only a hint: other processes release as well, and the runs of a class differ in size. The
  /// second half of a search finds the rest. The hints of large runs are complements, so that they
  /// begin at 0 as well.
  std::array<Tag, 32> hint_{};
};

}  // namespace lot::segment
