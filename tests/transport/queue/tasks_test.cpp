// SPDX-License-Identifier: Apache-2.0
// Items that wait for whoever takes them, whatever becomes of those who put them; and tasks, which
// come back when their worker does not finish them. Both engines.
#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <memory>
#include <random>
#include <stdexcept>
#include <sys/mman.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "support/both_engines.hpp"
#include "support/error_of.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::QueueEngine;
using lot::QueueOptions;
using lot::Status;

struct Job {
  std::uint64_t number = 0;
  lot::ShmVector<std::uint64_t> numbers;
};
struct Other {
  float number = 0;
};
using Jobs = lot::ShmQueue<lot::ShmUniquePtr<Job>>;

QueueOptions plain(QueueEngine engine) {
  QueueOptions options;
  options.engine = engine;
  return options;
}
QueueOptions redelivering(QueueEngine engine, std::uint32_t depth = 64) {
  QueueOptions options;
  options.engine = engine;
  options.depth = depth;
  options.redeliver = true;
  return options;
}

Status put(Jobs& queue, std::uint64_t number) {
  auto made = queue.make();
  made->number = number;
  made->numbers.assign(100, number);
  return queue.put(std::move(made));
}
bool is_whole(const Job& job) {
  return job.numbers.size() == 100 && job.numbers.front() == job.number &&
         job.numbers.back() == job.number;
}

/// Words that all processes of a test have.
template <std::size_t kWords>
class Board {
 public:
  Board()
      : words_(static_cast<std::atomic<unsigned>*>(
            mmap(nullptr, kWords * sizeof(std::atomic<unsigned>), PROT_READ | PROT_WRITE,
                 MAP_SHARED | MAP_ANONYMOUS, -1, 0))) {
    must(words_ != MAP_FAILED, "mmap");
  }
  ~Board() { munmap(words_, kWords * sizeof(std::atomic<unsigned>)); }
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;
  std::atomic<unsigned>& operator[](std::size_t i) const { return words_[i]; }

 private:
  std::atomic<unsigned>* words_;
};

using Fixture = BothEngines;

}  // namespace

TEST_SUITE_BEGIN("tasks");

TEST_CASE_FIXTURE(Fixture, "what was put stays when its putter has ended, until it is taken") {
  with_each_engine([&](QueueEngine engine) {
    for (const bool killed : {false, true}) {
      CAPTURE(killed);
      Steps steps;
      Child putter([&] {
        lot::ShmEngine shm(options);
        auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs", plain(engine));
        for (std::uint64_t n = 0; n < 10; ++n) must(put(mine, n) == Status::Ok, "put");
        steps.tell();
        if (killed) pause();
      });
      REQUIRE(steps.next() != 0);
      if (killed) {
        putter.kill9();
      } else {
        CHECK(putter.wait() == 0);
      }
      std::this_thread::sleep_for(50ms);  // nobody is there who reads, or has put
      lot::ShmEngine shm(options);
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs", plain(engine));
      for (std::uint64_t n = 0; n < 10; ++n) {
        const auto job = mine.wait_and_pop_for(5s);
        REQUIRE(job);
        CHECK((*job)->number == n);
        CHECK(is_whole(**job));
      }
      CHECK(!mine.try_pop());
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "what waits in a queue keeps its topic, and readers come and go") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    {
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs", plain(engine));
      for (std::uint64_t n = 0; n < 4; ++n) CHECK(put(mine, n) == Status::Ok);
    }
    // The topics that come now do not get the place of that one.
    std::vector<lot::ShmPusher<Other>> others;
    for (int i = 0; i < 3; ++i) others.push_back(shm.advertise<Other>("t" + std::to_string(i)));
    CHECK(error_of([&] {
            return shm.queue<lot::ShmUniquePtr<Other>>("jobs", plain(engine));
          }).first == EPROTOTYPE);
    for (std::uint64_t n = 0; n < 4; ++n) {
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs", plain(engine));
      CHECK(mine.size() == 4 - n);
      const auto job = mine.try_pop();
      REQUIRE(job);
      CHECK((*job)->number == n);
    }
    // Nothing waits any more: the name is anybody's.
    CHECK(eventually([&] {
      return error_of([&] {
               return shm.queue<lot::ShmUniquePtr<Other>>("jobs", plain(engine));
             }).first == 0;
    }));
  });
}

