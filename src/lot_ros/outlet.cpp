// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/outlet.hpp"

#include <algorithm>
#include <thread>
#include <utility>

#include <boost/make_shared.hpp>
#include <boost/weak_ptr.hpp>
#include <ros/console.h>
#include <ros/init.h>
#include <ros/single_subscriber_publisher.h>
#include <ros/this_node.h>

namespace lot::ros {
namespace {

/// Reads the link out of roscpp's SingleSubscriberPublisher, which keeps it private. All that LOT
/// uses of the link is public.
template <auto member>
struct Reveal {
  friend const ::ros::SubscriberLinkPtr& link_of(const ::ros::SingleSubscriberPublisher& peer) {
    return peer.*member;
  }
};
const ::ros::SubscriberLinkPtr& link_of(const ::ros::SingleSubscriberPublisher& peer);
template struct Reveal<&::ros::SingleSubscriberPublisher::link_>;

using namespace std::chrono_literals;

/// So long a LOT subscriber may take until it reads the ring: its node is just starting.
constexpr auto kPatience = 1s;
/// So long a reader may take until it answers for the first time. After that, the outlet takes the
/// cell for one of an earlier process of that name, which has not ended yet.
constexpr auto kAnswers = 5s;
constexpr std::chrono::milliseconds kFirstLook{10};
constexpr std::chrono::milliseconds kLastLook{100};
/// So long the end of a publisher waits for answers.
constexpr std::chrono::milliseconds kLastAnswers{100};
/// So long roscpp's thread then has to write the last frames of the links.
constexpr std::chrono::milliseconds kLastFrames{10};
/// When a thread is publishing just now, LOT's thread comes again after this.
constexpr std::chrono::milliseconds kBusy{1};
constexpr std::uint32_t kUsualDepth = 16;
/// Frames beside messages that may be in a link's queue: a probe and an invitation. The queue
/// throws its oldest frame away when it is full.
constexpr std::uint32_t kOurFrames = 2;

/// The depth of the ring.
std::uint32_t depth_of(const ::ros::AdvertiseOptions& options) {
  if (options.queue_size == 0) return kDeepest;  // the user's queue has no limit
  return std::clamp<std::uint32_t>(options.queue_size, kUsualDepth, kDeepest);
}

/// Not null while this thread calls a callback of roscpp's, to learn what it is about.
thread_local TopicOutlet::News* asked = nullptr;

void on_peer(const ::ros::SingleSubscriberPublisher& peer, bool came) {
  if (asked != nullptr) *asked = {came, peer.getSubscriberName(), link_of(peer)};
}

TopicOutlet::Links links_of(::ros::Publication& publication) {
  XmlRpc::XmlRpcValue all;
  all.setSize(0);  // getInfo() appends
  publication.getInfo(all);
  TopicOutlet::Links links;
  for (int i = 0; i < all.size(); ++i) {
    links[int(all[i][0])] = {std::string(all[i][1]), std::string(all[i][3])};
  }
  return links;
}

/// The callback queue by which roscpp tells of peers: it passes news on at once, on roscpp's own
/// threads. roscpp may keep the pointer for longer than an outlet lives, so it is never
/// destroyed.
class PeerNews final : public ::ros::CallbackQueueInterface {
 public:
  static PeerNews& the() {
    static auto* const news = new PeerNews;
    return *news;
  }

  void add(const ::ros::SubscriberCallbacksPtr& callbacks, std::weak_ptr<TopicOutlet> outlet) {
    const std::lock_guard guard(mutex_);
    outlets_[reinterpret_cast<std::uint64_t>(callbacks.get())] = {std::move(outlet), nullptr};
  }
  /// The topic is advertised: from now on roscpp does not hold the lock of the links while it
  /// calls.
  void opened(const ::ros::SubscriberCallbacksPtr& callbacks, ::ros::PublicationPtr publication) {
    const std::lock_guard guard(mutex_);
    outlets_[reinterpret_cast<std::uint64_t>(callbacks.get())].publication = std::move(publication);
  }
  void remove(const ::ros::SubscriberCallbacksPtr& callbacks) {
    const std::lock_guard guard(mutex_);
    outlets_.erase(reinterpret_cast<std::uint64_t>(callbacks.get()));
  }

  void addCallback(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner) override {
    Entry entry;
    {
      const std::lock_guard guard(mutex_);
      const auto at = outlets_.find(owner);
      if (at == outlets_.end()) return;
      entry = at->second;
    }
    TopicOutlet::News news;
    asked = &news;
    callback->call();
    asked = nullptr;
    if (entry.publication) news.links = links_of(*entry.publication);
    if (auto outlet = entry.outlet.lock()) outlet->note(std::move(news));
  }
  void removeByID(std::uint64_t) override {}

