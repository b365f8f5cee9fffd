// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstring>
#include <string>
#include <vector>

#include "recovery/recovery.hpp"
#include "registry/registry.hpp"
#include "segment/segment.hpp"
#include "support/lock_owner.hpp"
#include "support/processes.hpp"
#include "transport/pool.hpp"

namespace lot::fuzz {

/// A real segment, which is gone from its directory as soon as it is mapped, and Recovery's World
/// over it: for processes that are played in one process and one thread.
class LocalSegment {
 public:
  explicit LocalSegment(const segment::Capacity& capacity)
      : segment_(make(capacity)), registry_(segment_, owner_) {
    segment::Segment::remove(segment_.path(), {});
    holder_.segment = &segment_;
  }

  segment::Segment& segment() { return segment_; }
  registry::Registry& registry() { return registry_; }

  /// Makes everything as it was at the beginning.
  void clear() {
    const auto zero = [](auto table) {
      std::memset(static_cast<void*>(table.data()), 0, table.size_bytes());
    };
    zero(segment_.participants());
    zero(segment_.topics());
    zero(segment_.channels());
    zero(segment_.blocks());
    std::memset(static_cast<void*>(&segment_.arena(0)), 0, blocks() * sizeof(lot::detail::Arena));
    for (std::uint32_t b = 0; b < blocks(); ++b) segment_.build(b).close();
    segment_.granules().release_if([](std::uint32_t) { return true; });
    segment_.directory().version = 0;
  }

  bool reap(std::uint32_t k) {
    return recovery::Recovery<segment::Atomics, LocalSegment>(*this).reap(k);
  }
  bool collect() { return recovery::Recovery<segment::Atomics, LocalSegment>(*this).collect(); }

  // What Recovery asks of its World.
  std::uint32_t participants() const { return segment_.capacity().participants; }
  std::atomic<std::uint32_t>& part(std::uint32_t k) { return segment_.participants()[k].state; }
  std::uint32_t blocks() const { return segment_.capacity().blocks; }
  segment::BlockWords& block(std::uint32_t b) { return segment_.block(b); }
  std::uint32_t channels() const { return segment_.capacity().channels; }
  std::atomic<ring::Word>& channel_writer(std::uint32_t c) { return segment_.channels()[c].writer; }
  segment::Ring ring(std::uint32_t c) const { return segment_.ring(c); }
  template <class F>
  void each_reference(std::uint32_t b, F&& f) const {
    holder_.each_reference(b, f);
  }
  bool lock_rings() { return registry_.try_lock(); }
  void unlock_rings() { registry_.unlock(); }
  void recycle_ring(std::uint32_t c) { registry_.recycle(c); }
  void release_extents(const std::vector<bool>& dead) {
    segment_.granules().release_if(
        [&dead](std::uint32_t tag) { return (tag & segment::kRingTag) == 0 && dead[tag - 1]; });
  }
  void renew_directory() { segment_.directory().version.fetch_add(1); }
  void unsubscribe(std::uint32_t k) { registry_.unsubscribe(k); }
  void forget(std::uint32_t k) { registry_.forget(k); }
  template <class Word>
  void wake(std::atomic<Word>&) {}  // nobody sleeps here

 private:
  static std::string make(const segment::Capacity& capacity) {
    std::string path = "/dev/shm/" + testing::unique_name();
    segment::Segment::create(path, capacity, {});
    return path;
  }

  segment::Segment segment_;
  testing::Outsider owner_;
  registry::Registry registry_;
  transport::Holder holder_;
};

}  // namespace lot::fuzz