TEST_CASE_FIXTURE(Fixture, "with persist, what was put waits while no process is there") {
  lot::EngineOptions kept = fresh();
  kept.persist = true;
  for (const bool killed : {false, true}) {
    CAPTURE(killed);
    Steps steps;
    Child putter([&] {
      lot::ShmEngine shm(kept);
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs");
      for (std::uint64_t n = 0; n < 10; ++n) must(put(mine, n) == Status::Ok, "put");
      steps.tell();
      if (killed) pause();
    });
    REQUIRE(steps.next() != 0);
    if (killed) {
      putter.kill9();
    } else {
      CHECK(putter.wait() == 0);
    }
    Child worker([&] {
      lot::ShmEngine shm(kept);
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs");
      for (std::uint64_t n = 0; n < 10; ++n) {
        const auto job = mine.wait_and_pop_for(5s);
        must(job && (*job)->number == n && is_whole(**job), "the next one");
      }
    });
    CHECK(worker.wait() == 0);
  }
  CHECK(files_of(kept) == 2);
  remove_files_of(kept);
}

TEST_CASE_FIXTURE(Fixture, "with persist, what was put stays, whichever process leaves last") {
  const lot::EngineOptions visited = fresh();  // by a process that asks for nothing
  for (const char* how : {"returns", "is killed", "is ended by a signal"}) {
    CAPTURE(how);
    const std::string ending = how;
    Steps steps;
    Child putter([&] {
      lot::end_cleanly_on_signals();
      lot::EngineOptions kept = visited;
      kept.persist = true;
      lot::ShmEngine shm(kept);
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs");
      for (std::uint64_t n = 0; n < 10; ++n) must(put(mine, n) == Status::Ok, "put");
      steps.tell();
      if (ending != "returns") pause();
    });
    REQUIRE(steps.next() != 0);
    {
      lot::ShmEngine visitor(visited);
      if (ending == "is killed") putter.send(SIGKILL);
      if (ending == "is ended by a signal") putter.send(SIGTERM);
      putter.wait();
      lot::segment::Segment segment(visitor.path());
      CHECK(eventually([&] { return Audit(segment).participants == 1; }));
    }
    CHECK(files_of(visited) == 2);
    Child worker([&] {
      lot::ShmEngine shm(visited);
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs");
      for (std::uint64_t n = 0; n < 10; ++n) {
        const auto job = mine.wait_and_pop_for(5s);
        must(job && (*job)->number == n && is_whole(**job), "the next one");
      }
      must(!mine.try_pop(), "each once");
    });
    CHECK(worker.wait() == 0);
    CHECK(files_of(visited) == 2);
    remove_files_of(visited);
  }
}

TEST_CASE_FIXTURE(Fixture, "what is to stay is not replaced by a segment of another size") {
  lot::EngineOptions larger = options;
  larger.size_bytes *= 2;
  for (const bool persist : {false, true}) {
    CAPTURE(persist);
    Steps steps;
    Child putter([&] {
      lot::EngineOptions kept = options;
      kept.persist = persist;
      lot::ShmEngine shm(kept);
      auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs");
      for (std::uint64_t n = 0; n < 3; ++n) must(put(mine, n) == Status::Ok, "put");
      steps.tell();
      pause();
    });
    REQUIRE(steps.next() != 0);
    putter.kill9();
    const auto [error, text] = error_of([&] { const lot::ShmEngine shm(larger); });
    CHECK(error == (persist ? ENOTEMPTY : 0));
    CHECK((text.find("3 items wait") != std::string::npos) == persist);
    CHECK((text.find("lot clean --with-items") != std::string::npos) == persist);
    CHECK(files_of(options) == (persist ? 2 : 0));
  }
  {
    lot::ShmEngine shm(options);
    auto mine = shm.queue<lot::ShmUniquePtr<Job>>("jobs");
    for (std::uint64_t n = 0; n < 3; ++n) {
      const auto job = mine.wait_and_pop_for(5s);
      REQUIRE(job);
      CHECK((*job)->number == n);
    }
  }
  CHECK(files_of(options) == 2);
  { const lot::ShmEngine shm(larger); }  // nothing waits there: it is replaced
  CHECK(files_of(options) == 0);
}

