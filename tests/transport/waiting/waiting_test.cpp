// SPDX-License-Identifier: Apache-2.0
// Every way to wait: spinning, parked, WaitSet, listeners and descriptors. Both engines.
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <fcntl.h>
#include <functional>
#include <memory>
#include <optional>
#include <poll.h>
#include <sched.h>
#include <stdexcept>
#include <string>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "support/both_engines.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "transport/participant.hpp"
#include "waiting/notifier.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::PullerOptions;
using lot::QueueEngine;
using lot::Status;
using lot::Wait;
using lot::WaitSet;
using Clock = std::chrono::steady_clock;

struct Number {
  std::uint64_t value = 0;
};

void publish(lot::ShmPusher<Number>& pusher, std::uint64_t value) {
  CHECK(pusher.push(pusher.loan(Number{value})) == Status::Ok);
}

struct Fixture : BothEngines {
  static lot::PusherOptions with(QueueEngine engine, std::uint32_t depth = 64) {
    return {Policy::Block, depth, 1s, engine};
  }
};

bool readable(int fd, int timeout_ms) {
  pollfd p{fd, POLLIN, 0};
  return poll(&p, 1, timeout_ms) == 1;
}

/// What a set and a descriptor wait for, played by the test.
struct Played : lot::detail::Waitable {
  bool ready() override { return has_news; }
  std::optional<Clock::time_point> arm(lot::detail::FutexWaits& waits) override {
    ++arms;
    if (throws) throw std::runtime_error("not armed");
    if (has_news) return std::nullopt;
    if (waits.hearer() != nullptr) {
      ++heard;
      if (channel) waits.hearer()->listen(*channel);
      if (version) waits.hearer()->watch_directory(*version);
    } else {
      for (std::size_t i = 0; i < words.size(); ++i) waits.push_back({&words[i], 0});
    }
    return again.value_or(Clock::now() + 1h);
  }
  std::shared_ptr<lot::waiting::EarOwner> ear_owner() noexcept override {
    ++asked;
    return owner;
  }

  bool has_news = false;
  bool throws = false;
  std::optional<Clock::time_point> again;
  std::vector<std::uint32_t> words = std::vector<std::uint32_t>(1);
  std::optional<std::uint32_t> channel;
  std::optional<std::uint32_t> version;
  std::shared_ptr<lot::waiting::EarOwner> owner;
  int arms = 0;
  int heard = 0;  ///< of arms: by an ear
  int asked = 0;  ///< for an ear
};

std::size_t claimed_ears(const lot::segment::Segment& segment) {
  std::size_t claimed = 0;
  for (std::uint32_t e = lot::segment::kFirstFreeEar; e < lot::ring::kEars; ++e) {
    claimed += segment.ear(e).words->owner.load() != 0;
  }
  return claimed;
}

}  // namespace

TEST_SUITE_BEGIN("waiting");

TEST_CASE_FIXTURE(Fixture, "each way to wait sees each message, from processes that come and go") {
  with_each_engine([&](QueueEngine engine) {
    for (const Wait wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
      lot::ShmEngine shm(options);
      auto puller = shm.subscribe<Number>("/t", {wait, 0});
      for (std::uint64_t p = 0; p < 3; ++p) {
        Child publisher([&] {
          lot::ShmEngine mine(options);
          auto pusher = mine.advertise<Number>("/t", with(engine, 4));
          must(pusher.wait_for_readers(1, 10s), "a reader");
          for (std::uint64_t n = 0; n < 100; ++n) {
            if (n % 25 == 0) std::this_thread::sleep_for(1ms);
            must(pusher.push(pusher.loan(Number{n}), 10s) == Status::Ok, "push");
          }
        });
        for (std::uint64_t n = 0; n < 100; ++n) {
          const auto message = puller.pull(20s);
          REQUIRE(message);
          CHECK(message->value == n);
        }
        CHECK_FALSE(puller.pull(20s));
        CHECK(puller.status() == Status::PublisherGone);
        CHECK(publisher.wait() == 0);
      }
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a reader with history gets the newest messages from before it came") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    for (const Policy policy : {Policy::Overwrite, Policy::Refuse}) {
      auto pusher = shm.advertise<Number>("/t", {policy, 8, 1s, engine});
      for (std::uint64_t n = 0; n < 20; ++n) publish(pusher, n);
      for (const std::uint64_t history : {0UL, 1UL, 3UL}) {  // latched: 1
        auto puller = shm.subscribe<Number>("/t", {Wait::Park, history});
        CHECK(puller.size() == history);
        for (std::uint64_t n = 20 - history; n < 20; ++n) {
          const auto message = puller.try_pull();
          REQUIRE(message);
          CHECK(message->value == n);
        }
        CHECK(!puller.try_pull());
        CHECK(puller.missed_total() == 0);
      }
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a publisher under Policy::Refuse never waits") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", {Policy::Refuse, 2, 1h, engine});
    auto puller = shm.subscribe<Number>("/t");
    publish(pusher, 1);
    publish(pusher, 2);
    auto third = pusher.loan(Number{3});
    CHECK(pusher.push(std::move(third)) == Status::Full);
    CHECK(pusher.push(std::move(third), 1h) == Status::Full);
    REQUIRE(third);
    CHECK(puller.pull(1s)->value == 1);
    CHECK(pusher.push(std::move(third)) == Status::Ok);
    CHECK(puller.pull(1s)->value == 2);
    CHECK(puller.pull(1s)->value == 3);
  });
}

