// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <optional>
#include <utility>

#include <pybind11/pybind11.h>

#include "python/gil.hpp"
#include "python/part.hpp"
#include "python/waits.hpp"

namespace lot::python {

/// What a borrow() gives: for `with`.
class Borrow {
 public:
  explicit Borrow(std::shared_ptr<Held> held) : held_(std::move(held)) {}
  ~Borrow() { end(); }
  Borrow(Borrow&&) = default;
  Borrow& operator=(Borrow&&) = delete;

  pybind11::object message() const { return held_ ? to_object(Part(held_)) : pybind11::none(); }
  bool has_message() const noexcept { return held_ != nullptr; }
  void end() noexcept {
    if (held_) held_->end();
  }

 private:
  std::shared_ptr<Held> held_;  ///< null: nothing came
};

class Subscriber {
 public:
  explicit Subscriber(AnyPuller puller)
      : its_(std::make_shared<Subscription>(Subscription{std::move(puller)})) {}

  Borrow borrow(Seconds timeout) {
    const auto its = its_;  // also while the last reference goes in another thread
    AnyBorrow found;
    look(*its, timeout, [&](AnyPuller& puller, auto end) {
      found = end ? puller.borrow_until(Deadline(*end)) : puller.try_borrow();
    });
    return Borrow(found ? std::make_shared<Held>(std::move(found), its) : nullptr);
  }
  pybind11::object pull(Seconds timeout) {
    const auto its = its_;
    AnyMessage found;
    look(*its, timeout, [&](AnyPuller& puller, auto end) {
      found = end ? puller.pull_until(Deadline(*end)) : puller.try_pull();
    });
    if (!found) return pybind11::none();
    return to_object(Part(std::make_shared<Held>(std::move(found))));
  }
  AnyPuller& puller() const noexcept { return its_->puller; }
  const std::shared_ptr<Subscription>& subscription() const noexcept { return its_; }
  /// For what is asked of a puller beside its looks. Throws lot::Error (EBUSY).
  template <class F>
  auto ask(F&& f) const {
    const auto its = its_;
    const Use use(its->is_used, "subscriber");
    const Released release;
    return f(its->puller);
  }

 private:
  template <class Look>
  static void look(Subscription& its, Seconds timeout, Look&& take) {
    const Use use(its.is_used, "subscriber");
    if (timeout && *timeout <= 0) {
      const Released release;
      return take(its.puller, std::optional<Clock::time_point>());
    }
    wait(deadline_after(timeout), [&](Clock::time_point end) {
      take(its.puller, std::optional<Clock::time_point>(end));
      return its.puller.status();
    });
  }

  std::shared_ptr<Subscription> its_;
};

}  // namespace lot::python
