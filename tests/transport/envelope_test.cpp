// SPDX-License-Identifier: Apache-2.0

// What readers are told of a message beside it: its sequence, its publisher, the time of its push.
// No kill scenario is needed for the time: the word means something only for a message that is
// published, and another number in it is only another number.

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/selection.hpp"
#include "lot/lot.hpp"

#include "segment/segment.hpp"
#include "support/both_engines.hpp"
#include "support/in_blocks.hpp"
#include "support/processes.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
using lot::Envelope;
using lot::QueueEngine;
using lot::Status;
using Clock = std::chrono::steady_clock;

/// The name of this process.
const std::string kHere = program_invocation_short_name;

struct Ball {
  std::uint64_t number;
};
struct Frame {
  std::uint64_t number;
  lot::ShmVector<unsigned char> data;
};

lot::PusherOptions pushing(QueueEngine engine, bool stamp, std::uint32_t depth = 64) {
  lot::PusherOptions options;
  options.engine = engine;
  options.stamp = stamp;
  options.depth = depth;
  return options;
}

lot::EngineOptions named(lot::EngineOptions options, const std::string& name) {
  options.name = name;
  return options;
}

template <class T>
void push(lot::ShmPusher<T>& pusher, std::uint64_t number) {
  auto message = pusher.loan();
  message->number = number;
  must(pusher.push(std::move(message)) == Status::Ok, "pushed");
}

/// The index of the participant of that name; 0 if there is none.
std::uint32_t index_of(lot::segment::Segment& s, std::string_view name) {
  for (std::uint32_t k = 1; k < s.capacity().participants; ++k) {
    const auto& entry = s.participants()[k];
    if (entry.state.load() != 0 && name == entry.name) return k;
  }
  return 0;
}

/// The only ring of a publisher that is there.
lot::segment::RingHead& only_ring(lot::segment::Segment& s) {
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    const auto state = lot::ring::writer_state(s.channels()[c].writer.load());
    if (state == lot::ring::State::Live) return lot::segment::Segment::head_of(s.ring(c));
  }
  throw std::runtime_error("there is no ring");
}

/// Another process, with a name and a publisher of its own, that pushes so many balls and is then
/// killed. Its index is free when the constructor returns.
struct Dead {
  Dead(lot::segment::Segment& s, const lot::EngineOptions& options, QueueEngine engine,
       const std::string& name, std::uint64_t balls)
      : index(0) {
    Steps done;
    Child child([&] {
      lot::ShmEngine there(named(options, name));
      auto out = there.advertise<Ball>("/t", pushing(engine, true));
      for (std::uint64_t n = 0; n < balls; ++n) push(out, n);
      done.tell();
      pause();
    });
    REQUIRE(done.next() == '.');
    index = index_of(s, name);
    child.kill9();
    REQUIRE(eventually([&] { return s.participants()[index].state.load() == 0; }));
  }
  std::uint32_t index;
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE_FIXTURE(BothEngines, "an envelope names the publisher's process, and the publisher") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine here(options);
    auto in = here.subscribe<Ball>("/t");
    CHECK(in.envelope().publisher.empty());  // there is no message yet
    CHECK(in.envelope().publisher_id == 0);
    auto first = here.advertise<Ball>("/t", pushing(engine, false));
    auto second = here.advertise<Ball>("/t", pushing(engine, false));
    push(first, 1);
    REQUIRE(in.try_pull() != nullptr);
    const Envelope of_first = in.envelope();
    push(second, 2);
    REQUIRE(in.try_pull() != nullptr);
    const Envelope of_second = in.envelope();
    Child rear([&] {
      lot::ShmEngine there(named(options, "rear"));
      auto out = there.advertise<Ball>("/t", pushing(engine, false));
      push(out, 3);
    });
    const auto ball = in.pull(20s);
    REQUIRE(ball != nullptr);
    const Envelope of_rear = in.envelope();
    CHECK(rear.wait() == 0);

