// SPDX-License-Identifier: Apache-2.0
// Every function that takes a time, with the least, negative, no, much and the most time, in every
// unit. What has passed is answered at once, what never passes is waited for: the watchdog of the
// fixture ends a case that does otherwise.
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/both_engines.hpp"
#include "support/in_a_moment.hpp"
#include "support/must_go.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;
using lot::Wait;
using Clock = std::chrono::steady_clock;
using std::chrono::duration;

struct Number {
  int value = 0;
};
using Items = lot::ShmQueue<lot::ShmUniquePtr<Number>>;
using Views = lot::ShmQueue<lot::ShmSharedPtr<const Number>>;

/// Calls use(time) for lengths of time of this unit.
template <class Time, class Use>
void with_short(Use& use) {
  use(Time::min());
  use(Time(std::numeric_limits<typename Time::rep>::lowest() / 2));
  use(Time(-1));
  use(Time::zero());
}
template <class Use>
void with_each_short(Use&& use) {
  with_short<std::chrono::nanoseconds>(use);
  with_short<std::chrono::microseconds>(use);
  with_short<std::chrono::milliseconds>(use);
  with_short<std::chrono::seconds>(use);
  with_short<std::chrono::hours>(use);
  with_short<duration<int>>(use);
  with_short<duration<std::int8_t, std::ratio<1, 3>>>(use);
  with_short<duration<float>>(use);
  with_short<duration<double, std::pico>>(use);
  use(std::chrono::hours(-24 * 30));  // before the machine was started, most likely
  use(std::chrono::hours(-24 * 365 * 100));
  use(duration<double>(-std::numeric_limits<double>::infinity()));
  use(duration<double>(std::nan("")));
}
/// As long as can be said, or longer than anybody waits.
template <class Use>
void with_each_long(Use&& use) {
  use(std::chrono::nanoseconds::max());
  use(std::chrono::nanoseconds::max() - 1ns);
  use(std::chrono::microseconds::max());
  use(std::chrono::milliseconds::max());
  use(std::chrono::seconds::max());
  use(std::chrono::hours::max());
  use(std::chrono::hours(24 * 365 * 291));
  use(duration<unsigned long long>::max());
  use(duration<unsigned, std::ratio<86400>>::max());
  use(duration<float>::max());
  use(duration<double>(std::numeric_limits<double>::infinity()));
}

template <class Unit>
using At = std::chrono::time_point<Clock, Unit>;

/// Calls use(deadline) for times that have passed.
template <class Use>
void with_each_past(Use&& use) {
  use(Clock::time_point::min());
  use(Clock::time_point());
  use(Clock::time_point(-1ns));
  use(Clock::now() - 24h * 30);
  use(Clock::now() - 1ns);
  use(At<std::chrono::seconds>::min());
  use(At<std::chrono::hours>::min());
  use(At<std::chrono::hours>(std::chrono::hours(-1)));
  use(At<duration<double>>::min());
}
/// For some that nobody lives to see.
template <class Use>
void with_each_future(Use&& use) {
  use(Clock::time_point::max());
  use(Clock::time_point::max() - 1ns);
  use(Clock::now() + 24h * 365 * 100);
  use(At<std::chrono::milliseconds>::max());
  use(At<std::chrono::hours>::max());
  use(At<duration<double>>::max());
}

/// Puts until the queue is full.
template <class Put>
void fill(Put&& put) {
  while (put() == Status::Ok) {
  }
}

struct Fixture : BothEngines {
  /// So often each answer is asked for: a habit of spinning gives up after some that were in vain.
  static constexpr int kTimes = 6;

  template <class Test>
  void with_each_wait(Test&& test) {
    with_each_engine([&](QueueEngine engine) {
      for (const Wait wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) test(engine, wait);
    });
  }
};

}  // namespace

TEST_SUITE_BEGIN("deadlines");

