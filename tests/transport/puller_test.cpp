// SPDX-License-Identifier: Apache-2.0
// The core of ShmPuller, step by step: what each call says, finds, leaves and sleeps on.
#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "futex/futex.hpp"
#include "segment/segment.hpp"
#include "support/error_of.hpp"
#include "support/in_a_moment.hpp"
#include "support/in_blocks.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "transport/participant.hpp"
#include "transport/ring_ends.hpp"
#include "waiting/hearing.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::PullerOptions;
using lot::PusherOptions;
using lot::QueueEngine;
using lot::Status;
using lot::detail::Borrowed;
using lot::detail::Clock;
using lot::detail::Delivery;
using lot::detail::FutexWaits;
using lot::detail::Limit;
using lot::transport::Participant;
using lot::transport::RingPuller;

struct Number {
  std::uint64_t value = 0;
};
/// Plain, and larger than what a block or a slot has room for.
struct Large {
  std::uint64_t value = 0;
  std::array<unsigned char, 5000> rest{};
};
/// Not plain. The library frees it as a whole.
struct Text {
  lot::ShmString text;
};
/// Not plain, and has a destructor.
struct Refers {
  lot::ShmRef<const Number> number;
};
template <std::size_t kBytes>
struct Sized {
  std::array<unsigned char, kBytes> bytes{};
};

using Numbers = lot::ShmPusher<Number>;
using Core = std::unique_ptr<RingPuller>;

PusherOptions of_depth(std::uint32_t depth, Policy policy = Policy::Overwrite,
                       QueueEngine engine = QueueEngine::Ring) {
  PusherOptions how;
  how.depth = depth;
  how.policy = policy;
  how.engine = engine;
  how.block_for = 10s;
  return how;
}
PullerOptions history(std::uint64_t messages) {
  PullerOptions how;
  how.history = messages;
  return how;
}
PullerOptions observing() {
  PullerOptions how;
  how.observer = true;
  return how;
}
PullerOptions holding(std::uint64_t bytes) {
  PullerOptions how;
  how.max_held_bytes = bytes;
  return how;
}
lot::QueueOptions tasks() {
  lot::QueueOptions how;
  how.redeliver = true;
  how.depth = 4;
  return how;
}

void push(Numbers& pusher, std::uint64_t value) { must_go(pusher.push(pusher.loan(value))); }

Limit soon() { return Limit::until(Clock::now() + 2ms, {}); }

struct Fixture {
  const Watchdog watchdog{60};
  const lot::EngineOptions options = fresh();
  const int both = unsetenv("LOT_QUEUE") + unsetenv("LOT_FAST_LANE");
  lot::ShmEngine engine{options};
  std::shared_ptr<Participant> participant = Participant::join(options);
  lot::segment::Segment& segment = participant->segment();

  template <class T = Number>
  Core subscribe(const PullerOptions& how = {}, Delivery delivery = Delivery::ToAll,
                 lot::transport::RingWatcher* watcher = nullptr, const char* topic = "/t") {
    return lot::transport::make_ring_puller(participant, topic, lot::detail::message_type<T>(), how,
                                            delivery, watcher);
  }
  Numbers advertise(const PusherOptions& how = {}) { return engine.advertise<Number>("/t", how); }
  /// A worker of the queue "/tasks".
  Core work() {
    return lot::transport::make_ring_puller(participant, "/tasks", lot::detail::task_type<Number>(),
                                            {}, Delivery::ToWorker, nullptr);
  }
  std::uint32_t version() const { return segment.directory().version.load(); }
  lot::segment::RingHead& head(std::uint32_t channel) const {
    return lot::segment::Segment::head_of(segment.ring(channel));
  }
};

/// What a look has come to.
struct Found {
  Status status;
  std::uint64_t value;  ///< 0: nothing
  std::uint64_t missed;
  bool operator==(const Found&) const = default;
};
template <class T = Number>
std::uint64_t value_of(const Borrowed& borrowed) {
  return borrowed.root != nullptr ? static_cast<const T*>(borrowed.root)->value : 0;
}
Found borrow(RingPuller& core, Limit limit = Limit::now()) {
  Borrowed borrowed;
  const Status status = core.borrow(borrowed, limit);
  const Found found{status, value_of(borrowed), borrowed.missed};
  if (status == Status::Ok) core.done();
  return found;
}
template <class T = Number>
Found pull(RingPuller& core, Limit limit = Limit::now()) {
  Borrowed kept;
  const Status status = core.pull(kept, limit);
  const Found found{status, value_of<T>(kept), kept.missed};
  if (status == Status::Ok) kept.control->drop_pointer();
  return found;
}
/// The same, and the message stays.
template <class T = Number>
lot::ShmSharedPtr<const T> keep(RingPuller& core, Limit limit = Limit::now()) {
  Borrowed kept;
  if (core.pull(kept, limit) != Status::Ok) return {};
  return lot::detail::PointerAccess::shared(static_cast<const T*>(kept.root), kept.control);
}
std::string text_of(int number, const std::string& object, const char* reason, const char* advice) {
  return lot::Error(number, object, reason, advice).what();
}

/// What a puller tells the one that watches it.
struct Watcher final : lot::transport::RingWatcher {
  struct Joined {
    std::uint32_t channel, cell;
    bool operator==(const Joined&) const = default;
  };
  void announcing(std::uint32_t topic) noexcept override { announced.push_back(topic); }
  void joining(const lot::segment::Ring& ring, std::uint32_t cell) noexcept override {
    joined.push_back({ring.channel, cell});
  }
  void leaving(const lot::transport::Source& source) override { left.push_back(source.name); }

  std::vector<std::uint32_t> announced;
  std::vector<Joined> joined;
  std::vector<lot::registry::ChannelName> left;
};

/// What a puller asks of one that hears for it.
struct Listener final : lot::detail::Hearer {
  void listen(std::uint32_t channel) override { channels.push_back(channel); }
  void watch_directory(std::uint32_t version) override { versions.push_back(version); }
  std::vector<std::uint32_t> channels;
  std::vector<std::uint32_t> versions;
};

/// Arms the puller, and says whether it may sleep until `after` from then.
struct Armed {
  explicit Armed(RingPuller& core, FutexWaits& waits) : before(Clock::now()) {
    waits.clear();
    again = core.arm(waits);
    after = Clock::now();
  }
  bool is_in(std::chrono::nanoseconds time) const {
    return again && *again >= before + time && *again <= after + time;
  }
  Clock::time_point before;
  std::optional<Clock::time_point> again;
  Clock::time_point after;
};

/// The registry's lock is another thread's while this lives.
class TakenRegistry {
 public:
  explicit TakenRegistry(const lot::segment::Segment& segment) : segment_(segment) {
    REQUIRE(held_.next() != 0);
  }
  ~TakenRegistry() {
    go_.tell();
    other_.join();
  }

