// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "lot/description.hpp"
#include "lot/value.hpp"

/// A description as a flat list of steps, by which messages become CDR and back (docs/codec.md).
namespace lot::codec {

/// Four bytes that say how the rest is encoded: XCDR1, little-endian, no options.
inline constexpr std::uint64_t kHeadBytes = 4;

/// What a step does.
enum class Do : std::uint8_t {
  Numbers,  ///< so many numbers of one size, side by side
  Bools,    ///< so many bytes, each 0 or 1
  Run,      ///< steps that are one copy where the position allows it
  Blank,    ///< a struct without fields: a byte, which is 0
  Clear,    ///< bytes of the message that CDR does not have: a decoder sets them to 0
  Each,     ///< the elements of an array
  Items,    ///< the elements of a vector
  Text,     ///< a string
  Bits      ///< a bit-field
};

/// One step. Offsets count from the begin of the body's value: of the message, or of an element.
struct Step {
  Do what = Do::Numbers;
  std::uint8_t align = 1;      ///< what the first number is aligned to
  std::uint8_t widest = 0;     ///< Run; Each, Items: the largest alignment; 0: no element is a run
  bool is_signed = false;      ///< Bits
  bool needs_value = false;    ///< it, or a step of its body, looks at more than the struct's bytes
  std::uint32_t body = 0;      ///< Run, Each, Items: how many of the next steps belong to it
  std::uint64_t offset = 0;    ///< where it lies
  std::uint64_t count = 0;     ///< Numbers, Bools, Each: how many; Run, Clear, Bits: bytes
  std::uint64_t stride = 0;    ///< Each, Items: bytes of an element; Text, Bits: its own
  std::uint64_t least = 0;     ///< Each, Items: bytes of CDR that an element has at least
  std::uint32_t way = 0;       ///< where it begins in ways()
  std::uint32_t way_size = 0;  ///< how many fields lead from the body's value to it
};

/// A description, compiled. See encode() and decode().
///
/// Threads: any number may use one.
/// Errors:  the constructor throws lot::Error, which names the path: EINVAL for what ROS 2 does not
///          have, EBADMSG for a description that contradicts itself, ENOTSUP on a big-endian
///          machine; and std::bad_alloc.
/// Memory:  on the heap. The description must outlive it.
/// Crash:   nothing of it is shared.
class Program {
 public:
  explicit Program(const Description& description);

  const Description& description() const noexcept { return *description_; }
  const std::vector<Step>& steps() const noexcept { return steps_; }
  /// The value that a step is about, by the fields that lead to it. Throws as Value.
  template <class V>
  V part(const V& body, const Step& step) const {
    V found = body;
    for (std::uint32_t i = 0; i < step.way_size; ++i) {
      found = found[std::size_t{ways_[step.way + i]}];
    }
    return found;
  }
  /// Throws lot::Error (EINVAL) unless it is a whole message of this description, and lies in its
  /// segment (EBADMSG).
  void require(const Value& message) const;

 private:
  const Description* description_;
  std::vector<Step> steps_;
  std::vector<std::uint32_t> ways_;
};

/// Bytes until the next multiple of `align`, a power of two.
inline std::uint64_t padding(std::uint64_t position, std::uint64_t align) noexcept {
  return (~position + 1) & (align - 1);
}
/// Whether a run of numbers that lies at `offset` is one copy at this position, which is aligned
/// for the first of them.
inline bool is_one_copy(std::uint64_t position, std::uint64_t offset,
                        std::uint8_t widest) noexcept {
  return ((position - offset) & (widest - std::uint64_t{1})) == 0;
}

}  // namespace lot::codec
