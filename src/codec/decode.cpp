// SPDX-License-Identifier: Apache-2.0
#include "codec/decode.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <string_view>

#include "description/reader.hpp"

namespace lot::codec {
namespace {

using Access = detail::ValueAccess;

unsigned char* address_of(const MutableValue& value) {
  return const_cast<unsigned char*>(Access::address(value));
}

/// Carries the steps out, backwards.
///
/// Invariants
///   - take() has found the bytes of the input that are looked at.
///   - Each address comes from a MutableValue, which has found all bytes of its type in the
///     segment.
class Decoder {
 public:
  Decoder(const Program& program, Bytes bytes)
      : program_(program), at_(bytes.data()), size_(bytes.size()) {}

  void run(const MutableValue& message) {
    const std::byte* const head = take(message, kHeadBytes);
    if (head[0] != std::byte{0} || head[1] != std::byte{1}) {
      Access::refuse(message, ENOTSUP,
                     "its bytes are of another encoding than CDR in little-endian order");
    }
    const std::vector<Step>& steps = program_.steps();
    body(message, steps.data(), steps.data() + steps.size());
    constexpr std::uint64_t kMostPadding = 3;
    if (left() > kMostPadding) {
      Access::refuse(message, EBADMSG, std::to_string(left()) + " bytes are left behind it",
                     "they are of another type, or of another version of this one");
    }
  }

 private:
  std::uint64_t left() const noexcept { return size_ - done_; }
  std::uint64_t position() const noexcept { return done_ - kHeadBytes; }

  /// The next bytes.
  const std::byte* take(const Value& about, std::uint64_t bytes) {
    if (bytes > left()) {
      Access::refuse(about, EBADMSG,
                     "it wants " + std::to_string(bytes) + " bytes, and " + std::to_string(left()) +
                         " are left");
    }
    const std::byte* const taken = at_ + done_;
    done_ += bytes;
    return taken;
  }
  void align(const Value& about, std::uint64_t to) { (void)take(about, padding(position(), to)); }
  std::uint64_t take_word(const Value& about, std::uint64_t bytes) {
    align(about, bytes);
    std::uint64_t word = 0;
    std::memcpy(&word, take(about, bytes), bytes);
    return word;
  }
  static void require_bools(const Value& about, const std::byte* bytes, std::uint64_t number) {
    const auto* const bad =
        std::find_if(bytes, bytes + number, [](std::byte b) { return b > std::byte{1}; });
    if (bad == bytes + number) return;
    Access::refuse(about, EBADMSG, "a bool is " + std::to_string(std::to_integer<unsigned>(*bad)));
  }

  /// All steps of a value.
  void body(const MutableValue& value, const Step* step, const Step* end) {
    unsigned char* const to = address_of(value);
    for (; step != end; step += 1 + step->body) {
      if (!step->needs_value) {
        flat(value, to, step);
        continue;
      }
      const MutableValue part = program_.part(value, *step);
      if (step->what == Do::Text) {
        text(part);
      } else if (step->what == Do::Bits) {
        bits(part, *step);
      } else {
        items(part, step);
      }
    }
  }

  /// A step that writes only bytes at `to`, which are of `value` or of a part of it.
  void flat(const Value& value, unsigned char* to, const Step* step) {
    switch (step->what) {
      case Do::Numbers:
        align(value, step->align);
        return copy(value, to + step->offset, step->count * step->align);
      case Do::Bools:
        require_bools(value, at_ + done_, std::min(step->count, left()));
        return copy(value, to + step->offset, step->count);
      case Do::Blank:
        (void)take(value, 1);
        return;
      case Do::Clear:
        std::memset(to + step->offset, 0, step->count);
        return;
      case Do::Run:
        align(value, step->align);
        if (is_one_copy(position(), step->offset, step->widest)) {
          return copy(value, to + step->offset, step->count);
        }
        return flat_body(value, to, step);
      default:
        return flat_items(value, to + step->offset, step->count, step);
    }
  }
  void flat_body(const Value& value, unsigned char* to, const Step* of) {
    const Step* const end = of + 1 + of->body;
    for (const Step* step = of + 1; step != end; step += 1 + step->body) flat(value, to, step);
  }
  void copy(const Value& about, unsigned char* to, std::uint64_t bytes) {
    std::memcpy(to, take(about, bytes), bytes);
  }
  /// Elements whose bytes are all of them.
  void flat_items(const Value& value, unsigned char* to, std::uint64_t number, const Step* step) {
    if (number == 0) return;
    if (step->widest != 0) {
      align(value, step->align);
      if (is_one_copy(position(), 0, step->widest)) return copy(value, to, number * step->stride);
    }
    for (std::uint64_t i = 0; i < number; ++i) flat_body(value, to + i * step->stride, step);
  }

  void items(const MutableValue& part, const Step* step) {
    if (step->what == Do::Items && !make(part, step)) return;
    const Access::Items items = Access::items(part);
    const bool is_flat =
        std::none_of(step + 1, step + 1 + step->body, [](const Step& s) { return s.needs_value; });
    if (is_flat) {
      return flat_items(part, const_cast<unsigned char*>(items.data), items.count, step);
    }
    for (std::uint64_t i = 0; i < items.count; ++i) {
      body(part[i], step + 1, step + 1 + step->body);
    }
  }
  /// Gives a vector its elements. False: it has got all that they are, by one copy.
  bool make(const MutableValue& part, const Step* step) {
    const std::uint64_t number = take_word(part, sizeof(std::uint32_t));
    if (number > left() / step->least) {
      Access::refuse(part, EBADMSG,
                     "it says that it has " + std::to_string(number) + " elements, and " +
                         std::to_string(left()) + " bytes are left");
    }
    if (number != 0 && step->widest != 0) {
      align(part, step->align);
      if (is_one_copy(position(), 0, step->widest)) {
        const std::uint64_t bytes = number * step->stride;
        part.assign({take(part, bytes), bytes});
        return false;
      }
    }
    part.resize(number);
    return true;
  }

  void text(const MutableValue& part) {
    const std::uint64_t bytes = take_word(part, sizeof(std::uint32_t));
    const auto* const first = reinterpret_cast<const char*>(take(part, bytes));
    if (bytes != 0 && first[bytes - 1] != '\0') {
      Access::refuse(part, EBADMSG, "its text does not end with a zero byte");
    }
    part.set(std::string_view(first, bytes == 0 ? 0 : bytes - 1));
  }

  void bits(const MutableValue& part, const Step& step) {
    const std::uint64_t word = take_word(part, step.count);
    if (!step.is_signed) return part.set(word);
    const std::uint64_t above = 64 - 8 * step.count;
    part.set(static_cast<std::int64_t>(word << above) >> above);
  }

  const Program& program_;
  const std::byte* at_;
  std::uint64_t size_;
  std::uint64_t done_ = 0;
};

}  // namespace

void decode(const Program& program, Bytes bytes, const MutableValue& message) {
  program.require(message);
  Decoder(program, bytes).run(message);
}

}  // namespace lot::codec
