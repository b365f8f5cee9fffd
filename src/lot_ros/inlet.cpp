// SPDX-License-Identifier: Apache-2.0
#include "lot_ros/inlet.hpp"

#include <algorithm>
#include <functional>
#include <iterator>
#include <thread>
#include <utility>

#include <boost/make_shared.hpp>
#include <ros/console.h>
#include <ros/message_deserializer.h>
#include <ros/param.h>
#include <ros/this_node.h>
#include <ros/topic_manager.h>

#include "lot/detail/mutex.hpp"
#include "lot/detail/no_signals.hpp"

#include "lot_ros/immediate_queue.hpp"

namespace lot::ros {
namespace {

/// How many frames of one topic may wait to be deserialised: as many as its users would let wait,
/// and as many as a publisher sends at once when it goes from the ring to the link, with its
/// probes. None of these may be lost, since the inlet counts them.
constexpr std::uint32_t kShortestIntake = kDeepest + 16;
/// A publisher that waits for this reader has decided by then.
constexpr auto kDecided = std::chrono::seconds(2);
/// So often LOT's thread looks whether publishers are still there.
constexpr auto kForgetPeriod = std::chrono::seconds(5);

/// The thread that deserialises what comes over links. roscpp may keep this queue for longer than a
/// subscription lasts, so it is never destroyed.
class Intake final : public ::ros::CallbackQueueInterface {
 public:
  static Intake& the() {
    static auto* const intake = new Intake;
    return *intake;
  }

  void addCallback(const ::ros::CallbackInterfacePtr& callback, std::uint64_t owner) override {
    const std::lock_guard guard(mutex_);
    if (!begun_) {
      begun_ = true;
      const lot::detail::NoSignals quiet;
      std::thread([this] { run(); }).detach();
    }
    work_.push_back({callback, owner});
    more_.notify_one();
  }
  /// When it returns, no callback of that owner is called any more, unless such a callback calls
  /// it.
  void removeByID(std::uint64_t owner) override {
    std::unique_lock lock(mutex_);
    work_.erase(std::remove_if(work_.begin(), work_.end(),
                               [owner](const Work& w) { return w.owner == owner; }),
                work_.end());
    if (std::this_thread::get_id() != thread_) {
      idle_.wait(lock, [&] { return at_work_for_ != owner; });
    }
  }

 private:
  struct Work {
    ::ros::CallbackInterfacePtr callback;
    std::uint64_t owner;
  };

  void run() {
    pthread_setname_np(pthread_self(), "lot-ros-intake");
    std::unique_lock lock(mutex_);
    thread_ = std::this_thread::get_id();
    for (;;) {
      more_.wait(lock, [&] { return !work_.empty(); });
      const Work work = std::move(work_.front());
      work_.pop_front();
      at_work_for_ = work.owner;
      lock.unlock();
      try {
        work.callback->call();
      } catch (const std::exception& e) {
        ROS_ERROR("LOT: a message over TCPROS: %s", e.what());
      }
      lock.lock();
      at_work_for_ = 0;
      idle_.notify_all();
    }
  }

  lot::detail::Mutex mutex_{lot::detail::Rank::Intake};
  lot::detail::Condition more_, idle_;
  bool begun_ = false;
  std::thread::id thread_;
  std::deque<Work> work_;
  std::uint64_t at_work_for_ = 0;
};

/// A *sign* is a frame of one byte, which is no message: a probe or an invitation. It is
/// deserialised to a pointer to the place of its byte in this table.
constexpr std::uint8_t kSigns[256]{};
boost::shared_ptr<void const> sign(std::uint8_t byte) {
  return {&kSigns[byte], [](const void*) {}};
}
/// The byte of a sign. Nothing: it is a message.
std::optional<std::uint8_t> sign_of(const void* message) {
  const auto* const place = static_cast<const std::uint8_t*>(message);
  const bool is_sign =
      !std::less<>()(place, std::begin(kSigns)) && std::less<>()(place, std::end(kSigns));
  if (!is_sign) return std::nullopt;
  return static_cast<std::uint8_t>(place - kSigns);
}

bool is_latching(const boost::shared_ptr<::ros::M_string>& header) {
  const auto at = header->find("latching");
  return at != header->end() && at->second == "1";
}

/// The type that LOT's subscribers tell roscpp. No other callback is of this type, so no other
/// subscriber shares their deserialiser.
struct OurMessages {};
/// The type that LOT's subscribers tell this thread.
thread_local const std::type_info* said_type = &typeid(OurMessages);
/// When not null: an inlet that this thread asks for its type leaves its pointer here.
thread_local std::shared_ptr<Inlet>* found_inlet = nullptr;
/// While this thread sends past an inlet: that inlet alone says that it is of type Past.
struct Past {
  const Inlet* inlet;
};
thread_local const Past* past = nullptr;
/// The users to whose queues this thread adds callbacks just now.
thread_local std::vector<const Inlet::Adding*> adding_here;

/// Work for Intake's thread.
class Errand final : public ::ros::CallbackInterface {
 public:
  explicit Errand(std::function<void()> work) : work_(std::move(work)) {}
  CallResult call() override {
    work_();
    return Success;
  }