TEST_CASE_FIXTURE(Fixture, "one WaitSet serves many pullers, timers and a stop request") {
  with_each_engine([&](QueueEngine engine) {
    for (const Wait wait : {Wait::Park, Wait::Adaptive, Wait::Spin}) {
      lot::ShmEngine shm(options);
      constexpr std::size_t kTopics = 5;
      constexpr std::uint64_t kMessages = 200;
      WaitSet set(wait);
      std::vector<std::unique_ptr<lot::ShmPuller<Number>>> pullers;
      std::vector<std::uint64_t> next(kTopics, 0);
      std::uint64_t ticks = 0, once = 0;
      std::size_t done = 0;
      for (std::size_t t = 0; t < kTopics; ++t) {
        pullers.push_back(std::make_unique<lot::ShmPuller<Number>>(
            shm.subscribe<Number>("/t" + std::to_string(t))));
        set.add(*pullers[t], [&, t] {
          const auto message = pullers[t]->try_pull();  // one at a time: it is called again
          if (!message) return;
          CHECK(message->value == next[t]++);
          if (next[t] == kMessages && ++done == kTopics) set.stop();
        });
      }
      set.add_timer(1ms, [&] { ++ticks; });
      set.add_timer_once(1ms, [&] { ++once; });
      const Steps finished;
      Child publisher([&] {
        lot::ShmEngine mine(options);
        std::vector<lot::ShmPusher<Number>> pushers;
        for (std::size_t t = 0; t < kTopics; ++t) {
          pushers.push_back(mine.advertise<Number>("/t" + std::to_string(t), with(engine, 8)));
        }
        for (std::uint64_t n = 0; n < kMessages; ++n) {
          for (auto& pusher : pushers) {
            must(pusher.push(pusher.loan(Number{n}), 10s) == Status::Ok, "push");
          }
          if (n % 20 == 0) std::this_thread::sleep_for(1ms);
        }
        must(finished.next(30s) != 0, "all is read");
      });
      set.run();
      finished.tell();
      for (const std::uint64_t n : next) CHECK(n == kMessages);
      CHECK(ticks > 0);
      CHECK(once == 1);
      for (auto& puller : pullers) set.remove(*puller);
      pullers.clear();
      CHECK(publisher.wait() == 0);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a WaitSet of more queues than the kernel waits for at once") {
  lot::ShmEngine shm(options);
  constexpr std::size_t kPullers = 300;
  WaitSet set;
  std::vector<std::unique_ptr<lot::ShmPuller<Number>>> pullers;
  std::vector<lot::ShmPusher<Number>> pushers;
  std::vector<std::uint64_t> got(kPullers, 0);
  for (std::size_t t = 0; t < kPullers; ++t) {
    const std::string topic = "/t" + std::to_string(t);
    pushers.push_back(shm.advertise<Number>(topic, {Policy::Overwrite, 2, 1s}));
    pullers.push_back(std::make_unique<lot::ShmPuller<Number>>(shm.subscribe<Number>(topic)));
    set.add(*pullers[t], [&, t] {
      while (const auto message = pullers[t]->try_pull()) got[t] = message->value;
    });
  }
  CHECK(set.run_once(1ms) == 0);
  for (const std::size_t t : {std::size_t{0}, kPullers / 2, kPullers - 1}) {
    std::thread publisher([&] {
      std::this_thread::sleep_for(20ms);  // most likely asleep by now
      must_go(pushers[t].push(pushers[t].loan(Number{7})));
    });
    CHECK(set.run_once(20s) == 1);
    CHECK(got[t] == 7);
    publisher.join();
  }
}

TEST_CASE_FIXTURE(Fixture, "a WaitSet is stopped from another thread and from a signal handler") {
  lot::ShmEngine shm(options);
  auto puller = shm.subscribe<Number>("/t");
  static WaitSet* set;
  WaitSet mine;
  set = &mine;
  mine.add(puller, [] {});
  std::thread other([] {
    std::this_thread::sleep_for(10ms);
    set->stop();
  });
  mine.run();
  other.join();
  mine.stop();
  mine.run();  // a stop that came before ends the next run at once
  CHECK(mine.run_once(1ms) == 0);
  mine.stop();
  CHECK(mine.run_once(1h) == 0);
  struct sigaction action {};
  struct sigaction before {};
  action.sa_handler = [](int) { set->stop(); };
  sigaction(SIGUSR1, &action, &before);
  const pthread_t self = pthread_self();
  std::thread signaller([self] {
    std::this_thread::sleep_for(10ms);
    pthread_kill(self, SIGUSR1);
  });
  mine.run();
  signaller.join();
  sigaction(SIGUSR1, &before, nullptr);
}

TEST_CASE("a timer of a WaitSet is never early, and once late it leaves out what has passed") {
  // Only too early is wrong: a machine at work may be late by any time.
  constexpr auto kPeriod = 5ms;
  WaitSet set;
  const auto begin = std::chrono::steady_clock::now();
  int calls = 0, other = 0;
  bool early = false;
  std::optional<std::chrono::steady_clock::time_point> woke;
  set.add_timer(kPeriod, [&] {
    ++calls;
    early = early || std::chrono::steady_clock::now() < begin + calls * kPeriod;
    if (calls != 3) return;
    std::this_thread::sleep_for(10 * kPeriod);
    woke = std::chrono::steady_clock::now();
  });
  set.add_timer_once(7ms, [&] {
    ++other;
    early = early || std::chrono::steady_clock::now() < begin + 7ms;
  });
  while (!woke) set.run_once(1h);
  CHECK_FALSE(early);
  CHECK(other == 1);
  // One that is overdue, one that may be due at any moment, and then one in each period.
  for (int n = 0; n < 4; ++n) CHECK(set.run_once(1h) == 1);
  CHECK(std::chrono::steady_clock::now() >= *woke + 2 * kPeriod);
}

TEST_CASE("a WaitSet wakes for the earliest of its timers, in whichever order they came") {
  const Watchdog watchdog(60);
  for (const bool early_first : {true, false}) {
    WaitSet set;
    int early = 0, late = 0;
    if (early_first) set.add_timer_once(2ms, [&] { ++early; });
    set.add_timer(1h, [&] { ++late; });
    if (!early_first) set.add_timer_once(2ms, [&] { ++early; });
    CHECK(set.run_once(1h) == 1);
    CHECK(early == 1);
    CHECK(late == 0);
    CHECK(set.run_once(1ms) == 0);  // the one that is left is far away
  }
}

TEST_CASE("a timer that a handler adds waits for the next turn, though it is overdue") {
  const Watchdog watchdog(60);
  WaitSet set;
  int calls = 0;
  std::function<void()> again = [&] {
    ++calls;
    set.add_timer_once(-1s, again);
  };
  set.add_timer_once(0s, again);
  for (int n = 1; n <= 3; ++n) {
    CHECK(set.run_once(1h) == 1);
    CHECK(calls == n);
  }
}

TEST_CASE("a WaitSet whose timer throws calls the others in the next turn, and that one again") {
  const Watchdog watchdog(60);
  WaitSet set;
  int thrown = 0, others = 0;
  set.add_timer(20ms, [&] {
    ++thrown;
    throw std::runtime_error("no picture");
  });
  set.add_timer(1ms, [&] { ++others; });
  set.add_timer_once(0s, [] { throw std::runtime_error("once"); });
  int failed = 0;
  while (thrown < 3 || others == 0) {  // else the watchdog
    try {
      set.run_once(1h);
    } catch (const std::runtime_error& e) {
      failed += std::string(e.what()) == "once";
    }
  }
  CHECK(failed == 1);
}

TEST_CASE("a WaitSet removes the timer that it is told to, and no other") {
  WaitSet set;
  int first = 0, second = 0, third = 0;
  set.add_timer(1ms, [&] { ++first; });
  const WaitSet::Timer timer = set.add_timer(1ms, [&] { ++second; });
  set.add_timer(1ms, [&] { ++third; });
  set.remove(timer);
  while (first == 0 || third == 0) set.run_once(1h);
  CHECK(second == 0);
}

TEST_CASE("a WaitSet forgets the handler of a timer that was removed, or called once") {
  WaitSet set;
  auto held = std::make_shared<int>();
  const std::weak_ptr<int> seen = held;
  set.add_timer_once(0s, [held] {});
  set.remove(set.add_timer(1h, [held] {}));
  held.reset();
  CHECK(set.run_once(1h) == 1);
  CHECK(seen.expired());
}

TEST_CASE_FIXTURE(Fixture, "a WaitSet refuses an empty handler and a period of nothing") {
  lot::ShmEngine shm(options);
  auto puller = shm.subscribe<Number>("/t");
  WaitSet set;
  const auto refused = [](auto&& add, const char* why) {
    CHECK_THROWS_WITH_AS(add(), doctest::Contains(why), lot::Error);
  };
  refused([&] { set.add(puller, nullptr); }, "a handler is empty");
  refused([&] { set.add_timer(1s, nullptr); }, "a handler is empty");
  refused([&] { set.add_timer_once(0s, nullptr); }, "a handler is empty");
  refused([&] { set.add_timer(0s, [] {}); }, "longer than nothing");
  CHECK(set.run_once(1ms) == 0);
}

TEST_CASE_FIXTURE(Fixture, "handlers of a WaitSet may add, remove, also themselves, and throw") {
  lot::ShmEngine shm(options);
  auto pusher = shm.advertise<Number>("/t");
  auto one = shm.subscribe<Number>("/t");
  auto two = shm.subscribe<Number>("/t");
  WaitSet set;
  int first = 0, second = 0;
  set.add(one, [&] {
    ++first;
    set.remove(one);
    set.add(two, [&] {
      ++second;
      while (two.try_pull()) {
      }
    });
  });
  publish(pusher, 1);
  CHECK(set.run_once(1s) >= 1);
  while (set.run_once(10ms) != 0) {
  }
  CHECK(first == 1);
  CHECK(second == 1);
  const WaitSet::Timer timer = set.add_timer(1ms, [] { throw std::runtime_error("as it likes"); });
  CHECK_THROWS_AS(set.run(), std::runtime_error);
  set.remove(timer);
  CHECK(set.run_once(5ms) == 0);
  CHECK_THROWS_AS(set.add_timer(0s, [] {}), lot::Error);
}

TEST_CASE_FIXTURE(Fixture, "a ShmListener calls back for each message, on the thread asked for") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    std::atomic<std::uint64_t> next{0};
    std::atomic<bool> as_asked{true};
    lot::ThreadOptions thread;
    thread.name = "camera-in";
    thread.cpus = {0};
    thread.policy = SCHED_BATCH;
    {
      const auto listener = shm.listen<Number>(
          "/t",
          [&](const lot::ShmSharedPtr<const Number>& message) {
            char name[16] = {};
            pthread_getname_np(pthread_self(), name, sizeof(name));
            int policy = -1;
            sched_param parameters{};
            pthread_getschedparam(pthread_self(), &policy, &parameters);
            cpu_set_t cpus;
            pthread_getaffinity_np(pthread_self(), sizeof(cpus), &cpus);
            if (std::string(name) != "camera-in" || policy != SCHED_BATCH ||
                CPU_COUNT(&cpus) != 1 || !CPU_ISSET(0, &cpus) || message->value != next) {
              as_asked = false;
            }
            ++next;
          },
          {}, thread);
      const Steps finished;
      Child publisher([&] {
        lot::ShmEngine mine(options);
        auto pusher = mine.advertise<Number>("/t", with(engine));
        for (std::uint64_t n = 0; n < 500; ++n) {
          must(pusher.push(pusher.loan(Number{n}), 10s) == Status::Ok, "push");
        }
        must(finished.next(30s) != 0, "all is read");
      });
      CHECK(eventually([&] { return next == 500; }, 20s));
      finished.tell();
      CHECK(as_asked);
    }
    const std::uint64_t last = next;
    auto pusher = shm.advertise<Number>("/t", {Policy::Overwrite, 8, 1s, engine});
    publish(pusher, 1);
    std::this_thread::sleep_for(5ms);
    CHECK(next == last);  // it has ended
  });
}

