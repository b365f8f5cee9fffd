// SPDX-License-Identifier: Apache-2.0

// One ear over a bare segment (docs/ear.md): what it hears of, when it sleeps, and what the reaper
// of its process leaves. Publishers are played by the calls that they make.
#include <cstdint>
#include <memory>
#include <set>
#include <vector>

#include <doctest/doctest.h>

#include "futex/futex.hpp"
#include "support/local_segment.hpp"
#include "waiting/hearing.hpp"

namespace {

using lot::testing::LocalSegment;
using lot::waiting::Ear;
namespace ring = lot::ring;
namespace segment = lot::segment;

constexpr std::uint32_t kChannels = 70;  // more than a word of news, and no whole number of words
constexpr std::uint32_t kOwner = 2;
constexpr std::uint32_t kOther = 3;

struct Owner final : lot::waiting::EarOwner {
  Owner(segment::Segment& s, std::uint32_t i) : of(s), index(i) {}
  segment::Segment& ear_segment() noexcept override { return of; }
  std::uint32_t ear_index() const noexcept override { return index; }
  bool has_lost_ears() const noexcept override { return lost; }

  segment::Segment& of;
  std::uint32_t index;
  bool lost = false;
};

struct Fixture {
  LocalSegment local{{8 << 20, 4, 64, 2, kChannels, 3}};
  segment::Segment& segment = local.segment();
  Owner owner{segment, kOwner};

  /// Which clients are due.
  std::multiset<const Ear::Client*> take(Ear& ear) {
    std::multiset<const Ear::Client*> due;
    REQUIRE(ear.take([&](Ear::Client& client) { due.insert(&client); }));
    return due;
  }
  /// How many ears listen to the channel.
  std::size_t listeners(std::uint32_t channel) {
    std::size_t count = 0;
    segment.listeners()[channel].each([&](std::uint32_t) { ++count; });
    return count;
  }
  std::size_t all_listeners() {
    std::size_t count = 0;
    for (std::uint32_t c = 0; c < kChannels; ++c) count += listeners(c);
    return count;
  }
  /// Rings as a publisher does. How many bells it would wake.
  std::size_t ring_ears(std::uint32_t channel) {
    std::size_t woken = 0;
    segment.ring_ears(channel, [&](const void*, bool is_asleep) { woken += is_asleep; });
    return woken;
  }
  /// True if a thread that slept on these words would sleep.
  static bool would_sleep(const lot::detail::FutexWaits& waits) {
    for (const auto& wait : waits) {
      if (*static_cast<const std::uint32_t*>(wait.word) != wait.value) return false;
    }
    return true;
  }
};

using Clients = std::multiset<const Ear::Client*>;

}  // namespace

TEST_SUITE_BEGIN("waiting");

TEST_CASE_FIXTURE(Fixture, "an ear hears for those that listen to the ring, once") {
  Ear ear(owner);
  Ear::Client a, b, c;
  ear.listen(a, 0);
  ear.listen(a, 69);
  ear.listen(b, 69);
  ear.listen(c, 64);
  CHECK(take(ear).empty());
  ring_ears(69);
  CHECK(take(ear) == Clients{&a, &b});
  ring_ears(69);
  CHECK(take(ear).empty());  // they listen again when they are armed
  ear.listen(b, 69);
  ring_ears(69);
  ring_ears(0);
  ring_ears(64);
  ring_ears(64);
  CHECK(take(ear) == Clients{&a, &b, &c});
  ear.listen(a, 0);
  ear.listen(a, 0);
  ring_ears(0);
  CHECK(take(ear) == Clients{&a});
  ear.forget(a);
  ear.forget(b);
  ear.forget(c);
}

TEST_CASE_FIXTURE(Fixture, "a client that is forgotten is due no more") {
  Ear ear(owner);
  Ear::Client a, b;
  ear.listen(a, 3);
  ear.listen(b, 3);
  ear.watch_directory(a, 0);
  ring_ears(3);
  segment.ring_ears(3);
  ear.forget(a);
  local.world().renew_directory();
  CHECK(take(ear) == Clients{&b});
  CHECK(listeners(3) == 1);  // b was the first in its place, and listens on
  ear.forget(b);
}

TEST_CASE_FIXTURE(Fixture, "each of several that listen to one ring takes the first one's place") {
  Ear ear(owner);
  Ear::Client a, b, c;
  for (Ear::Client* const client : {&a, &b, &c}) {
    ear.listen(*client, 3);
    ear.listen(*client, 3);  // again, which changes nothing
  }
  ear.listen(c, 4);
  ear.forget(a);
  ear.forget(b);
  ring_ears(3);
  ring_ears(4);
  CHECK(take(ear) == Clients{&c, &c});
  CHECK(listeners(3) == 1);
  CHECK(listeners(4) == 1);
  ring_ears(3);
  CHECK(take(ear).empty());  // it would have to listen again
  CHECK(listeners(3) == 0);
  CHECK(listeners(4) == 1);
  ear.forget(c);
}

