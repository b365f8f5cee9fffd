// SPDX-License-Identifier: Apache-2.0
#include "lot/signals.hpp"

#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <optional>
#include <system_error>
#include <thread>
#include <unistd.h>

#include "lot/detail/mutex.hpp"
#include "lot/detail/no_signals.hpp"
#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "segment/system_limits.hpp"
#include "transport/participant.hpp"

namespace lot {
namespace {

constexpr int kSignals[] = {SIGINT, SIGTERM, SIGHUP};

/// remove_files() takes no longer than this. A signal that comes meanwhile is the same wish once
/// more: a terminal, a shell and timeout(1) send it twice, and so does a parent's death
/// (PR_SET_PDEATHSIG).
constexpr std::chrono::milliseconds kCleaning = transport::kGatePatience;

detail::Mutex mutex{detail::Rank::Signals};
// What the handler uses. Relaxed, all of it: nothing is handed over. No descriptor, since
// closefrom() would close it.
std::atomic<pid_t> process{0};         ///< the process that has the thread
std::atomic<std::int64_t> came_at{0};  ///< when the first signal came; 0: none has come
std::atomic<std::uint32_t> came{0};    ///< the number of the signal; the thread sleeps on this word

std::int64_t now() { return futex::Clock::now().time_since_epoch().count(); }

/// Ends the process as soon as the handler that calls this has returned. For a handler.
void end_at_once(int number) {
  std::signal(number, SIG_DFL);
  raise(number);
}

/// The handler of end_cleanly_on_signals(). It does only what a signal handler may do. Relaxed,
/// all: a number is all that each word tells.
void take(int number) {
  const int error = errno;
  const bool is_child = getpid() != process.load(std::memory_order_relaxed);
  std::int64_t first = 0;
  if (!is_child && came_at.compare_exchange_strong(first, now(), std::memory_order_relaxed)) {
    came.store(static_cast<std::uint32_t>(number), std::memory_order_relaxed);
    futex::wake_all(&came);
  } else if (is_child || now() - first > std::chrono::nanoseconds(kCleaning).count()) {
    end_at_once(number);  // a forked child has no such thread; or removing takes too long
  }
  errno = error;
}

/// The source of stop_on_signals(), never destroyed: a signal may come while statics go.
StopSource& stopping() {
  static auto* const source = new StopSource();
  return *source;
}
std::atomic<StopSource*> to_stop{nullptr};  ///< what the handler stops
std::atomic<std::int64_t> stopped_at{0};    ///< when the first signal came; 0: none has come

/// The handler of stop_on_signals(). It does only what a signal handler may do. Relaxed, both: the
/// time is all that the one tells, and the source is never changed.
void stop(int number) {
  const int error = errno;
  std::int64_t first = 0;
  if (stopped_at.compare_exchange_strong(first, now(), std::memory_order_relaxed)) {
    to_stop.load(std::memory_order_relaxed)->request_stop();
  } else if (now() - first > std::chrono::nanoseconds(kCleaning).count()) {
    end_at_once(number);
  }
  errno = error;
}

/// Ends the process as the signal does by default.
[[noreturn]] void end(int number) {
  std::signal(number, SIG_DFL);
  sigset_t its;
  sigemptyset(&its);
  sigaddset(&its, number);
  pthread_sigmask(SIG_UNBLOCK, &its, nullptr);
  raise(number);
  _exit(128 + number);  // for the first process of a container the default is to ignore it
}

/// What the thread does. Relaxed: the number is all that the word tells.
void wait_and_end() {
  pthread_setname_np(pthread_self(), "lot-signals");
  while (came.load(std::memory_order_relaxed) == 0) futex::wait(&came, 0, std::nullopt);
  transport::Participant::remove_files();
  end(static_cast<int>(came.load(std::memory_order_relaxed)));
}

/// Keeps main() from ending the process while a signal is on its way: a result of work that the
/// signal has cut short is no exit code. Relaxed, both: it looks again each time.
void await_end() {
  while (process.load(std::memory_order_relaxed) == getpid() &&
         came_at.load(std::memory_order_relaxed) != 0) {
    pause();
  }
}

/// Puts `handler` in the place of the default action, or of `other`.
void install(int number, void (*handler)(int), int flags, void (*other)(int) = SIG_DFL) {
  struct sigaction action {};
  if (sigaction(number, nullptr, &action) != 0 || (action.sa_flags & SA_SIGINFO) != 0) return;
  if (action.sa_handler != SIG_DFL && action.sa_handler != other) return;
  action.sa_handler = handler;
  action.sa_flags = flags;
  sigaction(number, &action, nullptr);
}

}  // namespace

void end_cleanly_on_signals() {
  const std::lock_guard guard(mutex);
  transport::Participant::watch_forks();
  // Relaxed, all: the mutex orders the callers, and the handler needs the numbers only.
  if (process.load(std::memory_order_relaxed) != getpid()) {
    came_at.store(0, std::memory_order_relaxed);  // these are the parent's
    came.store(0, std::memory_order_relaxed);
    const detail::NoSignals quiet;
    try {
      std::thread(&wait_and_end).detach();
    } catch (const std::system_error& e) {
      throw Error(e.code().value(), "thread", "no thread to hear of signals",
                  segment::advice_on_threads());
    }
    process.store(getpid(), std::memory_order_relaxed);  // relaxed: as above
  }
  static const int registered = std::atexit(&await_end);
  static_cast<void>(registered);  // if it fails, the exit code is main()'s
  for (const int number : kSignals) install(number, &take, SA_RESTART);
}

StopToken stop_on_signals() {
  const std::lock_guard guard(mutex);
  // Relaxed: no handler runs before the system call that installs it.
  to_stop.store(&stopping(), std::memory_order_relaxed);
  for (const int number : kSignals) install(number, &stop, 0, &take);
  return stopping().get_token();
}

}  // namespace lot
