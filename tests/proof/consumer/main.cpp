// SPDX-License-Identifier: Apache-2.0

// The README's programs, compiled as C++17: what a user writes.

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
struct Task {
  std::uint32_t number;
};

using namespace std::chrono_literals;

static int publish_and_receive(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Frame>("/camera/front");
  auto puller = engine.subscribe<Frame>("/camera/front");

  for (std::uint8_t round = 1; round <= 2; ++round) {
    lot::ShmUniquePtr<Frame> frame = pusher.loan();
    frame->encoding = "mono8";
    frame->data.resize(16 << 20);
    frame->data[4711] = round;
    if (pusher.push(std::move(frame)) != lot::Status::Ok) return 9;

    if (round == 1) {
      lot::ShmSharedPtr<const Frame> seen = puller.pull(100ms);
      if (!seen || seen->data.size() != 16 << 20 || seen->data[4711] != round) return 1;
    } else {
      auto look = puller.borrow(100ms);
      if (!look || look->data[4711] != round) return 2;
    }
  }
  return 0;
}

static int put_and_pop(lot::ShmEngine& engine) {
  auto tasks = engine.queue<lot::ShmUniquePtr<Task>>("tasks");
  if (tasks.put(tasks.make(Task{1})) != lot::Status::Ok) return 3;
  if (tasks.emplace(Task{2}) != lot::Status::Ok || tasks.size() != 2) return 4;
  if (tasks.wait_and_pop()->number != 1) return 5;
  const auto second = tasks.try_pop();
  if (!second || (*second)->number != 2 || !tasks.is_empty()) return 6;

  auto values = engine.queue<Task>("values");
  if (values.try_put(Task{3}) != lot::Status::Ok || values.wait_and_pop().number != 3) return 7;
  return 0;
}

static int wait_for_several(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Task>("/numbers");
  auto puller = engine.subscribe<Task>("/numbers");
  std::uint32_t sum = 0;
  lot::WaitSet set;
  set.add(puller, [&] {
    while (auto number = puller.try_pull()) sum += number->number;
    set.stop();
  });
  set.add_timer_once(1ms, [&] {
    if (pusher.push(pusher.loan(Task{5})) != lot::Status::Ok) set.stop();  // sum stays 0
  });
  set.run();
  return sum == 5 ? 0 : 8;
}

int main() {
  lot::ShmEngine engine;
  for (const auto part : {publish_and_receive, put_and_pop, wait_for_several}) {
    if (const int wrong = part(engine)) return wrong;
  }
  std::puts("ok");
}
