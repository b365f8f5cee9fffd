// SPDX-License-Identifier: Apache-2.0

// Processes die here: by kill -9 at chosen and at random moments, by signals, through fork().

#include <algorithm>
#include <array>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/sandbox.hpp"

namespace {

using namespace lot::testing;

struct Number {
  std::uint64_t value;
};
struct Frame {
  std::uint64_t number;
  lot::ShmVector<std::uint64_t> data;
};

/// A loan with its number in it.
lot::ShmUniquePtr<Frame> numbered(lot::ShmPusher<Frame>& pusher, std::uint64_t n) {
  auto frame = pusher.loan();
  frame->number = n;
  return frame;
}

[[maybe_unused]] const std::string& prefix_taken =
    prefix();  // before any engine looks at the environment

lot::EngineOptions node_options(const lot::EngineOptions& options, const char* name) {
  lot::EngineOptions o = options;
  o.name = name;
  return o;
}

lot::QueueOptions redelivering() {
  lot::QueueOptions options;
  options.redeliver = true;
  return options;
}

volatile std::sig_atomic_t stop_requested = 0;
void request_stop(int) { stop_requested = 1; }

/// A process that keeps the segment alive while others come, die and go, until it is told to leave.
struct Keeper {
  explicit Keeper(const lot::EngineOptions& options)
      : child([&, this] {
          lot::ShmEngine engine(options);
          ready.tell();
          done.next(60s);
        }) {
    REQUIRE(ready.next() == '.');
  }
  /// Leaves cleanly; its exit status.
  int leave() {
    done.tell();
    return child.wait();
  }
  Steps ready, done;
  Child child;
};

/// How often the warden of this process has gone to sleep.
long sleeps_of_warden() {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::ifstream comm(task.path() / "comm"), status(task.path() / "status");
    std::string name, word;
    if (!std::getline(comm, name) || name != "lot-warden") continue;
    long sleeps = 0;
    while (status >> word) {
      if (word == "voluntary_ctxt_switches:" && status >> sleeps) return sleeps;
    }
  }
  FAIL("there is no warden");
  return 0;
}

}  // namespace

TEST_SUITE_BEGIN("crash");

