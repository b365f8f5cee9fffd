// SPDX-License-Identifier: Apache-2.0
#include "tool/writers.hpp"

#include <algorithm>
#include <cctype>
#include <cstdint>

#include <boost/archive/iterators/base64_from_binary.hpp>
#include <boost/archive/iterators/transform_width.hpp>

#include "description/text.hpp"

namespace lot::tool {
namespace {

/// U+FFFD.
constexpr std::string_view kNoCharacter = "\xef\xbf\xbd";

/// The text with U+FFFD for each byte beyond ASCII, where it is no UTF-8.
std::string as_utf8(std::string_view text) {
  std::string out;
  for (const char c : text) {
    static_cast<unsigned char>(c) < 0x80 ? void(out += c) : void(out += kNoCharacter);
  }
  return out;
}

/// How many bytes the character has that begins here. REQUIRES: UTF-8.
std::size_t length_of(unsigned char first) {
  return first < 0x80 ? 1 : first < 0xe0 ? 2 : first < 0xf0 ? 3 : 4;
}
/// Of UTF-8: a byte behind the first one of its character.
bool goes_on(char byte) { return (static_cast<unsigned char>(byte) & 0xc0) == 0x80; }
std::uint32_t code_of(std::string_view character) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(character[i]); };
  switch (character.size()) {
    case 1:
      return byte(0);
    case 2:
      return (byte(0) & 0x1fU) << 6 | (byte(1) & 0x3fU);
    case 3:
      return (byte(0) & 0xfU) << 12 | (byte(1) & 0x3fU) << 6 | (byte(2) & 0x3fU);
    default:
      return (byte(0) & 0x7U) << 18 | (byte(1) & 0x3fU) << 12 | (byte(2) & 0x3fU) << 6 |
             (byte(3) & 0x3fU);
  }
}
/// What a terminal obeys: control characters, those that turn the direction of a line, and those
/// that end one.
bool steers(std::uint32_t code) {
  return code < 0x20 || (code >= 0x7f && code < 0xa0) || code == 0x61c || code == 0x200e ||
         code == 0x200f || (code >= 0x2028 && code <= 0x202e) ||
         (code >= 0x2066 && code <= 0x2069) || code == 0xfeff;
}

/// What yaml-cpp escapes only together with all that is not ASCII.
bool steers_unescaped(std::uint32_t code) {
  return steers(code) && (code == 0x7f || code > 0xa0) && code != 0xfeff;
}

/// What Unicode calls no character: yaml-cpp writes U+FFFD for one.
bool is_no_character(std::uint32_t code) {
  return (code & 0xfffe) == 0xfffe || (code >= 0xfdd0 && code <= 0xfdef);
}

/// Whether a character of the text is such a one. REQUIRES: UTF-8.
template <class Such>
bool has(std::string_view text, Such&& such) {
  for (std::size_t i = 0; i < text.size();) {
    const std::size_t length = length_of(static_cast<unsigned char>(text[i]));
    if (such(code_of(text.substr(i, length)))) return true;
    i += length;
  }
  return false;
}

std::string base64(std::string_view bytes) {
  using namespace boost::archive::iterators;
  using Digits = base64_from_binary<transform_width<const char*, 6, 8>>;
  std::string out(Digits(bytes.data()), Digits(bytes.data() + bytes.size()));
  out.append((4 - out.size() % 4) % 4, '=');
  return out;
}

bool is_finite(std::string_view number) { return number.find_first_of("ai") == number.npos; }

/// A name that each reader of YAML takes for this text, and not for a bool or nothing.
bool is_plain_key(std::string_view name) {
  const auto is_letter = [](unsigned char c) { return c == '_' || (c < 0x80 && std::isalpha(c)); };
  const auto is_part = [&](unsigned char c) { return is_letter(c) || (c >= '0' && c <= '9'); };
  if (name.empty() || !is_letter(static_cast<unsigned char>(name[0])) ||
      !std::all_of(name.begin(), name.end(), is_part)) {
    return false;
  }
  std::string low(name);
  std::transform(low.begin(), low.end(), low.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  for (const char* word : {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}) {
    if (low == word) return false;
  }
  return true;
}

}  // namespace

std::string_view begin_of(std::string_view text, std::uint64_t most) {
  if (text.size() <= most) return text;
  constexpr std::size_t kMostOfOne = 3;  // bytes of a character, but for its first
  const std::size_t least = most < kMostOfOne ? 0 : most - kMostOfOne;
  std::size_t end = most;
  while (end > least && goes_on(text[end])) --end;
  const bool begins = static_cast<unsigned char>(text[end]) >= 0xc0;  // else it is no UTF-8
  return text.substr(0, begins ? end : most);
}

std::string shown(std::string_view text, std::size_t most) {
  const bool is_text = description::is_utf8(text);
  std::string out;
  while (!text.empty()) {
    const std::size_t length = is_text ? length_of(static_cast<unsigned char>(text.front())) : 1;
    const std::string_view character = text.substr(0, length);
    const bool is_well =
        is_text ? !steers(code_of(character)) : text.front() >= ' ' && text.front() <= '~';
    is_well ? void(out += character) : void(out += '?');
    text.remove_prefix(length);
  }
  if (out.size() <= most) return out;
  const std::size_t half = (most - 2) / 2;  // the two ends of a text say most
  std::size_t end = out.size() - half;
  while (end < out.size() && goes_on(out[end])) ++end;
  return std::string(begin_of(out, half)) + ".." + out.substr(end);
}

// ---- JSON ----

void JsonWriter::text(std::string_view value) {
  std::string clean;
  if (!description::is_utf8(value)) value = clean = as_utf8(value);
  out_.String(value.data(), static_cast<rapidjson::SizeType>(value.size()));
}
void JsonWriter::binary(std::string_view bytes) {
  begin_map();
  key("base64");
  text(base64(bytes));
  end_map();
}
void JsonWriter::number(std::string_view text) {
  if (!is_finite(text)) return this->text(text);
  out_.RawValue(text.data(), text.size(), rapidjson::kNumberType);
}

// ---- YAML ----

void YamlWriter::quoted(std::string_view text) {
  std::string clean(description::is_utf8(text) ? text : as_utf8(text));
  if (has(clean, steers_unescaped)) out_ << YAML::EscapeNonAscii;
  out_ << YAML::DoubleQuoted << clean;
}
void YamlWriter::key(std::string_view name) {
  is_plain_key(name) ? void(out_ << std::string(name)) : quoted(name);
}
void YamlWriter::text(std::string_view value) {
  const bool is_kept = !description::is_utf8(value) || !has(value, is_no_character);
  is_kept ? quoted(value) : binary(value);
}
void YamlWriter::binary(std::string_view bytes) {
  out_ << YAML::SecondaryTag("binary") << YAML::DoubleQuoted << base64(bytes);
}
void YamlWriter::number(std::string_view text) {
  std::string plain(text);
  if (!is_finite(text)) {
    plain = text == "nan" ? ".nan" : text == "inf" ? ".inf" : "-.inf";
  } else if (const std::size_t e = text.find('e'); e != text.npos && text.find('.') == text.npos) {
    plain.insert(e, ".0");  // readers of YAML 1.1 take 1e+20 for a text
  }
  out_ << plain;
}

}  // namespace lot::tool
