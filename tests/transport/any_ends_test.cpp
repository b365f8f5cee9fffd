// SPDX-License-Identifier: Apache-2.0

// Publishers, subscribers and queues that do not have their type: AnyPuller, AnyPusher, AnyQueue.

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "segment/segment.hpp"
#include "support/error_of.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "support/secret.hpp"
#include "transport/ring_ends.hpp"

namespace {

using namespace lot::testing;
using lot::AnyMessage;
using lot::AnyType;
using lot::Status;

struct Point {
  float x = 1.0F, y = 0.0F;
};
struct Frame {
  std::uint32_t width = 0, height = 0;
  lot::ShmString encoding;
  lot::ShmVector<Point> points;
  lot::ShmRef<const Point> home;
};
struct Sum {
  std::uint64_t value = 0;
};
struct Other {
  std::uint32_t parts[2];
};
/// A name that begins as those of queues' items do.
struct Statistics {
  std::uint64_t items = 0;
};

}  // namespace
template <>
struct lot::TypeIdentity<Statistics> {
  static const char* name() { return "ShmQueueStatistics"; }
  static constexpr std::uint64_t hash() { return 0; }
};
namespace {

[[maybe_unused]] const std::string& prefix_taken = prefix();

lot::PullerOptions observing() {
  lot::PullerOptions options;
  options.observer = true;
  return options;
}

void put(lot::ShmPusher<Frame>& pusher, std::uint32_t width) {
  auto frame = pusher.loan();
  frame->width = width;
  frame->encoding = "mono8, in more bytes than a string has in itself";
  frame->points.resize(3);
  frame->points[2].y = 2.5F;
  must_go(pusher.push(std::move(frame)));
}

}  // namespace

TEST_SUITE_BEGIN("any_ends");

TEST_CASE("a subscriber without the type reads what a publisher with it sends") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto options = lot::PusherOptions();
  options.stamp = true;
  options.depth = 4;
  auto pusher = engine.advertise<Frame>("/frames", options);
  auto puller = engine.subscribe_any("/frames");
  CHECK(puller.publishers() == 1);
  CHECK(pusher.readers() == 1);
  CHECK(puller.type().name() == AnyType::of<Frame>().name());
  CHECK(puller.type().is_same(AnyType::of<Frame>()));
  CHECK(puller.type().size() == sizeof(Frame));

  CHECK(!puller.try_pull());
  CHECK(puller.status() == Status::Empty);
  CHECK(!puller.borrow(1ms));
  CHECK(puller.status() == Status::Timeout);

  put(pusher, 640);
  const AnyMessage message = puller.pull(10s);
  REQUIRE(message);
  CHECK(message.root()["width"].as<int>() == 640);
  CHECK(message.root()["encoding"].as<std::string_view>().starts_with("mono8, in more"));
  CHECK(message.root().at("points[2].y").as<float>() == 2.5F);
  CHECK(message.root()["home"].is_null());
  const lot::Envelope envelope = puller.envelope();
  CHECK(envelope.pushed.has_value());
  const auto typed = message.as<Frame>();
  REQUIRE(typed);
  CHECK(typed->width == 640);
  CHECK(message.as<Point>() == nullptr);

  put(pusher, 641);
  {
    auto borrow = puller.borrow(10s);
    REQUIRE(borrow);
    CHECK(borrow.root()["width"].as<int>() == 641);
    CHECK(borrow.envelope().sequence == envelope.sequence + 1);
    const AnyMessage kept = borrow.keep();
    borrow.end();
    CHECK(!borrow);
    CHECK(!borrow.keep());
    CHECK(kept.root()["width"].as<int>() == 641);
  }
  for (std::uint32_t n = 0; n < 10; ++n) put(pusher, n);
  CHECK(puller.size() == 4);
  const AnyMessage late = puller.try_pull();
  REQUIRE(late);
  CHECK(puller.missed() == 6);
  CHECK(puller.missed_total() == 6);
  CHECK(late.root()["width"].as<int>() == 6);
}