TEST_CASE_FIXTURE(Fixture, "a ShmListener whose thread cannot be had says why") {
  lot::ShmEngine shm(options);
  const auto ignore = [](const lot::ShmSharedPtr<const Number>&) {};
  lot::ThreadOptions thread;
  thread.cpus = {1023};
  CHECK_THROWS_WITH_AS((void)shm.listen<Number>("/t", ignore, {}, thread),
                       doctest::Contains("ThreadOptions::cpus"), lot::Error);
  thread = {};
  thread.policy = SCHED_FIFO;
  thread.priority = 1000;
  CHECK_THROWS_WITH_AS((void)shm.listen<Number>("/t", ignore, {}, thread),
                       doctest::Contains("ThreadOptions::policy"), lot::Error);
}

TEST_CASE_FIXTURE(Fixture, "fd() is readable while there are messages, for poll and epoll") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    auto puller = shm.subscribe<Number>("/t");
    const int fd = puller.fd();
    CHECK(puller.fd() == fd);
    CHECK(!readable(fd, 0));
    const int loop = epoll_create1(EPOLL_CLOEXEC);
    epoll_event wanted{EPOLLIN, {}};
    REQUIRE(epoll_ctl(loop, EPOLL_CTL_ADD, fd, &wanted) == 0);
    for (std::uint64_t n = 0; n < 200; ++n) {
      publish(pusher, 2 * n);
      publish(pusher, 2 * n + 1);
      epoll_event event{};
      REQUIRE(epoll_wait(loop, &event, 1, 20'000) == 1);
      for (std::uint64_t i = 0; i < 2; ++i) {
        REQUIRE(readable(fd, 20'000));  // level-triggered: until all are read
        const auto message = puller.try_pull();
        REQUIRE(message);
        CHECK(message->value == 2 * n + i);
      }
      CHECK(!puller.try_pull());
      CHECK(!readable(fd, 0));
    }
    close(loop);
    // From another process, and from a publisher that was not there before.
    const Steps finished;
    Child publisher([&] {
      lot::ShmEngine mine(options);
      auto late = mine.advertise<Number>("/t", with(engine));
      must(late.push(late.loan(Number{77}), 1s) == Status::Ok, "push");
      must(finished.next(30s) != 0, "all is read");
    });
    for (bool got = false; !got;) {
      REQUIRE(readable(fd, 20'000));
      const auto message = puller.try_pull();
      got = message && message->value == 77;
    }
    finished.tell();
    CHECK(publisher.wait() == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "fd() of an idle puller is readable once in a while") {
  // So its reader looks by itself, whatever the thread has failed to hear.
  lot::ShmEngine shm(options);
  auto pusher = shm.advertise<Number>("/t");
  auto first = shm.subscribe<Number>("/t");
  auto second = shm.subscribe<Number>("/t");
  const int fd = first.fd();
  REQUIRE(readable(fd, 20'000));
  CHECK(!first.try_pull());
  // A descriptor that is watched anew all the time does not put the others off.
  second.fd();
  while (!readable(fd, 10)) CHECK(!second.try_pull());  // else the watchdog
}

TEST_CASE_FIXTURE(Fixture, "fd() of an idle puller has a time of its own beside another's") {
  lot::ShmEngine shm(options);
  auto first = shm.subscribe<Number>("/t");
  auto second = shm.subscribe<Number>("/t");
  const int earlier = first.fd();
  std::this_thread::sleep_for(300ms);  // so that they do not become readable together
  const int later = second.fd();
  CHECK(readable(later, 20'000));
  CHECK(readable(earlier, 0));
}

TEST_CASE_FIXTURE(Fixture, "fd() of a puller that has gone is closed, and never written to") {
  lot::ShmEngine shm(options);
  auto pusher = shm.advertise<Number>("/t");
  auto other = shm.subscribe<Number>("/other");
  const int theirs = other.fd();
  const int event = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  int fd = -1;
  {
    auto puller = shm.subscribe<Number>("/t");
    fd = puller.fd();
  }
  // What the program opens next has its number, unless a thread of the library has it just now.
  int ours = -1;
  REQUIRE(eventually([&] {
    ours = fcntl(event, F_DUPFD_CLOEXEC, fd);
    if (ours != fd) close(ours);
    return ours == fd;
  }));
  publish(pusher, 1);
  // When this one's time has come, the time of the one that has gone has passed, too.
  for (int n = 0; n < 2; ++n) {
    REQUIRE(readable(theirs, 20'000));
    CHECK(!other.try_pull());
  }
  CHECK(!readable(ours, 0));
  close(ours);
  close(event);
}

TEST_CASE_FIXTURE(Fixture, "a WaitSet beside a borrow leaves the borrow alone") {
  lot::ShmEngine shm(options);
  auto first = std::make_unique<lot::ShmPusher<Number>>(shm.advertise<Number>("/t"));
  auto second = shm.advertise<Number>("/t");
  auto puller = shm.subscribe<Number>("/t");
  publish(second, 100);
  auto borrow = puller.borrow(1s);
  REQUIRE(borrow);
  first.reset();
  WaitSet set;
  set.add(puller, [] {});
  set.run_once(1ms);
  borrow.end();
  publish(second, 101);
  CHECK(puller.pull(1s)->value == 101);
  set.remove(puller);
}

TEST_CASE_FIXTURE(Fixture, "all ways to wait go on after a stopped process has had the lock") {
  lot::ShmEngine shm(options);
  auto pusher = shm.advertise<Number>("/t", with(QueueEngine::Mutex));
  auto puller = shm.subscribe<Number>("/t");
  const int fd = puller.fd();
  std::atomic<int> errors{0};
  std::atomic<std::uint64_t> heard{0};
  lot::ThreadOptions thread;
  thread.on_error = [&](const lot::Error&) { ++errors; };
  const auto listener = shm.listen<Number>(
      "/t", [&](const lot::ShmSharedPtr<const Number>& message) { heard = message->value; }, {},
      thread);
  publish(pusher, 1);
  REQUIRE(eventually([&] { return heard == 1; }));
  Steps steps;
  Child owner([&] {
    lot::ShmEngine mine(options);  // in whose name it locks
    lot::segment::Segment segment(mine.path());
    InOurName name(segment);
    for (std::uint32_t c = 0; c < segment.capacity().channels; ++c) {
      if (segment.ring(c).arrived == nullptr) continue;
      segment.queue_lock(c, name).lock();
      steps.tell();
      pause();
    }
  });
  REQUIRE(steps.next() != 0);
  CHECK(puller.size() == 1);
  CHECK_THROWS_WITH_AS((void)puller.try_pull(), doctest::Contains("lock of a queue"), lot::Error);
  owner.kill9();
  CHECK(readable(fd, 20'000));
  CHECK(puller.pull(20s)->value == 1);
  publish(pusher, 2);
  CHECK(eventually([&] { return heard == 2; }));
  CHECK(readable(fd, 20'000));
  CHECK(puller.pull(20s)->value == 2);
}

TEST_CASE_FIXTURE(Fixture, "a forked child of a process with fd() and a ShmListener ends") {
  lot::ShmEngine shm(options);
  auto puller = std::make_unique<lot::ShmPuller<Number>>(shm.subscribe<Number>("/t"));
  puller->fd();
  std::optional<lot::ShmListener> listener =
      shm.listen<Number>("/t", [](const lot::ShmSharedPtr<const Number>&) {});
  Child child([&] {
    // Threads of the child's own, where those that it has not inherited were.
    std::atomic<bool> done{false};
    std::vector<std::thread> others;
    for (int n = 0; n < 4; ++n) {
      others.emplace_back([&] {
        while (!done) std::this_thread::sleep_for(1ms);
      });
    }
    puller.reset();
    listener.reset();
    done = true;
    for (std::thread& other : others) other.join();
  });
  CHECK(child.wait() == 0);
}

TEST_CASE("a set calls each that has news, once in a round, and arms each of the others") {
  const Watchdog watchdog(60);
  WaitSet set;
  std::vector<Played> all(4);
  std::vector<int> calls(4);
  for (std::size_t i = 0; i < 4; ++i) {
    set.add(all[i], [&, i] {
      ++calls[i];
      all[i].has_news = false;
    });
  }
  all[1].has_news = all[3].has_news = true;
  CHECK(set.run_once(1h) == 2);
  CHECK(calls == std::vector{0, 1, 0, 1});
  for (const Played& one : all) CHECK(one.arms == 1);
  // One that keeps its news is called in each round.
  set.remove(all[0]);
  set.add(all[0], [&] { ++calls[0]; });
  all[0].has_news = true;
  for (int n = 1; n <= 3; ++n) {
    CHECK(set.run_once(1h) == 1);
    CHECK(calls[0] == n);
  }
  all[0].has_news = false;
  CHECK(set.run_once(0s) == 0);
  CHECK(set.run_once(-1h) == 0);
  CHECK(set.run_once_until(Clock::time_point::min()) == 0);
  CHECK(calls == std::vector{3, 1, 0, 1});
  // None that was removed is looked at any more.
  for (Played& one : all) set.remove(one);
  set.remove(all[0]);  // nothing
  std::vector<int> arms;
  for (const Played& one : all) arms.push_back(one.arms);
  for (Played& one : all) one.has_news = true;
  CHECK(set.run_once(1ms) == 0);
  for (std::size_t i = 0; i < 4; ++i) CHECK(all[i].arms == arms[i]);
  CHECK(calls == std::vector{3, 1, 0, 1});
}

TEST_CASE("a set wakes at the earliest time that one must be looked at again") {
  const Watchdog watchdog(60);
  for (std::size_t its = 0; its < 3; ++its) {
    CAPTURE(its);
    WaitSet set;
    std::vector<Played> all(3);
    int calls = 0;
    for (Played& one : all) set.add(one, [&] { ++calls; });
    const auto soon = Clock::now() + 3ms;
    all[its].again = soon;
    // It is armed anew when its time has come, and says then that it has news.
    struct Later : Played {
      std::optional<Clock::time_point> arm(lot::detail::FutexWaits& waits) override {
        has_news = again && Clock::now() >= *again;
        return Played::arm(waits);
      }
    } later;
    later.again = soon;
    bool called = false;
    set.add(later, [&] {
      called = true;
      later.again.reset();
    });
    CHECK(set.run_once(1h) == 1);
    CHECK(called);
    CHECK(calls == 0);
    CHECK(Clock::now() >= soon);
  }
}

TEST_CASE("a set whose handler throws, stops or removes leaves the others due") {
  const Watchdog watchdog(60);
  WaitSet set;
  std::vector<Played> all(3);
  std::vector<int> calls(3);
  bool throws = true;
  set.add(all[0], [&] {
    ++calls[0];
    if (throws) throw std::runtime_error("no picture");
    all[0].has_news = false;
  });
  for (std::size_t i = 1; i < 3; ++i) {
    set.add(all[i], [&, i] {
      ++calls[i];
      all[i].has_news = false;
    });
  }
  for (Played& one : all) one.has_news = true;
  CHECK_THROWS_WITH((void)set.run_once(1h), "no picture");
  CHECK(calls == std::vector{1, 0, 0});
  throws = false;
  CHECK(set.run_once(1h) == 3);
  CHECK(calls == std::vector{2, 1, 1});

  // A stop leaves the rest of the round out, and is told once.
  WaitSet other;
  int first = 0, second = 0;
  all[0].has_news = all[1].has_news = true;
  other.add(all[0], [&] {
    ++first;
    other.stop();
  });
  other.add(all[1], [&] { ++second; });
  CHECK(other.run_once(1h) == 1);
  CHECK(first == 1);
  CHECK(second == 0);
  CHECK(other.run_once(1h) == 0);  // it was stopped
  CHECK(first == 1);
  other.remove(all[0]);
  CHECK(other.run_once(1h) == 1);
  CHECK(second == 1);
  // One that another handler removes is not called in the same round.
  WaitSet third;
  int removed = 0;
  third.add(all[0], [&] { third.remove(all[1]); });
  third.add(all[1], [&] { ++removed; });
  CHECK(third.run_once(1h) == 1);
  CHECK(removed == 0);
}

TEST_CASE("a handler of a set may add one, which is looked at in the same round") {
  const Watchdog watchdog(60);
  WaitSet set;
  std::vector<Played> all(20);
  int calls = 0;
  std::size_t next = 1;
  std::function<void()> more = [&] {
    ++calls;
    all[next - 1].has_news = false;
    if (next == all.size()) return;
    all[next].has_news = true;
    set.add(all[next++], more);
  };
  all[0].has_news = true;
  set.add(all[0], more);
  CHECK(set.run_once(1h) == 20);
  CHECK(calls == 20);
  for (const Played& one : all) CHECK(one.arms == 1);
  CHECK(set.run_once(0s) == 0);
}

TEST_CASE("timers of a set are called in their order, as often as they are due, and not before") {
  const Watchdog watchdog(60);
  WaitSet set;
  std::vector<int> order;
  set.add_timer_once(-1ms, [&] { order.push_back(1); });
  set.add_timer_once(0s, [&] { order.push_back(2); });
  const WaitSet::Timer far = set.add_timer(1h, [&] { order.push_back(3); });
  const WaitSet::Timer once = set.add_timer_once(1h, [&] { order.push_back(4); });
  CHECK(far != once);
  CHECK(set.run_once(1h) == 2);
  CHECK(order == std::vector{1, 2});
  CHECK(set.run_once(2ms) == 0);
  CHECK(order.size() == 2);
  // Between two handlers a stop leaves the other timers out.
  int third = 0;
  set.add_timer_once(0s, [&] { set.stop(); });
  set.add_timer_once(0s, [&] { ++third; });
  CHECK(set.run_once(1h) == 1);
  CHECK(third == 0);
  CHECK(set.run_once(1h) == 0);
  CHECK(set.run_once(1h) == 1);
  CHECK(third == 1);
  // Timers and what else has news are called in one round.
  Played one;
  one.has_news = true;
  set.add(one, [&] { one.has_news = false; });
  set.add_timer_once(0s, [&] { ++third; });
  CHECK(set.run_once(1h) == 2);
  CHECK(third == 2);
}

TEST_CASE("a handler of a set may remove the timer that comes next, and its own") {
  const Watchdog watchdog(60);
  WaitSet set;
  int calls = 0, others = 0;
  WaitSet::Timer own{}, next{};
  own = set.add_timer(1ns, [&] {
    ++calls;
    set.remove(own);
    set.remove(next);
    set.remove(WaitSet::Timer{99});  // nothing
  });
  next = set.add_timer(1ns, [&] { ++others; });
  CHECK(set.run_once(1h) == 1);
  CHECK(set.run_once(1ms) == 0);
  CHECK(calls == 1);
  CHECK(others == 0);
}

TEST_CASE("what a set refuses it says in full") {
  WaitSet set;
  Played one;
  const auto refused = [](auto&& add, const char* object, const char* reason, const char* advice) {
    const lot::Error expected(EINVAL, object, reason, advice);
    CHECK_THROWS_WITH_AS(add(), expected.what(), lot::Error);
    try {
      add();
    } catch (const lot::Error& e) {
      CHECK(e.error_number() == EINVAL);
    }
  };
  const char* empty = "a handler is empty";
  const char* give = "give a function to be called";
  refused([&] { set.add(one, nullptr); }, "WaitSet", empty, give);
  refused([&] { set.add_timer(1s, nullptr); }, "WaitSet", empty, give);
  refused([&] { set.add_timer_once(0s, nullptr); }, "WaitSet", empty, give);
  for (const auto period : {0ns, -1ns, -3'600'000'000'000ns}) {
    refused([&] { set.add_timer(period, [] {}); }, "WaitSet::add_timer",
            "a period must be longer than nothing",
            "use add_timer_once() for what is to be done once");
  }
  one.has_news = true;
  CHECK(set.run_once(0s) == 0);
  CHECK(one.arms == 0);
  CHECK_NOTHROW(set.add_timer(1ns, [] {}));
}

TEST_CASE("a set asks for ears once it has more than eight words") {
  const Watchdog watchdog(60);
  for (const std::size_t words : {8UL, 9UL}) {
    CAPTURE(words);
    const bool is_many = words > 8;
    // In one that has them all, in one for each word.
    for (const bool one_each : {false, true}) {
      WaitSet set;
      std::vector<Played> all(one_each ? words : 2);
      if (!one_each) all[0].words.resize(words - 1);
      for (Played& one : all) set.add(one, [] {});
      CHECK(set.run_once(1ms) == 0);
      for (const Played& one : all) {
        CHECK((one.asked != 0) == is_many);
        CHECK(one.heard == 0);  // there is none to be had
      }
      // Once it has asked, it asks again for what comes later.
      Played late;
      set.add(late, [] {});
      CHECK(set.run_once(1ms) == 0);
      CHECK((late.asked != 0) == (is_many || words + 1 > 8));
    }
  }
}

TEST_CASE_FIXTURE(Fixture, "a set with an ear arms what has rung, and leaves the others alone") {
  lot::ShmEngine shm(options);
  {
    const auto participant = lot::transport::Participant::join(options);
    lot::segment::Segment& segment = participant->segment();
    std::vector<Played> all(12);
    std::vector<int> calls(12);
    {
      WaitSet set;
      for (std::uint32_t i = 0; i < 12; ++i) {
        all[i].owner = participant;
        all[i].channel = 100 + i;
        all[i].version = segment.directory().version.load();
        set.add(all[i], [&, i] {
          ++calls[i];
          all[i].has_news = false;
        });
      }
      CHECK(claimed_ears(segment) == 0);
      CHECK(set.run_once(1ms) == 0);
      CHECK(claimed_ears(segment) == 1);
      for (const Played& one : all) CHECK(one.heard >= 1);
      const auto arms = [&] {
        std::vector<int> n;
        for (const Played& one : all) n.push_back(one.arms);
        return n;
      };
      auto before = arms();
      CHECK(set.run_once(1ms) == 0);
      CHECK(arms() == before);  // they are armed
      // A ring that has news: its own is looked at alone.
      all[5].has_news = true;
      segment.ring_ears(105);
      CHECK(set.run_once(1h) == 1);
      CHECK(calls[5] == 1);
      ++before[5];
      CHECK(arms() == before);
      // It is due until it is armed again.
      CHECK(set.run_once(1ms) == 0);
      ++before[5];
      CHECK(arms() == before);
      // A ring that nobody listens to.
      segment.ring_ears(99);
      segment.ring_ears(112);
      CHECK(set.run_once(1ms) == 0);
      CHECK(arms() == before);
      // One that must be looked at again sooner than all are.
      all[7].again = Clock::now() + 2ms;
      segment.ring_ears(107);
      CHECK(set.run_once(0s) == 0);
      all[7].has_news = true;
      all[7].again.reset();
      CHECK(set.run_once(500ms) == 1);
      CHECK(calls[7] == 1);
      // Another version of the directory: all that watch it are due.
      CHECK(set.run_once(0s) == 0);
      before = arms();
      segment.directory().version.bump();
      for (Played& one : all) one.version = segment.directory().version.load();
      CHECK(set.run_once(1ms) == 0);
      for (int& n : before) ++n;
      CHECK(arms() == before);
      // Removed ones are not heard for; the ear goes with the last.
      for (std::size_t i = 0; i < 11; ++i) set.remove(all[i]);
      CHECK(claimed_ears(segment) == 1);
      for (std::uint32_t i = 0; i < 12; ++i) {
        all[i].has_news = true;
        segment.ring_ears(100 + i);
      }
      CHECK(set.run_once(1h) == 1);
      CHECK(calls[11] == 1);
      before[11] += 1;
      CHECK(arms() == before);
      set.remove(all[11]);
      CHECK(claimed_ears(segment) == 0);
    }
    CHECK(claimed_ears(segment) == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "a set with an ear looks at all by itself, at what no ear has heard") {
  lot::ShmEngine shm(options);
  const auto participant = lot::transport::Participant::join(options);
  WaitSet set;
  std::vector<Played> all(9);
  int calls = 0;
  for (std::uint32_t i = 0; i < 9; ++i) {
    all[i].owner = participant;
    all[i].channel = 100 + i;
    set.add(all[i], [&, i] {
      ++calls;
      all[i].has_news = false;
    });
  }
  CHECK(set.run_once(1ms) == 0);
  all[4].has_news = true;  // and nobody rings
  CHECK(set.run_once(1h) == 1);
  CHECK(calls == 1);
  for (Played& one : all) set.remove(one);
}

TEST_CASE_FIXTURE(Fixture, "a descriptor is readable once its ring, directory or time says so") {
  lot::ShmEngine shm(options);
  const auto participant = lot::transport::Participant::join(options);
  lot::segment::Segment& segment = participant->segment();
  {
    lot::waiting::Notifier one(participant->descriptors());
    lot::waiting::Notifier two(participant->descriptors());
    CHECK(one.fd() > 2);
    CHECK(two.fd() > 2);
    CHECK(one.fd() != two.fd());
    CHECK(fcntl(one.fd(), F_GETFD) == FD_CLOEXEC);
    CHECK((fcntl(one.fd(), F_GETFL) & O_NONBLOCK) != 0);
    CHECK(!readable(one.fd(), 0));
    Played first, second;
    const auto version = [&] { return segment.directory().version.load(); };
    first.channel = 100;
    second.channel = 101;
    one.watch(first);
    two.watch(second);
    CHECK(first.heard == 1);
    CHECK(!readable(one.fd(), 0));
    CHECK(!readable(two.fd(), 0));
    // Its own ring, and no other.
    segment.ring_ears(101);
    CHECK(readable(two.fd(), 20'000));
    CHECK(!readable(one.fd(), 0));
    two.watch(second);
    CHECK(!readable(two.fd(), 0));
    // What it has news of it says at once.
    second.has_news = true;
    two.watch(second);
    CHECK(readable(two.fd(), 0));
    second.has_news = false;
    two.watch(second);
    CHECK(!readable(two.fd(), 0));
    // One that cannot be armed has to look again.
    second.throws = true;
    CHECK_THROWS_WITH(two.watch(second), "not armed");
    CHECK(readable(two.fd(), 0));
    second.throws = false;
    // The directory.
    first.version = second.version = version();
    one.watch(first);
    two.watch(second);
    CHECK(!readable(one.fd(), 0));
    CHECK(!readable(two.fd(), 0));
    segment.directory().version.bump();
    lot::futex::wake_all(&segment.directory().version.word());
    CHECK(readable(one.fd(), 20'000));
    CHECK(readable(two.fd(), 20'000));
    first.version.reset();
    second.version.reset();
    // The time.
    first.again = Clock::now() + 3ms;
    one.watch(first);
    two.watch(second);
    CHECK(readable(one.fd(), 20'000));
    CHECK(!readable(two.fd(), 0));
    // A time that has passed, and an earlier one behind a later one.
    first.again = Clock::now() - 1s;
    one.watch(first);
    CHECK(readable(one.fd(), 20'000));
    second.again = Clock::now() + 1h;
    two.watch(second);
    first.again = Clock::now() + 2ms;
    one.watch(first);
    CHECK(readable(one.fd(), 20'000));
    CHECK(!readable(two.fd(), 0));
  }
}

TEST_SUITE_END();
