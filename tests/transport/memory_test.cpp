// SPDX-License-Identifier: Apache-2.0

// Memory and blocks run out: whose messages go, and what a publisher that is bound by them does.

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <new>
#include <optional>
#include <random>
#include <span>
#include <string>
#include <sys/stat.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/small_disk.hpp"
#include "transport/participant.hpp"

namespace {

thread_local bool counts_news = false;
thread_local long news = 0;
thread_local long until_failure = 0;  ///< this allocation of the thread fails; 0: none

void* get(std::size_t bytes) {
  if (counts_news) ++news;
  if (until_failure > 0 && --until_failure == 0) throw std::bad_alloc();
  void* const p = std::malloc(bytes != 0 ? bytes : 1);
  if (p == nullptr) throw std::bad_alloc();
  return p;
}

}  // namespace

void* operator new(std::size_t bytes) { return get(bytes); }
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;

constexpr std::size_t kMiB = std::size_t{1} << 20;

struct Map {
  int id;
};
struct Frame {
  int number;
  lot::ShmVector<char> data;
};

struct Place {
  explicit Place(std::size_t bytes, std::uint32_t blocks = 0) : engine(options(bytes, blocks)) {}
  static lot::EngineOptions options(std::size_t bytes, std::uint32_t blocks) {
    lot::EngineOptions o = fresh(bytes);
    if (blocks != 0) o.blocks = blocks;
    return o;
  }
  lot::ShmEngine engine;
};

lot::PullerOptions latched(std::uint32_t history) {
  lot::PullerOptions options;
  options.history = history;
  return options;
}

/// Loans frames of 1 MiB until memory has run out.
std::vector<lot::ShmUniquePtr<Frame>> take_all(lot::ShmPusher<Frame>& publisher) {
  std::vector<lot::ShmUniquePtr<Frame>> taken;
  try {
    for (;;) {
      taken.push_back(publisher.loan());
      taken.back()->data.resize(kMiB);
    }
  } catch (const lot::OutOfMemory&) {
  }
  return taken;
}

void push_frames(lot::ShmPusher<Frame>& pusher, int count, std::size_t bytes) {
  for (int i = 0; i < count; ++i) {
    auto frame = pusher.loan();
    frame->number = i;
    frame->data.resize(bytes);
    REQUIRE(pusher.push(std::move(frame)) == Status::Ok);
  }
}

std::uint32_t block_of(lot::transport::Participant& p, const void* message) {
  const auto at = static_cast<const unsigned char*>(message);
  const auto begin = static_cast<const unsigned char*>(static_cast<void*>(p.segment().small(0)));
  return static_cast<std::uint32_t>(static_cast<std::size_t>(at - begin) /
                                    lot::segment::kSmallBytes);
}

TEST_SUITE_BEGIN("transport");

TEST_CASE("a latched message stays while another topic of its process runs out of memory") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  lot::PusherOptions one;
  one.depth = 1;
  auto maps = place.engine.advertise<Map>("map", one);
  must_go(maps.push(maps.loan(Map{7})));
  auto camera = place.engine.advertise<Frame>("camera");
  push_frames(camera, 100, kMiB);
  auto late = place.engine.subscribe<Map>("map", latched(1));
  const auto got = late.try_pull();
  REQUIRE(got);
  CHECK(got->id == 7);
}

TEST_CASE("under its own limit a publisher gives its own messages up, and no other one's") {
  const Watchdog watchdog(60);
  Place place(64 * kMiB);
  lot::PusherOptions limited;
  limited.depth = 8;
  limited.max_bytes = 4 * kMiB;
  auto first = place.engine.advertise<Frame>("first");
  auto second = place.engine.advertise<Frame>("second", limited);
  auto third = place.engine.advertise<Frame>("third");
  push_frames(first, 4, kMiB);
  push_frames(third, 4, kMiB);
  push_frames(second, 10, kMiB);
  CHECK(place.engine.subscribe<Frame>("first", latched(8)).size() == 4);
  CHECK(place.engine.subscribe<Frame>("third", latched(8)).size() == 4);
  const std::size_t kept = place.engine.subscribe<Frame>("second", latched(8)).size();
  CHECK(kept >= 1);
  CHECK(kept <= 4);
}

