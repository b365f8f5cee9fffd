// SPDX-License-Identifier: Apache-2.0
#include "ros_ends.hpp"

#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <map>
#include <memory>
#include <mutex>
#include <shared_mutex>
#include <stdexcept>
#include <utility>
#include <vector>

#include <boost/make_shared.hpp>
#include <ros/callback_queue.h>
#include <ros/poll_manager.h>
#include <ros/ros.h>
#include <sensor_msgs/Image.h>

#include "lot/ros.hpp"

namespace ab::ros_ends {
namespace {

using namespace std::chrono_literals;
using Plain = sensor_msgs::Image;
using Shared = lot::ros::Message<sensor_msgs::Image_>;

constexpr auto kSpinTime = 50us;  ///< of adaptive waiting: a little more than a wake-up costs

bool is_lot(const Terms& terms) {
  return terms.way == Way::Lot || terms.way == Way::LotImmediate || terms.way == Way::LotMutex;
}

/// How LOT's thread waits: as the subscriber, if it is the subscriber; else that one spins by
/// itself, and two would not fit on two cores with a publisher.
const char* lots_waiting(const Terms& terms) {
  if (terms.way != Way::LotImmediate || terms.waiting == Waiting::Park) return "park";
  return terms.waiting == Waiting::Spin ? "spin" : "adaptive";
}

/// ROS in this process, as long as it has ends. roscpp begins once, and does not begin again.
class Node {
 public:
  static std::shared_ptr<Node> of(const Terms& terms) {
    static std::mutex mutex;
    static std::weak_ptr<Node> known;
    const std::lock_guard lock(mutex);
    auto node = known.lock();
    if (!node) known = node = std::shared_ptr<Node>(new Node(terms));
    return node;
  }
  ~Node() {
    if (over_udp_) ros::PollManager::instance()->shutdown();
    ended_.clear();
    handle_.reset();
    ros::shutdown();
  }
  lot::ros::NodeHandle& handle() { return *handle_; }
  /// Held while an end is opened, and while a publisher ends: two threads that publish and
  /// subscribe at once may be connected twice by roscpp.
  std::mutex& opening() { return opening_; }
  /// Shared by who publishes within this process, alone for a subscriber that ends: roscpp's link
  /// between the two takes the subscriber away from under a publish() that is at work.
  std::shared_mutex& intra() { return intra_; }
  /// An end over UDPROS; a subscriber behind the queue of its callbacks, which it needs as long as
  /// it lives, though none is called any more. It goes with the node, when the thread that reads
  /// sockets has ended: a datagram that comes for a link while that one goes would abort the
  /// process (boost::lock_error, or an empty boost::function, in ros::PollSet::update()). A
  /// publisher's sockets are polled as well.
  template <class End>
  void end_later(End end) {
    const std::lock_guard lock(opening_);
    ended_.push_back(std::make_shared<End>(std::move(end)));
  }
  /// Of a topic, in this process: roscpp has one link for all of them.
  std::atomic<unsigned>& subscribers(const std::string& topic) {
    const std::lock_guard lock(opening_);
    return subscribers_[topic];
  }

 private:
  explicit Node(const Terms& terms) : over_udp_(terms.way == Way::Udp) {
    if (ros::isInitialized()) throw std::runtime_error("ROS has ended in this process");
    setenv("ROS_HOME", terms.directory.c_str(), 1);
    setenv("ROS_IP", terms.address.c_str(), 1);
    setenv("LOT_DIR", terms.directory.c_str(), 1);
    const ros::M_string settings{
        {"__master", terms.master},
        {"_lot/segment", terms.segment},
        {"_lot/size", std::to_string((terms.segment_bytes >> 20) + 1) + "M"},
        {"_lot/queue", terms.way == Way::LotMutex ? "mutex" : "ring"},
        {"_lot/wait", lots_waiting(terms)},
        {"_lot/enable", is_lot(terms) ? "true" : "false"},
    };
    ros::init(settings, terms.node,
              ros::init_options::NoSigintHandler | ros::init_options::NoRosout);
    handle_ = std::make_unique<lot::ros::NodeHandle>();
  }

