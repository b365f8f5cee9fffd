// SPDX-License-Identifier: Apache-2.0
#include "python/part.hpp"

#include <cerrno>
#include <string_view>

#include "lot/error.hpp"
#include "lot/mutable_value.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

py::object text_of(std::string_view text) {
  PyObject* const made =
      PyUnicode_DecodeUTF8(text.data(), static_cast<Py_ssize_t>(text.size()), "surrogateescape");
  if (made == nullptr) throw py::error_already_set();
  return py::reinterpret_steal<py::object>(made);
}

/// What the number of an enum, duration or time point is.
Kind kind_of_number(const Description& all, const Description::Type& type) {
  const Description::Type* inner = &type;
  while (inner->kind == Kind::Enum || inner->kind == Kind::Duration ||
         inner->kind == Kind::TimePoint) {
    inner = &all.types.at(inner->element);
  }
  return inner->kind;
}

/// numpy makes no structs of dicts, and cuts numbers in tuples: these are set one by one.
bool are_structs_of_python(const Description& all, const Description::Type& type,
                           py::handle object) {
  return all.types.at(type.element).kind == Kind::Struct && PyObject_CheckBuffer(object.ptr()) == 0;
}

bool is_sequence(Kind kind) { return kind == Kind::Array || kind == Kind::Vector; }

void set(const std::shared_ptr<Held>& held, const MutableValue& place, py::handle object);

void set_number(const MutableValue& place, py::handle object) {
  if (py::isinstance<py::bool_>(object)) return place.set(object.cast<bool>());
  if (PyIndex_Check(object.ptr()) == 0) {
    const double real = PyFloat_AsDouble(object.ptr());  // TypeError for what is no number
    if (PyErr_Occurred() != nullptr) throw py::error_already_set();
    return place.set(real);
  }
  const auto whole = py::reinterpret_steal<py::object>(PyNumber_Index(object.ptr()));
  if (!whole) throw py::error_already_set();
  int overflow = 0;
  const long long number = PyLong_AsLongLongAndOverflow(whole.ptr(), &overflow);
  if (overflow == 0) return place.set(static_cast<std::int64_t>(number));
  const unsigned long long large = PyLong_AsUnsignedLongLong(whole.ptr());
  if (PyErr_Occurred() != nullptr) throw py::error_already_set();
  place.set(static_cast<std::uint64_t>(large));
}

void set_text(Held& held, const MutableValue& place, py::handle object) {
  if (!py::isinstance<py::bytes>(object) && !py::isinstance<py::str>(object)) {
    throw py::type_error("takes a str or bytes, not " + py::repr(object).cast<std::string>());
  }
  const auto bytes = py::isinstance<py::bytes>(object)
                         ? py::reinterpret_borrow<py::bytes>(object)
                         : py::reinterpret_steal<py::bytes>(
                               PyUnicode_AsEncodedString(object.ptr(), "utf-8", "surrogateescape"));
  if (!bytes) throw py::error_already_set();
  held.grow();
  place.set(static_cast<std::string_view>(bytes));
}

/// numpy converts the elements; a vector gets as many as the object has.
void set_elements(const std::shared_ptr<Held>& held, const MutableValue& place, py::handle object) {
  const Value& value = place.value();
  const py::module_ package = py::module_::import("lot");
  const py::object elements = package.attr("_elements")(to_object(Part(held, value)), object);
  if (value.kind() == Kind::Vector) {
    const std::size_t count = py::len(elements);
    held->grow();
    place.resize(count);
    if (count == 0) return;
  }
  package.attr("_fill")(to_object(Part(held, value)), elements);
}

void set_each(const std::shared_ptr<Held>& held, const MutableValue& place, py::handle object) {
  const auto items = py::reinterpret_borrow<py::sequence>(object);
  if (place.value().kind() == Kind::Vector) {
    held->grow();
    place.resize(items.size());
  } else if (items.size() != place.size()) {
    throw py::value_error("the array has " + std::to_string(place.size()) + " elements, always");
  }
  for (std::size_t i = 0; i < items.size(); ++i) set(held, place[i], py::object(items[i]));
}

/// None, or the message of a whole part.
void set_reference(const Held& held, const MutableValue& place, py::handle object) {
  if (object.is_none()) return held.refer(place, nullptr);
  if (!is_part(object)) {
    throw py::type_error("a reference is set to a message, or None");
  }
  held.refer(place, part_of(object).message());
}

