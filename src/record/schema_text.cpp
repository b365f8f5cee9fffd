// SPDX-License-Identifier: Apache-2.0
#include "record/schema_text.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <string_view>
#include <utility>
#include <vector>

#include "lot/error.hpp"

#include "description/containers.hpp"
#include "description/wire.hpp"

namespace lot::record {
namespace {

/// A text may say more than any message has.
constexpr std::uint64_t kMostElements = std::uint64_t{1} << 32;
constexpr std::size_t kMostFields = 4096;
constexpr std::size_t kMostTypes = 1024;

struct Primitive {
  const char* name;
  Kind kind;
  std::uint64_t size;
  const char* alike;  ///< the name that stands for all with the same bytes
};
constexpr Primitive kPrimitives[] = {
    {"bool", Kind::Bool, 1, "bool"},       {"byte", Kind::UInt, 1, "uint8"},
    {"char", Kind::Char, 1, "uint8"},      {"int8", Kind::Int, 1, "int8"},
    {"uint8", Kind::UInt, 1, "uint8"},     {"int16", Kind::Int, 2, "int16"},
    {"uint16", Kind::UInt, 2, "uint16"},   {"int32", Kind::Int, 4, "int32"},
    {"uint32", Kind::UInt, 4, "uint32"},   {"int64", Kind::Int, 8, "int64"},
    {"uint64", Kind::UInt, 8, "uint64"},   {"float32", Kind::Float, 4, "float32"},
    {"float64", Kind::Float, 8, "float64"}};

const Primitive* primitive(const std::string& name) {
  const auto* const found =
      std::ranges::find_if(kPrimitives, [&](const Primitive& p) { return name == p.name; });
  return found == std::end(kPrimitives) ? nullptr : found;
}

/// ROS allows no other names. `are_alike()` puts them between other signs.
bool is_name(const std::string& text) {
  const auto is_letter = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
  };
  const auto is_part = [&](char c) { return is_letter(c) || (c >= '0' && c <= '9'); };
  return !text.empty() && is_letter(text.front()) && std::ranges::all_of(text, is_part);
}

/// `pkg/msg/Name` and `pkg/Name` are one name.
std::string short_name(const std::string& name) {
  constexpr std::string_view kMsg = "/msg/";
  const auto at = name.find(kMsg);
  return at == std::string::npos ? name : name.substr(0, at) + name.substr(at + kMsg.size() - 1);
}

struct FieldText {
  std::string type;
  std::string name;
  bool is_list = false;
  std::optional<std::uint64_t> count;  ///< of an array
  std::size_t line = 0;
};
using Definitions = std::map<std::string, std::vector<FieldText>>;

class SchemaReader {
 public:
  SchemaReader(std::string name, const std::string& text) : name_(std::move(name)) {
    const std::string root = short_name(name_);
    std::string current = root;
    definitions_[current];
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
      ++line_;
      if (line.starts_with("===")) {
        current.clear();
      } else if (line.starts_with("MSG: ")) {
        current = short_name(trimmed(line.substr(5)));
        definitions_[current];
        if (definitions_.size() > kMostTypes) fail("more than 1024 types");
      } else if (auto field = field_of(line)) {
        if (current.empty()) fail("fields behind ===, and no line MSG: that names their type");
        if (++fields_ > kMostFields) fail("more than 4096 fields");
        definitions_[current].push_back(std::move(*field));
      }
    }
    if (!definitions_.contains("builtin_interfaces/Time")) {
      add_time("builtin_interfaces/Time", "int32");
    }
    if (!definitions_.contains("builtin_interfaces/Duration")) {
      add_time("builtin_interfaces/Duration", "int32");
    }
    made_.description.types.emplace_back();
    const Part part = add_struct(root, 0);
    std::swap(made_.description.types[0], made_.description.types[part.type]);
    made_.description.types.pop_back();  // it was the last one to be finished
    made_.align = part.align;
    made_.fields = part.fields;
    if (description::encode(made_.description).empty()) {
      fail("it is larger than 16 KiB as a description, or has more than 16 levels");
    }
  }
  SchemaType take() { return std::move(made_); }

