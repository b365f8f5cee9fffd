// SPDX-License-Identifier: Apache-2.0
/// The user's ends of topics, which lot::ros::Publisher and Subscriber hold.
#include <exception>
#include <map>
#include <mutex>
#include <set>
#include <utility>

#include <ros/callback_queue.h>
#include <ros/console.h>
#include <ros/node_handle.h>
#include <ros/single_subscriber_publisher.h>

#include "lot/detail/mutex.hpp"

#include "lot_ros/inlet.hpp"
#include "lot_ros/outlet.hpp"

namespace lot::ros::detail {
namespace {

/// The outlet and the inlet of each topic in this process. Never destroyed, since static
/// destructors use it.
struct Topics {
  lot::detail::Mutex opening{lot::detail::Rank::Opening};  ///< a thread holds it while it opens
                                                           ///< one, which may ask the master
  std::map<std::string, std::weak_ptr<TopicOutlet>> outlets;
  std::map<std::string, std::weak_ptr<Inlet>> inlets;
  /// Topics whose inlet is still closing: no thread subscribes to them meanwhile.
  std::set<std::string> closing;
  lot::detail::Condition closed;
  static Topics& all() {
    static auto* const topics = new Topics;
    return *topics;
  }
};

/// roscpp's unadvertise of a topic's last end looks for its place and erases it later. So no other
/// thread may advertise or unadvertise meanwhile. No user code runs under this mutex.
lot::detail::Mutex& advertising() {
  static auto* const mutex = new lot::detail::Mutex(lot::detail::Rank::Advertising);
  return *mutex;
}

/// Takes a topic out of the map if the map has this end for it; else false.
template <class Map, class End>
bool erase(Map& map, const std::string& topic, const std::shared_ptr<End>& end) {
  const auto at = map.find(topic);
  if (at == map.end() || at->second.lock() != end) return false;
  map.erase(at);
  return true;
}

class TopicAdvertisement final : public Advertisement {
 public:
  TopicAdvertisement(std::shared_ptr<TopicOutlet> outlet, std::uint64_t id, ::ros::Publisher plain)
      : id_(id), outlet_(std::move(outlet)), plain_(std::move(plain)) {}
  ~TopicAdvertisement() override { shutdown(); }

  std::uint64_t id() const override { return id_; }
  std::shared_ptr<Outlet> outlet() const override {
    const std::lock_guard guard(mutex_);
    return outlet_;
  }
  ::ros::Publisher plain() const override {
    const std::lock_guard guard(mutex_);
    return plain_;
  }
  void shutdown() override {
    std::shared_ptr<TopicOutlet> outlet;
    ::ros::Publisher plain;
    {
      const std::lock_guard guard(mutex_);
      outlet.swap(outlet_);
      std::swap(plain, plain_);
    }
    if (!outlet) return;
    plain.shutdown();  // the outlet keeps the topic advertised: only callbacks go here
    bool is_last = false;
    {
      const std::lock_guard guard(Topics::all().opening);
      is_last = outlet->remove(id_);
      if (is_last) erase(Topics::all().outlets, outlet->topic(), outlet);
    }
    if (!is_last) return;
    {
      const std::lock_guard guard(advertising());
      outlet->withdraw();
    }
    outlet->close();
  }

 private:
  const std::uint64_t id_;
  mutable lot::detail::Mutex mutex_{lot::detail::Rank::End};
  std::shared_ptr<TopicOutlet> outlet_;
  ::ros::Publisher plain_;
};

/// Closes an inlet without the lock: LOT's thread may be giving messages to a user's queue just
/// now, and that queue may want the lock.
void close(Inlet& inlet, const std::string& topic, std::unique_lock<lot::detail::Mutex>& opening) {
  Topics::all().closing.insert(topic);
  opening.unlock();
  std::shared_ptr<Session> session;  // destroyed last
  const struct Closed {              // its end comes also when close() throws
    const std::string& topic;
    ~Closed() {
      const std::lock_guard guard(Topics::all().opening);
      Topics::all().closing.erase(topic);
      Topics::all().closed.notify_all();
    }
  } closed{topic};
  session = inlet.close();
}

class TopicSubscription final : public Subscription {
 public:
  TopicSubscription(std::shared_ptr<Inlet> inlet, std::string topic, std::uint64_t user)
      : topic_(std::move(topic)), user_(user), inlet_(std::move(inlet)) {}
  ~TopicSubscription() override { shutdown(); }

  std::uint32_t publishers() const override {
    const std::lock_guard guard(mutex_);
    return inlet_ ? inlet_->publishers() : 0;
  }
  std::optional<bool> latches(const std::string& publisher) const override {
    const std::lock_guard guard(mutex_);
    return inlet_ ? inlet_->latches(publisher) : false;
  }
  std::string topic() const override { return topic_; }
  void shutdown() override {
    std::shared_ptr<Inlet> inlet;
    {
      const std::lock_guard guard(mutex_);
      inlet.swap(inlet_);
    }
    if (!inlet) return;
    inlet->remove(user_).dismiss();  // no lock is held while its callback's objects go
    std::unique_lock lock(Topics::all().opening);
    if (inlet->has_users() || !erase(Topics::all().inlets, topic_, inlet)) return;
    close(*inlet, topic_, lock);
  }