TEST_CASE_FIXTURE(Fixture, "all that listen to a ring are due once, also after another one went") {
  Ear ear(owner);
  Ear::Client a, b, c, d;
  for (const std::uint32_t channel : {3U, 4U}) {
    for (Ear::Client* const client : {&a, &b, &b, &c, &b}) ear.listen(*client, channel);
  }
  ear.listen(d, 3);
  ear.listen(d, 5);
  ear.forget(d);
  ring_ears(3);
  CHECK(take(ear) == Clients{&a, &b, &c});
  CHECK(listeners(3) == 1);
  ear.forget(b);  // it was behind another one
  ring_ears(4);
  CHECK(take(ear) == Clients{&a, &c});
  CHECK(listeners(4) == 1);
  ear.listen(a, 4);
  ring_ears(4);
  CHECK(take(ear) == Clients{&a});
  CHECK(listeners(4) == 1);
}

TEST_CASE_FIXTURE(Fixture, "the first that watches the directory is told, each by its version") {
  Ear ear(owner);
  Ear::Client a, b;
  const std::uint32_t version = segment.directory().version.load();
  CHECK(ear.watch_directory(a, version));
  CHECK_FALSE(ear.watch_directory(a, version));
  CHECK_FALSE(ear.watch_directory(b, version));
  CHECK(take(ear).empty());
  local.world().renew_directory();
  CHECK_FALSE(ear.watch_directory(b, segment.directory().version.load()));
  CHECK(take(ear) == Clients{&a});
  ear.forget(a);
  CHECK_FALSE(ear.watch_directory(b, version));  // it was there all the time
  ear.forget(b);
  CHECK(ear.watch_directory(b, version));
  CHECK_FALSE(ear.watch_directory(a, version));
  ear.forget(b);
  CHECK(take(ear) == Clients{&a});
}

TEST_CASE_FIXTURE(Fixture, "an ear takes its bit away where no client listens any more") {
  Ear ear(owner);
  Ear::Client a;
  ear.listen(a, 5);
  CHECK(listeners(5) == 1);
  ear.forget(a);
  CHECK(listeners(5) == 1);  // a push may see it still
  ring_ears(5);
  CHECK(take(ear).empty());
  CHECK(listeners(5) == 0);
  CHECK(ring_ears(5) == 0);
  ear.listen(a, 5);
  CHECK(listeners(5) == 1);
  ear.forget(a);
}

TEST_CASE_FIXTURE(Fixture, "an ear that was rung since it took its news does not sleep") {
  Ear ear(owner);
  Ear::Client a;
  ear.listen(a, 1);
  CHECK(ring_ears(1) == 0);  // it does not sleep
  CHECK(ear.has_rung());
  CHECK(take(ear) == Clients{&a});
  CHECK(!ear.has_rung());
  ear.listen(a, 1);
  ring_ears(1);
  lot::detail::FutexWaits waits;
  ear.prepare_to_sleep(waits);
  REQUIRE(waits.size() == 1);
  CHECK(!would_sleep(waits));
  CHECK(lot::futex::wait_any(waits, std::nullopt));  // at once
  CHECK(take(ear) == Clients{&a});
  ear.listen(a, 1);
  waits.clear();
  ear.prepare_to_sleep(waits);
  CHECK(would_sleep(waits));
  CHECK(ring_ears(1) == 1);
  CHECK(ring_ears(1) == 1);  // a ringer does not rely on another one's wake
  CHECK(!would_sleep(waits));
  CHECK(take(ear) == Clients{&a});
  ear.listen(a, 1);
  CHECK(ring_ears(1) == 0);  // it has woken
  ear.forget(a);
}

TEST_CASE_FIXTURE(Fixture, "news that another thread has taken leave nothing but a wake-up") {
  Ear ear(owner);
  Ear::Client a;
  ear.listen(a, 1);
  lot::detail::FutexWaits waits;
  ear.prepare_to_sleep(waits);
  CHECK(ring_ears(1) == 1);
  Clients due;
  ear.take_news([&](Ear::Client& client) { due.insert(&client); });
  CHECK(due == Clients{&a});
  CHECK(!would_sleep(waits));
  CHECK(take(ear).empty());
  ear.forget(a);
}