    CHECK(of_first.publisher == kHere);
    CHECK(of_second.publisher == kHere);
    CHECK(of_rear.publisher == "rear");
    CHECK(of_first.publisher_id != 0);
    CHECK(of_first.publisher_id != of_second.publisher_id);
    CHECK(of_rear.publisher_id != of_first.publisher_id);
    CHECK(of_rear.publisher_id != of_second.publisher_id);
    for (const Envelope& e : {of_first, of_second, of_rear}) CHECK(e.sequence == 0);
    // Empty looks change nothing, and neither does the end of the ring that it came from.
    CHECK(in.pull(10ms) == nullptr);
    CHECK(eventually([&] { return in.try_pull() == nullptr && in.publishers() == 2; }));
    CHECK(in.try_pull() == nullptr);
    CHECK(in.envelope().publisher == "rear");
    CHECK(in.envelope().publisher_id == of_rear.publisher_id);
    CHECK(in.envelope().sequence == 0);
    push(first, 4);
    REQUIRE(in.try_pull() != nullptr);
    CHECK(in.envelope().publisher_id == of_first.publisher_id);
    CHECK(in.envelope().sequence == 1);
  });
}

TEST_CASE_FIXTURE(BothEngines, "an envelope stays when its own ring ends, or another one") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/t");
    std::vector<std::optional<lot::ShmPusher<Ball>>> out(3);
    std::vector<std::uint64_t> ids;
    lot::ShmSharedPtr<const Ball> ball;
    for (std::uint64_t n = 0; n < 3; ++n) {
      out[n].emplace(shm.advertise<Ball>("/t", pushing(engine, true)));
      for (std::uint64_t m = 0; m <= n; ++m) {
        push(*out[n], m);
        ball = in.try_pull();
        REQUIRE(ball != nullptr);
      }
      ids.push_back(in.envelope().publisher_id);
    }
    // Its last message is from the third one.
    const Envelope last = in.envelope();
    CHECK(last.sequence == 2);
    REQUIRE(last.pushed.has_value());
    for (const std::size_t gone : {0U, 2U, 1U}) {
      out[gone].reset();
      CHECK(in.try_pull() == nullptr);
      CHECK(in.envelope().publisher == last.publisher);
      CHECK(in.envelope().publisher_id == ids[2]);
      CHECK(in.envelope().sequence == 2);
      CHECK(in.envelope().pushed == last.pushed);
    }
    CHECK(in.publishers() == 0);
    // Another publisher's ring comes to the same place.
    auto next = shm.advertise<Ball>("/t", pushing(engine, true));
    push(next, 7);
    CHECK(in.envelope().publisher_id == ids[2]);
    REQUIRE(in.try_borrow());  // and ends
    CHECK(std::count(ids.begin(), ids.end(), in.envelope().publisher_id) == 0);
    CHECK(in.envelope().sequence == 0);
    CHECK(!in.envelope().pushed.has_value());
  });
}

TEST_CASE_FIXTURE(BothEngines, "an envelope stays when a ring ends that the reader found later") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/t");
    std::vector<std::optional<lot::ShmPusher<Ball>>> out(3);
    for (auto& one : out) {
      one.emplace(shm.advertise<Ball>("/t", pushing(engine, true)));
      CHECK(in.try_pull() == nullptr);  // the reader finds the ring
    }
    out[0].reset();
    CHECK(in.try_pull() == nullptr);
    CHECK(in.envelope().publisher.empty());  // there is no message yet
    CHECK(in.envelope().publisher_id == 0);

    push(*out[1], 1);
    REQUIRE(in.try_pull() != nullptr);
    const Envelope last = in.envelope();
    CHECK(last.publisher == kHere);
    out[2].reset();
    CHECK(in.try_pull() == nullptr);
    CHECK(in.envelope().publisher_id == last.publisher_id);
    CHECK(in.envelope().sequence == last.sequence);
    push(*out[1], 2);
    REQUIRE(in.try_pull() != nullptr);
    CHECK(in.envelope().publisher_id == last.publisher_id);
    CHECK(in.envelope().sequence == 1);
  });
}

TEST_CASE_FIXTURE(BothEngines, "a message that a reader keeps does not lend its time to another") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto in = shm.subscribe<Ball>("/t");
    std::vector<std::optional<lot::ShmPusher<Ball>>> out(3);
    for (auto& one : out) {
      one.emplace(shm.advertise<Ball>("/t", pushing(engine, true)));
      CHECK(in.try_pull() == nullptr);  // the reader finds the ring
    }
    push(*out[1], 1);
    const auto kept = in.try_pull();
    REQUIRE(kept != nullptr);
    CHECK(in.envelope().pushed.has_value());
    push(*out[0], 2);
    REQUIRE(in.try_borrow());  // and ends
    CHECK(!in.envelope().pushed.has_value());
    // The ring of the third publisher takes the place of that of the second one.
    out[1].reset();
    CHECK(in.try_pull() == nullptr);
    push(*out[2], 3);
    REQUIRE(in.try_borrow());  // and ends
    CHECK(in.envelope().sequence == 0);
    CHECK(!in.envelope().pushed.has_value());
  });
}

