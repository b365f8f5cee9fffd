// SPDX-License-Identifier: Apache-2.0

// A new publisher needs memory for its queue. A segment that is filled by messages that may go
// makes room for it, as for a message.

#include <csignal>
#include <cstdint>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/error_of.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::size_t kMiB = std::size_t{1} << 20;
constexpr std::size_t kPage = 4096;
constexpr std::size_t kSegment = 16 * kMiB;

struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<unsigned char> data;
};
struct Item {
  std::uint64_t number = 0;
};

lot::EngineOptions small_segment() {
  auto options = fresh(kSegment);
  options.blocks = 8192;
  return options;
}

/// A queue that never is full before the segment is.
lot::PusherOptions deep(lot::Policy policy = lot::Policy::Overwrite) {
  lot::PusherOptions options;
  options.depth = 6000;
  options.policy = policy;
  return options;
}

void push(lot::ShmPusher<Frame>& pusher, std::uint64_t number, std::size_t bytes) {
  auto frame = pusher.loan();
  frame->number = number;
  frame->data.resize(bytes);
  must(pusher.push(std::move(frame)) == lot::Status::Ok, "pushed");
}

/// Publishes frames of these sizes in turn, three times what fits: the later ones take the place of
/// the oldest.
void fill(lot::ShmPusher<Frame>& pusher, const std::vector<std::size_t>& sizes) {
  std::uint64_t n = 0;
  for (std::size_t sum = 0; sum < 3 * kSegment; ++n) {
    const std::size_t bytes = sizes[n % sizes.size()];
    push(pusher, n, bytes);
    sum += bytes;
  }
}

/// What the queue of a topic has, for one that asks for all.
std::size_t held(lot::ShmEngine& engine, const std::string& name) {
  lot::PullerOptions all;
  all.history = 6000;
  return engine.subscribe<Frame>(name, all).size();
}

/// A new publisher works.
void use(lot::ShmEngine& engine, const std::string& name, const lot::PusherOptions& options = {}) {
  auto late = engine.advertise<Item>(name, options);
  auto reader = engine.subscribe<Item>(name);
  auto item = late.loan();
  item->number = 7;
  REQUIRE(late.push(std::move(item)) == lot::Status::Ok);
  const auto got = reader.pull(10s);
  REQUIRE(got);
  CHECK(got->number == 7);
}

const std::vector<std::vector<std::size_t>> kSizes{
    {kPage},                             // fragments
    {3 * kPage, kPage},                  //
    {kMiB},                              // large ones, from the other end
    {kPage, kMiB, 2 * kPage, kMiB / 4},  // mixed
};

/// A process that fills a segment with overwritten messages and does nothing more.
class Filler {
 public:
  Filler(const lot::EngineOptions& options, std::vector<std::size_t> sizes)
      : child_([&options, sizes = std::move(sizes), this] {
          lot::ShmEngine engine(options);
          auto pusher = engine.advertise<Frame>("/frames", deep());
          fill(pusher, sizes);
          ready_.tell();
          end_.next(60s);
        }) {}
  bool is_ready() const { return ready_.next() == '.'; }
  void send(int signal) { child_.send(signal); }
  int end() {
    end_.tell();
    return child_.wait();
  }

