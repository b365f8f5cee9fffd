// SPDX-License-Identifier: Apache-2.0

// Topics, their types, and the tables' limits.

#include "registry/registry.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"

namespace {

using namespace lot::testing;

struct Apple {
  std::uint64_t value;
};
struct Pear {
  std::uint64_t value;
};
struct BigApple {
  std::uint64_t value[4];
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::uint32_t kMaker = 1;  ///< the first process of a segment

std::string refusal(const std::function<void()>& what) {
  try {
    what();
  } catch (const lot::Error& e) {
    return e.what();
  }
  return "";
}
bool says(const std::string& text, const char* what) {
  return text.find(what) != std::string::npos;
}

}  // namespace

TEST_SUITE_BEGIN("registry");

TEST_CASE("a ring of items that a dead process has recycled in part holds none, and is no harm") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  lot::segment::Segment segment(engine.path());
  auto& channel = segment.channels()[0];
  const auto generation = lot::ring::writer_generation(channel.writer.load());
  channel.topic = 0;
  channel.taken = 1;
  lot::test::raw(channel.formed).store(0);  // and its memory has gone
  lot::test::raw(channel.writer)
      .store(lot::ring::make_writer(generation, lot::ring::State::Orphan, 0));
  Outsider owner;
  CHECK_FALSE(lot::registry::Registry(segment, owner).is_open({0, generation}));
  auto puller = engine.subscribe<Apple>("/p");
  auto pusher = engine.advertise<Apple>("/p");
  must_go(pusher.push(pusher.loan(std::uint64_t{7})));
  const auto apple = puller.pull(10s);
  REQUIRE(apple);
  CHECK(apple->value == 7);
  CHECK(eventually(
      [&] { return lot::ring::writer_state(channel.writer.load()) != lot::ring::State::Orphan; }));
}

TEST_CASE("a ring has extra memory if its maker asks for it: zero bytes, and behind all else") {
  const auto options = fresh();
  lot::ShmEngine engine(options);
  lot::segment::Segment segment(engine.path());
  InOurName owner(segment);
  lot::registry::Registry registry(segment, owner);
  const lot::registry::Registry::Lock lock(registry);
  const std::uint32_t topic = registry.enter("/extra", lot::detail::message_type<Apple>(), kMaker);
  const auto is_behind = [](const unsigned char* extra, const auto* table, std::size_t n) {
    return extra >= reinterpret_cast<const unsigned char*>(table + n);
  };
  for (const std::uint32_t taken : {0U, lot::segment::kFinished}) {
    // A queue that redelivers never overwrites.
    const auto policy = taken == 0 ? lot::Policy::Overwrite : lot::Policy::Block;
    lot::registry::RingOptions how{5, 3, policy, lot::QueueEngine::Ring, taken};
    const auto plain = registry.open(topic, kMaker, how);
    REQUIRE(plain);
    CHECK(segment.ring(plain->channel).extra == nullptr);
    how.extra = lot::segment::kExtraBytes;
    const unsigned char* soiled = nullptr;
    for (int times = 0; times < 2; ++times) {  // then in memory that was in use before
      const auto name = registry.open(topic, kMaker, how);
      REQUIRE(name);
      const lot::segment::Ring ring = segment.ring(name->channel);
      REQUIRE(ring.extra != nullptr);
      auto* const extra = static_cast<unsigned char*>(ring.extra);
      const std::size_t bytes = std::size_t{how.readers} * how.extra;
      CHECK(std::count(extra, extra + bytes, 0) == static_cast<std::ptrdiff_t>(bytes));
      CHECK(is_behind(extra, ring.cells, ring.readers));
      CHECK((ring.claims == nullptr || is_behind(extra, ring.claims, ring.depth)));
      auto& entry = segment.channels()[name->channel];
      CHECK(segment.offset_of(extra) + bytes <=
            segment.granule_offset(entry.granule + entry.granules));
      entry.extra = 8;  // a wild write
      CHECK(segment.ring(name->channel).depth == 0);
      entry.extra = how.extra;
      CHECK((times == 0 || extra == soiled));
      soiled = extra;
      std::fill_n(extra, bytes, std::uint8_t{0xff});
      registry.recycle(name->channel);
      lot::test::raw(entry.writer)
          .store(lot::ring::make_writer(name->generation, lot::ring::State::Free, 0));
    }
  }
}