/// Throws AttributeError, which says which fields there are.
void require_field(const Value& value, std::string_view name) {
  if (value.has(name)) return;
  std::string text = value.type_name() + " has no field '" + std::string(name) + "'";
  const bool is_told = value.kind() == Kind::Struct && name.substr(0, 2) != "__";
  for (std::size_t i = 0; is_told && i < value.size(); ++i) {
    text += (i == 0 ? ": it has " : ", ") + value[i].name();
  }
  throw py::attribute_error(text);
}

/// By a dict of some fields, or a tuple of all.
void set_struct(const std::shared_ptr<Held>& held, const MutableValue& place, py::handle object) {
  const Value& value = place.value();
  if (py::isinstance<py::tuple>(object)) {
    const auto items = py::reinterpret_borrow<py::tuple>(object);
    if (items.size() != value.size()) {
      throw py::value_error("it has " + std::to_string(value.size()) + " fields, the tuple " +
                            std::to_string(items.size()));
    }
    for (std::size_t i = 0; i < items.size(); ++i) set(held, place[i], py::object(items[i]));
    return;
  }
  if (!py::isinstance<py::dict>(object)) {
    throw py::type_error(
        "a struct is set by a dict of its fields, a tuple of all of them, or field by field");
  }
  for (const auto& [key, its] : py::reinterpret_borrow<py::dict>(object)) {
    const auto name = py::str(key).cast<std::string>();
    require_field(value, name);
    set(held, place[std::string_view(name)], its);
  }
}

void set_here(const std::shared_ptr<Held>& held, const MutableValue& place, py::handle object) {
  const Value& value = place.value();
  const Kind kind = value.kind();
  if (kind == Kind::Struct) {
    set_struct(held, place, object);
  } else if (is_sequence(kind)) {
    if (kind == Kind::Vector && PySequence_Check(object.ptr()) == 0) {
      throw py::type_error("takes a sequence or an array");
    }
    const bool is_text = py::isinstance<py::str>(object) || py::isinstance<py::bytes>(object);
    if (is_text && kind == Kind::Array) return set_text(*held, place, object);
    if (has_buffer(Part(held, value)) &&
        !are_structs_of_python(held->description(), value.type(), object)) {
      set_elements(held, place, object);
    } else {
      set_each(held, place, object);
    }
  } else if (kind == Kind::Reference) {
    set_reference(*held, place, object);
  } else if (kind == Kind::String || kind == Kind::Opaque) {
    set_text(*held, place, object);
  } else if (kind == Kind::Char && py::isinstance<py::str>(object)) {
    const auto text = object.cast<std::string>();
    if (text.size() != 1) throw py::value_error("a char is one byte of text");
    place.set(text.front());
  } else {
    set_number(place, object);
  }
}

/// An error whose text names the value.
class NamedError : public py::error_already_set {
 public:
  using py::error_already_set::error_already_set;
};

/// Throws the error of Python that is set, with the name of the value.
[[noreturn]] void raise_named(const MutableValue& place) {
  const py::error_already_set error;
  PyObject* const type = error.type().ptr();
  const bool has_plain_text =
      type == PyExc_TypeError || type == PyExc_ValueError || type == PyExc_OverflowError;
  if (!has_plain_text) throw error;
  const Value& value = place.value();
  const std::string path = value.path();
  const auto text = py::str(error.value()).cast<std::string>();
  PyErr_SetString(type,
                  ((path.empty() ? path : path + ", ") + value.type_name() + ": " + text).c_str());
  throw NamedError();
}

void set(const std::shared_ptr<Held>& held, const MutableValue& place, py::handle object) {
  try {
    return set_here(held, place, object);
  } catch (const NamedError&) {
    throw;
  } catch (py::error_already_set& error) {
    error.restore();
  } catch (const py::builtin_exception& error) {
    error.set_error();
  }
  raise_named(place);
}

}  // namespace

const Value& Part::value() const {
  held_->require_open();
  if (generation_ != held_->generation()) {
    value_ = held_->root().at(value_.path());
    generation_ = held_->generation();
  }
  return value_;
}

void Part::require_whole() const {
  if (!is_whole()) throw py::type_error("this is a part of a message, not the message");
}

AnyMessage Part::message() const {
  require_whole();
  return held_->share();
}

