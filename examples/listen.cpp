// SPDX-License-Identifier: Apache-2.0
/// Two ways to be called back: a listener with a thread of its own for what comes often, and a
/// WaitSet in which one thread serves several pullers, a timer and Ctrl-C.
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <sched.h>
#include <thread>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

using namespace std::chrono_literals;

struct Number {
  std::uint64_t value;
};

bool sensors() {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto imu = engine.advertise<Number>("/imu");
  auto front = engine.advertise<Number>("/camera/front");
  auto rear = engine.advertise<Number>("/camera/rear");
  for (std::uint64_t n = 0; !stop.stop_requested(); ++n) {  // until main() says SIGTERM
    // The oldest goes where a reader is slow: never Full.
    (void)imu.push(imu.loan(Number{n}));
    if (n % 30 == 0) (void)front.push(front.loan(Number{n}));
    if (n % 60 == 0) (void)rear.push(rear.loan(Number{n}));
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

bool consumer() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C
  lot::ShmEngine engine;

  lot::ThreadOptions thread;
  thread.name = "imu";
  thread.cpus = {static_cast<unsigned>(sched_getcpu())};  // one that we may use
  thread.policy = SCHED_BATCH;                            // SCHED_FIFO needs CAP_SYS_NICE
  std::atomic<std::uint64_t> samples{0};
  const lot::ShmListener imu = engine.listen<Number>(
      "/imu", [&](const lot::ShmSharedPtr<const Number>&) { ++samples; }, {}, thread);

  auto front = engine.subscribe<Number>("/camera/front");
  auto rear = engine.subscribe<Number>("/camera/rear");
  std::uint64_t frames = 0;
  lot::WaitSet set;
  set.add(front, [&] {
    while (front.try_pull()) ++frames;
  });
  set.add(rear, [&] {
    while (rear.try_pull()) ++frames;
  });
  set.add_timer(100ms, [&] {
    std::printf("%llu samples, %llu frames\n", static_cast<unsigned long long>(samples),
                static_cast<unsigned long long>(frames));
    if (samples >= 100 && frames >= 10) set.stop();  // enough for an example
  });

  set.run(stop);  // until set.stop(), or Ctrl-C
  return true;
}

}  // namespace

int main() {
  return example::run("listen", [] {
    const pid_t child = example::start("sensors", sensors);
    const bool good = consumer();
    kill(child, SIGTERM);
    example::finish(child);
    return good;
  });
}
