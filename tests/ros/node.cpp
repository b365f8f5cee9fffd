// SPDX-License-Identifier: Apache-2.0

// A ROS node for tests: publishes numbered images and takes account of those that it receives.
//
//     ros_node END... [--for SECONDS] [ROS remappings]
//
//     END   pub:HOW:TOPIC:COUNT:HZ:BYTES[:latch][:wait=N][:keep]
//               HOW: lot, plain, std (lot, given standard messages)
//           sub:HOW:TOPIC[:COUNT[:after=SECONDS]]
//               HOW: lot, plain, lotptr, event
//
// Ends when all publishers have sent all and all subscribers have got COUNT, or by SIGINT, SIGTERM
// or after SECONDS. Prints one line of JSON: what each end has seen.

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include "lot/ros.hpp"

namespace {

using Json = nlohmann::json;
using Shared = lot::ros::Message<sensor_msgs::Image_>;
using Plain = sensor_msgs::Image;

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == ':') {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  return parts;
}

/// Message n of a node: its number in the width, its publisher in the encoding, bytes that follow
/// from both.
template <class M>
void fill(M& message, std::uint32_t n, std::size_t bytes) {
  message.width = n;
  message.encoding = ros::this_node::getName().c_str();
  message.header.stamp = ros::Time::now();
  message.data.resize(bytes);
  for (std::size_t i = 0; i < bytes; i += 61) message.data[i] = static_cast<std::uint8_t>(n + i);
}

template <class M>
bool is_whole(const M& message) {
  for (std::size_t i = 0; i < message.data.size(); i += 61) {
    if (message.data[i] != static_cast<std::uint8_t>(message.width + i)) return false;
  }
  return true;
}

std::atomic<std::int64_t> latest{-1};  ///< number that any subscriber here has seen

/// What a subscriber has seen of each publisher.
class Account {
 public:
  template <class M>
  void note(const M& message, const std::string& callerid) {
    const std::lock_guard guard(mutex_);
    auto& seen = seen_[std::string(message.encoding.data(), message.encoding.size())];
    const std::int64_t n = message.width;
    latest = n;
    if (seen.received == 0) {
      seen.first = n;
    } else if (n <= seen.last) {
      ++(n == seen.last ? seen.twice : seen.disorder);
    } else {
      seen.gaps += n - seen.last - 1;
    }
    seen.last = n;
    ++seen.received;
    seen.torn += !is_whole(message);
    seen.misnamed += !callerid.empty() &&
                     callerid != std::string(message.encoding.data(), message.encoding.size());
    ++all_;
  }
  std::size_t all() const { return all_; }
  Json json() const {
    const std::lock_guard guard(mutex_);
    Json publishers = Json::object();
    for (const auto& [name, s] : seen_) {
      publishers[name] = {{"received", s.received}, {"first", s.first},       {"last", s.last},
                          {"twice", s.twice},       {"disorder", s.disorder}, {"gaps", s.gaps},
                          {"torn", s.torn},         {"misnamed", s.misnamed}};
    }
    return publishers;
  }

 private:
  struct Seen {
    std::int64_t received = 0, first = 0, last = 0, twice = 0, disorder = 0, gaps = 0, torn = 0,
                 misnamed = 0;
  };
  mutable std::mutex mutex_;
  std::map<std::string, Seen> seen_;
  std::atomic<std::size_t> all_{0};
};

struct End {
  virtual ~End() = default;
  virtual void look(std::chrono::steady_clock::duration /*since the start*/) {}
  virtual bool done() const = 0;
  virtual Json json() const = 0;
};

class Subscription final : public End {
 public:
  Subscription(const std::vector<std::string>& words, lot::ros::NodeHandle& node)
      : how_(words.at(1)),
        topic_(words.at(2)),
        wanted_(words.size() > 3 ? std::stoul(words[3]) : 0),
        node_(node) {
    if (words.size() > 4 && words[4].rfind("after=", 0) == 0) {
      after_ = std::chrono::duration<double>(std::stod(words[4].substr(6)));
    } else {
      begin();
    }
  }
  void look(std::chrono::steady_clock::duration now) override {
    // Just after a message, so that none is on its way.
    const std::int64_t seen = std::exchange(looked_, latest);
    if (after_ && now >= *after_ && seen != looked_) begin();
  }
  bool done() const override { return !after_ && wanted_ != 0 && account_.all() >= wanted_; }
  Json json() const override {
    return {{"end", "sub"},
            {"how", how_},
            {"topic", topic_},
            {"from", account_.json()},
            {"base", base_}};
  }

