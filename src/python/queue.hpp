// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <utility>

#include <pybind11/pybind11.h>

#include "lot/any_queue.hpp"

#include "python/part.hpp"
#include "python/waits.hpp"

namespace lot::python {

/// What a take() gives: for `with`. It is finished at the end of that, but goes back where an
/// exception passes.
class Task {
 public:
  explicit Task(AnyTask task) : held_(task ? std::make_shared<Held>(std::move(task)) : nullptr) {}
  ~Task() { give_back(); }
  Task(Task&&) = default;
  Task& operator=(Task&&) = delete;

  /// False: nothing came.
  bool has_item() const noexcept { return held_ != nullptr; }
  bool is_open() const noexcept { return held_ && held_->is_open(); }
  /// Throws ValueError where nothing came.
  Part item() const { return Part(held()); }
  std::uint32_t deliveries() const noexcept { return held_ ? held_->deliveries() : 0; }
  /// Throws ValueError after its end, lot::Error.
  void finish() { held()->finish(); }
  void give_back() noexcept {
    if (held_) held_->end();
  }

 private:
  const std::shared_ptr<Held>& held() const {
    if (!held_) throw pybind11::value_error("no task came");
    return held_;
  }

  std::shared_ptr<Held> held_;  ///< null: nothing came
};

/// Threads: any, under the GIL.
class Queue {
 public:
  /// `may_wait`: a put waits for a place, as Policy::Block says.
  Queue(AnyQueue queue, bool may_wait)
      : its_(std::make_shared<AnyQueue>(std::move(queue))), may_wait_(may_wait) {}

  pybind11::object loan(const pybind11::kwargs& fields);
  /// False: the queue is full, and the item is still the caller's.
  bool put(const Part& part, Seconds timeout);
  pybind11::object pop(Seconds timeout);
  Task take(Seconds timeout);
  /// Outlives the calls that use it.
  const std::shared_ptr<AnyQueue>& its() const noexcept { return its_; }

 private:
  std::shared_ptr<AnyQueue> its_;
  bool may_wait_;
};

void define_queue(pybind11::module_& module);

}  // namespace lot::python
