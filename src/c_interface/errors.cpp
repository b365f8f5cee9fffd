// SPDX-License-Identifier: Apache-2.0
#include "c_interface/errors.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <exception>
#include <new>

#include "lot/lot.h"

namespace lot::c_interface {
namespace {

static_assert(LOT_OK == static_cast<int>(Status::Ok));
static_assert(LOT_EMPTY == static_cast<int>(Status::Empty));
static_assert(LOT_FULL == static_cast<int>(Status::Full));
static_assert(LOT_TIMEOUT == static_cast<int>(Status::Timeout));
static_assert(LOT_PUBLISHER_GONE == static_cast<int>(Status::PublisherGone));
static_assert(LOT_HOLDS_TOO_MUCH == static_cast<int>(Status::HoldsTooMuch));
static_assert(LOT_STOPPED == static_cast<int>(Status::Stopped));

/// The last error of a thread. Its memory comes with the thread, so that a lack of memory can be
/// told, too.
struct LastError {
  char text[1536];
  char object[256];
};
thread_local LastError last_error;

template <std::size_t N>
void copy(char (&to)[N], std::string_view text) noexcept {
  const std::size_t size = std::min(text.size(), N - 1);
  std::memcpy(to, text.data(), size);
  to[size] = '\0';
}

int told(int number, std::string_view object, std::string_view text) noexcept {
  copy(last_error.text, text);
  copy(last_error.object, object);
  return number > 0 ? -number : -EIO;
}

}  // namespace

int error_in_flight() {
  try {
    throw;
  } catch (const OutOfMemory& error) {
    return told(ENOBUFS, "segment", error.what());
  } catch (const Error& error) {
    return told(error.error_number(), error.object(), error.what());
  } catch (const std::bad_alloc&) {
    return told(ENOMEM, "process", "lot: the process has no memory");
  } catch (const std::exception& error) {
    return told(EINVAL, "argument", error.what());
  }
}

void require(const void* argument, const char* name) {
  if (argument == nullptr) {
    throw Error(EINVAL, name, "this argument is NULL", "see lot/lot.h for what it takes");
  }
}

std::string_view text_of(const char* argument, const char* name) {
  require(argument, name);
  return argument;
}

}  // namespace lot::c_interface

extern "C" {

const char* lot_error_text(void) { return lot::c_interface::last_error.text; }

const char* lot_error_object(void) { return lot::c_interface::last_error.object; }

const char* lot_status_text(int status) {
  if (status >= LOT_OK && status <= LOT_STOPPED) {
    return lot::to_string(static_cast<lot::Status>(status));
  }
  const char* const text = status < 0 ? strerrordesc_np(-status) : nullptr;
  return text != nullptr ? text : "unknown";
}

}  // extern "C"
