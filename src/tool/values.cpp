// SPDX-License-Identifier: Apache-2.0
#include "tool/values.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

#include "lot/error.hpp"

#include "description/reader.hpp"
#include "description/text.hpp"

namespace lot::tool {
namespace {

using Access = detail::ValueAccess;

const char* const kLeftOut = "...";
const char* const kNotSet = "<damaged>";

/// What lies in an array of char, a vector of char or a string; none for anything else.
bool is_text(const Value& value) {
  const Description::Type& type = value.type();
  if (type.kind == Kind::String) return true;
  return (type.kind == Kind::Array || type.kind == Kind::Vector) &&
         Access::type_at(value, type.element).kind == Kind::Char;
}
std::string_view text_of(const Value& value) {
  if (value.kind() == Kind::String) return value.as<std::string_view>();
  if (value.kind() == Kind::Array) return description::text_of_chars(value);
  const Bytes bytes = value.bytes();
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}
bool is_scalar(Kind kind) {
  return kind != Kind::Struct && kind != Kind::Array && kind != Kind::Vector &&
         kind != Kind::Reference && kind != Kind::Opaque;
}
/// A char, as a text of it; empty for a byte that no page shows.
std::string char_text(const Value& value) {
  const char c = value.as<char>();
  return c >= ' ' && c <= '~' ? std::string(1, c) : std::string();
}

/// Ends a Teller, however deep it is in a value.
struct Stopped {};

/// Goes over a value, and tells a writer what is there: both formats leave out the same. Throws
/// Stopped, and as Value.
template <class Writer>
class Teller {
 public:
  Teller(Writer& out, const TextLimits& limits, const StopToken& stop, std::optional<Error>* unset)
      : out_(out), limits_(limits), left_(limits.values), stop_(stop), unset_(unset) {}

  void tell(const Value& value) {
    if (left_ == 0) return out_.text(kLeftOut);
    count_one();
    if (is_text(value)) return tell_text(text_of(value));
    if (Access::is_deepest(value) && !is_scalar(value.kind())) return out_.text(kLeftOut);
    switch (value.kind()) {
      case Kind::Struct:
        return tell_fields(value);
      case Kind::Array:
      case Kind::Vector:
        return tell_elements(value);
      case Kind::Reference:
        return tell_target(value);
      case Kind::Opaque:
        return tell_opaque(value);
      case Kind::Bool:
        if (is_set(value)) out_.boolean(value.as<bool>());
        return;
      case Kind::Enum:
        if (is_set(value)) tell_number(value);
        return;
      case Kind::Char:
        if (const std::string text = char_text(value); !text.empty()) return out_.text(text);
        return tell_number(value);
      case Kind::Duration:
      case Kind::TimePoint:
        return out_.text(description::seconds_text(value));
      default:
        return tell_number(value);
    }
  }

 private:
  /// One more value is told. A picture has millions, and they take seconds.
  void count_one() {
    constexpr std::uint64_t kLook = 1024;
    if (--left_ % kLook == 0 && stop_.stop_requested()) throw Stopped();
  }

  /// Whether a bool, or an enum of one, is true or false. Else it is told as damaged: the rest of
  /// the message is not.
  bool is_set(const Value& value) {
    (void)Access::inside(value);
    try {
      (void)Access::number(value);
      return true;
    } catch (const Error& e) {
      if (e.error_number() != EBADMSG) throw;
      out_.text(kNotSet);
      if (unset_ != nullptr && !*unset_) *unset_ = e;
      return false;
    }
  }

  /// What is checked is what is written: a faulty process may change the message meanwhile.
  void tell_text(std::string_view text) {
    const std::uint64_t most = std::min<std::uint64_t>(text.size(), limits_.characters);
    count_text(most);
    const std::string copied(text.substr(0, most + 1));  // with what says where a character ends
    const std::string_view begin = begin_of(copied, most);
    const bool is_cut = most < text.size();
    if (is_cut) begin_cut("bytes", text.size());
    description::is_utf8(begin) ? out_.text(begin)
                                : out_.binary(std::string_view(copied).substr(0, most));
    if (is_cut) out_.end_map();
  }
  /// Strings of a forged message may all be the same memory, and each as large as the segment.
  void count_text(std::uint64_t bytes) {
    constexpr std::uint64_t kAsLongAsOne = 16;
    constexpr std::uint64_t kMuch = 1 << 16;
    left_ -= std::min(left_, bytes / kAsLongAsOne);
    if (bytes >= kMuch && stop_.stop_requested()) throw Stopped();
  }

  /// Something that is long, of which a part follows.
  void begin_cut(const char* unit, std::uint64_t size) {
    out_.begin_map();
    out_.key(unit);
    out_.number(std::to_string(size));
    out_.key("first");
  }

  /// Only the type's own programs know what the bytes mean. A digit is a character.
  void tell_opaque(const Value& value) {
    const Bytes bytes = value.bytes();
    out_.begin_map();
    out_.key("opaque");
    out_.text(value.type_name());
    out_.key("bytes");
    out_.number(std::to_string(bytes.size()));
    out_.key("hex");
    std::string digits;
    const std::uint64_t shown = std::min<std::uint64_t>(bytes.size(), limits_.characters / 2);
    for (std::uint64_t i = 0; i < shown; ++i) {
      const auto byte = std::to_integer<unsigned>(bytes.data()[i]);
      digits += "0123456789abcdef"[byte >> 4];
      digits += "0123456789abcdef"[byte & 15];
    }
    out_.text(digits);
    out_.end_map();
  }

