// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include <boost/make_shared.hpp>
#include <ros/callback_queue_interface.h>
#include <ros/publication.h>
#include <ros/subscriber_link.h>
#include <ros/topic_manager.h>

#include "lot/ros/core.hpp"

#include "lot_ros/inlet.hpp"
#include "lot_ros/session.hpp"

namespace lot::ros {

/// One topic that this process publishes: LOT's ring for those peers that read it, an ordinary ROS
/// link for all others, and LOT's own subscribers of this process get messages from the thread that
/// publishes (docs/ros.md).
///
///     Open ------ it reads our ring ------> Ring ------ it wants its link, no room ------> Link
///      | ^                                                                               ^ |
///      | `------ it could read the ring: it is invited, by the last frame on its link ---|-'
///      `-------- it is no LOT subscriber's, or it has not come to read for too long -----'
///
/// Threads: all members may be called at once. note() is called by roscpp with its locks held.
/// Crash:   of a peer: its link ends, and it is forgotten; its cell in the ring is the reaper's.
class TopicOutlet final : public detail::Outlet, public std::enable_shared_from_this<TopicOutlet> {
 public:
  TopicOutlet(std::shared_ptr<Session> session, const ::ros::AdvertiseOptions& options,
              const detail::Kind& kind);

  /// Announces it to ROS; once, with the first end there already. False: ROS refuses it.
  bool open();
  /// When nobody publishes any more: takes that back; and then lets go of all. What roscpp's
  /// threads still have of this does nothing then.
  void withdraw();
  void close();
  const std::string& topic() const noexcept { return options_.topic; }

  lot::detail::Loan loan() override;
  void reserve(std::size_t count, std::size_t bytes) override;
  void publish(const detail::Parcel& parcel, bool fresh, std::uint64_t end) override;

  /// A user's end of the topic: whether it latches, and whether it greets peers.
  std::uint64_t add(bool latches, bool greets);
  /// The connect callback of that end has been called for a peer.
  void greeted(std::uint64_t end, const std::string& name);
  /// True when there is no other one.
  bool remove(std::uint64_t end);

  const detail::Kind& kind() const noexcept { return kind_; }

  std::uint64_t serialised() const override;
  std::uint64_t by_link() const override;
  std::uint32_t subscribers() const override;

  struct Link {
    std::string callerid;
    std::string transport;
  };
  using Links = std::map<int, Link>;  ///< by roscpp's number of the connection

  /// What roscpp says of a peer.
  struct News {
    bool came = false;
    std::string name{};
    boost::weak_ptr<::ros::SubscriberLink> link{};
    std::optional<Links> links{};  ///< then; null: until open() has them
  };
  void note(News news);

