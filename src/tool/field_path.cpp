// SPDX-License-Identifier: Apache-2.0
#include "tool/field_path.hpp"

#include <cerrno>
#include <charconv>
#include <cstdint>
#include <string>

#include "lot/error.hpp"

#include "description/reader.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

/// A way through types, step by step.
class Walk {
 public:
  Walk(const Description& description, std::string_view path)
      : all_(description), path_(path), rest_(path) {}

  std::uint32_t go() {
    for (follow(); !rest_.empty(); follow()) rest_.front() == '[' ? enter_element() : enter_field();
    return place_;
  }

 private:
  const Description::Type& type() const {
    if (place_ < all_.types.size()) return all_.types[place_];
    throw Error(EBADMSG, "the type of the topic", "its description names a type that is not there",
                "");
  }

  /// To what a reference names: a type that may be another one, as often as there are types.
  void follow() {
    for (std::size_t n = 0; type().kind == Kind::Reference && n < all_.types.size(); ++n) {
      place_ = type().element;
    }
  }

  void enter_element() {
    const std::string here = name();
    const std::size_t end = rest_.find(']');
    std::uint64_t i = 0;
    if (end == rest_.npos) refuse_form();
    const auto [stop, error] = std::from_chars(rest_.data() + 1, rest_.data() + end, i);
    if (error != std::errc() || stop != rest_.data() + end) refuse_form();
    if (type().kind != Kind::Array && type().kind != Kind::Vector) {
      refuse(here + " has no elements");
    }
    if (type().kind == Kind::Array && i >= type().count) {
      refuse(here + " has " + plural(type().count, "element", "elements"));
    }
    rest_.remove_prefix(end + 1);
    place_ = type().element;
  }

  void enter_field() {
    const std::string here = name();
    if (rest_.size() != path_.size()) {
      if (rest_.front() != '.') refuse_form();
      rest_.remove_prefix(1);
    }
    const std::string_view field = rest_.substr(0, rest_.find_first_of(".[]"));
    if (field.empty()) refuse_form();
    const std::uint64_t i = detail::ValueAccess::find(type(), field);
    if (type().kind != Kind::Struct || i == type().fields.size()) {
      refuse(here + " has no field \"" + std::string(field) + "\"");
    }
    rest_.remove_prefix(field.size());
    place_ = type().fields[i].type;
  }

  /// What the steps so far have led to.
  std::string name() const {
    const std::string_view done = path_.substr(0, path_.size() - rest_.size());
    return done.empty() ? "the message" : std::string(done);
  }

  [[noreturn]] void refuse(const std::string& what) const {
    throw Error(EINVAL, "--field " + std::string(path_), what, what_is_there());
  }
  [[noreturn]] void refuse_form() const {
    throw Error(EINVAL, "--field " + std::string(path_), "it is no path to a field",
                "a path looks like labels[2].name");
  }
  std::string what_is_there() const {
    switch (type().kind) {
      case Kind::Struct: {
        std::string text;
        for (std::size_t i = 0; i < type().fields.size(); ++i) {
          text += (i == 0 ? "there are " : ", ") + detail::name_of_field(type(), i);
        }
        return text.empty() ? "it has no fields" : text;
      }
      case Kind::Array:
      case Kind::Vector:
        return "it has elements, the first of which is [0]";
      case Kind::Opaque:
        return "it is opaque: only its own programs know what is in it";
      default:
        return "it is a single value";
    }
  }

  const Description& all_;
  std::string_view path_;
  std::string_view rest_;
  std::uint32_t place_ = 0;
};

}  // namespace

std::uint32_t type_at(const Description& description, std::string_view path) {
  return Walk(description, path).go();
}

}  // namespace lot::tool