 private:
  const std::string topic_;
  const std::uint64_t user_;
  mutable lot::detail::Mutex mutex_{lot::detail::Rank::End};
  std::shared_ptr<Inlet> inlet_;
};

bool is_same(const Kind& a, const Kind& b) { return *a.type == *b.type; }

}  // namespace

std::shared_ptr<Advertisement> advertise(::ros::NodeHandle& node,
                                         const ::ros::AdvertiseOptions& asked, const Kind& kind) {
  ::ros::AdvertiseOptions resolved = asked;
  resolved.topic = node.resolveName(asked.topic);
  std::shared_ptr<TopicOutlet> outlet;
  std::uint64_t end = 0;
  {
    std::unique_lock lock(Topics::all().opening);
    outlet = Topics::all().outlets[resolved.topic].lock();
    if (outlet && !is_same(outlet->kind(), kind)) {
      ROS_ERROR(
          "Tried to advertise on topic [%s] with type [%s], but the topic is already advertised as "
          "[%s]",
          resolved.topic.c_str(), kind.datatype, outlet->kind().datatype);
      return nullptr;
    }
    const bool is_new = outlet == nullptr;
    if (is_new) {
      ::ros::AdvertiseOptions bare = resolved;
      bare.connect_cb = {};
      bare.disconnect_cb = {};
      outlet = std::make_shared<TopicOutlet>(Session::get(), bare, kind);
    }
    end = outlet->add(asked.latch, bool(asked.connect_cb));
    if (is_new) {
      bool opened = false;
      {
        const std::lock_guard one(advertising());
        opened = outlet->open();
      }
      if (!opened) {
        lock.unlock();  // it may be the last of the session, which waits for LOT's thread
        outlet->close();
        return nullptr;
      }
      Topics::all().outlets[resolved.topic] = outlet;
    }
  }
  // roscpp's publisher for the user's callbacks. It latches by name only: the outlet sends what is
  // latched. By the name that the user has said, since roscpp remaps it once.
  ::ros::AdvertiseOptions own = asked;
  if (asked.connect_cb) {
    own.connect_cb = [weak = std::weak_ptr(outlet), end,
                      connect = asked.connect_cb](const ::ros::SingleSubscriberPublisher& peer) {
      const struct Greeted {  // its end comes also when connect() throws
        const std::weak_ptr<TopicOutlet>& outlet;
        std::uint64_t end;
        std::string name;
        ~Greeted() {
          const auto self = outlet.lock();
          if (!self) return;
          try {
            self->greeted(end, name);
          } catch (const std::exception& e) {
            ROS_ERROR("LOT: %s stays on TCPROS for %s: %s", self->topic().c_str(), name.c_str(),
                      e.what());
          }
        }
      } greeted{weak, end, peer.getSubscriberName()};
      connect(peer);
    };
  }
  ::ros::Publisher plain;
  try {
    const std::lock_guard one(advertising());
    plain = node.::ros::NodeHandle::advertise(own);
  } catch (...) {
    TopicAdvertisement(outlet, end, plain).shutdown();
    throw;
  }
  return std::make_shared<TopicAdvertisement>(std::move(outlet), end, std::move(plain));
}

std::shared_ptr<Subscription> subscribe(::ros::NodeHandle& node,
                                        const ::ros::SubscribeOptions& given, const Kind& kind) {
  ::ros::SubscribeOptions asked = given;
  ::ros::SubscribeOptions options = given;
  options.topic = node.resolveName(given.topic);
  if (options.callback_queue == nullptr) {
    options.callback_queue = node.getCallbackQueue() != nullptr ? node.getCallbackQueue()
                                                                : ::ros::getGlobalCallbackQueue();
  }
  std::shared_ptr<Inlet> inlet;
  std::uint64_t user = 0;
  Inlet::Calls calls;  // added when the lock has been released
  {
    const auto session = Session::get();
    std::unique_lock lock(Topics::all().opening);
    const auto is_closed = [&options] { return Topics::all().closing.count(options.topic) == 0; };
    if (session->loop()->has_turn() && !is_closed()) {  // called from a queue of the user's own
      throw Error(EDEADLK, options.topic, "its last subscriber is just being shut down",
                  "subscribe in a callback, not while a callback is added to a queue");
    }
    Topics::all().closed.wait(lock, is_closed);
    auto& place = Topics::all().inlets[options.topic];
    inlet = place.lock();
    if (inlet && !is_same(inlet->kind(), kind)) {
      throw ::ros::ConflictingSubscriptionException(
          "Tried to subscribe to a topic with the same name but different type: " + options.topic);
    }
    const bool is_new = inlet == nullptr;
    if (is_new) inlet = std::make_shared<Inlet>(session, options, kind);
    user = inlet->add(options, calls);
    if (is_new) {
      bool opened = false;
      try {
        opened = inlet->open(node, asked);
      } catch (...) {
        close(*inlet, options.topic, lock);
        throw;
      }
      if (!opened) {
        close(*inlet, options.topic, lock);
        return nullptr;
      }
      place = inlet;
    }
  }
  return std::make_shared<TopicSubscription>(std::move(inlet), options.topic, user);
}

std::shared_ptr<lot::detail::PusherCore> maker() {
  auto session = Session::get();
  lot::detail::PusherCore* const place = session->maker();
  if (place == nullptr) return nullptr;
  return {std::move(session), place};
}

}  // namespace lot::ros::detail