TEST_CASE_FIXTURE(Fixture, "with redeliver a task is there until finish()") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
    for (std::uint64_t n = 0; n < 3; ++n) CHECK(put(jobs, n) == Status::Ok);
    CHECK(jobs.size() == 3);
    auto first = jobs.try_take();
    REQUIRE(first);
    CHECK(first->number == 0);
    CHECK(first.deliveries() == 1);
    CHECK(jobs.size() == 2);
    auto second = jobs.wait_and_take();
    CHECK(second->number == 1);

    first.give_back();  // to the front
    CHECK(!first);
    CHECK(first.get() == nullptr);
    CHECK(jobs.size() == 2);
    first = jobs.wait_and_take_for(5s);
    REQUIRE(first);
    CHECK(first->number == 0);
    CHECK(first.deliveries() == 2);

    second.finish();
    CHECK(!second);
    second.finish();     // there is none
    second.give_back();  // nor to give back
    auto third = jobs.try_take();
    REQUIRE(third);
    CHECK(third->number == 2);
    CHECK(!jobs.try_take());
    try {
      const auto mine = std::move(third);
      CHECK(is_whole(*mine));
      throw std::runtime_error("the work failed");
    } catch (const std::runtime_error&) {  // unwinding acknowledges nothing
    }
    CHECK(jobs.size() == 1);
    third = jobs.wait_and_take();
    CHECK(third->number == 2);
    CHECK(third.deliveries() == 2);
    third.finish();
    first = {};
    first = jobs.try_take();
    REQUIRE(first);
    CHECK(first.deliveries() == 3);
    first.finish();
    CHECK(jobs.is_empty());
    CHECK(!jobs.wait_and_take_for(1ms));
  });
}

TEST_CASE_FIXTURE(Fixture, "words that lead a worker round and round the numbers are damage") {
  with_each_engine([&](QueueEngine engine) {
    constexpr std::uint32_t kDepth = 8;
    lot::ShmEngine shm(options);
    auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine, kDepth));
    for (std::uint64_t n = 0; n < 2; ++n) REQUIRE(put(jobs, n) == Status::Ok);
    jobs.try_take().finish();
    auto task = jobs.try_take();
    REQUIRE(task);
    lot::segment::Segment segment(shm.path());
    const auto channels = segment.channels();
    const auto c = std::find_if(channels.begin(), channels.end(), [](const auto& channel) {
      return lot::ring::writer_state(channel.writer.load()) == lot::ring::State::Live;
    });
    REQUIRE(c != channels.end());
    const auto ring = segment.ring(static_cast<std::uint32_t>(c - channels.begin()));
    REQUIRE(ring.depth == kDepth);
    std::array<lot::ring::Word, kDepth> slots, claims;
    lot::ring::Word block = lot::ring::kNoBlock;
    for (std::uint32_t i = 0; i < kDepth; ++i) {
      slots[i] = ring.slots[i].load();
      claims[i] = ring.claims[i].load();
      block = std::min(block, lot::ring::block(slots[i]));
    }
    REQUIRE(block != lot::ring::kNoBlock);
    // Each second message is a quarter of all numbers ahead; the one behind it is there, and
    // another worker was faster.
    for (std::uint32_t i = 0; i < kDepth; i += 2) {
      const auto ahead = lot::ring::advance(i, (i / 2 + 1) * (lot::ring::Word{1} << 40));
      const auto there = lot::ring::advance(ahead, lot::ring::Word{1} - kDepth);
      ring.slots[i] = lot::ring::make(ahead, block);
      ring.slots[i + 1] = lot::ring::make(there, block);
      ring.claims[i + 1] = lot::ring::make_claim(lot::ring::next(there), 1, 0);
    }
    for (int n = 0; n < 3; ++n) {
      CHECK(error_of([&] { return jobs.try_take(); }).first == EBADMSG);
      CHECK(error_of([&] { return jobs.wait_and_take(); }).first == EBADMSG);
    }
    for (std::uint32_t i = 0; i < kDepth; ++i) {
      ring.slots[i] = slots[i];
      ring.claims[i] = claims[i];
    }
    task.finish();
  });
}

TEST_CASE_FIXTURE(Fixture, "values are tasks as well, and the count of deliveries has an end") {
  lot::ShmEngine shm(options);
  auto numbers = shm.queue<std::uint64_t>("numbers", redelivering(QueueEngine::Ring, 2));
  for (std::uint64_t n = 0; n < 5; ++n) {
    CHECK(numbers.put(n) == Status::Ok);
    const auto kept = n == 0 ? 4100U : 3U;
    for (unsigned i = 1; i <= kept; ++i) {
      const lot::ShmTask<std::uint64_t> task = numbers.try_take();
      REQUIRE(task);
      if (*task != n || task.deliveries() != std::min(i, 4095U)) {
        CHECK(*task == n);
        CHECK(task.deliveries() == i);
        break;
      }
    }
    auto task = numbers.try_take();
    task.finish();
  }
  CHECK(numbers.is_empty());
}