 private:
  enum class State { Open, Ring, Link };
  /// So long after a peer has been invited in vain it is invited again; then twice as long.
  static constexpr std::chrono::milliseconds kFirstInvitation{250};
  static constexpr std::chrono::milliseconds kRarestInvitation{60'000};
  /// So long it is in the ring until the next invitation may come as soon as the first.
  static constexpr std::chrono::seconds kSettled{10};
  struct Message {
    detail::Parcel parcel;
    std::uint32_t number;
    bool fresh;  ///< its header says the number
    /// The end that latches it has this; null: it is not latched.
    boost::shared_ptr<::ros::M_string> latched_by{};
  };
  struct Peer {
    int number = 0;  ///< roscpp's, of the connection
    boost::weak_ptr<::ros::SubscriberLink> link{};
    std::string name;
    bool may_read = false;         ///< its link is TCPROS, and of another node
    bool is_kept = false;          ///< its link is of this process and has carried what is latched
    std::weak_ptr<Inlet> inlet{};  ///< that messages were handed over to last
    State state = State::Open;
    lot::detail::Served served;
    std::chrono::steady_clock::time_point served_since{};
    bool is_welcome = false;    ///< it has got what is latched
    bool has_last = false;      ///< Ring: the last message of the ring is for it
    bool has_answered = false;  ///< it is the one whose cell is served
    /// Open: what is in the ring, and is for it when it comes to read; since when the first is
    /// there, or it has been invited. Ring: what has gone there before it said whether somebody
    /// beside LOT needs it, too.
    std::deque<Message> unsure;
    std::chrono::steady_clock::time_point since;
    /// Open, after its link has carried messages: the invitation that it has got behind these. When
    /// it answers by that, it has them all.
    std::optional<std::uint8_t> invited{};
    /// The last one. They begin anywhere: a late answer to an earlier link's is none to this one's.
    std::uint8_t invitation = static_cast<std::uint8_t>(std::random_device()());
    std::chrono::steady_clock::time_point invite_at{};  ///< not before that
    std::chrono::milliseconds invite_again = kFirstInvitation;
  };
  using Peers = std::vector<Peer>;

  static constexpr std::chrono::milliseconds kProbePeriod{250};
  /// A probe costs the processor as much as several messages: a stream is asked about less often.
  static constexpr std::chrono::milliseconds kStreamProbePeriod{1000};
  static constexpr std::chrono::milliseconds kStream{60};  ///< a message comes within that

  struct End {
    bool latches = false;
    bool greets = false;
    std::optional<Message> latched{};
    /// While it lives, subscribers of this process give what is latched to those that come.
    boost::shared_ptr<::ros::M_string> alive = boost::make_shared<::ros::M_string>();
    /// By name: links that have come and are to be greeted yet, since when its callback was there.
    std::map<std::string, int> ungreeted{};
  };

  /// On LOT's thread: takes note of who has come.
  void tend(Loop::Clock::time_point when);

  void announce(const News& news);  // REQUIRES news_mutex_

  /// Holds mutex_. When it has left it, receivers_ deliver, and what is in gone_ is destroyed.
  class Turn;

  // All of these REQUIRE a Turn.
  void take_note();
  void welcome(Peer& peer);
  bool try_ring(Peer& peer);
  bool may_come(const Peer& peer) const;
  void keep_for(Peer& peer, const Message& message);
  void has_answered(Peer& peer);
  void go_to_link(Peer& peer);
  void leave_ring(Peer& peer);
  void return_to_link(Peer& peer);
  void invite(Peer& peer);
  void invite_later(Peer& peer);
  bool is_alone(const Peer& peer) const;
  bool is_read() const;
  std::vector<const Message*> latched() const;
  const Message* latched_last(const std::vector<const Message*>& latched) const;
  bool greets() const;
  bool is_greeted(const Peer& peer) const;
  bool needs_link(const Peer& peer) const;
  std::size_t most_unsure() const;
  void watch(std::chrono::milliseconds patience);
  void look_at(Loop::Clock::time_point when, std::chrono::milliseconds patience);
  bool take_answers();
  void settle();
  void probe(Peer& peer);
  /// The bytes of a message, made when they are asked for: once, for all links.
  using Bytes = std::optional<::ros::SerializedMessage>;
  const ::ros::SerializedMessage& serialise(const Message& message, Bytes& bytes);
  void send(Peer& peer, const Message& message, Bytes& bytes);
  void send(Peer& peer, const Message& message);
  void send_sign(const Peer& peer, ::ros::SerializedMessage frame);
  void send_in_process(Peer& peer, ::ros::SubscriberLink& link, const Message& message,
                       Bytes& bytes);
  Inlet::Subscribers subscribers_on(::ros::SubscriberLink& link);
  void hand_over(const std::shared_ptr<Inlet>& inlet, Peer& peer, const Message& message,
                 Bytes& bytes);
  void send_to_be_kept(Peer& peer, ::ros::SubscriberLink& link, const Inlet* has_it,
                       const Message& message, Bytes& bytes);
  bool is_latched_here() const;
  void look_beside();
  bool latches();
  boost::shared_ptr<void const> deserialise(const Message& message, Bytes& bytes);
  void keep_apart(Message& message, Bytes& bytes);
  std::shared_ptr<lot::detail::PusherCore> ring();
  detail::Parcel into_ring(const Message& message);
  void lacks_room();

  const std::shared_ptr<Loop> loop_;
  const ::ros::AdvertiseOptions options_;
  const detail::Kind& kind_;
  const std::shared_ptr<detail::Converter> converter_;
  /// Null: LOT is off, cannot have this topic, or it is closed. Changed with both mutexes held.
  std::shared_ptr<lot::detail::PusherCore> ring_;
  std::mutex ring_mutex_;  ///< a leaf
  ::ros::SubscriberCallbacksPtr callbacks_;
  ::ros::PublicationPtr publication_;

  mutable std::mutex mutex_;
  std::shared_ptr<Session> session_;  ///< null: closed
  Peers peers_;
  Peers gone_;
  std::vector<std::shared_ptr<Inlet>> receivers_;  ///< that may have messages to deliver
  std::vector<Inlet::Taken> dropped_;
  std::map<std::uint64_t, End> ends_;
  std::uint64_t last_end_ = 0;
  bool watching_ = false;        ///< LOT's thread will look after the links
  std::uint32_t published_ = 0;  ///< messages, since it has last asked
  std::chrono::milliseconds probe_period_ = kProbePeriod;
  Loop::Clock::time_point probe_at_;  ///< not before that it asks again
  bool last_is_latched_ = false;      ///< the last message of the ring is the one that is latched
  bool has_lacked_room_ = false;      ///< a message found none, which was said
  std::uint64_t serialised_ = 0;
  std::uint64_t by_link_ = 0;
  /// Once it has latched: links that were made then say so for ever.
  bool has_latched_ = false;

  mutable std::mutex news_mutex_;  ///< a leaf: roscpp's locks are held by who takes it
  std::vector<News> news_;
  std::set<int> announced_;  ///< roscpp's numbers of the links that it has told of
  bool is_open_ = false;     ///< all news have their links
};

}  // namespace lot::ros
