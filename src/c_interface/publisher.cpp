// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cstddef>
#include <memory>
#include <string_view>
#include <utility>

#include "lot/any_pusher.hpp"

#include "c_interface/errors.hpp"
#include "c_interface/handles.hpp"

namespace lot::c_interface {
namespace {

static_assert(LOT_REFUSE == static_cast<int>(Policy::Refuse));
static_assert(LOT_MUTEX == static_cast<int>(QueueEngine::Mutex));

PusherOptions options_of(const lot_publisher_options* given) {
  PusherOptions options;
  if (given == nullptr) return options;
  options.policy = static_cast<Policy>(given->policy);
  options.depth = given->depth;
  options.block_for = std::chrono::nanoseconds(given->block_for);
  options.engine = static_cast<QueueEngine>(given->engine);
  options.max_bytes = given->max_bytes;
  options.history = given->history;
  options.stamp = given->stamp;
  return options;
}

int push(lot_publisher* publisher, lot_loan** loan, const int64_t* block_for, lot_stop* stop) {
  return guarded([&] {
    require(publisher, "publisher");
    require(loan, "loan");
    require(*loan, "*loan");
    const StopToken token = token_of(stop);
    AnyPusher& pusher = publisher->pusher;
    AnyLoan& message = (*loan)->loan;
    const Status said =
        block_for == nullptr
            ? pusher.push(std::move(message), token)
            : pusher.push(std::move(message), std::chrono::nanoseconds(*block_for), token);
    if (said == Status::Ok) delete std::exchange(*loan, nullptr);
    return status(said);
  });
}

/// The place in a loan that a path leads to.
MutableValue at(lot_loan* loan, const char* path) {
  require(loan, "loan");
  return loan->loan.root().at(text_of(path, "path"));
}

template <class T>
int set(lot_loan* loan, const char* path, const T& value) {
  return guarded([&] {
    at(loan, path).set(value);
    return LOT_OK;
  });
}

}  // namespace
}  // namespace lot::c_interface

using lot::c_interface::at;
using lot::c_interface::guarded;
using lot::c_interface::require;
using lot::c_interface::status;
using lot::c_interface::text_of;
using lot::c_interface::token_of;

extern "C" {

lot_publisher_options lot_publisher_defaults(void) {
  const lot::PusherOptions options;
  return {static_cast<lot_policy>(options.policy),
          options.depth,
          std::chrono::nanoseconds(options.block_for).count(),
          static_cast<lot_queue_engine>(options.engine),
          options.max_bytes,
          options.history,
          options.stamp};
}

int lot_advertise(lot_engine* engine, const char* topic, const lot_type* type,
                  const lot_publisher_options* options, lot_publisher** publisher) {
  return guarded([&] {
    require(engine, "engine");
    require(type, "type");
    require(publisher, "publisher");
    auto pusher = engine->engine.advertise_any(text_of(topic, "topic"), type->type,
                                               lot::c_interface::options_of(options));
    auto shared = std::make_shared<const lot_type>(pusher.type());
    *publisher = new lot_publisher{std::move(pusher), std::move(shared)};
    return LOT_OK;
  });
}

void lot_publisher_close(lot_publisher* publisher) { delete publisher; }

const lot_type* lot_publisher_type(const lot_publisher* publisher) { return publisher->type.get(); }

int lot_publisher_loan(lot_publisher* publisher, lot_loan** loan) {
  return guarded([&] {
    require(publisher, "publisher");
    require(loan, "loan");
    auto made = std::make_unique<lot_loan>();
    lot::AnyPusher& pusher = publisher->pusher;
    const bool is_opaque = pusher.type().description().root().kind == lot::Kind::Opaque;
    made->loan = is_opaque ? pusher.loan_zeroed() : pusher.loan();
    made->message.loan = &made->loan;
    made->message.type = publisher->type;
    *loan = made.release();
    return LOT_OK;
  });
}

int lot_publisher_push(lot_publisher* publisher, lot_loan** loan, lot_stop* stop) {
  return lot::c_interface::push(publisher, loan, nullptr, stop);
}

int lot_publisher_push_for(lot_publisher* publisher, lot_loan** loan, int64_t block_for,
                           lot_stop* stop) {
  return lot::c_interface::push(publisher, loan, &block_for, stop);
}

int lot_publisher_forward(lot_publisher* publisher, const lot_message* message, lot_stop* stop) {
  return guarded([&] {
    require(publisher, "publisher");
    require(message, "message");
    return status(publisher->pusher.push(lot::c_interface::kept(*message), token_of(stop)));
  });
}

int lot_publisher_readers(lot_publisher* publisher, size_t* count) {
  return guarded([&] {
    require(publisher, "publisher");
    require(count, "count");
    *count = publisher->pusher.readers();
    return LOT_OK;
  });
}

int lot_publisher_wait_for_readers(lot_publisher* publisher, size_t count, int64_t timeout,
                                   lot_stop* stop) {
  return guarded([&] {
    require(publisher, "publisher");
    const lot::StopToken token = token_of(stop);
    lot::AnyPusher& pusher = publisher->pusher;
    const bool are_there =
        timeout == LOT_FOREVER
            ? pusher.wait_for_readers(count, token)
            : pusher.wait_for_readers(count, std::chrono::nanoseconds(timeout), token);
    if (are_there) return int{LOT_OK};
    return int{token.stop_requested() ? LOT_STOPPED : LOT_TIMEOUT};
  });
}

int lot_publisher_reserve(lot_publisher* publisher, size_t count, size_t bytes) {
  return guarded([&] {
    require(publisher, "publisher");
    publisher->pusher.reserve(count, bytes);
    return LOT_OK;
  });
}

// ---- loans ----

void* lot_loan_data(lot_loan* loan) { return loan->loan.data(); }
const lot_message* lot_loan_message(const lot_loan* loan) { return &loan->message; }

int lot_set_int64(lot_loan* loan, const char* path, int64_t value) {
  return lot::c_interface::set(loan, path, value);
}

int lot_set_uint64(lot_loan* loan, const char* path, uint64_t value) {
  return lot::c_interface::set(loan, path, value);
}

int lot_set_double(lot_loan* loan, const char* path, double value) {
  return lot::c_interface::set(loan, path, value);
}

int lot_set_text(lot_loan* loan, const char* path, const char* text, size_t size) {
  return guarded([&] {
    if (size != 0) require(text, "text");
    at(loan, path).set(std::string_view(text, size));
    return LOT_OK;
  });
}

int lot_resize(lot_loan* loan, const char* path, size_t count) {
  return guarded([&] {
    at(loan, path).resize(count);
    return LOT_OK;
  });
}

int lot_set_bytes(lot_loan* loan, const char* path, lot_view bytes) {
  return guarded([&] {
    if (bytes.size != 0) require(bytes.data, "bytes");
    at(loan, path).assign({static_cast<const std::byte*>(bytes.data), bytes.size});
    return LOT_OK;
  });
}

int lot_loan_bytes(lot_loan* loan, const char* path, void** data, size_t* size) {
  return guarded([&] {
    require(data, "data");
    require(size, "size");
    const lot::Bytes bytes = at(loan, path).value().bytes();
    *data = const_cast<std::byte*>(bytes.data());  // the message is the caller's own
    *size = bytes.size();
    return LOT_OK;
  });
}

void lot_loan_release(lot_loan* loan) { delete loan; }

}  // extern "C"
