// SPDX-License-Identifier: Apache-2.0
#include "python/service.hpp"

#include <memory>

namespace py = pybind11;

namespace lot::python {

Part Ticket::message() const {
  return Part(std::make_shared<Held>(
      AnyMessage(ShmSharedPtr<const void>(its_), AnyType::of<detail::Ticket>())));
}

void define_service(py::module_& module) {
  py::class_<Ticket>(module, "_Ticket")
      .def("wait_for", &Ticket::wait_for)
      .def_property_readonly("message", &Ticket::message);
}

}  // namespace lot::python