TEST_CASE("a request that can never be met throws OutOfMemory and gives no message up") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto maps = place.engine.advertise<Map>("map");
  auto camera = place.engine.advertise<Frame>("camera");
  for (int i = 0; i < 10; ++i) must_go(maps.push(maps.loan(Map{i})));
  push_frames(camera, 10, kMiB);
  auto reader = place.engine.subscribe<Frame>("camera", latched(10));
  auto frame = camera.loan();
  std::size_t before = reader.size();
  SUBCASE("more than the segment has") {
    CHECK_THROWS_AS(frame->data.resize(64 * kMiB), lot::OutOfMemory);
  }
  SUBCASE("more than what is kept leaves, in one piece") {
    // A loan lies in each run of half the segment.
    auto keeper = place.engine.advertise<Frame>("kept");
    std::vector<lot::ShmUniquePtr<Frame>> kept;
    for (int i = 0; i < 6; ++i) {
      kept.push_back(keeper.loan());
      kept.back()->data.resize(2 * kMiB);
    }
    before = reader.size();
    REQUIRE(before != 0);
    CHECK_THROWS_AS(frame->data.resize(16 * kMiB), lot::OutOfMemory);
  }
  CHECK(reader.size() == before);
  auto late = place.engine.subscribe<Map>("map", latched(10));
  CHECK(late.size() == 10);
}

/// Takes all that the file system has left.
class Filling {
 public:
  explicit Filling(const std::string& directory) : path_(directory + "/filling") {
    std::FILE* const file = std::fopen(path_.c_str(), "w");
    std::setbuf(file, nullptr);
    const std::vector<char> piece(4096);
    while (std::fwrite(piece.data(), piece.size(), 1, file) == 1) {
    }
    std::fclose(file);
  }
  ~Filling() { std::remove(path_.c_str()); }
  Filling(const Filling&) = delete;
  Filling& operator=(const Filling&) = delete;

 private:
  std::string path_;
};

TEST_CASE("where the file system is full the memory that was used before serves again") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=40m");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  lot::EngineOptions options = fresh(32 * kMiB);
  options.directory = disk.path;
  {
    lot::ShmEngine engine(options);
    auto front = engine.advertise<Frame>("front", {Policy::Overwrite, 8, {}});
    push_frames(front, 8, kMiB);
    auto rear = engine.advertise<Frame>("rear", {Policy::Overwrite, 2, {}});
    auto frame = rear.loan();
    lot::transport::Participant::at(frame.get())
        ->memory()
        .give_all_back_to_system();  // what is ahead
    const Filling filling(disk.path);
    const auto left = [&] { return engine.subscribe<Frame>("front", latched(8)).size(); };
    SUBCASE("of messages that go") {
      CHECK_NOTHROW(frame->data.resize(2 * kMiB));
      CHECK(left() >= 2);
      CHECK(left() < 8);
    }
    SUBCASE("of messages that have gone") {
      { const auto gone = std::move(front); }
      std::vector<lot::ShmUniquePtr<Frame>> frames;
      for (int i = 0; i < 6; ++i) {
        frames.push_back(rear.loan());
        CHECK_NOTHROW(frames.back()->data.resize(kMiB));
      }
    }
    SUBCASE("nothing goes for what the file system has no room for") {
      CHECK_THROWS_AS(frame->data.resize(8 * kMiB), lot::OutOfMemory);
      CHECK(left() == 8);
    }
  }
}

/// What the file system holds for the segment.
std::uint64_t taken(const lot::ShmEngine& engine) {
  struct stat status {};
  REQUIRE(stat(engine.path().c_str(), &status) == 0);
  return static_cast<std::uint64_t>(status.st_blocks) * 512;
}