 private:
  const lot::segment::Segment& segment_;
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

TEST_SUITE_BEGIN("transport");

TEST_CASE_FIXTURE(Fixture, "each look says why it has found nothing, or what it has found") {
  const Core core = subscribe();
  CHECK(borrow(*core) == Found{Status::PublisherGone, 0, 0});
  CHECK(pull(*core) == Found{Status::PublisherGone, 0, 0});
  CHECK(borrow(*core, soon()) == Found{Status::PublisherGone, 0, 0});
  CHECK(pull(*core, soon()) == Found{Status::PublisherGone, 0, 0});
  CHECK(pull(*core, Limit::until(Clock::time_point::min(), {})) ==
        Found{Status::PublisherGone, 0, 0});

  lot::StopSource source;
  CHECK(borrow(*core, Limit::until(Clock::now() + 1ms, source.get_token())) ==
        Found{Status::PublisherGone, 0, 0});
  source.request_stop();
  const Limit stopped = Limit::forever(source.get_token());
  CHECK(borrow(*core, stopped) == Found{Status::Stopped, 0, 0});
  CHECK(pull(*core, stopped) == Found{Status::Stopped, 0, 0});

  std::optional pusher(advertise(of_depth(4)));
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  CHECK(pull(*core) == Found{Status::Empty, 0, 0});
  CHECK(borrow(*core, soon()) == Found{Status::Timeout, 0, 0});
  CHECK(pull(*core, soon()) == Found{Status::Timeout, 0, 0});
  CHECK(pull(*core, Limit::until(Clock::time_point::min(), {})) == Found{Status::Timeout, 0, 0});

  for (std::uint64_t n = 1; n <= 6; ++n) push(*pusher, n);
  CHECK(borrow(*core, stopped) == Found{Status::Stopped, 0, 0});
  CHECK(pull(*core, stopped) == Found{Status::Stopped, 0, 0});
  CHECK(borrow(*core) == Found{Status::Ok, 3, 2});
  CHECK(pull(*core) == Found{Status::Ok, 4, 0});
  CHECK(borrow(*core, soon()) == Found{Status::Ok, 5, 0});
  pusher.reset();
  CHECK(pull(*core, Limit::forever({})) == Found{Status::Ok, 6, 0});
  CHECK(core->sources().size() == 1);
  CHECK(pull(*core, Limit::forever({})) == Found{Status::PublisherGone, 0, 0});
  CHECK(core->sources().empty());
  CHECK(pull(*core, soon()) == Found{Status::PublisherGone, 0, 0});  // it waits for another one
}

TEST_CASE_FIXTURE(Fixture, "a wait for ever ends once for each time that all publishers go") {
  for (const bool keeps : {false, true}) {
    const Core core = subscribe();
    const auto look = [&](Limit limit) {
      return keeps ? pull(*core, limit) : borrow(*core, limit);
    };
    for (int round = 0; round < 2; ++round) {
      std::optional one(advertise()), two(advertise());
      push(*one, 1);
      CHECK(look(Limit::forever({})) == Found{Status::Ok, 1, 0});
      one.reset();
      push(*two, 2);
      two.reset();
      CHECK(look(Limit::forever({})) == Found{Status::Ok, 2, 0});
      CHECK(look(Limit::forever({})) == Found{Status::PublisherGone, 0, 0});
      lot::StopSource source;
      const InAMoment stop([&] { source.request_stop(); });
      CHECK(look(Limit::forever(source.get_token())) == Found{Status::Stopped, 0, 0});
    }
  }
}

TEST_CASE_FIXTURE(Fixture, "while a borrow lasts each look is an error that says so") {
  const Core core = subscribe();
  auto pusher = advertise();
  push(pusher, 1);
  push(pusher, 2);
  const auto text = text_of(EBUSY, engine.path(), "this puller has a borrow that has not ended",
                            "end it (one borrow at a time), or keep() the message");
  for (int round = 0; round < 2; ++round) {
    Borrowed borrowed, other;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    for (const Limit limit : {Limit::now(), Limit::forever({})}) {
      CHECK(error_of([&] { (void)core->borrow(other, limit); }) == std::pair{EBUSY, text});
      CHECK(error_of([&] { (void)core->pull(other, limit); }) == std::pair{EBUSY, text});
    }
    FutexWaits waits;
    CHECK(!core->arm(waits));  // the next look says it
    CHECK(waits.empty());
    CHECK(core->size() == static_cast<std::size_t>(2 - round));
    if (round == 1) {  // also where it is damaged, and there is no other
      auto& word = core->sources()[0].reader.ring().slots[1];
      const auto whole = word.exchange(lot::ring::make(0, lot::ring::kNoBlock));
      CHECK(!core->ready());
      CHECK(!core->arm(waits));
      CHECK(waits.empty());
      word.store(whole);
    }
    core->done();
    CHECK(core->size() == static_cast<std::size_t>(1 - round));
  }
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
}

TEST_CASE_FIXTURE(Fixture, "a puller that holds all it may says of each look why it ends") {
  auto pusher = engine.advertise<Large>("/t", of_depth(8));
  const auto send = [&](std::uint64_t value) {
    auto message = pusher.loan();
    message->value = value;
    must_go(pusher.push(std::move(message)));
  };
  const Core core = subscribe<Large>(holding(4096));
  send(1);
  auto kept = keep<Large>(*core);
  REQUIRE(kept);

  lot::StopSource source;
  source.request_stop();
  const Limit stopped = Limit::forever(source.get_token());
  CHECK(pull<Large>(*core, stopped) == Found{Status::Stopped, 0, 0});
  CHECK(pull<Large>(*core) == Found{Status::Empty, 0, 0});
  CHECK(pull<Large>(*core, soon()) == Found{Status::Timeout, 0, 0});
  CHECK(!core->ready());

  send(2);
  CHECK(!core->ready());  // arm() says when to look again
  CHECK(pull<Large>(*core) == Found{Status::HoldsTooMuch, 0, 0});
  CHECK(pull<Large>(*core, soon()) == Found{Status::HoldsTooMuch, 0, 0});
  CHECK(pull<Large>(*core, stopped) == Found{Status::Stopped, 0, 0});
  {
    lot::StopSource later;
    const InAMoment stop([&] { later.request_stop(); });
    CHECK(pull<Large>(*core, Limit::forever(later.get_token())) == Found{Status::Stopped, 0, 0});
  }
  CHECK(core->size() == 1);
  const auto text =
      text_of(EDQUOT, "/t", "the subscription holds 0 MiB in 1 messages, which is all that it may",
              "let messages go, or raise PullerOptions::max_held_bytes");
  CHECK(error_of([&] { core->refuse_to_hold(); }) == std::pair{EDQUOT, text});
  {
    Borrowed borrowed;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    CHECK(value_of<Large>(borrowed) == 2);
    CHECK(error_of([&] { (void)core->keep(); }) == std::pair{EDQUOT, text});
    core->done();
  }
  send(3);
  CHECK(core->ready());  // a borrow keeps nothing
  {
    FutexWaits none;
    for (int n = 0; n < 2; ++n) CHECK(!core->arm(none));
  }
  CHECK(pull<Large>(*core) == Found{Status::HoldsTooMuch, 0, 0});
  CHECK(!core->ready());

  // A wait set is told at once, and then looks each ten milliseconds.
  FutexWaits waits;
  CHECK(!core->arm(waits));
  CHECK(Armed(*core, waits).is_in(10ms));
  CHECK(waits.empty());
  kept.reset();
  CHECK(!core->arm(waits));
  CHECK(pull<Large>(*core) == Found{Status::Ok, 3, 0});

  send(4);
  kept = keep<Large>(*core);
  send(5);
  {
    const InAMoment let_go([&] { kept.reset(); });
    CHECK(pull<Large>(*core, Limit::until(Clock::now() + 20s, {})) == Found{Status::Ok, 5, 0});
  }
}

TEST_CASE_FIXTURE(Fixture, "a puller that holds all it may is told of an error and of an end") {
  std::optional pusher(engine.advertise<Large>("/t", of_depth(8)));
  const Core core = subscribe<Large>(holding(4096));
  must_go(pusher->push(pusher->loan()));
  const auto kept = keep<Large>(*core);
  REQUIRE(kept);
  must_go(pusher->push(pusher->loan()));
  {
    Borrowed borrowed, other;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    CHECK(error_of([&] { (void)core->pull(other, Limit::now()); }).first == EBUSY);
    core->done();
  }
  // It finds new rings, and leaves those that have ended.
  auto second = engine.advertise<Large>("/t", of_depth(8));
  CHECK(pull<Large>(*core) == Found{Status::Empty, 0, 0});
  CHECK(core->sources().size() == 2);
  pusher.reset();
  CHECK(pull<Large>(*core) == Found{Status::Empty, 0, 0});
  CHECK(core->sources().size() == 1);
  must_go(second.push(second.loan()));
  CHECK(pull<Large>(*core) == Found{Status::HoldsTooMuch, 0, 0});
}

TEST_CASE_FIXTURE(Fixture, "a puller that holds all it may hears once that its publisher went") {
  for (const bool waits : {false, true}) {
    CAPTURE(waits);
    const auto limit = [&] { return waits ? Limit::forever({}) : Limit::now(); };
    std::optional pusher(engine.advertise<Large>("/t", of_depth(8)));
    const Core core = subscribe<Large>(holding(4096));
    must_go(pusher->push(pusher->loan()));
    const auto kept = keep<Large>(*core);
    REQUIRE(kept);
    pusher.reset();
    lot::StopSource before;
    before.request_stop();
    CHECK(pull<Large>(*core, Limit::forever(before.get_token())) == Found{Status::Stopped, 0, 0});
    CHECK(pull<Large>(*core, limit()) == Found{Status::PublisherGone, 0, 0});
    CHECK(pull<Large>(*core, soon()) == Found{Status::PublisherGone, 0, 0});
    lot::StopSource source;
    const InAMoment stop([&] { source.request_stop(); });
    CHECK(pull<Large>(*core, Limit::forever(source.get_token())) == Found{Status::Stopped, 0, 0});
  }
}

TEST_CASE_FIXTURE(Fixture, "what counts as held is a message's memory, and not its block") {
  // Small ones count by their number only: a quarter of the blocks.
  const Core core = subscribe(holding(4096));
  auto pusher = advertise(in_blocks());
  std::vector<lot::ShmSharedPtr<const Number>> kept;
  for (std::uint64_t n = 0; n < 10; ++n) {
    push(pusher, n + 1);
    kept.push_back(keep(*core));
    REQUIRE(kept.back());
    CHECK(kept.back()->value == n + 1);
  }
  {
    auto slots = engine.advertise<Number>("/slots");
    const Core from_slots = subscribe(holding(4096), Delivery::ToAll, nullptr, "/slots");
    for (std::uint64_t n = 0; n < 10; ++n) {
      push(slots, n + 1);
      kept.push_back(keep(*from_slots));
      REQUIRE(kept.back());
    }
  }
  // One that is not plain may have memory.
  const Core texts = subscribe<Text>(holding(2 * 4096), Delivery::ToAll, nullptr, "/texts");
  auto out = engine.advertise<Text>("/texts");
  std::vector<lot::ShmSharedPtr<const Text>> held;
  for (int n = 0; n < 5; ++n) {
    auto text = out.loan();
    text->text = std::string(3000, 'x').c_str();
    must_go(out.push(std::move(text)));
    if (auto one = keep<Text>(*texts)) held.push_back(std::move(one));
  }
  CHECK(held.size() == 2);
}

TEST_CASE_FIXTURE(Fixture, "a borrowed message has the memory of a slot, a block or granules") {
  const auto memory = [&](auto message, const PusherOptions& how) {
    using T = decltype(message);
    const Core core = subscribe<T>({}, Delivery::ToAll, nullptr, "/memory");
    auto pusher = engine.advertise<T>("/memory", how);
    must_go(pusher.push(pusher.loan()));
    Borrowed borrowed;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    const std::uint64_t bytes = core->memory();
    core->done();
    return bytes;
  };
  CHECK(memory(Number{}, {}) == 64);
  CHECK(memory(Sized<48>{}, {}) == 64);
  CHECK(memory(Sized<49>{}, {}) == 128);
  CHECK(memory(Sized<240>{}, {}) == 256);
  CHECK(memory(Number{}, in_blocks()) == 256);
  CHECK(memory(Sized<256>{}, {}) == 256);
  CHECK(memory(Sized<257>{}, {}) == 4096);
  CHECK(memory(Large{}, {}) == 8192);
}

TEST_CASE_FIXTURE(Fixture, "size(), publishers() and sources() count exactly what is there") {
  const Core core = subscribe();
  CHECK(core->size() == 0);
  CHECK(core->publishers() == 0);
  std::optional one(advertise(of_depth(4)));
  CHECK(core->sources().empty());  // until it looks
  CHECK(core->publishers() == 1);
  CHECK(core->sources().size() == 1);
  std::optional two(advertise(of_depth(4)));
  for (std::uint64_t n = 1; n <= 3; ++n) push(*two, n);
  CHECK(core->size() == 3);  // it finds the new one
  CHECK(core->sources().size() == 2);
  push(*one, 7);
  CHECK(core->size() == 4);
  for (std::uint64_t n = 1; n <= 9; ++n) push(*one, n);
  CHECK(core->size() == 7);
  CHECK(core->publishers() == 2);
  two.reset();
  CHECK(core->publishers() == 1);
  CHECK(core->size() == 7);
  one.reset();
  CHECK(core->publishers() == 0);
  CHECK(core->size() == 7);
  std::uint64_t n = 0, missed = 0;
  for (Found found; (found = borrow(*core)).status == Status::Ok;) {
    ++n;
    missed += found.missed;
  }
  CHECK(n == 7);
  CHECK(missed == 6);
  CHECK(core->sources().empty());
  CHECK(core->size() == 0);
}

TEST_CASE_FIXTURE(Fixture, "a look begins behind the publisher that had the last message") {
  const Core core = subscribe();
  std::vector<Numbers> pushers;
  for (int p = 0; p < 3; ++p) pushers.push_back(advertise());
  for (std::uint64_t p = 0; p < 3; ++p) {
    for (std::uint64_t n = 0; n < 2; ++n) push(pushers[p], 10 * p + n + 1);
  }
  std::vector<std::uint64_t> values;
  for (Found found; (found = borrow(*core)).status == Status::Ok;) values.push_back(found.value);
  REQUIRE(values.size() == 6);
  for (std::size_t i = 0; i < 3; ++i) CHECK(values[i + 3] == values[i] + 1);
  std::sort(values.begin(), values.end());
  CHECK(values == std::vector<std::uint64_t>{1, 2, 11, 12, 21, 22});
}

TEST_CASE_FIXTURE(Fixture, "ready() is true where a look may find something") {
  { auto other = engine.advertise<Number>("/other"); }
  CHECK(version() != 0);
  const Core core = subscribe();
  CHECK(!core->ready());
  std::optional pusher(advertise());
  CHECK(core->ready());  // there may be new rings
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  CHECK(!core->ready());
  push(*pusher, 1);
  CHECK(core->ready());
  CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
  CHECK(!core->ready());
  pusher.reset();
  CHECK(core->ready());  // a look tells of the end
  CHECK(borrow(*core) == Found{Status::PublisherGone, 0, 0});
  CHECK(!core->ready());
}

TEST_CASE_FIXTURE(Fixture, "a puller that finds nothing sleeps on a word of each ring") {
  for (const QueueEngine kind : {QueueEngine::Ring, QueueEngine::Mutex}) {
    CAPTURE(static_cast<int>(kind));
    const Core core = subscribe();
    FutexWaits waits;
    // No ring: on the directory's version.
    CHECK(Armed(*core, waits).is_in(1s));
    REQUIRE(waits.size() == 1);
    CHECK(waits[0].word == &segment.directory().version.word());
    CHECK(waits[0].value == version());
    CHECK(!waits[0].is_shared);

    std::optional one(advertise(of_depth(4, Policy::Overwrite, kind)));
    std::optional two(advertise(of_depth(4, Policy::Overwrite, kind)));
    CHECK(Armed(*core, waits).is_in(1s));
    REQUIRE(waits.size() == 2);
    REQUIRE(core->sources().size() == 2);
    for (std::size_t i = 0; i < 2; ++i) {
      const auto& ring = core->sources()[i].reader.ring();
      if (kind == QueueEngine::Mutex) {
        CHECK(waits[i].word == static_cast<const void*>(ring.arrived));
        CHECK(waits[i].value == ring.arrived->load());
      } else {
        CHECK(waits[i].word == lot::futex::low_half(ring.slots[0]));
        CHECK(waits[i].value == static_cast<std::uint32_t>(ring.slots[0].load()));
      }
      CHECK(!waits[i].is_shared);
    }
    // Its own marks stand, and are no other's.
    CHECK(Armed(*core, waits).is_in(1s));
    REQUIRE(waits.size() == 2);
    for (const auto& wait : waits) CHECK(!wait.is_shared);
    // Those of another sleeper are.
    const Core other = subscribe();
    FutexWaits others;
    CHECK(Armed(*other, others).is_in(1s));
    REQUIRE(others.size() == 2);
    for (std::size_t i = 0; i < 2; ++i) {
      CHECK(others[i].word == waits[i].word);
      CHECK(others[i].value == waits[i].value);
      CHECK(others[i].is_shared);
    }
    push(*two, 1);
    waits.clear();
    CHECK(!core->arm(waits));
    CHECK(waits.empty());
    CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
    // One has gone: the sleep is on the other one alone.
    two.reset();
    CHECK(Armed(*core, waits).is_in(1s));
    CHECK(waits.size() == 1);
    CHECK(core->sources().size() == 1);
    // Both have gone: the next look says so.
    one.reset();
    CHECK(!core->arm(waits));
    CHECK(borrow(*core) == Found{Status::PublisherGone, 0, 0});
    CHECK(Armed(*core, waits).is_in(1s));
    CHECK(waits.size() == 1);
  }
}

TEST_CASE_FIXTURE(Fixture, "a puller that is heard for names each ring, and sleeps on no word") {
  const Core core = subscribe();
  Listener listener;
  FutexWaits waits;
  waits.hear_by(&listener);
  CHECK(Armed(*core, waits).is_in(1s));
  CHECK(waits.empty());
  CHECK(listener.channels.empty());
  CHECK(listener.versions == std::vector{version()});
  listener.versions.clear();

  auto one = advertise();
  auto two = advertise();
  CHECK(Armed(*core, waits).is_in(1s));
  CHECK(waits.empty());
  REQUIRE(core->sources().size() == 2);
  CHECK(listener.channels ==
        std::vector{core->sources()[0].name.channel, core->sources()[1].name.channel});
  CHECK(listener.versions.empty());
  listener.channels.clear();

  push(one, 1);
  CHECK(!core->arm(waits));
  CHECK(listener.channels.empty());
  CHECK(core->ear_owner() == participant);
}

TEST_CASE_FIXTURE(Fixture, "while another has the registry a puller dozes, and looks no further") {
  const Core core = subscribe();
  auto pusher = advertise();
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  FutexWaits waits;
  {
    const TakenRegistry taken(segment);
    segment.directory().version.bump();
    CHECK(core->ready());
    CHECK(Armed(*core, waits).is_in(5ms));
    REQUIRE(waits.size() == 2);
    CHECK(waits[1].word == &segment.directory().version.word());
    CHECK(waits[1].value == version());
    CHECK(!core->ready());
    // What it has found is read all the same.
    push(pusher, 1);
    CHECK(core->ready());
    CHECK(core->size() == 1);
    CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
    CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
    Listener listener;
    FutexWaits heard;
    heard.hear_by(&listener);
    CHECK(Armed(*core, heard).is_in(5ms));
    CHECK(listener.channels.size() == 1);
    CHECK(listener.versions == std::vector{version()});
  }
  CHECK(core->publishers() == 1);
  CHECK(Armed(*core, waits).is_in(1s));
  CHECK(waits.size() == 1);
  // Once it has found what there is, it looks for more at once.
  auto later = advertise();
  CHECK(core->ready());
}

TEST_CASE_FIXTURE(Fixture, "a puller without a ring is not alone while another has the registry") {
  const Core core = subscribe();
  const TakenRegistry taken(segment);
  CHECK(borrow(*core) == Found{Status::PublisherGone, 0, 0});
  segment.directory().version.bump();
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  CHECK(pull(*core, soon()) == Found{Status::Timeout, 0, 0});
}

TEST_CASE_FIXTURE(Fixture, "a watcher hears of each ring that its puller joins and leaves") {
  Watcher watcher;
  const Core before = subscribe<Number>({}, Delivery::ToAll, nullptr, "/before");
  std::optional first(advertise());
  const Core early = subscribe();
  CHECK(early->topic() != before->topic());
  CHECK(segment.topics()[early->topic()].name == std::string("/t"));
  {
    const Core core = subscribe({}, Delivery::ToAll, &watcher);
    CHECK(watcher.announced == std::vector{core->topic()});
    REQUIRE(core->sources().size() == 1);
    const auto name = core->sources()[0].name;
    CHECK(watcher.joined == std::vector<Watcher::Joined>{{name.channel, 1}});
    // A ring that awaits it is not joined.
    auto second = advertise();
    CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
    CHECK(core->sources().size() == 2);
    CHECK(watcher.joined.size() == 1);
    push(*first, 1);
    first.reset();
    FutexWaits waits;
    CHECK(!core->arm(waits));
    CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
    CHECK(watcher.left.empty());
    // The watcher's module may have kept messages of what has ended: it looks first.
    CHECK(!core->arm(waits));
    CHECK(watcher.left == std::vector{name});
    CHECK(core->sources().size() == 1);
    CHECK(core->arm(waits));
    CHECK(watcher.left.size() == 1);
  }
  CHECK(watcher.left.size() == 1);  // what it leaves by going it does not tell
  CHECK(watcher.announced.size() == 1);
}

TEST_CASE_FIXTURE(Fixture, "an observer's watcher hears of new rings, too") {
  Watcher watcher;
  const Core core = subscribe(observing(), Delivery::ToAll, &watcher);
  CHECK(watcher.announced == std::vector{core->topic()});
  CHECK(watcher.joined.empty());
  const Core reader = subscribe();
  auto pusher = advertise();
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  REQUIRE(core->sources().size() == 1);
  CHECK(watcher.joined == std::vector<Watcher::Joined>{{core->sources()[0].name.channel, 1}});
  CHECK(pusher.readers() == 1);
}

TEST_CASE_FIXTURE(Fixture, "a late subscriber gets the history that it asks for, and no more") {
  auto pusher = advertise(of_depth(4));
  for (std::uint64_t n = 1; n <= 6; ++n) push(pusher, n);
  for (const std::uint64_t most : {0UL, 1UL, 3UL, 4UL, 9UL}) {
    CAPTURE(most);
    const Core core = subscribe(history(most));
    const std::uint64_t there = std::min<std::uint64_t>(most, 4);
    CHECK(core->size() == there);
    for (std::uint64_t n = 7 - there; n <= 6; ++n) CHECK(borrow(*core) == Found{Status::Ok, n, 0});
    CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  }
}

TEST_CASE_FIXTURE(Fixture, "a puller that joins a ring anew reads it from its oldest message on") {
  std::optional pusher(advertise(of_depth(4)));
  const Core core = subscribe();
  for (std::uint64_t n = 1; n <= 3; ++n) push(*pusher, n);
  CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
  CHECK(borrow(*core) == Found{Status::Ok, 2, 0});
  REQUIRE(core->sources().size() == 1);
  const auto name = core->sources()[0].name;
  CHECK(core->sources()[0].reader.cell() == 0);
  CHECK(core->join_anew(name));
  CHECK(core->sources()[0].reader.cell() == 1);
  CHECK(pusher->readers() == 1);  // the old cell is free
  CHECK(core->size() == 3);
  for (std::uint64_t n = 1; n <= 3; ++n) CHECK(borrow(*core) == Found{Status::Ok, n, 0});
  for (const auto& [channel, generation] :
       {std::pair{name.channel + 1, name.generation}, {name.channel, name.generation + 1}}) {
    lot::registry::ChannelName other = name;
    other.channel = channel;
    other.generation = generation;
    CHECK(!core->join_anew(other));
  }
  CHECK(core->size() == 0);
  pusher.reset();
  CHECK(!core->join_anew(name));  // it has ended
  CHECK(borrow(*core) == Found{Status::PublisherGone, 0, 0});
}

TEST_CASE_FIXTURE(Fixture, "where all places are taken a puller says how many only observe") {
  lot::EngineOptions small = fresh();
  small.readers = 2;
  lot::ShmEngine narrow(small);
  auto pusher = narrow.advertise<Number>("/t");
  const auto refusal = [&](int observers) {
    const std::string reason =
        "a publisher of the topic has all the 2 readers that it can have, of which " +
        std::to_string(observers) + " only observe";
    return std::pair{EUSERS, text_of(EUSERS, narrow.path(), reason.c_str(),
                                     "make the segment with a larger EngineOptions::readers")};
  };
  std::vector<lot::ShmPuller<Number>> readers;
  readers.push_back(narrow.subscribe<Number>("/t", observing()));
  readers.push_back(narrow.subscribe<Number>("/t"));
  CHECK(pusher.readers() == 1);
  CHECK(error_of([&] { (void)narrow.subscribe<Number>("/t"); }) == refusal(1));
  CHECK(error_of([&] { (void)narrow.subscribe<Number>("/t", observing()); }) == refusal(1));
  readers.clear();
  readers.push_back(narrow.subscribe<Number>("/t"));
  readers.push_back(narrow.subscribe<Number>("/t"));
  CHECK(error_of([&] { (void)narrow.subscribe<Number>("/t"); }) == refusal(0));
  CHECK(pusher.readers() == 2);
  readers.clear();
  CHECK(pusher.readers() == 0);
  // An observer that finds such a ring later says it once, and goes on with the others.
  auto observer = narrow.subscribe<Number>("/t", observing());
  std::optional<lot::ShmPusher<Number>> other(narrow.advertise<Number>("/t"));
  lot::segment::Segment view(narrow.path());
  std::vector<std::uint32_t> channels;
  for (std::uint32_t c = 0; c < view.capacity().channels; ++c) {
    if (lot::ring::writer_state(view.channels()[c].writer.load()) == lot::ring::State::Live) {
      channels.push_back(c);
    }
  }
  REQUIRE(channels.size() == 2);
  const auto ring = view.ring(channels[1]);
  for (std::uint32_t c = 0; c < 2; ++c) ring.who[c].store(300);
  CHECK(error_of([&] { (void)observer.try_pull(); }) == refusal(0));
  push(pusher, 5);
  const auto message = observer.try_pull();
  REQUIRE(message);
  CHECK(message->value == 5);
  CHECK(observer.try_pull() == nullptr);
  for (std::uint32_t c = 0; c < 2; ++c) ring.who[c].store(0);
}

TEST_CASE_FIXTURE(Fixture, "a ring that cannot be the topic's is refused, or passed over") {
  auto pusher = advertise(of_depth(4, Policy::Block));
  std::uint32_t channel = 0;
  {
    const Core core = subscribe();
    REQUIRE(core->sources().size() == 1);
    channel = core->sources()[0].name.channel;
  }
  auto& entry = segment.channels()[channel];
  const auto refusal = std::pair{
      EBADMSG, text_of(EBADMSG, engine.path(), "the queue of a publisher of the topic is damaged",
                       "restart the publisher")};
  const auto refused = [&](auto type) {
    return error_of([&] { (void)subscribe<decltype(type)>(); }) == refusal;
  };
  const std::uint32_t depth = std::exchange(entry.depth, 0);
  CHECK(refused(Number{}));
  entry.depth = depth;
  const auto taken = entry.taken;
  entry.taken = 1;  // as a queue whose items are taken
  REQUIRE(segment.ring(channel).depth != 0);
  CHECK(refused(Number{}));
  entry.taken = lot::segment::kFinished;
  CHECK(refused(Number{}));
  entry.taken = taken;
  {
    const Core core = subscribe();
    CHECK(core->sources().size() == 1);
  }
  // One that comes while a puller is there is passed over.
  const Core core = subscribe();
  auto second = advertise(of_depth(4, Policy::Block));
  std::uint32_t its = 0;
  {
    const Core other = subscribe();
    REQUIRE(other->sources().size() == 2);
    its = other->sources()[0].name.channel != channel ? other->sources()[0].name.channel
                                                      : other->sources()[1].name.channel;
  }
  segment.channels()[its].taken = 1;
  REQUIRE(segment.ring(its).depth != 0);
  CHECK(core->publishers() == 1);
  CHECK(core->sources().size() == 1);
  // It is not looked at again.
  segment.channels()[its].taken = taken;
  segment.directory().version.bump();
  CHECK(core->publishers() == 1);
  CHECK(core->sources().size() == 1);
}

TEST_CASE_FIXTURE(Fixture, "a ring whose slots have no room for the type is refused") {
  const auto refused = [&](auto type, std::uint16_t stride, std::uint32_t stamps) {
    using T = decltype(type);
    auto pusher = engine.advertise<T>("/room", of_depth(4));
    std::uint32_t channel = 0;
    {
      const Core core = subscribe<T>({}, Delivery::ToAll, nullptr, "/room");
      channel = core->sources()[0].name.channel;
    }
    auto& entry = segment.channels()[channel];
    const std::uint16_t before = std::exchange(entry.stride, stride);
    const std::uint32_t stamped = std::exchange(head(channel).stamps, stamps);
    const bool is_ring = segment.ring(channel).depth != 0;
    const int error =
        error_of([&] { (void)subscribe<T>({}, Delivery::ToAll, nullptr, "/room"); }).first;
    entry.stride = before;
    head(channel).stamps = stamped;
    return std::pair{is_ring, error};
  };
  CHECK(refused(Sized<48>{}, 64, 0) == std::pair{true, 0});
  CHECK(refused(Sized<48>{}, 64, 1) == std::pair{true, EBADMSG});
  CHECK(refused(Sized<40>{}, 64, 1) == std::pair{true, 0});
  CHECK(refused(Sized<49>{}, 64, 0) == std::pair{true, EBADMSG});
  CHECK(refused(Sized<49>{}, 128, 0) == std::pair{true, 0});
  CHECK(refused(Refers{}, 64, 0) == std::pair{true, EBADMSG});
  CHECK(refused(Refers{}, 0, 0) == std::pair{true, 0});
  // A type without a description here is not plain, and has no destructor.
  CHECK(refused(Text{}, 64, 0) == std::pair{true, 0});
}

TEST_CASE_FIXTURE(Fixture, "what is damaged counts as missed, and the text says what it is") {
  const auto damage = [&](const char* what) {
    return std::pair{
        EBADMSG,
        text_of(EBADMSG, engine.path(), (std::string("a message is damaged: ") + what).c_str(),
                "somebody has written into the segment who should not: look for a process that "
                "writes behind the end of its messages")};
  };
  const auto look = [](RingPuller& core, bool keeps) {
    return error_of([&] {
      Borrowed borrowed;
      if (keeps) {
        (void)core.pull(borrowed, Limit::now());
      } else {
        (void)core.borrow(borrowed, Limit::now());
      }
    });
  };
  for (const bool keeps : {false, true}) {
    CAPTURE(keeps);
    const Core core = subscribe();
    auto pusher = advertise(of_depth(4));
    const auto next = [&] { return keeps ? pull(*core) : borrow(*core); };
    // In a slot: a word that is no slot's, and a message of another place.
    CHECK(next() == Found{Status::Empty, 0, 0});
    const auto& ring = core->sources()[0].reader.ring();
    push(pusher, 1);
    auto* words = &ring.slots[0];
    const auto whole = words[0].load();
    words[0].store(lot::ring::make(lot::ring::sequence(whole), 5));
    CHECK(look(*core, keeps) == damage("its slot in the queue cannot be right"));
    words[0].store(whole);
    push(pusher, 2);
    CHECK(next() == Found{Status::Ok, 2, 1});
    push(pusher, 3);
    words = &ring.slots[2];
    words[1].store(lot::ring::sequence(words[0].load()) + 1);
    CHECK(look(*core, keeps) == damage("its slot in the queue says what no publisher says"));
    push(pusher, 4);
    CHECK(next() == Found{Status::Ok, 4, 1});
    CHECK(next() == Found{Status::Empty, 0, 0});
  }
  // In a block: one that there is not.
  const Core core = subscribe<Large>({}, Delivery::ToAll, nullptr, "/large");
  auto pusher = engine.advertise<Large>("/large", of_depth(4));
  must_go(pusher.push(pusher.loan()));
  CHECK(core->size() == 1);
  const auto& ring = core->sources()[0].reader.ring();
  const auto good = ring.slots[0].load();
  for (const std::uint32_t block : {segment.capacity().blocks, segment.capacity().blocks + 1}) {
    ring.slots[0].store(lot::ring::make(lot::ring::sequence(good), block));
    CHECK(look(*core, false) == damage("its slot in the queue cannot be right"));
    REQUIRE(core->join_anew(core->sources()[0].name));
    CHECK(core->size() == 1);
  }
  ring.slots[0].store(good);
  const auto found = pull<Large>(*core);
  CHECK(found.status == Status::Ok);
  CHECK(found.missed == 2);
}

TEST_CASE_FIXTURE(Fixture, "what is kept of a slot bears its topic, and its block comes back") {
  const auto blocks = [&] { return Audit(segment).homes; };
  const std::size_t before = blocks();
  {
    auto pusher = advertise(of_depth(4));
    const Core core = subscribe();
    push(pusher, 1);
    push(pusher, 2);
    push(pusher, 3);
    Borrowed kept;
    REQUIRE(core->pull(kept, Limit::now()) == Status::Ok);
    CHECK(value_of(kept) == 1);
    CHECK(segment.arena(kept.control->block).topic == lot::segment::topic_key("/t"));
    kept.control->drop_pointer();
    // A borrow lies in private memory until it is kept, whatever was borrowed before.
    Borrowed borrowed = kept;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    CHECK(borrowed.control == nullptr);
    CHECK(value_of(borrowed) == 2);
    const auto copy = core->keep();
    core->done();
    REQUIRE(copy.control != nullptr);
    CHECK(copy.root != borrowed.root);
    CHECK(static_cast<const Number*>(copy.root)->value == 2);
    CHECK(segment.arena(copy.control->block).topic == lot::segment::topic_key("/t"));
    CHECK(pull(*core) == Found{Status::Ok, 3, 0});
    CHECK(static_cast<const Number*>(copy.root)->value == 2);
    copy.control->drop_pointer();
    // In a block nothing is copied.
    auto other = engine.advertise<Number>("/blocks", in_blocks());
    const Core blocks_core = subscribe<Number>({}, Delivery::ToAll, nullptr, "/blocks");
    push(other, 4);
    REQUIRE(blocks_core->borrow(borrowed, Limit::now()) == Status::Ok);
    REQUIRE(borrowed.control != nullptr);
    const auto same = blocks_core->keep();
    blocks_core->done();
    CHECK(same.control == borrowed.control);
    CHECK(same.root == borrowed.root);
    same.control->drop_pointer();
  }
  CHECK(eventually([&] { return blocks() == before; }));
}

TEST_CASE_FIXTURE(Fixture, "a borrowed message has its place, and the time of its push") {
  PusherOptions stamps = of_depth(4);
  stamps.stamp = true;
  for (const bool fast : {true, false}) {
    CAPTURE(fast);
    stamps.fast_lane = fast;
    const Core core = subscribe();
    auto with = advertise(stamps);
    for (std::uint64_t n = 0; n < 3; ++n) {
      const auto before = Clock::now();
      push(with, n + 1);
      const auto after = Clock::now();
      Borrowed borrowed;
      REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
      const auto& source = core->sources()[0];
      const auto origin = core->origin();
      CHECK(origin.channel == source.name.channel);
      CHECK(origin.generation == source.name.generation);
      CHECK(origin.sequence == source.reader.cursor());
      const auto pushed = core->pushed();
      REQUIRE(pushed);
      CHECK(*pushed >= before);
      CHECK(*pushed <= after);
      const lot::Envelope envelope = core->envelope();
      CHECK(envelope.sequence == n);
      CHECK(envelope.publisher == program_invocation_short_name);
      CHECK(envelope.publisher_id ==
            (std::uint64_t{source.name.generation} << 32 | source.name.channel));
      CHECK(envelope.pushed == pushed);
      core->done();
      CHECK(!core->envelope().pushed);  // it may have gone
      CHECK(core->envelope().sequence == n);
    }
    {
      push(with, 7);
      const auto kept = keep(*core);
      REQUIRE(kept);
      CHECK(core->envelope().pushed);
    }
  }
  const Core core = subscribe();
  auto without = advertise();
  push(without, 9);
  Borrowed borrowed;
  REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
  CHECK(!core->pushed());
  CHECK(!core->envelope().pushed);
  core->done();
}

TEST_CASE_FIXTURE(Fixture, "a time that the clock cannot have is no time of a push") {
  const Core core = subscribe<Large>({}, Delivery::ToAll, nullptr, "/large");
  PusherOptions stamps = of_depth(4);
  stamps.stamp = true;
  auto pusher = engine.advertise<Large>("/large", stamps);
  must_go(pusher.push(pusher.loan()));
  Borrowed borrowed;
  REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
  auto& word = segment.arena(borrowed.control->block).pushed_ns;
  CHECK(core->pushed());
  word = 0;
  CHECK(!core->pushed());
  word = std::uint64_t{INT64_MAX} + 1;
  CHECK(!core->pushed());
  word = std::uint64_t{INT64_MAX};
  CHECK(core->pushed() == Clock::time_point(std::chrono::nanoseconds(INT64_MAX)));
  word = 1;
  CHECK(core->pushed() == Clock::time_point(1ns));
  core->done();
}

TEST_CASE_FIXTURE(Fixture, "the envelope stays while rings go before, at and behind its own") {
  PusherOptions stamps = of_depth(4);
  stamps.stamp = true;
  for (std::size_t its = 0; its < 3; ++its) {
    CAPTURE(its);
    const Core core = subscribe();
    std::vector<std::optional<Numbers>> pushers;
    for (int p = 0; p < 3; ++p) pushers.emplace_back(advertise(stamps));
    CHECK(core->envelope().publisher.empty());
    CHECK(core->envelope().publisher_id == 0);
    REQUIRE(core->publishers() == 3);
    const auto id = [&](std::size_t s) {
      const auto& name = core->sources()[s].name;
      return std::uint64_t{name.generation} << 32 | name.channel;
    };
    std::vector<std::uint64_t> ids;
    for (std::size_t s = 0; s < 3; ++s) ids.push_back(id(s));
    // Which pusher has which ring, by a message of each; the last one is of ring `its`.
    std::vector<std::size_t> at(3);
    for (std::size_t p = 0; p < 3; ++p) {
      push(*pushers[p], 1);
      REQUIRE(borrow(*core).status == Status::Ok);
      const auto found = std::find(ids.begin(), ids.end(), core->envelope().publisher_id);
      REQUIRE(found != ids.end());
      at[static_cast<std::size_t>(found - ids.begin())] = p;
    }
    push(*pushers[at[its]], 2);
    const auto kept = keep(*core);
    REQUIRE(kept);
    const lot::Envelope whole = core->envelope();
    CHECK(whole.publisher_id == ids[its]);
    CHECK(whole.sequence == 1);
    CHECK(whole.pushed);
    const auto is_same = [&] {
      const lot::Envelope now = core->envelope();
      return now.publisher_id == whole.publisher_id && now.sequence == whole.sequence &&
             now.publisher == whole.publisher && now.pushed == whole.pushed;
    };
    // In each of three orders, its own is first, second or last.
    for (std::size_t n = 0; n < 3; ++n) {
      pushers[at[(its + n + 1) % 3]].reset();
      CHECK(borrow(*core).status == (n == 2 ? Status::PublisherGone : Status::Empty));
      CHECK(core->sources().size() == 2 - n);
      CHECK(is_same());
    }
    // Another ring in the place of the one that has gone changes nothing.
    auto later = advertise(stamps);
    CHECK(borrow(*core).status == Status::Empty);
    CHECK(is_same());
    push(later, 3);
    CHECK(borrow(*core) == Found{Status::Ok, 3, 0});
    CHECK(!is_same());
    CHECK(core->envelope().sequence == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "the envelope stays when its own ring goes first") {
  PusherOptions stamps = of_depth(4);
  stamps.stamp = true;
  for (const bool keeps : {false, true}) {
    CAPTURE(keeps);
    const Core core = subscribe();
    std::optional first(advertise(stamps));
    auto second = advertise(stamps);
    push(*first, 1);
    Borrowed borrowed;
    if (keeps) {
      REQUIRE(core->pull(borrowed, Limit::now()) == Status::Ok);
    } else {
      REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
      core->done();
    }
    const lot::Envelope whole = core->envelope();
    CHECK(whole.pushed.has_value() == keeps);
    first.reset();
    CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
    CHECK(core->sources().size() == 1);
    const lot::Envelope now = core->envelope();
    CHECK(now.publisher_id == whole.publisher_id);
    CHECK(now.publisher == whole.publisher);
    CHECK(now.sequence == 0);
    CHECK(now.pushed == whole.pushed);
    if (keeps) borrowed.control->drop_pointer();
  }
}

TEST_CASE_FIXTURE(Fixture, "a claim names its item, and only a claim that fits changes one") {
  auto queue = engine.queue<Number>("/tasks", tasks());
  must_go(queue.put({1}));
  std::optional goes(work());
  const Core core = work();
  goes.reset();  // its cell is free
  for (std::uint64_t n = 2; n <= 3; ++n) must_go(queue.put({n}));
  const auto take = [&](lot::detail::Claim& claim) {
    const Status status = core->pull(claim.item, Limit::now());
    if (status == Status::Ok) core->describe(claim);
    return status;
  };
  lot::detail::Claim one, two;
  REQUIRE(take(one) == Status::Ok);
  REQUIRE(core->sources().size() == 1);
  const auto& source = core->sources()[0];
  CHECK(value_of(one.item) == 1);
  CHECK(one.origin.channel == source.name.channel);
  CHECK(one.origin.generation == source.name.generation);
  CHECK(one.slot == 0);
  CHECK(one.deliveries == 1);
  CHECK(one.word == source.reader.ring().claims[0].load());
  CHECK(one.origin.sequence == lot::ring::sequence(source.reader.ring().slots[0].load()));
  REQUIRE(take(two) == Status::Ok);
  CHECK(value_of(two.item) == 2);
  CHECK(two.slot == 1);
  CHECK(two.origin.sequence == one.origin.sequence + 1);
  CHECK(core->size() == 1);

  // What another process may have written into a claim changes nothing: neither its item, nor what
  // lies behind the slots and behind the claims.
  const auto& ring = source.reader.ring();
  CHECK(source.reader.cell() == 1);
  auto& behind_slots = ring.cells[0].position;
  auto& behind_claims = ring.claims[4];
  REQUIRE(static_cast<void*>(&behind_slots) == static_cast<void*>(&ring.slots[4]));
  const auto idle = behind_slots.load();
  const auto zero = behind_claims.load();
  const auto returned = ring.returned->load();
  for (int field = 0; field < 5; ++field) {
    CAPTURE(field);
    lot::detail::Claim wrong = one;
    if (field == 0) ++wrong.origin.channel;
    if (field == 1) ++wrong.origin.generation;
    if (field == 2) wrong.slot = 4;
    if (field == 3) wrong.slot = 1000;
    if (field == 4) wrong.slot = ~std::uint32_t{0};
    const auto message = lot::ring::make(one.origin.sequence, 3);
    behind_slots.store(message);
    behind_claims.store(one.word);
    core->finish(wrong);
    core->give_back(wrong);
    CHECK(behind_slots.load() == message);
    CHECK(behind_claims.load() == one.word);
    CHECK(ring.returned->load() == returned);
    behind_slots.store(idle);
    behind_claims.store(zero);
    CHECK(core->size() == 1);
  }
  CHECK(queue.size() == 1);
  one.item.control->drop_pointer();
  core->give_back(one);
  CHECK(core->size() == 2);
  CHECK(core->ready());
  lot::detail::Claim again;
  REQUIRE(take(again) == Status::Ok);  // what has come back is first
  CHECK(value_of(again.item) == 1);
  CHECK(again.deliveries == 2);
  CHECK(again.slot == 0);
  again.item.control->drop_pointer();
  core->finish(again);
  two.item.control->drop_pointer();
  core->finish(two);
  CHECK(core->size() == 1);
  lot::detail::Claim three;
  REQUIRE(take(three) == Status::Ok);
  CHECK(value_of(three.item) == 3);
  three.item.control->drop_pointer();
  core->finish(three);
  CHECK(take(three) == Status::Empty);
  CHECK(core->size() == 0);
}

TEST_CASE_FIXTURE(Fixture, "items that have come back are found first, whatever their ring") {
  std::vector<lot::ShmQueue<Number>> queues;
  for (int q = 0; q < 3; ++q) queues.push_back(engine.queue<Number>("/tasks", tasks()));
  auto worker = engine.queue<Number>("/tasks", tasks());
  for (std::uint64_t q = 0; q < 3; ++q) {
    for (std::uint64_t n = 1; n <= 2; ++n) must_go(queues[q].put({10 * q + n}));
  }
  for (int round = 0; round < 3; ++round) {
    auto task = worker.try_take();
    REQUIRE(task);
    const std::uint64_t value = task->value;
    task.give_back();
    auto again = worker.try_take();
    REQUIRE(again);
    CHECK(again->value == value);
    CHECK(again.deliveries() == 2);
    again.finish();
  }
  CHECK(worker.size() == 3);
}

TEST_CASE_FIXTURE(Fixture, "a puller that goes leaves no cell, no ring, no topic and no block") {
  const Audit before(segment);
  {
    std::optional pusher(advertise(of_depth(4)));
    std::optional<Core> core(subscribe());
    const Core stays = subscribe();
    CHECK(pusher->readers() == 2);
    push(*pusher, 1);
    CHECK(pull(**core) == Found{Status::Ok, 1, 0});
    push(*pusher, 2);
    core.reset();
    CHECK(pusher->readers() == 1);
    CHECK(Audit(segment).readers == before.readers + 1);
    pusher.reset();
    CHECK(Audit(segment).channels == before.channels + 1);  // one has not read it
  }
  CHECK(eventually([&] {
    const Audit now(segment);
    return now.readers == before.readers && now.channels == before.channels &&
           now.topics == before.topics && now.homes == before.homes;
  }));
}

TEST_CASE_FIXTURE(Fixture, "a lossless publisher goes on when a puller has read, left or gone") {
  for (const bool fast : {true, false}) {
    PusherOptions how = of_depth(2, Policy::Block);
    how.fast_lane = fast;
    auto pusher = advertise(how);
    std::optional<Core> core(subscribe());
    for (std::uint64_t n = 1; n <= 2; ++n) push(pusher, n);
    auto third = pusher.loan(std::uint64_t{3});
    CHECK(pusher.push(std::move(third), 0ns) == Status::Full);
    CHECK(borrow(**core) == Found{Status::Ok, 1, 0});
    CHECK(pusher.push(std::move(third), 10s) == Status::Ok);
    auto fourth = pusher.loan(std::uint64_t{4});
    CHECK(pusher.push(std::move(fourth), 0ns) == Status::Full);
    core.reset();
    CHECK(pusher.push(std::move(fourth), 10s) == Status::Ok);
    CHECK(pusher.readers() == 0);
  }
}

TEST_CASE_FIXTURE(Fixture, "an observer is told that its topic carries another type") {
  std::optional pusher(advertise());
  const Core core = subscribe(observing());
  push(*pusher, 1);
  pusher.reset();
  auto other = engine.advertise<Large>("/t");
  CHECK(core->ready());
  CHECK(borrow(*core) == Found{Status::Ok, 1, 0});  // what it carried before is read
  const auto refusal = std::pair{
      ESTALE, text_of(ESTALE, "/t", "the topic carries another type now", "subscribe to it again")};
  // The ring is left when a look has found it empty.
  CHECK(error_of([&] {
          for (int n = 0; n < 3; ++n) (void)borrow(*core);
        }) == refusal);
  CHECK(core->sources().empty());
  CHECK(core->ready());
  FutexWaits waits;
  CHECK(!core->arm(waits));
  CHECK(error_of([&] { (void)pull(*core); }) == refusal);
  CHECK(error_of([&] { (void)pull(*core, Limit::forever({})); }) == refusal);
}

TEST_CASE_FIXTURE(Fixture, "a finished task rings the sender, and tells of the end, not before") {
  std::optional queue(engine.queue<Number>("/tasks", tasks()));
  for (std::uint64_t n = 1; n <= 2; ++n) must_go(queue->put({n}));
  const Core core = work(), other = work();
  const auto take = [&](RingPuller& worker) {
    lot::detail::Claim claim;
    REQUIRE(worker.pull(claim.item, Limit::now()) == Status::Ok);
    worker.describe(claim);
    claim.item.control->drop_pointer();
    return claim;
  };
  const auto one = take(*core), two = take(*core);
  const auto& ring = core->sources()[0].reader.ring();
  const auto marks = [&] {
    std::size_t n = 0;
    for (std::uint32_t i = 0; i < ring.places(); ++i) {
      n += (ring.slots[i].load() & lot::ring::kSleeper) != 0;
    }
    return n;
  };
  FutexWaits waits;
  // The sender sleeps for room: it is woken.
  const auto space = ring.space->load();
  CHECK(space % 2 == 0);
  core->finish(one);
  CHECK(ring.space->load() == space);
  CHECK(pull(*other).status == Status::Empty);
  REQUIRE(other->arm(waits));
  CHECK(marks() == 1);
  ring.space->store(space + 1);
  core->finish(two);
  CHECK(ring.space->load() == space + 2);
  CHECK(marks() == 1);  // more may come
  // What comes back wakes those that sleep.
  must_go(queue->put({3}));
  must_go(queue->put({4}));
  const auto three = take(*core), four = take(*core);
  CHECK(pull(*other).status == Status::Empty);
  REQUIRE(other->arm(waits));
  CHECK(marks() == 1);
  const auto ear = lot::waiting::Ear::claim(*participant);
  REQUIRE(ear);
  lot::waiting::Ear::Client client;
  ear->listen(client, core->sources()[0].name.channel);
  core->give_back(three);
  CHECK(marks() == 0);
  int due = 0;
  ear->take([&](lot::waiting::Ear::Client& heard) { due += &heard == &client; });
  CHECK(due == 1);
  ear->forget(client);
  CHECK(other->ready());
  const auto again = take(*other);
  CHECK(again.origin.sequence == three.origin.sequence);
  // The publisher has gone: the last task that is finished wakes them.
  queue.reset();
  CHECK(pull(*other).status == Status::Empty);
  REQUIRE(other->arm(waits));
  CHECK(marks() == 1);
  other->finish(again);
  CHECK(marks() == 1);
  core->finish(four);
  CHECK(marks() == 0);
  CHECK(pull(*core).status == Status::PublisherGone);
  CHECK(pull(*other).status == Status::PublisherGone);
}

TEST_CASE_FIXTURE(Fixture, "items that one reader takes count for no max_held_bytes") {
  auto queue = engine.queue<Large>("/items");
  const Core core =
      lot::transport::make_ring_puller(participant, "/items", lot::detail::taken_type<Large>(),
                                       holding(4096), Delivery::ToOne, nullptr);
  std::vector<Borrowed> items(4);
  for (Borrowed& item : items) {
    must_go(queue.emplace());
    CHECK(core->pull(item, Limit::now()) == Status::Ok);
  }
  for (const Borrowed& item : items) {
    if (item.control != nullptr) item.control->drop_pointer();
  }
}

TEST_CASE_FIXTURE(Fixture, "a puller that has looked takes no cell that awaits another one") {
  std::optional<Core> looks(subscribe());
  const Core waits = subscribe();
  auto pusher = advertise(of_depth(4, Policy::Block));
  push(pusher, 1);
  CHECK(borrow(**looks) == Found{Status::Ok, 1, 0});
  CHECK(pusher.readers() == 2);
  looks.reset();
  CHECK(pusher.readers() == 1);
  push(pusher, 2);
  CHECK(borrow(*waits) == Found{Status::Ok, 1, 0});
  CHECK(borrow(*waits) == Found{Status::Ok, 2, 0});
}

TEST_CASE_FIXTURE(Fixture, "a puller looks for rings when the directory has another version") {
  const Core core = subscribe();
  CHECK(core->publishers() == 0);
  const auto before = version();
  auto pusher = advertise();
  push(pusher, 1);
  auto& word = lot::test::raw(segment.directory().version);
  const auto now = word.exchange(before);
  CHECK(now != before);
  FutexWaits waits;
  CHECK(!core->ready());
  CHECK(core->size() == 0);
  CHECK(core->publishers() == 0);
  CHECK(core->arm(waits));
  CHECK(borrow(*core) == Found{Status::PublisherGone, 0, 0});
  CHECK(pull(*core) == Found{Status::PublisherGone, 0, 0});
  CHECK(core->sources().empty());
  word = now;
  CHECK(core->ready());
  CHECK(core->arm(waits) == std::nullopt);
  CHECK(core->sources().size() == 1);
  CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
  {
    const TakenRegistry taken(segment);
    CHECK(core->publishers() == 1);  // it has nothing to wait for
  }
}

TEST_CASE_FIXTURE(Fixture, "a ring that is not the puller's own is not joined anew") {
  const Core core = subscribe();
  std::optional first(advertise());
  CHECK(core->publishers() == 1);
  auto second = advertise();
  CHECK(core->publishers() == 2);
  const auto gone = core->sources()[0].name;
  first.reset();
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  REQUIRE(core->sources().size() == 1);
  auto name = core->sources()[0].name;
  CHECK(!core->join_anew(gone));
  name.channel += 100;
  CHECK(!core->join_anew(name));
  CHECK(second.readers() == 1);
  CHECK(core->sources()[0].reader.cell() == 0);
  // Who hears for it is told that it goes on elsewhere.
  const auto channel = core->sources()[0].name.channel;
  const auto ear = lot::waiting::Ear::claim(*participant);
  REQUIRE(ear);
  lot::waiting::Ear::Client client;
  ear->listen(client, channel);
  CHECK(!ear->has_rung());
  CHECK(core->join_anew(core->sources()[0].name));
  int due = 0;
  ear->take([&](lot::waiting::Ear::Client& one) { due += &one == &client; });
  CHECK(due == 1);
  ear->forget(client);
}

TEST_CASE_FIXTURE(Fixture, "a ring of the mutex engine without messages is not locked by a look") {
  const Core core = subscribe();
  auto pusher = advertise(of_depth(4, Policy::Overwrite, QueueEngine::Mutex));
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  const auto channel = core->sources()[0].name.channel;
  Steps held, go;
  std::thread other([&] {
    InOurName name(segment);
    auto lock = segment.queue_lock(channel, name);
    lock.lock();
    held.tell();
    go.next(60s);
    lock.unlock();
  });
  const bool is_held = held.next() != 0;
  CHECK(is_held);
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  CHECK(pull(*core) == Found{Status::Empty, 0, 0});
  CHECK(!core->ready());
  CHECK(core->size() == 0);
  go.tell();
  other.join();
  push(pusher, 1);
  CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
}

TEST_CASE_FIXTURE(Fixture, "without a free block a pull keeps what is in blocks, not in slots") {
  lot::EngineOptions small = fresh();
  small.blocks = 16;
  lot::ShmEngine few(small);
  const auto its = Participant::join(small);
  const auto subscribe_to = [&](const char* topic) {
    return lot::transport::make_ring_puller(its, topic, lot::detail::message_type<Number>(), {},
                                            Delivery::ToAll, nullptr);
  };
  auto slots = few.advertise<Number>("/slots", of_depth(4));
  auto blocks = few.advertise<Number>("/blocks", in_blocks(of_depth(4)));
  const Core in_slots = subscribe_to("/slots"), from_blocks = subscribe_to("/blocks");
  push(blocks, 7);
  std::vector<lot::ShmUniquePtr<Number>> loans;
  auto other = few.advertise<Number>("/other");
  while (auto loan = other.try_loan()) loans.push_back(std::move(loan));
  CHECK(loans.size() >= 8);
  // There is no message: no block is asked for.
  CHECK(pull(*in_slots) == Found{Status::Empty, 0, 0});
  CHECK(pull(*in_slots, soon()) == Found{Status::Timeout, 0, 0});
  CHECK(pull(*from_blocks) == Found{Status::Ok, 7, 0});
  {
    auto message = std::move(loans.back());
    loans.pop_back();
    message->value = 1;
    must_go(slots.push(std::move(message)));
    while (auto loan = other.try_loan()) loans.push_back(std::move(loan));
  }
  const auto before = Clock::now();
  CHECK(pull(*in_slots) == Found{Status::HoldsTooMuch, 0, 0});
  CHECK(pull(*in_slots, soon()) == Found{Status::HoldsTooMuch, 0, 0});
  lot::StopSource source;
  source.request_stop();
  CHECK(pull(*in_slots, Limit::forever(source.get_token())) == Found{Status::Stopped, 0, 0});
  {
    lot::StopSource later;
    const InAMoment stop([&] { later.request_stop(); });
    CHECK(pull(*in_slots, Limit::forever(later.get_token())) == Found{Status::Stopped, 0, 0});
  }
  CHECK(in_slots->size() == 1);
  const auto [error, text] = error_of([&] { in_slots->refuse_to_hold(); });
  CHECK(error == 0);  // lot::OutOfMemory
  CHECK(text.find(": no room for a message: 16 of 16 ") != text.npos);
  CHECK(text.find("EngineOptions::blocks") != text.npos);
  // Who waits for it is told at once, and then looks each ten milliseconds.
  CHECK(!in_slots->ready());
  FutexWaits waits;
  CHECK(!in_slots->arm(waits));
  const Armed armed(*in_slots, waits);
  if (armed.after < before + 1s) CHECK(armed.is_in(10ms));
  // Once the message has gone there is nothing to be told.
  CHECK(borrow(*in_slots) == Found{Status::Ok, 1, 0});
  CHECK(pull(*in_slots) == Found{Status::Empty, 0, 0});
  CHECK(!in_slots->ready());
  // A borrow that finds no block says so when it is kept.
  {
    auto message = std::move(loans.back());
    loans.pop_back();
    message->value = 2;
    must_go(slots.push(std::move(message)));
    while (auto loan = other.try_loan()) loans.push_back(std::move(loan));
  }
  {
    Borrowed borrowed;
    REQUIRE(in_slots->borrow(borrowed, Limit::now()) == Status::Ok);
    CHECK(error_of([&] { (void)in_slots->keep(); }) == std::pair{0, text});
    loans.pop_back();
    const auto kept = in_slots->keep();
    CHECK(static_cast<const Number*>(kept.root)->value == 2);
    in_slots->done();
    kept.control->drop_pointer();
    loans.push_back(other.loan());
  }
  // The same of a message that comes while it waits.
  {
    auto message = std::move(loans.back());
    loans.pop_back();
    message->value = 9;
    const InAMoment comes([&] {
      must_go(slots.push(std::move(message)));
      while (auto loan = other.try_loan()) loans.push_back(std::move(loan));
    });
    const auto found = pull(*in_slots, Limit::until(Clock::now() + 100ms, {}));
    // The block of the message itself is free for a moment.
    if (found != Found{Status::Ok, 9, 0}) {
      CHECK(found == Found{Status::HoldsTooMuch, 0, 0});
      CHECK(borrow(*in_slots) == Found{Status::Ok, 9, 0});
    }
  }
  // A pull that waits gets it once there is a block.
  {
    auto message = std::move(loans.back());
    loans.pop_back();
    message->value = 3;
    must_go(slots.push(std::move(message)));
    while (auto loan = other.try_loan()) loans.push_back(std::move(loan));
  }
  const InAMoment let_go([&] { loans.clear(); });
  CHECK(pull(*in_slots, Limit::until(Clock::now() + 20s, {})) == Found{Status::Ok, 3, 0});
}

TEST_CASE_FIXTURE(Fixture, "a forked child is refused each call, and changes nothing by going") {
  std::optional<Core> core(subscribe());
  auto pusher = advertise(of_depth(4, Policy::Block));
  push(pusher, 1);
  push(pusher, 2);
  (*core)->fd();
  auto large = engine.advertise<Large>("/large");
  const Core full = subscribe<Large>(holding(4096), Delivery::ToAll, nullptr, "/large");
  must_go(large.push(large.loan()));
  const auto held = keep<Large>(*full);
  REQUIRE(held);
  Borrowed borrowed;
  REQUIRE((*core)->borrow(borrowed, Limit::now()) == Status::Ok);
  const auto& ring = (*core)->sources()[0].reader.ring();
  const auto position = ring.cells[0].position.load();
  Child child([&] {
    const auto refuses = [](auto&& use, const char* what) {
      must(error_of(use).first == ECHILD, what);
    };
    Borrowed other;
    FutexWaits waits;
    refuses([&] { (void)(*core)->borrow(other, Limit::now()); }, "borrow");
    refuses([&] { (void)(*core)->pull(other, Limit::now()); }, "pull");
    refuses([&] { (void)(*core)->pull(other, Limit::forever({})); }, "pull that waits");
    refuses([&] { (void)full->pull(other, Limit::now()); }, "pull of one that is full");
    refuses([&] { (void)(*core)->keep(); }, "keep");
    refuses([&] { (void)(*core)->size(); }, "size");
    refuses([&] { (void)(*core)->publishers(); }, "publishers");
    refuses([&] { (void)(*core)->envelope(); }, "envelope");
    refuses([&] { (void)(*core)->fd(); }, "fd");
    refuses([&] { (void)(*core)->arm(waits); }, "arm");
    refuses([&] { (void)subscribe(); }, "subscribe");
    (*core)->done();
    refuses([&] { (void)(*core)->borrow(other, Limit::now()); }, "borrow after it");
    refuses([&] { (void)(*core)->pull(other, Limit::now()); }, "pull after it");
    refuses([&] { (void)(*core)->arm(waits); }, "arm after it");
    core.reset();
  });
  CHECK(child.wait() == 0);
  CHECK(ring.cells[0].position.load() == position);
  CHECK(pusher.readers() == 1);
  (*core)->done();
  CHECK(borrow(**core) == Found{Status::Ok, 2, 0});
}

TEST_CASE_FIXTURE(Fixture, "a publisher that does not stamp tells no time, whatever it wrote") {
  const Core core = subscribe<Large>({}, Delivery::ToAll, nullptr, "/large");
  auto pusher = engine.advertise<Large>("/large", of_depth(4));
  must_go(pusher.push(pusher.loan()));
  Borrowed borrowed;
  REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
  segment.arena(borrowed.control->block).pushed_ns = 5;
  CHECK(!core->pushed());
  CHECK(!core->envelope().pushed);
  core->done();
}

TEST_CASE_FIXTURE(Fixture, "a block that a damaged slot has left is used by the next keep") {
  const auto homes = [&] { return Audit(segment).homes; };
  {
    const Core core = subscribe();
    auto pusher = advertise(of_depth(4));
    push(pusher, 1);
    CHECK(core->size() == 1);
    auto* const words = &core->sources()[0].reader.ring().slots[0];
    const auto whole = words[1].load();
    words[1].store(whole + 1);
    Borrowed kept;
    CHECK(error_of([&] { (void)core->pull(kept, Limit::now()); }).first == EBADMSG);
    words[1].store(whole);
    const std::size_t with_spare = homes();
    push(pusher, 2);
    Borrowed borrowed;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    const auto copy = core->keep();
    core->done();
    CHECK(homes() <= with_spare + 1);
    copy.control->drop_pointer();
  }
  CHECK(eventually([&] { return Audit(segment).nothing(); }));
}

TEST_CASE_FIXTURE(Fixture, "a puller rings a sender that waits for room, when it ends and looks") {
  const Core core = subscribe();
  auto pusher = advertise(of_depth(4, Policy::Block));
  push(pusher, 1);
  CHECK(core->size() == 1);
  auto& space = *core->sources()[0].reader.ring().space;
  space.store(7);
  CHECK(borrow(*core) == Found{Status::Ok, 1, 0});
  CHECK(space.load() == 8);
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  CHECK(space.load() == 8);
  space.store(9);
  CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
  CHECK(space.load() == 10);
  FutexWaits waits;
  space.store(11);
  CHECK(core->arm(waits));
  CHECK(space.load() == 12);
}

TEST_CASE_FIXTURE(Fixture, "messages in slots and in blocks of one topic follow each other") {
  const Core core = subscribe();
  auto slots = advertise(of_depth(4));
  auto blocks = advertise(in_blocks(of_depth(4)));
  for (std::uint64_t n = 1; n <= 3; ++n) {
    push(slots, n);
    Borrowed borrowed;
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    CHECK(value_of(borrowed) == n);
    CHECK(borrowed.control == nullptr);
    CHECK(core->memory() == 64);
    core->done();
    push(blocks, 10 + n);
    REQUIRE(core->borrow(borrowed, Limit::now()) == Status::Ok);
    CHECK(value_of(borrowed) == 10 + n);
    REQUIRE(borrowed.control != nullptr);
    CHECK(core->memory() == 256);
    const auto kept = core->keep();
    CHECK(kept.control == borrowed.control);
    CHECK(kept.root == borrowed.root);
    core->done();
    kept.control->drop_pointer();
  }
}

TEST_CASE_FIXTURE(Fixture, "a message that is said to lie where it cannot be is damaged") {
  const Core core = subscribe<Large>({}, Delivery::ToAll, nullptr, "/large");
  auto pusher = engine.advertise<Large>("/large", of_depth(4));
  must_go(pusher.push(pusher.loan()));
  CHECK(core->size() == 1);
  const auto block = static_cast<std::uint32_t>(
      lot::ring::block(core->sources()[0].reader.ring().slots[0].load()));
  auto& root = segment.arena(block).root;
  const auto whole = std::exchange(root, 8);
  Borrowed borrowed;
  const auto [error, text] = error_of([&] { (void)core->borrow(borrowed, Limit::now()); });
  CHECK(error == EBADMSG);
  CHECK(text.find("a message is damaged: it is said to lie where it cannot be") != text.npos);
  root = whole;
  must_go(pusher.push(pusher.loan()));
  CHECK(pull<Large>(*core) == Found{Status::Ok, 0, 1});
}

TEST_CASE_FIXTURE(Fixture, "a subscribe that fails leaves the rings that it has joined") {
  lot::EngineOptions small = fresh();
  small.readers = 2;
  lot::ShmEngine narrow(small);
  const auto its = Participant::join(small);
  std::vector<Numbers> pushers;
  for (int p = 0; p < 3; ++p) pushers.push_back(narrow.advertise<Number>("/t"));
  const auto join = [&] {
    return lot::transport::make_ring_puller(its, "/t", lot::detail::message_type<Number>(), {},
                                            Delivery::ToAll, nullptr);
  };
  std::vector<std::uint32_t> order;
  {
    const Core core = join();
    REQUIRE(core->sources().size() == 3);
    for (const auto& source : core->sources()) order.push_back(source.name.channel);
  }
  // The last of them has no place.
  const auto ring = its->segment().ring(order[2]);
  for (std::uint32_t c = 0; c < 2; ++c) ring.who[c].store(300);
  for (int n = 0; n < 3; ++n) CHECK(error_of(join).first == EUSERS);
  for (std::uint32_t c = 0; c < 2; ++c) ring.who[c].store(0);
  CHECK(Audit(its->segment()).readers == 0);
  for (Numbers& pusher : pushers) CHECK(pusher.readers() == 0);
  const Core core = join();
  CHECK(Audit(its->segment()).readers == 3);
}

TEST_CASE_FIXTURE(Fixture, "a queue of the one kind is no queue of the other") {
  auto items = engine.queue<Number>("/items");
  auto jobs = engine.queue<Number>("/tasks", tasks());
  must_go(items.put({1}));
  must_go(jobs.put({1}));
  const auto take = [&] {
    return lot::transport::make_ring_puller(
        participant, "/items", lot::detail::taken_type<Number>(), {}, Delivery::ToOne, nullptr);
  };
  std::uint32_t one = 0, other = 0;
  {
    const Core core = take();
    one = core->sources()[0].name.channel;
    const Core worker = work();
    other = worker->sources()[0].name.channel;
  }
  const auto refused = [](auto&& subscribe) {
    return error_of([&] { (void)subscribe(); }).first == EBADMSG;
  };
  const auto turn = [&](std::uint32_t channel, std::uint32_t taken) {
    segment.channels()[channel].taken =
        static_cast<std::remove_reference_t<decltype(segment.channels()[channel].taken)>>(taken);
    REQUIRE(segment.ring(channel).depth != 0);
  };
  turn(one, 2);
  CHECK(refused(take));
  turn(one, 0);
  CHECK(refused(take));
  turn(one, 1);
  CHECK(!refused(take));
  turn(other, 1);
  CHECK(refused([&] { return work(); }));
  turn(other, 0);
  CHECK(refused([&] { return work(); }));
  turn(other, 2);
  CHECK(!refused([&] { return work(); }));
}

TEST_CASE_FIXTURE(Fixture, "a message that was not kept has no time when another ring goes") {
  PusherOptions stamps = of_depth(4);
  stamps.stamp = true;
  const Core core = subscribe();
  std::vector<std::optional<Numbers>> pushers;
  for (int p = 0; p < 2; ++p) pushers.emplace_back(advertise(stamps));
  CHECK(core->publishers() == 2);
  const auto first = core->sources()[0].name;
  // Of the ring that is first, not kept; then the one behind it goes.
  for (std::size_t p = 0; p < 2; ++p) {
    push(*pushers[p], 1);
    REQUIRE(borrow(*core).status == Status::Ok);
    const auto id = std::uint64_t{first.generation} << 32 | first.channel;
    if (core->envelope().publisher_id != id) continue;
    push(*pushers[p], 2);
    CHECK(borrow(*core) == Found{Status::Ok, 2, 0});
    CHECK(!core->envelope().pushed);
    pushers[1 - p].reset();
    CHECK(borrow(*core) == Found{Status::Empty, 0, 0});
    CHECK(core->sources().size() == 1);
    CHECK(!core->envelope().pushed);
    CHECK(core->envelope().sequence == 1);
    break;
  }
}

TEST_CASE_FIXTURE(Fixture, "a full puller, too, looks for rings when there may be new ones") {
  const Core core = subscribe<Large>(holding(4096));
  auto pusher = engine.advertise<Large>("/t", of_depth(8));
  must_go(pusher.push(pusher.loan()));
  const auto kept = keep<Large>(*core);
  REQUIRE(kept);
  CHECK(pull<Large>(*core) == Found{Status::Empty, 0, 0});
  const auto before = version();
  auto second = engine.advertise<Large>("/t", of_depth(8));
  auto& word = lot::test::raw(segment.directory().version);
  const auto now = word.exchange(before);
  CHECK(pull<Large>(*core) == Found{Status::Empty, 0, 0});
  CHECK(core->sources().size() == 1);
  word = now;
  CHECK(pull<Large>(*core) == Found{Status::Empty, 0, 0});
  CHECK(core->sources().size() == 2);
}

TEST_SUITE_END();
