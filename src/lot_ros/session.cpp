// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/session.hpp"

#include <cerrno>
#include <chrono>
#include <cstdio>
#include <mutex>
#include <random>
#include <utility>

#include <boost/make_shared.hpp>
#include <ros/console.h>
#include <ros/master.h>
#include <ros/names.h>
#include <ros/param.h>
#include <ros/this_node.h>
#include <xmlrpcpp/XmlRpcException.h>

#include "lot/detail/mutex.hpp"
#include "lot/detail/no_signals.hpp"

#include "lot_ros/copies.hpp"

namespace lot::ros {
namespace {

using namespace std::chrono_literals;

/// Names one run of a ROS master that has no /run_id (roslaunch sets one).
constexpr const char* kGraphParameter = "/lot_graph";
constexpr auto kGraphSettles = 50ms;

std::string random_text() {
  std::random_device random;
  char text[33];
  std::snprintf(text, sizeof(text), "%08x%08x%08x%08x", random(), random(), random(), random());
  return text;
}

std::string asked_of_master(const char* method) {
  XmlRpc::XmlRpcValue request, response, payload;
  request[0] = ::ros::this_node::getName();
  if (!::ros::master::execute(method, request, response, payload, false)) return "";
  return payload.toXml();
}

/// Reads the parameter ~lot/NAME, if it is there and of this type.
template <class T>
bool read_parameter(const char* name, T& value) {
  return ::ros::param::get(::ros::names::resolve(std::string("~lot/") + name), value);
}

std::uint64_t bytes_of(const std::string& text) {
  char* end = nullptr;
  const double number = std::strtod(text.c_str(), &end);
  const std::string unit = end;
  const double factor = unit.empty() || unit == "B" ? 1
                        : unit == "K"               ? 1024.
                        : unit == "M"               ? 1024. * 1024
                        : unit == "G"               ? 1024. * 1024 * 1024
                                                    : 0;
  if (end == text.c_str() || factor == 0 || number <= 0) {
    throw Error(EINVAL, "~lot/size: " + text, "not a size",
                "write bytes, or a number with K, M or G");
  }
  return static_cast<std::uint64_t>(number * factor);
}

/// Joins the segment. ~lot/size is for the process that makes the segment: if others use one of
/// another size, it joins theirs.
std::shared_ptr<transport::Participant> join(EngineOptions options) {
  try {
    return lot::detail::join(options);
  } catch (const Error& e) {
    if (e.error_number() != EBUSY || options.size_bytes == 0) throw;
    options.size_bytes = 0;
    return lot::detail::join(options);
  }
}

/// How LOT's thread waits.
Wait waiting() {
  std::string word = "park";
  read_parameter("wait", word);
  if (word == "spin") return Wait::Spin;
  if (word == "adaptive") return Wait::Adaptive;
  if (word != "park") {
    ROS_WARN("LOT: ~lot/wait: %s is no way to wait: it parks; write park, adaptive or spin",
             word.c_str());
  }
  return Wait::Park;
}

}  // namespace

std::string hash_of(std::string_view text) {
  std::uint64_t h = 0xcbf29ce484222325;
  for (const char c : text) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  char digits[17];
  std::snprintf(digits, sizeof(digits), "%016llx", static_cast<unsigned long long>(h));
  return digits;
}

boost::shared_ptr<::ros::M_string> link_header(const detail::Kind& kind, const std::string& topic,
                                               const std::string& publisher) {
  auto header = boost::make_shared<::ros::M_string>();
  (*header)["callerid"] = publisher;
  (*header)["topic"] = topic;
  (*header)["type"] = kind.datatype;
  (*header)["md5sum"] = kind.md5sum;
  (*header)["message_definition"] = kind.definition;
  return header;
}

std::string participant_name(std::string_view node) {
  constexpr std::size_t kMost = lot::detail::kProcessNameBytes - 1;
  if (node.size() <= kMost) return std::string(node);
  const std::string hash = hash_of(node);
  return std::string(node.substr(0, kMost - 1 - hash.size())) + '#' + hash;
}

std::shared_ptr<Session> Session::get() {
  static auto* const mutex =
      new lot::detail::Mutex(lot::detail::Rank::Session);  // static destructors call this
  static auto* const the_one = new std::weak_ptr<Session>;
  const std::lock_guard guard(*mutex);
  auto session = the_one->lock();
  if (!session) {
    session.reset(new Session);
    *the_one = session;
  }
  return session;
}

Session::Session() : loop_(std::make_shared<Loop>(waiting())) {
  bool enable = true;
  read_parameter("enable", enable);
  try {
    if (enable) open();
  } catch (const std::exception& e) {
    ROS_WARN("LOT is off in this node, messages go over TCPROS: %s", e.what());
    maker_.reset();
    participant_.reset();
  }
  // LOT's thread runs without a segment, too: it delivers what comes over links.
  const lot::detail::NoSignals quiet;
  thread_ = std::thread([loop = loop_] { loop->run(); });
}

void Session::open() {
  // Two copies would be two participants with one node's name: publishers could not tell them
  // apart.
  if (const std::string first = earlier_copy(); !first.empty()) {
    throw Error(EEXIST, first, "it came into this process first, and has another copy of lot::ros",
                "link all nodes of a process with the same liblot_ros.so");
  }
  EngineOptions options;
  options.name = participant_name(::ros::this_node::getName());
  read_parameter("segment", options.segment);
  std::string size;
  int bytes = 0;
  if (read_parameter("size", size)) {
    options.size_bytes = bytes_of(size);
  } else if (read_parameter("size", bytes)) {
    options.size_bytes = bytes_of(std::to_string(bytes));
  }
  std::string queue = "ring";
  read_parameter("queue", queue);
  if (queue != "ring" && queue != "mutex") {
    throw Error(EINVAL, "~lot/queue: " + queue, "not a queue", "write ring or mutex");
  }
  queue_engine_ = queue == "ring" ? QueueEngine::Ring : QueueEngine::Mutex;
  run_ = graph();
  participant_ = join(options);
  // An engine of the application's may have given this process another name.
  lot::detail::rename(*participant_, options.name);
  maker_ = lot::detail::make_maker(participant_);
}

/// A name that tells this ROS graph from others that use the segment.
std::string Session::graph() {
  std::string id;
  if (!::ros::param::get("/run_id", id)) {
    // Several nodes may set it at once: the value of the last one stands.
    while (!::ros::param::get(kGraphParameter, id)) {
      if (!::ros::ok()) throw Error(ESHUTDOWN, kGraphParameter, "ROS ends", "start anew");
      ::ros::param::set(kGraphParameter, random_text());
      std::this_thread::sleep_for(kGraphSettles);
    }
  }
  return hash_of(id + asked_of_master("getUri") + asked_of_master("getPid")).substr(0, 8);
}

Session::~Session() {
  if (loop_->is_inherited()) {
    thread_.detach();
    return;
  }
  // The user's thread does not wait long for a callback that is at work on LOT's thread.
  loop_->end() ? thread_.join() : thread_.detach();
}

std::string Session::name_of(const std::string& topic) const {
  std::string name = run_ + ' ' + topic;
  if (name.size() < lot::detail::kTopicNameBytes) return name;
  const std::string hash = hash_of(topic);
  name.resize(lot::detail::kTopicNameBytes - 2 - hash.size());
  return name + '#' + hash;
}

}  // namespace lot::ros
