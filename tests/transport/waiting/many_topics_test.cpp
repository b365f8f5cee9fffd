// SPDX-License-Identifier: Apache-2.0
// Wait sets and descriptors that listen by ears (docs/ear.md): many topics, publishers that come
// and go and are killed, what a handler does and leaves, and what is left in the segment.
#include <cerrno>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <iterator>
#include <memory>
#include <optional>
#include <poll.h>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "registry/registry.hpp"
#include "support/both_engines.hpp"
#include "support/must_go.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;
using lot::WaitSet;

constexpr std::size_t kTopics = 40;  // more than a set sleeps on by words

struct Number {
  std::uint64_t value = 0;
};
using Puller = lot::ShmPuller<Number>;
using Pusher = lot::ShmPusher<Number>;

std::string topic(std::size_t t) { return "/t" + std::to_string(t); }

void publish(Pusher& pusher, std::uint64_t value) {
  must_go(pusher.push(pusher.loan(Number{value})));
}

bool readable(int fd, int timeout_ms) {
  pollfd p{fd, POLLIN, 0};
  return poll(&p, 1, timeout_ms) == 1;
}

std::size_t threads() {
  const std::filesystem::directory_iterator all("/proc/self/task");
  return static_cast<std::size_t>(std::distance(begin(all), end(all)));
}

/// Ears that listen to any ring, and ears that a wait set has claimed.
struct Ears {
  explicit Ears(const std::string& path) {
    const lot::segment::Segment segment(path);
    for (auto& of_channel : segment.listeners())
      of_channel.each([this](std::uint32_t) { ++listen; });
    for (std::uint32_t e = lot::segment::kFirstFreeEar; e < lot::ring::kEars; ++e) {
      claimed += segment.ear(e).words->owner.load(std::memory_order_relaxed) != 0;
    }
  }
  std::size_t listen = 0;
  std::size_t claimed = 0;
};

/// A child that works from go() on. It is forked before this process has threads: under
/// ThreadSanitizer a child whose parent had some may start none.
class Helper {
 public:
  template <class Work>
  explicit Helper(Work&& work)
      : child_([&] {
          alarm(100);  // as the fixture's watchdog
          must(go_.next(100s) != 0, "it may begin");
          alarm(60);
          work();
        }) {}

  void go() const { go_.tell(); }
  /// Waits until a look says true, which sleeps for a while. Fails at once where the child has.
  template <class Look>
  void wait_until(Look&& look) {
    while (!look()) {
      if (child_.ended(status_)) REQUIRE(status_ == 0);
    }
  }
  /// Its exit status.
  int wait() { return status_ == 0 ? 0 : child_.wait(); }
  void kill9() { child_.kill9(); }

 private:
  Steps go_;
  Child child_;
  int status_ = -1;
};

/// The children of a scene: so many for each engine, in the order of with_each_engine().
class Children {
 public:
  template <class Work>
  explicit Children(Work&& work, std::size_t lives = 1) {
    for (const QueueEngine engine : kEngines) {
      for (std::size_t n = 0; n < lives; ++n) all_.emplace_back([&] { work(engine); });
    }
  }
  /// The next one, which begins to work.
  Helper& begin_next() {
    Helper& helper = all_.at(begun_++);
    helper.go();
    return helper;
  }

 private:
  std::deque<Helper> all_;
  std::size_t begun_ = 0;
};

struct Fixture : BothEngines {
  static lot::PusherOptions with(QueueEngine engine, std::uint32_t depth = 8) {
    return {Policy::Block, depth, 50s, engine};
  }
  /// Subscribes to all topics.
  static std::vector<std::unique_ptr<Puller>> pullers(lot::ShmEngine& shm) {
    std::vector<std::unique_ptr<Puller>> all;
    for (std::size_t t = 0; t < kTopics; ++t) {
      all.push_back(std::make_unique<Puller>(shm.subscribe<Number>(topic(t))));
    }
    return all;
  }
  static std::vector<Pusher> pushers(lot::ShmEngine& shm, const lot::PusherOptions& options) {
    std::vector<Pusher> all;
    for (std::size_t t = 0; t < kTopics; ++t) {
      all.push_back(shm.advertise<Number>(topic(t), options));
    }
    return all;
  }
};

}  // namespace

TEST_SUITE_BEGIN("waiting");