TEST_CASE("a publisher without the type builds what a subscriber with it reads") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto puller = engine.subscribe<Frame>("/frames");
  std::optional pusher(engine.advertise_any("/frames", engine.type_of("/frames")));
  REQUIRE(pusher->wait_for_readers(1, 10s));
  CHECK(pusher->readers() == 1);
  pusher->reserve(2, 4096);
  for (std::uint32_t n = 0; n < 200; ++n) {  // blocks are used again, with what was there
    auto loan = pusher->loan();
    REQUIRE(loan);
    CHECK(loan.root().value()["points"].size() == 0);
    loan.root()["width"].set(n);
    loan.root()["encoding"].set("rgb8, also longer than what a string has in itself");
    loan.root()["points"].resize(5);
    loan.root().at("points[4].x").set(0.5);
    must_go(pusher->push(std::move(loan)));
    CHECK(!loan);
    const auto frame = puller.pull(10s);
    REQUIRE(frame);
    CHECK(frame->width == n);
    CHECK(frame->height == 0);
    CHECK(frame->encoding == "rgb8, also longer than what a string has in itself");
    REQUIRE(frame->points.size() == 5);
    CHECK(frame->points[4].x == 0.5F);
    CHECK(frame->points[0].x == 0.0F);
    CHECK(!frame->home);
  }
  // A message outlives its publisher.
  auto loan = pusher->loan();
  loan.root()["width"].set(7);
  must_go(pusher->push(std::move(loan)));
  const auto last = puller.pull(10s);
  { const auto unused = pusher->loan(); }
  pusher.reset();
  REQUIRE(last);
  CHECK(last->width == 7);
}

TEST_CASE("a message of another topic goes on without a copy") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto source = engine.advertise<Frame>("/in");
  auto in = engine.subscribe_any("/in");
  auto out = engine.advertise_any("/out", in.type());
  auto sink = engine.subscribe<Frame>("/out");
  put(source, 5);
  const AnyMessage message = in.pull(10s);
  REQUIRE(message);
  must_go(out.push(message));
  const auto there = sink.pull(10s);
  REQUIRE(there);
  CHECK(static_cast<const void*>(there.get()) == message.pointer().get());
  CHECK(there->width == 5);
  // What this process has made goes as well, by the type that it has.
  auto made = engine.make<Frame>();
  made->width = 6;
  const AnyMessage mine = lot::ShmSharedPtr<const Frame>(std::move(made));
  must_go(out.push(mine));
  CHECK(sink.pull(10s)->width == 6);

  CHECK(error_of([&] { (void)out.push(AnyMessage()); }).first == EINVAL);
  CHECK(error_of([&] { (void)out.push(lot::AnyLoan()); }).first == EINVAL);
  const AnyMessage other = lot::ShmSharedPtr<const Sum>(engine.make<Sum>());
  CHECK(error_of([&] { (void)out.push(other); }).first == EINVAL);
  auto sums = engine.advertise_any("/sums", AnyType::of<Sum>());
  auto sum = sums.loan();
  CHECK(error_of([&] { (void)out.push(std::move(sum)); }).first == EINVAL);
  CHECK(sum);
}

TEST_CASE("a child of fork() asks for no type, and gets no end without one") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto frames = engine.advertise<Frame>("/frames");
  const AnyType type = engine.type_of("/frames");
  Child child([&] {
    const auto is_refused = [](const auto& call) { return error_of(call).first == ECHILD; };
    must(is_refused([&] { (void)engine.type_of("/frames"); }), "type_of");
    must(is_refused([&] { (void)engine.subscribe_any("/frames"); }), "subscribe_any");
    must(is_refused([&] { (void)engine.advertise_any("/frames", type); }), "advertise_any");
    must(is_refused([&] { (void)engine.listen_any("/frames", [](const auto&) {}); }), "listen_any");
  });
  CHECK(child.wait() == 0);
}

