// SPDX-License-Identifier: Apache-2.0

// Observers (PullerOptions::observer): nothing waits for them, and no topic is kept for them.

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <optional>
#include <poll.h>
#include <thread>
#include <utility>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;

struct Note {
  std::uint64_t number = 0;
};
struct Other {
  std::uint32_t parts[2];
};
struct Large {
  lot::ShmVector<std::uint8_t> data;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

lot::PullerOptions observing() {
  lot::PullerOptions options;
  options.observer = true;
  return options;
}
lot::PusherOptions lossless(std::uint32_t depth, lot::QueueEngine engine) {
  lot::PusherOptions options;
  options.depth = depth;
  options.policy = Policy::Refuse;
  options.engine = engine;
  return options;
}
constexpr lot::QueueEngine kEngines[] = {lot::QueueEngine::Ring, lot::QueueEngine::Mutex};

void put(lot::ShmPusher<Note>& pusher, std::uint64_t number) {
  must_go(pusher.push(pusher.loan(Note{number})));
}

template <class T>
int error_of(lot::ShmPuller<T>& puller) {
  try {
    (void)puller.try_pull();
  } catch (const lot::Error& e) {
    return e.error_number();
  }
  return 0;
}

}  // namespace

TEST_SUITE_BEGIN("observer");

TEST_CASE("a lossless publisher does not wait for an observer, which counts what it misses") {
  const Watchdog watchdog(60);
  for (const auto kind : kEngines) {
    lot::ShmEngine engine(fresh());
    auto early = engine.subscribe<Note>("/notes", observing());
    auto pusher = engine.advertise<Note>("/notes", lossless(4, kind));
    auto late = engine.subscribe<Note>("/notes", observing());
    CHECK(pusher.readers() == 0);
    auto reader = engine.subscribe<Note>("/notes");
    CHECK(pusher.readers() == 1);
    for (std::uint64_t n = 0; n < 20; ++n) {
      put(pusher, n);
      const auto note = reader.pull(10s);
      REQUIRE(note);
      CHECK(note->number == n);
    }
    for (auto* observer : {&early, &late}) {
      std::uint64_t seen = 0;
      std::uint64_t next = 0;
      while (const auto note = observer->try_pull()) {
        CHECK(note->number >= next);
        CHECK(note->number == next + observer->missed());
        next = note->number + 1;
        ++seen;
      }
      CHECK(next == 20);
      CHECK(seen + observer->missed_total() == 20);
      CHECK(seen <= 4);
    }
    // A reader that does not read holds the publisher up, as ever.
    for (std::uint64_t n = 0; n < 4; ++n) put(pusher, n);
    CHECK(pusher.push(pusher.loan(Note{4})) == Status::Full);
  }
}

TEST_CASE("what an observer has borrowed stays whole while a lossless publisher goes on") {
  const Watchdog watchdog(60);
  for (const auto kind : kEngines) {
    lot::ShmEngine engine(fresh());
    auto pusher = engine.advertise<Note>("/notes", lossless(2, kind));
    auto observer = engine.subscribe<Note>("/notes", observing());
    put(pusher, 7);
    const auto borrowed = observer.try_borrow();
    REQUIRE(borrowed);
    for (std::uint64_t n = 100; n < 400; ++n) {
      put(pusher, n);
      REQUIRE(borrowed->number == 7);
    }
  }
}

TEST_CASE("observers see no torn message beside a lossless publisher at full speed") {
  const Watchdog watchdog(120);
  struct Wide {
    std::uint64_t parts[16];
  };
  lot::ShmEngine engine(fresh());
  lot::PusherOptions options;
  options.depth = 4;
  options.policy = Policy::Block;
  auto pusher = engine.advertise<Wide>("/wide", options);
  constexpr std::uint64_t kMessages = 100000;
  std::atomic<bool> is_done{false};
  std::uint64_t seen = 0;
  std::thread observes([&] {
    auto observer = engine.subscribe<Wide>("/wide", observing());
    while (!is_done) {
      const auto wide = observer.borrow(1ms);
      if (!wide) continue;
      const std::uint64_t first = wide->parts[0];
      for (const std::uint64_t part : wide->parts) REQUIRE(part == first);
      ++seen;
    }
  });
  std::thread reads([&] {
    auto reader = engine.subscribe<Wide>("/wide");
    for (std::uint64_t last = 0; last + 1 < kMessages;) {
      const auto wide = reader.borrow(10s);
      REQUIRE(wide);
      last = wide->parts[0];
    }
    is_done = true;
  });
  REQUIRE(pusher.wait_for_readers(1, 30s));
  for (std::uint64_t n = 0; n < kMessages; ++n) {
    auto wide = pusher.loan();
    for (std::uint64_t& part : wide->parts) part = n;
    must_go(pusher.push(std::move(wide), 30s));
  }
  reads.join();
  observes.join();
  CHECK(seen > 0);
}

