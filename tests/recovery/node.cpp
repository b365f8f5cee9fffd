// SPDX-License-Identifier: Apache-2.0

// A node of its own, to be run in another PID namespace: node SEGMENT SIZE publish|echo|hold TOPIC
//   publish: a number every millisecond, from 1 on, until a signal
//   echo:    tells each number it reads on stdout; stops at a signal
//   hold:    reads one, keeps it, tells it, and waits for its death
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <thread>
#include <unistd.h>

#include "lot/lot.hpp"

namespace {
volatile std::sig_atomic_t stop = 0;
void on_signal(int) { stop = 1; }

struct Number {
  std::uint64_t value;
};

int run(char** argv) {
  using namespace std::chrono_literals;
  lot::EngineOptions options;
  options.segment = argv[1];
  options.size_bytes = std::strtoull(argv[2], nullptr, 10);
  lot::ShmEngine engine(options);
  if (std::strcmp(argv[3], "publish") == 0) {
    auto pusher = engine.advertise<Number>(argv[4], {lot::Policy::Overwrite, 64, 1s});
    std::printf("pid %d\n", static_cast<int>(getpid()));
    std::fflush(stdout);
    for (std::uint64_t n = 1; stop == 0; ++n) {
      if (pusher.push(pusher.loan(n)) != lot::Status::Ok) return 1;
      std::this_thread::sleep_for(1ms);
    }
    return 0;
  }
  auto puller = engine.subscribe<Number>(argv[4]);
  std::printf("pid %d\n", static_cast<int>(getpid()));
  std::fflush(stdout);
  while (stop == 0) {
    const auto seen = puller.pull(100ms);
    if (!seen) continue;
    std::printf("got %llu\n", static_cast<unsigned long long>(seen->value));
    std::fflush(stdout);
    if (std::strcmp(argv[3], "hold") == 0) {
      while (stop == 0) pause();
    }
  }
  return 0;
}
}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) return 64;
  alarm(60);
  std::signal(SIGTERM, on_signal);
  std::signal(SIGINT, on_signal);
  try {
    return run(argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "node: %s\n", e.what());
    return 1;
  }
}
