// SPDX-License-Identifier: Apache-2.0
#include "gateway/settings_file.hpp"

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <limits>
#include <set>
#include <string>

#include <yaml-cpp/yaml.h>

#include "lot/error.hpp"

#include "gateway/names.hpp"
#include "gateway/ros_types.hpp"
#include "record/pattern.hpp"

namespace lot::gateway {
namespace {

constexpr double kMiB = 1 << 20;

/// Reads the nodes of one file.
class File {
 public:
  explicit File(std::string name) : name_(std::move(name)) {}

  void read(Settings& settings) const {
    const YAML::Node all = load();
    if (all.IsNull()) return;  // an empty file
    require_map(all);
    std::set<std::string> keys;
    for (const auto& entry : all) {
      const auto key = new_key(entry.first, keys);
      if (key == "domain") {
        settings.domain.id = static_cast<std::uint32_t>(whole(entry.second, 0, 232));
      } else if (key == "interface") {
        settings.domain.interface = text(entry.second);
      } else if (key == "max_size_mib") {
        settings.domain.max_size = mebibytes(entry.second, 1, 2047);
      } else if (key == "most_incoming") {
        settings.most_incoming = static_cast<std::size_t>(whole(entry.second, 0, 1000));
      } else if (key == "node") {
        settings.node = text(entry.second);
        if (!is_node_name(settings.node))
          refuse(entry.second, "ROS 2 allows no such name of a node");
      } else if (key == "ros") {
        settings.gid_bytes = gid_bytes(entry.second);
      } else if (key == "out" || key == "in") {
        rows(entry.second, key == "in", key == "in" ? settings.in : settings.out);
      } else {
        refuse(entry.first, "there is no setting " + key);
      }
    }
  }

 private:
  [[noreturn]] void refuse(const YAML::Node& where, const std::string& why) const {
    refuse_at(where.Mark(), why);
  }
  [[noreturn]] void refuse_at(const YAML::Mark& mark, const std::string& why) const {
    throw Error(EINVAL, name_ + ":" + std::to_string(mark.line + 1), why, "");
  }

  YAML::Node load() const {
    std::ifstream in(name_);
    if (!in) throw Error(errno, name_, "the file can not be read", "");
    try {
      return YAML::Load(in);
    } catch (const YAML::Exception& e) {
      refuse_at(e.mark, e.msg);
    }
  }

  void require_map(const YAML::Node& node) const {
    if (!node.IsMap()) refuse(node, "here belong settings, one a line: name: value");
  }
  std::string text(const YAML::Node& node) const {
    if (!node.IsScalar() || node.Scalar().empty()) refuse(node, "here belongs a text");
    return node.Scalar();
  }
  std::string new_key(const YAML::Node& node, std::set<std::string>& keys) const {
    std::string key = text(node);
    if (!keys.insert(key).second) refuse(node, key + " is there twice");
    return key;
  }
  double number(const YAML::Node& node, double least, double most) const {
    double value = std::numeric_limits<double>::quiet_NaN();
    if (node.IsScalar() && YAML::convert<double>::decode(node, value) && value >= least &&
        value <= most) {
      return value;
    }
    refuse(node, "here belongs a number from " + std::to_string(std::llround(least)) + " to " +
                     std::to_string(std::llround(most)));
  }
  double whole(const YAML::Node& node, double least, double most) const {
    const double value = number(node, least, most);
    if (value != std::floor(value)) refuse(node, "here belongs a whole number");
    return value;
  }
  std::uint64_t mebibytes(const YAML::Node& node, double least, double most) const {
    return static_cast<std::uint64_t>(number(node, least, most) * kMiB);
  }

  void rows(const YAML::Node& node, bool is_in, std::vector<RouteSettings>& into) const {
    if (!node.IsSequence()) refuse(node, "here belongs a list of topics");
    for (const YAML::Node& row : node) {
      if (row.IsScalar()) {
        RouteSettings settings;
        settings.topics = text(row);
        into.push_back(std::move(settings));
      } else {
        into.push_back(route(row, is_in));
      }
    }
  }

  RouteSettings route(const YAML::Node& node, bool is_in) const {
    require_map(node);
    RouteSettings settings;
    Quality& quality = settings.quality;
    std::set<std::string> keys;
    for (const auto& entry : node) {
      const auto key = new_key(entry.first, keys);
      const YAML::Node& value = entry.second;
      if (!is_in && (key == "max_rate" || key == "max_memory_mib" || key == "type")) {
        refuse(entry.first, key + " is a setting of topics that come in");
      }
      if (key == "topics") {
        settings.topics = text(value);
      } else if (key == "dds_topic") {
        settings.dds_topic = text(value);
      } else if (key == "reliability") {
        quality.reliability = reliability(value);
      } else if (key == "durability") {
        quality.durability = durability(value);
      } else if (key == "depth") {
        quality.depth = static_cast<std::uint32_t>(whole(value, 1, 10000));
      } else if (key == "deadline_ms") {
        quality.deadline = std::chrono::duration<double, std::milli>(number(value, 0, 1e9));
      } else if (key == "max_rate") {
        settings.limits.max_rate = number(value, 0, 1e9);
      } else if (key == "max_memory_mib") {
        settings.limits.max_bytes = mebibytes(value, 0, 1e6);
      } else if (key == "type") {
        settings.type = ros_type(value);
      } else {
        refuse(entry.first, "there is no setting " + key + " of a topic");
      }
    }
    if (settings.topics.empty()) refuse(node, "the topics are missing: topics: NAME");
    if (!settings.dds_topic.empty() && record::is_pattern(settings.topics)) {
      refuse(node, "dds_topic is the name of one topic, and " + settings.topics + " is a pattern");
    }
    return settings;
  }

  std::string ros_type(const YAML::Node& node) const {
    const std::string name = text(node);
    if (is_ros_type(dds_type_of(name))) return name;
    refuse(node, "the gateway knows no fields of " + name);
  }
  /// Only the size of an identity differs.
  std::size_t gid_bytes(const YAML::Node& node) const {
    const std::string word = text(node);
    if (word == "humble") return 24;
    if (word == "iron" || word == "jazzy") return 16;
    refuse(node, word + " is none of humble, iron, jazzy");
  }
  Reliability reliability(const YAML::Node& node) const {
    const std::string word = text(node);
    if (word == "reliable") return Reliability::Reliable;
    if (word == "best_effort") return Reliability::BestEffort;
    refuse(node, word + " is neither reliable nor best_effort");
  }
  Durability durability(const YAML::Node& node) const {
    const std::string word = text(node);
    if (word == "volatile") return Durability::Volatile;
    if (word == "transient_local") return Durability::TransientLocal;
    refuse(node, word + " is neither volatile nor transient_local");
  }

  const std::string name_;
};

}  // namespace

void read_settings(const std::string& file, Settings& settings) { File(file).read(settings); }

}  // namespace lot::gateway