  std::mutex opening_;
  std::shared_mutex intra_;
  std::map<std::string, std::atomic<unsigned>> subscribers_;
  const bool over_udp_;
  std::vector<std::shared_ptr<void>> ended_;
  std::unique_ptr<lot::ros::NodeHandle> handle_;
};

class PlainPublisher final : public Publisher {
 public:
  explicit PlainPublisher(const Terms& terms) : terms_(terms), node_(Node::of(terms)) {
    const std::lock_guard lock(node_->opening());
    publisher_ = node_->handle().advertise<Plain>(terms.topic, terms.depth);
    for (unsigned i = 0; i < terms.pool; ++i) pool_.push_back(make());
  }
  ~PlainPublisher() override {
    if (terms_.way == Way::Udp) {
      node_->end_later(std::move(publisher_));
      return;
    }
    // Two that end at once free one topic twice in roscpp (TopicManager::unadvertise() finds its
    // place in a list under a lock, and uses it under the next one).
    const std::lock_guard lock(node_->opening());
    publisher_.shutdown();
  }
  unsigned subscribers() const override {
    const unsigned links = publisher_.getNumSubscribers();
    return terms_.way == Way::Intra && links != 0 ? node_->subscribers(terms_.topic).load() : links;
  }
  std::byte* loan() override {
    if (!message_) message_ = next();
    return reinterpret_cast<std::byte*>(message_->data.data());
  }
  void publish() override {
    const auto message = std::move(message_);
    if (terms_.way == Way::Pace) return;
    std::shared_lock<std::shared_mutex> intra;
    if (terms_.way == Way::Intra) intra = std::shared_lock(node_->intra());
    publisher_.publish(message);
    ++published_;
  }
  std::uint64_t serialised() const override { return terms_.way == Way::Intra ? 0 : published_; }

 private:
  boost::shared_ptr<Plain> make() const {
    auto message = boost::make_shared<Plain>();
    message->data.resize(terms_.size);
    return message;
  }
  /// One of the pool that nobody else has; a new one where there is no pool, or it is all in use.
  boost::shared_ptr<Plain> next() {
    for (std::size_t i = 0; i < pool_.size(); ++i) {
      const auto& message = pool_[turn_++ % pool_.size()];
      if (message.use_count() != 1) continue;
      std::atomic_thread_fence(std::memory_order_acquire);  // readers have done
      return message;
    }
    return make();
  }

  const Terms terms_;
  const std::shared_ptr<Node> node_;
  ros::Publisher publisher_;
  std::vector<boost::shared_ptr<Plain>> pool_;
  std::size_t turn_ = 0;
  boost::shared_ptr<Plain> message_;
  std::uint64_t published_ = 0;
};

class LotPublisher final : public Publisher {
 public:
  explicit LotPublisher(const Terms& terms)
      : size_(terms.size),
        node_(Node::of(terms)),
        publisher_(node_->handle().advertise<Shared>(terms.topic, terms.depth)) {
    publisher_.reserve(terms.prepared, terms.size);
  }
  unsigned subscribers() const override { return publisher_.getNumSubscribers(); }
  std::byte* loan() override {
    if (!message_) {
      message_ = publisher_.loan();
      message_->data.resize(size_);
    }
    return reinterpret_cast<std::byte*>(message_->data.data());
  }
  void publish() override { publisher_.publish(std::move(message_)); }
  std::uint64_t serialised() const override { return publisher_.serialised(); }

 private:
  const std::size_t size_;
  const std::shared_ptr<Node> node_;
  lot::ros::Publisher<Shared> publisher_;
  lot::ros::Loan<Shared> message_;
};

/// Callbacks are called as ros::spin() calls them, by the node's own thread, from a queue of this
/// end's.
template <class Message>
class TopicSubscriber final : public Subscriber {
 public:
  explicit TopicSubscriber(const Terms& terms)
      : terms_(terms), node_(Node::of(terms)), count_(node_->subscribers(terms.topic)) {
    lot::ros::NodeHandle handle(node_->handle());
    handle.setCallbackQueue(queue_.get());
    ros::TransportHints hints;
    const std::lock_guard lock(node_->opening());
    if (terms.way == Way::Udp) hints.unreliable();
    if (terms.way == Way::TcpNoDelay) hints.tcpNoDelay();
    subscriber_ = handle.subscribe<Message>(
        terms.topic, terms.depth,
        boost::function<void(const boost::shared_ptr<Message const>&)>(
            [this](const boost::shared_ptr<Message const>& message) {
              (*handler_)(reinterpret_cast<const std::byte*>(message->data.data()),
                          message->data.size());
            }),
        hints);
    ++count_;
  }
  ~TopicSubscriber() override {
    --count_;
    if constexpr (std::is_same_v<Message, Plain>) {
      if (terms_.way == Way::Udp) {
        node_->end_later(std::make_pair(std::move(queue_), ros::Subscriber(subscriber_)));
        return;
      }
    }
    const std::lock_guard guard(node_->intra());
    subscriber_.shutdown();
  }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    handler_ = &handler;
    const auto begin = std::chrono::steady_clock::now();
    if (terms_.waiting != Waiting::Park) {
      for (;;) {
        if (call_one(0ns)) return true;
        const auto waited = std::chrono::steady_clock::now() - begin;
        if (patience >= 0ns && waited >= patience) return false;
        if (terms_.waiting == Waiting::Adaptive && waited >= kSpinTime) break;
      }
    }
    for (;;) {
      const auto waited = std::chrono::steady_clock::now() - begin;
      if (patience >= 0ns && waited >= patience) return call_one(0ns);
      if (call_one(patience < 0ns ? 1s : patience - waited)) return true;
    }
  }

