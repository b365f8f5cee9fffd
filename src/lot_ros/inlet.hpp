// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <typeinfo>
#include <utility>
#include <vector>

#include <ros/message_event.h>
#include <ros/subscriber.h>
#include <ros/subscriber_link.h>
#include <ros/subscription_callback_helper.h>
#include <ros/subscription_queue.h>

#include "lot/detail/mutex.hpp"
#include "lot/detail/selection.hpp"
#include "lot/ros/core.hpp"

#include "lot_ros/session.hpp"

namespace lot::ros {

/// One topic that this process reads (docs/ros.md), for all of the user's subscribers of it, its
/// *users*. Messages come on three ways:
/// - by the rings of publishers of other processes, which LOT's thread reads;
/// - by links: the inlet has one ordinary ROS subscription, and each link carries *frames*;
/// - by hand, from outlets of this process, which call take().
///
/// A publisher writes into the reader's cell of its ring which messages are for this inlet. LOT's
/// thread delivers those, keeps messages about which the publisher has said nothing yet, and drops
/// all others. A frame waits while the ring of its publisher has older messages for this inlet. So
/// a user gets no message both by the ring and by a link, and gets the messages of each publisher
/// in order.
///
/// Threads: all members may be called at once. LOT's thread reads the rings, and delivers what
///          rings and links bring. The publishing threads of this process deliver what they hand
///          over. Intake's thread deserialises the frames of links.
/// Crash:   of a publisher: LOT's thread reads its ring to the end, then forgets it.
class Inlet final : public std::enable_shared_from_this<Inlet> {
 public:
  Inlet(std::shared_ptr<Session> session, const ::ros::SubscribeOptions& options,
        const detail::Kind& kind);
  /// Joins the rings, then subscribes at ROS. Called once, when the first user has been added.
  /// `asked` has the topic's name as that user has said it to `node`. False: ROS refuses it.
  bool open(::ros::NodeHandle& node, const ::ros::SubscribeOptions& asked);
  /// Unsubscribes, when the inlet has no user any more. A call that a roscpp thread still makes
  /// does nothing then.
  /// Returns the session that it had: so the caller destroys the last session where nothing waits
  /// for this.
  std::shared_ptr<Session> close();

  /// How many threads add a callback to the queue of a user just now. The inlet's mutex guards it.
  struct Adding {
    unsigned threads = 0;
    bool is_removed = false;
  };
  using Queue = boost::shared_ptr<::ros::SubscriptionQueue>;
  /// What a callback queue knows a user by.
  static std::uint64_t id_of(const Queue& queue) noexcept {
    return reinterpret_cast<std::uint64_t>(queue.get());
  }
  struct User {
    ::ros::SubscriptionCallbackHelperPtr helper;
    ::ros::CallbackQueueInterface* callbacks;
    Queue queue;
    bool has_tracked_object;
    ::ros::VoidConstWPtr tracked_object;
    std::uint32_t queue_size;  ///< 0: any number
    std::shared_ptr<Adding> adding = std::make_shared<Adding>();

    std::uint64_t id() const noexcept { return id_of(queue); }
    /// When it returns, none of the user's callbacks begins any more, and none is at work, but one
    /// in this thread.
    void dismiss();
  };
  /// Callbacks to add for messages that are in users' queues already. The destructor adds them. No
  /// lock may be held then, since a queue of the application's may call at once. If this thread has
  /// the turn (Loop), LOT's thread adds them when it has done what it does now.
  class Calls {
   public:
    Calls() = default;
    ~Calls();
    Calls(const Calls&) = delete;
    Calls& operator=(const Calls&) = delete;
    void add(Inlet& inlet, const User& user);  // REQUIRES the inlet's mutex

   private:
    struct Call {
      std::shared_ptr<Inlet> inlet;
      ::ros::CallbackQueueInterface* callbacks;
      Queue queue;
      std::shared_ptr<Adding> adding;
      void make() const noexcept;
    };
    std::vector<Call> calls_;
  };
  /// Adds a user, and gives it what is latched. Returns its number here.
  std::uint64_t add(const ::ros::SubscribeOptions& options, Calls& calls);
  /// Takes a user out. The caller dismisses and destroys it where it holds no lock. When this
  /// returns, no thread but this one adds a callback to its queue any more.
  User remove(std::uint64_t user);
  bool has_users();

  /// LOT's thread reads so many messages before other topics have their turn, and before it calls
  /// callbacks, if it is the thread that calls them: so it does not fill a user's queue before.
  static constexpr std::uint32_t kAtOnce = 64;

  const detail::Kind& kind() const noexcept { return kind_; }

  /// A message that an outlet of this process has handed over.
  struct Taken {
    boost::shared_ptr<void const> message;
    boost::shared_ptr<::ros::M_string> header;
    /// Lives while the message is latched: until it dies, subscribers that come later get the
    /// message, too. Null: the message is not latched.
    boost::shared_ptr<::ros::M_string> latched_by;
    std::uint64_t behind = 0;  ///< the number of the marker that must pass first
  };
  /// Keeps a message for deliver_taken(), behind those that wait. So many may wait: `depth`, or as
  /// many as a user's queue takes. Returns the message that it drops for that; the caller destroys
  /// it where it holds no lock.
  Taken take(Taken taken, std::size_t depth);
  /// Puts the waiting messages into the users' queues: on this thread, or on LOT's thread if that
  /// one calls the callbacks. REQUIRES: this thread holds no lock of a topic.
  void deliver_taken();
  /// From now on the inlet delivers a message that it takes behind what links have brought so far.
  void follow_links();

