// SPDX-License-Identifier: Apache-2.0

// Memory between processes: nobody starves, whoever came first, and whoever does nothing more.
// LOT_FRAME_MIB and LOT_PERIOD_MS say what a camera publishes (tests/CMakeLists.txt). Of its frames
// 64 make a segment.

#include <csignal>
#include <cstdint>
#include <deque>
#include <random>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// As the README's camera on the default segment: 64 frames do not fit.
constexpr std::size_t kFrame = std::size_t{LOT_FRAME_MIB} << 20;
constexpr std::size_t kSegment = 64 * kFrame;

struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<unsigned char> data;
};

std::string topic(std::size_t n) { return "/camera" + std::to_string(n); }

void push(lot::ShmPusher<Frame>& pusher, std::uint64_t number, std::size_t bytes = kFrame) {
  auto frame = pusher.loan();
  frame->number = number;
  frame->data.resize(bytes);
  frame->data.front() = frame->data.back() = static_cast<unsigned char>(number);
  must(pusher.push(std::move(frame)) == lot::Status::Ok, "pushed");
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("the error of a full segment says what would have fitted, who holds most, what helps") {
  const Watchdog watchdog(60);
  auto options = fresh(kSegment);
  options.name = "the camera";
  Steps ready, end;
  Child keeper([&] {
    auto mine = options;
    mine.name = "the keeper";
    lot::ShmEngine engine(mine);
    auto reader = engine.subscribe<Frame>(topic(0));
    ready.tell();
    std::vector<lot::ShmSharedPtr<const Frame>> kept;
    while (kept.size() < 40) kept.push_back(reader.pull(20s));
    ready.tell();
    end.next();
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>(topic(0), {lot::Policy::Block, 4, 20s});
    for (std::uint64_t n = 0; n < 40; ++n) push(pusher, n);
    REQUIRE(ready.next() == '.');
    auto frame = pusher.loan();
    std::string text;
    try {
      frame->data.resize(2 * kSegment);
    } catch (const lot::OutOfMemory& e) {
      text = e.what();
    }
    CAPTURE(text);
    for (const char* part :
         {"the largest free piece has ", " MiB are of /camera0", "the camera (pid ",
          "the keeper (pid ", "keeps ", "let that one keep fewer", "LOT_SIZE"}) {
      CHECK(text.find(part) != std::string::npos);
    }
    const std::string kept = std::to_string(40 * LOT_FRAME_MIB) + " MiB";
    CHECK(text.find("keeps " + kept) != std::string::npos);
  }
  end.tell();
  CHECK(keeper.wait() == 0);
}

TEST_SUITE_END();