TEST_CASE("a publisher under Policy::Block goes on when the reader that holds it back is killed") {
  const Watchdog watchdog(60);
  for (const bool borrowing : {false, true}) {
    CAPTURE(borrowing);
    const auto options = fresh();
    Steps reading;
    Child reader([&] {
      lot::ShmEngine engine(options);
      auto puller = engine.subscribe<Number>("/t");
      reading.tell();
      auto look = puller.borrow(20s);
      must(bool(look) && look->value == 0, "the first message");
      const auto kept = look.keep();
      if (!borrowing) look.end();
      reading.tell();
      pause();
    });
    REQUIRE(reading.next() == '.');
    {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t", {lot::Policy::Block, 4, 30s});
      REQUIRE(pusher.wait_for_readers(1, 10s));
      REQUIRE(pusher.push(pusher.loan(std::uint64_t{0})) == lot::Status::Ok);
      REQUIRE(reading.next() == '.');
      std::uint64_t n = 1;
      for (;; ++n) {
        auto message = pusher.loan(n);
        if (pusher.try_push(std::move(message)) == lot::Status::Full) {
          CHECK(message);  // it stays with the caller
          break;
        }
        REQUIRE(n < 10);
      }
      std::atomic<std::int64_t> killed_at{0};
      std::thread killer([&] {
        std::this_thread::sleep_for(50ms);
        killed_at = std::chrono::steady_clock::now().time_since_epoch().count();
        reader.kill9();
      });
      CHECK(pusher.push(pusher.loan(n)) == lot::Status::Ok);
      const auto now = std::chrono::steady_clock::now().time_since_epoch().count();
      killer.join();
      MESSAGE("went on ", static_cast<double>(now - killed_at) / 1e6, " ms after the kill");
      CHECK(now > killed_at);
      CHECK(eventually([&] { return pusher.readers() == 0; }));
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("what a publisher had on loan when it was killed is freed") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Keeper keeper(options);
  Steps loaned;
  Child publisher([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t");
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    for (int i = 0; i < 5; ++i) {
      loans.push_back(pusher.loan());
      loans.back()->data.resize(100000);
    }
    loaned.tell();
    pause();
  });
  REQUIRE(loaned.next() == '.');
  const std::string path = options.directory + "/" + options.segment;
  {
    lot::segment::Segment s(path);
    CHECK(Audit(s).homes == 5);
    CHECK(Audit(s).participants == 2);
  }
  publisher.kill9();
  CHECK(leak_in(path) == "");
  CHECK(keeper.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("readers of a killed publisher get all that was published, then PublisherGone") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined, published;
  Child publisher([&] {
    must(joined.next() == '.', "readers are there");
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t", {lot::Policy::Overwrite, 16, 1s});
    must(pusher.wait_for_readers(3, 10s), "readers joined");
    std::this_thread::sleep_for(50ms);  // let them sleep
    for (std::uint64_t n = 0; n < 10; ++n) {
      auto frame = numbered(pusher, n);
      frame->data.assign(5000, n);
      must_go(pusher.push(std::move(frame)));
    }
    kill(getpid(), SIGKILL);
  });
  lot::ShmEngine engine(options);
  std::vector<std::thread> threads;
  std::atomic<int> subscribed{0}, good{0};
  for (const auto wait : {lot::Wait::Spin, lot::Wait::Adaptive, lot::Wait::Park}) {
    threads.emplace_back([&, wait] {
      auto puller = engine.subscribe<Frame>("/t", {wait, 0});
      ++subscribed;
      std::vector<lot::ShmSharedPtr<const Frame>> kept;
      while (kept.size() < 10) {
        if (auto frame = puller.pull(20s)) kept.push_back(frame);
      }
      const bool gone = eventually([&] {
        return puller.try_pull() == nullptr && puller.status() == lot::Status::PublisherGone;
      });
      bool same = puller.missed_total() == 0;
      for (std::uint64_t n = 0; n < kept.size(); ++n) {
        same &= kept[n]->number == n && kept[n]->data.size() == 5000 && kept[n]->data[4999] == n;
      }
      good += gone && same;
      if (!gone) std::printf("status %s\n", lot::to_string(puller.status()));
    });
  }
  CHECK(eventually([&] { return subscribed == 3; }));
  joined.tell();
  for (auto& t : threads) t.join();
  CHECK(good == 3);
  CHECK(publisher.wait() == 128 + SIGKILL);
  CHECK(leak_in(engine.path()) == "");
}

TEST_CASE("a reader that only polls gets PublisherGone, and the publisher's ring is freed") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined;
  Child publisher([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t");
    joined.tell();
    must(pusher.wait_for_readers(1, 10s), "reader joined");
    must_go(pusher.push(pusher.loan(std::uint64_t{1})));
    kill(getpid(), SIGKILL);
  });
  REQUIRE(joined.next() == '.');
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Number>("/t");
  lot::ShmSharedPtr<const Number> seen;
  CHECK(eventually([&] { return bool(seen = puller.try_pull()); }));
  seen.reset();
  CHECK(eventually([&] {
    return puller.try_pull() == nullptr && puller.status() == lot::Status::PublisherGone;
  }));
  lot::segment::Segment s(engine.path());
  CHECK(eventually([&] { return Audit(s).channels == 0; }, 5s));
}

TEST_CASE("a message that outlives its process is freed by its last holder, which was not told") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps leave;
  Child publisher([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t");
    must(pusher.wait_for_readers(1, 10s), "reader joined");
    auto frame = numbered(pusher, 7);
    frame->data.assign(1 << 17, 42);
    must_go(pusher.push(std::move(frame)));
    must(leave.next() == '.', "the end");
  });
  lot::ShmEngine engine(options);
  lot::ShmSharedPtr<const Frame> kept = engine.subscribe<Frame>("/t").pull(20s);
  REQUIRE(kept);
  std::this_thread::sleep_for(2200ms);  // our warden has found nothing to collect, and goes idle
  leave.tell();
  CHECK(publisher.wait() == 0);  // it repairs itself: nobody else has reaped
  std::this_thread::sleep_for(1200ms);
  CHECK(kept->data.back() == 42);
  lot::segment::Segment s(engine.path());
  CHECK(Audit(s).granules != 0);
  kept.reset();
  CHECK(eventually([&] { return Audit(s).granules == 0; }));
}

TEST_CASE("a warden sleeps while there is nothing to do, beside others and alone") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Number>("/t");
  std::optional<Keeper> other(options);
  for (int round = 0; round < 2; ++round) {
    std::this_thread::sleep_for(500ms);  // it has seen who has come or gone
    // It looks once a second; ten looks a second were too many. Where the machine is short of
    // memory it also waits for pages: then another two seconds count.
    long sleeps = 100;
    for (int look = 0; look < 5 && sleeps > 8; ++look) {
      const long before = sleeps_of_warden();
      std::this_thread::sleep_for(2s);
      sleeps = sleeps_of_warden() - before;
    }
    CHECK(sleeps >= 1);
    CHECK(sleeps <= 8);
    if (other) CHECK(other->leave() == 0);
    other.reset();
  }
}

