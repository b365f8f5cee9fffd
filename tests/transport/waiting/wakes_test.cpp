// SPDX-License-Identifier: Apache-2.0
// What ends a wait is a wake-up, and a thread that waits looks seldom. A thread that sleeps also
// looks by itself now and then (docs/waiting.md), so a wake-up that is lost is only late. Here that
// net is taken away: the kernel gets no deadline for a sleep on a word. And all sleeps are counted:
// a thread that looks again and again is found out. The linker leads each call of syscall() to the
// function below.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <functional>
#include <limits>
#include <linux/futex.h>
#include <memory>
#include <optional>
#include <poll.h>
#include <string>
#include <sys/syscall.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "futex/futex.hpp"
#include "robust_mutex/robust_mutex.hpp"
#include "segment/segment.hpp"
#include "support/both_engines.hpp"
#include "support/in_a_moment.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"

namespace {

/// Sleeps that would last longer than so many nanoseconds last until a wake-up.
constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
std::atomic<std::int64_t> longest{kNever};
thread_local std::int64_t longest_here = kNever;  ///< the same of one thread
std::atomic<std::uint64_t> sleeps{0};             ///< that this process has begun

}  // namespace

namespace {

/// Whether the net is away for a sleep with this deadline.
bool is_without(const timespec* until) {
  const std::chrono::nanoseconds at =
      std::chrono::seconds(until->tv_sec) + std::chrono::nanoseconds(until->tv_nsec);
  return (at - lot::futex::Clock::now().time_since_epoch()).count() >
         std::min(longest.load(), longest_here);
}

}  // namespace

// Numbers that are not there are read as well, as libc does.
extern "C" {
long __real_syscall(long number, ...);                                              // NOLINT
long __wrap_syscall(long number, long a, long b, long c, long d, long e, long f) {  // NOLINT
  constexpr long kFutexWaitv = 449;
  const bool waits = number == kFutexWaitv
                         ? b != 0
                         : number == SYS_futex && (b & FUTEX_CMD_MASK) == FUTEX_WAIT_BITSET;
  if (!waits) return __real_syscall(number, a, b, c, d, e, f);
  sleeps.fetch_add(1);
  if (d != 0 && is_without(reinterpret_cast<const timespec*>(d))) d = 0;
  return __real_syscall(number, a, b, c, d, e, f);
}
}

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::Status;
using lot::StopSource;
using lot::Wait;

struct Number {
  std::uint64_t value = 0;
};
struct Blob {
  std::uint64_t value = 0;
  lot::ShmVector<std::uint8_t> data;
};

/// While it lives, no sleep of more than half a second ends by itself. One that has begun before
/// does. The nets of readers, wait sets and wardens are 1 s. There are shorter sleeps that nobody
/// ends, and that are no net: a reader dozes while another process has the registry's lock, a
/// warden while a process is not quite dead.
class NoNet {
 public:
  NoNet() { longest = std::chrono::nanoseconds(500ms).count(); }
  ~NoNet() { longest = kNever; }
  NoNet(const NoNet&) = delete;
  NoNet& operator=(const NoNet&) = delete;
};
/// While it lives, no sleep of this thread ends by itself.
class NoNetHere {
 public:
  NoNetHere() { longest_here = 0; }
  ~NoNetHere() { longest_here = kNever; }
  NoNetHere(const NoNetHere&) = delete;
  NoNetHere& operator=(const NoNetHere&) = delete;
};

constexpr Wait kWaits[] = {Wait::Adaptive, Wait::Park};

struct Fixture {
  const Watchdog watchdog{100};
  const lot::EngineOptions options = fresh();
  const int both = unsetenv("LOT_QUEUE");  // it would come before what a test says

  /// The threads of the library that the test makes have no net from the beginning.
  template <class Test>
  void without_net(Test&& test) {
    for (const QueueEngine engine : kEngines) {
      CAPTURE(static_cast<int>(engine));
      const NoNet without;
      test(engine);
      CHECK(files_of(options) == 0);
    }
  }
  static lot::PusherOptions with(QueueEngine engine, std::uint32_t depth = 2) {
    return {Policy::Block, depth, 1h, engine};
  }
  static lot::QueueOptions items(QueueEngine engine) {
    lot::QueueOptions how;
    how.depth = 2;
    how.engine = engine;
    return how;
  }
};

template <class T>
void publish(lot::ShmPusher<T>& pusher, std::uint64_t value) {
  auto message = pusher.loan();
  message->value = value;
  must_go(pusher.push(std::move(message)));
}

