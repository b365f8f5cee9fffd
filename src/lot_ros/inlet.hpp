// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <condition_variable>
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

#include "lot/ros/core.hpp"

#include "lot_ros/session.hpp"

namespace lot::ros {

/// One topic that this process reads: one ordinary ROS subscription for all of the user's
/// subscribers, and the rings of its publishers (docs/ros.md).
///
/// Threads: all members may be called at once. Rings are read, and what they and links bring is
///          delivered, on LOT's thread; what publishers of this process hand over, on theirs.
///          Frames of links are deserialised on Intake's.
/// Crash:   of a publisher: its ring is read to the end, then forgotten.
class Inlet final : public std::enable_shared_from_this<Inlet> {
 public:
  Inlet(std::shared_ptr<Session> session, const ::ros::SubscribeOptions& options,
        const detail::Kind& kind);
  /// Joins the rings, then subscribes at ROS; once, with the first user there already. `asked` has
  /// the topic's name as that one has said it to `node`. False: ROS refuses it.
  bool open(::ros::NodeHandle& node, const ::ros::SubscribeOptions& asked);
  /// Unsubscribes, when it has no user any more. What roscpp's threads still have of this does
  /// nothing then.
  /// Returns what it had, so that the last one goes where nothing waits for this.
  std::shared_ptr<Session> close();

  /// Whether a thread adds a callback to the queue of a user just now. Guarded by the inlet's
  /// mutex.
  struct Adding {
    unsigned threads = 0;
    bool is_removed = false;
  };
  struct User {
    ::ros::SubscriptionCallbackHelperPtr helper;
    ::ros::CallbackQueueInterface* callbacks;
    boost::shared_ptr<::ros::SubscriptionQueue> queue;
    bool has_tracked_object;
    ::ros::VoidConstWPtr tracked_object;
    std::uint32_t queue_size;  ///< 0: any number
    std::shared_ptr<Adding> adding = std::make_shared<Adding>();

