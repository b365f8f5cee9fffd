// SPDX-License-Identifier: Apache-2.0
#include <lot/lot.hpp>

#include "camera.hpp"

namespace demo {

/// Publishes through shared memory.
int ring_camera(const Settings& settings) {
  using namespace std::chrono_literals;
  Control control(true);
  lot::ShmEngine engine(settings.engine());
  lot::PusherOptions options;
  options.depth = settings.depth;
  // The machine may keep a consumer from running. The camera waits then, and skips pictures, as the
  // TCP camera does: what is lost was lost by the transport.
  options.policy = lot::Policy::Block;
  options.block_for = 30s;
  options.engine = settings.mutex ? lot::QueueEngine::Mutex : lot::QueueEngine::Ring;
  auto pusher = engine.advertise<Frame>(kTopic, options);
  // As many as can exist at once, so that memory is warm from the first frame on.
  pusher.reserve(settings.depth + kConsumers * (kHeld + 1), settings.bytes);
  say("ready");
  // In its second life the camera does not wait for anybody.
  if (settings.run == 1 && !pusher.wait_for_readers(kConsumers, 10s)) {
    throw std::runtime_error("the consumers have not come");
  }
  film(settings, control, [&](std::uint32_t number, bool last) {
    lot::ShmUniquePtr<Frame> frame = pusher.loan();
    frame->head = make_head(settings.run, number, last);
    frame->data.resize(settings.bytes);
    draw(frame->data.data(), frame->data.size(), number);
    if (control.pause()) {  // to be killed here: loaned, drawn, not pushed
      say("paused", {{"pushed", number}});
      control.wait();
    }
    frame->head.stamp_ns = now_ns();
    if (pusher.push(std::move(frame)) != lot::Status::Ok) {
      throw std::runtime_error("a consumer has not read for 30 s");
    }
  });
  return 0;
}

}  // namespace demo