TEST_CASE_FIXTURE(BothEngines, "sequences of envelopes go on, and their gaps are missed()") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto out = shm.advertise<Ball>("/t", pushing(engine, false, 4));
    auto in = shm.subscribe<Ball>("/t");
    std::uint64_t next = 0;
    std::uint64_t pushed = 0;
    for (const unsigned burst : {1U, 3U, 4U, 5U, 10U, 1U}) {
      for (unsigned n = 0; n < burst; ++n) push(out, pushed++);
      for (auto ball = in.try_borrow(); ball; ball.end(), ball = in.try_borrow()) {
        const Envelope envelope = ball.envelope();
        CHECK(envelope.sequence == ball->number);
        CHECK(envelope.missed == ball.missed());
        CHECK(envelope.sequence == next + envelope.missed);
        next = envelope.sequence + 1;
      }
      CHECK(next == pushed);
    }
    CHECK(in.missed_total() == 7);
    lot::PullerOptions past;
    past.history = 2;
    auto late = shm.subscribe<Ball>("/t", past);
    REQUIRE(late.try_pull() != nullptr);
    CHECK(late.envelope().sequence == pushed - 2);
    CHECK(late.envelope().missed == 0);
  });
}

TEST_CASE_FIXTURE(BothEngines, "an envelope names the right process when that is long dead") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine here(options);
    lot::segment::Segment s(here.path());
    auto in = here.subscribe<Ball>("/t");
    // The reader has not looked at this ring before its publisher died.
    const Dead camera(s, options, engine, "camera", 2);
    Steps ready;
    Steps stop;
    Child lidar([&] {
      lot::ShmEngine there(named(options, "lidar"));
      auto out = there.advertise<Ball>("/u", pushing(engine, false));
      ready.tell();
      (void)stop.next();
    });
    REQUIRE(ready.next() == '.');
    REQUIRE(index_of(s, "lidar") == camera.index);
    for (std::uint64_t n = 0; n < 2; ++n) {
      const auto ball = in.pull(20s);
      REQUIRE(ball != nullptr);
      CHECK(in.envelope().publisher == "camera");
      CHECK(in.envelope().sequence == n);
      CHECK(in.envelope().pushed.has_value());
    }
    CHECK(in.try_pull() == nullptr);  // it leaves the ring
    CHECK(in.envelope().publisher == "camera");
    stop.tell();
    CHECK(lidar.wait() == 0);
  });
}

TEST_CASE_FIXTURE(BothEngines, "PusherOptions::stamp tells the time of each push") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto stamping = shm.advertise<Frame>("/on", pushing(engine, true));
    auto silent = shm.advertise<Frame>("/off", pushing(engine, false));
    auto on = shm.subscribe<Frame>("/on");
    auto off = shm.subscribe<Frame>("/off");
    for (std::uint64_t n = 0; n < 3; ++n) {
      const auto before = Clock::now();
      push(stamping, n);
      push(silent, n);
      const auto after = Clock::now();
      const auto frame = on.try_pull();
      REQUIRE(frame != nullptr);
      REQUIRE(on.envelope().pushed.has_value());
      CHECK(*on.envelope().pushed >= before);
      CHECK(*on.envelope().pushed <= after);
      const auto borrow = off.try_borrow();
      REQUIRE(borrow);
      CHECK(!borrow.envelope().pushed.has_value());
      CHECK(!off.envelope().pushed.has_value());
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "LOT_STAMP in the environment comes before PusherOptions::stamp") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    const auto is_stamped = [&](bool asked) {
      auto in = shm.subscribe<Ball>("/t");
      auto out = shm.advertise<Ball>("/t", pushing(engine, asked));
      push(out, 1);
      const auto ball = in.try_pull();
      must(ball != nullptr, "a ball");
      return in.envelope().pushed.has_value();
    };
    {
      const Variable on("LOT_STAMP", "1");
      CHECK(is_stamped(false));
    }
    {
      const Variable off("LOT_STAMP", "0");
      CHECK(!is_stamped(true));
    }
    {
      const Variable bad("LOT_STAMP", "yes");
      CHECK_THROWS_WITH_AS((void)shm.advertise<Ball>("/t"), doctest::Contains("LOT_STAMP=yes"),
                           lot::Error);
    }
    CHECK(is_stamped(true));
    CHECK(!is_stamped(false));
  });
}

