// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

#include <pybind11/pybind11.h>

#include "lot/any_message.hpp"
#include "lot/any_puller.hpp"
#include "lot/any_pusher.hpp"
#include "lot/any_queue.hpp"
#include "lot/value.hpp"

namespace lot::python {

/// A puller, and whether a thread looks by it just now.
struct Subscription {
  AnyPuller puller;
  bool is_used = false;
};

/// The message that parts and views of Python lead to: kept, borrowed, loaned, a task, or lent by
/// a recording.
///
/// Invariants
///   - Memory that a view looks at stays what it is until the last view has gone: `pins_` counts
///     them. A message that is pinned is not published, does not grow, and is kept when its borrow
///     ends.
///   - After the end no part reads the message.
///
/// Threads: under the GIL.
class Held {
 public:
  explicit Held(AnyMessage message) : state_(State::Kept), kept_(std::move(message)) {}
  Held(AnyBorrow borrow, std::shared_ptr<Subscription> subscription);
  explicit Held(AnyLoan loan) : state_(State::Loan), loan_(std::move(loan)) {}
  explicit Held(AnyTask task) : state_(State::Task), task_(std::move(task)) {}
  /// A message in private memory, which is there until end(): no view may outlive that.
  Held(const Value& value, AnyType type)
      : state_(State::Lent),
        lent_(std::make_unique<const Value>(value)),
        lent_type_(std::move(type)) {}
  Held(const Held&) = delete;
  Held& operator=(const Held&) = delete;

  bool is_loan() const noexcept { return state_ == State::Loan; }
  /// It is a loan of this process, not of a parent.
  bool can_change() const noexcept;
  /// Changes when parts of a loan may have moved.
  std::uint64_t generation() const noexcept { return generation_; }
  /// Throws ValueError after the end, lot::Error.
  void require_open() const;
  Value root() const;
  const AnyType& type() const;
  const Description& description() const { return type().description(); }
  /// Throws TypeError where it is no loan, ValueError after the end, lot::Error.
  MutableValue building() const;
  /// The same, which may be filled: it grows. Throws the same, and BufferError.
  const AnyLoan& filling();
  bool is_open() const noexcept { return state_ != State::Ended; }
  /// Before a loan grows: its parts may move. Throws BufferError where views look at it.
  void grow();

  /// The end of a borrow, of a task, which goes back, and of what is lent; of anything else
  /// nothing.
  void end() noexcept;
  /// The end of a task that is done. Throws TypeError where it is none, ValueError, lot::Error.
  void finish();
  std::uint32_t deliveries() const noexcept { return task_.deliveries(); }
  /// Has a reference in the loan refer to a message; none: to nothing. Throws lot::Error.
  void refer(const MutableValue& reference, const AnyMessage& target) const {
    loan_.refer(reference, target);
  }
  /// Takes the loan for a push. Throws BufferError, TypeError, ValueError.
  AnyLoan take_loan();
  /// After a push that has not published it.
  void give_back(AnyLoan loan) noexcept;
  /// The message, to be published or kept as well. Throws TypeError for a loan, lot::Error.
  AnyMessage share() const;

  /// A view begins: where it shall look for what lies at that place of the message. Throws
  /// std::bad_alloc.
  const std::byte* pin(const std::byte* place);
  void unpin() noexcept;

 private:
  /// How many forks made this process, of those since it began to count.
  static unsigned forks();

  enum class State { Kept, Borrowed, Loan, Task, Lent, Ended };

  State state_;
  AnyMessage kept_;
  std::shared_ptr<Subscription> subscription_;  ///< outlives the borrow
  AnyBorrow borrow_;
  AnyLoan loan_;
  AnyTask task_;
  std::unique_ptr<const Value> lent_;  ///< apart: it is large, and few have one
  AnyType lent_type_;
  bool is_in_slot_ = false;            ///< borrowed: the message is a copy in the puller's memory
  std::unique_ptr<std::byte[]> copy_;  ///< of that, for views
  std::size_t pins_ = 0;
  std::uint64_t generation_ = 0;
  unsigned forks_ = forks();
};

}  // namespace lot::python
