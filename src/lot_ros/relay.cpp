// SPDX-License-Identifier: Apache-2.0
#include "lot/ros/relay.hpp"

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <deque>
#include <iterator>
#include <map>
#include <string>

#include <boost/make_shared.hpp>
#include <ros/init.h>
#include <ros/master.h>
#include <ros/names.h>
#include <ros/param.h>

namespace lot::ros {
namespace {

constexpr int kQueue = 100;  ///< unless ~queue_size says otherwise
/// A message in shared memory may come before its publisher's link, which says whether the
/// publisher latches. The relay waits for the link so long, and looks so often.
using Clock = std::chrono::steady_clock;
constexpr std::chrono::seconds kLinkComes{1};
constexpr double kLook_s = 0.01;

/// The type of a topic; waits until a node publishes it. Empty: the node is to end.
std::string type_of(const std::string& topic) {
  for (bool said = false; ::ros::ok(); said = true) {
    ::ros::master::V_TopicInfo topics;
    ::ros::master::getTopics(topics);
    for (const auto& info : topics) {
      if (info.name == topic) return info.datatype;
    }
    if (!said) ROS_INFO("waiting for a publisher of %s", topic.c_str());
    ::ros::WallDuration(0.2).sleep();
  }
  return "";
}

/// Publishes a topic of any type again.
class Forward final : public ::ros::SubscriptionCallbackHelper {
 public:
  Forward(::ros::NodeHandle& node, const std::string& out, std::uint32_t queue_size,
          const detail::Kind& kind)
      : node_(node), out_(out), queue_size_(queue_size), kind_(kind), end_(advertise(false)) {}

  bool is_open() const { return end_ != nullptr; }
  /// The subscription `in` calls this until it ends.
  void is_fed_by(const detail::Subscription& in) {
    in_ = &in;
    looks_ = node_.createWallTimer(
        ::ros::WallDuration(kLook_s), [this](const ::ros::WallTimerEvent&) { look(); }, false,
        false);
  }

  ::ros::VoidConstPtr deserialize(
      const ::ros::SubscriptionCallbackHelperDeserializeParams& frame) override {
    return kind_.deserialise(frame.buffer, frame.length);
  }
  void call(::ros::SubscriptionCallbackHelperCallParams& params) override {
    waiting_.push_back(
        {params.event.getConstMessage(), params.event.getPublisherName(), Clock::now()});
    look();
  }
  const std::type_info& getTypeInfo() override { return *kind_.type; }
  bool isConst() override { return true; }
  bool hasHeader() override { return kind_.has_header; }

 private:
  using Message = boost::shared_ptr<void const>;
  struct Waiting {
    Message message;
    std::string publisher;
    Clock::time_point since;
  };

  void look() {
    while (!waiting_.empty()) {
      const auto& [message, publisher, since] = waiting_.front();
      const auto latches = in_->latches(publisher);
      if (!latches) {
        const bool is_doubtful = doubtful_.count(publisher) != 0;
        const bool has_time = Clock::now() - since < kLinkComes && waiting_.size() < queue_size_;
        if (has_time && !is_doubtful) break;
        doubtful_[publisher] = message;
      } else {
        doubtful_.erase(publisher);
      }
      send(message, latches.value_or(false));
      waiting_.pop_front();
    }
    for (auto doubtful = doubtful_.begin(); doubtful != doubtful_.end();) {
      const auto latches = in_->latches(doubtful->first);
      if (latches.value_or(false)) send(doubtful->second, true);  // again, so that it is latched
      doubtful = latches ? doubtful_.erase(doubtful) : std::next(doubtful);
    }
    if (waiting_.empty() && doubtful_.empty()) {
      looks_.stop();
    } else {
      looks_.start();
    }
  }
  void send(const Message& message, bool latches) {
    if (latches && !latching_end_) latching_end_ = advertise(true);
    const auto& end = latches && latching_end_ ? latching_end_ : end_;
    if (const auto outlet = end->outlet()) {
      outlet->publish({message, kind_.control_of(message)}, false, end->id());
    }
  }

  std::shared_ptr<detail::Advertisement> advertise(bool latch) {
    ::ros::AdvertiseOptions options(out_, queue_size_, kind_.md5sum, kind_.datatype,
                                    kind_.definition);
    options.has_header = kind_.has_header;
    options.latch = latch;
    return detail::advertise(node_, options, kind_);
  }

  ::ros::NodeHandle& node_;
  const std::string out_;
  const std::uint32_t queue_size_;
  const detail::Kind& kind_;
  std::shared_ptr<detail::Advertisement> end_;
  std::shared_ptr<detail::Advertisement> latching_end_;  ///< null: no publisher latches yet
  const detail::Subscription* in_ = nullptr;
  std::deque<Waiting> waiting_;  ///< until it is known whether their publishers latch
  /// The last message of each publisher that did not say in time whether it latches. The relay has
  /// sent it as one that is not latched.
  std::map<std::string, Message> doubtful_;
  ::ros::WallTimer looks_;
};

}  // namespace

int relay(int argc, char** argv, const std::vector<Relayed>& types) {
  ::ros::init(argc, argv, "lot_relay", ::ros::init_options::AnonymousName);
  // As roscpp's handler of SIGINT: it sets a flag, and ROS's thread ends the node.
  std::signal(SIGTERM, [](int) { ::ros::requestShutdown(); });
  ::ros::V_string arguments;
  ::ros::removeROSArgs(argc, argv, arguments);
  if (arguments.size() != 3) {
    std::fprintf(stderr, "usage: lot_relay IN OUT\n");
    return 2;
  }
  ::ros::NodeHandle node;
  const std::string in = node.resolveName(arguments[1]);
  if (in == node.resolveName(arguments[2])) {
    std::fprintf(stderr, "lot_relay: %s cannot be relayed to itself\n", in.c_str());
    return 2;
  }
  const std::string type = type_of(in);
  if (type.empty()) return 0;
  const auto known = std::find_if(types.begin(), types.end(),
                                  [&](const Relayed& each) { return each.datatype == type; });
  if (known == types.end()) {
    std::fprintf(stderr,
                 "lot_relay: %s carries %s, which this relay does not know; docs/porting.md shows "
                 "the program of three lines that does\n",
                 in.c_str(), type.c_str());
    return 1;
  }
  const detail::Kind& kind = known->kind();
  const auto queue_size = static_cast<std::uint32_t>(
      std::max(::ros::param::param(::ros::names::resolve("~queue_size"), kQueue), 1));
  const auto forward = boost::make_shared<Forward>(node, arguments[2], queue_size, kind);
  if (!forward->is_open()) return 1;
  ::ros::SubscribeOptions options(arguments[1], queue_size, kind.md5sum, kind.datatype);
  options.helper = forward;
  const auto subscription = detail::subscribe(node, options, kind);
  if (!subscription) return 1;
  forward->is_fed_by(*subscription);
  ::ros::spin();
  return 0;
}

}  // namespace lot::ros