TEST_CASE("a length of time that nanoseconds cannot tell is the nearest that they can") {
  constexpr auto kLeast = std::chrono::nanoseconds::min();
  constexpr auto kMost = std::chrono::nanoseconds::max();
  CHECK((lot::Duration(std::chrono::hours::max()) == kMost));
  CHECK((lot::Duration(std::chrono::hours::min()) == kLeast));
  CHECK((lot::Duration(std::chrono::microseconds::max()) == kMost));
  CHECK((lot::Duration(duration<unsigned long long>::max()) == kMost));
  CHECK((lot::Duration(duration<double>(1e300)) == kMost));
  CHECK((lot::Duration(duration<double>(std::nan(""))) == kLeast));
  CHECK((lot::Duration(kMost) == kMost));
  CHECK((lot::Duration(kLeast) == kLeast));
  CHECK((lot::Duration(std::chrono::hours(2562047)) == std::chrono::hours(2562047)));
  CHECK((lot::Duration(123'456'789us) == 123'456'789us));
  CHECK((lot::Duration(-1ms) == -1ms));
  CHECK((lot::Duration(duration<double>(0.25)) == 250ms));
  CHECK((lot::Duration(duration<std::int64_t, std::pico>(-7999)) == -8ns));
  CHECK((lot::Duration(duration<std::int64_t, std::pico>(-7499)) == -7ns));
  CHECK((lot::Deadline(At<std::chrono::hours>::max()) == Clock::time_point::max()));
  CHECK((lot::Deadline(At<std::chrono::seconds>(5s)) == Clock::time_point(5s)));
  static_assert(lot::Duration(20ms) == 20ms);
}

TEST_CASE("a length of time that falls between two nanoseconds is the nearer one") {
  using Third = duration<int, std::ratio<1, 3>>;
  CHECK((lot::Duration(duration<std::int64_t, std::pico>(1000)) == 1ns));
  CHECK((lot::Duration(duration<std::int64_t, std::pico>(1499)) == 1ns));
  CHECK((lot::Duration(duration<std::int64_t, std::pico>(1500)) == 2ns));
  CHECK((lot::Duration(duration<std::int64_t, std::pico>(-1000)) == -1ns));
  CHECK((lot::Duration(duration<double>(0.3)) == 300ms));
  CHECK((lot::Duration(duration<double>(-0.3)) == -300ms));
  CHECK((lot::Duration(duration<double, std::milli>(0.7)) == 700us));
  CHECK((lot::Duration(duration<long double, std::nano>(0.25L)) == 0ns));
  CHECK((lot::Duration(Third(3)) == 1s));
  CHECK((lot::Duration(Third(1)) == 333'333'333ns));
  CHECK((lot::Duration(Third(2)) == 666'666'667ns));
  CHECK((lot::Duration(duration<int, std::ratio<1, 60>>(60)) == 1s));
  // The last ones that nanoseconds can tell, of units without a fraction.
  constexpr std::int64_t kMost = std::chrono::nanoseconds::max().count();
  CHECK((lot::Duration(std::chrono::microseconds(kMost / 1000)).count() == kMost / 1000 * 1000));
  CHECK((lot::Duration(std::chrono::microseconds(-kMost / 1000)).count() == -kMost / 1000 * 1000));
  CHECK((lot::Duration(std::chrono::microseconds(kMost / 1000 + 1)).count() == kMost));
  CHECK((lot::Duration(duration<unsigned long long, std::nano>(kMost)).count() == kMost));
  CHECK((lot::Duration(duration<unsigned char>(255)) == 255s));
  CHECK((lot::Duration(duration<int, std::exa>(1)).count() == kMost));
  CHECK((lot::Duration(duration<int, std::exa>(0)) == 0ns));
  static_assert(lot::Duration(duration<double>(0.25)) == 250ms);
}

TEST_CASE("so much later than now is never earlier than now") {
  with_each_long([](auto time) {
    CHECK((lot::detail::after(lot::Duration(time)) > Clock::now() + 24h * 365 * 100));
  });
  with_each_short([](auto time) {
    const auto at = lot::detail::after(lot::Duration(time));
    CHECK((at <= Clock::now()));
  });
}

TEST_CASE_FIXTURE(Fixture, "a pull and a borrow whose time is up say so at once") {
  with_each_wait([&](QueueEngine engine, Wait wait) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t", {wait, 0});
    const auto all_end_with = [&](Status status) {
      with_each_short([&](auto time) {
        for (int n = 0; n < kTimes; ++n) {
          CHECK(!puller.pull(time));
          CHECK(puller.status() == status);
          CHECK(!puller.borrow(time));
          CHECK(puller.status() == status);
        }
      });
      with_each_past([&](auto deadline) {
        for (int n = 0; n < kTimes; ++n) {
          CHECK(!puller.pull_until(deadline));
          CHECK(puller.status() == status);
          CHECK(!puller.borrow_until(deadline));
          CHECK(puller.status() == status);
        }
      });
    };
    all_end_with(Status::PublisherGone);
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 64, 1s, engine});
    all_end_with(Status::Timeout);
    // What is there is had, however little time there is.
    with_each_short([&](auto time) {
      CHECK(pusher.push(pusher.loan(Number{1})) == Status::Ok);
      CHECK(puller.pull(time));
    });
    with_each_past([&](auto deadline) {
      CHECK(pusher.push(pusher.loan(Number{1})) == Status::Ok);
      CHECK(puller.borrow_until(deadline));
    });
  });
}

