// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <exception>
#include <new>

#include <pybind11/pybind11.h>

#include "lot/error.hpp"

namespace lot::python {

/// lot.Error and lot.OutOfMemory: Python gets them for those of C++.
void define_errors(pybind11::module_& module);
/// Sets the error of Python that an error of the library stands for. Throws what is none of these.
void set_error(const std::exception_ptr& thrown);

/// For functions that Python calls without pybind11: what call() returns. Where it throws, the
/// error of Python is set, and `failed` is returned.
template <class Result, class Call>
Result guarded(Result failed, Call&& call) noexcept {
  try {
    return call();
  } catch (pybind11::error_already_set& error) {
    error.restore();
  } catch (const pybind11::builtin_exception& error) {
    error.set_error();
  } catch (const OutOfMemory&) {
    set_error(std::current_exception());
  } catch (const Error&) {
    set_error(std::current_exception());
  } catch (const std::bad_alloc&) {
    PyErr_NoMemory();
  } catch (const std::exception& error) {
    PyErr_SetString(PyExc_RuntimeError, error.what());
  } catch (...) {
    PyErr_SetString(PyExc_RuntimeError, "an exception that has no text");
  }
  return failed;
}

}  // namespace lot::python