TEST_CASE_FIXTURE(Fixture, "an unfinished task counts for the depth, and finish() makes room") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine, 2));
    CHECK(put(jobs, 0) == Status::Ok);
    CHECK(put(jobs, 1) == Status::Ok);
    auto task = jobs.try_take();
    REQUIRE(task);
    auto made = jobs.make();
    CHECK(jobs.try_put(std::move(made)) == Status::Full);
    REQUIRE(made);
    std::thread putter([&] { CHECK(put(jobs, 2) == Status::Ok); });  // waits
    std::this_thread::sleep_for(20ms);
    task.finish();
    putter.join();
    for (std::uint64_t n = 1; n < 3; ++n) {
      task = jobs.wait_and_take();
      CHECK(task->number == n);
      task.finish();
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "a sleeping worker gets what another gives back, or had when killed") {
  with_each_engine([&](QueueEngine engine) {
    for (const bool putter_stays : {true, false}) {
      CAPTURE(putter_stays);
      lot::ShmEngine shm(options);
      auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
      jobs.listen();
      Steps taken;
      Steps go;
      std::unique_ptr<lot::ShmEngine> putting = std::make_unique<lot::ShmEngine>(options);
      auto puts = std::make_unique<Jobs>(
          putting->queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine)));
      CHECK(put(*puts, 7) == Status::Ok);
      Child worker([&] {
        lot::ShmEngine mine(options);
        auto queue = mine.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
        auto task = queue.wait_and_take_for(10s);
        must(task && task->number == 7 && task.deliveries() == 1, "the task");
        taken.tell();
        must(go.next() != 0, "give it back");
        task.give_back();
        must(go.next() != 0, "sleep for it");
        task = queue.wait_and_take_for(10s);
        must(task && task.deliveries() == 3, "the task once more");
        taken.tell();
        pause();
      });
      REQUIRE(taken.next() != 0);
      if (!putter_stays) puts.reset();
      const auto get_asleep = [&](unsigned deliveries) {
        auto task = jobs.wait_and_take_for(10s);
        REQUIRE(task);
        CHECK(task->number == 7);
        CHECK(is_whole(*task));
        CHECK(task.deliveries() == deliveries);
        return task;
      };
      std::thread teller([&] {
        std::this_thread::sleep_for(50ms);
        go.tell();
      });
      auto task = get_asleep(2);
      teller.join();
      go.tell();
      std::this_thread::sleep_for(50ms);  // the worker sleeps
      task.give_back();
      REQUIRE(taken.next() != 0);
      std::thread killer([&] {
        std::this_thread::sleep_for(50ms);
        worker.kill9();
      });
      task = get_asleep(4);
      killer.join();
      task.finish();
      CHECK(jobs.is_empty());
    }
  });
}

TEST_CASE_FIXTURE(Fixture, "what a killed worker had is the next one, before what was put later") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
    for (std::uint64_t n = 1; n <= 4; ++n) CHECK(put(jobs, n) == Status::Ok);
    Steps taken;
    Child worker([&] {
      lot::ShmEngine mine(options);
      auto queue = mine.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
      const auto first = queue.wait_and_take_for(10s);
      const auto second = queue.wait_and_take_for(10s);
      must(first && first->number == 1 && second && second->number == 2, "the tasks");
      taken.tell();
      pause();
    });
    REQUIRE(taken.next() != 0);
    auto third = jobs.try_take();
    REQUIRE(third);
    CHECK(third->number == 3);
    worker.kill9();
    lot::segment::Segment segment(shm.path());
    REQUIRE(eventually([&] { return Audit(segment).participants == 1; }));
    for (const std::uint64_t n : {1UL, 2UL, 4UL}) {
      auto task = jobs.try_take();
      REQUIRE(task);
      CHECK(task->number == n);
      CHECK(task.deliveries() == (n == 4 ? 1 : 2));
      task.finish();
    }
    third.finish();
    CHECK(jobs.is_empty());
  });
}