TEST_CASE("what cannot be subscribed to or advertised is an error, and says why") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  CHECK(!engine.type_of("/nothing"));
  CHECK(error_of([&] { (void)engine.subscribe_any("/nothing"); }).first == ENOENT);
  CHECK(error_of([&] { (void)engine.advertise_any("/nothing", AnyType()); }).first == EINVAL);

  auto queue = engine.queue<Sum>("/tasks");
  CHECK(engine.type_of("/tasks"));
  CHECK(error_of([&] { (void)engine.subscribe_any("/tasks"); }).first == EINVAL);
  CHECK(error_of([&] { (void)engine.advertise_any("/jobs", engine.type_of("/tasks")); }).first ==
        EINVAL);

  auto statistics = engine.advertise<Statistics>("/statistics");
  CHECK(engine.subscribe_any("/statistics").type().name() == "ShmQueueStatistics");

  auto frames = engine.advertise<Frame>("/frames");
  CHECK(error_of([&] { (void)engine.advertise_any("/frames", AnyType::of<Sum>()); }).first ==
        EPROTOTYPE);

  auto secrets = engine.advertise<Secret>("/secrets");
  auto secret = engine.subscribe_any("/secrets");
  CHECK(secret.type().description().root().kind == lot::Kind::Opaque);
  auto more = engine.advertise_any("/secrets", secret.type());
  CHECK(error_of([&] { (void)more.loan(); }).first == EINVAL);
  must_go(secrets.push(secrets.loan()));
  const AnyMessage found = secret.pull(10s);
  REQUIRE(found);
  CHECK(found.root().bytes().size() == sizeof(Secret));
  CHECK(found.as<Secret>()->get() == 17);
  must_go(more.push(found));
}

TEST_CASE("a damaged description stops what wants it, and nothing else") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto pusher = engine.advertise<Frame>("/frames");
  lot::segment::Segment segment(engine.path());
  auto& entry = segment.topics()[0];
  REQUIRE(std::string_view(entry.name) == "/frames");
  const std::uint64_t word = entry.description.load();
  lot::test::raw(entry.description) = word ^ 1;  // its check
  auto puller = engine.subscribe_any("/frames");
  put(pusher, 3);
  const AnyMessage message = puller.pull(10s);
  REQUIRE(message);
  CHECK(error_of([&] { (void)puller.type().description(); }).first == EBADMSG);
  CHECK(error_of([&] { (void)message.root(); }).first == EBADMSG);
  CHECK(message.as<Frame>()->width == 3);
  auto another = engine.advertise_any("/frames", puller.type());
  CHECK(error_of([&] { (void)another.loan(); }).first == EBADMSG);
  must_go(another.push(message));
  lot::test::raw(entry.description) = word;
  CHECK(engine.subscribe_any("/frames").type().description().root().fields.size() == 5);

  for (const std::uint64_t align : {std::uint64_t{0}, std::uint64_t{24}, std::uint64_t{1} << 40}) {
    entry.type_align = align;
    CHECK(error_of([&] { (void)engine.type_of("/frames"); }).first == EBADMSG);
  }
  entry.type_align = alignof(Frame);
  entry.type_size += 8;  // the description is that of another type, then
  CHECK(error_of([&] { (void)engine.type_of("/frames").description(); }).first == EBADMSG);
  entry.type_size -= 8;
}

TEST_CASE("an observer learns that the topic's type has changed, and subscribes again") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  std::optional pusher(engine.advertise<Frame>("/frames"));
  auto observer = engine.subscribe_any("/frames", observing());
  CHECK(pusher->readers() == 0);
  put(*pusher, 1);
  REQUIRE(observer.pull(10s));
  pusher.reset();
  auto sums = engine.advertise<Sum>("/frames");
  CHECK(eventually([&] { return error_of([&] { (void)observer.try_pull(); }).first == ESTALE; }));
  observer = engine.subscribe_any("/frames", observing());
  CHECK(observer.type().is_same(AnyType::of<Sum>()));
  must_go(sums.push(sums.loan(Sum{9})));
  const AnyMessage sum = observer.pull(10s);
  REQUIRE(sum);
  CHECK(sum.root()["value"].as<int>() == 9);
}

TEST_CASE("a subscriber finds a type however often the topic changes it meanwhile") {
  const Watchdog watchdog(120);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  std::atomic<bool> is_done{false};
  std::thread changes([&] {
    while (!is_done) {
      { auto pusher = engine.advertise<Sum>("/topic"); }
      { auto pusher = engine.advertise<Other>("/topic"); }
    }
  });
  unsigned sums = 0, others = 0;
  while (sums < 20 || others < 20) {
    try {
      auto puller = engine.subscribe_any("/topic", observing());
      const bool is_sum = puller.type().is_same(AnyType::of<Sum>());
      CHECK((is_sum || puller.type().is_same(AnyType::of<Other>())));
      ++(is_sum ? sums : others);
    } catch (const lot::Error& e) {
      CHECK(e.error_number() == ENOENT);
    }
  }
  is_done = true;
  changes.join();
}

