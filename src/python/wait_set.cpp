// SPDX-License-Identifier: Apache-2.0
#include "python/wait_set.hpp"

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include <pybind11/stl.h>

#include "lot/stop_token.hpp"
#include "lot/wait_set.hpp"

#include "python/queue.hpp"
#include "python/subscriber.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

using Number = std::uint64_t;

/// Waits for many ends and timers at once, each of which has a number.
///
/// Threads: under the GIL. wait() leaves it: a thread that comes meanwhile with anything but stop()
///          gets lot::Error (EBUSY).
class Waits {
 public:
  explicit Waits(Wait wait) : set_(wait) {}
  ~Waits() {
    for (auto& [number, its] : subscriptions_) set_.remove(its->puller);
    for (auto& [number, its] : queues_) set_.remove(*its);
  }
  Waits(const Waits&) = delete;
  Waits& operator=(const Waits&) = delete;

  void add_subscriber(Number number, const Subscriber& end) {
    const Use use(is_used_, "wait set");
    set_.add(end.puller(), news_of(number));
    subscriptions_.emplace(number, end.subscription());
  }
  void add_queue(Number number, const Queue& end) {
    const Use use(is_used_, "wait set");
    set_.add(*end.its(), news_of(number));
    queues_.emplace(number, end.its());
  }
  void add_timer(Number number, double seconds, bool again) {
    const Use use(is_used_, "wait set");
    const std::chrono::duration<double> time(seconds);
    timers_.emplace(number, again ? set_.add_timer(time, news_of(number))
                                  : set_.add_timer_once(time, news_of(number)));
  }
  void remove(Number number) {
    const Use use(is_used_, "wait set");
    if (const auto its = subscriptions_.find(number); its != subscriptions_.end()) {
      set_.remove(its->second->puller);
      subscriptions_.erase(its);
    } else if (const auto queue = queues_.find(number); queue != queues_.end()) {
      set_.remove(*queue->second);
      queues_.erase(queue);
    } else if (const auto timer = timers_.find(number); timer != timers_.end()) {
      set_.remove(timer->second);
      timers_.erase(timer);
    }
  }
  /// The numbers that have news; none: the time is up. Nothing: stop() was called.
  std::optional<std::vector<Number>> wait(Seconds timeout) {
    const Use use(is_used_, "wait set");
    std::vector<std::unique_ptr<Use>> uses;
    for (const auto& [number, its] : subscriptions_) {
      uses.push_back(std::make_unique<Use>(its->is_used, "subscriber"));
    }
    news_.clear();
    const StopToken stop = stop_.get_token();
    const Status said = lot::python::wait(deadline_after(timeout), [&](Clock::time_point end) {
      set_.run_once_until(Deadline(end), stop);
      if (!news_.empty()) return Status::Ok;
      return stop.stop_requested() ? Status::Stopped : Status::Timeout;
    });
    if (said != Status::Stopped) return std::move(news_);
    stop_ = StopSource();
    return std::nullopt;
  }
  void stop() noexcept { stop_.request_stop(); }

 private:
  WaitSet::Handler news_of(Number number) {
    return [this, number] { news_.push_back(number); };
  }
  WaitSet set_;
  std::map<Number, std::shared_ptr<Subscription>> subscriptions_;
  std::map<Number, std::shared_ptr<AnyQueue>> queues_;
  std::map<Number, WaitSet::Timer> timers_;
  std::vector<Number> news_;
  StopSource stop_;
  bool is_used_ = false;
};

}  // namespace

void define_wait_set(py::module_& module) {
  py::class_<Waits>(module, "_Waits")
      .def(py::init<Wait>())
      .def("add", &Waits::add_subscriber)
      .def("add", &Waits::add_queue)
      .def("add_timer", &Waits::add_timer)
      .def("remove", &Waits::remove)
      .def("wait", &Waits::wait)
      .def("stop", &Waits::stop);
}

}  // namespace lot::python
