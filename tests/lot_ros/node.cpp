// SPDX-License-Identifier: Apache-2.0

// A ROS node for tests: publishes numbered images and takes account of those that it receives.
//
//     ros_node END... [--for SECONDS] [--spin single|multi|async] [ROS remappings]
//
//     END   pub:HOW:TOPIC:COUNT:HZ:BYTES[:latch][:wait=N][:keep][:queue=N][:greet]
//               HOW: lot, plain, std (lot, given standard messages), other (lot, messages of
//               another definition under the same name)
//               greet: whoever comes gets message 0 of NAME/greeting for itself
//           sub:HOW:TOPIC[:COUNT[:after=SECONDS[:quietly]][:queue=N][:leave][:slow]]
//               HOW: lot, plain, lotptr, event
//               after: it begins then, when a message has just come, but quietly
//               leave: it ends when it has got COUNT
//               slow (lot): its callback takes a second for each 100th message
//           look:HOW:TOPIC[:COUNT[:history=N][:as=NAME]]
//               HOW: any (does not have the type), typed (has it: images)
//               an observer of a topic of the segment, which ROS does not know; TOPIC is the name
//               there. Without a COUNT (0) it looks on until a signal ends the node
//               as: the name of its process in the segment
//           TOPIC may be ~private.
//
// Ends when all publishers have sent all and all subscribers have got COUNT, or by SIGINT, SIGTERM
// or after SECONDS. Prints "ready" when it has all ends, and when it ends one line of JSON: what
// each end has seen, and where in the segment the payload of each message was (-1: not there).

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
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

#include "lot/error.hpp"
#include "lot/lot.hpp"
#include "lot/ros.hpp"

#include "changed.hpp"

namespace {

using Json = nlohmann::json;
using Shared = lot::ros::Message<sensor_msgs::Image_>;
using Plain = sensor_msgs::Image;
using Changed = lot::ros::Message<lot_test::Changed_>;

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

/// The segment as this process has mapped it.
class Map {
 public:
  /// Where something lies in the segment; -1: nowhere.
  std::int64_t place(const void* at) {
    const std::lock_guard guard(mutex_);
    const auto address = reinterpret_cast<std::uintptr_t>(at);
    if (!has(address)) look();
    return has(address) ? static_cast<std::int64_t>(address - begin_ + offset_) : -1;
  }

 private:
  bool has(std::uintptr_t address) const { return begin_ <= address && address < end_; }
  void look() {
    const char* const name = std::getenv("LOT_SEGMENT");
    if (begin_ != 0 || name == nullptr) return;
    std::ifstream maps("/proc/self/maps");
    for (std::string line; std::getline(maps, line);) {
      if (line.size() < std::strlen(name) + 1) continue;
      const std::size_t end = line.size() - std::strlen(name);
      if (line[end - 1] != '/' || line.substr(end) != name) continue;
      std::uintptr_t begin = 0, last = 0;
      unsigned long offset = 0;
      std::sscanf(line.c_str(), "%lx-%lx %*s %lx", &begin, &last, &offset);
      if (last - begin <= end_ - begin_) continue;  // there are small ones beside it
      begin_ = begin, end_ = last, offset_ = offset;
    }
  }
  std::mutex mutex_;
  std::uintptr_t begin_ = 0, end_ = 0, offset_ = 0;
} segment;

std::atomic<std::int64_t> latest{-1};  ///< number that any subscriber here has seen

constexpr std::size_t kMostPlaces = 1000;

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
    if (seen.places.size() < kMostPlaces) seen.places.push_back(segment.place(message.data.data()));
    ++seen.received;
    seen.torn += !is_whole(message);
    seen.stamp = message.header.stamp.toSec();
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
                          {"torn", s.torn},         {"misnamed", s.misnamed}, {"places", s.places},
                          {"stamp", s.stamp}};
    }
    return publishers;
  }

 private:
  struct Seen {
    std::int64_t received = 0, first = 0, last = 0, twice = 0, disorder = 0, gaps = 0, torn = 0,
                 misnamed = 0;
    std::vector<std::int64_t> places;  ///< of the first ones
    double stamp = 0;                  ///< of the last one
  };
  mutable std::mutex mutex_;
  std::map<std::string, Seen> seen_;
  std::atomic<std::size_t> all_{0};
};