TEST_CASE_FIXTURE(Fixture, "a set of many topics gets all that publishers send and leave") {
  constexpr lot::Wait kWaits[] = {lot::Wait::Park, lot::Wait::Adaptive, lot::Wait::Spin};
  constexpr std::uint64_t kLives = 2;
  constexpr std::uint64_t kMessages = 10;  // more than a queue is deep
  const auto work = [&](QueueEngine engine) {
    lot::ShmEngine mine(options);
    auto out = pushers(mine, with(engine));
    for (std::uint64_t n = 0; n < kMessages; ++n) {
      for (auto& pusher : out) publish(pusher, n);
      if (n % 8 == 0) std::this_thread::sleep_for(1ms);
    }
  };
  Children publishers(work, std::size(kWaits) * kLives);
  with_each_engine([&](QueueEngine) {
    for (const lot::Wait wait : kWaits) {
      lot::ShmEngine shm(options);
      auto in = pullers(shm);
      std::vector<std::uint64_t> got(kTopics, 0);
      std::uint64_t all = 0;
      WaitSet set(wait);
      for (std::size_t t = 0; t < kTopics; ++t) {
        set.add(*in[t], [&, t] {
          while (const auto message = in[t]->try_pull()) {
            CHECK(message->value == got[t] % kMessages);
            ++got[t];
            ++all;
          }
        });
      }
      CHECK(set.run_once(1ms) == 0);
      for (std::uint64_t life = 1; life <= kLives; ++life) {
        Helper& publisher = publishers.begin_next();
        publisher.wait_until([&] {
          if (all < life * kMessages * kTopics) set.run_once(1s);
          return all == life * kMessages * kTopics;
        });
        CHECK(publisher.wait() == 0);
      }
      CHECK(Ears(shm.path()).claimed == 1);
      for (auto& puller : in) set.remove(*puller);
      CHECK(Ears(shm.path()).claimed == 0);
      CHECK(Ears(shm.path()).listen == 0);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "one message of one topic calls one handler, however many there are") {
  lot::ShmEngine shm(options);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  auto in = pullers(shm);
  WaitSet set;
  std::vector<std::uint64_t> calls(kTopics, 0);
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] {
      ++calls[t];
      while (in[t]->try_pull()) {
      }
    });
  }
  CHECK(set.run_once(1ms) == 0);
  for (std::uint64_t n = 1; n <= 50; ++n) {
    const std::size_t t = n * 7 % kTopics;
    const std::uint64_t before = calls[t];
    std::thread publisher([&] {
      std::this_thread::sleep_for(1ms);  // most likely asleep by now
      publish(out[t], n);
    });
    CHECK(set.run_once(20s) == 1);
    publisher.join();
    CHECK(calls[t] == before + 1);
    CHECK(set.run_once(0ms) == 0);
  }
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "a puller that is removed is heard for no more") {
  lot::ShmEngine shm(options);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  auto in = pullers(shm);
  WaitSet set;
  for (auto& puller : in) set.add(*puller, [] {});
  CHECK(set.run_once(1ms) == 0);
  const std::size_t before = Ears(shm.path()).listen;
  REQUIRE(before >= kTopics);
  set.remove(*in[7]);
  publish(out[7], 1);
  CHECK(set.run_once(0ms) == 0);
  CHECK(Ears(shm.path()).listen == before - 1);
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "what a handler leaves unread, or throws at, is due again") {
  lot::ShmEngine shm(options);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  auto in = pullers(shm);
  WaitSet set;
  int throws = 0, leaves = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] {
      if (t == 1 && ++throws < 3) throw std::runtime_error("as it likes");
      if (t == 2 && ++leaves < 3) return;
      while (in[t]->try_pull()) {
      }
    });
  }
  CHECK(set.run_once(1ms) == 0);
  for (auto& pusher : out) publish(pusher, 1);
  CHECK_THROWS_AS(set.run_once(20s), std::runtime_error);
  CHECK_THROWS_AS(set.run_once(20s), std::runtime_error);
  CHECK(set.run_once(20s) == kTopics - 1);  // topic 0 has been read
  CHECK(set.run_once(20s) == 1);
  CHECK(set.run_once(20s) == 1);
  CHECK(set.run_once(0ms) == 0);
  CHECK(throws == 3);
  CHECK(leaves == 3);
  publish(out[2], 2);
  set.stop();
  CHECK(set.run_once(20s) == 0);
  CHECK(set.run_once(20s) == 1);
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "a puller that is used beside its set is heard again") {
  lot::ShmEngine shm(options);
  auto in = pullers(shm);
  WaitSet set;
  std::size_t calls = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] {
      ++calls;
      while (in[t]->try_pull()) {
      }
    });
  }
  CHECK(set.run_once(1ms) == 0);
  auto out = shm.advertise<Number>(topic(3), {Policy::Overwrite, 4});
  CHECK(in[3]->publishers() == 1);  // it has joined the ring, which no mark is in
  publish(out, 1);
  CHECK(set.run_once(20s) == 1);
  for (std::uint64_t n = 0; n < 20; ++n) {
    publish(out, n);
    CHECK(in[3]->try_pull()->value == n);  // the mark that it had left is behind it
    set.run_once(0ms);
    publish(out, n);
    calls = 0;
    CHECK(set.run_once(20s) == 1);
    CHECK(calls == 1);
  }
  auto second = shm.advertise<Number>(topic(3), {Policy::Overwrite, 4});
  CHECK(in[3]->size() == 0);
  publish(second, 1);
  CHECK(set.run_once(20s) == 1);
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "handlers of a set of many topics add and remove, to the last one") {
  lot::ShmEngine shm(options);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  auto in = pullers(shm);
  WaitSet set;
  std::size_t calls = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] {
      ++calls;
      (void)in[t]->try_pull();
      set.remove(*in[t]);
    });
  }
  CHECK(set.run_once(1ms) == 0);
  CHECK(Ears(shm.path()).claimed == 1);
  for (auto& pusher : out) publish(pusher, 1);
  while (calls < kTopics) set.run_once(20s);
  CHECK(Ears(shm.path()).claimed == 0);  // it has gone in a handler
  CHECK(Ears(shm.path()).listen == 0);
  CHECK(set.run_once(0ms) == 0);
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] {
      ++calls;
      (void)in[t]->try_pull();
    });
  }
  CHECK(set.run_once(1ms) == 0);
  publish(out[7], 2);
  CHECK(set.run_once(20s) == 1);
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "a set outlives its pullers and their engine, and keeps the segment") {
  std::optional<WaitSet> set(std::in_place);
  {
    lot::ShmEngine shm(options);
    auto in = pullers(shm);
    for (auto& puller : in) set->add(*puller, [] {});
    CHECK(set->run_once(1ms) == 0);
  }
  CHECK(files_of(options) == 2);
  set.reset();
  CHECK(files_of(options) == 0);
}

