// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include <yaml-cpp/yaml.h>

#include "lot/error.hpp"
#include "lot/mutable_value.hpp"
#include "lot/stop_token.hpp"
#include "lot/value.hpp"

#include "tool/writers.hpp"

/// Messages of any type as JSON and YAML, and from YAML. docs/tool.md has the rules.
namespace lot::tool {

/// Writes the value, of which `limits` leave out what is too long. False: the token was told to
/// stop meanwhile. Throws as Value. What is written is no whole document in both cases. A bool that
/// is neither true nor false is written as "<damaged>", and `unset` gets the first one's error.
bool write(JsonWriter& out, const Value& value, const TextLimits& limits, const StopToken& stop,
           std::optional<Error>* unset = nullptr);
bool write(YamlWriter& out, const Value& value, const TextLimits& limits, const StopToken& stop,
           std::optional<Error>* unset = nullptr);
/// The same as a document: JSON in one line without its end, YAML in lines. Throws as Value.
std::string to_json(const Value& value, const TextLimits& limits = TextLimits());
std::string to_yaml(const Value& value, const TextLimits& limits = TextLimits());
/// Sets what the YAML names, and nothing else. Throws lot::Error, which names the path: EINVAL for
/// a field that is not there and for a value of another kind, ERANGE for one that does not fit; and
/// as MutableValue.
void fill(const MutableValue& value, const YAML::Node& node);

}  // namespace lot::tool
