// SPDX-License-Identifier: Apache-2.0
#include "types.hpp"

#include <array>
#include <memory>
#include <string>
#include <utility>

#include "lot/detail/described.hpp"
#include "lot/type_identity.hpp"

#include "description/wire.hpp"
#include "node.hpp"
#include "segment/layout.hpp"
#include "support/processes.hpp"

namespace lot::kill {
namespace {

struct Made : detail::MessageType {
  detail::Described known;
};

/// `like`: what else the type says of itself.
Made made(const detail::MessageType& like, const Description& description) {
  Made type{};
  static_cast<detail::MessageType&>(type) = like;
  type.known = detail::make_described(description);
  type.described = [](const detail::MessageType& self) -> const detail::Described& {
    return static_cast<const Made&>(self).known;
  };
  return type;
}

Made number(const std::string& names) {
  Description description = describe<Number>();
  unsigned n = 0;
  for (auto& type : description.types) {
    for (auto& field : type.fields) {
      field.name = names.empty() ? "" : names + std::to_string(n++);
    }
  }
  return made(detail::message_type<Number>(), description);
}

/// A struct of bytes with long names. Its description has `bytes` bytes, or less by a part of a
/// piece.
Made large(const std::string& names, std::uint64_t fields, std::size_t last_name,
           std::size_t bytes) {
  constexpr std::size_t kName = 122;
  Description description;
  description.types.resize(2);
  Description::Type& root = description.types[0];
  root.kind = Kind::Struct;
  root.size = fields;
  description.types[1].kind = Kind::UInt;
  description.types[1].size = 1;
  for (std::uint64_t at = 0; at < fields; ++at) {
    Description::Field field;
    field.name = names + std::to_string(at);
    field.name.resize(at + 1 < fields ? kName : last_name, 'x');
    field.type = 1;
    field.offset = at;
    root.fields.push_back(std::move(field));
  }
  detail::MessageType like{};
  like.size = root.size;
  like.align = 1;
  like.name = "filler";
  like.plain = true;
  Made type = made(like, description);
  const std::size_t has = type.known.bytes.size();
  testing::must(has <= bytes && has > bytes - segment::kDescriptionPiece,
                "a description has the size that was asked for");
  return type;
}

}  // namespace

const detail::MessageType& nameless_number() {
  static const Made type = number("");
  return type;
}

const detail::MessageType& renamed_number() {
  static const Made type = number("other");
  return type;
}

const detail::MessageType& half(std::uint32_t n) {
  static std::array<std::unique_ptr<const Made>, kHalves> types;
  auto& type = types.at(n);
  if (!type) {
    type = std::make_unique<const Made>(
        large("half" + std::to_string(n) + "_", 64, 122, description::kMostBytes / 2));
  }
  return *type;
}

const detail::MessageType& largest(std::uint32_t n) {
  static std::array<std::unique_ptr<const Made>, kLargest> types;
  auto& type = types.at(n);
  if (!type) {
    type = std::make_unique<const Made>(
        large("largest" + std::to_string(n) + "_", 129, 80, description::kMostBytes));
  }
  return *type;
}

}  // namespace lot::kill