constexpr std::uint32_t kQueue = 1000;
std::uint32_t queue_of(const std::string& word) {  // queue=N
  return static_cast<std::uint32_t>(std::stoul(word.substr(6)));
}

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
    for (std::size_t i = 4; i < words.size(); ++i) {
      if (words[i].rfind("after=", 0) == 0) {
        after_ = std::chrono::duration<double>(std::stod(words[i].substr(6)));
      }
      if (words[i].rfind("queue=", 0) == 0) queue_ = queue_of(words[i]);
      if (words[i] == "quietly") quietly_ = true;
      if (words[i] == "leave") leaves_ = true;
      if (words[i] == "slow") slow_ = true;
    }
    if (!after_) begin();
  }
  void look(std::chrono::steady_clock::duration now) override {
    // Just after a message, so that none is on its way.
    const std::int64_t seen = std::exchange(looked_, latest);
    if (after_ && now >= *after_ && (quietly_ || seen != looked_)) begin();
    if (leaves_ && done()) {
      plain_.shutdown();
      lot_.shutdown();
    }
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
    if (how_ == "plain") {
      using Event = ros::MessageEvent<Plain const>;
      plain_ = static_cast<ros::NodeHandle&>(node).subscribe<Plain, const Event&>(
          topic_, queue_, boost::function<void(const Event&)>([this](const Event& event) {
            account_.note(*event.getConstMessage(), event.getPublisherName());
          }));
    } else if (how_ == "lotptr") {
      lot_ = node.subscribe<Shared>(
          topic_, queue_,
          [this](const lot::ShmSharedPtr<const Shared>& message) { account_.note(*message, ""); });
    } else if (how_ == "event") {
      lot_ = node.subscribe<Shared>(
          topic_, queue_, [this](const ros::MessageEvent<Shared const>& event) {
            account_.note(*event.getConstMessage(), event.getPublisherName());
          });
    } else {
      lot_ =
          node.subscribe<Shared>(topic_, queue_, [this](const boost::shared_ptr<Shared const>& m) {
            account_.note(*m, "");
            if (slow_ && m->width % 100 == 99) std::this_thread::sleep_for(std::chrono::seconds(1));
          });
    }
  }
  const std::string how_, topic_;
  const std::size_t wanted_;
  lot::ros::NodeHandle& node_;
  std::optional<std::chrono::duration<double>> after_;
  std::int64_t looked_ = -1;
  std::int64_t base_ = -1;  ///< of the messages when it subscribed
  std::uint32_t queue_ = kQueue;
  bool leaves_ = false;
  bool quietly_ = false;
  bool slow_ = false;
  Account account_;
  ros::Subscriber plain_;
  lot::ros::Subscriber lot_;
};

/// An image, as a program that does not have the type reads it.
struct Described {
  explicit Described(const lot::Value& image)
      : header{{image.at("header.stamp.sec").as<std::uint32_t>(),
                image.at("header.stamp.nsec").as<std::uint32_t>()}},
        width(image["width"].as<std::uint32_t>()),
        encoding(image["encoding"].as<std::string>()),
        data(image["data"].bytes()) {}
  struct {
    ros::Time stamp;
  } header;
  std::uint32_t width;
  std::string encoding;
  struct Data {
    explicit Data(const lot::Bytes& b) : bytes(b) {}
    std::size_t size() const { return bytes.size(); }
    std::uint8_t operator[](std::size_t i) const {
      return std::to_integer<std::uint8_t>(bytes.begin()[i]);
    }
    const void* data() const { return bytes.data(); }
    lot::Bytes bytes;
  } data;
};

/// Looks on at a topic of the segment, by a thread of its own: what a tool is.
class Onlooker final : public End {
 public:
  explicit Onlooker(const std::vector<std::string>& words)
      : how_(words.at(1)),
        topic_(words.at(2)),
        wanted_(words.size() > 3 ? std::stoul(words[3]) : 0) {
    lot::EngineOptions process;
    lot::PullerOptions options;
    options.observer = true;
    for (std::size_t i = 4; i < words.size(); ++i) {
      if (words[i].rfind("history=", 0) == 0) options.history = std::stoul(words[i].substr(8));
      if (words[i].rfind("as=", 0) == 0) process.name = words[i].substr(3);
    }
    engine_.emplace(process);
    if (how_ == "typed") {
      typed_.emplace(engine_->subscribe<Shared>(topic_, options));
    } else {
      any_.emplace(engine_->subscribe_any(topic_, options));
      type_ = any_->type().name();
    }
    thread_ = std::thread([this] { run(); });
  }
  ~Onlooker() override {
    ends_ = true;
    thread_.join();
  }
  bool done() const override { return wanted_ != 0 && seen_ >= wanted_; }
  Json json() const override {
    const std::lock_guard guard(mutex_);
    return {{"end", "look"}, {"how", how_},          {"topic", topic_},
            {"type", type_}, {"seen", seen_.load()}, {"missed", missed_},
            {"last", last_}, {"error", error_},      {"from", account_.json()}};
  }

 private:
  void run() {
    try {
      while (!ends_) typed_ ? borrow_from(*typed_) : borrow_from(*any_);
    } catch (const std::exception& e) {
      const std::lock_guard guard(mutex_);
      error_ = e.what();
    }
    typed_.reset();
    any_.reset();
  }
  void borrow_from(lot::ShmPuller<Shared>& puller) {
    const auto image = puller.borrow(kPatience);
    if (!image) return;
    account_.note(*image, "");
    note(image.missed(), {});
  }
  void borrow_from(lot::AnyPuller& puller) {
    const auto message = puller.borrow(kPatience);
    if (!message) return;
    if (type_ == "sensor_msgs/Image") account_.note(Described(message.root()), "");
    note(message.missed(), lot::to_string(message.root()));
  }
  void note(std::uint64_t missed, std::string text) {
    const std::lock_guard guard(mutex_);
    last_ = std::move(text);
    missed_ += missed;
    ++seen_;
  }

