// SPDX-License-Identifier: Apache-2.0
/// lot.Part as a type of CPython's own: what pybind11 keeps for each object, and does for each
/// call, would take longer than the rest of a look at a message.
#include <cstddef>
#include <new>
#include <string_view>
#include <utility>

#include <pybind11/pybind11.h>
#include <structmember.h>  // needs the former's Python.h

#include "python/errors.hpp"
#include "python/part.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

struct Head {
  PyObject object;
  PyObject* weak_references;
};

struct PartObject {
  Head head;
  Part part;
};

PyTypeObject* part_type = nullptr;  // never released: it lives as long as the module

PartObject& its(PyObject* self) noexcept { return *reinterpret_cast<PartObject*>(self); }

std::string_view text_of(PyObject* text) {
  Py_ssize_t size = 0;
  const char* const data = PyUnicode_AsUTF8AndSize(text, &size);  // TypeError for what is no text
  if (data == nullptr) throw py::error_already_set();
  return {data, static_cast<std::size_t>(size)};
}

py::object borrowed(PyObject* object) { return py::reinterpret_borrow<py::object>(object); }

py::handle given(PyObject* value) {
  if (value == nullptr) throw py::type_error("nothing of a message can be deleted");
  return value;
}

/// For CPython: the object that make(part) gives.
template <class Make>
PyObject* made_of(PyObject* self, Make&& make) noexcept {
  return guarded(static_cast<PyObject*>(nullptr),
                 [&] { return py::object(make(its(self).part)).release().ptr(); });
}

// ---- as CPython calls it ----

void destroy(PyObject* self) noexcept {
  if (its(self).head.weak_references != nullptr) PyObject_ClearWeakRefs(self);
  PyTypeObject* const type = Py_TYPE(self);
  its(self).part.~Part();
  PyObject_Free(self);
  Py_DECREF(type);
}

PyObject* attribute(PyObject* self, PyObject* name) noexcept {
  if (_PyType_Lookup(part_type, name) != nullptr) return PyObject_GenericGetAttr(self, name);
  return made_of(self, [&](const Part& part) { return part.attribute(text_of(name)); });
}

int set_attribute(PyObject* self, PyObject* name, PyObject* value) noexcept {
  return guarded(-1, [&] {
    its(self).part.set_attribute(text_of(name), given(value));
    return 0;
  });
}

PyObject* item(PyObject* self, PyObject* key) noexcept {
  return made_of(self, [&](const Part& part) { return part.item(borrowed(key)); });
}

/// For loops, which end by IndexError.
PyObject* item_at(PyObject* self, Py_ssize_t place) noexcept {
  return made_of(self, [&](const Part& part) { return part.item(py::int_(place)); });
}

int set_item(PyObject* self, PyObject* key, PyObject* value) noexcept {
  return guarded(-1, [&] {
    its(self).part.set_item(borrowed(key), given(value));
    return 0;
  });
}

Py_ssize_t size(PyObject* self) noexcept {
  return guarded(Py_ssize_t{-1}, [&] { return static_cast<Py_ssize_t>(its(self).part.size()); });
}

int is_true(PyObject*) noexcept { return 1; }  // a message, also an empty vector of it

PyObject* text(PyObject* self) noexcept {
  return made_of(self, [](const Part& part) { return part.text(); });
}

PyObject* resize(PyObject* self, PyObject* count) noexcept {
  return made_of(self, [&](Part& part) {
    const auto whole = py::reinterpret_steal<py::object>(PyNumber_Index(count));
    if (!whole) throw py::error_already_set();
    const std::size_t elements = PyLong_AsSize_t(whole.ptr());
    if (PyErr_Occurred() != nullptr) throw py::error_already_set();
    part.resize(elements);
    return py::none();
  });
}

PyObject* assign(PyObject* self, PyObject* value) noexcept {
  return made_of(self, [&](Part& part) {
    part.assign(value);
    return py::none();
  });
}

