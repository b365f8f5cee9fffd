// SPDX-License-Identifier: Apache-2.0
// ShmQueue: each kind of item, each way to put and to pop, what is left behind. Both engines.
#include <atomic>
#include <cerrno>
#include <functional>
#include <memory>
#include <optional>
#include <poll.h>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/both_engines.hpp"
#include "support/must_go.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::QueueOptions;
using lot::Status;
using Clock = std::chrono::steady_clock;

struct Task {
  std::uint64_t number = 0;
  lot::ShmVector<std::uint64_t> numbers;
};
struct Point {
  double x = 0, y = 0;
};
struct Note {
  lot::ShmString text;
};

/// A value whose copy fails when it is told to. It has no move that does not.
struct Fragile {
  int number = 0;
  explicit Fragile(int n) : number(n) {}
  Fragile(const Fragile& other) : number(other.number) {
    if (on_copy) on_copy();
  }
  Fragile(Fragile&&) { throw std::runtime_error("moved"); }
  static inline std::function<void()> on_copy;
};

/// While it is there, copies of Fragile fail.
struct Breaks {
  Breaks() {
    Fragile::on_copy = [] { throw std::runtime_error("copied"); };
  }
  ~Breaks() { Fragile::on_copy = nullptr; }
};

using Tasks = lot::ShmQueue<lot::ShmUniquePtr<Task>>;
using Views = lot::ShmQueue<lot::ShmSharedPtr<const Task>>;
using Points = lot::ShmQueue<Point>;

QueueOptions with(QueueEngine engine, std::uint32_t depth = 64, Policy policy = Policy::Block) {
  QueueOptions options;
  options.engine = engine;
  options.depth = depth;
  options.policy = policy;
  return options;
}

lot::ShmUniquePtr<Task> task(Tasks& queue, std::uint64_t number) {
  auto made = queue.make();
  made->number = number;
  made->numbers.assign(100, number);
  return made;
}

using Fixture = BothEngines;
using Fragiles = lot::ShmQueue<Fragile>;

}  // namespace

template <>
struct lot::is_trusted_message<Fragile> : std::true_type {};

TEST_SUITE_BEGIN("queue");

TEST_CASE_FIXTURE(Fixture, "items come out of a ShmQueue in the order in which they were put in") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto points = shm.queue<Point>("points", with(engine));
    CHECK(points.is_empty());
    CHECK(points.capacity() == 64);
    for (int i = 0; i < 10; ++i) CHECK(points.put({1.0 * i, -1.0 * i}) == Status::Ok);
    CHECK(points.size() == 10);
    CHECK(!points.is_empty());
    for (int i = 0; i < 10; ++i) {
      const auto point = points.try_pop();
      REQUIRE(point);
      CHECK(point->x == i);
      CHECK(point->y == -i);
    }
    CHECK(!points.try_pop());
    CHECK(points.is_empty());
  });
}

TEST_CASE_FIXTURE(Fixture, "putting by copy, by move and in place; popping by every way to wait") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto points = shm.queue<Point>("points", with(engine));
    const Point copied{1, 2};
    CHECK(points.put(copied) == Status::Ok);
    CHECK(points.put(Point{3, 4}) == Status::Ok);
    CHECK(points.emplace(5.0, 6.0) == Status::Ok);
    CHECK(points.put_for(copied, 1s) == Status::Ok);
    CHECK(points.put_until(copied, Clock::now() + 1s) == Status::Ok);
    CHECK(points.try_put(copied) == Status::Ok);
    CHECK(points.wait_and_pop().x == 1);
    CHECK(points.wait_and_pop_for(1s)->x == 3);
    CHECK(points.wait_and_pop_until(Clock::now() + 1s)->x == 5);
    CHECK(points.try_pop()->x == 1);
    CHECK(points.wait_and_pop_for(0s)->x == 1);
    CHECK(points.wait_and_pop_until(Clock::time_point::min())->x == 1);
    CHECK(!points.wait_and_pop_for(5ms));
    CHECK(!points.wait_and_pop_until(Clock::now() + 5ms));
    CHECK(!points.wait_and_pop_until(Clock::time_point::min()));
  });
}

TEST_CASE_FIXTURE(Fixture, "an item with a string is popped by value") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto notes = shm.queue<Note>("notes", with(engine));
    const std::string text(1000, 'x');
    Note note;
    note.text = text.c_str();
    CHECK(notes.put(note) == Status::Ok);
    CHECK(notes.wait_and_pop().text == text.c_str());
  });
}

