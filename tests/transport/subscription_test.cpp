// SPDX-License-Identifier: Apache-2.0

// What is published after a subscription reaches the subscriber or counts as missed, however late
// the subscriber looks, and whatever has become of the publisher.

#include <algorithm>
#include <csignal>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/error_of.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;

struct Number {
  std::uint64_t value;
};
using Owned = lot::ShmUniquePtr<Number>;
using Shared = lot::ShmSharedPtr<const Number>;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::uint64_t kItems = 5;

/// Which rings there are, and in which state.
struct Rings {
  std::size_t live = 0;
  std::size_t ended = 0;
  explicit Rings(const std::string& path) {
    lot::segment::Segment segment(path);
    for (auto& channel : segment.channels()) {
      const auto state = lot::ring::writer_state(channel.writer.load());
      live += state == lot::ring::State::Live;
      ended += state == lot::ring::State::Orphan;
    }
  }
};

/// Puts numbers on one queue of each kind and on a lossless topic. Returns how many said Ok.
struct Sender {
  explicit Sender(lot::ShmEngine& engine)
      : one(engine.queue<Owned>("one")),
        all(engine.queue<Shared>("all")),
        topic(engine.advertise<Number>("topic", {Policy::Block, 64, 1s})) {}
  std::uint64_t send() {
    std::uint64_t ok = 0;
    for (std::uint64_t n = 0; n < kItems; ++n) {
      ok += one.put(one.make(n)) == Status::Ok;
      ok += all.put(Shared(all.make(n))) == Status::Ok;
      ok += topic.push(topic.loan(n)) == Status::Ok;
    }
    return ok;
  }
  lot::ShmQueue<Owned> one;
  lot::ShmQueue<Shared> all;
  lot::ShmPusher<Number> topic;
};

struct Receiver {
  explicit Receiver(lot::ShmEngine& engine)
      : one(engine.queue<Owned>("one")),
        all(engine.queue<Shared>("all")),
        topic(engine.subscribe<Number>("topic")) {
    one.listen();
    all.listen();
  }
  void check() {
    for (std::uint64_t n = 0; n < kItems; ++n) {
      const auto item = one.wait_and_pop_for(20s);
      REQUIRE(item);
      CHECK((*item)->value == n);
      const auto view = all.wait_and_pop_for(20s);
      REQUIRE(view);
      CHECK((*view)->value == n);
      const auto message = topic.pull(20s);
      REQUIRE(message);
      CHECK(message->value == n);
    }
    CHECK_FALSE(one.try_pop());
    CHECK_FALSE(all.try_pop());
    CHECK_FALSE(topic.try_pull());
    CHECK(topic.missed_total() == 0);
  }
  lot::ShmQueue<Owned> one;
  lot::ShmQueue<Shared> all;
  lot::ShmPuller<Number> topic;
};

/// Holds the registry's lock, as a process does that is stopped there.
class TakenRegistry {
 public:
  explicit TakenRegistry(const lot::ShmEngine& engine) : segment_(engine.path()) {
    REQUIRE(held_.next() != 0);
  }
  ~TakenRegistry() {
    go_.tell();
    other_.join();
  }

 private:
  lot::segment::Segment segment_;
  Steps held_;
  Steps go_;
  std::thread other_{[this] {
    RegistryLock registry(segment_);
    if (registry.lock()) held_.tell();
    go_.next(60s);
    registry.unlock();
  }};
};

}  // namespace

TEST_SUITE_BEGIN("subscription");

TEST_CASE("messages of a killed publisher reach its subscribers, however late they look") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  Receiver receiver(engine);
  Steps done;
  Child sender([&] {
    lot::ShmEngine other(options);
    Sender mine(other);
    must(mine.send() == 3 * kItems, "all is put");
    done.tell();
    pause();
  });
  REQUIRE(done.next() != 0);
  sender.kill9();
  // Until it is reaped, and its queues would be recycled if nobody read them.
  REQUIRE(eventually([&] { return Rings(engine.path()).ended == 3; }, 20s));
  std::this_thread::sleep_for(200ms);
  CHECK(Rings(engine.path()).ended == 3);
  receiver.check();
  CHECK(eventually([&] {
    return !receiver.topic.try_pull() && !receiver.one.try_pop() && !receiver.all.try_pop() &&
           Rings(engine.path()).ended == 0;
  }));
}

