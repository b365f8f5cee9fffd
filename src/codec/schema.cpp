// SPDX-License-Identifier: Apache-2.0
#include "codec/schema.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <map>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include "codec/kinds.hpp"

namespace lot::codec {
namespace {

using Type = Description::Type;

bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }
bool is_digit(char c) { return c >= '0' && c <= '9'; }
char lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }
char upper(char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c; }

/// "a::b<c::d>::E" as "a::b<c::d>" and "E", and "a/E" as "a" and "E".
std::pair<std::string_view, std::string_view> split(std::string_view name) {
  int depth = 0;
  std::size_t end = 0;    // of the package
  std::size_t begin = 0;  // of the rest
  for (std::size_t i = 0; i < name.size(); ++i) {
    if (name[i] == '<' || name[i] == '(') ++depth;
    if (name[i] == '>' || name[i] == ')') --depth;
    if (depth != 0) continue;
    const bool is_scope = name[i] == ':' && i + 1 < name.size() && name[i + 1] == ':';
    if (!is_scope && name[i] != '/') continue;
    end = i;
    begin = i + (is_scope ? 2 : 1);
    if (is_scope) ++i;
  }
  return {name.substr(0, end), name.substr(begin)};
}

/// Lower-case words with single `_` between them.
std::string package_of(std::string_view text) {
  std::string result;
  for (const char c : text) {
    if (is_letter(c) || (is_digit(c) && !result.empty())) {
      result += lower(c);
    } else if (!result.empty() && result.back() != '_') {
      result += '_';
    }
  }
  while (!result.empty() && result.back() == '_') result.pop_back();
  return result.empty() ? "lot" : result;
}

/// WordsLikeThis.
std::string class_of(std::string_view text) {
  std::string result;
  bool begins = true;
  for (const char c : text) {
    if (is_letter(c) || (is_digit(c) && !result.empty())) {
      result += begins ? upper(c) : c;
      begins = false;
    } else {
      begins = true;
    }
  }
  return result.empty() ? "Message" : result;
}

/// What may stand in a comment: no end of the line, nor what a preprocessor would read.
std::string comment_of(std::string_view text) {
  std::string result(text);
  std::replace_if(
      result.begin(), result.end(), [](char c) { return c < ' ' || c > '~' || c == '\\'; }, '?');
  return result;
}

bool is_identifier(std::string_view name) {
  return !name.empty() && is_letter(name.front()) && name.back() != '_' &&
         std::all_of(name.begin(), name.end(),
                     [](char c) { return is_letter(c) || is_digit(c) || c == '_'; });
}

/// Words of IDL 4.2, which mean the same in any case of letters.
bool is_word_of_idl(std::string_view name) {
  static constexpr std::array<std::string_view, 83> kWords{
      "abstract",   "alias",     "any",        "attribute",   "bitfield",  "bitmask", "bitset",
      "boolean",    "case",      "char",       "component",   "connector", "const",   "consumes",
      "context",    "custom",    "default",    "double",      "emits",     "enum",    "eventtype",
      "exception",  "factory",   "false",      "finder",      "fixed",     "float",   "getraises",
      "home",       "import",    "in",         "inout",       "int16",     "int32",   "int64",
      "int8",       "interface", "local",      "long",        "manages",   "map",     "mirrorport",
      "module",     "multiple",  "native",     "object",      "octet",     "oneway",  "out",
      "port",       "porttype",  "primarykey", "private",     "provides",  "public",  "publishes",
      "raises",     "readonly",  "sequence",   "setraises",   "short",     "string",  "struct",
      "supports",   "switch",    "true",       "truncatable", "typedef",   "typeid",  "typename",
      "typeprefix", "uint16",    "uint32",     "uint64",      "uint8",     "union",   "unsigned",
      "uses",       "valuebase", "valuetype",  "void",        "wchar",     "wstring"};
  std::string text(name);
  std::transform(text.begin(), text.end(), text.begin(), lower);
  return std::find(kWords.begin(), kWords.end(), text) != kWords.end();
}

/// A name that none has got before.
std::string unique(std::set<std::string>& taken, const std::string& wanted) {
  std::string name = wanted;
  for (int i = 2; !taken.insert(name).second; ++i) name = wanted + "_" + std::to_string(i);
  return name;
}

/// A type as fields name it.
struct Name {
  std::string msg;
  std::string idl;
};
struct Member {
  Name type;
  std::string name;
  std::string count;    ///< "[3]", or nothing
  std::string comment;  ///< or nothing
};
struct Definition {
  std::string package;
  std::string name;
  std::vector<Member> members;
};

Name number_name(const Type& type) {
  const std::string bits = std::to_string(8 * type.size);
  switch (type.kind) {
    case Kind::Bool:
      return {"bool", "boolean"};
    case Kind::Char:
      return {"char", "char"};
    case Kind::Float:
      return {"float" + bits, type.size == 4 ? "float" : "double"};
    case Kind::Int:
      return {"int" + bits, "int" + bits};
    default:
      return {"uint" + bits, "uint" + bits};
  }
}

/// Makes the definitions of a description, each behind those that it needs.
class Writer {
 public:
  explicit Writer(const Description& all) : all_(all) {}