TEST_CASE("where the kernel cannot tell of a death, the warden finds it by itself") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined, done;
  Child survivor([&] {
    must(forget_futex_waitv(), "no futex_waitv");
    lot::ShmEngine engine(node_options(options, "survivor"));
    joined.tell();
    done.next(60s);
  });
  REQUIRE(joined.next() == '.');
  Child victim([&] {
    lot::ShmEngine engine(node_options(options, "victim"));
    joined.tell();
    for (;;) pause();
  });
  REQUIRE(joined.next() == '.');
  {
    lot::segment::Segment s(options.directory + "/" + options.segment);
    CHECK(Audit(s).participants == 2);
    victim.kill9();
    CHECK(eventually([&] { return Audit(s).participants == 1; }));
  }
  done.tell();
  CHECK(survivor.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a process leaves when its last handle goes, whatever its warden is at") {
  const Watchdog watchdog(60);
  for (int round = 0; round < 300; ++round) {
    CAPTURE(round);
    const auto options = fresh(16 << 20);
    {
      lot::ShmSharedPtr<const Number> kept;
      lot::ShmEngine engine(options);
      auto pusher = std::make_unique<lot::ShmPusher<Number>>(engine.advertise<Number>("/t"));
      auto puller = engine.subscribe<Number>("/t");
      for (std::uint64_t n = 0; n < 200; ++n) {
        must_go(pusher->push(pusher->loan(n)));
        if (n % 50 == 0) kept = puller.try_pull();
      }
      pusher.reset();  // the warden waits for the message that is kept
      if (round % 3 != 0) kept.reset();
      if (round % 2 != 0) usleep(static_cast<useconds_t>(round % 7) * 300);
    }
    REQUIRE(files_of(options) == 0);
  }
}

TEST_CASE("a killed publisher's last message stays readable for its subscribers") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps joined;
  Child publisher([&] {
    must(joined.next() == '.', "reader");
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t");
    must(pusher.wait_for_readers(1, 10s), "reader joined");
    auto frame = numbered(pusher, 7);
    frame->data.assign(1 << 17, 42);
    must_go(pusher.push(std::move(frame)));
    kill(getpid(), SIGKILL);
  });
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Frame>("/t");
  joined.tell();
  auto look = puller.borrow(20s);
  REQUIRE(look);
  CHECK(publisher.wait() == 128 + SIGKILL);
  lot::segment::Segment s(engine.path());
  CHECK(eventually([&] { return Audit(s).participants == 1; }));
  std::this_thread::sleep_for(1200ms);  // the warden looks
  CHECK(look->data.size() == 1 << 17);
  CHECK(std::all_of(look->data.begin(), look->data.end(), [](auto v) { return v == 42; }));
  auto kept = look.keep();
  look.end();
  CHECK(puller.try_pull() == nullptr);
  std::this_thread::sleep_for(1200ms);
  CHECK(std::all_of(kept->data.begin(), kept->data.end(), [](auto v) { return v == 42; }));
  kept.reset();
  CHECK(eventually([&] { return Audit(s).granules == 0 || Audit(s).homes == 0; }, 5s));
}