TEST_CASE("messages of a publisher that has left reach its subscribers") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  Receiver receiver(engine);
  SUBCASE("its handles are gone") {
    Sender sender(engine);
    CHECK(sender.send() == 3 * kItems);
  }
  SUBCASE("its process is gone") {
    Child child([&] {
      lot::ShmEngine other(options);
      Sender sender(other);
      must(sender.send() == 3 * kItems, "all is put");
    });
    CHECK(child.wait() == 0);
  }
  std::this_thread::sleep_for(300ms);
  receiver.check();
}

TEST_CASE("what a dead publisher has lost under Policy::Overwrite counts as missed") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Number>("/t");
  constexpr std::uint64_t kSent = 11;
  constexpr std::uint32_t kDepth = 4;
  Child publisher([&] {
    lot::ShmEngine other(options);
    auto pusher = other.advertise<Number>("/t", {Policy::Overwrite, kDepth, 1s});
    for (std::uint64_t n = 0; n < kSent; ++n) must(pusher.push(pusher.loan(n)) == Status::Ok, "");
    raise(SIGKILL);
  });
  CHECK(publisher.wait() == 128 + SIGKILL);
  REQUIRE(eventually([&] { return Rings(engine.path()).ended == 1; }, 20s));
  for (std::uint64_t n = kSent - kDepth; n < kSent; ++n) {
    const auto message = puller.pull(20s);
    REQUIRE(message);
    CHECK(message->value == n);
  }
  CHECK(puller.missed_total() == kSent - kDepth);
}

TEST_CASE("each of several pullers of a process gets what came after its own subscription") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  const auto drain = [](lot::ShmPuller<Number>& puller) {
    std::vector<std::uint64_t> got;
    while (const auto message = puller.try_pull()) got.push_back(message->value);
    std::sort(got.begin(), got.end());  // of two publishers, either may come first
    return got;
  };
  using Values = std::vector<std::uint64_t>;
  auto early = engine.subscribe<Number>("/t");
  auto twin = engine.subscribe<Number>("/t");
  std::optional first(engine.advertise<Number>("/t"));
  must_go(first->push(first->loan(1u)));
  auto later = engine.subscribe<Number>("/t");
  must_go(first->push(first->loan(2u)));
  first.reset();
  auto last = engine.subscribe<Number>("/t");
  CHECK(drain(later) == Values{2});
  std::optional second(engine.advertise<Number>("/t"));
  must_go(second->push(second->loan(3u)));
  second.reset();
  // The cells of the others are not taken by who has read the ring, or came after it.
  CHECK(drain(later) == Values{3});
  CHECK(drain(last) == Values{3});
  CHECK(drain(early) == Values{1, 2, 3});
  CHECK(drain(twin) == Values{1, 2, 3});
  for (auto* puller : {&early, &twin, &later, &last}) CHECK(drain(*puller).empty());
  CHECK(eventually([&] { return Rings(engine.path()).ended == 0; }));
}

TEST_CASE("a subscriber that goes without having looked leaves no ring behind") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto stays = engine.subscribe<Number>("/t");
  std::optional goes(engine.subscribe<Number>("/t"));
  std::optional pusher(engine.advertise<Number>("/t", {Policy::Block, 2, 20s}));
  CHECK(pusher->readers() == 2);
  for (std::uint64_t n = 0; n < 2; ++n) CHECK(pusher->push(pusher->loan(n)) == Status::Ok);
  for (std::uint64_t n = 0; n < 2; ++n) CHECK(stays.pull(20s)->value == n);
  std::thread late([&] {
    std::this_thread::sleep_for(20ms);
    goes.reset();
  });
  CHECK(pusher->push(pusher->loan(2u)) == Status::Ok);  // which it held back
  late.join();
  CHECK(pusher->readers() == 1);
  pusher.reset();
  CHECK(stays.pull(20s)->value == 2);
  CHECK_FALSE(stays.try_pull());
  CHECK(eventually([&] { return Rings(engine.path()).ended == 0; }));
  lot::segment::Segment segment(engine.path());
  CHECK(Audit(segment).readers == 0);
}

