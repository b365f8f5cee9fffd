// SPDX-License-Identifier: Apache-2.0
#include "conditions.hpp"

#include <algorithm>
#include <charconv>
#include <initializer_list>

#include "machine.hpp"
#include "measures.hpp"

namespace ab {
namespace {

/// NpMs.
bool parse_graph(const std::string& text, unsigned& publishers, unsigned& subscribers) {
  const char* const end = text.data() + text.size();
  const auto [p, error] = std::from_chars(text.data(), end, publishers);
  if (error != std::errc() || p == end || *p != 'p') return false;
  const auto [s, error2] = std::from_chars(p + 1, end, subscribers);
  return error2 == std::errc() && s + 1 == end && *s == 's' && publishers > 0 && subscribers > 0;
}

}  // namespace

bool is_scenario(const std::string& graph) { return graph == "av"; }

std::vector<Topic> topics(const Conditions& c) {
  if (is_scenario(c.graph)) {
    // The paper's vehicle. The inertial sensor comes first: blocks are counted in its messages.
    std::vector<Topic> all{
        {"imu", 128, 400, 1, 3}, {"lidar", 1 << 20, 10, 1, 3}, {"gnss", 128, 20, 1, 3}};
    for (unsigned i = 0; i < 4; ++i) {
      all.push_back({"camera" + std::to_string(i), 8 << 20, 30, 1, 3});
    }
    return all;
  }
  Topic topic;
  topic.size = c.size;
  topic.rate_hz = c.mode == "paced" ? c.rate_hz : 0;
  if (!parse_graph(c.graph, topic.publishers, topic.subscribers)) return {};
  return {topic};
}

std::vector<std::string> arms_of(const Conditions& c, const std::vector<std::string>& transports) {
  if (!is_scenario(c.graph)) return transports;
  std::vector<std::string> arms;
  for (const std::string& name : transports) {
    arms.push_back(name);
    arms.push_back(quiet(name));
  }
  return arms;
}

std::vector<Topic> topics_of(const Conditions& c, const std::string& arm) {
  std::vector<Topic> some = topics(c);
  if (is_quiet(arm)) {
    some.erase(
        std::remove_if(some.begin(), some.end(),
                       [](const Topic& topic) { return topic.name.rfind("camera", 0) == 0; }),
        some.end());
  }
  return some;
}

std::vector<std::string> floors_of(const Conditions& c) {
  std::vector<std::string> floors;
  // Who spins needs a core of its own.
  unsigned nodes = 0;
  for (const Topic& topic : topics(c)) nodes += topic.publishers + topic.subscribers;
  if (nodes <= usable_cores().size() && c.pin != "same-core") floors.emplace_back("floor-spin");
  floors.emplace_back("floor-futex");
  if (c.mode == "paced") floors.emplace_back("floor-pace");
  return floors;
}

std::string refused(const Conditions& c) {
  const auto is_one_of = [](const std::string& text, std::initializer_list<const char*> all) {
    return std::any_of(all.begin(), all.end(), [&](const char* each) { return text == each; });
  };
  const bool scenario = is_scenario(c.graph);
  unsigned publishers = 0;
  unsigned subscribers = 0;
  if (!is_one_of(c.mode, {"paced", "ping-pong", "throughput"})) {
    return "--mode is paced, ping-pong or throughput";
  }
  if (!scenario && !parse_graph(c.graph, publishers, subscribers)) {
    return "--graph is NpMs (1p5s) or av";
  }
  if (publishers > 64 || subscribers > 64)
    return "--graph: at most 64 publishers and 64 subscribers";
  if (scenario && c.mode != "paced") return "--graph " + c.graph + " is paced; leave --mode out";
  if (c.mode == "ping-pong" && (publishers != 1 || subscribers != 1)) {
    return "--mode ping-pong is between two nodes: --graph 1p1s";
  }
  if (!scenario && (c.size < 128 || c.size % 8 != 0 || c.size > (std::size_t{1} << 30))) {
    return "--size is a multiple of 8 from 128 to 1G";
  }
  if (c.mode == "paced" && !(c.rate_hz > 0 && c.rate_hz <= 100'000)) {
    return "--rate is more than 0 and at most 100000";
  }
  if (c.messages == 0 || c.block == 0) return "--messages and --block are at least 1";
  if (c.depth == 0 || c.depth > 4096) return "--depth is from 1 to 4096";
  if (!is_one_of(c.wait, {"spin", "adaptive", "park"})) return "--wait is spin, adaptive or park";
  if (!is_one_of(c.place, {"host", "container", "containers"})) {
    return "--place is host, container or containers";
  }
  if (!is_one_of(c.pin, {"none", "same-core", "other-core", "socket", "other-socket"})) {
    return "--pin is none, same-core, other-core, socket or other-socket";
  }
  if (c.pin == "same-core" && c.wait == "spin") {
    return "on one core who spins keeps the other from running; set --wait park or adaptive";
  }
  const std::vector<int> cores = usable_cores();
  if (c.pin == "other-core" && cores.size() < 2)
    return "--pin other-core: this process has one core";
  if (c.pin == "other-socket" && std::all_of(cores.begin(), cores.end(), [&](int core) {
        return socket_of(core) == socket_of(cores.front());
      })) {
    return "--pin other-socket: this machine has one socket";
  }
  return "";
}

}  // namespace ab
