// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>

namespace lot::python {

/// Recording and what it has, where lot::record is built.
void define_recording(pybind11::module_& module);

}  // namespace lot::python