  static constexpr std::chrono::milliseconds kPatience{20};
  const std::string how_, topic_;
  const std::size_t wanted_;
  std::optional<lot::ShmEngine> engine_;
  std::optional<lot::ShmPuller<Shared>> typed_;
  std::optional<lot::AnyPuller> any_;
  std::string type_;
  Account account_;
  mutable std::mutex mutex_;
  std::string last_;  ///< message, as text
  std::string error_;
  std::uint64_t missed_ = 0;
  std::atomic<std::size_t> seen_{0};
  std::atomic<bool> ends_{false};
  std::thread thread_;
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
    std::uint32_t queue = kQueue;
    for (std::size_t i = 6; i < words.size(); ++i) {
      if (words[i] == "latch") latch = true;
      if (words[i] == "keep") keep_ = true;
      if (words[i] == "greet") greets_ = true;
      if (words[i].rfind("wait=", 0) == 0) wait_ = std::stoul(words[i].substr(5));
      if (words[i].rfind("queue=", 0) == 0) queue = queue_of(words[i]);
    }
    if (how_ == "plain") {
      plain_ = static_cast<ros::NodeHandle&>(node).advertise<Plain>(topic_, queue, latch);
    } else if (how_ == "other") {
      other_ = node.advertise<Changed>(topic_, queue, latch);
    } else if (greets_) {
      lot_ = node.advertise<Shared>(
          topic_, queue, [this](const ros::SingleSubscriberPublisher& to) { greet(to); },
          [this](const ros::SingleSubscriberPublisher&) { ++left_; }, ros::VoidConstPtr(), latch);
    } else {
      lot_ = node.advertise<Shared>(topic_, queue, latch);
    }
    thread_ = std::thread([this] { run(); });
  }
  ~Publication() override { thread_.join(); }
  bool done() const override { return sent_ == count_ && !keep_; }
  Json json() const override {
    const std::lock_guard guard(mutex_);
    return {{"end", "pub"},
            {"how", how_},
            {"topic", topic_},
            {"sent", sent_.load()},
            {"subscribers", subscribers()},
            {"serialised", lot_.serialised()},
            {"last_serialised", last_serialised_.load()},
            {"left", left_.load()},
            {"places", places_}};
  }

 private:
  std::size_t subscribers() const {
    return plain_.getNumSubscribers() + lot_.getNumSubscribers() + other_.getNumSubscribers();
  }
  void greet(const ros::SingleSubscriberPublisher& to) const {
    Plain greeting;
    fill(greeting, 0, bytes_);
    greeting.encoding += "/greeting";
    to.publish(greeting);
  }
  void note_place(const void* payload) {
    const std::lock_guard guard(mutex_);
    if (places_.size() < kMostPlaces) places_.push_back(segment.place(payload));
  }
  void run() {
    while (ros::ok() && subscribers() < wait_) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    std::uint64_t serialised = 0;
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
      } else if (how_ == "other") {
        auto message = other_.loan();
        message->data = n;
        other_.publish(std::move(message));
      } else {
        auto message = lot_.loan();
        fill(*message, n, bytes_);
        note_place(message->data.data());
        lot_.publish(std::move(message));
      }
      ++sent_;
      if (lot_.serialised() != serialised) {
        serialised = lot_.serialised();
        last_serialised_ = sent_.load();
      }
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
  bool greets_ = false;
  std::atomic<std::size_t> left_{0};  ///< subscribers
  std::atomic<std::size_t> sent_{0};
  std::atomic<std::size_t> last_serialised_{0};  ///< so many had been sent then
  ros::Publisher plain_;
  lot::ros::Publisher<Shared> lot_;
  lot::ros::Publisher<Changed> other_;
  mutable std::mutex mutex_;
  std::vector<std::int64_t> places_;
  std::thread thread_;
};

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "node");
  double most_s = 60;
  std::string spins = "async";
  lot::ros::NodeHandle node;
  lot::ros::NodeHandle own("~");
  std::vector<std::unique_ptr<End>> ends;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--for") {
      most_s = std::stod(argv[++i]);
      continue;
    }
    if (word == "--spin") {
      spins = argv[++i];
      continue;
    }
    auto words = split(word);
    const bool is_private = words.at(2)[0] == '~';
    if (is_private) words[2].erase(0, 1);
    lot::ros::NodeHandle& handle = is_private ? own : node;
    if (words[0] == "pub") {
      ends.push_back(std::make_unique<Publication>(words, handle));
    } else if (words[0] == "look") {
      ends.push_back(std::make_unique<Onlooker>(words));
    } else {
      ends.push_back(std::make_unique<Subscription>(words, handle));
    }
  }
  std::puts("ready");
  std::fflush(stdout);
  std::optional<ros::AsyncSpinner> spinner;
  std::thread spinning;
  if (spins == "async") {
    spinner.emplace(1);
    spinner->start();
  } else {
    spinning = std::thread([&spins] {
      if (spins == "multi") {
        ros::MultiThreadedSpinner(2).spin();
      } else {
        ros::spin();
      }
    });
  }
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
  if (spinning.joinable()) spinning.join();
}