TEST_CASE_FIXTURE(Fixture, "a set of two segments listens in both") {
  lot::EngineOptions elsewhere = fresh();
  lot::ShmEngine here(options), there(elsewhere);
  auto out = pushers(here, {Policy::Overwrite, 4});
  auto out_there = pushers(there, {Policy::Overwrite, 4});
  auto in = pullers(here);
  auto in_there = pullers(there);
  WaitSet set;
  std::size_t calls = 0, calls_there = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] { calls += in[t]->try_pull() != nullptr; });
    set.add(*in_there[t], [&, t] { calls_there += in_there[t]->try_pull() != nullptr; });
  }
  CHECK(set.run_once(1ms) == 0);
  CHECK(Ears(here.path()).claimed == 1);
  CHECK(Ears(there.path()).claimed == 1);
  publish(out[1], 1);
  CHECK(set.run_once(20s) == 1);
  publish(out_there[1], 1);
  while (calls_there == 0) set.run_once(20s);
  CHECK(calls == 1);
  for (auto& puller : in_there) set.remove(*puller);
  CHECK(Ears(there.path()).claimed == 0);
  publish(out[2], 1);
  while (calls < 2) set.run_once(20s);
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "a set that finds no free ear sleeps on all its queues") {
  lot::ShmEngine shm(options);
  const lot::segment::Segment segment(shm.path());
  std::vector<std::uint32_t> taken;
  while (const auto e = segment.claim_ear(300)) taken.push_back(*e);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  auto in = pullers(shm);
  WaitSet set;
  std::size_t calls = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] { calls += in[t]->try_pull() != nullptr; });
  }
  for (std::size_t t = 0; t < kTopics; ++t) {
    std::thread publisher([&] {
      std::this_thread::sleep_for(1ms);  // most likely asleep by now
      publish(out[t], 1);
    });
    while (calls <= t) set.run_once(20s);
    publisher.join();
  }
  CHECK(Ears(shm.path()).listen == 0);
  for (const std::uint32_t e : taken) segment.free_ear(e);
  while (Ears(shm.path()).claimed == 0) set.run_once(10ms);  // it asks again
  publish(out[0], 1);
  while (calls == kTopics) set.run_once(20s);
  for (auto& puller : in) set.remove(*puller);
}