TEST_CASE("another type on a topic is an error at either end, which names both") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  const auto names_both = [](const std::string& text, const char* topic, const char* second) {
    return says(text, topic) && says(text, "Apple (8 bytes, alignment 8)") && says(text, second) &&
           says(text, "same definition");
  };
  {
    auto puller = engine.subscribe<Apple>("/p");
    CHECK(names_both(refusal([&] { return engine.advertise<Pear>("/p"); }), "/p", "Pear (8 bytes"));
    CHECK(names_both(refusal([&] { return engine.subscribe<Pear>("/p"); }), "/p", "Pear (8 bytes"));
    auto pusher = engine.advertise<Apple>("/q");
    CHECK(names_both(refusal([&] { return engine.subscribe<BigApple>("/q"); }), "/q",
                     "BigApple (32"));
    Child other([&] {
      lot::ShmEngine mine(options);
      must(names_both(refusal([&] { return mine.subscribe<Pear>("/q"); }), "/q", "Pear"),
           "subscribe");
      must(names_both(refusal([&] { return mine.advertise<Pear>("/p"); }), "/p", "Pear"),
           "advertise");
      must(refusal([&] { return mine.subscribe<Apple>("/q"); }).empty(), "the right type");
    });
    CHECK(other.wait() == 0);
    // The ends that were refused left nothing.
    CHECK(puller.publishers() == 0);
    must_go(pusher.push(pusher.loan(std::uint64_t{1})));
  }
  // After all have left, the name is free for another type.
  auto pusher = engine.advertise<Pear>("/p");
  auto puller = engine.subscribe<Pear>("/p");
  must_go(pusher.push(pusher.loan(std::uint64_t{4})));
  CHECK(puller.pull(1s)->value == 4);
  auto other = engine.subscribe<BigApple>("/q");
}

TEST_CASE("a topic of a process that was killed is free for another type") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready;
  Child victim([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Apple>("/p");
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  lot::ShmEngine engine(options);
  CHECK(!refusal([&] { return engine.subscribe<Pear>("/p"); }).empty());
  victim.kill9();
  CHECK(eventually([&] { return refusal([&] { return engine.subscribe<Pear>("/p"); }).empty(); }));
}

TEST_CASE("an observer that was killed is noted at its topic no more") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Apple>("/p");
  const lot::segment::Segment segment(engine.path());
  const auto is_observed = [&] {
    for (const auto& topic : segment.topics()) {
      for (std::uint32_t k = 0; k < segment.capacity().participants; ++k) {
        using lot::segment::Atomics;
        const auto word = topic.observers[k / Atomics::kBitsPerWord].load();
        if ((word >> k % Atomics::kBitsPerWord & 1) != 0) return true;
      }
    }
    return false;
  };
  CHECK(!is_observed());
  Steps ready;
  Child victim([&] {
    lot::ShmEngine other(options);
    lot::PullerOptions observing;
    observing.observer = true;
    auto puller = other.subscribe<Apple>("/p", observing);
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  CHECK(is_observed());
  victim.kill9();
  CHECK(eventually([&] { return !is_observed(); }));
}

TEST_CASE("bad topic names and depths are refused") {
  lot::ShmEngine engine(fresh());
  for (const std::string& bad : {std::string(), std::string(200, 'x'), std::string("a\0b", 3)}) {
    CHECK(says(refusal([&] { return engine.advertise<Apple>(bad); }), "not a name for a topic"));
    CHECK(says(refusal([&] { return engine.subscribe<Apple>(bad); }), "not a name for a topic"));
  }
  auto longest = engine.advertise<Apple>(std::string(199, 'x'));
  for (const std::uint32_t bad : {0U, 65537U}) {
    CHECK(says(refusal([&] {
                 return engine.advertise<Apple>("/t", {lot::Policy::Block, bad, 1s});
               }),
               "depth"));
  }
  lot::segment::Segment s(engine.path());
  CHECK(Audit(s).topics == 1);
  CHECK(Audit(s).channels == 1);
}

TEST_CASE("each limit is an error that names the setting, and what is freed is there again") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.processes = 2;
  options.topics = 3;
  options.channels = 4;
  options.readers = 2;
  options.blocks = 64;
  {
    lot::ShmEngine engine(options);
    lot::segment::Segment s(engine.path());
    for (int round = 0; round < 3; ++round) {
      std::vector<lot::ShmPusher<Apple>> pushers;
      for (const char* topic : {"/a", "/b", "/c"}) {
        pushers.push_back(engine.advertise<Apple>(topic));
      }
      CHECK(says(refusal([&] { return engine.advertise<Apple>("/d"); }), "EngineOptions::topics"));
      CHECK(says(refusal([&] { return engine.subscribe<Apple>("/d"); }), "EngineOptions::topics"));
      pushers.push_back(engine.advertise<Apple>("/a"));
      CHECK(
          says(refusal([&] { return engine.advertise<Apple>("/a"); }), "EngineOptions::channels"));
      std::vector<lot::ShmPuller<Apple>> pullers;
      for (int n = 0; n < 2; ++n) pullers.push_back(engine.subscribe<Apple>("/b"));
      CHECK(says(refusal([&] { return engine.subscribe<Apple>("/b"); }), "EngineOptions::readers"));
      pullers.pop_back();
      CHECK(refusal([&] { return engine.subscribe<Apple>("/b"); }).empty());
    }
    CHECK(eventually([&] { return Audit(s).nothing(); }));
    INFO(Audit(s).text());
    Steps ready, done;
    Child second([&] {
      lot::ShmEngine mine(options);
      ready.tell();
      done.next();
    });
    REQUIRE(ready.next() == '.');
    Child third([&] {
      must(says(refusal([&] { lot::ShmEngine mine(options); }), "EngineOptions::processes"),
           "the setting");
    });
    CHECK(third.wait() == 0);
    second.kill9();
    Child fourth([&] { lot::ShmEngine mine(options); });
    CHECK(fourth.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_SUITE_END();
