// SPDX-License-Identifier: Apache-2.0
#include "lot/signals.hpp"

#include <atomic>
#include <cerrno>
#include <csignal>
#include <mutex>
#include <sys/eventfd.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include "lot/error.hpp"

#include "transport/participant.hpp"

namespace lot {
namespace {

constexpr int kSignals[] = {SIGINT, SIGTERM, SIGHUP};

std::mutex mutex;
// What the handler uses. Relaxed: they are written before it is installed.
std::atomic<pid_t> process{0};  ///< that has the thread
std::atomic<int> bell{-1};      ///< an eventfd on which the thread sleeps
std::atomic<int> came{0};       ///< the first signal

/// Only what a signal handler may do.
void take(int number) {
  const int error = errno;
  int none = 0;
  if (getpid() == process.load(std::memory_order_relaxed) &&
      came.compare_exchange_strong(none, number, std::memory_order_relaxed)) {
    eventfd_write(bell.load(std::memory_order_relaxed), 1);
  } else {  // a child, which has no such thread; or it takes too long
    std::signal(number, SIG_DFL);
    raise(number);  // it comes when this handler has returned
  }
  errno = error;
}

/// The process ends as by default.
[[noreturn]] void end(int number) {
  std::signal(number, SIG_DFL);
  sigset_t its;
  sigemptyset(&its);
  sigaddset(&its, number);
  pthread_sigmask(SIG_UNBLOCK, &its, nullptr);
  raise(number);
  _exit(128 + number);  // the first process of a container has no default
}

void wait_and_end(int ears) {
  pthread_setname_np(pthread_self(), "lot-signals");
  eventfd_t count;
  while (eventfd_read(ears, &count) == -1 && errno == EINTR) {
  }
  transport::Participant::remove_files();
  end(came.load(std::memory_order_relaxed));
}

void install(int number) {
  struct sigaction action {};
  if (sigaction(number, nullptr, &action) != 0) return;
  if ((action.sa_flags & SA_SIGINFO) != 0 || action.sa_handler != SIG_DFL) return;
  action.sa_handler = &take;
  action.sa_flags = SA_RESTART;
  sigaction(number, &action, nullptr);
}

}  // namespace

void end_cleanly_on_signals() {
  const std::lock_guard guard(mutex);
  if (process.load(std::memory_order_relaxed) != getpid()) {
    // In a child: the parent's descriptor.
    if (const int theirs = bell.exchange(-1, std::memory_order_relaxed); theirs != -1) {
      close(theirs);
    }
    const int mine = eventfd(0, EFD_CLOEXEC);
    if (mine == -1) {
      throw Error(errno, "eventfd", "no descriptor to hear of signals by",
                  "close descriptors, or raise the limit (ulimit -n)");
    }
    // The thread takes no signals: it inherits the mask.
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    try {
      std::thread([mine] { wait_and_end(mine); }).detach();
    } catch (const std::system_error& e) {
      pthread_sigmask(SIG_SETMASK, &before, nullptr);
      close(mine);
      throw Error(e.code().value(), "thread", "no thread to hear of signals",
                  "raise the limit of threads (ulimit -u)");
    }
    came.store(0, std::memory_order_relaxed);
    bell.store(mine, std::memory_order_relaxed);
    process.store(getpid(), std::memory_order_relaxed);
    pthread_sigmask(SIG_SETMASK, &before, nullptr);
  }
  for (const int number : kSignals) install(number);
}

}  // namespace lot
