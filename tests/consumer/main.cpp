// SPDX-License-Identifier: Apache-2.0

// The README's program, compiled as C++17 against the installed package: what a user writes.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <utility>

#include <lot/lot.hpp>

struct Frame {
  std::uint32_t width, height;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
};

int main() {
  using namespace std::chrono_literals;

  lot::ShmEngine engine;
  auto pusher = engine.advertise<Frame>("/camera/front");
  auto puller = engine.subscribe<Frame>("/camera/front");

  for (std::uint8_t round = 1; round <= 2; ++round) {
    lot::ShmUniquePtr<Frame> frame = pusher.loan();
    frame->encoding = "mono8";
    frame->data.resize(16 << 20);
    frame->data[4711] = round;
    pusher.push(std::move(frame));

    if (round == 1) {
      lot::ShmSharedPtr<const Frame> seen = puller.pull(100ms);
      if (!seen || seen->data.size() != 16 << 20 || seen->data[4711] != round) return 1;
    } else {
      auto look = puller.borrow(100ms);
      if (!look || look->data[4711] != round) return 2;
    }
  }
  std::puts("ok");
}
