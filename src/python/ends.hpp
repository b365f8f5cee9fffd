// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>

namespace lot::python {

/// Engine, Publisher, Subscriber, and what they take and say.
void define_ends(pybind11::module_& module);

}  // namespace lot::python
