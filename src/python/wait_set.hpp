// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>

namespace lot::python {

/// The compiled half of WaitSet: it says which of its numbers have news. The handlers stay with
/// Python, whose garbage collector finds the rings that they make.
void define_wait_set(pybind11::module_& module);

}  // namespace lot::python
