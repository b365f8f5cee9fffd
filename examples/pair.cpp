// SPDX-License-Identifier: Apache-2.0
/// The README's program: a camera and a reader in two processes. 16 MiB cross without a copy.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <utility>

#include <lot/lot.hpp>

namespace {

using namespace std::chrono_literals;

struct Frame {
  std::uint32_t width, height;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
};

constexpr std::uint32_t kFrames = 3;

void camera() {
  lot::ShmEngine engine;
  auto pusher = engine.advertise<Frame>("/camera/front");
  pusher.wait_for_readers(1, 1s);
  for (std::uint32_t n = 1; n <= kFrames; ++n) {
    lot::ShmUniquePtr<Frame> frame = pusher.loan();
    frame->width = 4096;
    frame->height = 4096;
    frame->encoding = "mono8";
    frame->data.resize(16 << 20);  // no zeroing of pixels
    frame->data.back() = static_cast<std::uint8_t>(n);
    pusher.push(std::move(frame));  // unique becomes shared, no copy
  }
}

bool reader() {
  lot::ShmEngine engine;
  auto puller = engine.subscribe<Frame>("/camera/front");
  for (std::uint32_t n = 1; n <= kFrames; ++n) {
    lot::ShmSharedPtr<const Frame> seen = puller.pull(1s);
    if (!seen) {
      std::fprintf(stderr, "frame %u did not come: %s\n", n, lot::to_string(puller.status()));
      return false;
    }
    std::printf("%u x %u %s, %zu bytes, the last of them %d\n", seen->width, seen->height,
                seen->encoding.c_str(), seen->data.size(), seen->data.back());
    if (seen->data.back() != n) return false;
  }
  return true;
}

}  // namespace

int main() try {
  const std::string name = "lot_pair_" + std::to_string(getpid());
  setenv("LOT_SEGMENT", name.c_str(), 0);  // a segment of our own, unless the caller names one

  const pid_t child = fork();  // before any engine is made: what is inherited is inert
  if (child == -1) {
    std::perror("fork");
    return 1;
  }
  if (child == 0) {
    camera();
    return 0;
  }
  const bool all_came = reader();
  int status = 0;
  waitpid(child, &status, 0);
  return all_came && status == 0 ? 0 : 1;
} catch (const std::exception& e) {
  std::fprintf(stderr, "pair: %s\n", e.what());
  return 1;
}