namespace {

/// A node of the ten: publishes on its own topic, reads its neighbour's, until it is stopped.
void run_node(const lot::EngineOptions& options, unsigned id, unsigned of, const Steps& ready) {
  signal(SIGTERM, request_stop);
  signal(SIGINT, request_stop);
  lot::ShmEngine engine(node_options(options, "node"));
  auto pusher = engine.advertise<Frame>("/" + std::to_string(id), {lot::Policy::Overwrite, 8, 1s});
  auto puller = engine.subscribe<Frame>("/" + std::to_string((id + 1) % of));
  ready.tell();
  std::uint64_t expected = 0;
  std::uint64_t last = 0;
  for (std::uint64_t n = 1; stop_requested == 0; ++n) {
    auto frame = numbered(pusher, n);
    frame->data.assign(100 + n % 1000, n);
    must_go(pusher.push(std::move(frame)));
    while (auto look = puller.try_borrow()) {
      if (look->number < last) expected = 0;  // another publisher
      if (expected != 0) must(look->number == expected + look.missed(), "missed is exact");
      last = look->number;
      expected = look->number + 1;
      must(look->data.size() == 100 + look->number % 1000, "the size");
      must(look->data.front() == look->number && look->data.back() == look->number, "the content");
    }
    std::this_thread::sleep_for(1ms);
  }
}

}  // namespace