PyObject* fields(PyObject* self, PyObject*) noexcept {
  return made_of(self, [](const Part& part) { return part.fields(); });
}

PyObject* copy(PyObject* self, PyObject*) noexcept {
  return made_of(self, [](const Part& part) { return part.copy(); });
}

PyObject* reduce(PyObject* self, PyObject*) noexcept {
  return made_of(self, [](const Part& part) {
    return py::make_tuple(py::module_::import("lot").attr("_same"), py::make_tuple(part.copy()));
  });
}

PyObject* names(PyObject* self, PyObject*) noexcept {
  return made_of(self, [](const Part& part) {
    const auto type = py::reinterpret_borrow<py::object>(reinterpret_cast<PyObject*>(part_type));
    py::list all = py::module_::import("builtins").attr("list")(type.attr("__dict__"));
    for (const auto name : part.fields()) all.append(name);
    return all;
  });
}

PyMethodDef methods[] = {
    {"resize", resize, METH_O,
     "resize($self, count, /)\n--\n\n"
     "Gives a vector of a loan so many elements: those that come are zero, or empty."},
    {"assign", assign, METH_O,
     "assign($self, value, /)\n--\n\n"
     "Sets all of it: a vector or array by a sequence or an array of numpy, a struct by a dict."},
    {"fields", fields, METH_NOARGS, "fields($self, /)\n--\n\nThe names of a struct's fields."},
    {"copy", copy, METH_NOARGS,
     "copy($self, /)\n--\n\n"
     "A copy in plain Python: structs as SimpleNamespace, numbers as arrays of numpy."},
    {"__dir__", names, METH_NOARGS, nullptr},
    {"__reduce__", reduce, METH_NOARGS, nullptr},
    {}};

PyMemberDef members[] = {
    {"__weaklistoffset__", T_PYSSIZET, offsetof(Head, weak_references), READONLY, nullptr}, {}};

constexpr const char* kText =
    "A message, or a struct, array, vector or opaque value in it. It keeps the\n"
    "message. Fields are attributes, elements items; numpy looks without a copy.";

template <class Function>
void* slot(Function* function) noexcept {
  return reinterpret_cast<void*>(function);
}

}  // namespace

bool is_part(py::handle object) noexcept { return Py_TYPE(object.ptr()) == part_type; }

Part& part_of(py::handle object) noexcept { return its(object.ptr()).part; }

py::object to_object(Part part) {
  auto* const made = PyObject_New(PartObject, part_type);
  if (made == nullptr) throw py::error_already_set();
  made->head.weak_references = nullptr;
  ::new (&made->part) Part(std::move(part));
  return py::reinterpret_steal<py::object>(reinterpret_cast<PyObject*>(made));
}

void define_part_type(py::module_& module) {
  PyType_Slot slots[] = {{Py_tp_dealloc, slot(destroy)},
                         {Py_tp_getattro, slot(attribute)},
                         {Py_tp_setattro, slot(set_attribute)},
                         {Py_mp_subscript, slot(item)},
                         {Py_mp_ass_subscript, slot(set_item)},
                         {Py_mp_length, slot(size)},
                         {Py_sq_item, slot(item_at)},
                         {Py_sq_length, slot(size)},
                         {Py_nb_bool, slot(is_true)},
                         {Py_tp_repr, slot(text)},
                         {Py_bf_getbuffer, slot(get_buffer)},
                         {Py_bf_releasebuffer, slot(release_buffer)},
                         {Py_tp_methods, methods},
                         {Py_tp_members, members},
                         {Py_tp_doc, const_cast<char*>(kText)},
                         {0, nullptr}};
  PyType_Spec spec = {"lot._lot.Part", sizeof(PartObject), 0,
                      Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION, slots};
  auto type = py::reinterpret_steal<py::object>(PyType_FromSpec(&spec));
  if (!type) throw py::error_already_set();
  module.attr("Part") = type;
  part_type = reinterpret_cast<PyTypeObject*>(type.release().ptr());
}

}  // namespace lot::python