TEST_CASE_FIXTURE(Fixture, "a pull and a borrow with all the time there is wait for a message") {
  with_each_wait([&](QueueEngine engine, Wait wait) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t", {wait, 0});
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 64, 1s, engine});
    const auto push = [&] { must_go(pusher.push(pusher.loan(Number{1}))); };
    with_each_long([&](auto time) {
      {
        const InAMoment message(push);
        CHECK(puller.pull(time));
      }
      const InAMoment message(push);
      CHECK(puller.borrow(time));
    });
    with_each_future([&](auto deadline) {
      {
        const InAMoment message(push);
        CHECK(puller.pull_until(deadline));
      }
      const InAMoment message(push);
      CHECK(puller.borrow_until(deadline));
    });
  });
}

TEST_CASE_FIXTURE(Fixture, "a push and a put whose time is up say Full at once") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t");
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 2, 1h, engine});
    lot::QueueOptions small;
    small.engine = engine;
    small.depth = 2;
    auto items = shm.queue<lot::ShmUniquePtr<Number>>("items", small);
    auto views = shm.queue<lot::ShmSharedPtr<const Number>>("views", small);
    views.listen();
    lot::ShmSharedPtr<const Number> shared = pusher.loan(Number{1});
    CHECK(puller.publishers() == 1);  // it reads there from now on
    fill([&] { return pusher.try_push(pusher.loan()); });
    fill([&] { return items.try_put(items.make()); });
    fill([&] { return views.try_put(shared); });
    auto message = pusher.loan(Number{2});
    auto item = items.make(Number{2});
    with_each_short([&](auto time) {
      for (int n = 0; n < kTimes; ++n) {
        CHECK(pusher.push(std::move(message), time) == Status::Full);
        CHECK(pusher.push(shared, time) == Status::Full);
        CHECK(items.put_for(std::move(item), time) == Status::Full);
        CHECK(views.put_for(shared, time) == Status::Full);
      }
    });
    with_each_past([&](auto deadline) {
      for (int n = 0; n < kTimes; ++n) {
        CHECK(items.put_until(std::move(item), deadline) == Status::Full);
        CHECK(views.put_until(shared, deadline) == Status::Full);
      }
    });
    CHECK(message);
    CHECK(item);
    while (items.try_pop()) {
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a publisher's own patience may be any length of time") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t");
    const auto full = [&](auto time) {
      auto pusher = shm.advertise<Number>("/t", {Policy::Block, 2, time, engine});
      CHECK(puller.publishers() == 1);  // it reads there from now on
      fill([&] { return pusher.try_push(pusher.loan()); });
      return pusher;
    };
    with_each_short([&](auto time) {
      {
        auto pusher = full(time);
        CHECK(pusher.push(pusher.loan()) == Status::Full);
      }
      while (puller.try_pull()) {
      }
    });
    with_each_long([&](auto time) {
      {
        auto pusher = full(time);
        const InAMoment room([&] { return puller.pull(1h); });
        CHECK(pusher.push(pusher.loan()) == Status::Ok);
      }
      while (puller.try_pull()) {
      }
    });
  });
}

