// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <utility>

namespace lot::transport {

/// The blocks of a pool whose messages only other processes hold, in the order in which the pool
/// looks at them.
///
/// A block's own link says whether it is on the list. So a block whose message has died is taken
/// off at once, wherever it stands, and nothing is allocated.
///
/// Threads: size() at any time, all else with the pool's lock. A link is written by the pool that
///          has its block at home.
class KeptList {
 public:
  /// The places of the neighbours: a block's index plus 1; 0: not on a list.
  struct Link {
    std::uint32_t next = 0;
    std::uint32_t previous = 0;
  };

  /// `links`: one for each block, shared by all pools of the process.
  explicit KeptList(Link* links) noexcept : links_(links) {}

  // Relaxed: a hint, or read with the lock.
  std::size_t size() const noexcept { return size_.load(std::memory_order_relaxed); }
  bool empty() const noexcept { return first_ == 0; }
  /// REQUIRES: not empty.
  std::uint32_t front() const noexcept { return first_ - 1; }

  /// Puts the block at the end. False: it is on the list already.
  bool enter(std::uint32_t block) noexcept {
    if (links_[block].next != 0) return false;
    link_last(block);
    count(1);
    return true;
  }
  /// Puts the block at the end, whether it is on the list or not. size() never reports less
  /// meanwhile.
  void move_to_end(std::uint32_t block) noexcept {
    if (enter(block)) return;
    unlink(block);
    link_last(block);
  }

  /// Takes the block off, if it is on the list.
  void remove(std::uint32_t block) noexcept {
    if (links_[block].next == 0) return;
    unlink(block);
    count(-1);
  }

 private:
  void link_last(std::uint32_t block) noexcept {
    const std::uint32_t place = block + 1;
    if (first_ == 0) {
      links_[block] = {place, place};
      first_ = place;
    } else {
      const std::uint32_t last = at(first_).previous;
      links_[block] = {first_, last};
      at(last).next = place;
      at(first_).previous = place;
    }
  }
  void unlink(std::uint32_t block) noexcept {
    const Link link = std::exchange(links_[block], {});
    const std::uint32_t place = block + 1;
    if (link.next == place) {
      first_ = 0;
    } else {
      at(link.previous).next = link.next;
      at(link.next).previous = link.previous;
      if (first_ == place) first_ = link.next;
    }
  }
  Link& at(std::uint32_t place) noexcept { return links_[place - 1]; }
  /// Called with the lock only. Relaxed: readers without it take the size for a hint.
  void count(int change) noexcept {
    // Relaxed: see above.
    size_.store(size() + static_cast<std::size_t>(change), std::memory_order_relaxed);
  }

  Link* links_;
  std::uint32_t first_ = 0;
  std::atomic<std::size_t> size_{0};
};

}  // namespace lot::transport
