// SPDX-License-Identifier: Apache-2.0
/// One queue of tasks, shared by worker processes; one of them is killed in the midst of its work.
/// The others go on, and do what it had in hand: a task is there until its worker has finished it.
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <set>
#include <thread>
#include <vector>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

using namespace std::chrono_literals;

struct Task {
  std::uint32_t number = 0;
  lot::ShmVector<std::uint32_t> numbers;  ///< to be added up
};
struct Result {
  std::uint32_t number;
  std::uint64_t sum;
};

constexpr std::uint32_t kTasks = 400;
constexpr std::uint32_t kNumbers = 1000;

using Tasks = lot::ShmQueue<lot::ShmUniquePtr<Task>>;  // each is for one worker
using Results = lot::ShmQueue<Result>;                 // by value

void put(Tasks& tasks, std::uint32_t number) {
  auto task = tasks.make();
  task->number = number;
  task->numbers.assign(kNumbers, number);
  (void)tasks.put(std::move(task));  // waits for a place: never Full
}

lot::QueueOptions until_finished() {
  lot::QueueOptions options;
  options.depth = kTasks;  // nobody waits for room
  options.redeliver = true;
  return options;
}
lot::QueueOptions room_for_all() {
  lot::QueueOptions options;
  options.depth = kTasks;  // nobody waits for room
  return options;
}

bool worker() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C, and SIGTERM of main()
  lot::ShmEngine engine;
  auto tasks = engine.queue<lot::ShmUniquePtr<Task>>("tasks", until_finished());
  auto results = engine.queue<Result>("results", room_for_all());
  while (lot::ShmTask<Task> task = tasks.wait_and_take(stop)) {
    std::this_thread::sleep_for(1ms);  // hard work
    Result result{task->number, 0};
    for (const std::uint32_t n : task->numbers) result.sum += n;
    (void)results.put(result);  // there is room for all
    task.finish();              // killed before: the next worker does it (again)
  }
  return true;
}

bool supervisor(std::vector<pid_t>& workers) {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  auto tasks = engine.queue<lot::ShmUniquePtr<Task>>("tasks", until_finished());
  auto results = engine.queue<Result>("results");
  results.listen();
  for (std::uint32_t n = 1; n <= kTasks; ++n) put(tasks, n);

  std::set<std::uint32_t> done;
  bool right = true;
  const auto wait_for = [&](std::size_t count) {  // false: Ctrl-C
    while (done.size() < count) {
      const auto result = results.wait_and_pop(stop);
      if (!result) break;
      right &= result->sum == std::uint64_t{kNumbers} * result->number;
      done.insert(result->number);
    }
    return done.size() >= count;
  };
  if (!wait_for(kTasks / 4)) return false;
  kill(workers.back(), SIGKILL);
  example::finish(workers.back());
  workers.pop_back();
  std::printf("%zu tasks were done when a worker was killed\n", done.size());

  if (!wait_for(kTasks)) return false;
  std::printf("the others have done all %zu, and all sums are %s\n", done.size(),
              right ? "right" : "WRONG");
  return right;
}

}  // namespace

int main() {
  return example::run("workers", [] {
    std::vector<pid_t> workers;
    while (workers.size() < 3) workers.push_back(example::start("worker", worker));
    const bool good = supervisor(workers);
    for (const pid_t worker : workers) kill(worker, SIGTERM);
    for (const pid_t worker : workers) example::finish(worker);
    return good;
  });
}
