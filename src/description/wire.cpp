// SPDX-License-Identifier: Apache-2.0
#include "description/wire.hpp"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "lot/detail/described.hpp"

namespace lot::description {
namespace {

constexpr unsigned char kFormat = 1;  ///< the first byte

/// Numbers are LEB128: seven bits a byte, the lowest first; the top bit says that more follow.
class Bytes {
 public:
  Bytes() { bytes_.reserve(kUsual); }
  void add(std::uint64_t number) {
    while (number >= 0x80) {
      bytes_.push_back(static_cast<char>(0x80 | (number & 0x7f)));
      number >>= 7;
    }
    bytes_.push_back(static_cast<char>(number));
  }
  void add(std::string_view text) {
    add(text.size());
    bytes_.append(text);
  }
  void add(const Description::Type& type) {
    add(static_cast<std::uint64_t>(type.kind));
    add(type.size);
    add(type.name);
    add(type.element == Description::kNone ? 0 : std::uint64_t{type.element} + 1);
    add(type.count);
    add(static_cast<std::uint64_t>(type.numerator));
    add(static_cast<std::uint64_t>(type.denominator));
    add(type.fields.size());
    for (const Description::Field& field : type.fields) {
      add(field.name);
      add(field.type);
      add(field.offset);
      add(field.bit);
      add(field.bits);
    }
  }
  std::string take() && { return std::move(bytes_); }

 private:
  static constexpr std::size_t kUsual = 1024;  ///< most descriptions are shorter

  std::string bytes_;
};

/// Takes bytes apart. Where they end too early it says so once, and gives zeros from then on.
class Parser {
 public:
  explicit Parser(std::string_view bytes) : rest_(bytes) {}

  std::uint64_t number(std::uint64_t most) {
    std::uint64_t value = 0;
    for (unsigned shift = 0; shift < 64; shift += 7) {
      if (rest_.empty()) break;
      const auto byte = static_cast<unsigned char>(rest_.front());
      rest_.remove_prefix(1);
      const std::uint64_t bits = byte & 0x7f;
      if ((bits << shift) >> shift != bits) break;  // more than 64 bits
      value |= bits << shift;
      if ((byte & 0x80) != 0) continue;
      if ((byte == 0 && shift != 0) || value > most) break;  // one number, one spelling
      return value;
    }
    good_ = false;
    rest_ = {};
    return 0;
  }
  std::string text() {
    const std::uint64_t size = number(rest_.size());
    if (size > rest_.size()) {
      good_ = false;
      return {};
    }
    std::string result(rest_.substr(0, size));
    rest_.remove_prefix(size);
    return result;
  }
  /// How many of something follow, each of which takes `least` bytes or more.
  std::size_t count(std::size_t least) { return number(rest_.size() / least); }
  bool is_good() const { return good_; }
  bool is_at_end() const { return rest_.empty(); }

 private:
  std::string_view rest_;
  bool good_ = true;
};

constexpr std::uint64_t kMostSize = std::uint64_t{1} << 48;
constexpr std::size_t kLeastType = 8;   ///< bytes
constexpr std::size_t kLeastField = 5;  ///< bytes

Description::Field parse_field(Parser& parser, std::size_t types) {
  Description::Field field;
  field.name = parser.text();
  field.type = static_cast<std::uint32_t>(parser.number(types - 1));
  field.offset = parser.number(kMostSize);
  field.bit = static_cast<std::uint32_t>(parser.number(7));
  field.bits = static_cast<std::uint32_t>(parser.number(64));
  return field;
}

Description::Type parse_type(Parser& parser, std::size_t types) {
  constexpr std::uint64_t kLast = static_cast<std::uint64_t>(Kind::Reference);
  Description::Type type;
  type.kind = static_cast<Kind>(parser.number(kLast));
  type.size = parser.number(kMostSize);
  type.name = parser.text();
  const std::uint64_t element = parser.number(types);
  if (element != 0) type.element = static_cast<std::uint32_t>(element - 1);
  type.count = parser.number(kMostSize);
  type.numerator = static_cast<std::int64_t>(parser.number(INT64_MAX));
  type.denominator = static_cast<std::int64_t>(parser.number(INT64_MAX));
  const std::size_t fields = parser.count(kLeastField);
  for (std::size_t i = 0; i < fields && parser.is_good(); ++i) {
    type.fields.push_back(parse_field(parser, types));
  }
  return type;
}

bool is_one_of(std::uint64_t value, std::initializer_list<std::uint64_t> values) {
  return std::find(values.begin(), values.end(), value) != values.end();
}

/// Whether a description that was parsed could be one of a type: of each kind, what lies in it.
class Check {
 public:
  explicit Check(const Description& description) : all_(description) {}

  bool is_good() const {
    return std::all_of(all_.types.begin(), all_.types.end(), [this](const Description::Type& t) {
      return has_element(t) == (t.element != Description::kNone) &&
             (t.kind == Kind::Struct || t.fields.empty()) &&
             (t.kind == Kind::Array || t.count == 0) &&
             (t.kind == Kind::Duration) == (t.denominator != 0) &&
             (t.kind == Kind::Duration) == (t.numerator != 0) && is_good(t);
    });
  }

