// SPDX-License-Identifier: Apache-2.0
// What the paper promises of its ShmQueue (section III), one part each, for both engines: several
// threads in several processes, on the same and on different instances.
//
//   (a) each thread sees a consistent view of the data
//   (b) no data is lost or corrupted
//   (c) no race conditions arise
//   (d) threads can do the same or distinct operations independently
#include <array>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/both_engines.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::QueueOptions;
using lot::Status;

/// Says who has put it and when, and looks different when half of it is somebody else's.
struct Item {
  std::uint32_t from = 0;
  std::uint32_t number = 0;
  std::array<std::uint64_t, 20> text{};

  static Item of(std::uint32_t from, std::uint32_t number) {
    Item item;
    item.from = from;
    item.number = number;
    item.text.fill(std::uint64_t{from} << 32 | number);
    return item;
  }
  bool whole() const {
    for (const std::uint64_t word : text) {
      if (word != (std::uint64_t{from} << 32 | number)) return false;
    }
    return true;
  }
};

using ForOne = lot::ShmQueue<Item>;
using ForAll = lot::ShmQueue<lot::ShmSharedPtr<const Item>>;

constexpr std::uint32_t kPutters = 4;   ///< two processes of two threads
constexpr std::uint32_t kItems = 2000;  ///< of each
constexpr std::uint32_t kEnd = ~std::uint32_t{0};

/// Counts in memory that all processes of a test share.
class Board {
 public:
  Board() {
    void* at =
        mmap(nullptr, sizeof(Counts), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    REQUIRE(at != MAP_FAILED);
    counts_ = new (at) Counts;
  }
  ~Board() { munmap(counts_, sizeof(Counts)); }
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  void got(const Item& item) { ++counts_->got[item.from][item.number]; }
  std::uint32_t times(std::uint32_t from, std::uint32_t number) const {
    return counts_->got[from][number];
  }
  std::atomic<std::uint32_t>& operator[](std::size_t i) { return counts_->free[i]; }

 private:
  struct Counts {
    std::atomic<std::uint32_t> got[kPutters][kItems] = {};
    std::atomic<std::uint32_t> free[8] = {};
  };
  Counts* counts_;
};

struct Fixture : BothEngines {
  Board board;

  QueueOptions with(QueueEngine engine, std::uint32_t depth = 32) const {
    QueueOptions o;
    o.engine = engine;
    o.depth = depth;
    return o;
  }
  /// Two threads in a process of their own. On one queue, or each on its own handle of it.
  template <class Queue, class Work>
  Child two_threads(QueueEngine engine, bool same, Work work) {
    return Child([=, this] {
      lot::ShmEngine shm(options);
      auto one = shm.queue<typename Queue::value_type>("q", with(engine));
      auto other = shm.queue<typename Queue::value_type>("q", with(engine));
      std::atomic<bool> failed{false};
      std::thread thread([&] {
        try {
          work(same ? one : other, 1U);
        } catch (const std::exception& e) {
          std::fprintf(stderr, "thread: %s\n", e.what());
          failed = true;
        }
      });
      try {
        work(one, 0U);
      } catch (const std::exception& e) {
        std::fprintf(stderr, "thread: %s\n", e.what());
        failed = true;
      }
      thread.join();
      must(!failed, "a thread of it has failed");
    });
  }
};

}  // namespace

TEST_SUITE_BEGIN("conformance");