TEST_CASE_FIXTURE(BothEngines, "a message that is pushed again has the time of its last push") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto first = shm.advertise<Ball>("/first", in_blocks(pushing(engine, true)));
    auto again = shm.advertise<Ball>("/again", in_blocks(pushing(engine, true)));
    auto silent = shm.advertise<Ball>("/silent", in_blocks(pushing(engine, false)));
    auto in_first = shm.subscribe<Ball>("/first");
    auto in_again = shm.subscribe<Ball>("/again");
    auto in_silent = shm.subscribe<Ball>("/silent");
    push(first, 7);
    const auto ball = in_first.try_pull();
    REQUIRE(ball != nullptr);
    const auto then = in_first.envelope().pushed;
    REQUIRE(then.has_value());

    const auto before = Clock::now();
    REQUIRE(again.push(ball) == Status::Ok);
    const auto after = Clock::now();
    REQUIRE(silent.push(ball) == Status::Ok);
    const auto twice = in_again.try_borrow();
    REQUIRE(twice);
    CHECK(twice.get() == ball.get());
    CHECK(*twice.envelope().pushed >= before);
    CHECK(*twice.envelope().pushed <= after);
    CHECK(in_first.envelope().pushed == twice.envelope().pushed);
    CHECK(*then <= before);
    // A publisher that does not stamp neither tells a time nor changes one.
    const auto thrice = in_silent.try_borrow();
    REQUIRE(thrice);
    CHECK(thrice.get() == ball.get());
    CHECK(!thrice.envelope().pushed.has_value());
  });
}

TEST_CASE_FIXTURE(BothEngines, "a stamped block that is loaned anew, unstamped, tells no time") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto silent = shm.advertise<Ball>("/silent", in_blocks(pushing(engine, false, 1)));
    auto stamping = shm.advertise<Ball>("/stamping", in_blocks(pushing(engine, true, 1)));
    auto in = shm.subscribe<Ball>("/silent");
    auto stamped = shm.subscribe<Ball>("/stamping");
    auto ball = silent.loan();
    const Ball* const place = ball.get();
    REQUIRE(stamping.push(std::move(ball)) == Status::Ok);
    REQUIRE(stamped.try_borrow().envelope().pushed.has_value());
    for (int n = 0; n < 200; ++n) push(stamping, 2);  // the ring lets the first one go
    bool is_there = false;
    for (int n = 0; n < 1000 && !is_there; ++n) {
      push(silent, 3);
      const auto borrow = in.try_borrow();
      REQUIRE(borrow);
      CHECK(!borrow.envelope().pushed.has_value());
      is_there = borrow.get() == place;
    }
    CHECK(is_there);
  });
}

TEST_CASE_FIXTURE(BothEngines, "ShmPuller: a message that has gone has an envelope, but no time") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    auto out = shm.advertise<Ball>("/t", in_blocks(pushing(engine, true, 1)));
    auto in = shm.subscribe<Ball>("/t");
    push(out, 0);
    auto ball = in.try_pull();
    REQUIRE(ball != nullptr);
    const Ball* const place = ball.get();
    const auto pushed = in.envelope().pushed;
    REQUIRE(pushed.has_value());
    push(out, 1);  // the queue has another message
    CHECK(in.envelope().pushed == pushed);
    ball.reset();
    bool is_used_again = false;  // the block, by a message that has a time as well
    for (std::uint64_t n = 2; n < 1000 && !is_used_again; ++n) {
      auto next = out.loan();
      next->number = n;
      is_used_again = next.get() == place;
      REQUIRE(out.push(std::move(next)) == Status::Ok);
    }
    REQUIRE(is_used_again);
    CHECK(!in.envelope().pushed.has_value());
    CHECK(in.envelope().sequence == 0);

    auto borrow = in.try_borrow();
    REQUIRE(borrow);
    CHECK(borrow.envelope().pushed.has_value());
    CHECK(in.envelope().pushed == borrow.envelope().pushed);
    const auto kept = borrow.keep();
    const std::uint64_t sequence = borrow.envelope().sequence;
    borrow.end();
    CHECK(borrow.envelope().publisher.empty());
    CHECK(borrow.envelope().publisher_id == 0);
    CHECK(in.envelope().pushed.has_value());  // it was kept
    push(out, 7);
    REQUIRE(in.try_borrow());  // and ends
    CHECK(in.envelope().sequence == sequence + 1);
    CHECK(!in.envelope().pushed.has_value());
  });
}

