// SPDX-License-Identifier: Apache-2.0
// What wakes the sleepers that a push has left asleep: sleepers that pass nothing on, as if they
// were stopped, wake all the same.
#include "transport/rouser.hpp"

#include <atomic>
#include <cerrno>
#include <deque>
#include <filesystem>
#include <fstream>
#include <string>
#include <sys/syscall.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "futex/futex.hpp"
#include "support/asleep.hpp"
#include "support/both_engines.hpp"
#include "support/must_go.hpp"
#include "support/sandbox.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
using lot::QueueEngine;
using lot::Status;
using lot::transport::Rouser;
namespace futex = lot::futex;

struct Number {
  std::uint64_t value = 0;
};

using Word = std::atomic<std::uint32_t>;

/// Threads that sleep on words, each until its word is 1, and pass nothing on.
class Deaf {
 public:
  ~Deaf() { join(); }
  void sleep_on(const Word& word) {
    threads_.emplace_back([&word] {
      while (word == 0) futex::wait(&word, 0, std::nullopt);
    });
  }
  void join() {
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
  }

 private:
  std::vector<std::thread> threads_;
};

/// Whether this process has such a thread.
bool has_thread(const std::string& name) {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string of;
    std::ifstream comm(task.path() / "comm");
    if (std::getline(comm, of) && of == name) return true;
  }
  return false;
}

/// From now on the process can start no thread.
void refuse_threads() {
  must(refuse(SYS_clone3, EAGAIN) && refuse(SYS_clone, EAGAIN), "no thread can start");
}

struct Fixture : BothEngines {
  lot::transport::WardenThread warden;  // it has not started: the rouser stays on these cores
};

}  // namespace

TEST_SUITE_BEGIN("rouser");

TEST_CASE_FIXTURE(Fixture, "a Rouser wakes all that sleep on a word, when it is asked again, too") {
  Rouser rouser(warden);
  for (int round = 0; round < 20; ++round) {
    Word word{0};
    Deaf deaf;
    for (int i = 0; i < 12; ++i) deaf.sleep_on(word);
    await_asleep(&word, 0, 12);
    word = 1;
    rouser.rouse(&word);
    deaf.join();
  }
  CHECK(has_thread("lot-rouser"));
}

TEST_CASE_FIXTURE(Fixture, "a Rouser wakes the sleepers of more words than it has places for") {
  Rouser rouser(warden);
  for (int round = 0; round < 3; ++round) {
    std::deque<Word> words(Rouser::kPlaces + 40);
    Deaf deaf;
    for (const Word& word : words) deaf.sleep_on(word);
    for (const Word& word : words) await_asleep(&word, 0, 1);
    for (Word& word : words) word = 1;
    for (const Word& word : words) rouser.rouse(&word);
    deaf.join();
  }
}

TEST_CASE_FIXTURE(Fixture, "threads that ask a Rouser at once each get their sleepers woken") {
  for (int round = 0; round < 30; ++round) {
    Rouser rouser(warden);  // its thread starts anew each time
    std::deque<Word> words(4);
    Deaf deaf;
    for (const Word& word : words) deaf.sleep_on(word);
    for (const Word& word : words) await_asleep(&word, 0, 1);
    std::vector<std::thread> askers;
    for (Word& word : words) {
      askers.emplace_back([&rouser, &word] {
        word = 1;
        rouser.rouse(&word);
      });
    }
    for (std::thread& asker : askers) asker.join();
    deaf.join();
  }
}

TEST_CASE_FIXTURE(Fixture, "a Rouser that is stopped has done what it was asked") {
  Word word{0};
  Deaf deaf;
  for (int i = 0; i < 5; ++i) deaf.sleep_on(word);
  await_asleep(&word, 0, 5);
  word = 1;
  Rouser rouser(warden);
  rouser.rouse(&word);
  rouser.stop();
  CHECK(asleep_on(&word, 1) == 0);
  deaf.join();
  CHECK_FALSE(has_thread("lot-rouser"));
}

TEST_CASE_FIXTURE(Fixture, "where no thread can start, the thread that asks a Rouser wakes all") {
  Child alone([this] {
    std::deque<Word> words(3);
    Deaf deaf;
    for (const Word& word : words) deaf.sleep_on(word);
    for (const Word& word : words) await_asleep(&word, 0, 1);
    refuse_threads();
    Rouser rouser(warden);
    for (Word& word : words) {
      word = 1;
      rouser.rouse(&word);
      must(asleep_on(&word, 1) == 0, "it is woken when rouse() returns");
    }
    must(!has_thread("lot-rouser"), "there is no thread");
    deaf.join();
  });
  CHECK(alone.wait() == 0);
}

/// A publisher, and a reader that sleeps at once.
struct Topic {
  Topic(const lot::EngineOptions& options, QueueEngine engine)
      : shm(options),
        pusher(shm.advertise<Number>("/t", pushing(engine))),
        puller(shm.subscribe<Number>("/t", {lot::Wait::Park, 0})) {}
  static lot::PusherOptions pushing(QueueEngine engine) {
    lot::PusherOptions options;
    options.engine = engine;
    return options;
  }

  lot::ShmEngine shm;
  lot::ShmPusher<Number> pusher;
  lot::ShmPuller<Number> puller;
};