TEST_CASE_FIXTURE(Fixture, "(a) of shared items, every handle sees all of each putter, in order") {
  for (const bool same : {false, true}) {
    CAPTURE(same);
    with_each_engine([&](QueueEngine engine) {
      constexpr std::uint32_t kReaders = 3;
      board[0] = 0;
      std::vector<Child> readers;
      for (std::uint32_t r = 0; r < kReaders; ++r) {
        readers.push_back(Child([&] {
          lot::ShmEngine shm(options);
          auto queue = shm.queue<lot::ShmSharedPtr<const Item>>("q", with(engine));
          queue.listen();
          ++board[0];
          std::array<std::uint32_t, kPutters> next{};
          for (std::uint32_t ends = 0; ends < kPutters;) {
            const auto item = queue.wait_and_pop();
            must(item->whole(), "whole");
            if (item->number == kEnd) {
              ++ends;
              continue;
            }
            must(item->number == next[item->from]++, "in order, none left out");
          }
          for (const std::uint32_t n : next) must(n == kItems, "all of them");
        }));
      }
      REQUIRE(eventually([&] { return board[0] == kReaders; }));
      std::vector<Child> putters;
      for (std::uint32_t p = 0; p < kPutters / 2; ++p) {
        putters.push_back(two_threads<ForAll>(engine, same, [p](ForAll& queue, std::uint32_t t) {
          const std::uint32_t from = 2 * p + t;
          const auto put = [&](std::uint32_t number) {
            auto made = queue.make(Item::of(from, number));
            must(queue.put(lot::ShmSharedPtr<const Item>(std::move(made))) == Status::Ok, "put");
          };
          for (std::uint32_t n = 0; n < kItems; ++n) put(n);
          put(kEnd);
        }));
      }
      for (Child& putter : putters) CHECK(putter.wait() == 0);
      for (Child& reader : readers) CHECK(reader.wait() == 0);
    });
  }
}

TEST_CASE_FIXTURE(Fixture, "(b) of items for one, none is lost, none is got twice, none is torn") {
  for (const bool same : {false, true}) {
    CAPTURE(same);
    with_each_engine([&](QueueEngine engine) {
      const Board fresh_board;
      auto& counts = const_cast<Board&>(fresh_board);
      counts[0] = 0;
      std::vector<Child> poppers;
      for (std::uint32_t p = 0; p < 2; ++p) {
        poppers.push_back(two_threads<ForOne>(engine, same, [&](ForOne& queue, std::uint32_t) {
          while (counts[0] < kPutters * kItems) {
            const auto item = queue.wait_and_pop_for(20ms);
            if (!item) continue;
            must(item->whole(), "whole");
            counts.got(*item);
            ++counts[0];
          }
        }));
      }
      std::vector<Child> putters;
      for (std::uint32_t p = 0; p < kPutters / 2; ++p) {
        putters.push_back(
            two_threads<ForOne>(engine, same, [p, &counts](ForOne& queue, std::uint32_t t) {
              for (std::uint32_t n = 0; n < kItems; ++n) {
                must(queue.put(Item::of(2 * p + t, n)) == Status::Ok, "put");
              }
              // What nobody reads any more goes with who has put it.
              must(eventually([&] { return counts[0] == kPutters * kItems; }, 90s), "all are got");
            }));
      }
      for (Child& putter : putters) CHECK(putter.wait() == 0);
      for (Child& popper : poppers) CHECK(popper.wait() == 0);
      for (std::uint32_t from = 0; from < kPutters; ++from) {
        for (std::uint32_t n = 0; n < kItems; ++n) REQUIRE(counts.times(from, n) == 1);
      }
    });
  }
}

