// SPDX-License-Identifier: Apache-2.0
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "python/errors.hpp"
#include "python/part.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

using Type = Description::Type;

/// Tells elements as PEP 3118 has it.
class Format {
 public:
  explicit Format(const Description& all) : all_(all) {}

  /// Empty: they are not just bytes. `alone`: in native sizes, as memoryview reads them.
  std::string of(std::uint32_t place, bool alone) {
    const Type& type = all_.types.at(place);
    switch (type.kind) {
      case Kind::Bool:
        return alone ? "?" : "=?";
      case Kind::Char:
        return alone ? "c" : "=c";
      case Kind::Int:
      case Kind::UInt:
      case Kind::Float:
        return number(type, alone);
      case Kind::Enum:
      case Kind::Duration:
      case Kind::TimePoint:
        return of(type.element, alone);
      case Kind::Array:
        return array(type);
      case Kind::Struct:
        return structure(type);
      case Kind::Opaque:
        return std::to_string(type.size) + "s";
      default:
        return {};
    }
  }

 private:
  static std::string number(const Type& type, bool alone) {
    const char* const codes = type.kind == Kind::Float ? "..fd"
                              : type.kind == Kind::Int ? "bhiq"
                                                       : "BHIQ";
    for (unsigned i = 0; i < 4; ++i) {
      if (type.size == std::uint64_t{1} << i && codes[i] != '.') {
        return (alone ? "" : "=") + std::string(1, codes[i]);
      }
    }
    return std::to_string(type.size) + "s";  // long double
  }
  /// Arrays of arrays have one shape: "(2,3)=f".
  std::string array(const Type& type) {
    std::string shape = std::to_string(type.count);
    const Type* its = &type;
    while (all_.types.at(its->element).kind == Kind::Array) {
      its = &all_.types.at(its->element);
      shape += "," + std::to_string(its->count);
    }
    const std::string element = of(its->element, false);
    return element.empty() ? element : "(" + shape + ")" + element;
  }
  std::string structure(const Type& type) {
    std::string text = "T{";
    std::uint64_t end = 0;
    for (std::size_t i = 0; i < type.fields.size(); ++i) {
      const Description::Field& field = type.fields[i];
      const std::string its = of(field.type, false);
      if (its.empty()) return {};
      const std::string name = field.name.empty() ? "_" + std::to_string(i) : field.name;
      const bool can_be_told =
          field.bits == 0 && field.offset >= end && name.find(':') == std::string::npos;
      if (!can_be_told) return std::to_string(type.size) + "s";
      pad(text, field.offset - end);
      text += its + ":" + name + ":";
      end = field.offset + all_.types.at(field.type).size;
    }
    pad(text, type.size - end);
    return text + "}";
  }
  static void pad(std::string& text, std::uint64_t bytes) {
    if (bytes != 0) text += std::to_string(bytes) + "x";
  }

  const Description& all_;
};

/// What a view has of its own, until it is released.
struct View {
  /// A vector, and arrays in arrays as deep as a description tells (docs/layout.md).
  static constexpr int kMostDimensions = 17;

  void add(std::uint64_t count) {
    if (dimensions == kMostDimensions) throw py::buffer_error("it has too many dimensions");
    shape[dimensions++] = static_cast<Py_ssize_t>(count);
  }

  std::shared_ptr<Held> held;
  std::string format;  // mostly one letter, which needs no memory
  int dimensions = 0;
  Py_ssize_t shape[kMostDimensions];
  Py_ssize_t strides[kMostDimensions];
  Py_ssize_t item = 0;
};

/// What is told of a part, without the bytes. The format stays empty where there can be no view.
void describe(const Part& part, View& view) {
  const Value& value = part.value();
  const Description& all = part.held()->description();
  const Type* type = &value.type();
  if (type->kind == Kind::Vector || type->kind == Kind::Array) {
    view.add(value.size());
    while (all.types.at(type->element).kind == Kind::Array) {
      type = &all.types.at(type->element);
      view.add(type->count);
    }
    view.format = Format(all).of(type->element, true);
    view.item = static_cast<Py_ssize_t>(all.types.at(type->element).size);
  } else {
    const auto place = static_cast<std::uint32_t>(type - all.types.data());
    view.format = Format(all).of(place, true);
    view.item = static_cast<Py_ssize_t>(type->size);
  }
  Py_ssize_t stride = view.item;
  for (int i = view.dimensions; i-- > 0; stride *= view.shape[i]) view.strides[i] = stride;
}

void fill(PyObject* self, Py_buffer* buffer, int flags) {
  const Part& part = part_of(self);
  auto view = std::make_unique<View>();
  describe(part, *view);
  if (view->format.empty()) {
    throw py::buffer_error("its elements have strings, vectors or references: use them one by one");
  }
  const bool can_change = part.held()->can_change();
  if ((flags & PyBUF_WRITABLE) != 0 && !can_change) {
    throw py::buffer_error("a received message is read-only");
  }
  static constexpr std::byte kNothing{};  // an empty vector has no memory
  const Bytes bytes = part.value().bytes();
  const std::byte* const at = part.held()->pin(bytes.data());
  view->held = part.held();
  buffer->buf = const_cast<std::byte*>(bytes.size() == 0 ? &kNothing : at);
  buffer->len = static_cast<Py_ssize_t>(bytes.size());
  buffer->itemsize = view->item;
  buffer->readonly = can_change ? 0 : 1;
  buffer->ndim = view->dimensions;
  buffer->format = (flags & PyBUF_FORMAT) != 0 ? view->format.data() : nullptr;
  buffer->shape = (flags & PyBUF_ND) != 0 ? view->shape : nullptr;
  buffer->strides = (flags & PyBUF_STRIDES) == PyBUF_STRIDES ? view->strides : nullptr;
  buffer->suboffsets = nullptr;
  buffer->internal = view.release();
  Py_INCREF(self);
  buffer->obj = self;
}

}  // namespace

int get_buffer(PyObject* self, Py_buffer* buffer, int flags) noexcept {
  buffer->obj = nullptr;
  return guarded(-1, [&] {
    fill(self, buffer, flags);
    return 0;
  });
}

void release_buffer(PyObject*, Py_buffer* buffer) noexcept {
  const std::unique_ptr<View> view(static_cast<View*>(buffer->internal));
  view->held->unpin();
}

bool has_buffer(const Part& part) {
  View view;
  describe(part, view);
  return !view.format.empty();
}

}  // namespace lot::python