TEST_CASE_FIXTURE(Fixture, "400 tasks are done at least once, with workers killed at random") {
  constexpr std::size_t kTasks = 400;
  constexpr std::size_t kWorkers = 3;
  // The worker that gets one of these first does not finish it: it is killed over it.
  constexpr std::size_t kHardTask = 20;
  constexpr unsigned kHardTasks = kTasks / kHardTask;
  with_each_engine([&](QueueEngine engine) {
    const Board<kTasks> done;        // how often each was finished
    const Board<kWorkers> in_hand;   // the task that a worker surely has not finished, plus 1
    const Board<1> delivered_again;  // tasks that had been delivered before
    std::mt19937_64 random(seed());
    const auto work = [&](std::size_t self, unsigned salt) {
      lot::ShmEngine mine(options);
      auto queue = mine.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine, 32));
      std::mt19937 luck(salt);
      for (;;) {
        auto task = queue.wait_and_take();
        if (task.deliveries() > 1) ++delivered_again[0];
        in_hand[self] = unsigned(task->number) + 1;
        must(is_whole(*task), "it is whole");
        if (task->number % kHardTask == 0 && task.deliveries() == 1) pause();
        const bool can_do_it = luck() % 8 != 0;
        if (luck() % 4 == 0) std::this_thread::sleep_for(std::chrono::microseconds(luck() % 500));
        in_hand[self] = 0;
        if (!can_do_it) continue;
        ++done[task->number];
        task.finish();
      }
    };
    std::array<Child, kWorkers> workers;
    const auto start = [&](std::size_t w) {
      workers[w] = Child([&, w, salt = random()] { work(w, unsigned(salt)); });
    };
    for (std::size_t w = 0; w < kWorkers; ++w) start(w);
    // Putters come and go as well, one after the other: a clean end, then a kill.
    std::array<Child, 4> putters;
    for (std::size_t p = 0; p < putters.size(); ++p) {
      putters[p] = Child([&, p] {
        lot::ShmEngine mine(options);
        auto queue = mine.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine, 32));
        for (std::size_t n = p * kTasks / 4; n < (p + 1) * kTasks / 4; ++n) {
          must(put(queue, n) == Status::Ok, "put");
        }
        if (p % 2 == 1) raise(SIGKILL);
      });
    }
    const auto all_done = [&] {
      for (std::size_t n = 0; n < kTasks; ++n) {
        if (done[n].load() == 0) return false;
      }
      return true;
    };
    const auto until = std::chrono::steady_clock::now() + 60s;
    unsigned kills = 0;
    unsigned kills_in_hand = 0;
    while (!all_done() && std::chrono::steady_clock::now() < until) {
      std::this_thread::sleep_for(std::chrono::microseconds(random() % 8000));
      const std::size_t victim = random() % kWorkers;
      workers[victim].kill9();
      ++kills;
      if (in_hand[victim].exchange(0) != 0) ++kills_in_hand;
      start(victim);
    }
    CHECK(all_done());
    for (std::size_t p = 0; p < putters.size(); ++p) {
      CHECK(putters[p].wait() == (p % 2 == 1 ? 128 + SIGKILL : 0));
    }
    for (auto& worker : workers) worker.kill9();
    lot::ShmEngine shm(options);
    lot::segment::Segment segment(shm.path());
    CHECK(eventually([&] { return Audit(segment).participants == 1; }));  // each death is known
    // What the last kills left unfinished is still there, and nothing else.
    auto rest = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine, 32));
    while (auto task = rest.wait_and_take_for(200ms)) {
      CHECK(is_whole(*task));
      if (task.deliveries() > 1) ++delivered_again[0];
      task.finish();
    }
    CHECK(rest.is_empty());
    MESSAGE(kills << " kills, " << kills_in_hand << " with a task in hand, "
                  << delivered_again[0].load() << " tasks delivered again");
    // A few workers may have been killed before they could say what they had.
    CHECK(kills_in_hand >= kHardTasks / 2);
    CHECK(delivered_again[0].load() >= kills_in_hand);
  });
}