  void run() {
    if (all_.root().kind == Kind::Struct) {
      (void)type_name(0);
    } else {
      (void)wrapped(0, "Message", "data");
    }
  }
  const std::vector<Definition>& definitions() const { return done_; }

 private:
  /// A definition gets its name before those in it, and its place behind them.
  Name add(const std::string& package, const std::string& name, std::vector<Member> members) {
    done_.push_back({package, name, std::move(members)});
    return {package + "/" + name, package + "::msg::" + name};
  }
  std::string unique_class(const std::string& package, const std::string& wanted) {
    std::string name = wanted;
    for (int i = 2; !taken_.insert(package + "/" + name).second; ++i) {
      name = wanted + std::to_string(i);
    }
    return name;
  }

  /// The type of an element, or of a field that is no array and no vector.
  Name type_name(std::uint32_t place) {
    const Type& type = all_.types[place];
    if (type.kind == Kind::String) return {"string", "string"};
    if (const Type* const number = number_of(all_, type)) return number_name(*number);
    if (const auto known = known_.find(place); known != known_.end()) return known->second;
    const Name name =
        type.kind == Kind::Struct ? struct_name(type) : wrapped(place, "Items", "items");
    known_.emplace(place, name);
    return name;
  }

  Name struct_name(const Type& type) {
    if (is_ros_time(all_, type)) {
      const bool is_time = type.name == "time";
      const std::string name = unique_class("builtin_interfaces", is_time ? "Time" : "Duration");
      return add("builtin_interfaces", name,
                 {{{"int32", "int32"}, "sec", "", ""}, {{"uint32", "uint32"}, "nanosec", "", ""}});
    }
    const auto [scope, rest] = split(type.name);
    const std::string package = package_of(scope);
    const std::string name = unique_class(package, class_of(rest));
    std::vector<Member> members;
    std::set<std::string> taken;
    for (std::size_t i = is_ros_header(all_, type) ? 1 : 0; i < type.fields.size(); ++i) {
      const Description::Field& field = type.fields[i];
      const std::string wanted =
          is_identifier(field.name) ? field.name : "field_" + std::to_string(i);
      members.push_back(member(field.type, unique(taken, wanted)));
    }
    if (members.empty()) {
      members.push_back({{"uint8", "uint8"}, "structure_needs_at_least_one_member", "", ""});
    }
    return add(package, name, std::move(members));
  }

  /// A message with one field, where ROS 2 wants a message.
  Name wrapped(std::uint32_t place, const std::string& wanted, const std::string& field) {
    const std::string name = unique_class("lot", wanted);
    return add("lot", name, {member(place, field)});
  }

  Member member(std::uint32_t place, const std::string& name) {
    Member result{{}, name, "", comment(all_.types[place])};
    const Type* type = &all_.types[place];
    if (type->kind == Kind::Vector) {
      const Name element = type_name(type->element);
      result.type = {element.msg + "[]", "sequence<" + element.idl + ">"};
      result.comment = comment(all_.types[type->element]);
      return result;
    }
    std::uint64_t count = 1;
    for (; type->kind == Kind::Array; type = &all_.types[place]) {
      count *= type->count;
      place = type->element;
      result.count = "[" + std::to_string(count) + "]";
    }
    result.type = type_name(place);
    result.comment = comment(*type);
    return result;
  }

  std::string comment(const Type& type) const {
    if (type.kind == Kind::Enum) return comment_of(type.name);
    const Type* const span = type.kind == Kind::TimePoint ? &all_.types[type.element] : &type;
    if (span->kind != Kind::Duration) return "";
    std::string text = "unit: " + std::to_string(span->numerator);
    if (span->denominator != 1) text += "/" + std::to_string(span->denominator);
    text += " s";
    if (type.kind == Kind::TimePoint) text += ", since the epoch of " + comment_of(type.name);
    return text;
  }

  const Description& all_;
  std::vector<Definition> done_;
  std::map<std::uint32_t, Name> known_;
  std::set<std::string> taken_;
};

std::string msg_fields(const Definition& definition) {
  std::string text;
  for (const Member& m : definition.members) {
    text += m.type.msg + m.count + " " + m.name;
    text += m.comment.empty() ? "\n" : "  # " + m.comment + "\n";
  }
  return text;
}

std::string idl_struct(const Definition& definition) {
  std::string text =
      "module " + definition.package + " {\nmodule msg {\nstruct " + definition.name + " {\n";
  for (const Member& m : definition.members) {
    text += "  " + m.type.idl + (is_word_of_idl(m.name) ? " _" : " ") + m.name + m.count + ";";
    text += m.comment.empty() ? "\n" : "  // " + m.comment + "\n";
  }
  return text + "};\n};\n};\n";
}

}  // namespace

Schema schema_of(const Description& description) {
  Writer writer(description);
  writer.run();
  const std::vector<Definition>& all = writer.definitions();
  Schema schema;
  schema.name = all.back().package + "/msg/" + all.back().name;
  schema.msg = msg_fields(all.back());
  for (auto one = all.rbegin() + 1; one != all.rend(); ++one) {
    schema.msg += std::string(80, '=') + "\nMSG: " + one->package + "/" + one->name + "\n";
    schema.msg += msg_fields(*one);
  }
  for (const Definition& one : all) schema.idl += idl_struct(one);
  return schema;
}

}  // namespace lot::codec