TEST_CASE("memory that no process uses any more goes back to the system") {
  const Watchdog watchdog(120);
  Place place(256 * kMiB);
  auto kept = place.engine.advertise<Frame>("kept", {Policy::Overwrite, 2, {}});
  for (int i = 1; i <= 2; ++i) {
    auto frame = kept.loan();
    frame->number = i;
    frame->data.assign(3 * kMiB, static_cast<char>(i));
    REQUIRE(kept.push(std::move(frame)) == Status::Ok);
  }
  auto reserved = place.engine.advertise<Frame>("reserved", {Policy::Overwrite, 2, {}});
  reserved.reserve(2, 8 * kMiB);
  const auto probe = place.engine.make<Frame>();
  lot::transport::Participant::at(probe.get())
      ->memory()
      .give_all_back_to_system();  // what is ahead
  const std::uint64_t before = taken(place.engine);
  std::optional<lot::ShmPusher<Frame>> burst = place.engine.advertise<Frame>("burst");
  push_frames(*burst, 30, 4 * kMiB);
  CHECK(taken(place.engine) >= before + 118 * kMiB);  // it begins within a unit
  SUBCASE("of a publisher that has gone") { burst.reset(); }
  SUBCASE("of loans of a publisher that is there") {
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    burst.reset();
    burst.emplace(place.engine.advertise<Frame>("burst"));
    for (int i = 0; i < 30; ++i) {
      loans.push_back(burst->loan());
      loans.back()->data.resize(4 * kMiB);
    }
  }
  CHECK(eventually([&] { return taken(place.engine) <= before + 4 * kMiB; }, 60s));
  CHECK(taken(place.engine) >= before - 4 * kMiB);  // the rest is in use, or reserved
  auto frames = place.engine.subscribe<Frame>("kept", latched(2));
  for (int i = 1; i <= 2; ++i) {
    const auto frame = frames.try_pull();
    REQUIRE(frame);
    CHECK(frame->number == i);
    CHECK(std::count(frame->data.begin(), frame->data.end(), static_cast<char>(i)) == 3 * kMiB);
  }
}

TEST_CASE("a process that is killed while it gives memory back leaves what the others repair") {
  const Watchdog watchdog(120);
  std::mt19937_64 random(seed());
  Place place(32 * kMiB);
  lot::segment::Segment segment(place.engine.path());
  const lot::EngineOptions options = [&] {
    lot::EngineOptions same;
    same.segment = std::filesystem::path(place.engine.path()).filename();
    return same;
  }();
  for (int round = 0; round < 12; ++round) {
    const Steps begun;
    Child child([&] {
      lot::ShmEngine engine(options);
      const auto participant = lot::transport::Participant::join(options);
      for (bool first = true;; first = false) {
        engine.advertise<Frame>("frames").reserve(2, 4 * kMiB);
        participant->stock().give_back_to_system(0, [] { return false; });
        if (first) begun.tell();
      }
    });
    REQUIRE(begun.next() != 0);
    usleep(static_cast<useconds_t>(random() % 6000));
    child.kill9();
    CHECK(eventually([&] { return Audit(segment).participants == 1; }));
    CHECK(leak_in(place.engine.path()) == "");
  }
  auto pusher = place.engine.advertise<Frame>("frames", {Policy::Overwrite, 4, {}});
  push_frames(pusher, 8, 3 * kMiB);
}

TEST_CASE("memory that went back is asked for again before it is used") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=40m");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  lot::EngineOptions options = fresh(32 * kMiB);
  options.directory = disk.path;
  {
    lot::ShmEngine engine(options);
    {
      auto first = engine.advertise<Frame>("first", {Policy::Overwrite, 8, {}});
      push_frames(first, 8, 2 * kMiB);
    }
    const auto participant = lot::transport::Participant::join(options);
    const std::uint64_t before = taken(engine);
    CHECK(participant->memory().give_all_back_to_system() >= 14 * kMiB);
    CHECK(taken(engine) + 14 * kMiB <= before);
    CHECK(participant->memory().give_all_back_to_system() == 0);
    auto second = engine.advertise<Frame>("second", {Policy::Overwrite, 8, {}});
    {
      const Filling filling(disk.path);
      auto frame = second.loan();
      CHECK_THROWS_AS(frame->data.resize(8 * kMiB), lot::OutOfMemory);
    }
    push_frames(second, 8, 2 * kMiB);
    CHECK(taken(engine) + 4 * kMiB >= before);
  }
}