TEST_CASE_FIXTURE(Fixture, "those that watch the directory are due when its version changes") {
  Ear ear(owner);
  Ear::Client a, b;
  const auto version = [&] { return segment.directory().version.load(std::memory_order_relaxed); };
  CHECK(ear.watch_directory(a, version()));
  CHECK(!ear.watch_directory(b, version()));
  CHECK(!ear.watch_directory(b, version()));
  CHECK(take(ear).empty());
  lot::detail::FutexWaits waits;
  ear.prepare_to_sleep(waits);
  REQUIRE(waits.size() == 2);
  CHECK(would_sleep(waits));
  local.world().renew_directory();
  CHECK(!would_sleep(waits));
  CHECK(take(ear) == Clients{&a, &b});
  CHECK(take(ear).empty());
  CHECK(ear.watch_directory(a, version() - 1));  // it has not found the rings yet
  CHECK(take(ear) == Clients{&a});
  ear.watch_directory(a, version());
  CHECK(take(ear).empty());
  owner.call_watchers();
  CHECK(take(ear) == Clients{&a});
  CHECK(take(ear).empty());
  ear.forget(a);
  ear.forget(b);
}

TEST_CASE_FIXTURE(Fixture, "wait sets claim ears until there is none, and give them back") {
  std::vector<std::unique_ptr<Ear>> ears;
  Ear::Client a;
  while (auto ear = Ear::claim(owner)) ears.push_back(std::move(ear));
  CHECK(ears.size() == ring::kEars - segment::kFirstFreeEar);
  Owner other(segment, kOther);
  CHECK(Ear::claim(other) == nullptr);
  ears.back()->listen(a, 7);
  ears.front()->listen(a, 8);
  ears.front()->forget(a);
  ears.back()->forget(a);
  ears.pop_back();
  CHECK(listeners(7) == 0);
  CHECK(listeners(8) == 1);
  const auto again = Ear::claim(other);
  CHECK(again != nullptr);
  CHECK(Ear::claim(owner) == nullptr);
  ears.clear();
  CHECK(all_listeners() == 0);
}

TEST_CASE_FIXTURE(Fixture, "a reaper frees the ears of the dead, and no others") {
  Owner other(segment, kOther);
  auto by_index = std::make_unique<Ear>(owner);
  auto claimed = Ear::claim(owner);
  Ear other_index(other);
  const auto other_claimed = Ear::claim(other);
  Ear::Client a;
  for (Ear* ear : {by_index.get(), claimed.get(), &other_index, other_claimed.get()}) {
    for (std::uint32_t c = 0; c < kChannels; ++c) ear->listen(a, c);
    ear->forget(a);
  }
  local.world().participant_state(kOwner).take();
  CHECK(local.reap(kOwner));
  CHECK(all_listeners() == 2 * kChannels);
  owner.lost = true;  // it is dead
  by_index.reset();
  claimed.reset();
  CHECK(all_listeners() == 2 * kChannels);
  std::size_t free = 0;
  for (std::uint32_t e = segment::kFirstFreeEar; e < ring::kEars; ++e) {
    free += segment.ear(e).words->owner.load(std::memory_order_relaxed) == 0;
  }
  CHECK(free == ring::kEars - segment::kFirstFreeEar - 1);
}

TEST_CASE_FIXTURE(Fixture, "a reaper rings whether a mark stands or not") {
  Ear ear(owner);
  Ear::Client a;
  ear.listen(a, 0);
  {
    const lot::registry::Registry::Lock lock(local.registry());
    const lot::detail::MessageType number{8, 8, 1, "number", nullptr, true, nullptr};
    const std::uint32_t topic = local.registry().enter("/numbers", number, kOther);
    REQUIRE(local.registry().open(topic, kOther, {4, 3}).has_value());
  }
  take(ear);
  ear.listen(a, 0);
  local.world().participant_state(kOther).take();
  CHECK(local.reap(kOther));
  CHECK(take(ear) == Clients{&a});
  ear.forget(a);
}

TEST_CASE_FIXTURE(Fixture, "a lost ear touches nothing") {
  auto ear = std::make_unique<Ear>(owner);
  Ear::Client a;
  ear->listen(a, 4);
  ring_ears(4);
  owner.lost = true;
  CHECK(!ear->take([](Ear::Client&) { FAIL("no client is due"); }));
  lot::detail::FutexWaits waits;
  ear->prepare_to_sleep(waits);
  CHECK(waits.empty());
  CHECK(Ear::claim(owner) == nullptr);
  ear->forget(a);
  ear.reset();
  CHECK(listeners(4) == 1);
  CHECK(segment.ear(kOwner).news[0].load(std::memory_order_relaxed) == 1U << 4);
}

TEST_CASE_FIXTURE(Fixture, "damaged words name no channel that there is not") {
  Ear ear(owner);
  Ear::Client a;
  for (std::uint32_t c = 0; c < kChannels; ++c) ear.listen(a, c);
  for (std::uint32_t w = 0; w < segment::Ear::news_words(kChannels); ++w) {
    segment.ear(kOwner).news[w].store(~ring::Word{0}, std::memory_order_relaxed);
  }
  std::size_t due = 0;
  CHECK(ear.take([&](Ear::Client&) { ++due; }));
  CHECK(due == kChannels);
  CHECK(take(ear).empty());
  segment.ring_ears(kChannels);  // no such channel
  ear.forget(a);
}

TEST_SUITE_END();