TEST_CASE("a subscriber that dies without having looked leaves no ring behind") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  Steps done;
  Child subscriber([&] {
    lot::ShmEngine other(options);
    auto puller = other.subscribe<Number>("/t");
    done.tell();
    pause();
  });
  REQUIRE(done.next() != 0);
  std::optional pusher(engine.advertise<Number>("/t"));
  CHECK(pusher->readers() == 1);
  must_go(pusher->push(pusher->loan(1u)));
  pusher.reset();
  CHECK(Rings(engine.path()).ended == 1);
  subscriber.kill9();
  CHECK(eventually([&] { return Rings(engine.path()).ended == 0; }, 20s));
}

TEST_CASE("a puller that goes while the registry is taken leaves its unread rings later") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  std::optional<lot::ShmPuller<Number>> stays;
  SUBCASE("it is the only one of its process") {}
  SUBCASE("another one stays, and only its own cell is left to it") {
    stays.emplace(engine.subscribe<Number>("/t"));
  }
  auto puller = std::make_unique<lot::ShmPuller<Number>>(engine.subscribe<Number>("/t"));
  auto pusher = engine.advertise<Number>("/t", {Policy::Block, 2, 20s});
  const std::size_t others = stays ? 1 : 0;
  std::optional<TakenRegistry> taken(std::in_place, engine);
  puller.reset();
  CHECK(pusher.readers() == others + 1);
  taken.reset();
  CHECK(eventually([&] { return pusher.readers() == others; }, 20s));
  for (std::uint64_t n = 0; n < 5; ++n) {
    CHECK(pusher.push(pusher.loan(n)) == Status::Ok);
    if (stays) CHECK(stays->pull(20s)->value == n);
  }
  // The topic counts the puller no more: a new ring awaits the others alone.
  CHECK(engine.advertise<Number>("/t").readers() == others);
}

TEST_CASE("a subscribe that fails takes nothing from the other pullers of its process") {
  const Watchdog watchdog(100);
  auto options = fresh();
  options.readers = 2;
  lot::ShmEngine engine(options);
  auto one = engine.subscribe<Number>("/t");
  auto two = engine.subscribe<Number>("/t");
  auto pusher = engine.advertise<Number>("/t", {Policy::Block, 8, 20s});
  for (std::uint64_t n = 0; n < kItems; ++n) CHECK(pusher.push(pusher.loan(n)) == Status::Ok);
  CHECK_THROWS_AS((void)engine.subscribe<Number>("/t"), lot::Error);
  CHECK(pusher.readers() == 2);
  for (auto* puller : {&one, &two}) {
    for (std::uint64_t n = 0; n < kItems; ++n) {
      const auto message = puller->try_pull();
      REQUIRE(message);
      CHECK(message->value == n);
    }
  }
}

TEST_CASE("an observer counts as a reader, and an error says how many there are") {
  const Watchdog watchdog(100);
  auto options = fresh();
  options.readers = 3;
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Number>("/t");
  lot::PullerOptions looks;
  looks.observer = true;
  std::vector<lot::ShmPuller<Number>> observers;
  for (int i = 0; i < 2; ++i) {
    observers.push_back(engine.subscribe<Number>("/t", looks));
    (void)observers.back().try_pull();
  }
  const auto reader = engine.subscribe<Number>("/t");
  const auto [error, text] = error_of([&] { (void)engine.subscribe<Number>("/t"); });
  CHECK(error == EUSERS);
  CAPTURE(text);
  CHECK(text.find("all the 3 readers that it can have, of which 2 only observe") != text.npos);
}

