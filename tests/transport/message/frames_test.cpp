// SPDX-License-Identifier: Apache-2.0

// Frames of 1 byte to 64 MiB in random order: the memory that they take stays bounded.
// LOT_LOANS says how many (tests/CMakeLists.txt).

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::uint64_t kLoans = LOT_LOANS;
constexpr unsigned kOctaves = 26;  // to 64 MiB
constexpr std::size_t kPublishers = 3;
constexpr std::uint32_t kDepth = 4;
constexpr std::size_t kInHand = 3;  ///< of each publisher, at most
constexpr std::size_t kKept = 3;    ///< by each reader, at most
constexpr std::uint64_t kSegment = std::uint64_t{1} << 30;
/// Frames that somebody has: in a queue, in hand, kept by one of two readers.
constexpr std::size_t kLive = kPublishers * (kDepth + kInHand) + 2 * kKept;
/// What these take on average, in granules, by any_size(): the mean of 2^x is the largest by ln of
/// it.
constexpr double kLiveGranules =
    kLive * (std::uint64_t{1} << kOctaves) / (kOctaves * 0.6931) / lot::segment::kGranule;

struct Frame {
  std::uint64_t size;
  lot::ShmVector<std::uint8_t> data;
};

using Random = std::mt19937_64;

/// As many small as large: each power of two is as likely as the next.
std::uint64_t any_size(Random& random) {
  std::uniform_real_distribution<double> octave(0, kOctaves);
  const auto size = static_cast<std::uint64_t>(std::exp2(octave(random)));
  return std::min(size, std::uint64_t{1} << kOctaves);
}

/// Little of a frame is touched: it says its size at both ends.
void write(Frame& frame, std::uint64_t size) {
  frame.size = size;
  frame.data.resize(size);
  frame.data.front() = static_cast<std::uint8_t>(size);
  frame.data.back() = static_cast<std::uint8_t>(size);
}
bool good(const Frame& frame) {
  return frame.data.size() == frame.size &&
         frame.data.front() == static_cast<std::uint8_t>(frame.size) &&
         frame.data.back() == static_cast<std::uint8_t>(frame.size);
}

/// A reader that keeps some of what it gets, and lets go in any order.
class Keeper {
 public:
  explicit Keeper(lot::ShmEngine& engine) : puller_(engine.subscribe<Frame>("/frames")) {}

  /// False: what it got is damaged.
  bool look(Random& random, std::chrono::nanoseconds most) {
    auto seen = puller_.pull(most);
    if (!seen) seen = puller_.try_pull();  // says whether somebody is there
    if (!seen) return true;
    any_ = true;
    if (random() % 2 == 0) kept_[random() % kKept] = seen;
    return good(*seen) && std::all_of(kept_.begin(), kept_.end(),
                                      [](const auto& frame) { return !frame || good(*frame); });
  }
  bool is_over() const { return any_ && puller_.status() == lot::Status::PublisherGone; }

 private:
  lot::ShmPuller<Frame> puller_;
  std::array<lot::ShmSharedPtr<const Frame>, kKept> kept_;
  bool any_ = false;
};

/// A publisher that has some frames in hand, pushes most of them in any order and drops the others.
class Publisher {
 public:
  explicit Publisher(lot::ShmEngine& engine)
      : pusher_(engine.advertise<Frame>("/frames", {lot::Policy::Overwrite, kDepth, 1s})) {}

  bool wait_for_readers(std::size_t count) { return pusher_.wait_for_readers(count, 20s); }

  void step(Random& random) {
    auto frame = pusher_.loan();
    write(*frame, any_size(random));
    in_hand_.push_back(std::move(frame));
    while (in_hand_.size() > random() % kInHand) {
      std::swap(in_hand_[random() % in_hand_.size()], in_hand_.back());
      frame = std::move(in_hand_.back());
      in_hand_.pop_back();
      if (random() % 8 != 0) must_go(pusher_.push(std::move(frame)));
    }
  }

 private:
  lot::ShmPusher<Frame> pusher_;
  std::vector<lot::ShmUniquePtr<Frame>> in_hand_;
};

/// What the segment held, over a part of the time.
struct Fill {
  std::uint32_t most = 0;
  std::size_t most_blocks = 0;
  std::uint64_t sum = 0;
  std::uint64_t samples = 0;

  void look(lot::segment::Segment& segment) {
    const std::uint32_t used = segment.granules().used();
    std::size_t blocks = 0;
    for (auto& block : segment.blocks()) blocks += block.home.load() != 0;
    most = std::max(most, used);
    most_blocks = std::max(most_blocks, blocks);
    sum += used;
    ++samples;
  }
  std::uint64_t mean() const { return sum / samples; }
};

}  // namespace

TEST_SUITE_BEGIN("message");

TEST_CASE("frames of 1 byte to 64 MiB in random order keep the memory that they take bounded") {
  const Watchdog watchdog(300);
  Random random(seed());
  const auto options = fresh(kSegment);
  Steps ready;
  Child reader([&] {
    alarm(300);
    lot::ShmEngine engine(options);
    Keeper keeper(engine);
    ready.tell();
    while (!keeper.is_over()) must(keeper.look(random, 100ms), "a frame");
  });
  REQUIRE(ready.next() == '.');
  lot::ShmEngine engine(options);
  lot::segment::Segment segment(engine.path());
  std::array<Fill, 4> quarters;
  {
    std::vector<Publisher> publishers;
    for (std::size_t i = 0; i < kPublishers; ++i) publishers.emplace_back(engine);
    for (auto& publisher : publishers) REQUIRE(publisher.wait_for_readers(1));
    Keeper keeper(engine);
    bool all_good = true;
    for (std::uint64_t n = 0; n < kLoans; ++n) {
      publishers[random() % kPublishers].step(random);  // throws when there is no memory
      if (random() % 2 == 0) all_good = all_good && keeper.look(random, 0ns);
      if (n % 100 == 99) quarters[4 * n / kLoans].look(segment);
    }
    CHECK(all_good);
  }
  CHECK(reader.wait() == 0);
  for (const Fill& quarter : quarters) {
    const std::uint64_t mean = quarter.mean() / 256;
    const std::uint64_t most = quarter.most / 256;
    MESSAGE(mean << " MiB in " << quarter.most_blocks << " blocks at most; at most " << most
                 << " MiB");
    CHECK(quarter.most_blocks <= 4 * kLive);
    // Twice what is live was seen on average, and 2.8 times over one quarter: blocks keep for some
    // seconds what a larger frame made them take. A leak goes on.
    CHECK(static_cast<double>(quarter.mean()) < 4 * kLiveGranules);
  }
  CHECK(eventually([&] { return Audit(segment).nothing(); }));
}

TEST_SUITE_END();
