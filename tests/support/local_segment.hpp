// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstring>
#include <string>

#include "registry/registry.hpp"
#include "segment/segment.hpp"
#include "support/lock_owner.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "transport/world.hpp"

namespace lot::testing {

/// A real segment, which is gone from its directory as soon as it is mapped, and its World: for
/// processes that are played in one process and one thread.
class LocalSegment {
 public:
  explicit LocalSegment(const segment::Capacity& capacity)
      : segment_(make(capacity)), registry_(segment_, owner_), world_(segment_, registry_) {
    segment::Segment::remove(segment_.path(), {});
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
    std::memset(static_cast<void*>(&segment_.arena(0)), 0,
                segment_.capacity().blocks * sizeof(lot::detail::Arena));
    for (std::uint32_t b = 0; b < segment_.capacity().blocks; ++b) segment_.build(b).close();
    segment_.granules().release_if([](std::uint32_t) { return true; });
    test::raw(segment_.directory().version) = 0;
  }

  transport::World& world() { return world_; }
  bool reap(std::uint32_t k) { return transport::Recovery(world_).reap(k); }
  bool collect() { return transport::Recovery(world_).collect(); }

 private:
  static std::string make(const segment::Capacity& capacity) {
    std::string path = "/dev/shm/" + unique_name();
    segment::Segment::create(path, capacity, {});
    return path;
  }

  segment::Segment segment_;
  Outsider owner_;
  registry::Registry registry_;
  transport::World world_;
};

}  // namespace lot::testing
