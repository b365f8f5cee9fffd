// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "lot/any_message.hpp"
#include "lot/any_puller.hpp"
#include "lot/any_pusher.hpp"
#include "lot/any_type.hpp"
#include "lot/engine.hpp"
#include "lot/lot.h"
#include "lot/stop_token.hpp"

/// What the handles of C lead to. All of it is private memory: nothing in the segment knows of it.

struct lot_engine {
  lot::ShmEngine engine;
};

struct lot_type {
  explicit lot_type(lot::AnyType its) : type(std::move(its)) {}

  lot::AnyType type;
  std::once_flag is_encoded;
  std::string bytes;  ///< of lot_type_encode()
};

struct lot_stop {
  std::optional<lot::StopSource> source;  ///< none: the signals'
  lot::StopToken token;
};

struct lot_publisher {
  lot::AnyPusher pusher;
  std::shared_ptr<const lot_type> type;
};

/// A message: borrowed, kept, or the reading side of a loan.
struct lot_message {
  /// Throws lot::Error.
  lot::Value root() const {
    if (loan != nullptr) return loan->root().value();
    return kept ? kept.root() : borrow.root();
  }
  const void* data() const noexcept {
    if (loan != nullptr) return loan->data();
    return kept ? kept.pointer().get() : borrow.data();
  }

  /// Of a borrowed one: it is in the subscription's queue until the borrow ends, which comes first.
  /// A kept one leaves its subscriber alone, so that no publisher waits for one that was closed.
  std::shared_ptr<lot::AnyPuller> puller = nullptr;
  lot::AnyBorrow borrow = {};
  lot::AnyMessage kept = {};
  const lot::AnyLoan* loan = nullptr;
  std::shared_ptr<const lot_type> type = nullptr;
};

struct lot_loan {
  lot::AnyLoan loan;
  lot_message message;
};

struct lot_subscriber {
  std::shared_ptr<lot::AnyPuller> puller;
  std::shared_ptr<const lot_type> type;
};

namespace lot::c_interface {

/// A copy: a program may release its handle while another thread waits by it.
inline StopToken token_of(const lot_stop* stop) {
  return stop != nullptr ? stop->token : StopToken();
}

/// A message of one's own: shares a kept one, keeps a borrowed one. Throws lot::Error: EINVAL for a
/// loan; as AnyBorrow::keep().
AnyMessage kept(const lot_message& message);

}  // namespace lot::c_interface
