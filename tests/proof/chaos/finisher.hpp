// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <deque>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "lot/lot.hpp"

#include "deliveries.hpp"
#include "job.hpp"
#include "life.hpp"
#include "plan.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

/// Takes tasks, works on them and finishes them. Some it keeps for later, also beyond its handle;
/// some it cannot do, and lets go.
template <class T>
class Finisher final : public Job {
 public:
  Finisher(Life& life, ShmEngine& engine, std::uint32_t topic)
      : life_(life),
        engine_(engine),
        topic_(topic),
        plan_(reading(life.random, Role::Finish)),
        longest_work_(std::array{0us, 400us, 3000us}[life.random.below(3)]),
        fail_percent_(std::array{0U, 5U, 30U}[life.random.below(3)]),
        deliveries_(life, topic) {
    join();
  }
  ~Finisher() override {
    leave();
    let_go(0);
  }

  void turn() override {
    if (life_.random.chance(plan_.rejoin_percent)) {
      leave();
      join();
    }
    for (unsigned n = 0; n < 16; ++n) {
      if (!take_one(n == 0)) break;
    }
    // A finisher that spins leaves the processor to others all the same.
    if (plan_.options.wait != Wait::Park) std::this_thread::sleep_for(1ms);
  }
  void quiet() override { turn(); }
  bool settle() override {
    let_go(0);
    return !take_one(false);
  }

 private:
  using Style = Reading::Style;
  using Task = ShmTask<T>;
  struct CannotDo {};

  void join() {
    life_.doing(Doing::Subscribing, topic_);
    QueueOptions options;
    options.wait = plan_.options.wait;
    options.redeliver = true;
    queue_.emplace(engine_.queue<ShmUniquePtr<T>>(kTopic[topic_].name, options));
    queue_->listen();
    life_.me.pullers[topic_].fetch_add(1);
    life_.count(Count::Subscribed);
  }
  void leave() {
    if (!queue_) return;
    life_.doing(Doing::Closing, topic_);
    life_.me.pullers[topic_].fetch_sub(1);
    queue_.reset();
  }

  bool take_one(bool wait) {
    const bool waits = wait && plan_.style != Style::TryBorrow && plan_.style != Style::TryPull;
    life_.doing(Doing::Looking, topic_);
    if (wait && !waits) std::this_thread::sleep_for(plan_.patience);
    life_.me.taking.store(Life::now());
    Task task = waits ? queue_->wait_and_take_for(plan_.patience) : queue_->try_take();
    if (task) got(task);
    life_.me.taking.store(0);
    if (!task) {
      if (life_.random.chance(10)) let_go(0);  // its putter may have room for no more
      return false;
    }
    life_.count(Count::Received);
    kept_.push_back(std::move(task));
    let_go(life_.random.chance(plan_.keep_percent) ? plan_.most_kept : 0);
    return true;
  }

  void got(const Task& task) {
    const std::uint32_t deliveries = task.deliveries();
    const bool tells_less = life_.has(Plant::Recount) && deliveries > 1;
    deliveries_.got(task->stamp, tells_less ? deliveries - 1 : deliveries);
  }

  void let_go(std::size_t rest) {
    while (kept_.size() > rest) {
      Task task = std::move(kept_.front());
      kept_.pop_front();
      try {
        finish(std::move(task));
      } catch (const CannotDo&) {
        life_.count(Count::GivenBack);
      }
    }
  }
  void finish(Task task) {
    life_.doing(Doing::Reading, topic_);
    const Stamp stamp = task->stamp;
    work(*task);
    life_.doing(Doing::Finishing, topic_);
    // When all come to rest, some finisher has done each task.
    if (life_.stage() != Stage::Settle && life_.random.chance(fail_percent_)) {
      deliveries_.before_give_back(stamp);
      throw CannotDo();
    }
    if (life_.has(Plant::Forget, 5)) return task.finish();
    if (life_.has(Plant::Share, 5)) task.give_back();
    deliveries_.before_finish(stamp);
    task.finish();
    deliveries_.finished(stamp);
    life_.count(Count::Finished);
  }
  /// The task is the same before and after it.
  void work(const T& task) {
    if (const std::string w = wrong(task); !w.empty()) torn(w, task.stamp);
    std::this_thread::sleep_for(life_.random.between(0us, longest_work_));
    if (life_.random.chance(plan_.linger_percent)) {
      std::this_thread::sleep_for(life_.random.between(50us, plan_.longest_linger));
    }
    if (const std::string w = wrong(task); !w.empty()) torn(w, task.stamp);
  }
  [[noreturn]] void torn(const std::string& what, const Stamp& s) {
    life_.fail(Finding::Torn, std::string(kTopic[topic_].name) + ": " + what + " (incarnation " +
                                  std::to_string(s.incarnation) + " number " +
                                  std::to_string(s.number) + ")");
  }

  Life& life_;
  ShmEngine& engine_;
  std::uint32_t topic_;
  Reading plan_;
  std::chrono::microseconds longest_work_;
  unsigned fail_percent_;  ///< of tasks that it cannot do
  Deliveries deliveries_;
  std::optional<ShmQueue<ShmUniquePtr<T>>> queue_;
  std::deque<Task> kept_;
};

}  // namespace lot::chaos
