// SPDX-License-Identifier: Apache-2.0

// The arm of LOT in hop.py: frames by a segment. And the floor: a futex alone, at the same pace.
//
//     lot_arm send|receive|futex TOPIC BOARD [--bytes N] [--frames N] [--period-us N] [--window N]

#include <sched.h>
#include <sys/wait.h>

#include <lot/lot.hpp>

#include "run.hpp"

namespace bench {

struct Frame {
  std::uint64_t number = 0;
  std::uint64_t stamp_ns = 0;
  lot::ShmVector<std::uint8_t> data;
};

namespace {

void send(const Settings& settings) {
  lot::ShmEngine engine;
  lot::PusherOptions options;
  options.depth = settings.depth;
  auto pusher = engine.advertise<Frame>(settings.topic, options);
  send_all(settings, [&](std::uint64_t number, std::uint64_t bytes) {
    auto frame = pusher.loan();
    frame->number = number;
    frame->data.resize(bytes);
    fill(frame->data.data(), bytes, number);
    frame->stamp_ns = now_ns();
    if (pusher.push(std::move(frame)) != lot::Status::Ok) throw std::runtime_error("push");
  });
}

void receive(const Settings& settings) {
  lot::ShmEngine engine;
  auto puller = engine.subscribe<Frame>(settings.topic);
  Receipt receipt(settings);
  for (bool goes_on = true; goes_on;) {
    const auto frame = puller.borrow(20s);
    if (!frame) throw std::runtime_error("no frame for 20 s, or the publisher has gone");
    goes_on = receipt.take(frame->number, frame->stamp_ns, frame->data.data(), frame->data.size());
  }
  receipt.print();
}

/// Each side on a core of its own, where there are two: on one core a wake-up is ten times as fast.
void stay_on(int core) {
  cpu_set_t cores;
  CPU_ZERO(&cores);
  CPU_SET(core, &cores);
  (void)sched_setaffinity(0, sizeof cores, &cores);
}

/// How long a futex takes to wake a process that has slept for a period.
void futex(const Settings& settings) {
  struct Shared {
    std::atomic<std::uint32_t> word;
    std::atomic<std::uint32_t> seen;  ///< by the other process, which is about to sleep
    std::atomic<std::uint64_t> stamp_ns;
  };
  void* const at =
      mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (at == MAP_FAILED) throw std::runtime_error("mmap");
  auto& shared = *static_cast<Shared*>(at);
  const pid_t sender = fork();
  if (sender < 0) throw std::runtime_error("fork");
  stay_on(sender == 0 ? 1 : 0);
  if (sender == 0) {
    const auto begin = Clock::now();
    for (std::uint32_t n = 0; n < settings.frames; ++n) {
      std::this_thread::sleep_until(begin + n * std::chrono::microseconds(settings.period_us));
      while (shared.seen.load(std::memory_order_acquire) != n) std::this_thread::sleep_for(100us);
      shared.stamp_ns.store(now_ns(), std::memory_order_relaxed);
      shared.word.store(n + 1, std::memory_order_release);
      syscall(SYS_futex, &shared.word, FUTEX_WAKE, 1, nullptr, nullptr, 0);
    }
    _exit(0);
  }
  std::vector<double> latencies;
  for (std::uint32_t seen = 0; seen < settings.frames;) {
    syscall(SYS_futex, &shared.word, FUTEX_WAIT, seen, nullptr, nullptr, 0);
    const std::uint64_t now = now_ns();
    const std::uint32_t next = shared.word.load(std::memory_order_acquire);
    if (next == seen) continue;
    if (seen >= settings.warm_up) {
      const std::uint64_t then = shared.stamp_ns.load(std::memory_order_relaxed);
      latencies.push_back(static_cast<double>(now - then) / 1e3);
    }
    seen = next;
    shared.seen.store(seen, std::memory_order_release);
  }
  waitpid(sender, nullptr, 0);
  munmap(at, sizeof(Shared));
  std::printf("%s\n", nlohmann::json{{"latencies_us", latencies}}.dump().c_str());
}

void work(const Settings& settings) {
  if (settings.role == "futex") return futex(settings);
  if (settings.role == "send") return send(settings);
  receive(settings);
}

}  // namespace
}  // namespace bench

int main(int argc, char** argv) { return bench::main_of(argc, argv, "lot_arm", bench::work); }
