// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <exception>

#include <cxxabi.h>
#include <pybind11/pybind11.h>

#include "python/gil.hpp"

namespace lot::python {

/// lot.Error and lot.OutOfMemory: Python gets them for those of C++.
void define_errors(pybind11::module_& module);
/// Sets the error of Python that an error of the library stands for. Throws what is none of these.
void set_error(const std::exception_ptr& thrown);

/// In a handler: sets the error of Python that the exception stands for, whatever it is.
void set_current_error() noexcept;

/// For functions that Python calls without pybind11: what call() returns. Where it throws, the
/// error of Python is set, and `failed` is returned.
template <class Result, class Call>
Result guarded(Result failed, Call&& call) noexcept {
  try {
    return call();
  } catch (abi::__forced_unwind&) {  // of a thread that code of Python, within the call, was in
    stop_here();
  } catch (...) {
    set_current_error();
  }
  return failed;
}

}  // namespace lot::python