TEST_CASE_FIXTURE(Fixture, "an item that could not be copied out is the next one to be popped") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<Fragile>("fragile", with(engine, 4));
    for (int round = 0; round < 20; ++round) {
      for (int n = 0; n < 3; ++n) REQUIRE(queue.emplace(3 * round + n) == Status::Ok);
      {
        const Breaks breaks;
        CHECK_THROWS_WITH((void)queue.try_pop(), "copied");
        CHECK_THROWS_WITH((void)queue.wait_and_pop_for(1s), "copied");
        CHECK_THROWS_WITH((void)queue.wait_and_pop(), "copied");
      }
      CHECK(queue.size() == 3);
      const auto first = queue.try_pop();
      REQUIRE(first);
      CHECK(first->number == 3 * round);
      const auto second = queue.wait_and_pop_for(1s);
      REQUIRE(second);
      CHECK(second->number == 3 * round + 1);
      CHECK(queue.wait_and_pop().number == 3 * round + 2);
      CHECK(queue.is_empty());
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "an item that one thread could not copy reaches another that waits") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<Fragile>("fragile", with(engine));
    for (int round = 0; round < 20; ++round) {
      REQUIRE(queue.emplace(round) == Status::Ok);
      std::atomic<bool> is_copying{false};
      std::atomic<bool> is_waiting{false};
      Fragile::on_copy = [&, first = std::this_thread::get_id()] {
        if (std::this_thread::get_id() != first) return;
        is_copying = true;
        while (!is_waiting) std::this_thread::yield();
        std::this_thread::sleep_for(2ms);  // most likely it sleeps by now; right in any case
        throw std::runtime_error("copied");
      };
      std::optional<int> popped;
      std::thread waiter([&] {
        while (!is_copying) std::this_thread::yield();
        is_waiting = true;
        popped = queue.wait_and_pop().number;
      });
      CHECK_THROWS_WITH((void)queue.try_pop(), "copied");
      waiter.join();
      Fragile::on_copy = nullptr;
      CHECK(popped == round);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a handle that goes puts back what it could not copy out") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto puts = shm.queue<Fragile>("fragile", with(engine));
    auto other = shm.queue<Fragile>("fragile", with(engine));
    other.listen();
    for (const bool also_puts : {false, true}) {
      auto goes = std::make_unique<Fragiles>(shm.queue<Fragile>("fragile", with(engine)));
      if (also_puts) REQUIRE(goes->emplace(8) == Status::Ok);
      REQUIRE(puts.emplace(9) == Status::Ok);
      {
        const Breaks breaks;
        CHECK_THROWS_WITH((void)goes->try_pop(), "copied");
      }
      CHECK(goes->size() == (also_puts ? 2 : 1));
      CHECK(other.size() == (also_puts ? 1 : 0));
      goes.reset();
      std::multiset<int> numbers;
      while (const auto item = other.try_pop()) numbers.insert(item->number);
      CHECK(numbers == (also_puts ? std::multiset<int>{8, 9} : std::multiset<int>{9}));
    }
    // There is no room: the item goes with the handle.
    auto goes = std::make_unique<Fragiles>(shm.queue<Fragile>("fragile", with(engine, 1)));
    REQUIRE(goes->emplace(1) == Status::Ok);
    {
      const Breaks breaks;
      CHECK_THROWS_WITH((void)goes->try_pop(), "copied");
    }
    REQUIRE(goes->emplace(2) == Status::Ok);
    goes.reset();
    const auto item = other.try_pop();
    REQUIRE(item);
    CHECK(item->number == 2);
    CHECK(!other.try_pop());
  });
}

TEST_CASE_FIXTURE(Fixture, "a full queue: Refuse says so at once, Policy::Block in time") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    for (const Policy policy : {Policy::Block, Policy::Refuse}) {
      auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 3, policy));
      for (std::uint64_t n = 0; n < 3; ++n) CHECK(tasks.put(task(tasks, n)) == Status::Ok);
      auto kept = task(tasks, 3);
      CHECK(tasks.try_put(std::move(kept)) == Status::Full);
      REQUIRE(kept);  // it stays with the caller
      CHECK(tasks.put_for(std::move(kept), 5ms) == Status::Full);
      if (policy == Policy::Refuse) CHECK(tasks.put(std::move(kept)) == Status::Full);
      CHECK(kept->number == 3);
      CHECK(tasks.try_pop().value()->number == 0);
      CHECK(tasks.put(std::move(kept)) == Status::Ok);
      CHECK(!kept);
      for (std::uint64_t n = 1; n < 4; ++n) CHECK(tasks.wait_and_pop()->number == n);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a full queue under Policy::Overwrite keeps the newest items") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 4, Policy::Overwrite));
    for (std::uint64_t n = 0; n < 11; ++n) CHECK(tasks.put(task(tasks, n)) == Status::Ok);
    CHECK(tasks.size() == 4);
    for (std::uint64_t n = 7; n < 11; ++n) CHECK(tasks.wait_and_pop()->number == n);
    CHECK(tasks.is_empty());
  });
}

TEST_CASE_FIXTURE(Fixture, "a put into a full queue waits until another process pops") {
  with_each_engine([&](QueueEngine engine) {
    Child popper([&] {
      lot::ShmEngine shm(options);
      auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 2));
      for (std::uint64_t n = 0; n < 200; ++n) {
        if (n % 20 == 0) std::this_thread::sleep_for(2ms);
        must(tasks.wait_and_pop()->number == n, "the next one");
      }
    });
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 2));
    for (std::uint64_t n = 0; n < 200; ++n) CHECK(tasks.put(task(tasks, n)) == Status::Ok);
    CHECK(popper.wait() == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "every reader gets a shared item, and owns it") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto one = shm.queue<lot::ShmSharedPtr<const Task>>("views", with(engine));
    auto two = shm.queue<lot::ShmSharedPtr<const Task>>("views", with(engine));
    one.listen();
    two.listen();
    auto made = one.make();
    made->number = 7;
    const lot::ShmSharedPtr<const Task> put = std::move(made);
    CHECK(one.put(put) == Status::Ok);
    const auto first = one.wait_and_pop();
    const auto second = two.wait_and_pop();
    CHECK(first == put);
    CHECK(second == put);
    CHECK(second->number == 7);
    CHECK(first.use_count() == 3);
  });
}

