// SPDX-License-Identifier: Apache-2.0
/// The compiled half of the package `lot`: docs/python.md says what its objects keep.
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "lot/any_message.hpp"
#include "lot/any_type.hpp"

#include "python/ends.hpp"
#include "python/errors.hpp"
#include "python/gil.hpp"
#include "python/part.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

std::vector<AnyType::Field> fields_of(const py::sequence& fields) {
  std::vector<AnyType::Field> parts;
  for (const auto field : fields) {
    const auto [name, type] = field.cast<std::pair<std::string, AnyType>>();
    parts.push_back({name, type});
  }
  return parts;
}

void define_kinds(py::module_& module) {
  py::enum_<Kind>(module, "Kind", "What a value is.")
      .value("OPAQUE", Kind::Opaque)
      .value("BOOL", Kind::Bool)
      .value("CHAR", Kind::Char)
      .value("INT", Kind::Int)
      .value("UINT", Kind::UInt)
      .value("FLOAT", Kind::Float)
      .value("ENUM", Kind::Enum)
      .value("DURATION", Kind::Duration)
      .value("TIME_POINT", Kind::TimePoint)
      .value("ARRAY", Kind::Array)
      .value("STRUCT", Kind::Struct)
      .value("STRING", Kind::String)
      .value("VECTOR", Kind::Vector)
      .value("REFERENCE", Kind::Reference);
}

/// Types that a program makes.
void define_making(py::class_<AnyType>& type) {
  type.def_static("number", &AnyType::number, py::arg("kind"), py::arg("size"))
      .def_static("string", &AnyType::string)
      .def_static("vector", &AnyType::vector, py::arg("element"))
      .def_static("array", &AnyType::array, py::arg("element"), py::arg("count"))
      .def_static("reference", &AnyType::reference, py::arg("target"))
      .def_static("enumeration", &AnyType::enumeration, py::arg("name"), py::arg("number"))
      .def_static("duration", &AnyType::duration, py::arg("number"), py::arg("numerator"),
                  py::arg("denominator"))
      .def_static("time_point", &AnyType::time_point, py::arg("clock"), py::arg("duration"))
      .def_static(
          "structure",
          [](const std::string& name, const py::sequence& fields) {
            return AnyType::structure(name, fields_of(fields));
          },
          py::arg("name"), py::arg("fields"))
      .def_static("opaque", &AnyType::opaque, py::arg("name"), py::arg("size"),
                  py::arg("alignment"))
      .def_static(
          "decode",
          [](const std::string& name, std::size_t alignment, const py::bytes& bytes,
             std::uint64_t hash) {
            return AnyType::decoded(name, alignment, static_cast<std::string_view>(bytes), hash);
          },
          py::arg("name"), py::arg("alignment"), py::arg("bytes"), py::arg("hash") = 0);
}

void define_types(py::module_& module) {
  py::class_<AnyType> made(module, "Type",
                           "A message type, which lies as the C++ type of that name does.");
  define_making(made);
  made.def("encode", [](const AnyType& type) { return py::bytes(type.encoded()); })
      .def_property_readonly("name", &AnyType::name)
      .def_property_readonly("size", &AnyType::size)
      .def_property_readonly("alignment", &AnyType::alignment)
      .def_property_readonly("kind",
                             [](const AnyType& type) { return type.description().root().kind; })
      .def_property_readonly(
          "hash", [](const AnyType& type) { return detail::type_of(*type.known()).hash; },
          "What its program says of it beside the layout (TypeIdentity::hash()), mostly 0.")
      .def_property_readonly("layout_hash",
                             [](const AnyType& type) { return type.description().layout_hash(); })
      .def_property_readonly("names_hash",
                             [](const AnyType& type) { return type.description().names_hash(); })
      .def("fields",
           [](const AnyType& type) {
             py::list fields;
             const auto& its = type.description().root().fields;
             for (std::size_t i = 0; i < its.size(); ++i) {
               fields.append(py::make_tuple(its[i].name, its[i].offset, type.field(i)));
             }
             return fields;
           })
      .def("element",
           [](const AnyType& type) -> py::object {
             AnyType element = type.element();
             return element ? py::cast(std::move(element)) : py::none();
           })
      .def("__eq__", &AnyType::is_same)
      .def("__eq__", [](const AnyType&, const py::object&) { return false; })
      .def("__hash__", [](const AnyType& type) { return py::hash(py::str(type.name())); })
      .def("__repr__", [](const AnyType& type) {
        return "<lot.Type " + type.name() + ", " + std::to_string(type.size()) + " bytes>";
      });
}

}  // namespace

PYBIND11_MODULE(_lot, module) {
  module.doc() = "LOT: messages in shared memory, without copies.";
  define_gil(module);
  define_errors(module);
  define_kinds(module);
  define_types(module);
  define_part_type(module);
  define_part(module);
  define_ends(module);
}

}  // namespace lot::python
