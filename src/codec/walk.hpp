// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "codec/program.hpp"
#include "description/reader.hpp"

namespace lot::codec {

/// Goes over the steps of a message, for an encoder and for a decoder. `V` is Value or
/// MutableValue, `Byte` a byte of the message. `Worker` derives from this and has:
///
///     position(), align(value, to)          in the bytes of CDR
///     bytes_of(value)                       where a value lies
///     numbers(value, at, bytes), bools(value, at, count), blank(value), clear(at, bytes)
///     text(part), bits(part, step)
///     items(part, step)                     the elements of a vector that are left to do
///
/// Invariants
///   - Each address comes from a Value, which has found all bytes of its type in the segment; a
///     Program's offsets stay in the type.
template <class Worker, class V, class Byte>
class Walk {
 protected:
  explicit Walk(const Program& program) : program_(program) {}

  /// All steps of a message.
  void message(const V& value) {
    const std::vector<Step>& steps = program_.steps();
    body(value, steps.data(), steps.data() + steps.size());
  }

 private:
  Worker& worker() noexcept { return static_cast<Worker&>(*this); }

  void body(const V& value, const Step* step, const Step* end) {
    Byte* const at = worker().bytes_of(value);
    for (; step != end; step += 1 + step->body) {
      if (step->needs_value) {
        placed(program_.part(value, *step), step);
      } else {
        flat(value, at, step);
      }
    }
  }

  /// A step about a part that is more than the bytes of its struct.
  void placed(const V& part, const Step* step) {
    if (step->what == Do::Text) return worker().text(part);
    if (step->what == Do::Bits) return worker().bits(part, *step);
    const Step* const first = step + 1;
    const Step* const end = first + step->body;
    const bool is_flat = std::none_of(first, end, [](const Step& s) { return s.needs_value; });
    const detail::ValueAccess::Items items =
        step->what == Do::Items ? worker().items(part, *step) : detail::ValueAccess::items(part);
    if (is_flat) return flat_items(part, const_cast<Byte*>(items.data), items.count, step);
    for (std::uint64_t i = 0; i < items.count; ++i) body(part[std::size_t{i}], first, end);
  }

  /// A step that is only about bytes at `at`, which are of `value` or of a part of it.
  void flat(const V& value, Byte* at, const Step* step) {
    switch (step->what) {
      case Do::Numbers:
        worker().align(value, step->align);
        return worker().numbers(value, at + step->offset, step->count * step->align);
      case Do::Bools:
        return worker().bools(value, at + step->offset, step->count);
      case Do::Blank:
        return worker().blank(value);
      case Do::Clear:
        return worker().clear(at + step->offset, step->count);
      case Do::Run:
        worker().align(value, step->align);
        if (is_one_copy(worker().position(), step->offset, step->widest)) {
          return worker().numbers(value, at + step->offset, step->count);
        }
        return flat_body(value, at, step);
      default:
        return flat_items(value, at + step->offset, step->count, step);
    }
  }
  void flat_body(const V& value, Byte* at, const Step* of) {
    const Step* const end = of + 1 + of->body;
    for (const Step* step = of + 1; step != end; step += 1 + step->body) flat(value, at, step);
  }
  /// Elements whose bytes are all of them.
  void flat_items(const V& value, Byte* at, std::uint64_t number, const Step* step) {
    if (number == 0) return;
    if (step->widest != 0) {
      worker().align(value, step->align);
      if (is_one_copy(worker().position(), 0, step->widest)) {
        return worker().numbers(value, at, number * step->stride);
      }
    }
    for (std::uint64_t i = 0; i < number; ++i) flat_body(value, at + i * step->stride, step);
  }

  const Program& program_;
};

}  // namespace lot::codec