 private:
  /// An opaque type may say what it holds.
  static bool has_element(const Description::Type& t) {
    switch (t.kind) {
      case Kind::Enum:
      case Kind::Duration:
      case Kind::TimePoint:
      case Kind::Array:
      case Kind::String:
      case Kind::Vector:
      case Kind::Reference:
        return true;
      case Kind::Opaque:
        return t.element != Description::kNone;
      default:
        return false;
    }
  }
  const Description::Type& element(const Description::Type& t) const {
    return all_.types[t.element];
  }
  bool is_good(const Description::Type& t) const {
    switch (t.kind) {
      case Kind::Bool:
      case Kind::Char:
        return t.size == 1;
      case Kind::Int:
      case Kind::UInt:
        return is_one_of(t.size, {1, 2, 4, 8});
      case Kind::Float:
        return is_one_of(t.size, {4, 8, 12, 16});
      case Kind::Enum:
        return element(t).size == t.size && (element(t).kind == Kind::Int || is_plain(element(t)));
      case Kind::Duration:
        return element(t).size == t.size && (element(t).kind == Kind::Float ||
                                             element(t).kind == Kind::Int || is_plain(element(t)));
      case Kind::TimePoint:
        return element(t).size == t.size && element(t).kind == Kind::Duration;
      case Kind::Array:
        return element(t).size != 0 && t.size / element(t).size == t.count &&
               t.size % element(t).size == 0;
      case Kind::Struct:
        return t.size != 0 && std::all_of(t.fields.begin(), t.fields.end(),
                                          [&](const auto& field) { return lies_in(t, field); });
      case Kind::String:
        return element(t).kind == Kind::Char && t.size != 0;
      default:
        return t.size != 0;
    }
  }
  static bool is_plain(const Description::Type& t) {
    return t.kind == Kind::UInt || t.kind == Kind::Bool || t.kind == Kind::Char;
  }
  bool lies_in(const Description::Type& whole, const Description::Field& field) const {
    const Description::Type& type = all_.types[field.type];
    if (field.bits == 0) {
      return field.bit == 0 && field.offset <= whole.size && type.size <= whole.size - field.offset;
    }
    const bool is_integer = type.kind == Kind::Int || type.kind == Kind::Enum || is_plain(type);
    return is_integer && field.bits <= 8 * type.size && field.offset < whole.size &&
           (field.bit + field.bits + 7) / 8 <= whole.size - field.offset;
  }

  const Description& all_;
};

/// True when no value of a type lies in a value of the same type, which would have no end, and each
/// is within the limits. What lies elsewhere (behind a vector or a reference) may be of the same
/// type.
class Inside {
 public:
  explicit Inside(const Description& description)
      : all_(description), sizes_(description.types.size()) {}

  bool all_end() {
    for (std::uint32_t i = 0; i < all_.types.size(); ++i) {
      if (!ends(i, 0)) return false;
    }
    return true;
  }

 private:
  /// Of what lies in a value of a type, how often it may stand there.
  struct Size {
    std::size_t levels = 0;
    std::size_t steps = 0;  ///< 0: not known yet
  };

  bool ends(std::uint32_t place, std::size_t level) {
    Size& size = sizes_[place];
    if (size.steps != 0) return true;
    if (level > kMostLevels) return false;  // as where a type lies in itself
    const Description::Type& t = all_.types[place];
    const bool elsewhere = t.kind == Kind::String || t.kind == Kind::Vector ||
                           t.kind == Kind::Reference || t.kind == Kind::Opaque;
    Size sum;
    sum.steps = 1;
    if (!elsewhere && t.element != Description::kNone && !add(t.element, level, sum)) return false;
    for (const Description::Field& field : t.fields) {
      if (!add(field.type, level, sum)) return false;
    }
    size = sum;
    return true;
  }
  bool add(std::uint32_t part, std::size_t level, Size& sum) {
    if (!ends(part, level + 1)) return false;
    sum.levels = std::max(sum.levels, sizes_[part].levels + 1);
    sum.steps += sizes_[part].steps;
    return sum.levels <= kMostLevels && sum.steps <= kMostSteps;
  }

  const Description& all_;
  std::vector<Size> sizes_;
};

bool is_sound(const Description& description) {
  return Check(description).is_good() && Inside(description).all_end() && is_small(description);
}

}  // namespace

std::string encode(const Description& description) {
  if (!is_sound(description)) return {};
  Bytes bytes;
  bytes.add(kFormat);
  bytes.add(description.types.size());
  for (const Description::Type& type : description.types) bytes.add(type);
  std::string result = std::move(bytes).take();
  if (result.size() > kMostBytes) result.clear();
  return result;
}

std::optional<Description> decode(std::string_view bytes) {
  if (bytes.size() > kMostBytes) return std::nullopt;
  Parser parser(bytes);
  if (parser.number(kFormat) != kFormat) return std::nullopt;
  Description description;
  const std::size_t types = parser.count(kLeastType);
  if (types == 0) return std::nullopt;
  for (std::size_t i = 0; i < types && parser.is_good(); ++i) {
    description.types.push_back(parse_type(parser, types));
  }
  if (!parser.is_good() || !parser.is_at_end() || !is_sound(description)) return std::nullopt;
  return description;
}

}  // namespace lot::description

namespace lot::detail {

Described make_described(const Description& description) {
  return {description.layout_hash(), description.names_hash(), description::has_names(description),
          description::encode(description)};
}

}  // namespace lot::detail
