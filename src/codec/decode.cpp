// SPDX-License-Identifier: Apache-2.0
#include "codec/decode.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <string_view>

#include "codec/walk.hpp"
#include "description/reader.hpp"

namespace lot::codec {
namespace {

using Access = detail::ValueAccess;

/// Carries the steps out, backwards: take() has found the bytes of the input that are looked at.
class Decoder : private Walk<Decoder, MutableValue, unsigned char> {
 public:
  Decoder(const Program& program, Bytes bytes)
      : Walk(program), at_(bytes.data()), size_(bytes.size()) {}

  void run(const MutableValue& value) {
    const std::byte* const head = take(value, kHeadBytes);
    if (head[0] != std::byte{0} || head[1] != std::byte{1}) {
      Access::refuse(value, ENOTSUP,
                     "its bytes are of another encoding than CDR in little-endian order");
    }
    message(value);
    constexpr std::uint64_t kMostPadding = 3;
    if (left() > kMostPadding) {
      Access::refuse(value, EBADMSG, std::to_string(left()) + " bytes are left behind it",
                     "they are of another type, or of another version of this one");
    }
  }

 private:
  friend Walk;

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

  static unsigned char* bytes_of(const MutableValue& value) noexcept {
    return const_cast<unsigned char*>(Access::address(value));
  }
  void numbers(const Value& about, unsigned char* to, std::uint64_t bytes) {
    std::memcpy(to, take(about, bytes), bytes);
  }
  void bools(const Value& about, unsigned char* to, std::uint64_t number) {
    const std::byte* const taken = take(about, number);
    const auto* const bad =
        std::find_if(taken, taken + number, [](std::byte b) { return b > std::byte{1}; });
    if (bad != taken + number) {
      Access::refuse(about, EBADMSG,
                     "a bool is " + std::to_string(std::to_integer<unsigned>(*bad)));
    }
    std::memcpy(to, taken, number);
  }
  void blank(const Value& about) { (void)take(about, 1); }
  static void clear(unsigned char* at, std::uint64_t bytes) noexcept { std::memset(at, 0, bytes); }

  /// Gives a vector its elements. None is left to do where one copy has made them all.
  Access::Items items(const MutableValue& part, const Step& step) {
    const std::uint64_t number = take_word(part, sizeof(std::uint32_t));
    if (number > left() / step.least) {
      Access::refuse(part, EBADMSG,
                     "it says that it has " + std::to_string(number) + " elements, and " +
                         std::to_string(left()) + " bytes are left");
    }
    if (number != 0 && step.widest != 0) {
      align(part, step.align);
      if (is_one_copy(position(), 0, step.widest)) {
        const std::uint64_t bytes = number * step.stride;
        part.assign({take(part, bytes), bytes});
        return {};
      }
    }
    part.resize(number);
    return Access::items(part);
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