TEST_CASE_FIXTURE(Fixture, "a queue of shared items is a topic") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<lot::ShmSharedPtr<const Task>>("/t", with(engine));
    auto puller = shm.subscribe<Task>("/t");
    queue.listen();
    auto pusher = shm.advertise<Task>("/t", {Policy::Overwrite, 8, 1s, engine});
    auto pushed = pusher.loan();
    pushed->number = 1;
    must_go(pusher.push(std::move(pushed)));
    CHECK(queue.wait_and_pop()->number == 1);
    CHECK(puller.pull(1s)->number == 1);
    auto made = queue.make();
    made->number = 2;
    CHECK(queue.put(lot::ShmSharedPtr<const Task>(std::move(made))) == Status::Ok);
    CHECK(puller.pull(1s)->number == 2);
  });
}

TEST_CASE_FIXTURE(Fixture, "a topic and a queue of items for one do not mix") {
  lot::ShmEngine shm(options);
  auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("/t");
  CHECK_THROWS_WITH_AS((void)shm.subscribe<Task>("/t"), doctest::Contains("ShmQueue of"),
                       lot::Error);
}

TEST_CASE_FIXTURE(Fixture, "values and ShmUniquePtr are put into the same queue") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto values = shm.queue<Point>("points", with(engine));
    auto pointers = shm.queue<lot::ShmUniquePtr<Point>>("points", with(engine));
    CHECK(values.put({1, 2}) == Status::Ok);
    CHECK(pointers.wait_and_pop()->y == 2);
    CHECK(pointers.put(pointers.make(3.0, 4.0)) == Status::Ok);
    CHECK(values.wait_and_pop().y == 4);
  });
}

TEST_CASE_FIXTURE(Fixture, "an empty pointer is refused, and any deadline is one") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 1));
    auto views = shm.queue<lot::ShmSharedPtr<const Task>>("views", with(engine));
    CHECK_THROWS_WITH_AS((void)tasks.put(nullptr), doctest::Contains("an empty pointer"),
                         lot::Error);
    CHECK_THROWS_WITH_AS((void)views.put(nullptr), doctest::Contains("an empty pointer"),
                         lot::Error);
    const auto long_ago = Clock::time_point::min() + 1ns;
    CHECK(tasks.put_until(tasks.make(), long_ago) == Status::Ok);
    CHECK(tasks.put_until(tasks.make(), long_ago) == Status::Full);
    CHECK(tasks.put_for(tasks.make(), -1h) == Status::Full);
    CHECK(tasks.wait_and_pop_until(Clock::time_point::max()));
    CHECK(!tasks.wait_and_pop_until(long_ago));
    CHECK(!tasks.wait_and_pop_for(std::chrono::nanoseconds::min()));
  });
}

