// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>
#include <set>
#include <string>
#include <utility>

#include "description/wire.hpp"

namespace lot::description {
namespace {

std::string bits_of(std::uint64_t bytes) { return std::to_string(8 * bytes); }

/// What a type is, in a few words.
std::string text_of(const Description& all, std::uint32_t place, unsigned level = 0) {
  constexpr unsigned kMostNested = 4;
  const Description::Type& t = all.types[place];
  const auto element = [&] {
    return level < kMostNested ? text_of(all, t.element, level + 1) : std::string("...");
  };
  switch (t.kind) {
    case Kind::Bool:
      return "bool";
    case Kind::Char:
      return "char";
    case Kind::Int:
      return "int" + bits_of(t.size);
    case Kind::UInt:
      return "uint" + bits_of(t.size);
    case Kind::Float:
      return "float" + bits_of(t.size);
    case Kind::Enum:
      return "enum " + t.name + " of " + element();
    case Kind::Duration:
      return "duration of " + element() + " in " + std::to_string(t.numerator) + "/" +
             std::to_string(t.denominator) + " s";
    case Kind::TimePoint:
      return "time of " + t.name + ", " + element();
    case Kind::Array:
      return "array of " + std::to_string(t.count) + " " + element();
    case Kind::Struct:
      return "struct " + t.name;
    case Kind::String:
      return "string of " + t.name;
    case Kind::Vector:
      return "vector of " + element() + ", of " + t.name;
    case Kind::Reference:
      return "reference to " + element();
    case Kind::Opaque:
      break;
  }
  return t.name + ", " + std::to_string(t.size) + " bytes";
}

std::string text_of(const Description& all, const Description::Field& field) {
  std::string text = field.name.empty() ? "" : field.name + ", ";
  text += text_of(all, field.type);
  if (field.bits != 0) text += " of " + std::to_string(field.bits) + " bits";
  text += " at byte " + std::to_string(field.offset);
  if (field.bits != 0) text += ", bit " + std::to_string(field.bit);
  return text;
}

/// Looks at two descriptions side by side.
class Difference {
 public:
  Difference(const Description& topic, const Description& here)
      : topic_(topic), here_(here), merged_(topic) {}

  /// Empty: the types at these places do not differ.
  std::string of(std::uint32_t there, std::uint32_t here, const std::string& path) {
    if (!met_.emplace(there, here).second) return {};
    const Description::Type& a = topic_.types[there];
    const Description::Type& b = here_.types[here];
    if (a.kind != b.kind) return told(there, here, path);
    if (a.kind == Kind::Struct) {
      std::string found = of_fields(there, here, path);
      return found.empty() && a.size != b.size ? told_size(a, b, path) : found;
    }
    if ((a.element == Description::kNone) == (b.element == Description::kNone) &&
        a.element != Description::kNone) {
      std::string found = of(a.element, b.element, path + inner(a.kind));
      if (!found.empty()) return found;
    }
    const bool same_name = a.kind == Kind::Enum || a.name == b.name;
    const bool alike = a.size == b.size && a.count == b.count && a.numerator == b.numerator &&
                       a.denominator == b.denominator && same_name &&
                       (a.element == Description::kNone) == (b.element == Description::kNone);
    return alike ? std::string() : told(there, here, path);
  }
  /// Of the fields that of() has met.
  const Names& names() const { return names_; }
  /// The topic's description, with the names that this side alone has.
  const Description& merged() const { return merged_; }

 private:
  /// What is between a path and the path of what lies in it.
  static std::string inner(Kind kind) {
    const bool has_many = kind == Kind::Array || kind == Kind::Vector || kind == Kind::Opaque;
    return has_many ? "[]" : "";
  }
  static std::string below(const std::string& path, const Description::Field& a,
                           const Description::Field& b, std::size_t i) {
    const std::string& name = b.name.empty() ? a.name : b.name;
    return (path.empty() ? "" : path + ".") + (name.empty() ? "_" + std::to_string(i) : name);
  }
  static std::string said(const std::string& path, const std::string& there,
                          const std::string& here) {
    return path + ": the topic has " + there + "; this side has " + here;
  }
  std::string told(std::uint32_t there, std::uint32_t here, const std::string& path) const {
    return said(path.empty() ? "the message" : path, text_of(topic_, there), text_of(here_, here));
  }
  static std::string told_size(const Description::Type& a, const Description::Type& b,
                               const std::string& path) {
    return said(path.empty() ? "the message" : path, std::to_string(a.size) + " bytes",
                std::to_string(b.size) + " bytes");
  }

  std::string of_fields(std::uint32_t there, std::uint32_t here, const std::string& path) {
    const Description::Type& a = topic_.types[there];
    const Description::Type& b = here_.types[here];
    for (std::size_t i = 0; i < std::max(a.fields.size(), b.fields.size()); ++i) {
      const std::string number =
          "field " + std::to_string(i + 1) + (path.empty() ? "" : " of " + path);
      if (i >= a.fields.size()) return said(number, "none", text_of(here_, b.fields[i]));
      if (i >= b.fields.size()) return said(number, text_of(topic_, a.fields[i]), "none");
      const Description::Field& f = a.fields[i];
      const Description::Field& g = b.fields[i];
      const bool same_name = f.name == g.name || f.name.empty() || g.name.empty();
      names_.topic_knows_more |= g.name.empty() && !f.name.empty();
      if (f.name.empty() && !g.name.empty()) {
        names_.here_knows_more = true;
        merged_.types[there].fields[i].name = g.name;
      }
      if (!same_name || f.offset != g.offset || f.bit != g.bit || f.bits != g.bits) {
        return said(number, text_of(topic_, f), text_of(here_, g));
      }
      std::string found = of(f.type, g.type, below(path, f, g, i));
      if (!found.empty()) return found;
    }
    return {};
  }

  const Description& topic_;
  const Description& here_;
  Description merged_;
  std::set<std::pair<std::uint32_t, std::uint32_t>> met_;
  Names names_;
};

}  // namespace

std::string first_difference(const Description& topic, const Description& here) {
  return Difference(topic, here).of(0, 0, "");
}

bool has_names(const Description& description) noexcept {
  return std::any_of(description.types.begin(), description.types.end(), [](const auto& type) {
    return std::any_of(type.fields.begin(), type.fields.end(),
                       [](const auto& field) { return !field.name.empty(); });
  });
}

Names compare_names(std::string_view topic, std::string_view here) {
  if (topic == here) return {};
  const auto theirs = decode(topic);
  const auto ours = decode(here);
  if (!theirs || !ours) return {};
  Difference difference(*theirs, *ours);
  const bool differ = !difference.of(0, 0, "").empty();
  Names names = difference.names();
  names.differ = differ;
  if (!differ && names.topic_knows_more && names.here_knows_more) {
    names.merged = encode(difference.merged());
    names.merged_names = difference.merged().names_hash();
  }
  return names;
}

}  // namespace lot::description
