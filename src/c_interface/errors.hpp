// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string_view>
#include <utility>

#include "lot/error.hpp"

/// How exceptions become what a function of C returns.
namespace lot::c_interface {

/// Notes the exception that is being handled as this thread's last error: what to return for it.
/// One that is no std::exception is thrown on: a thread that is cancelled ends by such a one.
int error_in_flight();

/// Calls f(), which returns a status. What it throws becomes an error. Needs no memory for that.
template <class F>
int guarded(F&& f) {
  try {
    return std::forward<F>(f)();
  } catch (...) {
    return error_in_flight();
  }
}

/// Throws lot::Error (EINVAL) where an argument is missing.
void require(const void* argument, const char* name);
/// The same of a text.
std::string_view text_of(const char* argument, const char* name);

inline int status(Status status) noexcept { return static_cast<int>(status); }

}  // namespace lot::c_interface