 private:
  struct Entry {
    std::weak_ptr<TopicOutlet> outlet;
    ::ros::PublicationPtr publication;
  };
  lot::detail::Mutex mutex_{lot::detail::Rank::PeerNews};
  std::map<std::uint64_t, Entry> outlets_;
};

/// A frame of one byte, which is no message.
::ros::SerializedMessage frame_of(std::uint8_t sign) {
  boost::shared_array<std::uint8_t> bytes(new std::uint8_t[5]{1, 0, 0, 0, sign});
  ::ros::SerializedMessage message(bytes, 5);
  message.message_start = bytes.get() + 4;
  return message;
}
const ::ros::SerializedMessage& probe_frame() {
  static const auto* const frame = new ::ros::SerializedMessage(frame_of(kProbe));
  return *frame;
}

bool is_in_process(const boost::weak_ptr<::ros::SubscriberLink>& link) {
  const ::ros::SubscriberLinkPtr there = link.lock();
  return there && there->isIntraprocess();
}

}  // namespace

class TopicOutlet::Turn {
 public:
  explicit Turn(TopicOutlet& outlet) : Turn(outlet, std::unique_lock(outlet.mutex_)) {}
  Turn(TopicOutlet& outlet, std::unique_lock<lot::detail::Mutex> lock)
      : outlet_(outlet), lock_(std::move(lock)) {}
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;
  ~Turn() { leave(); }

  /// Releases the mutex for that time: other threads may take it.
  void sleep(std::chrono::milliseconds time) {
    leave();
    std::this_thread::sleep_for(time);
    lock_.lock();
  }

 private:
  void leave() {
    Peers gone;
    gone.swap(outlet_.gone_);
    decltype(receivers_) receivers;
    receivers.swap(outlet_.receivers_);
    decltype(dropped_) dropped;
    dropped.swap(outlet_.dropped_);
    lock_.unlock();
    for (const auto& inlet : receivers) inlet->deliver_taken();
  }

