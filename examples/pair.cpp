// SPDX-License-Identifier: Apache-2.0
/// The README's program: a camera and a reader in two processes. 16 MiB cross without a copy.
#include <cstdint>
#include <cstdio>
#include <utility>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

struct Frame {
  std::uint32_t width, height;
  lot::ShmString encoding;
  lot::ShmVector<std::uint8_t> data;
};

constexpr std::uint32_t kFrames = 3;

bool camera() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C
  lot::ShmEngine engine;
  auto pusher = engine.advertise<Frame>("/camera/front");
  if (!pusher.wait_for_readers(1, stop)) return false;
  for (std::uint32_t n = 1; n <= kFrames; ++n) {
    lot::ShmUniquePtr<Frame> frame = pusher.loan();
    frame->width = 4096;
    frame->height = 4096;
    frame->encoding = "mono8";
    frame->data.resize(16 << 20);  // no zeroing of pixels
    frame->data.back() = static_cast<std::uint8_t>(n);
    (void)pusher.push(std::move(frame));  // no copy; the oldest goes: never Full
  }
  return true;
}

bool reader() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C
  lot::ShmEngine engine;
  auto puller = engine.subscribe<Frame>("/camera/front");
  for (std::uint32_t n = 1; n <= kFrames; ++n) {
    lot::ShmSharedPtr<const Frame> seen = puller.pull(stop);
    if (!seen) return false;  // Ctrl-C, or the camera has gone: status() says which
    std::printf("%u x %u %s, %zu bytes, the last of them %d\n", seen->width, seen->height,
                seen->encoding.c_str(), seen->data.size(), seen->data.back());
    if (seen->data.back() != n) return false;
  }
  return true;
}

}  // namespace

int main() {
  return example::run("pair", [] {
    const pid_t child = example::start("camera", camera);
    const bool all_came = reader();
    return example::finish(child) && all_came;
  });
}
