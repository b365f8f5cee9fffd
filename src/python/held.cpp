// SPDX-License-Identifier: Apache-2.0
#include "python/held.hpp"

#include <cerrno>
#include <cstring>
#include <exception>
#include <new>
#include <pthread.h>
#include <utility>

#include "lot/detail/mapping.hpp"
#include "lot/error.hpp"

namespace py = pybind11;

namespace lot::python {

Held::Held(AnyBorrow borrow, std::shared_ptr<Subscription> subscription)
    : state_(State::Borrowed),
      subscription_(std::move(subscription)),
      borrow_(std::move(borrow)),
      is_in_slot_(detail::Mapping::of(borrow_.data()) == nullptr) {}

void Held::require_open() const {
  if (state_ == State::Ended) {
    throw py::value_error(
        "the borrow or the task has ended, or the loan was pushed: the message is not here");
  }
}

Value Held::root() const {
  require_open();
  switch (state_) {
    case State::Borrowed:
      return borrow_.root();
    case State::Loan:
      return loan_.root().value();
    case State::Task:
      return task_.root();
    case State::Lent:
      return *lent_;
    default:
      return kept_.root();
  }
}

const AnyType& Held::type() const {
  require_open();
  switch (state_) {
    case State::Borrowed:
      return borrow_.type();
    case State::Loan:
      return loan_.type();
    case State::Task:
      return task_.type();
    case State::Lent:
      return lent_type_;
    default:
      return kept_.type();
  }
}

unsigned Held::forks() {
  static unsigned count = 0;
  static const int registered = pthread_atfork(nullptr, nullptr, [] { ++count; });
  if (registered != 0) throw std::bad_alloc();
  return count;
}

bool Held::can_change() const noexcept { return is_loan() && forks_ == forks(); }

MutableValue Held::building() const {
  require_open();
  if (!is_loan()) throw py::type_error("a received message is read-only");
  if (!can_change()) {
    throw Error(ECHILD, "loan", "it is of the parent of this process, which builds it",
                "make a new lot.Engine in the child, and a loan of its own");
  }
  return loan_.root();
}

const AnyLoan& Held::filling() {
  (void)building();
  grow();
  return loan_;
}

void Held::grow() {
  if (pins_ != 0) {
    throw py::buffer_error("views of this loan are alive (numpy, memoryview): delete them first");
  }
  ++generation_;
}

void Held::end() noexcept {
  const bool can_end = state_ == State::Borrowed || state_ == State::Task || state_ == State::Lent;
  if (!can_end) return;  // it has ended before, and a view may still have the borrow
  const bool is_seen = pins_ != 0 && !is_in_slot_;
  const State before = std::exchange(state_, State::Ended);
  try {
    if (before == State::Borrowed && is_seen) kept_ = borrow_.keep();
    if (before == State::Task && is_seen) kept_ = task_.keep();
  } catch (const std::exception&) {
    return;  // it may not be kept: the borrow goes on until the last view has gone
  }
  borrow_.end();
  task_.give_back();
}

void Held::finish() {
  require_open();
  if (state_ != State::Task) throw py::type_error("the message is no task");
  if (pins_ != 0) kept_ = task_.keep();
  task_.finish();
  state_ = State::Ended;
}

AnyLoan Held::take_loan() {
  require_open();
  if (!is_loan()) throw py::type_error("the message is no loan");
  grow();
  state_ = State::Ended;
  return std::move(loan_);
}

void Held::give_back(AnyLoan loan) noexcept {
  loan_ = std::move(loan);
  state_ = State::Loan;
}

AnyMessage Held::share() const {
  require_open();
  switch (state_) {
    case State::Kept:
      return kept_;
    case State::Borrowed:
      return borrow_.keep();
    case State::Task:
      return task_.keep();
    default:
      throw py::type_error(
          "the message is a loan, which lot.share() finishes, or of a recording, which "
          "copy_to() brings into a loan");
  }
}

const std::byte* Held::pin(const std::byte* place) {
  if (!is_in_slot_) {
    ++pins_;
    return place;
  }
  // The puller's next look writes over the message.
  const std::size_t size = borrow_.type().size();
  const auto* const message = static_cast<const std::byte*>(borrow_.data());
  if (copy_ == nullptr) {
    copy_ = std::make_unique<std::byte[]>(size);
    std::memcpy(copy_.get(), message, size);
  }
  ++pins_;
  return copy_.get() + (place - message);
}

void Held::unpin() noexcept {
  if (--pins_ != 0 || state_ != State::Ended) return;
  borrow_.end();
  task_.give_back();
  kept_.reset();
}

}  // namespace lot::python