TEST_CASE("a topic that comes later gets its share from the one that has all the memory") {
  const Watchdog watchdog(60);
  Place place(64 * kMiB);
  auto front = place.engine.advertise<Frame>("front");
  auto rear = place.engine.advertise<Frame>("rear");
  push_frames(front, 100, kMiB);
  for (int round = 0; round < 60; ++round) {  // 2 s at 30 Hz
    push_frames(rear, 1, kMiB);
    push_frames(front, 1, kMiB);
  }
  const auto a = place.engine.subscribe<Frame>("front", latched(64)).size();
  const auto b = place.engine.subscribe<Frame>("rear", latched(64)).size();
  // 60 % of an equal share: 60 fit.
  CHECK(a >= 18);
  CHECK(b >= 18);
}

TEST_CASE("another topic's need leaves a publisher its newest two messages") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto front = place.engine.advertise<Frame>("front");
  push_frames(front, 100, kMiB);
  auto rear = place.engine.advertise<Frame>("rear");
  const auto kept = take_all(rear);
  auto reader = place.engine.subscribe<Frame>("front", latched(64));
  CHECK(reader.size() == 2);
}

/// One that has nothing, and does something while the others are looked at.
class Meddler final : public lot::transport::Evictor {
 public:
  std::function<void()> meddle;
  std::uint32_t pool() const noexcept override { return ~std::uint32_t{0}; }
  bool settle() noexcept override { return false; }
  Stock stock(lot::transport::Shortage) noexcept override {
    if (const auto once = std::exchange(meddle, nullptr)) once();
    return {};
  }
  void mark(bool, std::uint64_t, bool, std::vector<bool>&) noexcept override {}
  std::size_t look(std::span<std::uint32_t>) noexcept override { return 0; }
  bool give_up() noexcept override { return false; }
  bool give_up_to_other(lot::transport::Shortage, std::uint64_t) noexcept override { return false; }
};

TEST_CASE("a message that is kept while the others are weighed is not given up to another topic") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto front = place.engine.advertise<Frame>("front", {Policy::Overwrite, 8, {}});
  push_frames(front, 8, kMiB);
  auto rear = place.engine.advertise<Frame>("rear", {Policy::Overwrite, 2, {}});
  const auto probe = rear.loan();
  lot::transport::Participant& p = *lot::transport::Participant::at(probe.get());
  lot::transport::Holder& holder = p.holder();
  const std::uint32_t asker = holder.control(block_of(p, probe.get())).pool.load();
  Meddler meddler;
  p.eviction().add(meddler);
  auto reader = place.engine.subscribe<Frame>("front", latched(8));
  lot::ShmSharedPtr<const Frame> oldest;
  const auto evict = [&] {
    return p.eviction().evict(asker, kMiB, lot::transport::Shortage::Memory, {}).what ==
           lot::transport::Eviction::Step::What::Given;
  };
  const auto numbers = [&] {
    std::vector<int> all;
    auto late = place.engine.subscribe<Frame>("front", latched(8));
    while (const auto frame = late.try_borrow()) all.push_back(frame->number);
    return all;
  };
  SUBCASE("it is kept: the one behind it goes") {
    meddler.meddle = [&] { oldest = reader.try_pull(); };
    CHECK(evict());
    CHECK(numbers() == std::vector{0, 2, 3, 4, 5, 6, 7});
  }
  SUBCASE("nothing happens") {
    CHECK(evict());
    CHECK(numbers() == std::vector{1, 2, 3, 4, 5, 6, 7});
  }
  p.eviction().remove(meddler);
}

/// Refers to a frame.
struct Detection {
  int number;
  lot::ShmRef<const Frame> frame;
  lot::ShmVector<char> data;
};

lot::ShmSharedPtr<const Frame> make_frame(lot::ShmEngine& engine, std::size_t bytes) {
  auto frame = engine.make<Frame>();
  frame->data.resize(bytes);
  return lot::ShmSharedPtr<const Frame>(std::move(frame));
}