 private:
  bool call_one(std::chrono::nanoseconds patience) {
    return queue_->callOne(ros::WallDuration().fromNSec(patience.count())) ==
           ros::CallbackQueue::Called;
  }

  const Terms terms_;
  const std::shared_ptr<Node> node_;
  std::atomic<unsigned>& count_;
  std::shared_ptr<ros::CallbackQueue> queue_ = std::make_shared<ros::CallbackQueue>();
  const Handler* handler_ = nullptr;
  std::conditional_t<std::is_same_v<Message, Shared>, lot::ros::Subscriber, ros::Subscriber>
      subscriber_;
};

/// Callbacks are called on LOT's thread. Nobody need be woken for that, unless who receives has to
/// do something about each message.
class ImmediateSubscriber final : public Subscriber {
 public:
  explicit ImmediateSubscriber(const Terms& terms) : terms_(terms), node_(Node::of(terms)) {
    lot::ros::NodeHandle handle(node_->handle());
    handle.setCallbackQueue(lot::ros::immediate_queue());
    const std::lock_guard guard(node_->opening());
    subscriber_ = handle.subscribe<Shared>(
        terms.topic, terms.depth,
        [this](const boost::shared_ptr<Shared const>& message) { hear(*message); });
  }
  ~ImmediateSubscriber() override {
    {
      const std::lock_guard guard(mutex_);
      over_ = true;
    }
    listening_.notify_all();
    subscriber_.shutdown();
  }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    std::unique_lock lock(mutex_);
    const std::uint64_t before = heard_;
    handler_ = &handler;
    listening_.notify_one();
    wakes_ = terms_.one_by_one || patience < 0ns;
    const auto has_come = [&] { return wakes_ && heard_ != before; };
    if (patience < 0ns) {
      come_.wait(lock, has_come);
    } else {
      come_.wait_for(lock, patience, has_come);
    }
    handler_ = nullptr;
    return heard_ != before;
  }

 private:
  void hear(const Shared& message) {
    std::unique_lock lock(mutex_);
    listening_.wait(lock, [this] { return handler_ != nullptr || over_; });
    if (over_) return;
    (*handler_)(reinterpret_cast<const std::byte*>(message.data.data()), message.data.size());
    ++heard_;
    if (!wakes_) return;
    handler_ = nullptr;  // until it is asked for the next one
    come_.notify_one();
  }

  const Terms terms_;
  const std::shared_ptr<Node> node_;
  std::mutex mutex_;
  std::condition_variable listening_, come_;
  const Handler* handler_ = nullptr;
  bool wakes_ = true;  ///< whoever receives, for each message
  std::uint64_t heard_ = 0;
  bool over_ = false;
  lot::ros::Subscriber subscriber_;
};

}  // namespace

std::unique_ptr<Publisher> advertise(const Terms& terms) {
  if (is_lot(terms)) {
    return std::make_unique<LotPublisher>(terms);
  }
  return std::make_unique<PlainPublisher>(terms);
}

std::unique_ptr<Subscriber> subscribe(const Terms& terms) {
  if (terms.way == Way::LotImmediate) return std::make_unique<ImmediateSubscriber>(terms);
  if (is_lot(terms)) return std::make_unique<TopicSubscriber<Shared>>(terms);
  return std::make_unique<TopicSubscriber<Plain>>(terms);
}

}  // namespace ab::ros_ends