TEST_CASE("ten nodes are ended by signals in any order, and one starts meanwhile: no file stays") {
  const Watchdog watchdog(100);
  std::mt19937_64 random(seed());
  for (int round = 0; round < 6; ++round) {
    CAPTURE(round);
    const auto options = fresh();
    Steps ready;
    std::vector<Child> nodes;
    for (unsigned id = 0; id < 10; ++id) {
      nodes.emplace_back([&, id] { run_node(options, id, 10, ready); });
    }
    for (unsigned id = 0; id < 10; ++id) REQUIRE(ready.next() == '.');
    std::vector<unsigned> order{0, 1, 2, 3, 4, 5, 6, 7, 8, 9};
    std::shuffle(order.begin(), order.end(), random);
    std::vector<int> signals(10);
    for (auto& s : signals) s = std::array{SIGINT, SIGTERM, SIGKILL}[random() % 3];
    const int spacing = round % 2 == 0 ? 0 : 3000;  // together, or one after the other
    Child late;
    for (unsigned i = 0; i < 10; ++i) {
      if (i == 5) late = Child([&] { run_node(options, 10, 10, ready); });
      nodes[order[i]].send(signals[order[i]]);
      if (spacing != 0) usleep(static_cast<useconds_t>(random() % 3000));
    }
    REQUIRE(ready.next() == '.');
    for (unsigned id = 0; id < 10; ++id) {
      CHECK(nodes[id].wait() == (signals[id] == SIGKILL ? 128 + SIGKILL : 0));
    }
    usleep(20000);
    late.send(SIGTERM);
    CHECK(late.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("processes that leave at the same moment leave no file") {
  const Watchdog watchdog(60);
  for (int round = 0; round < 25; ++round) {
    const auto options = fresh(32 << 20);
    Steps ready, go;
    std::vector<Child> nodes;
    for (unsigned id = 0; id < 4; ++id) {
      nodes.emplace_back([&] {
        {
          lot::ShmEngine engine(options);
          ready.tell();
          go.next();
        }
      });
    }
    for (unsigned id = 0; id < 4; ++id) REQUIRE(ready.next() == '.');
    for (unsigned id = 0; id < 4; ++id) go.tell();
    for (auto& node : nodes) CHECK(node.wait() == 0);
    REQUIRE(files_of(options) == 0);
  }
}

TEST_CASE("after all processes were killed, the next one starts and its exit cleans up") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready;
  std::vector<Child> nodes;
  for (unsigned id = 0; id < 10; ++id) {
    nodes.emplace_back([&, id] { run_node(options, id, 10, ready); });
  }
  for (unsigned id = 0; id < 10; ++id) REQUIRE(ready.next() == '.');
  for (auto& node : nodes) node.send(SIGKILL);
  for (auto& node : nodes) CHECK(node.wait() == 128 + SIGKILL);
  CHECK(files_of(options) == 2);
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/0");
    auto puller = engine.subscribe<Frame>("/0");
    CHECK(pusher.push(numbered(pusher, 1)) == lot::Status::Ok);
    CHECK(puller.pull(10s));
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("what killed processes have left is not in the way of the next one's first calls") {
  const Watchdog watchdog(100);
  for (int round = 0; round < 10; ++round) {
    CAPTURE(round);
    const auto options = fresh();
    Steps done;
    Child dead([&] {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/t");
      auto puller = engine.subscribe<Number>("/t");
      auto tasks = engine.queue<Number>("tasks", redelivering());
      for (unsigned n = 0; n < 3; ++n) must_go(tasks.put(Number{n}));
      const auto task = tasks.wait_and_take();
      done.tell();
      pause();
    });
    REQUIRE(done.next() != 0);
    dead.kill9();
    Child next([&] {
      lot::ShmEngine engine(options);
      auto other = engine.advertise<Frame>("/t");  // of another type
      auto tasks = engine.queue<Number>("tasks", redelivering());
      const auto task = tasks.wait_and_take();
      must(task->value == 0 && task.deliveries() == 2, "the dead worker's task comes first");
    });
    CHECK(next.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a reader that starts behind the death of the last publisher waits for the next one") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  Child dead([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t");
    must_go(pusher.push(pusher.loan(1u)));
    raise(SIGKILL);
  });
  CHECK(dead.wait() == 128 + SIGKILL);
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Number>("/t");
  std::thread next([&] {
    std::this_thread::sleep_for(50ms);
    auto pusher = engine.advertise<Number>("/t");
    must_go(pusher.push(pusher.loan(2u)));
  });
  const auto message = puller.pull(20s);
  next.join();
  REQUIRE(message);
  CHECK(message->value == 2);
}

TEST_CASE("a storm of kills at random moments leaves nothing behind") {
  const Watchdog watchdog(110);
  std::mt19937_64 random(seed());
  const auto options = fresh();
  Keeper keeper(options);
  const auto start = [&](unsigned role) {
    const std::uint64_t its_seed = random();
    return Child([&options, role, its_seed] {
      std::mt19937_64 r(its_seed);
      lot::ShmEngine engine(node_options(options, "storm"));
      std::vector<lot::ShmSharedPtr<const Frame>> kept(4);
      const auto check = [](const Frame& frame) {
        must(frame.data.size() == frame.number % 3000, "the size");
        for (const auto v : frame.data) must(v == frame.number, "the content");
      };
      if (role % 3 == 0) {
        auto pusher = engine.advertise<Frame>(
            "/a", {role % 2 == 0 ? lot::Policy::Overwrite : lot::Policy::Block, 8, 50ms});
        for (;;) {
          const std::uint64_t n = r() % 100000;
          auto frame = numbered(pusher, n);
          for (std::uint64_t i = 0; i < n % 3000; ++i) frame->data.push_back(n);
          (void)pusher.push(std::move(frame));  // Full as well: a reader is slow
          if (n % 4 == 0) usleep(static_cast<useconds_t>(n % 3000));  // leave others some time
        }
      } else if (role % 3 == 1) {  // forwards
        auto puller = engine.subscribe<Frame>("/a", {lot::Wait::Park, 0});
        auto pusher = engine.advertise<Frame>("/b", {lot::Policy::Overwrite, 8, 50ms});
        for (;;) {
          if (auto frame = puller.pull(50ms)) {
            check(*frame);
            must_go(pusher.push(frame));
            kept[r() % 4] = frame;
          }
        }
      } else {
        auto a = engine.subscribe<Frame>("/a", {lot::Wait::Park, 0});
        auto b = engine.subscribe<Frame>("/b", {lot::Wait::Park, 0});
        for (;;) {
          if (auto look = a.borrow(5ms)) {
            check(*look);
            if (r() % 3 == 0) kept[r() % 4] = look.keep();
          }
          if (auto frame = b.pull(5ms)) {
            check(*frame);
            kept[r() % 4] = frame;
          }
        }
      }
    });
  };
  std::vector<Child> nodes;
  for (unsigned role = 0; role < 9; ++role) nodes.push_back(start(role));
  unsigned failures = 0;
  for (int kills = 0; kills < 300; ++kills) {
    usleep(static_cast<useconds_t>(random() % 30000));
    const auto victim = static_cast<unsigned>(random() % nodes.size());
    int status = 0;
    for (unsigned i = 0; i < nodes.size(); ++i) {
      if (nodes[i].ended(status)) {
        ++failures;
        MESSAGE("node of role ", i, " ended by itself: ", status, " after ", kills, " kills");
        nodes[i] = start(i);
      }
    }
    nodes[victim].kill9();
    nodes[victim] = start(victim);
  }
  for (auto& node : nodes) node.kill9();
  CHECK(failures == 0);
  CHECK(leak_in(options.directory + "/" + options.segment) == "");
  CHECK(keeper.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("what a forked child inherits is inert and says so, and the parent goes on") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  {
    auto engine = std::make_unique<lot::ShmEngine>(options);
    auto pusher = std::make_unique<lot::ShmPusher<Frame>>(
        engine->advertise<Frame>("/t", {lot::Policy::Overwrite, 4, 1s}));
    auto puller = std::make_unique<lot::ShmPuller<Frame>>(engine->subscribe<Frame>("/t"));
    auto lent = std::make_unique<lot::ShmPuller<Frame>>(engine->subscribe<Frame>("/t"));
    for (std::uint64_t n = 0; n < 3; ++n) {
      auto frame = numbered(*pusher, n);
      frame->data.assign(1000, n);
      must_go(pusher->push(std::move(frame)));
    }
    auto kept = puller->pull(1s);
    lot::ShmWeakPtr<const Frame> weak = kept;
    auto loaned = numbered(*pusher, 9);
    auto borrowed = lent->borrow(1s);
    REQUIRE(borrowed);
    lot::segment::Segment s(engine->path());
    const std::string before = Audit(s).text();

    Child child([&] {
      const auto says_so = [](auto&& use) {
        try {
          use();
        } catch (const lot::Error& e) {
          return std::string(e.what()).find("fork") != std::string::npos;
        }
        return false;
      };
      must(says_so([&] { return engine->advertise<Frame>("/u"); }), "advertise");
      must(says_so([&] { return engine->subscribe<Frame>("/u"); }), "subscribe");
      must(says_so([&] { return engine->make<Frame>(); }), "make");
      must(says_so([&] { return pusher->loan(); }), "loan");
      must(says_so([&] { return pusher->try_loan(); }), "try_loan");
      must(says_so([&] { return pusher->push(std::move(loaned)); }), "push unique");
      must(says_so([&] { return pusher->push(kept); }), "push shared");
      must(says_so([&] { pusher->reserve(1, 1); }), "reserve");
      must(says_so([&] { pusher->readers(); }), "readers");
      must(says_so([&] { return puller->try_pull(); }), "try_pull");
      must(says_so([&] { return puller->pull(1s); }), "pull");
      must(says_so([&] { return puller->try_borrow(); }), "try_borrow");
      must(says_so([&] { puller->publishers(); }), "publishers");
      must(says_so([&] { return borrowed.keep(); }), "keep");
      must(weak.lock() == nullptr, "weak");
      auto copy = kept;
      copy.reset();
      borrowed.end();
      weak.reset();
      kept.reset();
      loaned.reset();
      puller.reset();
      lent.reset();
      pusher.reset();
      engine.reset();
      // An engine of its own works.
      lot::ShmEngine own(options);
      auto own_puller = own.subscribe<Frame>("/t", {lot::Wait::Adaptive, 1});
      auto seen = own_puller.pull(5s);
      must(bool(seen) && seen->number == 2, "a message by its own engine");
    });
    CHECK(child.wait() == 0);
    CHECK(eventually([&] { return Audit(s).participants == 1; }));
    CHECK(Audit(s).text() == before);
    // The parent's borrow still protects.
    for (std::uint64_t n = 10; n < 60; ++n) {
      auto frame = numbered(*pusher, n);
      frame->data.assign(1000, n);
      must_go(pusher->push(std::move(frame)));
    }
    CHECK(borrowed->number == 0);
    CHECK(std::all_of(borrowed->data.begin(), borrowed->data.end(), [](auto v) { return v == 0; }));
    borrowed.end();
    CHECK(kept->number == 0);
    CHECK(kept->data[999] == 0);
    CHECK(pusher->push(std::move(loaned)) == lot::Status::Ok);
    CHECK(lent->pull(1s));
    CHECK(files_of(options) == 2);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a forked child that outlives its parent does not keep it alive in others' eyes") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Keeper keeper(options);
  Steps forked, done;
  Child parent([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t");
    if (fork() == 0) {
      alarm(30);
      done.next();
      _exit(0);
    }
    forked.tell();
    pause();
  });
  REQUIRE(forked.next() == '.');
  parent.kill9();
  const std::string path = options.directory + "/" + options.segment;
  CHECK(leak_in(path) == "");
  lot::segment::Segment s(path);
  CHECK(eventually([&] { return Audit(s).participants == 1; }));
  done.tell();
  CHECK(keeper.leave() == 0);
  CHECK(files_of(options) == 0);
}

namespace {

/// crash_node in a PID namespace of its own; its output is read by lines.
struct Confined {
  Confined(const lot::EngineOptions& options, const char* role, const char* topic)
      : process([&, this] {
          dup2(out[1], 1);
          const std::string size = std::to_string(options.size_bytes);
          execlp("unshare", "unshare", "--pid", "--fork", "--kill-child", "--mount-proc",
                 LOT_CRASH_NODE, options.segment.c_str(), size.c_str(), role, topic, nullptr);
          _exit(127);
        }) {
    close(out[1]);
    stream = fdopen(out[0], "r");
  }
  ~Confined() {
    process.kill9();
    std::fclose(stream);
  }
  std::string line() {
    std::array<char, 100> text{};
    return std::fgets(text.data(), static_cast<int>(text.size()), stream) != nullptr ? text.data()
                                                                                     : "";
  }
  std::array<int, 2> out = [] {
    std::array<int, 2> fd{};
    if (pipe(fd.data()) != 0) std::abort();
    return fd;
  }();
  Child process;
  std::FILE* stream = nullptr;
};

}  // namespace

TEST_CASE("processes with the same pid in different PID namespaces meet, and reap each other") {
  const Watchdog watchdog(60);
  if (std::system("unshare --pid --fork --mount-proc true 2>/dev/null") != 0) {
    MESSAGE("skipped: no PID namespaces here");
    return;
  }
  const auto options = fresh();
  Keeper keeper(options);
  Confined publisher(options, "publish", "/n");
  const std::string pid = publisher.line();
  CHECK(pid == "pid 1\n");
  {
    Confined echo(options, "echo", "/n");
    CHECK(echo.line() == pid);
    int last = 0;
    for (int i = 0; i < 50; ++i) {
      int n = 0;
      REQUIRE(std::sscanf(echo.line().c_str(), "got %d", &n) == 1);
      CHECK(n > last);
      last = n;
    }
    Confined hold(options, "hold", "/n");
    CHECK(hold.line() == pid);
    CHECK(hold.line().substr(0, 3) == "got");
    lot::segment::Segment s(options.directory + "/" + options.segment);
    CHECK(Audit(s).participants == 4);
  }  // both are killed
  const std::string path = options.directory + "/" + options.segment;
  lot::segment::Segment s(path);
  CHECK(eventually([&] { return Audit(s).participants == 2 && Audit(s).readers == 0; }));
  publisher.process.kill9();
  CHECK(leak_in(path) == "");
  CHECK(keeper.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_SUITE_END();