TEST_CASE("wait sets, descriptors and listeners take what has no type") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto pusher = engine.advertise<Frame>("/frames");
  auto puller = engine.subscribe_any("/frames");
  CHECK(puller.fd() >= 0);
  std::atomic<std::uint32_t> heard{0};
  std::atomic<std::uint64_t> sequence{0};
  const auto plain = engine.listen_any("/frames", [&](const AnyMessage& message) {
    heard += message.root()["width"].as<unsigned>();
  });
  const auto told =
      engine.listen_any("/frames", [&](const AnyMessage& message, const lot::Envelope& envelope) {
        if (message) sequence = envelope.sequence + 1;
      });
  lot::WaitSet set;
  unsigned seen = 0;
  set.add(puller, [&] {
    while (const auto message = puller.try_pull()) seen += message.root()["width"].as<unsigned>();
  });
  put(pusher, 30);
  put(pusher, 12);
  CHECK(eventually([&] {
    (void)set.run_once(10ms);
    return seen == 42;
  }));
  set.remove(puller);
  auto queue = engine.queue_any("/sums", AnyType::of<Sum>());
  unsigned popped = 0;
  set.add(queue, [&] { popped += queue.try_pop() ? 1 : 0; });
  must_go(queue.try_put(queue.loan()));
  CHECK(eventually([&] {
    (void)set.run_once(10ms);
    return popped == 1;
  }));
  set.remove(queue);
  CHECK(eventually([&] { return heard == 42 && sequence == 2; }));
}

TEST_CASE("a queue without the type and one with it share their items") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto sums = engine.queue_any("/sums", AnyType::of<Sum>());
  auto values = engine.queue<Sum>("/sums");
  auto item = sums.loan();
  item.root()["value"].set(7);
  must_go(sums.put_until(std::move(item), lot::Deadline(std::chrono::steady_clock::now() + 10s)));
  CHECK(!item);
  CHECK(values.wait_and_pop().value == 7);
  values.listen();
  must_go(values.put(Sum{8}));  // in its slot
  const AnyMessage popped =
      sums.wait_and_pop_until(lot::Deadline(std::chrono::steady_clock::now() + 10s));
  REQUIRE(popped);
  CHECK(popped.as<Sum>()->value == 8);
  CHECK(!sums.try_pop());

  auto frames = engine.queue_any("/frames", AnyType::of<Frame>());
  auto pointers = engine.queue<lot::ShmUniquePtr<Frame>>("/frames");
  auto frame = pointers.make();
  frame->width = 9;
  frame->encoding = "longer than what a string has in its own bytes";
  must_go(pointers.put(std::move(frame)));
  const AnyMessage seen = frames.try_pop();
  REQUIRE(seen);
  CHECK(seen.root()["encoding"].as<std::string_view>().size() == 46);
  CHECK(frames.size() == 0);
  CHECK(frames.fd() >= 0);
  CHECK(frames.capacity() == 64);
}

TEST_CASE("what a queue without the type does not take stays with the caller") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  lot::QueueOptions options;
  options.depth = 1;
  auto sums = engine.queue_any("/sums", AnyType::of<Sum>(), options);
  must_go(sums.try_put(sums.loan()));
  auto more = sums.loan();
  CHECK(sums.try_put(std::move(more)) == Status::Full);
  CHECK(more);
  auto other = engine.make_any(AnyType::of<Frame>());
  CHECK(error_of([&] { (void)sums.try_put(std::move(other)); }).first == EINVAL);
  CHECK(other);
  CHECK(error_of([&] { (void)sums.loan_zeroed(); }).first == EINVAL);
  CHECK(error_of([&] { (void)sums.try_take(); }).first == EINVAL);
  CHECK(error_of([&] { (void)engine.queue_any("/none", AnyType()); }).first == EINVAL);
  CHECK(error_of([&] { (void)engine.queue_any("/none", engine.type_of("/sums")); }).first ==
        EINVAL);
  CHECK(error_of([&] { (void)engine.queue_any("/sums", AnyType::of<Frame>()); }).first ==
        EPROTOTYPE);
}