TEST_CASE_FIXTURE(Fixture, "an item that was taken can be changed, and put again") {
  with_each_engine([&](QueueEngine engine) {
    Child worker([&] {
      lot::ShmEngine shm(options);
      auto in = shm.queue<lot::ShmUniquePtr<Task>>("in", with(engine));
      auto out = shm.queue<lot::ShmUniquePtr<Task>>("out", with(engine));
      for (std::uint64_t n = 0; n < 50; ++n) {
        auto item = in.wait_and_pop();
        must(item->number == n && item->numbers.at(99) == n, "the item");
        item->number += 1000;
        item->numbers[0] = 2000 + n;
        must(out.put(std::move(item)) == Status::Ok, "put again");
      }
      // All are read before the one that has put them leaves.
      must(eventually([&] { return in.try_pop().has_value(); }), "the end");
    });
    lot::ShmEngine shm(options);
    auto in = shm.queue<lot::ShmUniquePtr<Task>>("in", with(engine));
    auto out = shm.queue<lot::ShmUniquePtr<Task>>("out", with(engine));
    for (std::uint64_t n = 0; n < 50; ++n) {
      CHECK(in.put(task(in, n)) == Status::Ok);
      const auto back = out.wait_and_pop();
      CHECK(back->number == 1000 + n);
      CHECK(back->numbers[0] == 2000 + n);
      CHECK(back->numbers[1] == n);
    }
    CHECK(in.put(task(in, 0)) == Status::Ok);
    CHECK(worker.wait() == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "an item that was taken from another process can not grow there") {
  Steps steps;
  Child maker([&] {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks");
    must(tasks.put(task(tasks, 1)) == Status::Ok, "put");
    steps.next();
  });
  lot::ShmEngine shm(options);
  auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks");
  auto item = tasks.wait_and_pop();
  CHECK_THROWS_AS(item->numbers.resize(100'000), lot::OutOfMemory);
  CHECK(item->numbers.size() == 100);
  steps.tell();
  CHECK(maker.wait() == 0);
}

struct Referring {
  lot::ShmRef<const Task> task;
};

TEST_CASE_FIXTURE(Fixture, "an item that was taken from another process can not refer to others") {
  Steps steps;
  Child maker([&] {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<lot::ShmUniquePtr<Referring>>("q");
    must(queue.put(queue.make()) == Status::Ok, "put");
    steps.next();
  });
  lot::ShmEngine shm(options);
  auto queue = shm.queue<lot::ShmUniquePtr<Referring>>("q");
  auto item = queue.wait_and_pop();
  const lot::ShmSharedPtr<const Task> target = shm.make<Task>();
  CHECK_THROWS_WITH_AS(item->task = target, doctest::Contains("can not refer"), lot::Error);
  item.reset();
  steps.tell();
  CHECK(maker.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "an item that was taken keeps what it refers to until it goes home") {
  Steps steps;
  Child maker([&] {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<lot::ShmUniquePtr<Referring>>("q");
    lot::ShmSharedPtr<const Task> target = shm.make<Task>();
    const lot::ShmWeakPtr<const Task> weak = target;
    auto item = queue.make();
    item->task = target;
    target.reset();
    must(queue.put(std::move(item)) == Status::Ok, "put");
    steps.next();
    must(eventually([&] { return weak.expired(); }), "what it referred to has gone");
  });
  lot::ShmEngine shm(options);
  auto queue = shm.queue<lot::ShmUniquePtr<Referring>>("q");
  auto item = queue.wait_and_pop();
  CHECK(item->task);
  item->task.reset();
  item.reset();
  steps.tell();
  CHECK(maker.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "items that are handed on for ever give their memory back") {
  auto small = options;
  small.segment += "_small";
  small.blocks = 256;
  for (const QueueEngine engine : kEngines) {
    lot::ShmEngine shm(small);
    auto one = shm.queue<lot::ShmUniquePtr<Task>>("one", with(engine));
    auto two = shm.queue<lot::ShmUniquePtr<Task>>("two", with(engine));
    for (std::uint64_t n = 0; n < 5000; ++n) {
      REQUIRE(one.put(task(one, n)) == Status::Ok);
      REQUIRE(two.put(one.wait_and_pop()) == Status::Ok);
      CHECK(two.wait_and_pop()->number == n);
    }
  }
}

TEST_CASE_FIXTURE(Fixture, "items that many threads hand round keep what they are, and all die") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto one = shm.queue<lot::ShmUniquePtr<Task>>("one", with(engine));
    auto two = shm.queue<lot::ShmUniquePtr<Task>>("two", with(engine));
    for (std::uint64_t n = 0; n < 30; ++n) REQUIRE(one.put(task(one, n)) == Status::Ok);
    std::atomic<bool> whole{true};
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t) {
      threads.emplace_back([&, t] {
        auto& from = t % 2 == 0 ? one : two;
        auto& to = t % 2 == 0 ? two : one;
        for (int n = 0; n < 3000; ++n) {
          auto item = from.wait_and_pop_for(1ms);
          if (!item) continue;
          if ((*item)->numbers.back() != (*item)->number) whole = false;
          if (to.put(std::move(*item)) != Status::Ok) whole = false;
        }
      });
    }
    for (auto& thread : threads) thread.join();
    CHECK(whole);
    CHECK(one.size() + two.size() == 30);
    for (auto* queue : {&one, &two}) {
      while (queue->try_pop()) {
      }
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "items of a handle that goes at once reach the process that waits") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine));
    auto views = shm.queue<lot::ShmSharedPtr<const Task>>("views", with(engine));
    views.listen();
    for (std::uint64_t round = 0; round < 20; ++round) {
      Child brief([&] {
        lot::ShmEngine mine(options);
        auto queue = mine.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine));
        auto shared = mine.queue<lot::ShmSharedPtr<const Task>>("views", with(engine));
        for (std::uint64_t n = 0; n < 3; ++n) {
          must(queue.put(task(queue, n)) == Status::Ok, "put");
          auto made = shared.make();
          made->number = n;
          must(shared.put(lot::ShmSharedPtr<const Task>(std::move(made))) == Status::Ok, "put");
        }
      });
      std::thread viewer([&] {
        for (std::uint64_t n = 0; n < 3; ++n) CHECK(views.wait_and_pop()->number == n);
      });
      for (std::uint64_t n = 0; n < 3; ++n) CHECK(tasks.wait_and_pop()->number == n);
      viewer.join();
      CHECK(brief.wait() == 0);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a queue with Overwrite gives its oldest up when memory runs out") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);  // 64 MiB
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 64, Policy::Overwrite));
    for (std::uint64_t n = 0; n < 200; ++n) {
      auto big = tasks.make();
      big->number = n;
      big->numbers.resize(1 << 17);  // 1 MiB
      REQUIRE(tasks.put(std::move(big)) == Status::Ok);
      if (n % 7 == 0) {
        CHECK(tasks.try_pop().has_value());
      }
    }
    std::uint64_t last = 0;
    while (const auto item = tasks.try_pop()) {
      CHECK((*item)->number > last);
      last = (*item)->number;
    }
    CHECK(last == 199);
  });
}

TEST_CASE_FIXTURE(Fixture, "the only pointer to an item that was taken counts as one") {
  Steps steps;
  Child maker([&] {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks");
    must(tasks.put(task(tasks, 1)) == Status::Ok, "put");
    steps.next();
  });
  lot::ShmEngine shm(options);
  auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks");
  const lot::ShmSharedPtr<const Task> shared = tasks.wait_and_pop();
  CHECK(shared.use_count() == 1);
  steps.tell();
  CHECK(maker.wait() == 0);
}

TEST_CASE_FIXTURE(Fixture, "a queue in a forked child is an error, whatever its threads were at") {
  lot::ShmEngine shm(options);
  auto points = shm.queue<Point>("points");
  std::atomic<bool> stop{false};
  std::thread popper([&] {
    while (!stop) (void)points.try_pop();
  });
  for (int n = 0; n < 20; ++n) {
    Child child([&] {
      int refused = 0;
      const auto refuses = [&](auto&& use) {
        try {
          use();
        } catch (const lot::Error&) {
          ++refused;
        }
      };
      refuses([&] { (void)points.try_pop(); });
      refuses([&] { (void)points.size(); });
      refuses([&] { points.listen(); });
      refuses([&] { (void)points.put({1, 2}); });
      must(refused == 4, "refused");
    });
    CHECK(child.wait() == 0);
  }
  stop = true;
  popper.join();
}