TEST_CASE_FIXTURE(Fixture, "(c) all operations at once, at random, on the same handles") {
  const std::uint64_t s = seed();
  with_each_engine([&](QueueEngine engine) {
    const Board fresh_board;
    auto& counts = const_cast<Board&>(fresh_board);
    std::vector<Child> players;
    for (std::uint32_t p = 0; p < 2; ++p) {
      players.push_back(Child([&, p] {
        lot::ShmEngine shm(options);
        auto queue = shm.queue<Item>("q", with(engine, 8));
        std::atomic<bool> failed{false};
        std::vector<std::thread> threads;
        for (std::uint32_t t = 0; t < 3; ++t) {
          threads.emplace_back([&, t] {
            std::mt19937_64 random(s + 10 * p + t);
            // counts: 0 put, 1 popped; an item is put by (p, t) under a number of its own
            for (std::uint32_t n = 0; n < 1500;) {
              const auto got = [&](const std::optional<Item>& item) {
                if (!item) return;
                if (!item->whole()) failed = true;
                ++counts[1];
              };
              switch (random() % 8) {
                case 0:
                  got(queue.try_pop());
                  break;
                case 1:
                  got(queue.wait_and_pop_for(100us));
                  break;
                case 2:
                  got(queue.wait_and_pop_until(std::chrono::steady_clock::now() + 50us));
                  break;
                case 3:
                  if (queue.size() > 2 * 8) failed = true;  // two processes, 8 each
                  break;
                case 4:
                  (void)queue.is_empty();
                  break;
                default: {
                  const Item item = Item::of(4 * p + t, n);
                  const bool done = random() % 2 == 0 ? queue.try_put(item) == Status::Ok
                                                      : queue.put_for(item, 200us) == Status::Ok;
                  if (done) {
                    ++counts[0];
                    ++n;
                  }
                }
              }
            }
          });
        }
        for (auto& thread : threads) thread.join();
        must(!failed, "an item was torn, or there were more than fit");
        ++counts[2];
        must(eventually([&] { return counts[2] == 2; }, 90s), "the other one");
        while (const auto item = queue.wait_and_pop_for(10ms)) ++counts[1];
        ++counts[3];
        must(eventually([&] { return counts[3] == 2; }, 90s), "the other one");
      }));
    }
    for (Child& player : players) CHECK(player.wait() == 0);
    CHECK(counts[0] == 2 * 3 * 1500);
    CHECK(counts[1] == counts[0]);
  });
}

TEST_CASE_FIXTURE(Fixture, "(d) waiting on a queue keeps no process from anything else") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto queue = shm.queue<Item>("q", with(engine, 2));
    auto other = shm.queue<Item>("other", with(engine, 2));
    // On one handle: a thread that waits for an item, while this one does everything else.
    std::thread waiter([&] {
      for (std::uint32_t n = 0; n < 3; ++n) (void)queue.wait_and_pop();  // any item
    });
    std::this_thread::sleep_for(20ms);  // most likely asleep by now
    CHECK(!queue.wait_and_pop_for(1ms));
    CHECK(queue.is_empty());
    CHECK(other.put(Item::of(0, 0)) == Status::Ok);
    CHECK(other.try_pop().has_value());
    for (std::uint32_t n = 0; n < 3; ++n) CHECK(queue.put(Item::of(0, n)) == Status::Ok);
    waiter.join();
    // A thread that waits for room, and one that makes it.
    CHECK(queue.put(Item::of(0, 0)) == Status::Ok);
    CHECK(queue.put(Item::of(0, 1)) == Status::Ok);
    std::thread putter([&] { CHECK(queue.put(Item::of(0, 2)) == Status::Ok); });
    std::this_thread::sleep_for(20ms);
    CHECK(queue.size() == 2);
    CHECK(queue.try_put(Item::of(0, 3)) == Status::Full);
    CHECK(queue.try_pop()->number == 0);
    putter.join();
    CHECK(queue.wait_and_pop().number == 1);
    CHECK(queue.wait_and_pop().number == 2);
    // In several processes: one that is stopped in the middle of its work stops nobody of the ring.
    if (engine != QueueEngine::Ring) return;
    Child stopped([&] {
      lot::ShmEngine mine(options);
      auto handle = mine.queue<Item>("q", with(engine, 2));
      for (std::uint32_t n = 0;; ++n) {
        (void)handle.try_put(Item::of(1, n));
        (void)handle.try_pop();
      }
    });
    std::this_thread::sleep_for(5ms);
    stopped.send(SIGSTOP);
    for (std::uint32_t n = 0; n < 100; ++n) {
      while (queue.try_put(Item::of(0, n)) != Status::Ok) (void)queue.try_pop();
      (void)queue.try_pop();
    }
    stopped.kill9();
    while (queue.wait_and_pop_for(20ms)) {  // what it has left waits
    }
  });
}

TEST_SUITE_END();