TEST_CASE_FIXTURE(Fixture, "a task outlives its handle, and is its process's") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmTask<Job> task;
    {
      lot::ShmEngine shm(options);
      auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
      for (std::uint64_t n = 0; n < 2; ++n) CHECK(put(jobs, n) == Status::Ok);
      task = jobs.wait_and_take();
    }
    CHECK(is_whole(*task));
    Child child([&] {
      bool threw = false;
      try {
        task.finish();
      } catch (const lot::Error&) {
        threw = true;
      }
      must(threw, "a child cannot finish its parent's task");
      task.give_back();  // nothing
    });
    CHECK(child.wait() == 0);
    lot::ShmEngine shm(options);
    auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine));
    auto next = jobs.try_take();
    REQUIRE(next);
    CHECK(next->number == 1);
    CHECK(!jobs.try_take());
    task.finish();
    task = std::move(next);
    CHECK(task->number == 1);
    task.finish();
    CHECK(!jobs.try_take());
  });
}

TEST_CASE_FIXTURE(Fixture, "a process that leaves gives its tasks back") {
  lot::ShmEngine shm(options);
  auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(QueueEngine::Ring));
  CHECK(put(jobs, 3) == Status::Ok);
  Child worker([&] {
    lot::ShmEngine mine(options);
    auto queue = mine.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(QueueEngine::Ring));
    const auto task = queue.wait_and_take_for(5s);
    must(static_cast<bool>(task), "the task");
  });
  CHECK(worker.wait() == 0);
  auto task = jobs.wait_and_take_for(5s);
  REQUIRE(task);
  CHECK(task->number == 3);
  CHECK(task.deliveries() == 2);
  task.finish();
}

TEST_CASE_FIXTURE(Fixture, "one long task keeps no memory from other tasks") {
  with_each_engine([&](QueueEngine engine) {
    lot::EngineOptions small = fresh(16 << 20);
    small.blocks = 64;
    lot::ShmEngine shm(small);
    auto jobs = shm.queue<lot::ShmUniquePtr<Job>>("jobs", redelivering(engine, 1000));
    const auto put_large = [&](std::uint64_t number) {
      auto job = jobs.make();
      job->number = number;
      job->numbers.assign(1 << 17, number);  // 1 MiB
      return jobs.put(std::move(job));
    };
    CHECK(put_large(0) == Status::Ok);
    auto first = jobs.wait_and_take();
    for (std::uint64_t n = 1; n < 200; ++n) {
      REQUIRE(put_large(n) == Status::Ok);
      auto task = jobs.wait_and_take();
      REQUIRE(task->number == n);
      CHECK(task->numbers.back() == n);
      task.finish();
    }
    CHECK(first->numbers.back() == 0);
    first.finish();
  });
}

TEST_CASE_FIXTURE(Fixture, "names are used again at once, by whatever queue comes") {
  lot::ShmEngine shm(options);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      const std::string name = "n" + std::to_string(t);
      for (int n = 0; n < 200; ++n) {
        { auto one = shm.advertise<Job>(name); }
        { auto two = shm.advertise<Other>(name); }
        auto tasks = shm.queue<std::uint64_t>(name, redelivering(QueueEngine::Ring, 2));
        CHECK(tasks.put(7) == Status::Ok);
        auto task = tasks.try_take();
        REQUIRE(task);
        task.finish();
      }
    });
  }
  for (auto& thread : threads) thread.join();
}

TEST_CASE_FIXTURE(Fixture, "popping and taking do not mix, and the error says which is meant") {
  lot::ShmEngine shm(options);
  auto tasks = shm.queue<lot::ShmUniquePtr<Job>>("tasks", redelivering(QueueEngine::Ring));
  auto items = shm.queue<lot::ShmUniquePtr<Job>>("items");
  CHECK(error_of([&] { return tasks.try_pop(); }).first == EINVAL);
  CHECK(error_of([&] { return items.try_take(); }).first == EINVAL);
  CHECK(error_of([&] { return shm.queue<lot::ShmUniquePtr<Job>>("tasks"); }).first == EPROTOTYPE);
  CHECK(error_of([&] {
          return shm.queue<lot::ShmUniquePtr<Job>>("items", redelivering(QueueEngine::Ring));
        }).first == EPROTOTYPE);
  CHECK(error_of([&] {
          return shm.queue<lot::ShmSharedPtr<const Job>>("all", redelivering(QueueEngine::Ring));
        }).first == EINVAL);
  QueueOptions overwriting = redelivering(QueueEngine::Ring);
  overwriting.policy = Policy::Overwrite;
  CHECK(error_of([&] { return shm.queue<lot::ShmUniquePtr<Job>>("newest", overwriting); }).first ==
        EINVAL);
}

TEST_SUITE_END();