TEST_CASE_FIXTURE(Fixture, "a set finds new rings when another process lets go of the registry") {
  Steps go;
  Steps told;
  Child other([&] {
    alarm(100);
    must(go.next(100s) != 0, "it may begin");
    const auto participant = lot::transport::Participant::join(options);
    {
      const lot::registry::Registry::Lock lock(participant->registry());
      told.tell();
      must(go.next(100s) != 0, "it may let go");
    }
    told.tell();
    must(go.next(100s) != 0, "it may leave, which wakes each reader that looks for a ring");
  });
  lot::ShmEngine shm(options);
  auto in = pullers(shm);
  WaitSet set;
  std::size_t got = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set.add(*in[t], [&, t] {
      while (in[t]->try_pull()) ++got;
    });
  }
  while (Ears(shm.path()).claimed == 0) set.run_once(10ms);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  for (auto& pusher : out) publish(pusher, 1);
  go.tell();
  REQUIRE(told.next(50s) == '.');
  // All look for it, again and again, and longer than it is from one look at all to the next.
  const auto until = std::chrono::steady_clock::now() + 2500ms;
  while (std::chrono::steady_clock::now() < until) set.run_once(100ms);
  CHECK(got == 0);
  go.tell();
  REQUIRE(told.next(50s) == '.');
  while (got < kTopics) REQUIRE(set.run_once(20s) != 0);
  for (auto& puller : in) set.remove(*puller);
  go.tell();
  CHECK(other.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "a forked child takes no news from its parent's set and descriptors") {
  lot::ShmEngine shm(options);
  auto out = pushers(shm, {Policy::Overwrite, 4});
  auto in = pullers(shm);
  std::optional<WaitSet> set(std::in_place);
  std::size_t calls = 0;
  for (std::size_t t = 0; t < kTopics; ++t) {
    set->add(*in[t], [&, t] { calls += in[t]->try_pull() != nullptr; });
  }
  const int fd = in[5]->fd();
  CHECK(set->run_once(1ms) == 0);
  CHECK(!in[5]->try_pull());
  publish(out[5], 1);
  Child child([&] {
    try {
      set->run_once(1s);
      must(false, "a set of the parent is inert");
    } catch (const lot::Error& e) {
      must(e.error_number() == ECHILD, "it says why");
    }
    in.clear();
    set.reset();
  });
  CHECK(child.wait() == 0);
  CHECK(readable(fd, 20'000));
  CHECK(set->run_once(20s) == 1);
  CHECK(calls == 1);
  CHECK(Ears(shm.path()).claimed == 1);
  publish(out[6], 1);
  CHECK(set->run_once(20s) == 1);
  set.reset();
}

TEST_CASE_FIXTURE(Fixture, "a process that is killed leaves no ear, and no bit of one") {
  Steps steps;
  Children readers([&](QueueEngine) {
    lot::ShmEngine mine(options);
    auto in = pullers(mine);
    WaitSet set;
    for (auto& puller : in) {
      (void)puller->fd();
      set.add(*puller, [&] {
        while (puller->try_pull()) {
        }
      });
    }
    set.run_once(1ms);
    steps.tell();
    set.run();
  });
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto out = pushers(shm, {Policy::Overwrite, 4, 1s, engine});
    Helper& reader = readers.begin_next();
    reader.wait_until([&] { return steps.next(100ms) != 0; });
    CHECK(Ears(shm.path()).claimed == 1);
    CHECK(Ears(shm.path()).listen == 2 * kTopics);  // of the set, and of the descriptors
    for (auto& pusher : out) publish(pusher, 1);
    reader.kill9();
    for (auto& pusher : out) publish(pusher, 2);
    CHECK(eventually([&] { return Ears(shm.path()).claimed == 0; }));
    CHECK(Ears(shm.path()).listen == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "a set of many topics hears of a publisher that is killed") {
  Steps steps;
  Children publishers([&](QueueEngine engine) {
    lot::ShmEngine mine(options);
    auto out = pushers(mine, with(engine));
    for (auto& pusher : out) publish(pusher, 1);
    steps.tell();
    pause();
  });
  with_each_engine([&](QueueEngine) {
    lot::ShmEngine shm(options);
    auto in = pullers(shm);
    WaitSet set;
    std::vector<bool> gone(kTopics, false);
    std::size_t ends = 0;
    for (std::size_t t = 0; t < kTopics; ++t) {
      set.add(*in[t], [&, t] {
        while (in[t]->try_pull()) {
        }
        if (in[t]->status() == Status::PublisherGone && !gone[t]) {
          gone[t] = true;
          ++ends;
        }
      });
    }
    Helper& publisher = publishers.begin_next();
    publisher.wait_until([&] { return steps.next(100ms) != 0; });
    set.run_once(20s);
    publisher.kill9();
    while (ends < kTopics) set.run_once(20s);
    for (auto& puller : in) set.remove(*puller);
  });
}

TEST_CASE_FIXTURE(Fixture, "queues and tasks in a set of many topics") {
  const auto queue = [&](lot::ShmEngine& shm, QueueEngine engine, bool redeliver) {
    lot::QueueOptions how;
    how.engine = engine;
    how.redeliver = redeliver;
    return shm.queue<Number>(redeliver ? "tasks" : "items", how);
  };
  Children others([&](QueueEngine engine) {
    lot::ShmEngine mine(options);
    auto out = queue(mine, engine, false);
    auto work = queue(mine, engine, true);
    for (std::uint64_t n = 0; n < 30; ++n) {
      must_go(out.put(Number{n}));
      must_go(work.put(Number{n}));
      if (n % 10 == 0) std::this_thread::sleep_for(1ms);
    }
  });
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = pullers(shm);
    auto items = queue(shm, engine, false);
    auto tasks = queue(shm, engine, true);
    std::size_t popped = 0, taken = 0;
    WaitSet set;
    for (auto& puller : in) set.add(*puller, [] {});
    set.add(items, [&] {
      while (items.try_pop()) ++popped;
    });
    set.add(tasks, [&] {
      while (auto task = tasks.try_take()) {
        if (++taken % 2 == 0) task.finish();  // else it comes back
      }
    });
    CHECK(set.run_once(1ms) == 0);
    Helper& other = others.begin_next();
    other.wait_until([&] {
      if (popped < 30 || taken < 60) set.run_once(1s);
      return popped == 30 && taken == 60;
    });
    CHECK(other.wait() == 0);
    set.remove(items);
    set.remove(tasks);
    for (auto& puller : in) set.remove(*puller);
  });
}

TEST_CASE_FIXTURE(Fixture, "one thread serves all descriptors, and each is readable by itself") {
  Steps steps, finished;
  Children publishers([&](QueueEngine engine) {
    lot::ShmEngine mine(options);
    auto out = pushers(mine, with(engine));
    auto put = mine.queue<Number>("items", {.engine = engine});
    for (std::uint64_t n = 0; n < 20; ++n) {
      publish(out[n], n);
      must(steps.next() != 0, "it was read");
    }
    must_go(put.put(Number{1}));
    must(finished.next(30s) != 0, "all is read");
  });
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = pullers(shm);
    auto items = shm.queue<Number>("items", {.engine = engine});
    const std::size_t before = threads();
    std::vector<int> fds;
    for (auto& puller : in) fds.push_back(puller->fd());
    const int of_queue = items.fd();
    CHECK(threads() == before + 1);
    for (const int fd : fds) CHECK(!readable(fd, 0));
    Helper& publisher = publishers.begin_next();
    for (std::uint64_t n = 0; n < 20; ++n) {
      std::unique_ptr<Puller>& puller = in[n];
      publisher.wait_until([&] {
        if (!readable(fds[n], 100)) return false;
        const auto message = puller->try_pull();
        if (message) CHECK(message->value == n);
        return message != nullptr;
      });
      steps.tell();
    }
    publisher.wait_until([&] { return readable(of_queue, 100) && items.try_pop(); });
    in[3].reset();  // others go on
    finished.tell();
    CHECK(publisher.wait() == 0);
    for (const std::size_t t : {std::size_t{0}, kTopics - 1}) {
      while (in[t]->try_pull()) {
      }
      auto pusher = shm.advertise<Number>(topic(t), with(engine));
      publish(pusher, 9);
      for (bool got = false; !got;) {
        REQUIRE(readable(fds[t], 20'000));
        got = in[t]->try_pull() != nullptr;
      }
    }
    CHECK(threads() <= before + 2);  // and perhaps one that wakes the sleepers of a push
  });
}

TEST_SUITE_END();
