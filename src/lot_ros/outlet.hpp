// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
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

#include "lot/detail/mutex.hpp"
#include "lot/detail/selection.hpp"
#include "lot/ros/core.hpp"

#include "lot_ros/inlet.hpp"
#include "lot_ros/session.hpp"

namespace lot::ros {

/// One topic that this process publishes (docs/ros.md). A *peer* is the subscriber's process at the
/// other end of one of the topic's ROS links. Peers that can read the publisher's ring get messages
/// by the ring, all others by their links. LOT's own subscribers of this process get messages by
/// hand: the thread that publishes gives them to their inlet.
///
/// The outlet decides for each peer, and changes its mind:
///
///     Open ---- the peer reads the ring ----> Ring --- it wants its link, or no room ---> Link
///      | ^                                                                                ^ |
///      | `---- the peer could read the ring: it is invited, by the last frame on its link |-'
///      `------ the peer is no LOT subscriber's, or has not come to read for too long -----'
///
/// - Open: the outlet has sent nothing on the link yet, or nothing since it invited the peer. It
///   expects the peer to read the ring, and keeps for it what goes into the ring meanwhile.
/// - Ring: the peer reads the ring. Its link carries probes and no messages.
/// - Link: the outlet sends each message on the link.
///
/// Threads: all members may be called at once. roscpp calls note() with its own locks held.
/// Crash:   of a peer: its link ends, and the outlet forgets it. The reaper frees its cell in the
///          ring.
class TopicOutlet final : public detail::Outlet, public std::enable_shared_from_this<TopicOutlet> {
 public:
  TopicOutlet(std::shared_ptr<Session> session, const ::ros::AdvertiseOptions& options,
              const detail::Kind& kind);

  /// Advertises the topic at ROS. Called once, when the first end has been added. False: ROS
  /// refuses it.
  bool open();
  /// The end of the outlet, when the user has no publisher of the topic any more. withdraw() takes
  /// the advertisement back, then close() lets go of everything. A call that a roscpp thread still
  /// makes does nothing then.
  void withdraw();
  void close();
  const std::string& topic() const noexcept { return options_.topic; }

  lot::detail::Loan loan() override;
  void reserve(std::size_t count, std::size_t bytes) override;
  void publish(const detail::Parcel& parcel, bool fresh, std::uint64_t end) override;

  /// Adds an end: one publisher of the user's. `latches`, `greets`: whether it latches, and whether
  /// it has a connect callback that greets peers.
  std::uint64_t add(bool latches, bool greets);
  /// The connect callback of that end has returned from a call for the peer of that name.
  void greeted(std::uint64_t end, const std::string& name);
  /// Removes an end. True when it was the last one.
  bool remove(std::uint64_t end);

  const detail::Kind& kind() const noexcept { return kind_; }

  std::uint64_t serialised() const override;
  std::uint64_t by_link() const override;
  std::uint32_t subscribers() const override;

  struct Link {
    std::string callerid;
    std::string transport;
  };
  using Links = std::map<int, Link>;  ///< by the number that roscpp gives a connection

  /// What roscpp says about a peer: that a link came, or went.
  struct News {
    bool came = false;
    std::string name{};
    boost::weak_ptr<::ros::SubscriberLink> link{};
    std::optional<Links> links{};  ///< all links of that moment; null: open() adds them
  };
  void note(News news);