void push_detections(lot::ShmPusher<Detection>& pusher, int count,
                     const lot::ShmSharedPtr<const Frame>& frame) {
  for (int i = 0; i < count; ++i) {
    auto detection = pusher.loan();
    detection->number = i;
    detection->frame = frame;
    REQUIRE(pusher.push(std::move(detection)) == Status::Ok);
  }
}

TEST_CASE("messages do not give way for what they refer to when others keep that alive") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto detections = place.engine.advertise<Detection>("detections", {Policy::Overwrite, 16, {}});
  auto frames = place.engine.advertise<Frame>("frames", {Policy::Overwrite, 4, {}});
  auto camera = place.engine.advertise<Frame>("camera");
  lot::ShmSharedPtr<const Frame> frame = make_frame(place.engine, 8 * kMiB);
  SUBCASE("a pointer") { push_detections(detections, 16, frame); }
  SUBCASE("another queue") {
    push_detections(detections, 16, frame);
    REQUIRE(frames.push(frame) == Status::Ok);
    frame.reset();
  }
  SUBCASE("each other") {
    push_detections(detections, 16, frame);
    frame.reset();
  }
  push_frames(camera, 40, kMiB);
  CHECK(place.engine.subscribe<Detection>("detections", latched(16)).size() == 16);
}

TEST_CASE("messages give way that alone have what they refer to") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto detections = place.engine.advertise<Detection>("detections", {Policy::Overwrite, 16, {}});
  SUBCASE("one after the other, for another topic") {
    for (int i = 0; i < 16; ++i) {
      push_detections(detections, 1, make_frame(place.engine, kMiB));
    }
    auto camera = place.engine.advertise<Frame>("camera");
    push_frames(camera, 40, kMiB);
    CHECK(place.engine.subscribe<Frame>("camera", latched(40)).size() > 8);
    CHECK(place.engine.subscribe<Detection>("detections", latched(16)).size() < 16);
  }
  SUBCASE("together, for their own one") {
    push_detections(detections, 16, make_frame(place.engine, 8 * kMiB));
    std::vector<lot::ShmSharedPtr<const Frame>> others;
    try {
      for (;;) others.push_back(make_frame(place.engine, kMiB));
    } catch (const lot::OutOfMemory&) {
    }
    auto next = detections.loan();
    CHECK_NOTHROW(next->data.resize(4 * kMiB));
    CHECK(place.engine.subscribe<Detection>("detections", latched(16)).size() == 0);
  }
}

TEST_CASE("memory from reserve() is there whatever other topics need") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto front = place.engine.advertise<Frame>("front");
  front.reserve(2, 4 * kMiB);
  auto rear = place.engine.advertise<Frame>("rear");
  const auto kept = take_all(rear);
  SUBCASE("idle") {}
  SUBCASE("in its queue") {
    push_frames(front, 2, 4 * kMiB);
    CHECK_THROWS_AS(rear.loan()->data.resize(kMiB), lot::OutOfMemory);
    auto reader = place.engine.subscribe<Frame>("front", latched(2));
    CHECK(reader.size() == 2);
  }
  CHECK_NOTHROW(push_frames(front, 4, 4 * kMiB));
}

TEST_CASE("a reserve() that fails leaves its memory to others; what was reserved before stays") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto front = place.engine.advertise<Frame>("front");
  front.reserve(2, 4 * kMiB);
  CHECK_THROWS_AS(front.reserve(100, kMiB), lot::OutOfMemory);
  auto rear = place.engine.advertise<Frame>("rear");
  const auto kept = take_all(rear);
  CHECK(kept.size() > 10);
  CHECK_NOTHROW(push_frames(front, 4, 4 * kMiB));
}

TEST_CASE("a publisher that is bound by memory has the next message in its oldest one's memory") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto camera = place.engine.advertise<Frame>("camera");
  push_frames(camera, 100, kMiB);
  int warm = 0;
  for (int i = 0; i < 100; ++i) {
    auto frame = camera.loan();
    lot::transport::Participant& p = *lot::transport::Participant::at(frame.get());
    warm += p.segment().build(block_of(p, frame.get())).extents != 0;
    frame->data.resize(kMiB);
    must_go(camera.push(std::move(frame)));
  }
  CHECK(warm >= 50);  // but when it looks whether there is more for it
}

