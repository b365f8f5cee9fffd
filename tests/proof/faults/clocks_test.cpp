// SPDX-License-Identifier: Apache-2.0

// The wall clock is set, by years and while processes sleep: nothing changes for them.

#include <cstdint>
#include <cstdio>
#include <string>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "registry/registry.hpp"
#include "support/janitor.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"
#include "wall_clock.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;
using lot::Wait;
using Clock = std::chrono::steady_clock;

struct Number {
  std::uint64_t value;
};

[[maybe_unused]] const bool has_clock = WallClock::take();
[[maybe_unused]] const bool has_janitor = start_janitor();

/// Says that a case can not be run here.
bool skipped() {
  if (WallClock::lacking().empty()) return false;
  std::printf("skipped: %s\n", WallClock::lacking().c_str());
  return true;
}

/// Sets the clock for the time of a case.
struct Jumps {
  ~Jumps() { WallClock::set(0); }
  /// Ten years on, forty years back, and to the true time, while others are at work.
  static void all() {
    for (const int years : {10, -30, 0}) {
      WallClock::set(years);
      usleep(20000);
    }
  }
};

}  // namespace

TEST_SUITE_BEGIN("clocks");

TEST_CASE("a pull with a deadline ends in its time, whatever the wall clock does meanwhile") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  const Jumps jumps;
  for (const auto wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
    for (const int years : {10, -30}) {
      CAPTURE(static_cast<int>(wait));
      CAPTURE(years);
      const Ground options;
      Steps waiting;
      WallClock::set(0);
      Child reader([&] {
        lot::ShmEngine engine(options);
        auto pusher = engine.advertise<Number>("/t");
        auto puller = engine.subscribe<Number>("/t", {wait, 0});
        const int year = WallClock::year();
        const auto start = Clock::now();
        waiting.tell();
        must(!puller.pull(150ms) && puller.status() == Status::Timeout, "Timeout");
        must(Clock::now() - start >= 150ms, "not before its time");
        must(eventually([&] { return WallClock::year() == year + years; }), "the other year");
        must_go(pusher.push(pusher.loan(std::uint64_t{7})));
        must(puller.pull(150ms)->value == 7, "it goes on");
      });
      REQUIRE(waiting.next() == '.');
      usleep(30000);
      WallClock::set(years);
      CHECK(reader.wait() == 0);
      CHECK(files_of(options) == 0);
    }
  }
}

TEST_CASE("a sleeper without a deadline is woken, and one with a far one too") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  const Jumps jumps;
  for (const bool forever : {true, false}) {
    CAPTURE(forever);
    const Ground options;
    Steps sleeping;
    Child reader([&] {
      lot::ShmEngine engine(options);
      auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
      sleeping.tell();
      const auto seen = forever ? puller.pull() : puller.pull(std::chrono::hours(24 * 365 * 20));
      must(seen && seen->value == 7, "the message");
    });
    REQUIRE(sleeping.next() == '.');
    usleep(20000);
    Jumps::all();
    WallClock::set(10);
    Child writer([&] {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t");
      must(pusher.wait_for_readers(1, 10s), "the reader");
      usleep(20000);
      must_go(pusher.push(pusher.loan(std::uint64_t{7})));
    });
    CHECK(writer.wait() == 0);
    CHECK(reader.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a blocked push ends in its time, or goes on when there is room") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  const Jumps jumps;
  for (const bool room : {false, true}) {
    CAPTURE(room);
    const Ground options;
    Steps blocking, make_room, done;
    Child writer([&] {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t", {Policy::Block, 2, 1s});
      blocking.tell();
      must(pusher.wait_for_readers(1, 10s), "the reader");
      for (std::uint64_t n = 0; n < 2; ++n) must_go(pusher.push(pusher.loan(n)));
      const auto start = Clock::now();
      blocking.tell();
      if (room) {
        must(pusher.push(pusher.loan(std::uint64_t{2}), 50s) == Status::Ok, "room");
      } else {
        must(pusher.push(pusher.loan(std::uint64_t{2}), 150ms) == Status::Full, "Full");
        must(Clock::now() - start >= 150ms, "not before its time");
      }
    });
    REQUIRE(blocking.next() == '.');
    Child reader([&] {
      lot::ShmEngine engine(options);
      auto puller = engine.subscribe<Number>("/t");
      must(make_room.next() == '.', "the order");
      must(!room || puller.pull(10s)->value == 0, "the first");
      must(done.next() == '.', "the end");
    });
    REQUIRE(blocking.next() == '.');
    usleep(20000);
    Jumps::all();
    WallClock::set(10);
    make_room.tell();
    CHECK(writer.wait() == 0);
    done.tell();
    CHECK(reader.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a process that waits for the registry, or the gate, waits on when the clock is set") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  const Jumps jumps;
  const Ground options;
  Steps holding, wait, begun;
  Child keeper([&] {
    lot::ShmEngine engine(options);
    lot::segment::Segment s(engine.path());
    InOurName name(s);
    lot::registry::Registry registry(s, name);
    {
      const lot::registry::Registry::Lock lock(registry);
      holding.tell();
      must(wait.next() == '.', "the clock was set while the lock was held");
    }
    must(wait.next() == '.', "it has left again");
    lot::liveness::LockFile file(engine.path() + ".lock");
    must(file.enter_gate(5s), "the gate");
    holding.tell();
    must(wait.next() == '.', "and while the gate was held");
    file.leave_gate();
    must(wait.next() == '.', "the end");
  });
  const auto let_wait = [&](auto&& join_and_use) {
    REQUIRE(holding.next() == '.');
    Child waiting(join_and_use);
    REQUIRE(begun.next() == '.');
    usleep(20000);
    Jumps::all();
    int status = 0;
    CHECK(!waiting.ended(status));
    wait.tell();
    CHECK(waiting.wait() == 0);
    wait.tell();
  };
  let_wait([&] {
    lot::ShmEngine engine(options);
    begun.tell();
    auto pusher = engine.advertise<Number>("/t");
  });
  let_wait([&] {
    begun.tell();
    const lot::ShmEngine engine(options);
  });
  CHECK(keeper.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a warden goes on looking for the dead when the clock was set back by years") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  const Jumps jumps;
  for (const int years : {10, -30}) {
    CAPTURE(years);
    const Ground options;
    Steps joined, done;
    WallClock::set(0);
    Child living = member(options, "living", joined, done);
    Child dying = member(options, "dying", joined, done);
    for (int i = 0; i < 2; ++i) REQUIRE(joined.next() == '.');
    WallClock::set(years);
    {
      lot::segment::Segment s(file_of(options));
      // A death would wake it: it looks by itself, too.
      const auto& looked = s.sightings()[index_of(s, "living")].looked_ns;
      const auto before = looked.load();
      CHECK(eventually([&] { return looked.load() != before; }));
      const auto once = looked.load();
      CHECK(eventually([&] { return looked.load() != once; }));
    }
    dying.kill9();
    {
      lot::segment::Segment s(file_of(options));
      CHECK(eventually([&] { return index_of(s, "dying") == 0; }));
      CHECK(index_of(s, "living") != 0);
    }
    done.tell();
    CHECK(living.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_SUITE_END();
