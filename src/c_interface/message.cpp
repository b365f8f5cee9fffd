// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstddef>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "lot/any_message.hpp"

#include "c_interface/errors.hpp"
#include "c_interface/handles.hpp"

namespace lot::c_interface {
namespace {

/// Gives what read(value) makes of the place that a path leads to.
template <class T, class F>
int get(const lot_message* message, const char* path, T* result, F&& read) {
  return guarded([&] {
    require(message, "message");
    require(result, "result");
    *result = read(message->root().at(text_of(path, "path")));
    return LOT_OK;
  });
}

template <class T>
int get_number(const lot_message* message, const char* path, T* result) {
  return get(message, path, result, [](const Value& value) { return value.as<T>(); });
}

}  // namespace
}  // namespace lot::c_interface

using lot::Value;
using lot::c_interface::get;
using lot::c_interface::get_number;
using lot::c_interface::guarded;
using lot::c_interface::require;
using lot::c_interface::text_of;

extern "C" {

int lot_message_keep(const lot_message* message, lot_message** kept) {
  return guarded([&] {
    require(message, "message");
    require(kept, "kept");
    auto made = std::make_unique<lot_message>();
    made->type = message->type;
    made->kept = lot::c_interface::kept(*message);
    *kept = made.release();
    return LOT_OK;
  });
}

void lot_message_release(lot_message* message) { delete message; }

const void* lot_message_data(const lot_message* message) { return message->data(); }
const lot_type* lot_message_type(const lot_message* message) { return message->type.get(); }

int lot_get_kind(const lot_message* message, const char* path, lot_kind* kind) {
  return get(message, path, kind,
             [](const Value& value) { return static_cast<lot_kind>(value.kind()); });
}

int lot_get_count(const lot_message* message, const char* path, size_t* count) {
  return get(message, path, count, [](const Value& value) { return value.size(); });
}

int lot_get_int64(const lot_message* message, const char* path, int64_t* value) {
  return get_number(message, path, value);
}

int lot_get_uint64(const lot_message* message, const char* path, uint64_t* value) {
  return get_number(message, path, value);
}

int lot_get_double(const lot_message* message, const char* path, double* value) {
  return get_number(message, path, value);
}

int lot_get_text(const lot_message* message, const char* path, lot_view* text) {
  return get(message, path, text, [](const Value& value) {
    const auto found = value.as<std::string_view>();
    return lot_view{found.data(), found.size()};
  });
}

int lot_get_bytes(const lot_message* message, const char* path, lot_view* bytes) {
  return get(message, path, bytes, [](const Value& value) {
    const lot::Bytes found = value.bytes();
    return lot_view{found.data(), found.size()};
  });
}

int lot_print(const lot_message* message, const char* path, char* buffer, size_t size,
              size_t* needed) {
  return guarded([&] {
    require(message, "message");
    require(needed, "needed");
    if (size != 0) require(buffer, "buffer");
    const std::string text = lot::to_string(message->root().at(text_of(path, "path")));
    *needed = text.size();
    if (size == 0) return LOT_OK;
    const size_t count = std::min(text.size(), size - 1);
    std::memcpy(buffer, text.data(), count);
    buffer[count] = '\0';
    return LOT_OK;
  });
}

}  // extern "C"
