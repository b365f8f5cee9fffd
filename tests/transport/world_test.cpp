// SPDX-License-Identifier: Apache-2.0

// The World that Recovery repairs, over a segment and its registry alone: no participant, no lock
// file, no thread.

#include "transport/world.hpp"

#include <atomic>
#include <cstdint>
#include <cstring>

#include <doctest/doctest.h>

#include "lot/detail/control.hpp"

#include "support/local_segment.hpp"
#include "transport/pool.hpp"

namespace {

using lot::testing::LocalSegment;
using lot::transport::HardwareOwnership;
using lot::transport::Recovery;
using lot::transport::World;
namespace refcount = lot::refcount;

constexpr std::uint32_t kDead = 2;
constexpr lot::detail::MessageType kNumber{8, 8, 1, "number", nullptr, true, nullptr};

LocalSegment make() { return LocalSegment({6 << 20, 4, 64, 2, 3, 3}); }

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("a World over a bare segment: Recovery frees the blocks, memory and topics of the dead") {
  LocalSegment local = make();
  World& world = local.world();
  world.participant_state(kDead).take();
  HardwareOwnership::Hold hold{};
  REQUIRE(HardwareOwnership(kDead).claim(world.block(5), hold));
  REQUIRE(local.segment().claim_run(3, 5 + 1) !=
          lot::segment::Granules<lot::segment::Atomics>::kNone);
  {
    const lot::registry::Registry::Lock lock(local.registry());
    const std::uint32_t topic = local.registry().enter("/numbers", kNumber, kDead);
    REQUIRE(local.registry().open(topic, kDead, {4, 3}).has_value());
  }
  CHECK(world.used_channels() == 1);
  const std::uint32_t adoptions = local.segment().directory().adoptions.load();

  CHECK(Recovery(world).reap(kDead));

  CHECK(world.participant_state(kDead).load() == 0);
  CHECK(world.block(5).home.load() == refcount::kHomeFree);
  CHECK(lot::ring::writer_state(world.channel_writer(0).load()) == lot::ring::State::Free);
  CHECK(local.segment().directory().adoptions.load() != adoptions);
  const auto& tags = local.segment().granules();
  for (std::uint32_t i = 0; i < tags.count(); ++i) CHECK(tags.tag(i) == 0);
  CHECK(!Recovery(world).reap(kDead));
}

TEST_CASE("a World finds rings that have ended, and forgets them once Recovery has collected") {
  LocalSegment local = make();
  World& world = local.world();
  world.participant_state(kDead).take();
  lot::registry::ChannelName ring{};
  {
    const lot::registry::Registry::Lock lock(local.registry());
    const std::uint32_t topic = local.registry().enter("/numbers", kNumber, kDead);
    ring = local.registry().open(topic, kDead, {4, 3}).value();
  }
  CHECK(!world.has_orphan_rings());

  Recovery(world).orphan_ring(ring.channel, kDead);
  CHECK(world.has_orphan_rings());
  CHECK(world.has_ending_rings());

  CHECK(Recovery(world).collect());
  CHECK(!world.has_orphan_rings());
  CHECK(!world.has_ending_rings());
}

TEST_CASE("a World reads a participant's name up to its end, and none for an index of no process") {
  LocalSegment local = make();
  auto& entry = local.segment().participants()[kDead];
  CHECK(local.world().name_of(kDead).empty());
  std::memset(entry.name, 'x', sizeof(entry.name));
  CHECK(local.world().name_of(kDead).size() == sizeof(entry.name));
  CHECK(local.world().name_of(local.world().participants()).empty());
}
