// SPDX-License-Identifier: Apache-2.0
#include "python/errors.hpp"

#include <cerrno>
#include <exception>
#include <new>
#include <string>

#include "lot/error.hpp"

namespace py = pybind11;

namespace lot::python {
namespace {

PyObject* error_type = nullptr;          // never released: it lives as long as the module
PyObject* out_of_memory_type = nullptr;  // the same

/// A new reference; null: what failed is set. Texts of others may be no UTF-8.
PyObject* decoded(const std::string& text) noexcept {
  return PyUnicode_DecodeUTF8(text.data(), static_cast<Py_ssize_t>(text.size()), "surrogateescape");
}

void raise(PyObject* type, int number, const std::string& what,
           const std::string& object) noexcept {
  PyObject* const text = decoded(what);
  PyObject* const its = decoded(object);
  PyObject* const error =
      text != nullptr && its != nullptr ? PyObject_CallFunction(type, "iO", number, text) : nullptr;
  if (error != nullptr && PyObject_SetAttrString(error, "object", its) == 0) {
    PyErr_SetObject(type, error);
  }
  Py_XDECREF(error);
  Py_XDECREF(its);
  Py_XDECREF(text);
}

}  // namespace

void set_error(const std::exception_ptr& thrown) {
  try {
    if (thrown) std::rethrow_exception(thrown);
  } catch (const OutOfMemory& error) {
    raise(out_of_memory_type, ENOBUFS, error.what(), "segment");
  } catch (const Error& error) {
    if (error.error_number() == ERANGE) {
      PyErr_SetString(PyExc_OverflowError, error.what());
    } else {
      raise(error_type, error.error_number(), error.what(), error.object());
    }
  }
}

void set_current_error() noexcept {
  try {
    try {
      throw;
    } catch (py::error_already_set& error) {
      error.restore();
    } catch (const py::builtin_exception& error) {
      error.set_error();
    } catch (const OutOfMemory&) {
      set_error(std::current_exception());
    } catch (const Error&) {
      set_error(std::current_exception());
    } catch (const std::bad_alloc&) {
      PyErr_NoMemory();
    } catch (const std::exception& error) {
      PyErr_SetString(PyExc_RuntimeError, error.what());
    }
  } catch (...) {
    PyErr_SetString(PyExc_RuntimeError, "an exception that has no text");
  }
}

void define_errors(py::module_& module) {
  const auto make = [&](const char* name, const char* text, const py::tuple& bases) {
    py::dict attributes;
    attributes["__doc__"] = text;
    attributes["__module__"] = "lot";
    attributes["object"] = "";
    const py::object made = py::module_::import("builtins").attr("type")(name, bases, attributes);
    module.attr(name) = made;
    return py::object(made).release().ptr();
  };
  error_type =
      make("Error", "A failure from outside: errno, a text that says what to do, and `object`.",
           py::make_tuple(py::handle(PyExc_OSError)));
  out_of_memory_type = make("OutOfMemory", "The segment has no room for a message.",
                            py::make_tuple(py::handle(error_type), py::handle(PyExc_MemoryError)));
  // NOLINTNEXTLINE(performance-unnecessary-value-param): pybind11 gives it by value
  py::register_exception_translator([](std::exception_ptr thrown) { set_error(thrown); });
}

}  // namespace lot::python
