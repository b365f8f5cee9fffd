// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <exception>

#include <pybind11/pybind11.h>

namespace lot::python {

/// lot.Error and lot.OutOfMemory: Python gets them for those of C++.
void define_errors(pybind11::module_& module);
/// Sets the error of Python that an error of the library stands for. Throws what is none of these.
void set_error(const std::exception_ptr& thrown);

}  // namespace lot::python
