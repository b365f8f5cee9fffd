// SPDX-License-Identifier: Apache-2.0
#include <deque>

#include <lot/lot.hpp>

#include "tally.hpp"

namespace demo {

/// Receives through shared memory, and keeps the latest frames a while.
int ring_consumer(const Settings& settings) {
  using namespace std::chrono_literals;
  Control control(true);
  lot::ShmEngine engine(settings.engine());
  auto puller = engine.subscribe<Frame>(kTopic);
  say("ready", {{"path", engine.path()}});
  Tally tally(settings);
  std::deque<lot::ShmSharedPtr<const Frame>> held;
  while (!control.stop()) {
    lot::ShmSharedPtr<const Frame> frame = puller.pull(50ms);
    if (!frame) continue;
    if (settings.hash && frame->head.last != 0) {  // a video ends with an empty frame
      tally.report(puller.missed_total());
      continue;
    }
    tally.note(frame->head, frame->data.data(), frame->data.size());
    if (frame->head.last != 0) {
      held.clear();
      tally.report(puller.missed_total());
      continue;
    }
    held.push_back(std::move(frame));
    if (held.size() > kHeld) held.pop_front();
  }
  return 0;
}

}  // namespace demo