TEST_CASE("missed() counts what memory pressure took before the publisher died") {
  const Watchdog watchdog(100);
  auto options = fresh();
  options.size_bytes = 32 << 20;
  lot::ShmEngine engine(options);
  struct Frame {
    lot::ShmVector<unsigned char> data;
  };
  auto puller = engine.subscribe<Frame>("/t");
  std::uint64_t sent = 3;
  Child publisher([&] {
    lot::ShmEngine other(options);
    auto pusher = other.advertise<Frame>("/t");
    const auto make = [&] {
      auto frame = pusher.loan();
      frame->data.resize(4 << 20);
      return frame;
    };
    for (std::uint64_t n = 0; n < sent; ++n) must(pusher.push(make()) == Status::Ok, "pushed");
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    try {
      for (;;) loans.push_back(make());
    } catch (const std::bad_alloc&) {  // all that was pushed has gone
      raise(SIGKILL);
    }
  });
  CHECK(publisher.wait() == 128 + SIGKILL);
  REQUIRE(eventually([&] { return Rings(engine.path()).ended == 1; }, 20s));
  CHECK_FALSE(puller.try_pull());
  CHECK(puller.missed_total() == sent);
  auto next = engine.advertise<Frame>("/t");
  CHECK(next.push(next.loan()) == Status::Ok);
  CHECK(puller.pull(20s));
  CHECK(puller.missed() == sent);  // before this one
  CHECK(puller.missed_total() == sent);
}

TEST_CASE("the places of the dead are not counted as taken") {
  const Watchdog watchdog(100);
  auto options = fresh();
  options.readers = 2;
  lot::ShmEngine engine(options);
  std::optional<lot::ShmPusher<Number>> pusher;
  bool anew = true;
  SUBCASE("when a publisher comes") {}
  SUBCASE("when a subscriber comes") {
    pusher.emplace(engine.advertise<Number>("/t"));
    anew = false;
  }
  for (int round = 0; round < 10; ++round) {
    Steps done;
    std::vector<std::unique_ptr<Child>> dead;
    for (int i = 0; i < 2; ++i) {
      dead.push_back(std::make_unique<Child>([&] {
        lot::ShmEngine other(options);
        auto puller = other.subscribe<Number>("/t");
        done.tell();
        pause();
      }));
      REQUIRE(done.next() != 0);
    }
    for (auto& child : dead) child->kill9();
    auto puller = engine.subscribe<Number>("/t");
    if (anew) pusher.emplace(engine.advertise<Number>("/t"));
    CHECK(pusher->push(pusher->loan(7u)) == Status::Ok);
    CHECK(puller.pull(20s)->value == 7);
  }
}

TEST_CASE("a ring that has ended and has nothing to tell awaits no subscriber") {
  const Watchdog watchdog(100);
  auto options = fresh();
  options.channels = 4;
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Number>("/t");  // it never looks
  auto idle = engine.queue<Owned>("tasks");      // nor does this one
  idle.listen();
  auto tasks = engine.queue<Owned>("tasks");
  tasks.listen();
  const auto gone = [&] { return Rings(engine.path()).ended == 0; };
  for (int n = 0; n < 20; ++n) {
    (void)engine.advertise<Number>("/t");  // and closes it
    CHECK(eventually(gone, 20s));
  }
  std::optional other(engine.queue<Owned>("tasks"));
  CHECK(other->put(other->make(1u)) == Status::Ok);
  CHECK(tasks.wait_and_pop_for(20s));
  other.reset();  // all that was in it was taken
  CHECK(eventually([&] { return !tasks.try_pop() && gone(); }, 20s));
  std::optional last(engine.advertise<Number>("/t"));
  CHECK(last->push(last->loan(1u)) == Status::Ok);
  last.reset();
  std::this_thread::sleep_for(300ms);
  CHECK(Rings(engine.path()).ended == 1);  // this one has something
  CHECK(puller.pull(20s)->value == 1);
  CHECK(puller.missed_total() == 0);
  CHECK(eventually([&] { return !puller.try_pull() && gone(); }, 20s));
}

TEST_CASE("a publisher is not said to be gone while the registry is taken") {
  const Watchdog watchdog(100);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Number>("/t");
  std::optional pusher(engine.advertise<Number>("/t"));
  must_go(pusher->push(pusher->loan(1u)));
  SUBCASE("it is there") {}
  SUBCASE("it has gone, and its messages are unread") { pusher.reset(); }
  std::optional<TakenRegistry> taken(std::in_place, engine);
  CHECK_FALSE(puller.try_pull());
  CHECK(puller.status() == Status::Empty);
  taken.reset();
  const auto message = puller.pull(20s);
  REQUIRE(message);
  CHECK(message->value == 1);
}

TEST_SUITE_END();
