// SPDX-License-Identifier: Apache-2.0
#include "gateway/names.hpp"

namespace lot::gateway {
namespace {

/// What ROS 2 puts in front of the names of topics. Services have others.
constexpr std::string_view kPrefix = "rt/";

/// Words of letters, digits and _, none of which begins with a digit, with / between them.
bool is_ros_name(std::string_view name) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  const auto is_letter = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
  };
  char before = '/';
  for (const char c : name) {
    const bool is_first = before == '/';
    const bool is_allowed = c == '/' ? !is_first : is_letter(c) || (is_digit(c) && !is_first);
    if (!is_allowed) return false;
    before = c;
  }
  return before != '/';
}

}  // namespace

std::optional<std::string> dds_topic_of(std::string_view topic) {
  if (!topic.empty() && topic.front() == '/') topic.remove_prefix(1);
  if (!is_ros_name(topic)) return std::nullopt;
  return std::string(kPrefix) + std::string(topic);
}

std::optional<std::string> topic_of_dds(std::string_view dds_topic) {
  if (!dds_topic.starts_with(kPrefix)) return std::nullopt;
  const std::string_view name = dds_topic.substr(kPrefix.size());
  if (!is_ros_name(name)) return std::nullopt;
  return "/" + std::string(name);
}

std::string dds_type_of(std::string_view schema) {
  std::string result;
  const std::size_t last = schema.rfind('/');
  for (std::size_t i = 0; i < schema.size(); ++i) {
    if (schema[i] != '/') {
      result += schema[i];
    } else {
      result += i == last ? "::dds_::" : "::";
    }
  }
  return result + "_";
}

bool is_node_name(std::string_view name) {
  return is_ros_name(name) && name.find('/') == name.npos;
}

}  // namespace lot::gateway