TEST_CASE_FIXTURE(Fixture, "a push and a put with all the time there is wait for room") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto puller = shm.subscribe<Number>("/t");
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 2, 0s, engine});
    lot::QueueOptions small;
    small.engine = engine;
    small.depth = 2;
    auto items = shm.queue<lot::ShmUniquePtr<Number>>("items", small);
    CHECK(puller.publishers() == 1);
    fill([&] { return pusher.try_push(pusher.loan()); });
    fill([&] { return items.try_put(items.make()); });
    const auto pull = [&] { return puller.pull(1h); };
    const auto pop = [&] { return items.wait_and_pop(); };
    with_each_long([&](auto time) {
      {
        const InAMoment room(pull);
        CHECK(pusher.push(pusher.loan(), time) == Status::Ok);
      }
      const InAMoment room(pop);
      CHECK(items.put_for(items.make(), time) == Status::Ok);
    });
    with_each_future([&](auto deadline) {
      const InAMoment room(pop);
      CHECK(items.put_until(items.make(), deadline) == Status::Ok);
    });
    while (items.try_pop()) {
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a pop whose time is up says so at once, one with all of it waits") {
  with_each_wait([&](QueueEngine engine, Wait wait) {
    lot::ShmEngine shm(options);
    lot::QueueOptions queue_options;
    queue_options.engine = engine;
    queue_options.wait = wait;
    auto items = shm.queue<lot::ShmUniquePtr<Number>>("items", queue_options);
    const auto put = [&] { must_go(items.put(items.make(Number{1}))); };
    with_each_short([&](auto time) {
      for (int n = 0; n < kTimes; ++n) CHECK(!items.wait_and_pop_for(time));
    });
    with_each_past([&](auto deadline) {
      for (int n = 0; n < kTimes; ++n) CHECK(!items.wait_and_pop_until(deadline));
    });
    with_each_long([&](auto time) {
      const InAMoment item(put);
      CHECK(items.wait_and_pop_for(time));
    });
    with_each_future([&](auto deadline) {
      const InAMoment item(put);
      CHECK(items.wait_and_pop_until(deadline));
    });
  });
}

TEST_CASE_FIXTURE(Fixture, "wait_for_readers() takes any length of time") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 2, 1s, engine});
    with_each_short([&](auto time) { CHECK(!pusher.wait_for_readers(1, time)); });
    with_each_long([&](auto time) {
      std::optional<lot::ShmPuller<Number>> puller;
      {
        const InAMoment reader([&] { puller.emplace(shm.subscribe<Number>("/t")); });
        CHECK(pusher.wait_for_readers(1, time));
      }
    });
  });
}

TEST_CASE_FIXTURE(Fixture, "a WaitSet waits and calls its timers after any length of time") {
  with_each_wait([&](QueueEngine engine, Wait wait) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", {Policy::Block, 64, 1s, engine});
    auto puller = shm.subscribe<Number>("/t", {wait, 0});
    lot::WaitSet set(wait);
    std::size_t messages = 0, calls = 0;
    set.add(puller, [&] {
      while (puller.try_pull()) ++messages;
    });
    const auto call = [&] { ++calls; };
    with_each_long([&](auto time) {  // never: they are all there in what follows
      set.add_timer(time, call);
      set.add_timer_once(time, call);
    });
    with_each_short([&](auto time) {
      for (int n = 0; n < kTimes; ++n) CHECK(set.run_once(time) == 0);
    });
    with_each_long([&](auto time) {
      const std::size_t before = messages;
      const InAMoment message([&] { must_go(pusher.push(pusher.loan(Number{1}))); });
      while (messages == before) set.run_once(time);
    });
    CHECK(calls == 0);
    with_each_short([&](auto time) {
      const std::size_t before = calls;
      set.add_timer_once(time, call);
      while (calls == before) set.run_once(1h);
      CHECK(set.run_once(0s) == 0);
      CHECK(calls == before + 1);
      CHECK_THROWS_AS(set.add_timer(time, call), lot::Error);
    });
    set.remove(puller);
  });
}

TEST_CASE_FIXTURE(Fixture, "a timer that was due long ago and is added anew leaves the others be") {
  lot::ShmEngine shm(options);
  auto pusher = shm.advertise<Number>("/t");
  auto puller = shm.subscribe<Number>("/t");
  lot::WaitSet set;
  bool heard = false;
  std::size_t calls = 0;
  set.add(puller, [&] { heard = puller.try_pull() != nullptr; });
  std::function<void()> again = [&] {
    ++calls;
    set.add_timer_once(-1h, again);
  };
  set.add_timer_once(-1h, again);
  CHECK(pusher.push(pusher.loan(Number{1})) == Status::Ok);
  CHECK(set.run_once(0s) == 2);
  CHECK(heard);
  CHECK(calls == 1);
  CHECK(set.run_once(0s) == 1);
  set.remove(puller);
}

TEST_SUITE_END();