TEST_CASE_FIXTURE(Fixture, "an item becomes shared after it was taken") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 2));
    std::vector<lot::ShmSharedPtr<const Task>> kept;
    for (std::uint64_t n = 0; n < 20; ++n) {
      CHECK(tasks.put(task(tasks, n)) == Status::Ok);
      kept.emplace_back(tasks.wait_and_pop());
      kept.push_back(kept.back());
    }
    for (std::uint64_t n = 0; n < 20; ++n) {
      CHECK(kept[2 * n]->number == n);
      CHECK(kept[2 * n]->numbers.back() == n);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "the memory of items that were taken is used again") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);  // 64 MiB
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 64));
    for (std::uint64_t n = 0; n < 200; ++n) {
      auto big = tasks.make();
      big->numbers.resize(1 << 20);  // 8 MiB
      CHECK(tasks.put(std::move(big)) == Status::Ok);
      CHECK(tasks.wait_and_pop()->numbers.size() == 1 << 20);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "items wait in the queue for the reader that comes later") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 8));
    for (std::uint64_t n = 0; n < 5; ++n) CHECK(tasks.put(task(tasks, n)) == Status::Ok);
    CHECK(tasks.wait_and_pop()->number == 0);
    Child late([&] {
      lot::ShmEngine other(options);
      auto mine = other.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 8));
      must(mine.size() == 4, "what is there");
      for (std::uint64_t n = 1; n < 5; ++n) must(mine.wait_and_pop()->number == n, "the next");
    });
    CHECK(late.wait() == 0);
    CHECK(tasks.is_empty());
  });
}

TEST_CASE_FIXTURE(Fixture, "what a killed process has put is still taken") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine));
    tasks.listen();
    Steps steps;
    Child maker([&] {
      lot::ShmEngine other(options);
      auto mine = other.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine));
      for (std::uint64_t n = 0; n < 5; ++n) must(mine.put(task(mine, n)) == Status::Ok, "put");
      steps.tell();
      pause();
    });
    REQUIRE(steps.next() != 0);
    maker.kill9();
    for (std::uint64_t n = 0; n < 5; ++n) {
      const auto item = tasks.wait_and_pop();
      CHECK(item->number == n);
      CHECK(item->numbers.back() == n);
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "each item is taken by exactly one, also when some of them are killed") {
  std::mt19937_64 random(seed());
  with_each_engine([&](QueueEngine engine) {
    constexpr std::uint64_t kItems = 3000;
    // Who has taken an item says so in memory of the test's own.
    auto* taken = static_cast<std::atomic<std::uint32_t>*>(
        mmap(nullptr, kItems * 4, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
    REQUIRE(taken != MAP_FAILED);
    const auto work = [&] {
      lot::ShmEngine shm(options);
      auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 16));
      for (;;) {
        const auto item = tasks.wait_and_pop();
        if (item->number >= kItems) return;
        must(item->numbers.back() == item->number, "whole");
        ++taken[item->number];
      }
    };
    constexpr std::size_t kWorkers = 4;
    std::vector<Child> workers;
    for (std::size_t i = 0; i < kWorkers; ++i) workers.emplace_back(work);
    std::uint64_t kills = 0;
    {
      lot::ShmEngine shm(options);
      auto tasks = shm.queue<lot::ShmUniquePtr<Task>>("tasks", with(engine, 16));
      for (std::uint64_t n = 0; n < kItems; ++n) {
        REQUIRE(tasks.put(task(tasks, n)) == Status::Ok);
        if (n % 100 != 0) continue;
        const std::size_t i = random() % kWorkers;
        workers[i].kill9();
        workers[i] = Child(work);
        ++kills;
      }
      for (std::size_t i = 0; i < kWorkers; ++i) {
        REQUIRE(tasks.put(task(tasks, kItems)) == Status::Ok);
      }
      for (Child& worker : workers) CHECK(worker.wait() == 0);
    }
    std::uint64_t lost = 0;
    for (std::uint64_t n = 0; n < kItems; ++n) {
      CHECK(taken[n] <= 1);
      lost += taken[n] == 0;
    }
    CHECK(lost <= kills);  // what a killed one had taken died with it
    munmap(taken, kItems * 4);
  });
}

TEST_CASE_FIXTURE(Fixture, "a pop that sleeps hears of a process that comes later") {
  with_each_engine([&](QueueEngine engine) {
    Child late([&] {
      std::this_thread::sleep_for(20ms);
      lot::ShmEngine other(options);
      auto mine = other.queue<Point>("points", with(engine));
      must(mine.put({1, 2}) == Status::Ok, "put");
      std::this_thread::sleep_for(20ms);
    });
    lot::ShmEngine shm(options);
    auto points = shm.queue<Point>("points", with(engine));
    CHECK(points.wait_and_pop().y == 2);
    CHECK(late.wait() == 0);
  });
}

