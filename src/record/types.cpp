// SPDX-License-Identifier: Apache-2.0
#include "record/types.hpp"

#include <bit>
#include <cerrno>
#include <charconv>
#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <utility>

#include "lot/compliance.hpp"
#include "lot/error.hpp"

#include "codec/program.hpp"
#include "codec/schema.hpp"
#include "description/wire.hpp"
#include "record/schema_text.hpp"
#include "registry/known_type.hpp"

namespace lot::record {
namespace {

constexpr const char* kType = "lot.type";
constexpr const char* kSize = "lot.size";
constexpr const char* kAlign = "lot.align";
constexpr const char* kIdentity = "lot.identity";
constexpr const char* kDescription = "lot.description";

constexpr std::string_view kDigits = "0123456789abcdef";

std::string hex_of(std::string_view bytes) {
  std::string text;
  for (const char c : bytes) {
    const auto byte = static_cast<unsigned char>(c);
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

std::optional<std::string> bytes_of_hex(std::string_view hex) {
  if (hex.size() % 2 != 0) return std::nullopt;
  std::string bytes;
  for (std::size_t i = 0; i < hex.size(); i += 2) {
    const auto high = kDigits.find(hex[i]);
    const auto low = kDigits.find(hex[i + 1]);
    if (high == std::string_view::npos || low == std::string_view::npos) return std::nullopt;
    bytes += static_cast<char>(high << 4 | low);
  }
  return bytes;
}

std::optional<std::uint64_t> number_of(const mcap::Pairs& pairs, const char* key) {
  const auto found = pairs.find(key);
  if (found == pairs.end()) return std::nullopt;
  const std::string& text = found->second;
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

/// As a program has its own types, but from a description.
struct Made : detail::MessageType {
  detail::Described known;
};

AnyType type_with(const std::string& name, std::uint64_t size, std::uint64_t align,
                  std::uint64_t hash, Description description) {
  Made made{};
  made.size = size;
  made.align = align;
  made.hash = hash;
  made.name = name.c_str();
  made.known = detail::make_described(description);
  made.described = [](const detail::MessageType& type) -> const detail::Described& {
    return static_cast<const Made&>(type).known;
  };
  return AnyType(std::make_shared<const registry::KnownType>(made, std::move(description)));
}

}  // namespace

mcap::Pairs pairs_of(const AnyType& type) {
  const detail::MessageType& its = type.known()->type();
  return {{kType, type.name()},
          {kSize, std::to_string(its.size)},
          {kAlign, std::to_string(its.align)},
          {kIdentity, std::to_string(its.hash)},
          {kDescription, hex_of(description::encode(type.description()))}};
}

AnyType type_of(const mcap::Pairs& pairs) {
  const auto name = pairs.find(kType);
  const auto hex = pairs.find(kDescription);
  if (name == pairs.end() || hex == pairs.end()) return {};
  const auto size = number_of(pairs, kSize);
  const auto align = number_of(pairs, kAlign);
  const auto identity = number_of(pairs, kIdentity);
  const auto bytes = bytes_of_hex(hex->second);
  auto description = bytes ? description::decode(*bytes) : std::nullopt;
  if (!size || !align || !identity || !description || description->root().size != *size ||
      !std::has_single_bit(*align) || *align > detail::kMaxAlignment) {
    throw Error(EBADMSG, name->second, "the recording's description of this type is damaged", "");
  }
  return type_with(name->second, *size, *align, *identity, std::move(*description));
}

AnyType type_of_schema(const std::string& name, const std::string& text) {
  SchemaType made = read_schema(name, text);
  // FNV-1a: another schema is another type.
  std::uint64_t hash = 14695981039346656037U;
  for (const char c : made.fields) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211U;
  const std::string its_name = made.description.root().name;
  const std::uint64_t size = made.description.root().size;
  return type_with(its_name, size, made.align, hash, std::move(made.description));
}

bool is_like(const AnyType& type, const std::string& schema) {
  try {
    const codec::Program program(type.description());  // schema_of() wants one that it takes
    return are_alike(schema, codec::schema_of(program.description()).msg);
  } catch (const Error&) {
    return false;
  }
}

bool are_alike(const std::string& one, const std::string& other) {
  if (one == other) return true;
  try {
    return read_schema("a/A", one).fields == read_schema("a/A", other).fields;
  } catch (const Error&) {
    return false;
  }
}

}  // namespace lot::record
