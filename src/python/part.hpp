// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include <pybind11/pybind11.h>

#include "lot/value.hpp"

#include "python/held.hpp"

namespace lot::python {

/// A struct, array, vector, or opaque value in a message, or the whole message.
///
/// Threads: under the GIL.
class Part {
 public:
  /// The whole message. Throws lot::Error.
  explicit Part(const std::shared_ptr<Held>& held) : Part(held, held->root()) { is_whole_ = true; }
  Part(std::shared_ptr<Held> held, const Value& value)
      : held_(std::move(held)), value_(value), generation_(held_->generation()) {}

  const std::shared_ptr<Held>& held() const noexcept { return held_; }
  /// Where it lies now. Throws ValueError after the end, lot::Error where it has gone.
  const Value& value() const;
  /// True: it is the message itself.
  bool is_whole() const noexcept { return is_whole_; }
  /// Throws TypeError.
  void require_whole() const;

  /// The message itself, to be kept. Throws TypeError for a part of it, or a loan; lot::Error.
  AnyMessage message() const;

  pybind11::object attribute(std::string_view name) const;
  pybind11::object item(const pybind11::object& key) const;
  void set_attribute(std::string_view name, pybind11::handle object);
  void set_item(const pybind11::object& key, pybind11::handle object);
  std::size_t size() const { return value().size(); }
  void resize(std::size_t count);
  void assign(pybind11::handle object);
  pybind11::list fields() const;
  /// All of it in one line.
  pybind11::object text() const;
  /// A copy in plain Python.
  pybind11::object copy() const;

 private:
  /// The same place, to be written. Throws TypeError where it is no loan, ValueError, lot::Error.
  MutableValue building() const;
  std::size_t index(pybind11::handle key) const;

  std::shared_ptr<Held> held_;
  mutable Value value_;
  mutable std::uint64_t generation_;
  bool is_whole_ = false;
};

/// What Python sees of a value: a number, a text, None, or a part. Throws lot::Error.
pybind11::object to_python(const std::shared_ptr<Held>& held, const Value& value);

/// The part as a lot.Part: a type without pybind11's tables, since each message makes some of
/// these. Throws error_already_set.
pybind11::object to_object(Part part);
/// False: it is no lot.Part.
bool is_part(pybind11::handle object) noexcept;
/// REQUIRES: is_part().
Part& part_of(pybind11::handle object) noexcept;

/// True where numpy and memoryview can look at the part: the elements are just bytes. Throws
/// lot::Error.
bool has_buffer(const Part& part);
/// Of lot.Part: how they look, as CPython calls it.
int get_buffer(PyObject* self, Py_buffer* buffer, int flags) noexcept;
void release_buffer(PyObject* self, Py_buffer* buffer) noexcept;

/// REQUIRES: define_part_type() came before.
void define_part(pybind11::module_& module);
void define_part_type(pybind11::module_& module);

}  // namespace lot::python

/// Functions that are bound take and give parts.
template <>
class pybind11::detail::type_caster<lot::python::Part> {
 public:
  static constexpr auto name = const_name("lot.Part");
  template <class T>
  using cast_op_type = const lot::python::Part&;

  bool load(handle source, bool) noexcept {
    if (!lot::python::is_part(source)) return false;
    part_ = &lot::python::part_of(source);
    return true;
  }
  static handle cast(lot::python::Part part, return_value_policy, handle) {
    return lot::python::to_object(std::move(part)).release();
  }
  // NOLINTNEXTLINE(google-explicit-constructor): as pybind11 has it
  operator const lot::python::Part&() const noexcept { return *part_; }

 private:
  const lot::python::Part* part_ = nullptr;
};
