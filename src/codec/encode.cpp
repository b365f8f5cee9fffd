// SPDX-License-Identifier: Apache-2.0
#include "codec/encode.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>

#include "codec/walk.hpp"
#include "description/reader.hpp"

namespace lot::codec {

using Access = detail::ValueAccess;

/// Carries the steps out. The message may change meanwhile: what has to be looked at is looked at
/// in the copy.
class Encoder : private Walk<Encoder, Value, const unsigned char> {
 public:
  Encoder(const Program& program, Encoded& into) : Walk(program), to_(into) {
    to_.size_ = 0;
    to_.buffer_.clear();
    to_.large_.clear();
  }

  void run(const Value& value) {
    constexpr std::array<unsigned char, kHeadBytes> kHead{0, 1, 0, 0};
    numbers(value, kHead.data(), kHead.size());
    message(value);
  }

 private:
  friend Walk;

  /// The position in the payload.
  std::uint64_t position() const noexcept { return to_.size_ - kHeadBytes; }

  void count(const Value& about, std::uint64_t bytes) {
    if (bytes > to_.most_ - std::min(to_.most_, to_.size_)) {
      Access::refuse(about, EMSGSIZE,
                     "it has more than the " + std::to_string(to_.most_) +
                         " bytes that a message may have here");
    }
    to_.size_ += bytes;
  }
  void numbers(const Value& about, const unsigned char* from, std::uint64_t bytes) {
    count(about, bytes);
    const auto* const first = reinterpret_cast<const std::byte*>(from);
    if (bytes >= to_.large_from_) {
      to_.large_.push_back({to_.buffer_.size(), Bytes(first, bytes)});
    } else {
      to_.buffer_.insert(to_.buffer_.end(), first, first + bytes);
    }
  }
  void add_word(const Value& about, std::uint64_t word, std::uint64_t bytes) {
    align(about, bytes);
    std::array<std::byte, 8> little{};
    std::memcpy(little.data(), &word, sizeof word);
    count(about, bytes);
    to_.buffer_.insert(to_.buffer_.end(), little.begin(),
                       little.begin() + static_cast<std::ptrdiff_t>(bytes));
  }
  void align(const Value& about, std::uint64_t to) {
    const std::uint64_t bytes = padding(position(), to);
    count(about, bytes);
    to_.buffer_.resize(to_.buffer_.size() + bytes);
  }
  void add_count(const Value& about, std::uint64_t number) {
    if (number > std::numeric_limits<std::uint32_t>::max()) {
      Access::refuse(about, ERANGE,
                     "it has " + std::to_string(number) + " parts, more than CDR can");
    }
    add_word(about, number, sizeof(std::uint32_t));
  }
  void bools(const Value& about, const unsigned char* from, std::uint64_t number) {
    count(about, number);
    const auto* const first = reinterpret_cast<const std::byte*>(from);
    const std::size_t before = to_.buffer_.size();
    to_.buffer_.insert(to_.buffer_.end(), first, first + number);
    const auto bad = std::find_if(to_.buffer_.begin() + static_cast<std::ptrdiff_t>(before),
                                  to_.buffer_.end(), [](std::byte b) { return b > std::byte{1}; });
    if (bad != to_.buffer_.end()) {
      Access::refuse(about, EBADMSG, "a bool is " + std::to_string(std::to_integer<unsigned>(*bad)),
                     "its publisher has not set it; or a process writes where it should not");
    }
  }

  static const unsigned char* bytes_of(const Value& value) noexcept {
    return Access::address(value);
  }
  void blank(const Value& about) { add_word(about, 0, 1); }
  static void clear(const unsigned char* /*at*/, std::uint64_t /*bytes*/) noexcept {}
  Access::Items items(const Value& part, const Step& /*step*/) {
    const Access::Items items = Access::items(part);
    add_count(part, items.count);
    return items;
  }

  void text(const Value& part) {
    const std::string_view text = Access::text(part);
    add_count(part, text.size() + 1);
    numbers(part, reinterpret_cast<const unsigned char*>(text.data()), text.size());
    add_word(part, 0, 1);
  }

  void bits(const Value& part, const Step& step) {
    const std::uint64_t word = step.is_signed ? static_cast<std::uint64_t>(part.as<std::int64_t>())
                                              : part.as<std::uint64_t>();
    add_word(part, word, step.count);
  }

  Encoded& to_;
};

std::vector<Bytes> Encoded::pieces() const {
  std::vector<Bytes> result;
  std::size_t done = 0;
  for (const Large& large : large_) {
    if (large.before != done) result.emplace_back(buffer_.data() + done, large.before - done);
    result.push_back(large.bytes);
    done = large.before;
  }
  if (done != buffer_.size()) result.emplace_back(buffer_.data() + done, buffer_.size() - done);
  return result;
}

void Encoded::pad(std::uint64_t bytes) {
  const std::uint64_t more = padding(size_, bytes);
  buffer_.resize(buffer_.size() + more);
  size_ += more;
}

void encode(const Program& program, const Value& message, Encoded& into) {
  program.require(message);
  Encoder(program, into).run(message);
}

}  // namespace lot::codec