  TopicOutlet& outlet_;
  std::unique_lock<lot::detail::Mutex> lock_;
};

TopicOutlet::TopicOutlet(std::shared_ptr<Session> session, const ::ros::AdvertiseOptions& options,
                         const detail::Kind& kind)
    : loop_(session->loop()),
      options_(options),
      kind_(kind),
      converter_(detail::make_converter(kind)),
      session_(std::move(session)) {
  if (!session_->is_on() || kind.least_bytes < 2) return;
  PusherOptions ring;
  ring.depth = depth_of(options);
  ring.engine = session_->queue_engine();
  try {
    ring_ = lot::detail::make_selecting_pusher(
        session_->participant(), session_->name_of(options.topic), *kind.layout, ring);
  } catch (const std::exception& e) {
    ROS_WARN("LOT: %s goes over TCPROS: %s", options.topic.c_str(), e.what());
  }
}

bool TopicOutlet::open() {
  ::ros::AdvertiseOptions options = options_;
  options.latch = false;
  if (options.queue_size != 0) options.queue_size += kOurFrames;
  callbacks_ = boost::make_shared<::ros::SubscriberCallbacks>(
      [](const ::ros::SingleSubscriberPublisher& peer) { on_peer(peer, true); },
      [](const ::ros::SingleSubscriberPublisher& peer) { on_peer(peer, false); },
      ::ros::VoidConstPtr(), &PeerNews::the());
  // With this callback, links say from the first one on that the topic latches. The outlet itself
  // sends what is latched.
  if (options_.latch) callbacks_->push_latched_message_ = [](const ::ros::SubscriberLinkPtr&) {};
  PeerNews::the().add(callbacks_, weak_from_this());
  const bool accepted = ::ros::TopicManager::instance()->advertise(options, callbacks_);
  if (accepted) {
    publication_ = ::ros::TopicManager::instance()->lookupPublication(options.topic);
  }
  if (!publication_) {
    PeerNews::the().remove(callbacks_);
    return false;
  }
  PeerNews::the().opened(callbacks_, publication_);
  // News that came before now have no links yet.
  const Links links = links_of(*publication_);
  const std::lock_guard guard(news_mutex_);
  for (News& news : news_) {
    if (news.links) continue;
    news.links = links;
    announce(news);
  }
  is_open_ = true;
  return true;
}

/// Before the end: peers that have not come to the ring yet, or have not answered yet, get what the
/// outlet has kept for them.
void TopicOutlet::settle() {
  const auto until = Loop::Clock::now() + kLastAnswers;
  bool is_sending = false;
  {
    Turn turn(*this);
    const std::uint64_t on_links = serialised_;
    take_note();
    for (Peer& peer : peers_) {
      const bool may_answer = peer.invited && !peer.unsure.empty();
      if (peer.state == State::Open && !may_answer && (needs_link(peer) || !try_ring(peer))) {
        go_to_link(peer);
      }
      if (peer.state == State::Ring && !peer.unsure.empty()) probe(peer);
    }
    while (!take_answers() && ::ros::ok() && Loop::Clock::now() < until) turn.sleep(kBusy);
    for (Peer& peer : peers_) {
      if (peer.state == State::Open) go_to_link(peer);
    }
    is_sending = serialised_ != on_links;
  }
  // When the topic ends, roscpp drops the frames that it has not written.
  if (is_sending) std::this_thread::sleep_for(kLastFrames);
}

void TopicOutlet::withdraw() {
  try {
    settle();
  } catch (const std::exception& e) {  // say, taken for dead: its peers have all
    ROS_WARN("LOT: %s: its last messages: %s", options_.topic.c_str(), e.what());
  }
  PeerNews::the().remove(callbacks_);
  ::ros::TopicManager::instance()->unadvertise(options_.topic, callbacks_);
}

void TopicOutlet::close() {
  Peers gone;
  std::shared_ptr<lot::detail::SelectingPusher> ring;
  std::shared_ptr<Session> session;
  const std::scoped_lock guard(mutex_, ring_mutex_);  // released first, before the objects above go
  gone.swap(peers_);
  ring.swap(ring_);
  session.swap(session_);
}

// ---- who is there -------------------------------------------------------------------------------

void TopicOutlet::note(News news) {
  {
    const std::lock_guard guard(news_mutex_);
    if (news.links) announce(news);
    news_.push_back(std::move(news));
  }
  tend({});
}

/// Notes the link that the news is about: a new one of that name.
void TopicOutlet::announce(const News& news) {
  if (!news.came) return;
  for (const auto& [number, link] : *news.links) {
    if (link.callerid == news.name && announced_.insert(number).second) return;
  }
}

/// LOT's thread does not wait for a thread that is publishing: that thread takes note itself.
void TopicOutlet::tend(Loop::Clock::time_point when) {
  loop_->at(when, [weak = weak_from_this()] {
    const auto self = weak.lock();
    if (!self) return;
    std::unique_lock lock(self->mutex_, std::try_to_lock);
    if (!lock) return self->tend(Loop::Clock::now() + kBusy);
    const Turn turn(*self, std::move(lock));
    if (!self->session_) return;
    self->take_note();
    for (Peer& peer : self->peers_) {
      if (peer.state != State::Open) continue;
      self->welcome(peer);
      if (peer.state == State::Open && !self->needs_link(peer)) self->try_ring(peer);
    }
  });
}

void TopicOutlet::take_note() {
  std::vector<News> all;
  {
    const std::lock_guard guard(news_mutex_);
    if (!is_open_) return;
    all.swap(news_);
  }
  for (News& news : all) {
    const Links& links = *news.links;
    latches();
    if (news.came) {
      for (auto& [name, end] : ends_) {
        if (end.greets) ++end.ungreeted[news.name];
      }
      const auto is_new = [&](const auto& link) {
        return link.second.callerid == news.name &&
               std::none_of(peers_.begin(), peers_.end(),
                            [&](const Peer& p) { return p.number == link.first; });
      };
      const auto at = std::find_if(links.begin(), links.end(), is_new);
      Peer peer;
      peer.name = news.name;
      peer.link = news.link;
      if (at != links.end()) {
        peer.number = at->first;
        peer.may_read =
            at->second.transport == "TCPROS" && news.name != ::ros::this_node::getName();
      } else {
        peer.state = State::Link;  // it was there before LOT: its kind is unknown
      }
      peers_.push_back(std::move(peer));
    } else {
      for (auto peer = peers_.begin(); peer != peers_.end();) {
        if (peer->name != news.name || links.count(peer->number) != 0) {
          ++peer;
          continue;
        }
        leave_ring(*peer);
        {
          const std::lock_guard guard(news_mutex_);
          announced_.erase(peer->number);
        }
        gone_.push_back(std::move(*peer));
        peer = peers_.erase(peer);
      }
    }
  }
}

/// Treats a peer that has just come: it gets what is latched.
void TopicOutlet::welcome(Peer& peer) {
  if (std::exchange(peer.is_welcome, true)) return;
  const auto latched = this->latched();
  const Message* const last = latched_last(latched);
  if (needs_link(peer) || (!latched.empty() && last == nullptr) || !may_come(peer)) {
    if (!latched.empty()) go_to_link(peer);
    for (const Message* message : latched) send(peer, *message);
  } else if (last != nullptr) {
    keep_for(peer, *last);
  }
}

std::vector<const TopicOutlet::Message*> TopicOutlet::latched() const {
  std::vector<const Message*> latched;
  for (const auto& [name, end] : ends_) {
    if (end.latches && end.latched) latched.push_back(&*end.latched);
  }
  return latched;
}

/// The latched message, if there is one only and it is the ring's last message; else null.
const TopicOutlet::Message* TopicOutlet::latched_last(
    const std::vector<const Message*>& latched) const {
  return latched.size() == 1 && last_is_latched_ ? latched.front() : nullptr;
}

/// Open -> Ring, if the peer reads the ring: selects its reader from the oldest kept message on.
/// The probe then asks whether the ring is enough for the peer's process.
bool TopicOutlet::try_ring(Peer& peer) {
  if (!ring_ || !peer.may_read || !is_alone(peer)) return false;
  const auto reader = ring_->select(participant_name(peer.name), peer.unsure.size(), peer.invited);
  if (!reader) return false;
  peer.reader = *reader;
  peer.selected_since = std::chrono::steady_clock::now();
  peer.state = State::Ring;
  peer.has_last = !peer.unsure.empty();
  peer.invited.reset();
  while (peer.unsure.size() > most_unsure()) peer.unsure.pop_front();
  probe(peer);
  return true;
}

/// True when the peer may still come to read the ring: a living participant of that name wants the
/// topic, and the peer has not taken too long. (If another peer of that name is there, too, its
/// process has gone, and roscpp has yet to say so.)
bool TopicOutlet::may_come(const Peer& peer) const {
  const bool in_time =
      peer.unsure.empty() || std::chrono::steady_clock::now() - peer.since < kPatience;
  return in_time && ring_ && peer.may_read && ring_->expects(participant_name(peer.name));
}

/// Keeps a message that goes into the ring, since the peer may yet need it by its link.
void TopicOutlet::keep_for(Peer& peer, const Message& message) {
  const auto now = std::chrono::steady_clock::now();
  if (peer.unsure.empty()) peer.since = now;
  peer.unsure.push_back(message);
  const bool hangs = peer.state == State::Ring && now - peer.since > kPatience;
  const std::size_t most = hangs ? std::min(kMostUndecidedLater, most_unsure()) : most_unsure();
  while (peer.unsure.size() > most) peer.unsure.pop_front();
  watch(kFirstLook);
}

/// The peer has confirmed that the ring is enough: its link needs none of the kept messages.
void TopicOutlet::has_answered(Peer& peer) {
  peer.has_answered = true;
  if (peer.invite_again != kFirstInvitation &&
      std::chrono::steady_clock::now() - peer.selected_since > kSettled) {
    peer.invite_again = kFirstInvitation;
  }
  peer.unsure.clear();
}

/// Open -> Link, or the end of Ring: sends on the link what the outlet has kept for the peer.
void TopicOutlet::go_to_link(Peer& peer) {
  peer.state = State::Link;
  if (peer.invited) invite_later(peer);
  peer.invited.reset();
  for (const Message& message : std::exchange(peer.unsure, {})) send(peer, message);
}

/// Link -> Open, if the peer could read the ring: invites it. The peer's link has carried all
/// messages for it so far, and the invitation is the frame behind them. The outlet keeps what comes
/// next until the peer reads the ring. It invites no peer of a latched topic: what is latched must
/// stay the link's last frame, which roscpp keeps for subscribers that come later.
void TopicOutlet::invite(Peer& peer) {
  if (!ring_ || !peer.may_read || !is_alone(peer) || !is_greeted(peer)) return;
  if (!latched().empty()) return;
  if (std::chrono::steady_clock::now() < peer.invite_at) return;
  if (!ring_->is_read_by(participant_name(peer.name))) {
    peer.invite_at = std::chrono::steady_clock::now() + kFirstLook;
    return;
  }
  peer.invitation = peer.invitation == kLastInvitation ? 1 : peer.invitation + 1;
  peer.invited = peer.invitation;
  peer.since = std::chrono::steady_clock::now();
  peer.state = State::Open;
  peer.has_answered = false;
  send_sign(peer, frame_of(peer.invitation));
  watch(kFirstLook);
}
/// Sets the earliest time of the next invitation, and doubles the wait.
void TopicOutlet::invite_later(Peer& peer) {
  peer.invite_at = std::chrono::steady_clock::now() + peer.invite_again;
  peer.invite_again = std::min(2 * peer.invite_again, kRarestInvitation);
}

bool TopicOutlet::is_alone(const Peer& peer) const {
  return std::count_if(peers_.begin(), peers_.end(),
                       [&](const Peer& p) { return p.name == peer.name; }) == 1;
}

/// True when a connect callback of the user's may send something on each link.
bool TopicOutlet::greets() const {
  return std::any_of(ends_.begin(), ends_.end(),
                     [](const auto& each) { return each.second.greets; });
}

bool TopicOutlet::is_greeted(const Peer& peer) const {
  return std::none_of(ends_.begin(), ends_.end(), [&peer](const auto& each) {
    return each.second.ungreeted.count(peer.name) != 0;
  });
}

/// True when a connect callback greets the peer over its link. An invited peer has got the
/// greeting: it is a frame before the invitation.
bool TopicOutlet::needs_link(const Peer& peer) const { return greets() && !peer.invited; }

/// As many messages as the peer's link takes at once: roscpp throws the oldest frame away when its
/// queue is full.
std::size_t TopicOutlet::most_unsure() const {
  const std::size_t undecided = most_undecided(depth_of(options_));
  return options_.queue_size == 0 ? undecided
                                  : std::min<std::size_t>(options_.queue_size, undecided);
}

/// The peer's link has gone: ends its service in the ring.
void TopicOutlet::leave_ring(Peer& peer) {
  if (peer.state != State::Ring) return;
  ring_->deselect(peer.reader, 0);
  peer.state = State::Link;
}

/// Ring -> Link: the peer's messages go by the link from now on. So do those that a plain
/// subscriber beside its LOT subscribers may have missed, and what is latched. The inlet of the
/// peer knows by `to` which of them it has had.
void TopicOutlet::return_to_link(Peer& peer) {
  const Message* const last = latched_last(latched());
  if (last != nullptr && peer.has_last && peer.unsure.empty()) peer.unsure.push_back(*last);
  ring_->deselect(peer.reader, peer.unsure.size());
  invite_later(peer);
  go_to_link(peer);
}

// ---- messages -----------------------------------------------------------------------------------

/// A pointer to the ring, since another thread may close the outlet meanwhile.
std::shared_ptr<lot::detail::SelectingPusher> TopicOutlet::ring() {
  const std::lock_guard guard(ring_mutex_);
  return ring_;
}

lot::detail::Loan TopicOutlet::loan() {
  const auto ring = this->ring();
  return ring ? ring->core().loan(*kind_.layout, false) : lot::detail::Loan{};
}

void TopicOutlet::reserve(std::size_t count, std::size_t bytes) {
  if (const auto ring = this->ring()) ring->core().reserve(count, bytes);
}

void TopicOutlet::publish(const detail::Parcel& given, bool fresh, std::uint64_t end) {
  const Turn turn(*this);
  if (!session_ || !::ros::ok() || publication_->isDropped()) {
    gone_.swap(peers_);
    return;
  }
  take_note();
  for (Peer& peer : peers_) {
    if (peer.state == State::Open) welcome(peer);
  }
  const std::uint32_t number = publication_->incrementSequence();
  Message message{given, number, fresh};
  detail::Parcel& parcel = message.parcel;
  if (fresh) kind_.set_sequence(const_cast<void*>(parcel.message.get()), number);

  const auto from = ends_.find(end);
  const bool latches = from != ends_.end() && from->second.latches;
  if (latches) message.latched_by = from->second.alive;
  for (Peer& peer : peers_) {
    if (peer.state != State::Open) continue;
    const bool has_room = peer.unsure.size() < most_unsure();
    if (needs_link(peer) || (!try_ring(peer) && !(has_room && may_come(peer)))) go_to_link(peer);
  }
  const auto in = [&](State state) {
    return std::any_of(peers_.begin(), peers_.end(),
                       [state](const Peer& p) { return p.state == state; });
  };
  bool to_ring = ring_ != nullptr && (latches || in(State::Ring) || in(State::Open));
  if (to_ring &&
      (parcel.control == nullptr || !ring_->accepts(*parcel.control, parcel.message.get()))) {
    const detail::Parcel copy = into_ring(message);
    to_ring = copy.control != nullptr;
    if (to_ring) {
      parcel.message = copy.message;
      parcel.control = copy.control;
    } else {
      lacks_room();
    }
  }
  for (Peer& peer : peers_) {
    if (peer.state == State::Open && !to_ring) {
      go_to_link(peer);
    } else if (peer.state == State::Ring) {
      if (!to_ring || !ring_->wants(peer.reader)) {
        return_to_link(peer);
      } else if (ring_->has_confirmed(peer.reader)) {
        has_answered(peer);
      }
    }
  }

  const bool is_due = Loop::Clock::now() >= probe_at_;
  std::vector<Peer*> undecided;
  for (Peer& peer : peers_) {
    if (peer.state == State::Open) undecided.push_back(&peer);
    if (peer.state != State::Ring) continue;
    peer.has_last = true;
    if (is_due) ring_->ask(peer.reader);  // no other thread has asked lately
    if (ring_->has_confirmed(peer.reader)) {
      has_answered(peer);
    } else {
      undecided.push_back(&peer);
    }
  }
  if (to_ring) ring_->core().push_shared(parcel.control, parcel.message.get(), {0ns});
  for (Peer* peer : undecided) keep_for(*peer, message);
  last_is_latched_ = to_ring && latches;
  look_beside();
  Bytes bytes;
  if (latches) {
    keep_apart(message, bytes);
    from->second.latched = message;
  }
  // Subscribers of this process come last: they may change a standard message.
  for (const bool here : {false, true}) {
    for (Peer& peer : peers_) {
      if (peer.state != State::Link || is_in_process(peer.link) != here) continue;
      send(peer, message, bytes);
      invite(peer);
    }
  }
  if (in(State::Ring)) {
    ++published_;
    watch(kFirstLook);
  }
}

/// Copies into the ring's memory a message that other processes cannot read where it is. Returns an
/// empty parcel when there is no room. The copy of a standard message gets the message's number.
detail::Parcel TopicOutlet::into_ring(const Message& message) {
  const detail::Parcel& given = message.parcel;
  try {
    const lot::detail::Loan loan = ring_->core().loan(*kind_.layout, false);
    if (loan.control == nullptr) return {};
    if (given.message) return kind_.copy_into(loan, given.message.get());
    detail::Parcel copy = kind_.standard.copy_into(loan, given.standard.get());
    kind_.set_sequence(const_cast<void*>(copy.message.get()), message.number);
    return copy;
  } catch (const OutOfMemory&) {
    return {};
  }
}

void TopicOutlet::lacks_room() {
  if (std::exchange(has_lacked_room_, true)) return;
  ROS_WARN(
      "LOT: %s goes over TCPROS for a message that the segment has no room for: set a larger "
      "~lot/size at the node that makes it, or keep fewer messages (said once)",
      options_.topic.c_str());
}

const ::ros::SerializedMessage& TopicOutlet::serialise(const Message& message, Bytes& bytes) {
  if (bytes) return *bytes;
  ++serialised_;
  const detail::Parcel& parcel = message.parcel;
  bytes = parcel.message ? kind_.serialise(parcel.message.get())
                         : kind_.standard.serialise(parcel.standard.get());
  if (kind_.has_header && !message.fresh) {
    // Other threads may be reading the message: the outlet sets its number in the bytes alone.
    for (int i = 0; i < 4; ++i) {
      bytes->message_start[i] = static_cast<std::uint8_t>(message.number >> 8 * i);
    }
  }
  return *bytes;
}

/// Sends a frame that is no message: a probe or an invitation. Plain subscribers of this process do
/// not see it.
void TopicOutlet::send_sign(const Peer& peer, ::ros::SerializedMessage frame) {
  frame.type_info = kind_.standard.type;
  if (const ::ros::SubscriberLinkPtr link = peer.link.lock()) {
    link->enqueueMessage(frame, true, false);
  }
}

void TopicOutlet::send(Peer& peer, const Message& message) {
  Bytes bytes;
  send(peer, message, bytes);
}

void TopicOutlet::send(Peer& peer, const Message& message, Bytes& bytes) {
  const ::ros::SubscriberLinkPtr link = peer.link.lock();
  if (!link) return;
  if (link->isIntraprocess()) return send_in_process(peer, *link, message, bytes);
  ++by_link_;
  link->enqueueMessage(serialise(message, bytes), true, false);
}

/// Sends a message to subscribers of this process, by pointer: LOT's get the message in shared
/// memory, plain ones the standard message, which they may change. Subscribers of other types
/// (ShapeShifter) get bytes. Where the topic latches, plain ones get bytes, too: roscpp keeps the
/// last frame, and gives it to subscribers that come later, whatever type they take.
void TopicOutlet::send_in_process(Peer& peer, ::ros::SubscriberLink& link, const Message& message,
                                  Bytes& bytes) {
  const std::type_info& standard = *kind_.standard.type;
  const Inlet::Subscribers there = subscribers_on(link);
  // The outlet copies and serialises before a subscriber has a pointer by which it may change the
  // message.
  if (there.inlet) hand_over(there.inlet, peer, message, bytes);
  if (latches()) {
    if (there.plain || there.others || peer.is_kept) {
      send_to_be_kept(peer, link, there.inlet.get(), message, bytes);
    }
    if (is_latched_here()) watch(kFirstLook);
    return;
  }
  if (!there.plain && !there.others) return;
  ++by_link_;
  if (there.others) serialise(message, bytes);
  if (there.plain) {
    const detail::Parcel& parcel = message.parcel;
    ::ros::SerializedMessage where;
    where.message = parcel.standard ? parcel.standard : converter_->make(parcel.message);
    where.type_info = &standard;
    link.enqueueMessage(where, false, true);
  }
  if (!there.others) return;
  const Inlet::Disguise as_plain_ones(standard);  // plain ones have the message by pointer
  ::ros::SerializedMessage for_others = *bytes;
  for_others.type_info = &standard;
  link.enqueueMessage(for_others, true, false);
}

/// Hands a message over to the inlet of LOT's own subscribers of this process. The inlet delivers
/// it when this thread has released the outlet's mutex.
void TopicOutlet::hand_over(const std::shared_ptr<Inlet>& inlet, Peer& peer, const Message& message,
                            Bytes& bytes) {
  boost::shared_ptr<void const> ours = message.parcel.message;
  if (!ours && ring_) {
    ours = into_ring(message).message;
    if (!ours) lacks_room();
  }
  if (!ours) ours = deserialise(message, bytes);
  // A greeting goes by the link: the message waits behind it.
  if (!is_greeted(peer)) inlet->follow_links();
  const auto& header = header_of(message.latched_by != nullptr);
  dropped_.push_back(
      inlet->take({std::move(ours), header, message.latched_by}, depth_of(options_)));
  peer.inlet = inlet;
}

/// What the header of a link would say to these subscribers. Made once, since a map of strings
/// costs as much as all else that a message needs here.
const boost::shared_ptr<::ros::M_string>& TopicOutlet::header_of(bool is_latched) {
  auto& header = headers_[is_latched ? 1 : 0];
  if (header) return header;
  header = link_header(kind_, options_.topic, ::ros::this_node::getName());
  (*header)["latching"] = is_latched ? "1" : "0";
  return header;
}

/// Sends the bytes to all subscribers on the link but those of the inlet that has the message.
/// roscpp keeps the bytes for subscribers that come to this link later.
void TopicOutlet::send_to_be_kept(Peer& peer, ::ros::SubscriberLink& link, const Inlet* has_it,
                                  const Message& message, Bytes& bytes) {
  ++by_link_;
  Inlet::send_past(has_it, link, serialise(message, bytes));
  peer.is_kept = true;
}

/// True when a plain subscriber may come beside LOT's own of this process, is to get what is
/// latched, and roscpp does not have it.
bool TopicOutlet::is_latched_here() const {
  return !latched().empty() && std::any_of(peers_.begin(), peers_.end(), [](const Peer& peer) {
    return peer.state == State::Link && !peer.is_kept && is_in_process(peer.link);
  });
}

/// Looks whether such a plain subscriber has come, or a new inlet of LOT's: roscpp does not say so.
void TopicOutlet::look_beside() {
  if (!is_latched_here()) return;
  for (Peer& peer : peers_) {
    const ::ros::SubscriberLinkPtr link = peer.link.lock();
    if (peer.state != State::Link || peer.is_kept || !link || !link->isIntraprocess()) continue;
    const Inlet::Subscribers there = subscribers_on(*link);
    const bool is_new = there.inlet && there.inlet != peer.inlet.lock();
    for (const Message* message : latched()) {
      Bytes bytes;
      if (is_new) hand_over(there.inlet, peer, *message, bytes);
      if (there.plain || there.others) {
        send_to_be_kept(peer, *link, there.inlet.get(), *message, bytes);
      }
    }
  }
}

/// The subscribers on a link of this process. The inlet that it finds delivers, and may go, when
/// this thread has released the mutex.
Inlet::Subscribers TopicOutlet::subscribers_on(::ros::SubscriberLink& link) {
  Inlet::Subscribers there = Inlet::on(link, *kind_.standard.type);
  if (there.inlet) receivers_.push_back(there.inlet);
  return there;
}

bool TopicOutlet::latches() {
  has_latched_ = has_latched_ || publication_->isLatching();
  return has_latched_;
}

/// Makes the message anew on the heap, from its bytes.
boost::shared_ptr<void const> TopicOutlet::deserialise(const Message& message, Bytes& bytes) {
  const ::ros::SerializedMessage& made = serialise(message, bytes);
  const auto length =
      made.num_bytes - static_cast<std::size_t>(made.message_start - made.buf.get());
  return kind_.deserialise(made.message_start, static_cast<std::uint32_t>(length));
}

/// Makes a message that is latched safe from subscribers that change it: gives up the user's
/// standard message, and keeps a copy.
void TopicOutlet::keep_apart(Message& message, Bytes& bytes) {
  detail::Parcel& parcel = message.parcel;
  if (!parcel.message) {
    parcel.message = deserialise(message, bytes);
    message.fresh = false;
  }
  parcel.standard.reset();
}

/// Has LOT's thread look after the links while messages are published. It probes every now and
/// then: does a plain subscriber beside a peer's LOT subscribers need the link? A publishing thread
/// does not send the probes, since they would hold its messages up. LOT's thread takes the answers
/// as well, since there may be no further message.
void TopicOutlet::watch(std::chrono::milliseconds patience) {
  if (std::exchange(watching_, true)) return;
  look_at(Loop::Clock::now() + patience, patience);
}

void TopicOutlet::look_at(Loop::Clock::time_point when, std::chrono::milliseconds patience) {
  loop_->at(when, [weak = weak_from_this(), patience] {
    const auto self = weak.lock();
    if (!self) return;
    std::unique_lock lock(self->mutex_, std::try_to_lock);
    if (!lock) return self->look_at(Loop::Clock::now() + kBusy, patience);
    const Turn turn(*self, std::move(lock));
    self->watching_ = false;
    if (!self->session_) return;
    const bool all_answered = self->take_answers();
    const auto now = Loop::Clock::now();
    const bool is_early = now < self->probe_at_;
    bool goes_on = is_early;
    // A plain subscriber that comes beside a peer in the ring is to get what is latched, too.
    self->look_beside();
    const bool asks_anyway = self->is_latched_here() ||
                             (self->latched_last(self->latched()) != nullptr && self->is_read());
    if (!goes_on && (self->published_ != 0 || !all_answered || asks_anyway)) {
      goes_on = true;
      const std::uint32_t published = std::exchange(self->published_, 0);
      const bool is_stream = published > self->probe_period_ / kStream;
      self->probe_period_ = is_stream || published == 0 ? kStreamProbePeriod : kProbePeriod;
      self->probe_at_ = now + self->probe_period_;
      for (Peer& peer : self->peers_) {
        if (peer.state == State::Ring) self->probe(peer);
      }
    }
    if (!all_answered || goes_on) {
      self->watching_ = true;
      auto next = all_answered ? self->probe_at_ : now + patience;
      // It looks earlier for the answers, and for new plain subscribers of this process, which no
      // probe finds.
      if ((asks_anyway && !is_early) || self->is_latched_here()) {
        next = std::min(next, now + kLastLook);
      }
      self->look_at(next, all_answered ? kFirstLook : std::min(2 * patience, kLastLook));
    }
  });
}

/// True when a peer has its messages from the ring.
bool TopicOutlet::is_read() const {
  return std::any_of(peers_.begin(), peers_.end(),
                     [](const Peer& peer) { return peer.state == State::Ring; });
}

/// Takes the answers of the peers. False: a peer has yet to answer about messages that the outlet
/// keeps for it.
bool TopicOutlet::take_answers() {
  bool all_answered = true;
  for (Peer& peer : peers_) {
    if (peer.state == State::Ring && !ring_->wants(peer.reader)) return_to_link(peer);
    if (peer.state == State::Open && peer.invited && peer.unsure.empty() && !try_ring(peer)) {
      if (std::chrono::steady_clock::now() - peer.since > kPatience) {
        go_to_link(peer);
      } else {
        all_answered = false;
      }
    }
    if (peer.unsure.empty()) continue;
    if (peer.state == State::Open) {
      if (needs_link(peer) || (!try_ring(peer) && !may_come(peer))) go_to_link(peer);
    } else if (ring_->has_confirmed(peer.reader)) {
      has_answered(peer);
    } else if (!peer.has_answered && std::chrono::steady_clock::now() - peer.since > kAnswers) {
      return_to_link(peer);
    }
    all_answered = all_answered && peer.unsure.empty();
  }
  return all_answered;
}

/// Asks a peer: is a plain subscriber beside your LOT subscribers? It has to confirm anew that it
/// needs no link.
void TopicOutlet::probe(Peer& peer) {
  ring_->ask(peer.reader);
  send_sign(peer, probe_frame());
}

// ---- the user's ends ----------------------------------------------------------------------------

std::uint64_t TopicOutlet::add(bool latches, bool greets) {
  const Turn turn(*this);
  ends_[++last_end_] = {latches, greets};
  if (!greets) return last_end_;
  // What the connect callback sends comes behind all that was published so far.
  End& end = ends_[last_end_];
  end.greets = false;  // take_note() counts no greeting for it: the loop below does
  take_note();
  end.greets = true;
  for (Peer& peer : peers_) {
    if (peer.state == State::Open) welcome(peer);
    if (peer.state == State::Open) go_to_link(peer);
    if (peer.state == State::Ring) return_to_link(peer);
    ++end.ungreeted[peer.name];
  }
  return last_end_;
}

void TopicOutlet::greeted(std::uint64_t name, const std::string& peer_name) {
  const Turn turn(*this);
  const auto at = ends_.find(name);
  if (!session_ || at == ends_.end()) return;
  take_note();
  // Links that were there before the callback was may be greeted twice.
  auto& ungreeted = at->second.ungreeted;
  if (const auto link = ungreeted.find(peer_name); link != ungreeted.end()) {
    if (--link->second == 0) ungreeted.erase(link);
  }
  for (Peer& peer : peers_) {
    if (peer.name != peer_name || !is_greeted(peer)) continue;
    if (peer.state == State::Open) welcome(peer);
    if (peer.state == State::Open && needs_link(peer)) go_to_link(peer);
    if (peer.state != State::Link) continue;
    invite(peer);
    const ::ros::SubscriberLinkPtr link = peer.link.lock();
    if (!link || !link->isIntraprocess()) continue;
    const auto there = subscribers_on(*link);
    if (there.inlet) there.inlet->follow_links();
  }
}

bool TopicOutlet::remove(std::uint64_t name) {
  End end;  // destroyed when the mutex is released
  const std::lock_guard guard(mutex_);
  const auto at = ends_.find(name);
  if (at != ends_.end()) {
    end = std::move(at->second);
    if (end.latched) last_is_latched_ = false;
    ends_.erase(at);
  }
  return ends_.empty();
}

std::uint64_t TopicOutlet::serialised() const {
  const std::lock_guard guard(mutex_);
  return serialised_;
}

std::uint64_t TopicOutlet::by_link() const {
  const std::lock_guard guard(mutex_);
  return by_link_;
}

/// How many links are there of which roscpp has told the outlet, which it does a little later.
std::uint32_t TopicOutlet::subscribers() const {
  const Links links = links_of(*publication_);
  const std::lock_guard guard(news_mutex_);
  return static_cast<std::uint32_t>(
      std::count_if(links.begin(), links.end(),
                    [this](const auto& link) { return announced_.count(link.first) != 0; }));
}

}  // namespace lot::ros