/// Waits until there is a message, or the last publisher has gone.
template <class T>
struct Form {
  const char* name;
  std::function<void(lot::ShmPuller<T>&, Wait)> waits;
};
template <class T>
std::vector<Form<T>> forms() {
  const auto borrows = [](auto& puller, Wait) { (void)puller.borrow(); };
  const auto pulls = [](auto& puller, Wait) { (void)puller.pull(); };
  const auto in_a_set = [](auto& puller, Wait wait) {
    lot::WaitSet set(wait);
    set.add(puller, [&] { (void)puller.try_pull(); });
    while (set.run_once(1h) == 0) {
    }
    set.remove(puller);
  };
  const auto by_descriptor = [](auto& puller, Wait) {
    pollfd p{puller.fd(), POLLIN, 0};
    do {
      REQUIRE(poll(&p, 1, 50'000) == 1);
      (void)puller.try_pull();
    } while (puller.status() == Status::Timeout);
  };
  return {{"pull", pulls}, {"borrow", borrows}, {"set", in_a_set}, {"fd", by_descriptor}};
}

/// What happens while each form waits for a T.
template <class T>
void each_wait_hears(const lot::EngineOptions& options, const lot::PusherOptions& how) {
  for (const Form<T>& form : forms<T>()) {
    CAPTURE(form.name);
    for (const Wait wait : kWaits) {
      lot::ShmEngine shm(options);
      auto puller = shm.subscribe<T>("/t", {wait, 0});
      if (std::string(form.name) == "fd") (void)puller.fd();  // and its thread
      std::optional<lot::ShmPusher<T>> pusher;
      {
        const InAMoment come([&] {
          pusher = shm.advertise<T>("/t", how);
          publish(*pusher, 1);
        });
        form.waits(puller, wait);
      }
      for (int n = 0; n < 5; ++n) {
        while (puller.try_pull()) {
        }
        const InAMoment push([&] { publish(*pusher, 2); });
        form.waits(puller, wait);
      }
      while (puller.try_pull()) {
      }
      const InAMoment end([&] { pusher.reset(); });
      form.waits(puller, wait);
    }
  }
}

}  // namespace

TEST_SUITE_BEGIN("wakes");

TEST_CASE_FIXTURE(Fixture, "a wait for messages is woken by the first, the next and the end") {
  without_net([&](QueueEngine engine) {
    each_wait_hears<Number>(options, with(engine));  // in slots
    each_wait_hears<Blob>(options, with(engine));    // in blocks
  });
}

TEST_CASE_FIXTURE(Fixture, "a wait for messages is woken when the last publisher is killed") {
  without_net([&](QueueEngine engine) {
    for (const Form<Number>& form : forms<Number>()) {
      CAPTURE(form.name);
      const Steps there;
      Child child([&] {
        lot::ShmEngine own(options);
        auto pusher = own.advertise<Number>("/t", with(engine));
        there.tell();
        pause();
      });
      REQUIRE(there.next() != 0);
      lot::ShmEngine shm(options);
      auto puller = shm.subscribe<Number>("/t", {Wait::Park, 0});
      CHECK(puller.publishers() == 1);
      const InAMoment end([&] { child.kill9(); });
      form.waits(puller, Wait::Park);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a wait is woken when it is told to stop") {
  without_net([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    auto puller = shm.subscribe<Number>("/t", {Wait::Park, 0});
    {
      StopSource source;
      const InAMoment stop([&] { source.request_stop(); });
      CHECK(puller.pull(source.get_token()) == nullptr);
    }
    {
      StopSource source;
      const InAMoment stop([&] { source.request_stop(); });
      lot::WaitSet(Wait::Park).run(source.get_token());
    }
    lot::WaitSet set(Wait::Park);
    const InAMoment stop([&] { set.stop(); });
    set.run();
  });
}

TEST_CASE_FIXTURE(Fixture, "a push without room is woken by each reader that reads or goes") {
  const auto test = [&](QueueEngine engine) {
    const Steps there;
    Child child([&] {
      lot::ShmEngine own(options);
      const auto mine = own.subscribe<Number>("/t");
      there.tell();
      pause();
    });
    REQUIRE(there.next() != 0);
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    REQUIRE(pusher.wait_for_readers(1, 50s));
    const NoNetHere without;  // it would look each millisecond
    const auto fill = [&] {
      auto message = pusher.loan();
      while (pusher.try_push(std::move(message)) == Status::Ok) message = pusher.loan();
    };
    fill();
    {
      const InAMoment go([&] { child.kill9(); });
      publish(pusher, 1);
    }
    std::optional<lot::ShmPuller<Number>> puller = shm.subscribe<Number>("/t");
    fill();
    for (int n = 0; n < 5; ++n) {
      const InAMoment read([&] {
        while (puller->try_pull()) {
        }
      });
      for (int k = 0; k < 2; ++k) publish(pusher, 1);
    }
    for (int n = 0; n < 5; ++n) {
      const InAMoment read([&] { (void)puller->borrow(); });
      publish(pusher, 1);
    }
    const InAMoment go([&] { puller.reset(); });
    publish(pusher, 1);
  };
  without_net(test);
}

TEST_CASE_FIXTURE(Fixture, "each side of a queue wakes the other, for an item, a task or room") {
  without_net([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    using Items = lot::ShmQueue<lot::ShmUniquePtr<Number>>;
    Items queue = shm.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
    Items beside = shm.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
    auto how = items(engine);
    how.redeliver = true;
    Items tasks = shm.queue<lot::ShmUniquePtr<Number>>("tasks", how);
    Items workers = shm.queue<lot::ShmUniquePtr<Number>>("tasks", how);
    for (std::uint64_t n = 0; n < 5; ++n) {
      const InAMoment put([&] { must_go(beside.put(beside.make(Number{n}))); });
      const auto item = queue.wait_and_pop();
      REQUIRE(item);
      CHECK(item->value == n);
    }
    for (int n = 0; n < 2; ++n) must_go(queue.put(queue.make(Number{7})));
    for (int n = 0; n < 5; ++n) {
      const InAMoment pop([&] { (void)beside.try_pop(); });
      must_go(queue.put(queue.make(Number{7})));
    }
    must_go(tasks.put(tasks.make(Number{8})));
    for (unsigned n = 1; n < 5; n += 2) {
      auto task = workers.wait_and_take();
      REQUIRE(task);
      CHECK(task.deliveries() == n);
      const InAMoment back([&] { task.give_back(); });
      auto again = tasks.wait_and_take();
      CHECK(again->value == 8);
      again.give_back();
    }
    while (queue.try_pop()) {
    }
    tasks.wait_and_take().finish();
  });
}

TEST_CASE_FIXTURE(Fixture, "a worker is woken by the task that another one has left") {
  without_net([&](QueueEngine engine) {
    auto how = items(engine);
    how.redeliver = true;
    const Steps took;
    Child worker([&] {
      lot::ShmEngine own(options);
      auto mine = own.queue<lot::ShmUniquePtr<Number>>("tasks", how);
      must_go(mine.put(mine.make(Number{9})));
      const auto task = mine.wait_and_take();
      took.tell();
      pause();
    });
    REQUIRE(took.next() != 0);
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Number>>("tasks", how);
    const InAMoment end([&] { worker.kill9(); });
    auto task = tasks.wait_and_take();
    REQUIRE(task);
    CHECK(task->value == 9);
    CHECK(task.deliveries() == 2);
    task.finish();
  });
}

TEST_CASE_FIXTURE(Fixture, "a call is woken by its answer, and when the server is killed") {
  without_net([&](QueueEngine engine) {
    setenv("LOT_QUEUE", engine == QueueEngine::Ring ? "ring" : "mutex", 1);
    {
      lot::ShmEngine shm(options);
      auto client = shm.client<Number, Number>("twice");
      const auto server = shm.serve<Number, Number>(
          "twice", [](const Number& asked, Number& told) { told.value = 2 * asked.value; });
      for (std::uint64_t n = 0; n < 20; ++n) {
        const auto answer = client.call(Number{n});
        REQUIRE(answer);
        CHECK(answer->value == 2 * n);
      }
    }
    const Steps there, asked;
    Child child([&] {
      lot::ShmEngine own(options);
      const auto server = own.serve<Number, Number>("twice", [&](const Number&, Number&) {
        asked.tell();
        pause();
      });
      there.tell();
      pause();
    });
    REQUIRE(there.next() != 0);
    lot::ShmEngine shm(options);
    auto client = shm.client<Number, Number>("twice");
    std::thread kill([&] {
      asked.next();
      child.kill9();
    });
    CHECK(client.call(Number{1}) == nullptr);
    kill.join();
    unsetenv("LOT_QUEUE");
  });
}

TEST_CASE_FIXTURE(Fixture, "a set that listens by ears is woken by what comes, and what goes") {
  constexpr std::size_t kTopics = lot::futex::kMaxWords + 2;
  without_net([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    std::vector<std::unique_ptr<lot::ShmPuller<Number>>> pullers;
    std::vector<std::optional<lot::ShmPusher<Number>>> pushers(kTopics);
    lot::WaitSet set(Wait::Park);
    std::size_t called = kTopics;
    for (std::size_t t = 0; t < kTopics; ++t) {
      const std::string topic = "/t" + std::to_string(t);
      if (t != 0) pushers[t] = shm.advertise<Number>(topic, with(engine));
      pullers.push_back(std::make_unique<lot::ShmPuller<Number>>(shm.subscribe<Number>(topic)));
      set.add(*pullers.back(), [&, t] {
        while (pullers[t]->try_pull()) called = t;
        if (pullers[t]->status() == Status::PublisherGone) called = t;
      });
    }
    const auto hears = [&](std::size_t t, const std::function<void()>& what) {
      called = kTopics;
      const InAMoment happens(what);
      while (called != t) set.run_once(1h);
    };
    for (const std::size_t t : {kTopics - 1, std::size_t{1}, kTopics / 2}) {
      for (int n = 0; n < 3; ++n) hears(t, [&] { publish(*pushers[t], 1); });
    }
    hears(0, [&] {
      pushers[0] = shm.advertise<Number>("/t0", with(engine));
      publish(*pushers[0], 1);
    });
    hears(0, [&] { publish(*pushers[0], 1); });
    hears(0, [&] { pushers[0].reset(); });
    for (auto& puller : pullers) set.remove(*puller);
  });
}

TEST_CASE_FIXTURE(Fixture, "a listener is woken by each message, and by its own end") {
  without_net([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    std::atomic<std::uint64_t> last{0};
    const auto listener = shm.listen<Number>(
        "/t", [&](const lot::ShmSharedPtr<const Number>& message) { last = message->value; });
    for (std::uint64_t n = 1; n <= 5; ++n) {
      std::this_thread::sleep_for(2ms);
      publish(pusher, n);
      CHECK(eventually([&] { return last == n; }, 50s));
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a thread that waits for a lock is woken when it is free") {
  lot::ShmEngine shm(options);
  const lot::segment::Segment segment(shm.path());
  InOurName owner(segment);
  lot::RobustMutex::Word word{0};
  lot::RobustMutex mutex(word, owner);
  const NoNetHere without;
  for (int n = 0; n < 20; ++n) {
    REQUIRE(mutex.lock_for(0s) == lot::RobustMutex::Outcome::Locked);
    const InAMoment unlock([&] { mutex.unlock(); });
    REQUIRE(mutex.lock_for(30s) == lot::RobustMutex::Outcome::Locked);
    mutex.unlock();
  }
}

TEST_CASE_FIXTURE(Fixture, "a warden is woken by a death, and reaps all that the dead had") {
  without_net([&](QueueEngine engine) {
    const Steps there;
    std::vector<Child> children;
    for (int n = 0; n < 3; ++n) {
      children.emplace_back([&] {
        lot::ShmEngine own(options);
        auto pusher = own.advertise<Number>("/t", with(engine));
        auto puller = own.subscribe<Number>("/t");
        publish(pusher, 1);
        const auto kept = puller.pull();
        there.tell();
        pause();
      });
      REQUIRE(there.next() != 0);
    }
    lot::ShmEngine shm(options);
    lot::segment::Segment segment(shm.path());
    for (std::size_t left = children.size(); left > 0; --left) {
      CHECK(Audit(segment).participants == left + 1);
      children[left - 1].kill9();
      CHECK(eventually([&] { return Audit(segment).participants == left; }));
    }
    CHECK(eventually([&] { return Audit(segment).nothing(); }));
  });
}

TEST_CASE_FIXTURE(Fixture, "a thread that waits sleeps, and looks seldom") {
  // What may be counted besides: the wardens' looks, one a second each.
  const auto sleeps_of = [](const std::function<void()>& waits) {
    const auto before = sleeps.load();
    waits();
    return sleeps.load() - before;
  };
  without_net([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", with(engine));
    CHECK(sleeps_of([] { std::this_thread::sleep_for(300ms); }) < 20);
    auto puller = shm.subscribe<Number>("/t", {Wait::Park, 0});
    CHECK(sleeps_of([&] { (void)puller.pull(300ms); }) < 20);
    CHECK(sleeps_of([&] { (void)puller.borrow(300ms); }) < 20);
    {
      lot::WaitSet set(Wait::Park);
      set.add(puller, [] {});
      CHECK(sleeps_of([&] { (void)set.run_once(300ms); }) < 20);
      set.remove(puller);
    }
    // Each millisecond, but not more often.
    auto message = pusher.loan();
    while (pusher.try_push(std::move(message)) == Status::Ok) message = pusher.loan();
    CHECK(sleeps_of([&] { (void)pusher.push(std::move(message), 300ms); }) < 1000);
    while (puller.try_pull()) {
    }
    (void)puller.fd();
    CHECK(sleeps_of([] { std::this_thread::sleep_for(300ms); }) < 20);
    auto queue = shm.queue<lot::ShmUniquePtr<Number>>("items", items(engine));
    CHECK(sleeps_of([&] { (void)queue.wait_and_pop_for(300ms); }) < 20);
  });
}