TEST_CASE_FIXTURE(Fixture, "LOT_QUEUE in the environment comes before the code") {
  lot::ShmEngine shm(options);
  const lot::segment::Segment segment(shm.path());
  const auto engine_of_the_only_ring = [&] {
    for (const auto& channel : segment.channels()) {
      if (lot::ring::writer_state(channel.writer.load()) == lot::ring::State::Live) {
        return static_cast<QueueEngine>(channel.engine);
      }
    }
    throw std::runtime_error("there is none");
  };
  const char* before = std::getenv("LOT_QUEUE");
  const std::string saved = before != nullptr ? before : "";
  setenv("LOT_QUEUE", "mutex", 1);
  {
    auto pusher = shm.advertise<Point>("/t", {Policy::Overwrite, 4, 1s, QueueEngine::Ring});
    CHECK((engine_of_the_only_ring() == QueueEngine::Mutex));
  }
  REQUIRE(eventually([&] { return Audit(const_cast<lot::segment::Segment&>(segment)).nothing(); }));
  setenv("LOT_QUEUE", "ring", 1);
  {
    auto pusher = shm.advertise<Point>("/t", {Policy::Overwrite, 4, 1s, QueueEngine::Mutex});
    CHECK((engine_of_the_only_ring() == QueueEngine::Ring));
  }
  setenv("LOT_QUEUE", "fast", 1);
  CHECK_THROWS_WITH_AS((void)shm.advertise<Point>("/t"), doctest::Contains("LOT_QUEUE=fast"),
                       lot::Error);
  if (before != nullptr) {
    setenv("LOT_QUEUE", saved.c_str(), 1);
  } else {
    unsetenv("LOT_QUEUE");
  }
}

TEST_CASE_FIXTURE(Fixture, "a bad depth and another type are said when the queue is made") {
  lot::ShmEngine shm(options);
  QueueOptions none;
  none.depth = 0;
  CHECK_THROWS_WITH_AS((void)shm.queue<Point>("q", none), doctest::Contains("depth 0"), lot::Error);
  auto points = shm.queue<Point>("q");
  CHECK_THROWS_AS((void)shm.queue<Task>("q"), lot::Error);
}

TEST_CASE_FIXTURE(Fixture, "a queue is made as its options say, for each kind of item") {
  unsetenv("LOT_FAST_LANE");  // it would come before the option
  lot::ShmEngine shm(options);
  lot::segment::Segment segment(shm.path());
  struct Made {
    std::uint32_t depth, policy, engine, taken;
    bool in_slots;
    bool operator==(const Made&) const = default;
  };
  const auto made = [&](auto& queue) {
    must_go(queue.emplace());
    for (std::uint32_t c = 0; c < segment.capacity().channels; ++c) {
      const auto& channel = segment.channels()[c];
      if (lot::ring::writer_state(channel.writer.load()) != lot::ring::State::Live) continue;
      return Made{channel.depth, channel.policy, channel.engine, channel.taken,
                  segment.ring(c).in_slots()};
    }
    throw std::runtime_error("there is none");
  };
  const auto block = static_cast<std::uint32_t>(Policy::Block);
  const auto refuse = static_cast<std::uint32_t>(Policy::Refuse);
  for (const QueueEngine engine : kEngines) {
    CAPTURE(static_cast<int>(engine));
    const auto kind = static_cast<std::uint32_t>(engine);
    auto how = with(engine, 7, Policy::Refuse);
    for (const bool fast : {true, false}) {
      CAPTURE(fast);
      how.fast_lane = fast;
      {
        auto queue = shm.queue<Point>("q", how);
        CHECK(made(queue) == Made{7, refuse, kind, 1, fast});
        CHECK(queue.capacity() == 7);
        CHECK(queue.try_pop());
      }
      {
        how.redeliver = true;
        auto queue = shm.queue<Point>("q", how);
        CHECK(made(queue) == Made{7, refuse, kind, 2, fast});
        queue.try_take().finish();
        how.redeliver = false;
      }
      CHECK(eventually([&] { return Audit(segment).nothing(); }));
    }
  }
  {
    auto queue = shm.queue<Point>("q");
    CHECK(made(queue) == Made{64, block, static_cast<std::uint32_t>(QueueEngine::Ring), 1, true});
    CHECK(queue.try_pop());
  }
}

TEST_CASE_FIXTURE(Fixture, "what a queue refuses when it is made, it says in full") {
  lot::ShmEngine shm(options);
  auto how = with(QueueEngine::Ring, 4, Policy::Overwrite);
  how.redeliver = true;
  const auto refused = [](auto&& make) {
    try {
      make();
    } catch (const lot::Error& e) {
      return std::pair{e.error_number(), std::string(e.what())};
    }
    return std::pair{0, std::string()};
  };
  const std::pair over{
      EINVAL,
      std::string(lot::Error(EINVAL, "q", "a queue that redelivers cannot overwrite its items",
                             "use Policy::Block or Policy::Refuse")
                      .what())};
  CHECK(refused([&] { (void)shm.queue<Point>("q", how); }) == over);
  for (const Policy policy : {Policy::Block, Policy::Refuse}) {
    how.policy = policy;
    CHECK(refused([&] { (void)shm.queue<Point>("q", how); }).first == 0);
    CHECK(refused([&] { (void)shm.queue<lot::ShmUniquePtr<Task>>("p", how); }).first == 0);
    const auto shared = refused([&] { (void)shm.queue<lot::ShmSharedPtr<const Task>>("v", how); });
    CHECK(shared.first == EINVAL);
  }
  how.redeliver = false;
  how.policy = Policy::Overwrite;
  CHECK(refused([&] { (void)shm.queue<Point>("q", how); }).first == 0);
  {
    // What is popped is not taken, and the other way round.
    auto pops = shm.queue<Point>("pops");
    CHECK(refused([&] { (void)pops.try_take(); }) ==
          std::pair{EINVAL,
                    std::string(lot::Error(EINVAL, "pops",
                                           "the queue was made without QueueOptions::redeliver",
                                           "pop its items, or set redeliver in each process that "
                                           "uses it")
                                    .what())});
    how.redeliver = true;
    how.policy = Policy::Block;
    auto takes = shm.queue<Point>("takes", how);
    CHECK(refused([&] { (void)takes.try_pop(); }) ==
          std::pair{EINVAL,
                    std::string(lot::Error(EINVAL, "takes",
                                           "an item of a queue that redelivers cannot be popped",
                                           "wait_and_take() it, and finish() it when it is done")
                                    .what())});
    // A handle that redelivers and one that does not never meet: their types differ by name.
    const auto other = refused([&] { (void)shm.queue<Point>("takes"); });
    CHECK(other.first == EPROTOTYPE);
    CHECK(other.second.find("ShmQueue with redelivery of ") != std::string::npos);
    CHECK(other.second.find("ShmQueue of ") != std::string::npos);
  }
}