TEST_CASE("a publisher as deep as there are blocks claims none in its steady state") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB, 256);
  lot::PusherOptions deep;
  deep.depth = 256;
  auto pusher = place.engine.advertise<Map>("t", deep);
  for (int i = 0; i < 1000; ++i) must_go(pusher.push(pusher.loan(Map{i})));
  int claims = 0;
  for (int i = 0; i < 1000; ++i) {
    auto map = pusher.loan(Map{i});
    lot::transport::Holder& holder = lot::transport::Participant::at(map.get())->holder();
    claims += holder.next_free.exchange(0) != 0;
    must_go(pusher.push(std::move(map)));
  }
  CHECK(claims <= 100);
}

TEST_CASE("a bound publisher has its whole depth again when memory is free again") {
  const Watchdog watchdog(60);
  Place place(34 * kMiB);
  auto camera = place.engine.advertise<Frame>("camera", {Policy::Overwrite, 16, {}});
  {
    auto other = place.engine.advertise<Frame>("other");
    std::vector<lot::ShmUniquePtr<Frame>> kept;
    for (int i = 0; i < 20; ++i) {
      kept.push_back(other.loan());
      kept.back()->data.resize(kMiB);
    }
    push_frames(camera, 100, kMiB);
  }
  auto reader = place.engine.subscribe<Frame>("camera", latched(16));
  while (reader.size() < 14) push_frames(camera, 1, kMiB);  // else the watchdog
}

TEST_CASE("a push of the same message again allocates nothing") {
  const Watchdog watchdog(60);
  Place place(32 * kMiB);
  auto pusher = place.engine.advertise<Map>("t");
  const lot::ShmSharedPtr<Map> same(pusher.loan(Map{1}));
  for (int i = 0; i < 1000; ++i) must_go(pusher.push(same));
  news = 0;
  counts_news = true;
  for (int i = 0; i < 1000; ++i) must_go(pusher.push(same));
  counts_news = false;
  CHECK(news == 0);
}

/// Large enough for an extent of its own, and plain.
struct Big {
  char bytes[5000];
};
struct ToBig {
  int number;
  lot::ShmRef<const Big> big;
};
/// The same, and it grows.
struct Growing {
  char bytes[5000];
  lot::ShmVector<char> data;
};

TEST_CASE("a block whose message another one referred to is loaned for large messages again") {
  const Watchdog watchdog(60);
  Place place(64 * kMiB, 64);
  auto bigs = place.engine.advertise<Big>("bigs", {Policy::Overwrite, 1, {}});
  auto boxes = place.engine.advertise<ToBig>("boxes", {Policy::Overwrite, 1, {}});
  for (int i = 0; i < 200; ++i) {
    lot::ShmSharedPtr<Big> big;
    REQUIRE_NOTHROW(big = bigs.loan());
    auto box = boxes.loan();
    box->big = lot::ShmSharedPtr<const Big>(big);
    REQUIRE(boxes.push(std::move(box)) == Status::Ok);
  }
}

TEST_CASE("a block whose maker was killed is loaned for large messages again") {
  const Watchdog watchdog(60);
  constexpr std::uint32_t kBlocks = 8;
  lot::EngineOptions options = fresh();
  options.blocks = kBlocks;
  Steps made, joined;
  Child maker([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Growing>("t", {Policy::Overwrite, kBlocks, {}});
    for (std::uint32_t i = 0; i < kBlocks; ++i) {
      const lot::ShmSharedPtr<Growing> message(pusher.loan());
      message->data.resize(100);
      must(pusher.push(message) == Status::Ok, "it was pushed");
    }
    made.tell();
    joined.next();
  });
  REQUIRE(made.next() == '.');
  lot::ShmEngine engine(options);
  maker.kill9();
  auto pusher = engine.advertise<Growing>("other");
  std::vector<lot::ShmUniquePtr<Growing>> all;
  while (all.size() < kBlocks) {  // once its maker is reaped: else the watchdog
    lot::ShmUniquePtr<Growing> one;
    REQUIRE_NOTHROW(one = pusher.try_loan());
    if (one) all.push_back(std::move(one));
  }
}