  /// The subscribers on a link inside this process.
  struct Subscribers {
    std::shared_ptr<Inlet> inlet;  ///< of LOT's own, which take() messages; null: there are none
    bool plain = false;            ///< there are plain ones, of the standard type
    bool others = false;           ///< there are some of another type, as ShapeShifter
  };
  static Subscribers on(::ros::SubscriberLink& link, const std::type_info& standard);
  /// Sends bytes to all subscribers on the link but those of `inlet`, which may be null. roscpp
  /// keeps the bytes for subscribers that come later.
  static void send_past(const Inlet* inlet, ::ros::SubscriberLink& link,
                        ::ros::SerializedMessage bytes);
  /// While it lives, LOT's own subscribers say to this thread that they are of `type`.
  class Disguise {
   public:
    explicit Disguise(const std::type_info& type) noexcept;
    ~Disguise();
    Disguise(const Disguise&) = delete;
    Disguise& operator=(const Disguise&) = delete;

   private:
    // A queue that calls at once may publish another message meanwhile.
    const std::type_info* type_before_;
    const void* past_before_;
  };

  std::uint32_t publishers() const { return subscriber_.getNumPublishers(); }
  /// Whether the node that sent messages latches. Nothing: the node has yet to say so.
  std::optional<bool> latches(const std::string& publisher) const;

 private:
  class Helper;
  using Header = boost::shared_ptr<::ros::M_string>;  ///< the header of a connection
  struct Frame {
    boost::shared_ptr<void const> message;  ///< null: an invitation with the number below
    Header header;
    std::string publisher;  ///< the publisher's node, named as its participant would be
    std::uint8_t invitation = 0;
    bool is_marker = false;  ///< no frame: all frames before it have been handled
  };
  struct Pulled {
    boost::shared_ptr<void const> message;
    lot::detail::Origin origin;
  };

  /// The last message of a publisher.
  struct Last {
    boost::shared_ptr<void const> message;
    Header header;
    boost::weak_ptr<::ros::M_string> alive;
    bool is_known = false;              ///< the link that it belongs to is known
    std::vector<std::uint64_t> late{};  ///< users that came before the link was known
  };

  /// {channel, generation}.
  using RingName = std::pair<std::uint32_t, std::uint32_t>;

  // Called by LOT's thread only.
  void read();
  void deliver_claimed();
  bool has_claimed() const;
  void claim(Pulled pulled);
  bool deliver_if_ours(const Pulled& pulled);
  bool may_be_ours_yet(const Pulled& pulled) const;
  void heard(const std::string& publisher, const Header& header, bool is_shared);
  void forget_those_gone();
  void forget_later();
  void arrived(Frame frame);
  void handle(const Frame& frame);
  void deliver_held();
  void deliver_in_turn();
  void deliver_soon();
  bool deliver_next();
  void expect_marker();
  void send_marker();
  void deliver(const boost::shared_ptr<void const>& message, const std::string& publisher,
               const Header& header);
  Header header_of(const std::string& publisher) const;
  // REQUIRES mutex_.
  void remember(const std::string& publisher, Last& last);
  void count_at_once();
  void give(const User& user, const boost::shared_ptr<void const>& message, const Header& header,
            Calls& calls);

  const std::shared_ptr<Loop> loop_;
  const std::string topic_;
  const std::string own_name_;  ///< of this process, as its participant is called
  const detail::Kind& kind_;
  ::ros::Subscriber subscriber_;
  std::shared_ptr<Session> session_;                     ///< null: closed
  std::unique_ptr<lot::detail::SelectingPuller> rings_;  ///< null: LOT is off
  std::uint64_t turn_ = ~std::uint64_t{0};  ///< the loop's round in which may_deliver_ was set
  std::uint32_t may_deliver_ = 0;           ///< messages that it may still deliver in this round
  bool reads_again_ = false;                ///< read() is due in the next round; LOT's thread's own
  /// The *unclaimed* messages of each ring: the last ones of which the publisher has not said yet
  /// whether they are for this inlet.
  struct Unclaimed {
    std::deque<Pulled> messages;
    Loop::Clock::time_point since;
  };
  std::map<RingName, Unclaimed> unclaimed_;
  std::deque<Frame> held_;  ///< frames that wait until the ring has been read
  /// What the links of a publisher say of it.
  struct Link {
    Header header;  ///< a copy: roscpp's own goes with the link
    boost::weak_ptr<::ros::M_string> alive;
    std::size_t had = 0;  ///< how many of the link's next frames a ring has brought already
    Loop::Clock::time_point since{};
    /// Set once the link has carried messages for so long that its publisher has decided: the rings
    /// that the publisher had then. They bring nothing more for this inlet, unless the publisher
    /// invites it.
    std::optional<std::vector<RingName>> idle_rings{};
  };
  std::map<std::string, Link> links_;

  mutable lot::detail::Mutex mutex_{lot::detail::Rank::Inlet};
  std::map<std::uint64_t, User> users_;
  // A thread with mutex_ writes these three; others read them without it.
  std::atomic<std::uint32_t> at_once_{kAtOnce};
  std::atomic<bool> calls_at_once_{false};    ///< LOT's thread calls the callback of a user
  std::atomic<std::size_t> most_waiting_{0};  ///< places of the largest queue of a user
  lot::detail::Condition added_;              ///< a thread has added a callback
  /// The last message of each publisher that latches, or of which that is not known yet.
  std::map<std::string, Last> latched_;
  bool forgetting_ = false;  ///< LOT's thread is due to look for publishers that have gone
  std::uint64_t last_user_ = 0;

  lot::detail::Mutex taken_mutex_{
      lot::detail::Rank::Taken};  ///< a leaf: no other lock is taken under it
  std::deque<Taken> taken_;
  std::uint64_t markers_ = 0;  ///< so far; a message waits until those before it have passed
  std::uint64_t markers_passed_ = 0;
  bool is_closed_ = false;
};

}  // namespace lot::ros