TEST_CASE("a task without the type is finished, given back, and kept longer than it lasts") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  lot::QueueOptions options;
  options.redeliver = true;
  auto tasks = engine.queue_any("/tasks", AnyType::of<Sum>(), options);
  auto workers = engine.queue<Sum>("/tasks", options);
  must_go(workers.put(Sum{7}));
  AnyMessage kept;
  {
    const auto task = tasks.try_take();
    REQUIRE(task);
    CHECK(task.root()["value"].as<unsigned>() == 7);
    CHECK(task.deliveries() == 1);
    kept = task.keep();
  }  // it goes back
  auto again = workers.try_take();
  REQUIRE(again);
  CHECK(again->value == 7);
  CHECK(again.deliveries() == 2);
  again.give_back();
  auto last = tasks.wait_and_take_until(lot::Deadline(std::chrono::steady_clock::now() + 10s));
  CHECK(last.deliveries() == 3);
  lot::AnyTask moved;
  moved = std::move(last);
  moved.finish();
  moved.finish();
  CHECK(!moved);
  CHECK(!moved.keep());
  CHECK(!tasks.try_take());
  for (std::uint64_t n = 0; n < 200; ++n) {  // blocks are used again
    must_go(workers.put(Sum{n}));
    workers.try_take().finish();
  }
  CHECK(kept.root()["value"].as<unsigned>() == 7);
}

TEST_CASE("a message without the type refers to others, which it keeps") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto puller = engine.subscribe<Frame>("/frames");
  auto pusher = engine.advertise_any("/frames", AnyType::of<Frame>());
  auto home = engine.make_any(AnyType::of<Point>());
  home.root()["x"].set(7);
  AnyMessage shared = std::move(home).share();
  CHECK(!home);
  auto frame = pusher.loan();
  const auto reference = frame.root()["home"];
  frame.refer(reference, shared);
  CHECK(frame.root().value().at("home.x").as<int>() == 7);
  frame.refer(reference, nullptr);
  CHECK(frame.root().value()["home"].is_null());
  const AnyMessage sum = engine.make_any(AnyType::of<Sum>()).share();
  CHECK(error_of([&] { frame.refer(reference, sum); }).first == EINVAL);
  CHECK(error_of([&] { frame.refer(frame.root()["width"], shared); }).first == EINVAL);
  frame.refer(reference, shared);
  must_go(pusher.push(std::move(frame)));
  shared.reset();
  const auto seen = puller.pull(10s);
  REQUIRE(seen);
  REQUIRE(seen->home);
  CHECK(seen->home->x == 7.0F);
}

template <std::uint64_t kNames>
const lot::detail::Described& too_large_to_keep(const lot::detail::MessageType&) {
  static const lot::detail::Described described{1, kNames, true, ""};
  return described;
}

TEST_CASE("types whose descriptions are too large to keep differ by the hash of their names") {
  const lot::detail::MessageType one{8, 8, 1, "large", nullptr, true, &too_large_to_keep<1>};
  const lot::detail::MessageType same{8, 8, 1, "large", nullptr, true, &too_large_to_keep<1>};
  const lot::detail::MessageType other{8, 8, 1, "large", nullptr, true, &too_large_to_keep<2>};
  CHECK(lot::detail::is_same(one, same));
  CHECK(!lot::detail::is_same(one, other));
}

TEST_CASE("the core of a puller tells a borrowed message's memory, and joins no ring it lacks") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto pusher = engine.advertise<Frame>("/frames");
  auto puller = engine.subscribe_any("/frames");
  lot::transport::RingPuller& core = lot::detail::PullerAccess::core(puller);
  for (const std::size_t granules : {std::size_t{2}, std::size_t{3}}) {
    auto frame = pusher.loan();
    frame->points.resize(granules * lot::segment::kGranule / sizeof(Point));
    must_go(pusher.push(std::move(frame)));
    const auto borrow = puller.borrow(10s);
    REQUIRE(borrow);
    CHECK(core.memory() == granules * lot::segment::kGranule);
  }
  REQUIRE(core.sources().size() == 1);
  lot::registry::ChannelName other = core.sources().front().name;
  ++other.generation;
  CHECK(!core.join_anew(other));
  const auto typed = engine.subscribe<Frame>("/silent");
  auto silent = engine.subscribe_any("/silent");
  CHECK(!lot::detail::PullerAccess::core(silent).join_anew(other));
}