 private:
  Steps ready_, end_;
  Child child_;
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("advertise on a segment that is full of messages of this process makes room") {
  const Watchdog watchdog(60);
  for (const auto& sizes : kSizes) {
    for (const bool is_read : {false, true}) {
      CAPTURE(sizes.front());
      CAPTURE(is_read);
      lot::ShmEngine engine(small_segment());
      auto pusher = engine.advertise<Frame>("/frames", deep());
      std::vector<lot::ShmPuller<Frame>> readers;
      if (is_read) readers.push_back(engine.subscribe<Frame>("/frames"));
      fill(pusher, sizes);
      const std::size_t before = held(engine, "/frames");
      std::vector<lot::ShmPusher<Item>> others;
      for (int n = 0; n < 80; ++n) {
        REQUIRE_NOTHROW(others.push_back(engine.advertise<Item>("/item" + std::to_string(n))));
      }
      use(engine, "/late");
      CHECK(held(engine, "/frames") < before);
      CHECK(held(engine, "/frames") >= 2);
      for (auto& reader : readers) CHECK(reader.pull(10s) != nullptr);
    }
  }
}

TEST_CASE("advertise on a segment that is full of messages of an idle process makes room") {
  const Watchdog watchdog(60);
  for (const auto& sizes : kSizes) {
    CAPTURE(sizes.front());
    const auto options = small_segment();
    Filler filler(options, sizes);
    REQUIRE(filler.is_ready());
    {
      lot::ShmEngine engine(options);
      auto reader = engine.subscribe<Frame>("/frames");
      std::vector<lot::ShmPusher<Item>> others;
      for (int n = 0; n < 80; ++n) {
        REQUIRE_NOTHROW(others.push_back(engine.advertise<Item>("/item" + std::to_string(n))));
      }
      use(engine, "/late");
      CHECK(held(engine, "/frames") >= 2);
    }
    CHECK(filler.end() == 0);
  }
}

TEST_CASE("advertise waits for a process that is slow, where no other can make room") {
  const Watchdog watchdog(60);
  const auto options = small_segment();
  lot::ShmEngine engine(options);
  Filler filler(options, {kPage});
  REQUIRE(filler.is_ready());
  filler.send(SIGSTOP);
  std::thread later([&] {
    std::this_thread::sleep_for(300ms);  // longer than one answer is waited for
    filler.send(SIGCONT);
  });
  std::vector<lot::ShmPusher<Item>> others;
  CHECK_NOTHROW(others.push_back(engine.advertise<Item>("/item")));
  later.join();
  CHECK(filler.end() == 0);
}

TEST_CASE("advertise makes room while another process goes on publishing") {
  const Watchdog watchdog(60);
  const auto options = small_segment();
  Steps ready, end;
  Child other([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/frames", deep());
    fill(pusher, {kMiB});
    ready.tell();
    for (std::uint64_t n = 0; end.next(0ms) == 0; ++n) push(pusher, n, kMiB);
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    std::vector<lot::ShmPusher<Item>> others;
    // A process that did not answer in time is passed over until it has: on a busy machine the
    // other one may be such for a moment.
    const auto advertise = [&](int n) {
      try {
        others.push_back(engine.advertise<Item>("/item" + std::to_string(n)));
        return true;
      } catch (const lot::OutOfMemory&) {
        return false;
      }
    };
    for (int n = 0; n < 80; ++n) REQUIRE(eventually([&] { return advertise(n); }, 5s));
    use(engine, "/late");
  }
  end.tell();
  CHECK(other.wait() == 0);
}

TEST_CASE("messages of a publisher that has left make room for a new queue") {
  const Watchdog watchdog(60);
  const auto options = small_segment();
  lot::ShmEngine engine(options);
  auto reader = engine.subscribe<Frame>("/frames");
  {
    auto pusher = engine.advertise<Frame>("/frames", deep());
    fill(pusher, {kPage});
  }
  use(engine, "/late");
  CHECK(reader.pull(10s) != nullptr);
}

TEST_CASE("a queue of any kind gets its memory in a full segment") {
  const Watchdog watchdog(60);
  for (const lot::QueueEngine kind : {lot::QueueEngine::Ring, lot::QueueEngine::Mutex}) {
    for (const lot::Policy policy :
         {lot::Policy::Overwrite, lot::Policy::Block, lot::Policy::Refuse}) {
      CAPTURE((kind == lot::QueueEngine::Ring));
      CAPTURE(static_cast<int>(policy));
      lot::ShmEngine engine(small_segment());
      auto pusher = engine.advertise<Frame>("/frames", deep());
      fill(pusher, {kPage});
      lot::PusherOptions options;
      options.engine = kind;
      options.policy = policy;
      use(engine, "/late", options);
    }
  }
}

TEST_CASE("the first put into a queue of items finds room in a full segment") {
  const Watchdog watchdog(60);
  for (const bool redeliver : {false, true}) {
    CAPTURE(redeliver);
    lot::ShmEngine engine(small_segment());
    auto pusher = engine.advertise<Frame>("/frames", deep());
    fill(pusher, {kPage});
    lot::QueueOptions options;
    options.redeliver = redeliver;
    auto queue = engine.queue<Item>("/items", options);
    REQUIRE(queue.put(Item{7}) == lot::Status::Ok);
    CHECK(queue.size() == 1);
  }
}

TEST_CASE("a queue that can never fit takes nothing, and the error says what helps") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(small_segment());
  auto owner = engine.advertise<Frame>("/owner");
  auto pusher = engine.advertise<Frame>("/frames");
  for (std::uint64_t n = 0; n < 64; ++n) push(pusher, n, kPage);
  // As much as there is.
  std::size_t reserved = 0;
  while (error_of([&] { owner.reserve(reserved + 1, 32 * kPage); }).second == "no error") {
    ++reserved;
  }
  const std::size_t before = held(engine, "/frames");
  CHECK(before >= 32);
  lot::PusherOptions deepest;
  deepest.depth = 65536;
  const std::string text =
      error_of([&] { return engine.advertise<Item>("/late", deepest); }).second;
  CAPTURE(text);
  CHECK(names(text, "the queue of /late"));
  CHECK(names(text, "LOT_SIZE"));
  CHECK(names(text, "depth"));
  CHECK(held(engine, "/frames") == before);
  use(engine, "/late");  // a usual one gets its memory all the same
}

TEST_CASE("a loan does not give way to a new queue, and the error names the process that has it") {
  const Watchdog watchdog(60);
  auto options = small_segment();
  options.name = "the loaner";
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Frame>("/frames");
  std::vector<lot::ShmUniquePtr<Frame>> loans;
  const auto loan = [&] {
    loans.push_back(pusher.loan());
    loans.back()->data.resize(kPage);
  };
  while (error_of(loan).second == "no error") {
  }
  const std::string text = error_of([&] { return engine.advertise<Item>("/late"); }).second;
  CAPTURE(text);
  CHECK(names(text, "the queue of /late"));
  CHECK(names(text, "of /frames, made by the loaner (pid "));
  CHECK(names(text, "LOT_SIZE"));
  loans.clear();
  use(engine, "/late");
}

TEST_SUITE_END();