 private:
  const std::function<void()> work_;
};

}  // namespace

/// roscpp calls it for each frame of the topic's links.
class Inlet::Helper final : public ::ros::SubscriptionCallbackHelper {
 public:
  Helper(std::weak_ptr<Inlet> inlet, std::shared_ptr<Loop> loop, const detail::Kind& kind)
      : inlet_(std::move(inlet)), loop_(std::move(loop)), kind_(kind) {}

  ::ros::VoidConstPtr deserialize(
      const ::ros::SubscriptionCallbackHelperDeserializeParams& frame) override {
    if (frame.length < kind_.least_bytes) {
      return sign(frame.length == 1 ? *frame.buffer : kProbe);
    }
    return kind_.deserialise(frame.buffer, frame.length);
  }

  void call(::ros::SubscriptionCallbackHelperCallParams& params) override {
    const auto& event = params.event;
    const bool is_shared = event.nonConstWillCopy();  // a plain subscriber is on the link, too
    const auto sign = sign_of(event.getMessage().get());
    const bool is_probe = sign == kProbe;
    Frame frame{sign ? nullptr : event.getMessage(), event.getConnectionHeaderPtr(),
                participant_name(event.getPublisherName()), sign.value_or(kProbe)};
    loop_->soon([weak = inlet_, is_shared, is_probe, frame = std::move(frame)]() mutable {
      const auto inlet = weak.lock();
      if (!inlet) return;
      try {
        inlet->heard(frame.publisher, frame.header, is_shared);
      } catch (const std::exception& e) {  // a ring's; the frame may be another's
        ROS_ERROR("LOT: %s", e.what());
      }
      if (!is_probe) inlet->arrived(std::move(frame));
    });
  }

  const std::type_info& getTypeInfo() override {
    if (found_inlet != nullptr) *found_inlet = inlet_.lock();
    if (past != nullptr)
      return inlet_.lock().get() == past->inlet ? typeid(Past) : typeid(OurMessages);
    return *said_type;
  }
  bool isConst() override { return true; }
  bool hasHeader() override { return kind_.has_header; }

