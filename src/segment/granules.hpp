// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

/// The pool of message memory: granules of 4 KiB, handed out in runs of a power of two at places
/// aligned to their size (so that large runs fit again after many small ones).
///
/// One fact, one word: each granule's tag names its owner. There are no free lists and no tree to
/// split and join; a run is free when its tags are 0, and what the dead owned is found by name.
///
/// Progress: claim() is lock-free. Claims go upwards and are undone when a later granule is taken,
///           so of those who collide the one furthest up goes through.
/// Edges
///   G1  tag = 0 in release (release) -> tag compare-and-swap in claim (acquire)
///       carries: "the old owner and all its readers are done with the memory".
/// Crash: killed while claiming: the granules carry the tag of a block or ring whose home is dead;
///        they are freed with it.
namespace lot::segment {

template <class P>
class Granules {
 public:
  using Tag = typename P::template Atomic<std::uint32_t>;
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  static constexpr unsigned kOrders = 24;

  Granules() = default;
  Granules(Tag* tags, std::uint32_t count) { reset(tags, count); }

  void reset(Tag* tags, std::uint32_t count) {
    tags_ = tags;
    count_ = count;
  }

  /// A run of 2^order granules that carries `tag` now, or kNone. Small runs are sought from the low
  /// end and large ones from the high end, which keeps them apart.
  std::uint32_t claim(unsigned order, std::uint32_t tag) {
    return claim(order, tag, [](std::uint32_t) { return true; });
  }
  /// The same, of the runs that may(first) allows.
  template <class May>
  std::uint32_t claim(unsigned order, std::uint32_t tag, May&& may) {
    if (order >= kOrders || (std::uint64_t{1} << order) > count_) return kNone;
    const std::uint32_t run = std::uint32_t{1} << order;
    const std::uint32_t places = count_ >> order;
    std::uint32_t place = hint_[order].load(std::memory_order_relaxed);
    for (std::uint32_t n = 0; n < places; ++n, ++place) {
      if (place >= places) place = 0;
      const std::uint32_t first = (order >= kLarge ? places - 1 - place : place) << order;
      if (may(first) && take(first, run, tag)) {
        hint_[order].store(place, std::memory_order_relaxed);
        return first;
      }
    }
    return kNone;
  }

  void release(std::uint32_t first, unsigned order) {
    for (std::uint32_t i = 0; i < std::uint32_t{1} << order; ++i) {
      tags_[first + i].store(0, std::memory_order_release);  // G1
    }
    // Look here first the next time: it is warm.
    const std::uint32_t place = first >> order;
    hint_[order].store(order >= kLarge ? (count_ >> order) - 1 - place : place,
                       std::memory_order_relaxed);
  }

  /// Releases every granule whose tag dead(tag) says so.
  template <class Dead>
  void release_if(Dead&& dead) {
    for (std::uint32_t i = 0; i < count_; ++i) {
      const std::uint32_t tag = tags_[i].load(std::memory_order_relaxed);
      if (tag != 0 && dead(tag)) tags_[i].store(0, std::memory_order_release);  // G1
    }
  }

  std::uint32_t count() const { return count_; }
  std::uint32_t tag(std::uint32_t i) const { return tags_[i].load(std::memory_order_relaxed); }
  std::uint32_t used() const {
    std::uint32_t n = 0;
    for (std::uint32_t i = 0; i < count_; ++i) n += tag(i) != 0;
    return n;
  }

 private:
  static constexpr unsigned kLarge = 8;

  bool take(std::uint32_t first, std::uint32_t run, std::uint32_t tag) {
    for (std::uint32_t i = 0; i < run; ++i) {
      std::uint32_t free = 0;
      if (tags_[first + i].load(std::memory_order_relaxed) != 0 ||
          !tags_[first + i].compare_exchange_strong(free, tag, std::memory_order_acquire,
                                                    std::memory_order_relaxed)) {  // G1
        // Release: what the former owner has released is handed on (G1).
        while (i > 0) tags_[first + --i].store(0, std::memory_order_release);
        return false;
      }
    }
    return true;
  }

  Tag* tags_ = nullptr;
  std::uint32_t count_ = 0;
  std::array<Tag, kOrders> hint_{};  ///< private: where to look first
};

}  // namespace lot::segment