 private:
  /// A type that was added.
  struct Part {
    std::uint32_t type = 0;
    std::uint64_t size = 0;
    std::uint64_t align = 1;
    std::string fields;
  };

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(EINVAL, name_, "line " + std::to_string(line_) + " of its schema: " + what, "");
  }

  static std::string trimmed(const std::string& text) {
    const auto first = text.find_first_not_of(" \t\r");
    if (first == std::string::npos) return "";
    return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
  }

  void add_time(const std::string& name, const std::string& seconds) {
    FieldText sec;
    sec.type = seconds;
    sec.name = "sec";
    FieldText nanosec;
    nanosec.type = "uint32";
    nanosec.name = "nanosec";
    definitions_[name] = {sec, nanosec};
  }

  /// Nothing: a blank line, a comment, a constant.
  std::optional<FieldText> field_of(const std::string& whole) {
    const std::string line = trimmed(whole.substr(0, whole.find('#')));
    if (line.empty()) return std::nullopt;
    const auto blank = line.find_first_of(" \t");
    if (blank == std::string::npos) fail("a type without a name: " + line);
    FieldText field;
    field.line = line_;
    std::string type = line.substr(0, blank);
    const std::string rest = trimmed(line.substr(blank));
    const auto end = rest.find_first_of(" \t=");
    field.name = rest.substr(0, end);
    const auto behind = rest.find_first_not_of(" \t", end);
    if (end != std::string::npos && behind != std::string::npos && rest[behind] == '=') {
      return std::nullopt;  // a constant
    }
    if (!is_name(field.name)) fail("no name of a field: " + field.name);
    if (const auto bracket = type.find('['); bracket != std::string::npos) {
      read_list(type.substr(bracket), field);
      type.resize(bracket);
    }
    field.type = type.substr(0, type.find("<="));  // the bound of a string is no part of its bytes
    return field;
  }
  void read_list(const std::string& brackets, FieldText& field) {
    if (!brackets.ends_with(']')) fail("[ without ]");
    field.is_list = true;
    const std::string inside = brackets.substr(1, brackets.size() - 2);
    if (inside.empty() || inside.starts_with("<=")) return;
    std::uint64_t count = 0;
    const auto [end, error] = std::from_chars(inside.data(), inside.data() + inside.size(), count);
    if (error != std::errc() || end != inside.data() + inside.size() || count == 0 ||
        count >= kMostElements) {
      fail("an array of " + inside);
    }
    field.count = count;
  }

  /// The definition that a type of a field of `from` names.
  const std::string& resolve(const std::string& type, const std::string& from) {
    const std::string name = short_name(type);
    const std::string package = from.substr(0, from.find('/'));
    for (const std::string& full : {name, package + "/" + name}) {
      if (const auto found = definitions_.find(full); found != definitions_.end()) {
        return found->first;
      }
    }
    const std::string end = "/" + name;
    const auto found = std::ranges::find_if(
        definitions_, [&](const auto& each) { return each.first.ends_with(end); });
    if (found == definitions_.end()) fail("the type " + type + " is not in it");
    return found->first;
  }

  std::uint32_t add(Description::Type type, const std::string& key) {
    if (const auto found = added_.find(key); found != added_.end()) return found->second;
    made_.description.types.push_back(std::move(type));
    const auto place = static_cast<std::uint32_t>(made_.description.types.size() - 1);
    added_.emplace(key, place);
    return place;
  }

  Part add_plain(const FieldText& field, const std::string& from, std::size_t level) {
    line_ = field.line;
    Description::Type type;
    if (field.type == "string") {
      Description::Type letter;
      letter.kind = Kind::Char;
      letter.size = 1;
      type.element = add(std::move(letter), "char");
      type.kind = Kind::String;
      type.size = description::StdString::kSize;
      type.name = "libstdc++";
      return {add(std::move(type), "string"), description::StdString::kSize, 8, "string"};
    }
    if (field.type == "wstring") fail("a wstring, which no message of LOT can have");
    if (const Primitive* const p = primitive(field.type)) {
      type.kind = p->kind;
      type.size = p->size;
      return {add(std::move(type), p->name), p->size, p->size, p->alike};
    }
    return add_struct(resolve(field.type, from), level + 1);
  }

  Part add_field(const FieldText& field, const std::string& from, std::size_t level) {
    Part element = add_plain(field, from, level);
    line_ = field.line;
    if (!field.is_list) return element;
    Description::Type type;
    type.element = element.type;
    std::string key;
    if (field.count) {
      type.kind = Kind::Array;
      type.count = *field.count;
      if (element.size > description_limit() / *field.count) fail("an array that is too large");
      type.size = element.size * *field.count;
      key = "[" + std::to_string(*field.count) + "]" + std::to_string(element.type);
      element.fields = "[" + std::to_string(*field.count) + "]" + element.fields;
    } else {
      type.kind = Kind::Vector;
      type.size = description::kVectorSize;
      type.name = "libstdc++";
      key = "[]" + std::to_string(element.type);
      element.fields = "[]" + element.fields;
      element.align = description::kWord;
    }
    element.size = type.size;
    element.type = add(std::move(type), key);
    return element;
  }
  static constexpr std::uint64_t description_limit() { return std::uint64_t{1} << 40; }

  Part add_struct(const std::string& name, std::size_t level) {
    if (level > description::kMostLevels) fail("types that lie too deep in each other");
    if (const auto found = structs_.find(name); found != structs_.end()) return found->second;
    if (!open_.insert(name).second) fail(name + " lies within itself");
    Part part;
    Description::Type type;
    type.kind = Kind::Struct;
    type.name = name;
    part.fields = "{";
    std::set<std::string> names;
    for (const FieldText& text : definitions_.at(name)) {
      line_ = text.line;
      if (!names.insert(text.name).second) fail("two fields are called " + text.name);
      const Part its = add_field(text, name, level);
      Description::Field field;
      field.name = text.name;
      field.type = its.type;
      field.offset = (part.size + its.align - 1) / its.align * its.align;
      part.size = field.offset + its.size;
      part.align = std::max(part.align, its.align);
      part.fields += text.name + ":" + its.fields + ",";
      type.fields.push_back(std::move(field));
      if (part.fields.size() > (1 << 20)) fail("more fields than a message can have");
    }
    part.fields += "}";
    part.size = std::max<std::uint64_t>((part.size + part.align - 1) / part.align * part.align, 1);
    type.size = part.size;
    part.type = add(std::move(type), "struct " + name);
    structs_.emplace(name, part);
    open_.erase(name);
    return part;
  }

  std::string name_;
  std::size_t line_ = 0;
  std::size_t fields_ = 0;
  Definitions definitions_;
  SchemaType made_;
  std::map<std::string, std::uint32_t> added_;
  std::map<std::string, Part> structs_;
  std::set<std::string> open_;  ///< structs that are being added
};

}  // namespace

SchemaType read_schema(const std::string& name, const std::string& text) {
  return SchemaReader(name, text).take();
}

}  // namespace lot::record
