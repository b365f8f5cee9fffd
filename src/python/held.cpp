// SPDX-License-Identifier: Apache-2.0
#include "python/held.hpp"

#include <cstring>
#include <exception>
#include <utility>

#include "lot/detail/mapping.hpp"

namespace py = pybind11;

namespace lot::python {

Held::Held(AnyBorrow borrow, std::shared_ptr<Subscription> subscription)
    : state_(State::Borrowed),
      subscription_(std::move(subscription)),
      borrow_(std::move(borrow)),
      is_in_slot_(detail::Mapping::of(borrow_.data()) == nullptr) {}

void Held::require_open() const {
  if (state_ == State::Ended) {
    throw py::value_error("the borrow has ended, or the loan was pushed: the message is not here");
  }
}

Value Held::root() const {
  require_open();
  if (state_ == State::Kept) return kept_.root();
  return state_ == State::Borrowed ? borrow_.root() : loan_.root().value();
}

const Description& Held::description() const {
  require_open();
  if (state_ == State::Kept) return kept_.type().description();
  return (state_ == State::Borrowed ? borrow_.type() : loan_.type()).description();
}

MutableValue Held::building() const {
  require_open();
  if (!is_loan()) throw py::type_error("a received message is read-only");
  return loan_.root();
}

void Held::grow() {
  if (pins_ != 0) {
    throw py::buffer_error("views of this loan are alive (numpy, memoryview): delete them first");
  }
  ++generation_;
}

void Held::end() noexcept {
  if (state_ != State::Borrowed) return;
  state_ = State::Ended;
  if (pins_ != 0 && !is_in_slot_) {
    try {
      kept_ = borrow_.keep();
    } catch (const std::exception&) {
      return;  // it may not be kept: the borrow goes on until the last view has gone
    }
  }
  borrow_.end();
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
  if (is_loan()) throw py::type_error("the message is a loan: push it first");
  return state_ == State::Kept ? kept_ : borrow_.keep();
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
  kept_.reset();
}

}  // namespace lot::python