 private:
  const std::weak_ptr<Inlet> inlet_;
  const std::shared_ptr<Loop> loop_;
  const detail::Kind& kind_;
};

void Inlet::send_past(const Inlet* inlet, ::ros::SubscriberLink& link,
                      ::ros::SerializedMessage bytes) {
  const Disguise for_this_message(typeid(OurMessages));
  const Past here{inlet};
  past = &here;
  bytes.type_info = &typeid(Past);
  link.enqueueMessage(bytes, true, false);
}

Inlet::Disguise::Disguise(const std::type_info& type) noexcept
    : type_before_(std::exchange(said_type, &type)), past_before_(std::exchange(past, nullptr)) {}
Inlet::Disguise::~Disguise() {
  said_type = type_before_;
  past = static_cast<const Past*>(past_before_);
}

Inlet::Subscribers Inlet::on(::ros::SubscriberLink& link, const std::type_info& standard) {
  Subscribers found;
  bool is_ours = false;
  bool not_ours = false;
  const Disguise as_they_are(typeid(OurMessages));
  found_inlet = &found.inlet;
  link.getPublishTypes(not_ours, is_ours, typeid(OurMessages));
  found_inlet = nullptr;
  if (!not_ours) return found;
  bool not_plain = false;
  link.getPublishTypes(not_plain, found.plain, standard);
  const Disguise as_plain_ones(standard);
  bool plain_or_ours = false;
  link.getPublishTypes(found.others, plain_or_ours, standard);
  return found;
}

Inlet::Inlet(std::shared_ptr<Session> session, const ::ros::SubscribeOptions& options,
             const detail::Kind& kind)
    : loop_(session->loop()),
      topic_(options.topic),
      own_name_(participant_name(::ros::this_node::getName())),
      kind_(kind),
      session_(std::move(session)) {}

bool Inlet::open(::ros::NodeHandle& node, const ::ros::SubscribeOptions& asked) {
  const auto has_plain_ones = [this] {
    ::ros::V_string topics;
    ::ros::TopicManager::instance()->getSubscribedTopics(topics);
    return std::find(topics.begin(), topics.end(), topic_) != topics.end();
  };
  bool statistics = false;
  ::ros::param::get("/enable_statistics", statistics);
  if (statistics) {
    ROS_INFO("LOT: %s comes over TCPROS: /enable_statistics counts what links carry",
             topic_.c_str());
  } else if (session_->is_on()) {
    try {
      PullerOptions from_the_start;
      from_the_start.history = ~std::uint64_t{0};
      from_the_start.max_held_bytes = PullerOptions::kNoQuota;  // no callback says that it is full
      rings_ = lot::detail::make_selecting_puller(
          session_->participant(), session_->name_of(topic_), *kind_.layout, from_the_start);
      if (has_plain_ones()) rings_->decline();
      rings_->core().size();  // joins the rings, before a link says that we are here
      // This thread must not wait for LOT's thread here: LOT's thread may be giving a message to a
      // user's queue just now, and that queue may want to open another topic.
      loop_->soon([weak = weak_from_this()] {
        const auto self = weak.lock();
        if (!self || !self->rings_) return;
        self->loop_->arrivals().add(self->rings_->core(), [inlet = self.get()] { inlet->read(); });
      });
    } catch (const std::exception& e) {
      rings_.reset();
      ROS_WARN("LOT: %s comes over TCPROS: %s", topic_.c_str(), e.what());
    }
  }

  // By the name that the user has said, since roscpp remaps it once.
  ::ros::SubscribeOptions ours(asked.topic, std::max(asked.queue_size, kShortestIntake),
                               asked.md5sum, asked.datatype);
  if (asked.queue_size == 0) ours.queue_size = 0;  // no limit
  ours.helper = boost::make_shared<Helper>(weak_from_this(), loop_, kind_);
  ours.callback_queue = &Intake::the();
  ours.transport_hints = asked.transport_hints;
  ::ros::NodeHandle own(node);  // a copy: the user may shut its own down while other users stay
  expect_marker();              // roscpp may give us what links brought last
  subscriber_ = own.subscribe(ours);
  send_marker();
  return bool(subscriber_);
}

std::shared_ptr<Session> Inlet::close() {
  // The inlet leaves its rings first, so that no publisher selects it there when the link is
  // another inlet's.
  {
    decltype(rings_) rings;  // all destroyed when LOT's thread may go on
    decltype(unclaimed_) unclaimed;
    decltype(held_) held;
    decltype(taken_) taken;
    decltype(latched_) latched;
    loop_->call([&] {
      if (rings_) loop_->arrivals().remove(rings_->core());
      rings.swap(rings_);
      unclaimed.swap(unclaimed_);
      held.swap(held_);
      const std::scoped_lock guard(mutex_, taken_mutex_);
      latched.swap(latched_);
      taken.swap(taken_);
      is_closed_ = true;
    });
  }
  subscriber_.shutdown();
  return std::move(session_);
}

// ---- LOT's thread -------------------------------------------------------------------------------

void Inlet::read() {
  if (!rings_) return;
  // LOT's thread delivers so many in one round of its loop. Then it reads other topics. The loop
  // comes back while messages are there.
  if (std::exchange(turn_, loop_->turn_number()) != loop_->turn_number()) {
    may_deliver_ = at_once_.load(std::memory_order_relaxed);  // the number is all that it tells
  }
  deliver_claimed();
  for (; may_deliver_ > 0; --may_deliver_) {
    lot::detail::Borrowed borrowed;
    lot::detail::PullerCore& puller = rings_->core();
    if (puller.borrow(borrowed, lot::detail::Limit::now()) != Status::Ok) break;
    const struct End {
      lot::detail::PullerCore& puller;
      ~End() { puller.done(); }
    } end{puller};
    const lot::detail::Kept kept = puller.keep();
    borrowed.control = kept.control;
    borrowed.root = kept.root;
    claim({kind_.adopt(borrowed), rings_->origin()});
  }
  deliver_claimed();
  if (has_claimed()) {
    if (std::exchange(reads_again_, true)) return;
    loop_->soon([weak = weak_from_this()] {
      const auto self = weak.lock();
      if (!self) return;
      self->reads_again_ = false;
      self->read();
    });
  } else {
    deliver_held();
  }
}

/// Delivers kept messages that the publisher has said to be for this inlet, as many as it may in
/// this round.
void Inlet::deliver_claimed() {
  for (auto ring = unclaimed_.begin(); ring != unclaimed_.end();) {
    auto& waiting = ring->second.messages;
    while (may_deliver_ > 0 && !waiting.empty() && deliver_if_ours(waiting.front())) {
      waiting.pop_front();
      --may_deliver_;
    }
    const bool is_over = waiting.empty() || (may_deliver_ > 0 && !may_be_ours_yet(waiting.front()));
    ring = is_over ? unclaimed_.erase(ring) : std::next(ring);
  }
}

/// True when kept messages may be left for the next round. It does not ask whether they are for
/// this inlet: a caller of is_ours() that gets true must deliver.
bool Inlet::has_claimed() const { return may_deliver_ == 0 && !unclaimed_.empty(); }

/// Delivers a pulled message if it is for this inlet. Keeps it if older ones of its ring are kept,
/// or if the publisher may yet say that it is for this inlet.
void Inlet::claim(Pulled pulled) {
  if (rings_->publisher(pulled.origin) == own_name_) return;  // its outlet calls take()
  const RingName name(pulled.origin.channel, pulled.origin.generation);
  const auto ring = unclaimed_.find(name);
  if (ring == unclaimed_.end()) {
    if (!deliver_if_ours(pulled) && may_be_ours_yet(pulled)) {
      unclaimed_[name] = {{std::move(pulled)}, Loop::Clock::now()};
    }
    return;
  }
  auto& waiting = ring->second.messages;
  waiting.push_back(std::move(pulled));
  const std::size_t depth = rings_->depth({name.first, name.second, 0});
  const bool takes_long = Loop::Clock::now() - ring->second.since > kDecided;
  const std::size_t most = takes_long ? kMostUndecidedLater : most_undecided(depth);
  while (depth != 0 && waiting.size() > most) {
    deliver_if_ours(waiting.front());
    waiting.pop_front();
  }
}

/// False when the publisher's link brings the messages of this ring.
bool Inlet::may_be_ours_yet(const Pulled& pulled) const {
  const auto link = links_.find(std::string(rings_->publisher(pulled.origin)));
  if (link == links_.end() || !link->second.idle_rings) return true;
  const auto& idle = *link->second.idle_rings;
  const RingName ring(pulled.origin.channel, pulled.origin.generation);
  return std::find(idle.begin(), idle.end(), ring) == idle.end();
}

/// Delivers the message if it is for this inlet. False: the publisher has yet to say so.
bool Inlet::deliver_if_ours(const Pulled& pulled) {
  const auto is_ours = rings_->is_ours(pulled.origin);
  if (!is_ours) return false;
  if (*is_ours) {
    const std::string publisher(rings_->publisher(pulled.origin));
    deliver(pulled.message, publisher, header_of(publisher));
  }
  return true;
}

/// Takes from a frame what it says: whether a plain subscriber gets what the link brings, too, and
/// what the link knows of its publisher. Answers the publisher by decline() or confirm().
void Inlet::heard(const std::string& publisher, const Header& header, bool is_shared) {
  Link& link = links_[publisher];
  if (link.alive.lock() != header) {
    link = {boost::make_shared<::ros::M_string>(*header), header, 0, Loop::Clock::now()};
    Calls calls;
    Last old;  // destroyed after the mutex is released
    const std::lock_guard guard(mutex_);
    if (!std::exchange(forgetting_, true)) forget_later();
    const auto last = latched_.find(publisher);
    // A message that this process itself has handed over has nothing to do with a link.
    const bool is_links =
        publisher != own_name_ || (last != latched_.end() && last->second.alive.expired());
    if (last != latched_.end() && is_links) {
      if (last->second.is_known || !is_latching(header)) {  // it is an earlier link's, or of none
        old = std::move(last->second);
        latched_.erase(last);
      } else {
        last->second.header = link.header;
        last->second.alive = link.alive;
        last->second.is_known = true;
        for (const std::uint64_t name : std::exchange(last->second.late, {})) {
          const auto user = users_.find(name);
          if (user != users_.end()) give(user->second, last->second.message, link.header, calls);
        }
      }
    }
  }
  if (!rings_) return;
  is_shared ? rings_->decline() : rings_->confirm();
  read();
}

void Inlet::arrived(Frame frame) {
  const auto is_held = [&](const Frame& f) { return f.publisher == frame.publisher; };
  const bool is_behind =
      rings_ && (has_claimed() || std::any_of(held_.begin(), held_.end(), is_held));
  if (frame.is_marker) {
    if (!is_behind) return handle(frame);
    held_.push_back(std::move(frame));
    return read();
  }
  Link& link = links_[frame.publisher];
  if (rings_ && !link.idle_rings && Loop::Clock::now() - link.since > kDecided) {
    link.idle_rings.emplace();
    for (const auto& ring : rings_->rings_of(frame.publisher)) {
      link.idle_rings->emplace_back(ring.channel, ring.generation);
    }
  }
  if (rings_) link.had += rings_->resent(frame.publisher);
  if (!frame.message) link.had = 0;  // they came before the invitation, or were lost
  if (link.had != 0) {
    --link.had;
    return;
  }
  if (is_behind || (rings_ && rings_->has_remaining(frame.publisher))) {
    held_.push_back(std::move(frame));
    read();
  } else {
    handle(frame);
  }
}

/// Handles a frame: a message, an invitation, or a marker. All messages that its publisher
/// sent before it have been delivered.
void Inlet::handle(const Frame& frame) {
  if (frame.is_marker) {
    {
      const std::lock_guard guard(taken_mutex_);
      ++markers_passed_;
    }
    return deliver_in_turn();
  }
  if (frame.message) return deliver(frame.message, frame.publisher, header_of(frame.publisher));
  if (!rings_) return;
  Link& link = links_[frame.publisher];
  link.idle_rings.reset();
  link.since = Loop::Clock::now();
  for (const auto& ring : rings_->join_anew(frame.publisher, frame.invitation)) {
    unclaimed_.erase(RingName(ring.channel, ring.generation));  // the inlet reads it again
  }
}

void Inlet::deliver_held() {
  if (!rings_) return;
  for (auto frame = held_.begin(); frame != held_.end();) {
    if (rings_->has_remaining(frame->publisher)) {
      ++frame;
      continue;
    }
    handle(*frame);
    frame = held_.erase(frame);
  }
}

/// Forgets publishers whose link is gone and whose ring is read: they latch nothing any more.
void Inlet::forget_those_gone() {
  const auto is_gone = [this](const std::string& publisher) {
    const auto link = links_.find(publisher);
    return (link == links_.end() || link->second.alive.expired()) &&
           !(rings_ && publisher != own_name_ && rings_->has_publisher(publisher));
  };
  std::vector<Last> gone;  // destroyed after the mutex is released
  const std::lock_guard guard(mutex_);
  for (auto last = latched_.begin(); last != latched_.end();) {
    if (!last->second.alive.expired() || !is_gone(last->first)) {
      ++last;
      continue;
    }
    gone.push_back(std::move(last->second));
    last = latched_.erase(last);
  }
  for (auto link = links_.begin(); link != links_.end();) {
    link = is_gone(link->first) ? links_.erase(link) : std::next(link);
  }
  forgetting_ = !latched_.empty() || !links_.empty();
  if (forgetting_) forget_later();
}
void Inlet::forget_later() {
  loop_->at(Loop::Clock::now() + kForgetPeriod, [weak = weak_from_this()] {
    if (const auto inlet = weak.lock()) inlet->forget_those_gone();
  });
}

/// The connection header of a publisher: as its link says, or what is known without a link.
Inlet::Header Inlet::header_of(const std::string& publisher) const {
  if (const auto at = links_.find(publisher); at != links_.end()) return at->second.header;
  return link_header(kind_, topic_, publisher);
}

std::optional<bool> Inlet::latches(const std::string& publisher) const {
  const std::lock_guard guard(mutex_);
  const auto last = latched_.find(participant_name(publisher));
  if (last == latched_.end()) return false;
  if (!last->second.is_known) return std::nullopt;
  return is_latching(last->second.header);
}

/// Puts a message into the queues of all users.
void Inlet::deliver(const boost::shared_ptr<void const>& message, const std::string& publisher,
                    const Header& header) {
  Calls calls;
  Last last;  // destroyed after the mutex is released
  const auto link = links_.find(publisher);
  const std::lock_guard guard(mutex_);
  const bool is_known = link != links_.end() && !link->second.alive.expired();
  if (!is_known || is_latching(header)) {
    last = {message, header, is_known ? link->second.alive : decltype(Last::alive)(), is_known};
    remember(publisher, last);
  }
  for (const auto& [name, user] : users_) give(user, message, header, calls);
}

/// Remembers the last message of a publisher. `last` has the one before then: the caller destroys
/// it when it has released the mutex.
void Inlet::remember(const std::string& publisher, Last& last) {
  std::swap(last, latched_[publisher]);
  if (!std::exchange(forgetting_, true)) forget_later();
}

/// Puts a message into one user's queue, whose order is final.
void Inlet::give(const User& user, const boost::shared_ptr<void const>& message,
                 const Header& header, Calls& calls) {
  ::ros::SerializedMessage made;
  made.message = message;
  made.type_info = kind_.type;
  const auto deserializer =
      boost::make_shared<::ros::MessageDeserializer>(user.helper, made, header);
  bool was_full = false;
  // Other subscribers may have the message: a callback that changes it gets a copy.
  user.queue->push(user.helper, deserializer, user.has_tracked_object, user.tracked_object, true,
                   ::ros::Time::now(), &was_full);
  if (was_full) return;
  if (user.callbacks == immediate_queue()) {
    loop_->afterwards(
        [queue = user.queue, id = user.id()] { ImmediateQueue::the().call(queue, id); });
  } else {
    calls.add(*this, user);
  }
}

void Inlet::Calls::add(Inlet& inlet, const User& user) {
  calls_.push_back({inlet.shared_from_this(), user.callbacks, user.queue, user.adding});
}

Inlet::Calls::~Calls() {
  if (calls_.empty()) return;
  Loop& loop = *calls_.front().inlet->loop_;
  if (loop.has_turn()) {
    loop.afterwards([calls = std::move(calls_)] {
      for (const Call& call : calls) call.make();
    });
  } else {
    for (const Call& call : calls_) call.make();
  }
}

void Inlet::Calls::Call::make() const noexcept {
  {
    const std::lock_guard guard(inlet->mutex_);
    if (adding->is_removed) return;
    ++adding->threads;
  }
  adding_here.push_back(adding.get());
  try {
    callbacks->addCallback(queue, id_of(queue));
  } catch (const std::exception& e) {  // thrown by a queue that calls at once
    ROS_ERROR("LOT: %s: %s", inlet->topic_.c_str(), e.what());
  } catch (...) {
    ROS_ERROR("LOT: %s: a callback queue has thrown something that is no std::exception",
              inlet->topic_.c_str());
  }
  adding_here.pop_back();
  const std::lock_guard guard(inlet->mutex_);
  --adding->threads;
  inlet->added_.notify_all();
}

// ---- from publishers of this process ------------------------------------------------------------

Inlet::Taken Inlet::take(Taken taken, std::size_t depth) {
  Taken dropped{};
  const std::lock_guard guard(taken_mutex_);
  if (is_closed_) return taken;
  // Relaxed: the number is all that it tells.
  if (taken_.size() >= std::max(depth, most_waiting_.load(std::memory_order_relaxed))) {
    // What is latched must be remembered: it drops the oldest message that is not latched, and a
    // latched one only if all are.
    const auto oldest =
        std::find_if(taken_.begin(), taken_.end(), [](const Taken& t) { return !t.latched_by; });
    const auto at = oldest != taken_.end() ? oldest : taken_.begin();
    dropped = std::move(*at);
    taken_.erase(at);
  }
  taken.behind = markers_;
  taken_.push_back(std::move(taken));
  return dropped;
}

void Inlet::expect_marker() {
  const std::lock_guard guard(taken_mutex_);
  ++markers_;
}

/// Sends a marker behind the frames that links have brought so far, through Intake's thread and
/// LOT's thread. It may pass for one that was expected earlier: the frames before that one are
/// before this one, too.
void Inlet::send_marker() {
  const auto come = [weak = weak_from_this(), loop = loop_] {
    loop->soon([weak] {
      const auto inlet = weak.lock();
      if (!inlet) return;
      Frame last{};
      last.publisher = inlet->own_name_;
      last.is_marker = true;
      inlet->arrived(std::move(last));
    });
  };
  Intake::the().addCallback(boost::make_shared<Errand>(come), 0);
}

void Inlet::follow_links() {
  expect_marker();
  send_marker();
}

void Inlet::deliver_taken() {
  if (loop_->has_turn()) return deliver_in_turn();
  // Relaxed: a user that is added now could as well have been added behind this look.
  if (calls_at_once_.load(std::memory_order_relaxed)) return deliver_soon();
  std::size_t here = 0;  // messages that come meanwhile are delivered by their own threads
  {
    const std::lock_guard guard(taken_mutex_);
    here = taken_.size();
  }
  while (here-- > 0 && deliver_next()) {
  }
}

/// Called by LOT's thread: delivers as many messages as it may before it calls callbacks.
void Inlet::deliver_in_turn() {
  if (std::exchange(turn_, loop_->turn_number()) != loop_->turn_number()) {
    may_deliver_ = at_once_.load(std::memory_order_relaxed);  // the number is all that it tells
  }
  for (; may_deliver_ > 0; --may_deliver_) {
    if (!deliver_next()) return;
  }
  deliver_soon();
}

void Inlet::deliver_soon() {
  loop_->soon([weak = weak_from_this()] {
    if (const auto inlet = weak.lock()) inlet->deliver_in_turn();
  });
}

/// Delivers the first waiting message. False: none waits, or the first one waits for a marker.
bool Inlet::deliver_next() {
  Calls calls;
  Taken next;  // destroyed, as `last`, when the mutexes are released
  Last last;
  const std::lock_guard guard(mutex_);
  {
    const std::lock_guard its_place(taken_mutex_);
    if (taken_.empty() || taken_.front().behind > markers_passed_) return false;
    next = std::move(taken_.front());
    taken_.pop_front();
  }
  if (next.latched_by) {
    last = {next.message, next.header, next.latched_by, true};
    remember(own_name_, last);
  }
  for (const auto& [name, user] : users_) give(user, next.message, next.header, calls);
  return true;
}

// ---- users --------------------------------------------------------------------------------------

std::uint64_t Inlet::add(const ::ros::SubscribeOptions& options, Calls& calls) {
  User user;
  user.helper = options.helper;
  user.callbacks = options.callback_queue;
  user.queue = boost::make_shared<::ros::SubscriptionQueue>(topic_, options.queue_size,
                                                            options.allow_concurrent_callbacks);
  user.has_tracked_object = options.tracked_object != nullptr;
  user.tracked_object = options.tracked_object;
  user.queue_size = options.queue_size;
  const std::lock_guard guard(mutex_);
  ++last_user_;
  for (auto& [publisher, last] : latched_) {
    if (!last.is_known) {
      last.late.push_back(last_user_);
    } else if (is_latching(last.header) && !last.alive.expired()) {
      give(user, last.message, last.header, calls);
    }
  }
  users_[last_user_] = std::move(user);
  count_at_once();
  return last_user_;
}

void Inlet::count_at_once() {
  std::uint32_t n = kAtOnce;
  bool is_at_once = false;
  std::size_t most = 0;
  for (const auto& [name, user] : users_) {
    most = std::max(most, user.queue_size == 0 ? ~std::size_t{0} : std::size_t{user.queue_size});
    if (user.callbacks != immediate_queue()) continue;
    is_at_once = true;
    if (user.queue_size != 0) n = std::min(n, user.queue_size);
  }
  // Relaxed, all: the users themselves are read with mutex_.
  at_once_.store(n, std::memory_order_relaxed);
  calls_at_once_.store(is_at_once, std::memory_order_relaxed);
  most_waiting_.store(most, std::memory_order_relaxed);
}

Inlet::User Inlet::remove(std::uint64_t name) {
  std::unique_lock lock(mutex_);
  const auto at = users_.find(name);
  User user = std::move(at->second);
  users_.erase(at);
  count_at_once();
  Adding& adding = *user.adding;
  adding.is_removed = true;
  const auto here =
      static_cast<unsigned>(std::count(adding_here.begin(), adding_here.end(), &adding));
  added_.wait(lock, [&] { return adding.threads == here; });
  return user;
}

bool Inlet::has_users() {
  const std::lock_guard guard(mutex_);
  return !users_.empty();
}

void Inlet::User::dismiss() {
  queue->clear();
  callbacks->removeByID(id());
}

}  // namespace lot::ros
