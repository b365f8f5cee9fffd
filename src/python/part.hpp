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
  void set_attribute(const std::string& name, pybind11::handle object);
  void set_item(const pybind11::object& key, pybind11::handle object);
  std::size_t size() const { return value().size(); }
  void resize(std::size_t count);
  void assign(pybind11::handle object);
  pybind11::list fields() const;
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

/// Lets numpy and memoryview look at parts, without a copy, and finds fields as attributes.
void add_protocols(PyHeapTypeObject* type);
/// True where that works: the elements are just bytes. Throws lot::Error.
bool has_buffer(const Part& part);

void define_part(pybind11::module_& module);

}  // namespace lot::python