 private:
  void begin() {
    after_.reset();
    base_ = latest;
    lot::ros::NodeHandle& node = node_;
    constexpr std::uint32_t kQueue = 1000;
    if (how_ == "plain") {
      using Event = ros::MessageEvent<Plain const>;
      plain_ = static_cast<ros::NodeHandle&>(node).subscribe<Plain, const Event&>(
          topic_, kQueue, boost::function<void(const Event&)>([this](const Event& event) {
            account_.note(*event.getConstMessage(), event.getPublisherName());
          }));
    } else if (how_ == "lotptr") {
      lot_ = node.subscribe<Shared>(
          topic_, kQueue,
          [this](const lot::ShmSharedPtr<const Shared>& message) { account_.note(*message, ""); });
    } else if (how_ == "event") {
      lot_ = node.subscribe<Shared>(
          topic_, kQueue, [this](const ros::MessageEvent<Shared const>& event) {
            account_.note(*event.getConstMessage(), event.getPublisherName());
          });
    } else {
      lot_ = node.subscribe<Shared>(
          topic_, kQueue,
          [this](const boost::shared_ptr<Shared const>& m) { account_.note(*m, ""); });
    }
  }
  const std::string how_, topic_;
  const std::size_t wanted_;
  lot::ros::NodeHandle& node_;
  std::optional<std::chrono::duration<double>> after_;
  std::int64_t looked_ = -1;
  std::int64_t base_ = -1;  ///< of the messages when it subscribed
  Account account_;
  ros::Subscriber plain_;
  lot::ros::Subscriber lot_;
};

class Publication final : public End {
 public:
  Publication(const std::vector<std::string>& words, lot::ros::NodeHandle& node)
      : how_(words.at(1)),
        topic_(words.at(2)),
        count_(std::stoul(words.at(3))),
        hz_(std::stod(words.at(4))),
        bytes_(std::stoul(words.at(5))) {
    bool latch = false;
    for (std::size_t i = 6; i < words.size(); ++i) {
      if (words[i] == "latch") latch = true;
      if (words[i] == "keep") keep_ = true;
      if (words[i].rfind("wait=", 0) == 0) wait_ = std::stoul(words[i].substr(5));
    }
    constexpr std::uint32_t kQueue = 1000;
    if (how_ == "plain") {
      plain_ = static_cast<ros::NodeHandle&>(node).advertise<Plain>(topic_, kQueue, latch);
    } else {
      lot_ = node.advertise<Shared>(topic_, kQueue, latch);
    }
    thread_ = std::thread([this] { run(); });
  }
  ~Publication() override { thread_.join(); }
  bool done() const override { return sent_ == count_ && !keep_; }
  Json json() const override {
    return {
        {"end", "pub"},
        {"how", how_},
        {"topic", topic_},
        {"sent", sent_.load()},
        {"subscribers", how_ == "plain" ? plain_.getNumSubscribers() : lot_.getNumSubscribers()},
        {"serialised", how_ == "plain" ? 0 : lot_.serialised()}};
  }

 private:
  void run() {
    while (ros::ok() &&
           (how_ == "plain" ? plain_.getNumSubscribers() : lot_.getNumSubscribers()) < wait_) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    auto next = std::chrono::steady_clock::now();
    for (std::uint32_t n = 0; n < count_ && ros::ok(); ++n) {
      if (how_ == "plain" || how_ == "std") {
        auto message = boost::make_shared<Plain>();
        fill(*message, n, bytes_);
        if (how_ == "plain") {
          plain_.publish(message);
        } else {
          lot_.publish(*message);
        }
      } else {
        auto message = lot_.loan();
        fill(*message, n, bytes_);
        lot_.publish(std::move(message));
      }
      ++sent_;
      if (hz_ > 0) {
        next += std::chrono::nanoseconds(static_cast<std::int64_t>(1e9 / hz_));
        std::this_thread::sleep_until(next);
      }
    }
  }

  const std::string how_, topic_;
  const std::size_t count_;
  const double hz_;
  const std::size_t bytes_;
  std::size_t wait_ = 0;
  bool keep_ = false;
  std::atomic<std::size_t> sent_{0};
  ros::Publisher plain_;
  lot::ros::Publisher<Shared> lot_;
  std::thread thread_;
};

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "node");
  double most_s = 60;
  lot::ros::NodeHandle node;
  std::vector<std::unique_ptr<End>> ends;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--for") {
      most_s = std::stod(argv[++i]);
      continue;
    }
    const auto words = split(word);
    if (words[0] == "pub") {
      ends.push_back(std::make_unique<Publication>(words, node));
    } else {
      ends.push_back(std::make_unique<Subscription>(words, node));
    }
  }
  ros::AsyncSpinner spinner(1);
  spinner.start();
  const auto until = std::chrono::steady_clock::now() + std::chrono::duration<double>(most_s);
  const auto all_done = [&] {
    for (const auto& end : ends) {
      if (!end->done()) return false;
    }
    return true;
  };
  const auto start = std::chrono::steady_clock::now();
  while (ros::ok() && !all_done() && std::chrono::steady_clock::now() < until) {
    for (auto& end : ends) end->look(std::chrono::steady_clock::now() - start);
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  // What was sent last is still on its way.
  if (ros::ok()) std::this_thread::sleep_for(std::chrono::milliseconds(300));
  Json report = Json::array();
  for (const auto& end : ends) report.push_back(end->json());
  std::printf("%s\n", report.dump().c_str());
  std::fflush(stdout);
  ros::shutdown();
}