 private:
  enum class State { Open, Ring, Link };
  /// If a peer does not follow an invitation, the outlet waits so long before the next one, then
  /// twice as long each time.
  static constexpr std::chrono::milliseconds kFirstInvitation{250};
  static constexpr std::chrono::milliseconds kRarestInvitation{60'000};
  /// After so long in the ring, the peer's next invitation may come as soon as a first one.
  static constexpr std::chrono::seconds kSettled{10};
  struct Message {
    detail::Parcel parcel;
    std::uint32_t number;
    bool fresh;  ///< its header holds the number, since no other thread had the message
    /// Lives as long as the end that latches the message. Null: the message is not latched.
    boost::shared_ptr<::ros::M_string> latched_by{};
  };
  struct Peer {
    int number = 0;  ///< roscpp's number of the connection
    boost::weak_ptr<::ros::SubscriberLink> link{};
    std::string name;
    bool may_read = false;  ///< the link is TCPROS, and of another node
    bool is_kept = false;   ///< a link in this process, and roscpp keeps there what is latched
    std::weak_ptr<Inlet> inlet{};  ///< the inlet that got the last message by hand
    State state = State::Open;
    lot::detail::SelectedReader reader;  ///< Ring: the reader that the outlet has selected
    std::chrono::steady_clock::time_point selected_since{};
    bool is_welcome = false;    ///< the peer has got what is latched
    bool has_last = false;      ///< Ring: the last message of the ring is for it
    bool has_answered = false;  ///< the selected reader is this peer's, since it has answered
    /// Messages that the ring has, and that the peer may still need by its link.
    /// Open: they are for the peer if it comes to read the ring.
    /// Ring: they went into the ring before the peer said whether its link is needed, too.
    /// `since`: when the first of them was published; Open: or when the outlet invited the peer.
    std::deque<Message> unsure;
    std::chrono::steady_clock::time_point since;
    /// Open, after the link has carried messages: the number of the invitation that the outlet sent
    /// behind these. A peer that answers with this number has them all.
    std::optional<std::uint8_t> invited{};
    /// The number of the last invitation. The numbers begin at random: so a late answer to an
    /// earlier link's invitation is none to this link's.
    std::uint8_t invitation = static_cast<std::uint8_t>(std::random_device()());
    std::chrono::steady_clock::time_point invite_at{};  ///< no invitation before that
    std::chrono::milliseconds invite_again = kFirstInvitation;
  };
  using Peers = std::vector<Peer>;

  static constexpr std::chrono::milliseconds kProbePeriod{250};
  /// A probe costs the processor as much as several messages: so the outlet probes less often in a
  /// stream.
  static constexpr std::chrono::milliseconds kStreamProbePeriod{1000};
  static constexpr std::chrono::milliseconds kStream{60};  ///< a stream has one within that

  struct End {
    bool latches = false;
    bool greets = false;
    std::optional<Message> latched{};
    /// While it lives, the inlets of this process give what is latched to subscribers that come
    /// later.
    boost::shared_ptr<::ros::M_string> alive = boost::make_shared<::ros::M_string>();
    /// By the peer's name: how many links have come since the callback was there, and are not
    /// greeted yet.
    std::map<std::string, int> ungreeted{};
  };

  /// Has LOT's thread take note of the links that came and went.
  void tend(Loop::Clock::time_point when);

  void announce(const News& news);  // REQUIRES news_mutex_

  /// Holds mutex_. When it has released mutex_, it has the inlets of receivers_ deliver, and
  /// destroys the peers in gone_.
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
  /// The bytes of a message. The first link that needs them makes them, for all links.
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
  std::shared_ptr<lot::detail::SelectingPusher> ring();
  detail::Parcel into_ring(const Message& message);
  const boost::shared_ptr<::ros::M_string>& header_of(bool is_latched);
  void lacks_room();

  const std::shared_ptr<Loop> loop_;
  const ::ros::AdvertiseOptions options_;
  const detail::Kind& kind_;
  const std::shared_ptr<detail::Converter> converter_;
  /// Null: LOT is off, cannot carry this topic, or the outlet is closed. A thread that changes it
  /// holds both mutexes.
  std::shared_ptr<lot::detail::SelectingPusher> ring_;
  lot::detail::Mutex ring_mutex_{
      lot::detail::Rank::Ring};  ///< a leaf: no other lock is taken under it
  ::ros::SubscriberCallbacksPtr callbacks_;
  ::ros::PublicationPtr publication_;

  mutable lot::detail::Mutex mutex_{lot::detail::Rank::Outlet};
  std::shared_ptr<Session> session_;  ///< null: closed
  Peers peers_;
  Peers gone_;
  std::vector<std::shared_ptr<Inlet>> receivers_;  ///< inlets that may have messages to deliver
  std::vector<Inlet::Taken> dropped_;
  std::array<boost::shared_ptr<::ros::M_string>, 2> headers_;  ///< header_of()
  std::map<std::uint64_t, End> ends_;
  std::uint64_t last_end_ = 0;
  bool watching_ = false;        ///< LOT's thread is due to look after the links
  std::uint32_t published_ = 0;  ///< messages since the last probes
  std::chrono::milliseconds probe_period_ = kProbePeriod;
  Loop::Clock::time_point probe_at_;  ///< no probes before that
  bool last_is_latched_ = false;      ///< the last message of the ring is the latched one
  bool has_lacked_room_ = false;      ///< a message found no room, and the user was told
  std::uint64_t serialised_ = 0;
  std::uint64_t by_link_ = 0;
  /// True once the topic has latched. roscpp's links that were made then latch for ever.
  bool has_latched_ = false;

  mutable lot::detail::Mutex news_mutex_{
      lot::detail::Rank::News};  ///< a leaf: a thread may take it with roscpp's locks held
  std::vector<News> news_;
  std::set<int> announced_;  ///< numbers of the links that roscpp has told of
  bool is_open_ = false;     ///< open() has added the links to all news
};

}  // namespace lot::ros
