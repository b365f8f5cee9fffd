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
constexpr std::uint32_t kReader = 3;
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

TEST_CASE("what a reader looks at outlives its publisher's death, though no slot has it any more") {
  LocalSegment local = make();
  World& world = local.world();
  world.participant_state(kDead).take();
  lot::registry::ChannelName name{};
  {
    const lot::registry::Registry::Lock lock(local.registry());
    const std::uint32_t topic = local.registry().enter("/numbers", kNumber, kDead);
    name = local.registry().open(topic, kDead, {1, 3}).value();
  }
  const auto ring = local.segment().ring(name.channel);
  lot::ring::Writer<lot::segment::Atomics> writer(ring);
  bool full = false;
  auto reader =
      lot::ring::Reader<lot::segment::Atomics>::join(ring, name.generation, kReader, 0, full);
  REQUIRE(reader);
  REQUIRE(reader->cell() == 0);
  HardwareOwnership::Hold holds[2]{};
  std::uint64_t missed = 0;
  for (std::uint32_t b = 0; b < 2; ++b) {
    REQUIRE(HardwareOwnership(kDead).claim(world.block(b), holds[b]));
    writer.publish(b);
    if (b == 0) REQUIRE(reader->poll(missed) == 0);
  }

  CHECK(local.reap(kDead));
  CHECK(world.block(0).home.load() == refcount::kHomeOrphanage);
  CHECK(world.block(1).home.load() == refcount::kHomeOrphanage);

  reader->done();
  CHECK(local.collect());
  CHECK(world.block(0).home.load() == refcount::kHomeFree);
  CHECK(world.block(1).home.load() == refcount::kHomeOrphanage);
}
