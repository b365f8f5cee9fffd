// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstring>
#include <memory>
#include <utility>

#include "lot/any_puller.hpp"

#include "c_interface/errors.hpp"
#include "c_interface/handles.hpp"

namespace lot::c_interface {
namespace {

static_assert(LOT_PARK == static_cast<int>(Wait::Park));

PullerOptions options_of(const lot_subscriber_options* given) {
  PullerOptions options;
  if (given == nullptr) return options;
  options.wait = static_cast<Wait>(given->wait);
  options.history = given->history;
  options.max_held_bytes = given->max_held_bytes;
  options.observer = given->observer;
  return options;
}

/// Looks for a message: by now(), in(timeout, token) or forever(token) of the puller. None if the
/// token has stopped: then nothing was taken.
template <class Now, class In, class Forever>
auto look(int64_t timeout, const StopToken& token, Now&& now, In&& in, Forever&& forever) {
  if (timeout == LOT_FOREVER) return forever(token);
  return timeout > 0 ? in(std::chrono::nanoseconds(timeout), token) : now();
}

/// Calls take(puller, token, message), which fills the message if there is one.
template <class F>
int next(lot_subscriber* subscriber, int64_t timeout, lot_stop* stop, lot_message** message,
         F&& take) {
  return guarded([&] {
    require(subscriber, "subscriber");
    require(message, "message");
    const StopToken token = token_of(stop);
    if (timeout <= 0 && token.stop_requested()) {
      *message = nullptr;
      return int{LOT_STOPPED};
    }
    AnyPuller& puller = *subscriber->puller;
    // Before the message is taken: a lack of memory loses none.
    auto made = std::make_unique<lot_message>();
    made->type = subscriber->type;
    *message = take(puller, token, *made) ? made.release() : nullptr;
    return status(puller.status());
  });
}

}  // namespace

AnyMessage kept(const lot_message& message) {
  if (message.loan != nullptr) {
    throw Error(EINVAL, message.type->type.name(), "the message is a loan, which is not published",
                "push the loan");
  }
  return message.kept ? message.kept : message.borrow.keep();
}

}  // namespace lot::c_interface

using lot::c_interface::guarded;
using lot::c_interface::look;
using lot::c_interface::next;
using lot::c_interface::require;
using lot::c_interface::text_of;

extern "C" {

lot_subscriber_options lot_subscriber_defaults(void) {
  const lot::PullerOptions options;
  return {static_cast<lot_wait>(options.wait), options.history, options.max_held_bytes,
          options.observer};
}

int lot_subscribe(lot_engine* engine, const char* topic, const lot_type* type,
                  const lot_subscriber_options* options, lot_subscriber** subscriber) {
  return guarded([&] {
    require(engine, "engine");
    require(subscriber, "subscriber");
    const std::string_view name = text_of(topic, "topic");
    const lot::PullerOptions its = lot::c_interface::options_of(options);
    lot::ShmEngine& shared = engine->engine;
    auto puller = std::make_shared<lot::AnyPuller>(
        type == nullptr ? shared.subscribe_any(name, its)
                        : shared.subscribe_any(name, type->type, its));
    auto its_type = std::make_shared<const lot_type>(puller->type());
    *subscriber = new lot_subscriber{std::move(puller), std::move(its_type)};
    return LOT_OK;
  });
}

void lot_subscriber_close(lot_subscriber* subscriber) { delete subscriber; }

const lot_type* lot_subscriber_type(const lot_subscriber* subscriber) {
  return subscriber->type.get();
}

int lot_borrow(lot_subscriber* subscriber, int64_t timeout, lot_stop* stop, lot_message** message) {
  return next(subscriber, timeout, stop, message,
              [&](lot::AnyPuller& puller, const lot::StopToken& token, lot_message& found) {
                found.borrow = look(
                    timeout, token, [&] { return puller.try_borrow(); },
                    [&](auto time, const auto& its) { return puller.borrow(time, its); },
                    [&](const auto& its) { return puller.borrow(its); });
                found.puller = subscriber->puller;
                return static_cast<bool>(found.borrow);
              });
}

int lot_pull(lot_subscriber* subscriber, int64_t timeout, lot_stop* stop, lot_message** message) {
  return next(subscriber, timeout, stop, message,
              [&](lot::AnyPuller& puller, const lot::StopToken& token, lot_message& found) {
                found.kept = look(
                    timeout, token, [&] { return puller.try_pull(); },
                    [&](auto time, const auto& its) { return puller.pull(time, its); },
                    [&](const auto& its) { return puller.pull(its); });
                return static_cast<bool>(found.kept);
              });
}

int lot_subscriber_envelope(lot_subscriber* subscriber, lot_envelope* envelope) {
  return guarded([&] {
    require(subscriber, "subscriber");
    require(envelope, "envelope");
    const lot::Envelope its = subscriber->puller->envelope();
    lot_envelope told = {};
    told.sequence = its.sequence;
    told.missed = its.missed;
    told.publisher_id = its.publisher_id;
    told.pushed =
        its.pushed ? std::chrono::nanoseconds(its.pushed->time_since_epoch()).count() : -1;
    std::memcpy(told.publisher, its.publisher.data(),
                std::min(its.publisher.size(), sizeof told.publisher - 1));
    *envelope = told;
    return LOT_OK;
  });
}

uint64_t lot_subscriber_missed(const lot_subscriber* subscriber) {
  return subscriber->puller->missed_total();
}

int lot_subscriber_publishers(lot_subscriber* subscriber, size_t* count) {
  return guarded([&] {
    require(subscriber, "subscriber");
    require(count, "count");
    *count = subscriber->puller->publishers();
    return LOT_OK;
  });
}

int lot_subscriber_size(lot_subscriber* subscriber, size_t* count) {
  return guarded([&] {
    require(subscriber, "subscriber");
    require(count, "count");
    *count = subscriber->puller->size();
    return LOT_OK;
  });
}

int lot_subscriber_fd(lot_subscriber* subscriber, int* fd) {
  return guarded([&] {
    require(subscriber, "subscriber");
    require(fd, "fd");
    *fd = subscriber->puller->fd();
    return LOT_OK;
  });
}

}  // extern "C"