TEST_CASE_FIXTURE(Fixture, "a push wakes readers behind two that are woken and do nothing") {
  with_each_engine([&](QueueEngine engine) {
    Topic topic(options, engine);
    auto& pusher = topic.pusher;
    auto& puller = topic.puller;
    CHECK_FALSE(has_thread("lot-rouser"));
    // A mark stands, which the puller has left. The others sleep on its word, as readers do that
    // have found it.
    CHECK_FALSE(puller.pull(1ms));
    const auto participant = lot::transport::Participant::join(options);
    const auto ring = participant->segment().ring(0);
    const auto* const word = static_cast<const Word*>(
        ring.arrived != nullptr ? ring.arrived : futex::low_half(ring.slots[0]));
    const std::uint32_t value = *word;
    std::vector<std::thread> others;
    for (int i = 0; i < 9; ++i) {
      others.emplace_back([word, value] {
        while (*word == value) futex::wait(word, value, std::nullopt);
      });
    }
    await_asleep(word, value, others.size());
    must_go(pusher.push(pusher.loan(Number{1})));
    for (std::thread& other : others) other.join();
    CHECK(has_thread("lot-rouser"));
    CHECK(puller.try_pull());
  });
  CHECK_FALSE(has_thread("lot-rouser"));  // it has gone with the last handle
}

/// Waits for a message of a topic by a wait set that is large enough to have an ear.
void await_by_ear(lot::ShmEngine& shm) {
  const lot::PullerOptions parks{lot::Wait::Park, 0};
  auto puller = shm.subscribe<Number>("/t", parks);
  std::deque<lot::ShmPuller<Number>> quiet;
  bool has_read = false;
  lot::WaitSet set(lot::Wait::Park);
  set.add(puller, [&] { has_read = has_read || puller.try_pull(); });
  for (int i = 0; i < 10; ++i) {
    quiet.push_back(shm.subscribe<Number>("/quiet" + std::to_string(i), parks));
    set.add(quiet.back(), [] {});
  }
  while (!has_read) set.run_once(1h);
}

TEST_CASE_FIXTURE(Fixture, "a push wakes two wait sets itself, and leaves others to the rouser") {
  with_each_engine([&](QueueEngine engine) {
    constexpr unsigned kSets = 4;
    lot::ShmEngine shm(options);
    auto pusher = shm.advertise<Number>("/t", Topic::pushing(engine));
    std::deque<lot::ShmPusher<Number>> quiet;
    for (int i = 0; i < 10; ++i) {
      quiet.push_back(shm.advertise<Number>("/quiet" + std::to_string(i)));
    }
    std::vector<std::thread> readers;
    for (unsigned i = 0; i < kSets; ++i) readers.emplace_back([&shm] { await_by_ear(shm); });
    const auto participant = lot::transport::Participant::join(options);
    const auto& segment = participant->segment();
    const auto asleep = [&segment] {
      unsigned count = 0;
      segment.listeners()[0].each(
          [&](std::uint32_t ear) { count += segment.ear(ear).words->bell.word() & 1; });
      return count;
    };
    while (asleep() != kSets) std::this_thread::sleep_for(1ms);
    CHECK_FALSE(has_thread("lot-rouser"));
    must_go(pusher.push(pusher.loan(Number{1})));
    for (std::thread& reader : readers) reader.join();
    CHECK(has_thread("lot-rouser"));
  });
}

TEST_CASE_FIXTURE(Fixture, "a push that wakes a reader that is alone starts no rouser") {
  with_each_engine([&](QueueEngine engine) {
    Topic topic(options, engine);
    auto& pusher = topic.pusher;
    auto& puller = topic.puller;
    std::thread reader([&] {
      for (int n = 0; n < 50; ++n) must(bool(puller.pull(1h)), "a message");
    });
    for (int n = 0; n < 50; ++n) {
      must_go(pusher.push(pusher.loan(Number{1})));
      std::this_thread::sleep_for(200us);
    }
    reader.join();
    CHECK_FALSE(has_thread("lot-rouser"));
  });
}

TEST_CASE_FIXTURE(Fixture, "many readers and sleepers of each kind get each message of a push") {
  with_each_engine([&](QueueEngine engine) {
    constexpr std::uint64_t kMessages = 30;
    lot::ShmEngine shm(options);
    lot::PusherOptions with{lot::Policy::Block, 2, 1h, engine};
    auto pusher = shm.advertise<Number>("/t", with);
    std::vector<std::thread> readers;
    std::atomic<unsigned> ready{0};
    constexpr unsigned kReaders = 12;
    for (unsigned i = 0; i < kReaders; ++i) {
      readers.emplace_back([&, i] {
        auto puller = shm.subscribe<Number>("/t", {lot::Wait::Park, 0});
        ++ready;
        std::uint64_t read = 0;
        if (i % 3 == 0) {
          lot::WaitSet set(lot::Wait::Park);
          set.add(puller, [&] {
            while (const auto message = puller.try_pull()) must(message->value == read++, "order");
          });
          while (read != kMessages) set.run_once(1h);
        } else {
          for (; read != kMessages; ++read) {
            const auto message = puller.pull(1h);
            must(message && message->value == read, "the next message");
          }
        }
      });
    }
    while (ready != kReaders) std::this_thread::yield();
    for (std::uint64_t n = 0; n < kMessages; ++n) {
      must_go(pusher.push(pusher.loan(Number{n})));
      if (n % 3 == 0) std::this_thread::sleep_for(2ms);  // they fall asleep
    }
    for (std::thread& reader : readers) reader.join();
  });
}

TEST_CASE_FIXTURE(Fixture, "a forked child has no rouser, and its parent keeps its own") {
  lot::ShmEngine shm(options);
  auto participant = lot::transport::Participant::join(options);
  const auto rouse = [&participant] {
    Word word{0};
    Deaf deaf;
    deaf.sleep_on(word);
    await_asleep(&word, 0, 1);
    word = 1;
    participant->rouser().rouse(&word);
  };
  rouse();
  Child child([&] {
    must(!has_thread("lot-rouser"), "the child has no such thread");
    participant.reset();
  });
  CHECK(child.wait() == 0);
  rouse();
  CHECK(has_thread("lot-rouser"));
}

TEST_SUITE_END();