TEST_CASE_FIXTURE(Fixture, "a ShmTask that is moved, assigned, finished or given back") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto how = with(engine, 8);
    how.redeliver = true;
    auto queue = shm.queue<Point>("tasks", how);
    for (int n = 1; n <= 3; ++n) REQUIRE(queue.put({1.0 * n, 0}) == Status::Ok);
    lot::ShmTask<Point> none;
    CHECK(!none);
    CHECK(none.get() == nullptr);
    CHECK(none.deliveries() == 0);
    none.finish();
    none.give_back();

    auto one = queue.try_take();
    REQUIRE(one);
    CHECK(one.get()->x == 1);
    CHECK((*one).x == 1);
    CHECK(one->x == 1);
    CHECK(one.deliveries() == 1);
    lot::ShmTask<Point> moved(std::move(one));
    CHECK(!one);  // NOLINT: what is left of it
    CHECK(one.get() == nullptr);
    CHECK(one.deliveries() == 0);
    CHECK(moved->x == 1);
    CHECK(queue.size() == 2);
    // Assigned to itself it stays.
    auto& same = moved;
    moved = std::move(same);
    REQUIRE(moved);
    CHECK(moved->x == 1);
    CHECK(queue.size() == 2);
    // Another one in its place: the first is given back.
    auto two = queue.try_take();
    REQUIRE(two);
    CHECK(two->x == 2);
    moved = std::move(two);
    CHECK(!two);  // NOLINT: what is left of it
    CHECK(moved->x == 2);
    CHECK(moved.deliveries() == 1);
    CHECK(queue.size() == 2);
    auto again = queue.try_take();
    REQUIRE(again);
    CHECK(again->x == 1);
    CHECK(again.deliveries() == 2);
    again.finish();
    CHECK(!again);
    CHECK(again.get() == nullptr);
    again.finish();  // nothing
    again.give_back();
    moved.finish();
    CHECK(queue.size() == 1);
    // One that goes is given back.
    for (std::uint32_t n = 1; n <= 3; ++n) {
      const auto goes = queue.try_take();
      REQUIRE(goes);
      CHECK(goes->x == 3);
      CHECK(goes.deliveries() == n);
      CHECK(queue.size() == 0);
    }
    CHECK(queue.size() == 1);
    auto last = queue.wait_and_take_for(1s);
    REQUIRE(last);
    last.give_back();
    CHECK(!last);
    CHECK(queue.size() == 1);
    queue.wait_and_take().finish();
    CHECK(queue.is_empty());
    CHECK(!queue.try_take());
    CHECK(!queue.wait_and_take_for(2ms));
    CHECK(!queue.wait_and_take_until(Clock::time_point::min()));
  });
}

TEST_CASE_FIXTURE(Fixture, "a put that is told to stop copies nothing, a Full one keeps it") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    lot::StopSource source;
    source.request_stop();
    const auto stop = source.get_token();
    auto fragile = shm.queue<Fragile>("fragile", with(engine, 2));
    const Fragile item(1);
    {
      const Breaks breaks;  // a copy would throw
      CHECK(fragile.put(item, stop) == Status::Stopped);
      CHECK(fragile.put(Fragile(item.number), stop) == Status::Stopped);
      CHECK(fragile.put_for(item, 1h, stop) == Status::Stopped);
      CHECK(fragile.put_until(item, Clock::now() + 1h, stop) == Status::Stopped);
      CHECK_THROWS_WITH((void)fragile.put(item), "copied");
      CHECK_THROWS_WITH((void)fragile.try_put(item), "copied");
    }
    CHECK(fragile.is_empty());
    REQUIRE(fragile.put(item) == Status::Ok);
    CHECK(!fragile.wait_and_pop(stop));
    CHECK(!fragile.wait_and_pop_for(1h, stop));
    CHECK(fragile.size() == 1);
    const auto popped = fragile.wait_and_pop(lot::StopToken());
    REQUIRE(popped);
    CHECK(popped->number == 1);

    // A shared pointer is null once its item is in the queue, and not before.
    auto views = shm.queue<lot::ShmSharedPtr<const Task>>("views", with(engine, 2));
    auto reader = shm.queue<lot::ShmSharedPtr<const Task>>("views", with(engine, 2));
    reader.listen();
    for (std::uint64_t n = 1; n <= 2; ++n) {
      auto made = views.make();
      made->number = n;
      lot::ShmSharedPtr<const Task> shared(std::move(made));
      const auto copy = shared;
      CHECK(views.put(std::move(shared)) == Status::Ok);
      CHECK(!shared);  // NOLINT: it was put
      CHECK(copy);
    }
    lot::ShmSharedPtr<const Task> third(views.make());
    CHECK(views.try_put(std::move(third)) == Status::Full);
    REQUIRE(third);  // NOLINT: it stays
    CHECK(views.put_for(std::move(third), 2ms) == Status::Full);
    CHECK(views.put(std::move(third), stop) == Status::Stopped);
    REQUIRE(third);  // NOLINT: it stays
    CHECK(views.try_put(third) == Status::Full);
    CHECK(reader.try_pop().value()->number == 1);
    CHECK(views.put(third) == Status::Ok);
    REQUIRE(third);  // a copy was put
  });
}

