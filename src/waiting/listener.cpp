// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <memory>
#include <mutex>
#include <sched.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include "lot/detail/mutex.hpp"
#include "lot/detail/no_signals.hpp"
#include "lot/wait_set.hpp"

#include "segment/system_limits.hpp"

namespace lot {
namespace {

/// The listener pauses this long after an error, since it may come again at once.
constexpr std::chrono::milliseconds kAfterError{10};

/// Gives the calling thread the name, cores and priority that `options` names. Throws lot::Error.
void become(const ThreadOptions& options) {
  pthread_setname_np(pthread_self(), options.name.substr(0, 15).c_str());
  if (!options.cpus.empty()) {
    cpu_set_t cpus;
    CPU_ZERO(&cpus);
    for (const unsigned cpu : options.cpus) {
      if (cpu < CPU_SETSIZE) CPU_SET(cpu, &cpus);
    }
    if (const int error = pthread_setaffinity_np(pthread_self(), sizeof(cpus), &cpus)) {
      throw Error(error, "ThreadOptions::cpus", "the listener's thread cannot run on these",
                  "name cores that there are, and that the process may use (taskset -p)");
    }
  }
  if (options.policy != SCHED_OTHER || options.priority != 0) {
    sched_param parameters{};
    parameters.sched_priority = options.priority;
    if (const int error = pthread_setschedparam(pthread_self(), options.policy, &parameters)) {
      throw Error(error, "ThreadOptions::policy",
                  "the listener's thread cannot be scheduled like this",
                  "use a priority of the policy (chrt -m); real-time ones need CAP_SYS_NICE or "
                  "a limit (ulimit -r)");
    }
  }
}

}  // namespace

struct ShmListener::Impl {
  WaitSet set;
  ThreadOptions options;
  detail::Mutex mutex{detail::Rank::Listener};
  detail::Condition begun;
  bool has_begun = false;
  std::exception_ptr refused;
  const pid_t process = getpid();
  std::unique_ptr<std::thread> thread;

  explicit Impl(Wait wait) : set(wait) {}
  ~Impl() {
    if (getpid() != process) {
      (void)thread.release();  // a forked child has no such thread
      return;
    }
    set.stop();
    if (thread) thread->join();
  }

  void run() {
    {
      const std::lock_guard guard(mutex);
      try {
        become(options);
      } catch (const Error&) {
        refused = std::current_exception();
      }
      has_begun = true;
      begun.notify_all();
    }
    if (refused) return;
    for (bool again = true; again;) {
      again = false;
      try {
        set.run();
      } catch (const Error& error) {
        again = true;
        report(error);
        std::this_thread::sleep_for(kAfterError);
      }
    }
  }

  void report(const Error& error) {
    if (options.on_error) {
      options.on_error(error);
    } else {
      std::fprintf(stderr, "%s: %s\n", options.name.c_str(), error.what());
    }
  }
};

void ShmListener::start(detail::Waitable& waitable, std::function<void()> on_ready, Wait wait,
                        const ThreadOptions& thread) {
  impl_ = std::make_shared<Impl>(wait);
  Impl& impl = *impl_;
  impl.options = thread;
  impl.set.add(waitable, std::move(on_ready));
  try {
    const detail::NoSignals quiet;
    impl.thread = std::make_unique<std::thread>([&impl] { impl.run(); });
  } catch (const std::system_error& e) {
    throw Error(e.code().value(), "thread", "no thread for a listener",
                segment::advice_on_threads());
  }
  std::unique_lock lock(impl.mutex);
  impl.begun.wait(lock, [&impl] { return impl.has_begun; });
  if (impl.refused) {
    lock.unlock();
    std::rethrow_exception(impl.refused);
  }
}
ShmListener::~ShmListener() = default;
ShmListener::ShmListener(ShmListener&&) noexcept = default;
ShmListener& ShmListener::operator=(ShmListener&&) noexcept = default;

}  // namespace lot