TEST_CASE_FIXTURE(BothEngines, "an envelope bears anything that another process may have written") {
  with_each_engine([&](QueueEngine engine) {
    lot::ShmEngine shm(options);
    lot::segment::Segment s(shm.path());
    auto out = shm.advertise<Ball>("/t", in_blocks(pushing(engine, true)));
    std::memset(only_ring(s).publisher, 'x', sizeof(only_ring(s).publisher));  // it has no end
    auto in = shm.subscribe<Ball>("/t");
    push(out, 1);
    const auto ball = in.try_pull();
    REQUIRE(ball != nullptr);
    CHECK(in.envelope().publisher == std::string(48, 'x'));

    auto& word = *[&]() -> std::uint64_t* {
      for (std::uint32_t b = 0; b < s.capacity().blocks; ++b) {
        if (s.arena(b).pushed_ns != 0) return &s.arena(b).pushed_ns;
      }
      throw std::runtime_error("no block is stamped");
    }();
    const auto year = Clock::now() + std::chrono::hours(24 * 365);
    word = static_cast<std::uint64_t>(year.time_since_epoch().count());
    CHECK(in.envelope().pushed == year);
    word = static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max());
    CHECK(in.envelope().pushed == Clock::time_point::max());
    for (const std::uint64_t none : {std::uint64_t{0}, std::uint64_t{1} << 63, ~std::uint64_t{0}}) {
      word = none;
      CHECK(!in.envelope().pushed.has_value());
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "ShmListener: a callback may take the envelope of its message") {
  with_each_engine([&](QueueEngine engine) {
    constexpr std::uint64_t kBalls = 100;
    lot::ShmEngine shm(options);
    std::vector<Envelope> envelopes;
    std::atomic<std::uint64_t> heard{0};
    const auto listener = shm.listen<Ball>(
        "/t", [&](const lot::ShmSharedPtr<const Ball>& ball, const Envelope& envelope) {
          must(ball->number == envelope.sequence, "the envelope of this ball");
          envelopes.push_back(envelope);
          heard.fetch_add(1, std::memory_order_release);
        });
    auto out = shm.advertise<Ball>("/t", pushing(engine, true, 2 * kBalls));
    for (std::uint64_t n = 0; n < kBalls; ++n) push(out, n);
    REQUIRE(eventually([&] { return heard.load(std::memory_order_acquire) == kBalls; }));
    for (const Envelope& envelope : envelopes) {
      CHECK(envelope.publisher == kHere);
      CHECK(envelope.pushed.has_value());
    }
  });
}

TEST_CASE_FIXTURE(BothEngines, "readers that a publisher selects are told the same of a message") {
  with_each_engine([&](QueueEngine engine) {
    const auto participant = lot::detail::join(options);
    const auto& type = lot::detail::message_type<Ball>();
    const auto pusher =
        lot::detail::make_selecting_pusher(participant, "/t", type, pushing(engine, true));
    const auto puller = lot::detail::make_selecting_puller(participant, "/t", type, {});
    lot::ShmPusher<Ball> out(
        lot::detail::make_pusher(participant, "/t", type, pushing(engine, false),
                                 lot::detail::Delivery::ToAll),
        0s);
    auto ball = out.loan();
    REQUIRE(pusher->core().push_unique(lot::detail::whole(ball), {0ns}) == Status::Ok);
    lot::detail::PointerAccess::take(ball);
    lot::detail::Borrowed borrowed;
    REQUIRE(puller->core().borrow(borrowed, lot::detail::Limit::now()) == Status::Ok);
    const Envelope envelope = puller->core().envelope();
    CHECK(envelope.publisher == kHere);
    CHECK(envelope.publisher == puller->publisher(puller->origin()));
    CHECK(envelope.sequence == 0);
    CHECK(envelope.pushed.has_value());
    puller->core().done();
  });
}

TEST_CASE_FIXTURE(BothEngines, "a forked child is refused the envelopes of its parent") {
  lot::ShmEngine shm(options);
  auto out = shm.advertise<Ball>("/t");
  auto in = shm.subscribe<Ball>("/t");
  push(out, 1);
  const auto borrow = in.try_borrow();
  REQUIRE(borrow);
  Child child([&] {
    try {
      (void)borrow.envelope();
    } catch (const lot::Error& e) {
      must(e.error_number() == ECHILD, "it says why");
      return;
    }
    must(false, "refused");
  });
  CHECK(child.wait() == 0);
}

TEST_SUITE_END();