TEST_CASE("a topic with observers only may get another type; they are told, and may join again") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto observer = engine.subscribe<Note>("/notes", observing());
  std::optional pusher(engine.advertise<Note>("/notes"));
  put(*pusher, 1);
  CHECK_THROWS_AS((void)engine.advertise<Other>("/notes"), lot::Error);
  auto note = observer.pull(10s);
  REQUIRE(note);
  CHECK(note->number == 1);
  pusher.reset();
  {  // the same type again: it goes on
    auto again = engine.advertise<Note>("/notes");
    put(again, 2);
    note = observer.pull(10s);
    REQUIRE(note);
    CHECK(note->number == 2);
  }
  auto other = engine.advertise<Other>("/notes");
  CHECK(eventually([&] { return error_of(observer) == ESTALE; }));
  CHECK(error_of(observer) == ESTALE);
  auto typed = engine.subscribe<Other>("/notes", observing());
  must_go(other.push(other.loan(Other{{3, 4}})));
  const auto seen = typed.pull(10s);
  REQUIRE(seen);
  CHECK(seen->parts[1] == 4);
}

TEST_CASE("an observer that waits learns that its topic has another type, however it waits") {
  const Watchdog watchdog(60);
  enum class Way { Pull, Set, Descriptor };
  for (const Way way : {Way::Pull, Way::Set, Way::Descriptor}) {
    CAPTURE(static_cast<int>(way));
    lot::ShmEngine engine(fresh());
    auto observer = engine.subscribe<Note>("/notes", observing());
    {
      auto pusher = engine.advertise<Note>("/notes");
      CHECK_FALSE(observer.try_pull());  // it has found the ring
    }
    CHECK_FALSE(observer.try_pull());
    CHECK(observer.status() == Status::PublisherGone);
    CHECK_FALSE(observer.try_pull());
    CHECK(observer.status() == Status::PublisherGone);
    int error = 0;
    lot::WaitSet set;
    if (way == Way::Set) {
      set.add(observer, [&] { error = error_of(observer); });
      (void)set.run_once(10ms);
    }
    const int fd = way == Way::Descriptor ? observer.fd() : -1;
    std::atomic<bool> has_learnt{false};
    std::thread retypes([&] {
      std::this_thread::sleep_for(50ms);
      const auto other = engine.advertise<Other>("/notes");
      while (!has_learnt) std::this_thread::sleep_for(1ms);
    });
    // Both may be called for nothing now and then.
    if (way == Way::Set) {
      while (error == 0 && set.run_once(10s) == 1) continue;
    } else if (way == Way::Descriptor) {
      pollfd readable{fd, POLLIN, 0};
      while (error == 0 && poll(&readable, 1, 10000) == 1) error = error_of(observer);
    } else {
      CHECK_THROWS_AS((void)observer.pull(10s), lot::Error);
      error = error_of(observer);
    }
    CHECK(error == ESTALE);
    has_learnt = true;
    retypes.join();
  }
}

TEST_CASE("an observer that may keep no more learns that its topic has another type") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto options = observing();
  options.max_held_bytes = 1;
  auto observer = engine.subscribe<Large>("/large", options);
  lot::ShmSharedPtr<const Large> kept;
  {
    auto pusher = engine.advertise<Large>("/large");
    auto large = pusher.loan();
    large->data.resize(10000);
    must_go(pusher.push(std::move(large)));
    kept = observer.pull(10s);
    REQUIRE(kept);
  }
  CHECK_FALSE(observer.try_pull());
  CHECK(observer.status() == Status::PublisherGone);
  const auto other = engine.advertise<Other>("/large");
  CHECK(error_of(observer) == ESTALE);
  CHECK_THROWS_AS((void)observer.pull(10s), lot::Error);
}

TEST_CASE("an observer of a topic whose last user goes leaves no topic behind") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  lot::segment::Segment segment(engine.path());
  {
    auto observer = engine.subscribe<Note>("/notes", observing());
    auto twin = engine.subscribe<Note>("/notes", observing());
    { auto pusher = engine.advertise<Note>("/notes"); }
    CHECK(segment.topics()[0].users[0].load() == 0);
    CHECK(segment.topics()[0].observers[0].load() != 0);
  }
  CHECK(segment.topics()[0].observers[0].load() == 0);
}