py::object to_python(const std::shared_ptr<Held>& held, const Value& value) {
  const Description::Type& type = value.type();
  switch (kind_of_number(held->description(), type)) {
    case Kind::Bool:
      return py::bool_(value.as<bool>());
    case Kind::Char:
      return text_of(std::string(1, value.as<char>()));
    case Kind::Int:
      return py::int_(value.as<std::int64_t>());
    case Kind::UInt:
      return py::int_(value.as<std::uint64_t>());
    case Kind::Float:
      return py::float_(value.as<double>());
    case Kind::String:
      return text_of(value.as<std::string_view>());
    case Kind::Reference:
      if (value.is_null()) return py::none();
      return to_python(held, value.target());
    default:
      return to_object(Part(held, value));
  }
}

py::object Part::attribute(std::string_view name) const {
  require_field(value(), name);
  return to_python(held_, value()[name]);
}

MutableValue Part::building() const {
  const MutableValue message = held_->building();
  return is_whole_ ? message : message.at(value().path());
}

std::size_t Part::index(py::handle key) const {
  const Py_ssize_t given = PyNumber_AsSsize_t(key.ptr(), PyExc_IndexError);
  if (given == -1 && PyErr_Occurred() != nullptr) throw py::error_already_set();
  const auto count = static_cast<Py_ssize_t>(size());
  const Py_ssize_t place = given < 0 ? given + count : given;
  if (place < 0 || place >= count) throw py::index_error("there is no such element");
  return static_cast<std::size_t>(place);
}

py::object Part::item(const py::object& key) const {
  if (py::isinstance<py::str>(key)) return to_python(held_, value().at(key.cast<std::string>()));
  if (py::isinstance<py::slice>(key) || py::isinstance<py::tuple>(key)) {
    return py::module_::import("numpy").attr("asarray")(to_object(*this)).attr("__getitem__")(key);
  }
  return to_python(held_, value()[index(key)]);
}

void Part::set_attribute(std::string_view name, py::handle object) {
  const MutableValue whole = building();
  require_field(value(), name);
  set(held_, whole[name], object);
}

void Part::set_item(const py::object& key, py::handle object) {
  const MutableValue whole = building();
  if (py::isinstance<py::str>(key)) {
    set(held_, whole.at(key.cast<std::string>()), object);
  } else if (py::isinstance<py::slice>(key) || py::isinstance<py::tuple>(key)) {
    py::module_::import("numpy").attr("asarray")(to_object(*this)).attr("__setitem__")(key, object);
  } else {
    set(held_, whole[index(key)], object);
  }
}

void Part::resize(std::size_t count) {
  const MutableValue place = building();
  held_->grow();
  place.resize(count);
}

void Part::assign(py::handle object) { set(held_, building(), object); }

py::list Part::fields() const {
  py::list names;
  if (value().kind() != Kind::Struct) return names;
  for (const Value field : value()) names.append(text_of(field.name()));
  return names;
}

py::object Part::text() const { return text_of(to_string(value())); }

py::object Part::copy() const {
  const auto copied = [](const py::object& object) {
    return is_part(object) ? part_of(object).copy() : object;
  };
  const Kind kind = value().kind();
  if (kind != Kind::Struct && has_buffer(*this)) {
    return py::module_::import("numpy").attr("array")(to_object(*this));
  }
  if (kind != Kind::Struct) {
    py::list items;
    for (const Value item : value()) items.append(copied(to_python(held_, item)));
    return items;
  }
  const py::object made = py::module_::import("types").attr("SimpleNamespace")();
  for (const Value field : value()) {
    py::setattr(made, text_of(field.name()), copied(to_python(held_, field)));
  }
  return made;
}

namespace {

class Weak {
 public:
  explicit Weak(const AnyMessage& message) : message_(message.pointer()), type_(message.type()) {}
  py::object lock() const {
    auto kept = message_.lock();
    if (!kept) return py::none();
    return to_object(Part(std::make_shared<Held>(AnyMessage(std::move(kept), type_))));
  }

 private:
  ShmWeakPtr<const void> message_;
  AnyType type_;
};

}  // namespace

void define_part(py::module_& module) {
  py::class_<Weak>(module, "Weak", "Looks after a message without keeping it: lot.weak().")
      .def("__call__", &Weak::lock, "The message; None when it has died.");
  module.def(
      "weak", [](const Part& part) { return Weak(part.message()); }, py::arg("message"),
      "Looks after a received message without keeping it.");
  module.def(
      "share",
      [](const Part& part) {
        part.require_whole();
        return Part(std::make_shared<Held>(part.held()->take_loan().share()));
      },
      py::arg("loan"),
      "Ends a loan without a push: the message as all see it from here on, to be pushed on "
      "several\n"
      "topics, or referred to.");
  module.def("_whole", [](const Part& part) { return Part(part.held()); });
}

}  // namespace lot::python