TEST_CASE_FIXTURE(Fixture, "a queue's descriptor and its wait set tell of what came back, too") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<Fragile>("fragile", with(engine));
    const auto readable = [](int fd, int timeout_ms) {
      pollfd p{fd, POLLIN, 0};
      return poll(&p, 1, timeout_ms) == 1;
    };
    const int fd = queue.fd();
    CHECK(fd > 2);
    CHECK(queue.fd() == fd);
    while (queue.try_pop()) {
    }
    CHECK(!readable(fd, 0));
    REQUIRE(queue.emplace(1) == Status::Ok);
    CHECK(readable(fd, 20'000));
    lot::WaitSet set;
    int calls = 0;
    set.add(queue, [&] { ++calls; });
    CHECK(set.run_once(20s) == 1);
    {
      const Breaks breaks;
      CHECK_THROWS_WITH((void)queue.try_pop(), "copied");
    }
    CHECK(queue.size() == 1);
    CHECK(set.run_once(20s) == 1);  // it is this handle's
    CHECK(readable(fd, 20'000));
    CHECK(calls == 2);
    const auto item = queue.try_pop();
    REQUIRE(item);
    CHECK(item->number == 1);
    CHECK(!queue.try_pop());
    CHECK(!readable(fd, 0));
    CHECK(set.run_once(2ms) == 0);
    set.remove(queue);
  });
}

TEST_CASE_FIXTURE(Fixture, "items that could not be copied come again, before the others") {
  lot::ShmEngine shm(options);
  auto queue = shm.queue<Fragile>("fragile", with(QueueEngine::Ring));
  for (int n = 1; n <= 3; ++n) REQUIRE(queue.emplace(n) == Status::Ok);
  // Two threads have an item each while neither can be copied.
  std::atomic<int> copying{0};
  Fragile::on_copy = [&] {
    ++copying;
    while (copying < 2) std::this_thread::yield();
    throw std::runtime_error("copied");
  };
  std::thread other([&] { CHECK_THROWS_WITH((void)queue.try_pop(), "copied"); });
  CHECK_THROWS_WITH((void)queue.try_pop(), "copied");
  other.join();
  Fragile::on_copy = nullptr;
  CHECK(queue.size() == 3);
  std::multiset<int> first;
  for (int n = 0; n < 2; ++n) first.insert(queue.try_pop().value().number);
  CHECK(first == std::multiset<int>{1, 2});
  CHECK(queue.try_pop().value().number == 3);
  CHECK(!queue.try_pop());
}

TEST_CASE_FIXTURE(Fixture, "each call of a queue is refused in a forked child that ends well") {
  lot::ShmEngine shm(options);
  auto how = with(QueueEngine::Ring);
  how.redeliver = true;
  auto points = std::make_unique<Points>(shm.queue<Point>("points"));
  auto tasks = shm.queue<Point>("tasks", how);
  points->fd();
  REQUIRE(points->put({1, 2}) == Status::Ok);
  REQUIRE(tasks.put({3, 4}) == Status::Ok);
  auto task = tasks.try_take();
  REQUIRE(task);
  Child child([&] {
    const auto refuses = [](auto&& use) {
      try {
        use();
      } catch (const lot::Error& e) {
        return e.error_number() == ECHILD;
      }
      return false;
    };
    must(refuses([&] { (void)points->try_pop(); }), "try_pop");
    must(refuses([&] { (void)points->wait_and_pop_for(1h); }), "wait_and_pop_for");
    must(refuses([&] { (void)points->size(); }), "size");
    must(refuses([&] { points->listen(); }), "listen");
    must(refuses([&] { (void)points->fd(); }), "fd");
    must(refuses([&] { (void)points->put({1, 2}); }), "put");
    must(refuses([&] { (void)points->make(); }), "make");
    must(refuses([&] { (void)tasks.try_take(); }), "try_take");
    must(refuses([&] { task.finish(); }), "finish");
    must(refuses([&] { (void)shm.queue<Point>("new"); }), "queue");
    must(points->capacity() == 64, "capacity");
    task.give_back();  // nothing: it is the parent's
    points.reset();
  });
  CHECK(child.wait() == 0);
  CHECK(tasks.size() == 0);
  CHECK(task->x == 3);
  task.finish();
  CHECK(points->try_pop().value().x == 1);
  CHECK(!points->try_pop());
}

TEST_SUITE_END();
