// SPDX-License-Identifier: Apache-2.0
#include "transport/process_barrier.hpp"

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <linux/membarrier.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "lot/detail/patience.hpp"

namespace lot::transport {
namespace {

bool membarrier(int command) noexcept { return syscall(SYS_membarrier, command, 0, 0) == 0; }

constexpr unsigned kTries = 1000;  ///< how often the barrier is tried, 50 us apart

/// Registered while the process has one thread. Later the kernel waits until every core has passed
/// through it, which takes 10 ms, and seconds on an overloaded machine.
[[maybe_unused]] const bool is_registered_at_start =
    membarrier(MEMBARRIER_CMD_REGISTER_PRIVATE_EXPEDITED);

}  // namespace

bool ProcessBarrier::is_there() noexcept {
#if defined(__SANITIZE_THREAD__)
  return false;
#else
#if defined(__has_feature)
#if __has_feature(thread_sanitizer)
  return false;
#endif
#endif
  static std::atomic<pid_t> tried{0};
  const pid_t process = getpid();
  // Acquire, with the release below: the process has registered by then.
  if (tried.load(std::memory_order_acquire) == process) return true;
  // The barrier itself is tried as well: a sandbox may have come since the process was registered.
  if (!membarrier(MEMBARRIER_CMD_REGISTER_PRIVATE_EXPEDITED) ||
      !membarrier(MEMBARRIER_CMD_PRIVATE_EXPEDITED)) {
    return false;
  }
  tried.store(process, std::memory_order_release);  // that the process has registered
  return true;
#endif
}

void ProcessBarrier::pass() noexcept {
  // The kernel may be short of memory for a moment. A process that it refuses for good cannot go
  // on.
  detail::Patience patience;
  for (unsigned tries = 0; !membarrier(MEMBARRIER_CMD_PRIVATE_EXPEDITED); patience.wait(0)) {
    if (++tries < kTries) continue;
    std::fputs(
        "lot: membarrier() worked when this process began and is refused now: let a sandbox come "
        "before the first lot::ShmEngine\n",
        stderr);
    std::abort();
  }
}

}  // namespace lot::transport
