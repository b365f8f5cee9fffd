// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "description/wire.hpp"
#include "registry/type_table.hpp"
#include "segment/segment.hpp"

namespace lot::testing {

/// What is wrong with what topics carry, or "". Each topic that is there carries one whole type:
/// its hashes fit its description. Equal descriptions lie in one place. A name is that of one topic
/// with users.
inline std::string wrong_types(segment::Segment& segment) {
  const auto any = [](const auto& bits) {
    return std::any_of(std::begin(bits), std::end(bits),
                       [](const auto& word) { return word.load() != 0; });
  };
  std::string text;
  const auto wrong = [&text](const segment::TopicEntry& topic, const char* what) {
    text += (text.empty() ? "topic " : "; topic ") + std::string(topic.name) + what;
  };
  const registry::TypeTable table(segment);
  std::map<std::string, unsigned> used;        // by name
  std::map<std::string, std::uint64_t> words;  // by bytes
  for (const auto& topic : segment.topics()) {
    if (any(topic.users) && ++used[topic.name] == 2) wrong(topic, " is there twice");
    const std::uint64_t word = topic.description.load();
    if (word == 0 || !(any(topic.users) || any(topic.observers))) continue;
    const auto bytes = table.copy(word);
    const auto description = bytes ? description::decode(*bytes) : std::nullopt;
    if (!description) {
      wrong(topic, " has a damaged description");
      continue;
    }
    const std::uint64_t here = topic.type_names.load();
    const std::uint64_t names = description->names_hash();
    if (description->layout_hash() != topic.type_layout ||
        description->root().size != topic.type_size) {
      wrong(topic, " has the description of another type");
    } else if (names != here && names != 0 && here != 0) {
      wrong(topic, " has a description with other names");
    }
    if (words.emplace(*bytes, word).first->second != word) {
      wrong(topic, " does not share its description");
    }
  }
  return text;
}

}  // namespace lot::testing
