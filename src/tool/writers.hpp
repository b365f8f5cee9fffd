// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include <rapidjson/stringbuffer.h>
#include <rapidjson/writer.h>
#include <yaml-cpp/yaml.h>

/// Documents of messages as text, written piece by piece: a message may be of any size, and a tree
/// of its numbers would be fifty times as large. Texts and keys are UTF-8, with U+FFFD for what is
/// not, and escaped so that no terminal obeys them. A text that YAML cannot keep becomes base64.
namespace lot::tool {

/// The text as a terminal may show it: '?' stands for each character that would steer the terminal,
/// and for each byte beyond ASCII where the text is no UTF-8. One of more than `most` bytes is cut
/// in its middle. REQUIRES: `most` is 10 or more.
std::string shown(std::string_view text, std::size_t most);
/// The begin of a text, of at most so many bytes, which ends with a whole character where it is
/// UTF-8.
std::string_view begin_of(std::string_view text, std::uint64_t most);

/// JSON, in one line of ASCII.
class JsonWriter {
 public:
  JsonWriter() : out_(text_) {}

  void boolean(bool value) { out_.Bool(value); }
  void null() { out_.Null(); }
  void text(std::string_view value);
  void binary(std::string_view bytes);
  /// A number, or "nan", "inf", "-inf".
  void number(std::string_view text);

  void begin_map(bool /*in_line*/ = false) { out_.StartObject(); }
  void key(std::string_view name) { text(name); }
  void end_map() { out_.EndObject(); }
  void begin_list(bool /*in_line*/) { out_.StartArray(); }
  void end_list() { out_.EndArray(); }

  std::string take() { return {text_.GetString(), text_.GetSize()}; }

 private:
  rapidjson::StringBuffer text_;
  rapidjson::Writer<rapidjson::StringBuffer, rapidjson::UTF8<>, rapidjson::ASCII<>> out_;
};

/// YAML, with a line for each field.
class YamlWriter {
 public:
  void boolean(bool value) { out_ << (value ? "true" : "false"); }
  void null() { out_ << YAML::Null; }
  void text(std::string_view value);
  void binary(std::string_view bytes);
  /// A number, or "nan", "inf", "-inf".
  void number(std::string_view text);

  /// `in_line`: what is in it stands in one line; else it has lines of its own.
  void begin_map(bool in_line = false) {
    out_ << (in_line ? YAML::Flow : YAML::Block) << YAML::BeginMap;
  }
  void key(std::string_view name);
  void end_map() { out_ << YAML::EndMap; }
  /// The same.
  void begin_list(bool in_line) { out_ << (in_line ? YAML::Flow : YAML::Block) << YAML::BeginSeq; }
  void end_list() { out_ << YAML::EndSeq; }

  /// The lines, with the end of the last.
  std::string take() { return std::string(out_.c_str(), out_.size()) + '\n'; }

 private:
  void quoted(std::string_view text);

  YAML::Emitter out_;
};

}  // namespace lot::tool