  void tell_fields(const Value& value) {
    const std::size_t count = value.size();
    out_.begin_map(count == 0);
    for (std::size_t i = 0; i < count; ++i) {
      out_.key(detail::name_of_field(value.type(), i));
      tell(value[i]);
    }
    out_.end_map();
  }

  void tell_elements(const Value& value) {
    const std::uint64_t count = value.size();
    const std::uint64_t shown = std::min(count, limits_.elements);
    if (shown < count) begin_cut("elements", count);
    const Description::Type& element = Access::type_at(value, value.type().element);
    out_.begin_list(shown == 0 || is_scalar(element.kind));
    if (!tell_numbers(value, element, shown)) {
      std::uint64_t n = 0;
      for (auto item = value.begin(); n < shown; ++item, ++n) {
        const bool was_last = left_ == 0;
        tell(*item);
        if (was_last) break;  // the others are left out as well
      }
    }
    out_.end_list();
    if (shown < count) out_.end_map();
  }

  /// Tells numbers that lie side by side: a picture has millions. False: they are none.
  bool tell_numbers(const Value& value, const Description::Type& element, std::uint64_t count) {
    const bool is_integer = element.kind == Kind::Int || element.kind == Kind::UInt;
    if (count == 0 || !(is_integer || element.kind == Kind::Float)) return false;
    const bool is_signed = element.kind == Kind::Int;
    switch (element.size) {
      case 1:
        if (!is_integer) return false;
        is_signed ? tell_each<std::int8_t>(value, count) : tell_each<std::uint8_t>(value, count);
        return true;
      case 2:
        if (!is_integer) return false;
        is_signed ? tell_each<std::int16_t>(value, count) : tell_each<std::uint16_t>(value, count);
        return true;
      case 4:
        !is_integer ? tell_each<float>(value, count)
        : is_signed ? tell_each<std::int32_t>(value, count)
                    : tell_each<std::uint32_t>(value, count);
        return true;
      case 8:
        !is_integer ? tell_each<double>(value, count)
        : is_signed ? tell_each<std::int64_t>(value, count)
                    : tell_each<std::uint64_t>(value, count);
        return true;
      default:
        return false;
    }
  }
  template <class T>
  void tell_each(const Value& value, std::uint64_t count) {
    const Bytes bytes = value.bytes();
    const std::uint64_t there = std::min<std::uint64_t>(count, bytes.size() / sizeof(T));
    const std::uint64_t told = std::min(there, left_);
    for (std::uint64_t i = 0; i < told; ++i) {
      count_one();
      const auto* const at = reinterpret_cast<const unsigned char*>(bytes.data()) + i * sizeof(T);
      char text[64];
      out_.number(description::text_of_number(Access::load<T>(at), text));
    }
    if (told < there) out_.text(kLeftOut);
  }

  void tell_target(const Value& value) {
    Value target = value;
    try {
      if (value.is_null()) return out_.null();
      target = value.target();
    } catch (const Error& e) {
      // It leads to another reference: to nothing, or deeper than a value can be.
      if (e.error_number() == EINVAL) return out_.null();
      if (e.error_number() == ELOOP) return out_.text(kLeftOut);
      throw;
    }
    tell(target);
  }

  void tell_number(const Value& value) {
    const std::string text = description::number_text(value);
    if (!std::is_same_v<Writer, JsonWriter> || value.target().type().size <= sizeof(double)) {
      return out_.number(text);
    }
    char rounded[64];  // readers of JSON have nothing longer
    const std::string_view number =
        description::text_of_number(std::strtod(text.c_str(), nullptr), rounded);
    // They take a number beyond a double for infinity, or for an error.
    number.ends_with("inf") ? out_.text(text) : out_.number(number);
  }

  Writer& out_;
  TextLimits limits_;
  std::uint64_t left_;
  const StopToken& stop_;
  std::optional<Error>* unset_;
};

template <class Writer>
bool tell(Writer& out, const Value& value, const TextLimits& limits, const StopToken& stop,
          std::optional<Error>* unset) {
  try {
    Teller<Writer>(out, limits, stop, unset).tell(value);
    return true;
  } catch (const Stopped&) {
    return false;
  }
}

template <class Writer>
std::string document_of(const Value& value, const TextLimits& limits) {
  Writer out;
  (void)write(out, value, limits, StopToken());
  return out.take();
}

}  // namespace

bool write(JsonWriter& out, const Value& value, const TextLimits& limits, const StopToken& stop,
           std::optional<Error>* unset) {
  return tell(out, value, limits, stop, unset);
}
bool write(YamlWriter& out, const Value& value, const TextLimits& limits, const StopToken& stop,
           std::optional<Error>* unset) {
  return tell(out, value, limits, stop, unset);
}

std::string to_json(const Value& value, const TextLimits& limits) {
  return document_of<JsonWriter>(value, limits);
}
std::string to_yaml(const Value& value, const TextLimits& limits) {
  return document_of<YamlWriter>(value, limits);
}

}  // namespace lot::tool