TEST_CASE("a dead message lets go of what it referred to without any allocation") {
  const Watchdog watchdog(60);
  struct Box {
    lot::ShmRef<const Map> map;
  };
  Place place(32 * kMiB);
  auto pusher = place.engine.advertise<Box>("boxes", {Policy::Overwrite, 1, {}});
  std::vector<lot::ShmWeakPtr<const Map>> maps;
  for (int i = 0; i < 100; ++i) {
    lot::ShmSharedPtr<const Map> map = place.engine.make<Map>(Map{i});
    maps.emplace_back(map);
    news = 0;
    counts_news = true;
    auto box = pusher.loan();  // in the block of a dead one, which goes now
    counts_news = false;
    REQUIRE(news == 0);
    box->map = std::move(map);
    REQUIRE(pusher.push(std::move(box)) == Status::Ok);
  }
  CHECK(maps[0].expired());
  CHECK(maps[90].expired());
  CHECK(!maps[99].expired());
}

/// Does step(engine) with its first allocation failing, then its second, and so on, until it needs
/// no more than that. Afterwards each block can be had again.
template <class Step>
void fail_each_allocation(Step&& step) {
  constexpr std::uint32_t kBlocks = 256;
  Place place(32 * kMiB, kBlocks);
  bool failed = true;
  for (long n = 1; failed; ++n) {
    REQUIRE(n < 10000);
    try {
      step(place.engine, n);
    } catch (const std::bad_alloc&) {
    }
    failed = until_failure == 0;
    until_failure = 0;
    auto again = place.engine.advertise<Frame>("again");
    push_frames(again, 3, 100);
  }
  lot::segment::Segment segment(place.engine.path());
  CHECK(eventually([&] {
    const Audit audit(segment);
    return audit.readers == 0 && audit.channels == 0 && audit.topics == 0;
  }));
  auto all = place.engine.advertise<Map>("all");
  std::vector<lot::ShmUniquePtr<Map>> loans;
  loans.reserve(kBlocks);
  // What a closed ring held comes home when it is settled: else the watchdog.
  while (loans.size() < kBlocks) {
    if (auto loan = all.try_loan()) loans.push_back(std::move(loan));
  }
}

TEST_CASE("whichever allocation of advertise and of its end fails, nothing is lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    until_failure = n;
    auto pusher = engine.advertise<Frame>("t");
  });
}

TEST_CASE("whichever allocation of loan and push fails, nothing is lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    auto pusher = engine.advertise<Frame>("t", {Policy::Overwrite, 8, {}});
    auto other = engine.advertise<Frame>("t", {Policy::Overwrite, 8, {}});
    until_failure = n;
    for (int i = 0; i < 50; ++i) {
      auto frame = pusher.loan();
      frame->data.resize(100);
      const lot::ShmSharedPtr<Frame> shared(std::move(frame));
      must_go(pusher.push(shared));
      must_go(pusher.push(shared));
      must_go(other.push(shared));
    }
  });
}

TEST_CASE("whichever allocation of a publisher's end fails, nothing is lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    auto pusher = engine.advertise<Frame>("t", {Policy::Overwrite, 32, {}});
    push_frames(pusher, 32, 5000);
    const auto kept = pusher.loan();
    until_failure = n;
  });
}

TEST_CASE("whichever allocation of subscribe, pull and their end fails, nothing is lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    auto pusher = engine.advertise<Frame>("t");
    push_frames(pusher, 3, 100);
    until_failure = n;
    auto puller = engine.subscribe<Frame>("t", latched(3));
    const auto first = puller.try_pull();
    REQUIRE(first);
    const lot::ShmWeakPtr<const Frame> weak = first;
    const auto again = weak.lock();
    const auto look = puller.try_borrow();
    const auto kept = look.keep();
    CHECK(kept->number == 1);
  });
}

