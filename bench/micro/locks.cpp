// SPDX-License-Identifier: Apache-2.0
#include <optional>
#include <pthread.h>
#include <thread>

#include "micro.hpp"
#include "robust_mutex/robust_mutex.hpp"

/// What the locks of slow paths cost, beside the C library's; and what a process pays to come.
namespace bench {
namespace {

class Owner final : public lot::LockOwner {
 public:
  std::uint32_t name() const noexcept override { return lot::lock::make_name(1, 1); }
  bool is_gone(std::uint32_t) noexcept override { return false; }
};

/// A mutex of the C library that does the same.
class Mutex {
 public:
  Mutex() {
    pthread_mutexattr_t attributes;
    pthread_mutexattr_init(&attributes);
    pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
    pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
    expect(pthread_mutex_init(&*memory_, &attributes) == 0, "a robust mutex");
    pthread_mutexattr_destroy(&attributes);
  }
  double lock_and_unlock(std::uint64_t count) {
    return time_ns(count, [&] {
      for (std::uint64_t n = 0; n < count; ++n) {
        expect(pthread_mutex_lock(&*memory_) == 0, "the mutex");
        pthread_mutex_unlock(&*memory_);
      }
    });
  }

 private:
  Shared<pthread_mutex_t> memory_;
};

void vs_pthread(benchmark::State& state) {
  constexpr std::uint64_t kCount = 20'000;
  pin(0);
  const Shared<lot::RobustMutex::Word> word;
  Owner owner;
  Mutex mutex;
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    rounds.run(
        [&] {
          return time_ns(kCount, [&] {
            lot::RobustMutex lock(*word, owner);
            for (std::uint64_t n = 0; n < kCount; ++n) {
              expect(lock.lock_for(1s) == lot::RobustMutex::Outcome::Locked, "the lock");
              lock.unlock();
            }
          });
        },
        [&] { return mutex.lock_and_unlock(kCount); });
  }
  rounds.report(state);
  unpin();
}

/// A process joins a segment in which another one lives; beside it, a thread that is begun and
/// ends: a floor that is the system's.
void join(benchmark::State& state) {
  Companion other([&](Companion& here) {
    lot::ShmEngine engine(segment());
    for (; here.hear() != Companion::kStop; here.meet()) {
    }
  });
  other.tell(1);
  other.meet();
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) {
    std::optional<lot::ShmEngine> engine;
    rounds.run([&] { return time_ns(1, [&] { engine.emplace(segment()); }); },
               [&] { return time_ns(1, [] { std::thread([] {}).join(); }); });
    engine.reset();
  }
  rounds.report(state);
}

}  // namespace

BENCHMARK(vs_pthread)->Name("locks/vs_pthread")->UseRealTime();
BENCHMARK(join)->Name("join/vs_thread")->UseRealTime();

}  // namespace bench
