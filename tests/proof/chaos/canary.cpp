// SPDX-License-Identifier: Apache-2.0
#include "canary.hpp"

#include <csignal>
#include <sched.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

namespace lot::chaos {
namespace {

using namespace std::chrono_literals;

constexpr auto kSong = 100ms;
constexpr auto kSilence = 2s;
constexpr auto kMemory = 30s;

std::int64_t now() {
  return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
}

}  // namespace

Canary::Canary(Board& board) : board_(board) {
  cpu_set_t allowed;
  sched_getaffinity(0, sizeof(allowed), &allowed);
  for (unsigned cpu = 0; cpu < CPU_SETSIZE && canaries_.size() < Board::kProcessors; ++cpu) {
    if (!CPU_ISSET(cpu, &allowed)) continue;
    auto& seen = board.canary_seen[canaries_.size()];
    seen.store(now());
    const pid_t pid = ::fork();
    if (pid == -1) continue;
    if (pid > 0) {
      canaries_.push_back(pid);
      continue;
    }
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(cpu, &one);
    sched_setaffinity(0, sizeof(one), &one);
    for (;;) {
      seen.store(now(), std::memory_order_relaxed);
      std::this_thread::sleep_for(kSong);
    }
  }
}

Canary::~Canary() {
  for (const pid_t pid : canaries_) {
    ::kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
  }
}

bool Canary::machine_stalls() {
  bool stalls = false;
  for (std::size_t i = 0; i < canaries_.size(); ++i) {
    stalls |= now() - board_.canary_seen[i].load(std::memory_order_relaxed) >
              std::chrono::nanoseconds(kSilence).count();
  }
  if (stalls) board_.stalled_at.store(now());
  return stalls;
}

bool has_stalled(const Board& board) {
  const std::int64_t at = board.stalled_at.load();
  return at != 0 && now() - at < std::chrono::nanoseconds(kMemory).count();
}

}  // namespace lot::chaos
