// SPDX-License-Identifier: Apache-2.0
#include "transport/biased_lock.hpp"

#include <cstdio>
#include <cstdlib>
#include <linux/membarrier.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "lot/detail/patience.hpp"

namespace lot::transport {
namespace {

bool membarrier(int command) noexcept { return syscall(SYS_membarrier, command, 0, 0) == 0; }

constexpr unsigned kTries = 1000;  ///< of the barrier, 50 us apart

/// True when this process (a forked child is another one) may use the barrier.
bool can_revoke() noexcept {
#if defined(__SANITIZE_THREAD__)
  return false;  // it does not know of membarrier
#else
#if defined(__has_feature)
#if __has_feature(thread_sanitizer)
  return false;
#endif
#endif
  static std::atomic<pid_t> registered{0};
  const pid_t process = getpid();
  if (registered.load(std::memory_order_acquire) == process) return true;
  if (!membarrier(MEMBARRIER_CMD_REGISTER_PRIVATE_EXPEDITED)) return false;
  registered.store(process, std::memory_order_release);
  return true;
#endif
}

/// While the process has one thread: later the kernel waits until every core has passed through it,
/// which takes 10 ms, and seconds on a machine that is overloaded.
[[maybe_unused]] const bool is_registered_at_start = can_revoke();

}  // namespace

BiasedLock::BiasedLock() noexcept {
  if (!can_revoke()) {
    owner_.store(kNobody, std::memory_order_relaxed);
    shared_.store(true, std::memory_order_relaxed);
  }
}

void BiasedLock::lock_shared() noexcept {
  const std::uint32_t thread = detail::ThisThread::id();
  detail::Patience patience;
  std::uint32_t inside = 0;
  while (!taken_.compare_exchange_weak(inside, thread, std::memory_order_acquire,
                                       std::memory_order_relaxed)) {  // L2
    while (inside != 0) {
      patience.wait(inside);
      inside = taken_.load(std::memory_order_relaxed);
    }
  }
  const std::uintptr_t owner = owner_.load(std::memory_order_relaxed);
  if (owner == kUnowned) {
    owner_.store(self(), std::memory_order_relaxed);
  } else if (owner != self()) {
    if (!shared_.load(std::memory_order_relaxed)) revoke(patience);
    alone_ = 0;
  } else if (++alone_ == kReturn) {
    shared_.store(false, std::memory_order_relaxed);  // the next thread that has taken_ sees it
  }
}

void BiasedLock::revoke(detail::Patience& patience) noexcept {
  shared_.store(true, std::memory_order_seq_cst);  // L1
  // The kernel may be short of memory for a moment. A process that is refused for good cannot go
  // on.
  for (unsigned tries = 0; !membarrier(MEMBARRIER_CMD_PRIVATE_EXPEDITED); patience.wait(0)) {
    if (++tries < kTries) continue;
    std::fputs("lot: membarrier was registered and fails now\n", stderr);
    std::abort();
  }
  while (busy_.load(std::memory_order_acquire)) patience.wait(0);  // L1, L2
}

}  // namespace lot::transport