TEST_CASE("whichever allocation of a look at a new publisher fails, its messages are not lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    auto puller = engine.subscribe<Frame>("t");
    {
      auto pusher = engine.advertise<Frame>("t");
      push_frames(pusher, 3, 100);
    }
    until_failure = n;
    int number = 0;
    bool failed = false;
    const auto drain = [&] {
      while (const auto frame = puller.try_pull()) CHECK(frame->number == number++);
    };
    try {
      drain();
    } catch (const std::bad_alloc&) {
      failed = true;
    }
    if (failed) CHECK(eventually([&] { return drain(), number == 3; }));
    CHECK(number == 3);
  });
}

TEST_CASE("whichever allocation of put and pop fails, no item is lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    using Owned = lot::ShmUniquePtr<Map>;
    using Shared = lot::ShmSharedPtr<const Map>;
    auto one = engine.queue<Owned>("one");
    auto all = engine.queue<Shared>("all");
    all.listen();
    int put_to_one = 0;
    int put_to_all = 0;
    int from_one = 0;
    int from_all = 0;
    const auto pop = [&] {
      while (const auto item = one.try_pop()) CHECK((*item)->id == from_one++);
      while (const auto view = all.try_pop()) CHECK((*view)->id == from_all++);
    };
    until_failure = n;
    try {
      for (int i = 0; i < 3; ++i) {
        put_to_one += one.put(one.make(Map{i})) == Status::Ok;
        put_to_all += all.put(Shared(all.make(Map{i}))) == Status::Ok;
        pop();
      }
    } catch (const std::bad_alloc&) {
    }
    const long left = std::exchange(until_failure, 0);
    CHECK(eventually([&] { return pop(), from_one == put_to_one && from_all == put_to_all; }));
    until_failure = left;
  });
}

TEST_CASE("whichever allocation of listen, fd and a WaitSet fails, nothing is lost") {
  const Watchdog watchdog(100);
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    auto pusher = engine.advertise<Frame>("t");
    auto puller = engine.subscribe<Frame>("t");
    until_failure = n;
    const auto listener =
        engine.listen<Frame>("t", [](const lot::ShmSharedPtr<const Frame>& frame) {
          if (frame->number < 0) std::abort();
        });
    const int fd = puller.fd();
    CHECK(fd >= 0);
    lot::WaitSet set;
    set.add(puller, [&] { return puller.try_pull(); });
    set.add_timer(1ms, [] {});
    push_frames(pusher, 1, 100);
    set.run_once(1s);
  });
}

TEST_CASE("whichever allocation of a message with a ShmRef fails, nothing is lost") {
  const Watchdog watchdog(100);
  struct Box {
    lot::ShmRef<const Map> map;
  };
  fail_each_allocation([](lot::ShmEngine& engine, long n) {
    until_failure = n;
    const lot::ShmSharedPtr<const Map> map = engine.make<Map>(Map{7});
    auto box = engine.make<Box>();
    box->map = map;
    const lot::ShmRef<const Map> outside = map;
    auto pusher = engine.advertise<Box>("boxes");
    auto puller = engine.subscribe<Box>("boxes");
    must_go(pusher.push(std::move(box)));
    const auto seen = puller.try_pull();
    REQUIRE(seen);
    CHECK(seen->map.lock()->id == 7);
  });
}

TEST_SUITE_END();

TEST_CASE("a publisher whose messages readers keep gives none of them up in vain") {
  const Watchdog watchdog(60);
  Place place(16 * kMiB, 8);
  auto pusher = place.engine.advertise<Frame>("camera");
  auto keeper = place.engine.subscribe<Frame>("camera");
  std::vector<lot::ShmSharedPtr<const Frame>> kept;
  const auto push_one = [&] {
    must_go(pusher.push(pusher.loan()));
    if (auto frame = keeper.try_pull()) kept.push_back(std::move(frame));
  };
  for (int n = 0; n < 2; ++n) push_one();
  auto greedy = place.engine.advertise<Frame>("greedy");
  std::vector<lot::ShmUniquePtr<Frame>> loans;
  while (auto loan = greedy.try_loan()) loans.push_back(std::move(loan));
  REQUIRE(kept.size() == 2);
  auto late = place.engine.subscribe<Frame>("camera", latched(64));
  REQUIRE(late.size() == 2);
  CHECK_THROWS_AS((void)pusher.loan(), lot::OutOfMemory);
  CHECK(late.size() == 2);
}

}  // namespace