    std::uint64_t id() const noexcept { return reinterpret_cast<std::uint64_t>(queue.get()); }
    /// None of its callbacks begins any more, and none is at work but in this thread.
    void dismiss();
  };
  /// Callbacks for messages that are in users' queues already. They are added at its end, where no
  /// lock may be held, for a queue of the application's may call at once; by LOT's thread when it
  /// has done what it does now.
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
      User user;
      void make() const noexcept;
    };
    std::vector<Call> calls_;
  };
  /// A subscriber of the user's; the name that it has here. What is latched it gets at once.
  std::uint64_t add(const ::ros::SubscribeOptions& options, Calls& calls);
  /// Takes it out; to be dismissed, and destroyed, where no lock is held. No thread but this one
  /// adds a callback to its queue any more.
  User remove(std::uint64_t user);
  bool has_users();

  /// So many messages are read before other topics have their turn, and callbacks, if LOT's thread
  /// calls them: no queue of a user's is to be filled before.
  static constexpr std::uint32_t kAtOnce = 64;

  const detail::Kind& kind() const noexcept { return kind_; }

  /// A message that a publisher of this process hands over itself.
  struct Taken {
    boost::shared_ptr<void const> message;
    boost::shared_ptr<::ros::M_string> header;
    /// Who subscribes later gets it, too, as long as this lives; null: it is not latched.
    boost::shared_ptr<::ros::M_string> latched_by;
    std::uint64_t behind = 0;  ///< the gate that is to be passed first
  };
  /// Keeps it for deliver_taken(), behind those that are there: the last of them, `depth` or as
  /// many as a user's queue takes. Returns what that drops; to be destroyed where no lock is held.
  Taken take(Taken taken, std::size_t depth);
  /// Puts those that are there into the users' queues: on this thread, or on LOT's where that calls
  /// callbacks. REQUIRES: no lock of a topic is held.
  void deliver_taken();
  /// What is taken from now on is delivered behind what links have brought so far.
  void follow_links();

  /// Who subscribes on a link inside this process.
  struct Subscribers {
    std::shared_ptr<Inlet> inlet;  ///< LOT's own, which take() messages; null: there are none
    bool plain = false;            ///< of the standard type
    bool others = false;           ///< of another one, as ShapeShifter
  };
  static Subscribers on(::ros::SubscriberLink& link, const std::type_info& standard);
  /// To all subscribers on the link but `inlet`, which may be null; and roscpp keeps it.
  static void send_past(const Inlet* inlet, ::ros::SubscriberLink& link,
                        ::ros::SerializedMessage bytes);
  /// While it lives LOT's own pass for those of another type, on this thread.
  class Disguise {
   public:
    explicit Disguise(const std::type_info& type) noexcept;
    ~Disguise();
    Disguise(const Disguise&) = delete;
    Disguise& operator=(const Disguise&) = delete;
  };

  std::uint32_t publishers() const { return subscriber_.getNumPublishers(); }
  /// Whether a node that messages came from latches; nothing: it has yet to say so.
  std::optional<bool> latches(const std::string& publisher) const;

 private:
  class Helper;
  using Header = boost::shared_ptr<::ros::M_string>;  ///< of a connection
  struct Frame {
    boost::shared_ptr<void const> message;  ///< null: an invitation of this number
    Header header;
    std::string publisher;  ///< as a participant would be called
    std::uint8_t invitation = 0;
    bool is_last_before = false;  ///< no frame: what follow_links() waits for
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
    bool is_known = false;              ///< of which link it is
    std::vector<std::uint64_t> late{};  ///< users that came before that was known
  };

  /// {channel, generation}.
  using RingName = std::pair<std::uint32_t, std::uint32_t>;

  // LOT's thread.
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
  bool deliver_next();
  std::uint64_t close_gate();
  void open_gate_behind_links();
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
  const std::string own_name_;  ///< of this process, as a participant is called
  const detail::Kind& kind_;
  ::ros::Subscriber subscriber_;
  std::shared_ptr<Session> session_;                ///< null: closed
  std::unique_ptr<lot::detail::PullerCore> rings_;  ///< null: LOT is off
  std::uint64_t turn_ = ~std::uint64_t{0};          ///< of the loop's
  std::uint32_t may_deliver_ = 0;                   ///< from rings, in this turn
  bool reads_again_ = false;                        ///< in the next turn; LOT's thread's own
  /// The last messages of each ring whose publisher has not said yet whom they are for.
  struct Unclaimed {
    std::deque<Pulled> messages;
    Loop::Clock::time_point since;
  };
  std::map<RingName, Unclaimed> unclaimed_;
  std::deque<Frame> held_;  ///< frames that came before the ring was read
  /// What links say of publishers, and how many of a link's next frames a ring has brought already.
  struct Link {
    Header header;  ///< a copy, since a link is gone when nobody has its own any more
    boost::weak_ptr<::ros::M_string> alive;
    std::size_t had = 0;
    Loop::Clock::time_point since{};
    /// Once it has carried messages for so long that all is decided: rings that its publisher had
    /// then. They have nothing more for us, unless it invites us.
    std::optional<std::vector<RingName>> idle_rings{};
  };
  std::map<std::string, Link> links_;

  mutable std::mutex mutex_;
  std::map<std::uint64_t, User> users_;
  std::atomic<std::uint32_t> at_once_{kAtOnce};
  std::atomic<bool> calls_at_once_{false};    ///< a user's callback is called by LOT's thread
  std::atomic<std::size_t> most_waiting_{0};  ///< that a user's queue takes
  std::condition_variable added_;             ///< a callback
  /// Of each publisher that latches, or of which that is not known yet.
  std::map<std::string, Last> latched_;
  bool forgetting_ = false;  ///< LOT's thread will look whether they are still there
  std::uint64_t last_user_ = 0;

  std::mutex taken_mutex_;  ///< a leaf
  std::deque<Taken> taken_;
  std::uint64_t gates_closed_ = 0;  ///< messages wait behind them for what links have brought
  std::uint64_t gates_opened_ = 0;
  bool is_closed_ = false;
};

}  // namespace lot::ros
