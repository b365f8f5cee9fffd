// SPDX-License-Identifier: Apache-2.0
/// The core of ShmQueue: one pusher and one puller for all threads. Each is made when it is first
/// needed.
#include <algorithm>
#include <cerrno>
#include <mutex>

#include "lot/detail/core.hpp"
#include "lot/detail/mutex.hpp"

#include "futex/futex.hpp"
#include "transport/participant.hpp"
#include "waiting/notifier.hpp"
#include "waiting/waiting.hpp"

namespace lot::transport {
namespace {

using detail::Clock;
using namespace std::chrono_literals;

class Queue final : public detail::QueueCore {
 public:
  Queue(std::shared_ptr<Participant> participant, std::string_view name,
        const detail::MessageType& type, const PusherOptions& putting, const PullerOptions& popping,
        detail::Delivery delivery)
      : participant_(std::move(participant)),
        name_(name),
        type_(type),
        putting_(putting),
        popping_(popping),
        delivery_(delivery),
        habit_(popping.wait) {
    check_depth(name, putting.depth);
    if (has_workers() && putting.policy == Policy::Overwrite) {
      throw Error(EINVAL, std::string(name), "a queue that redelivers cannot overwrite its items",
                  "use Policy::Block or Policy::Refuse");
    }
    topic_ = participant_->topics().enter(name, type);
  }
  ~Queue() override {
    if (participant_->inert()) {
      (void)notifier_.release();  // a forked child has no such thread
      return;
    }
    notifier_.reset();
    for (const detail::Borrowed& item : returned_) put_back(item);
    participant_->topics().leave(topic_);
  }

  detail::Loan loan(const detail::MessageType& type) override { return pusher().loan(type, true); }

  Status put_unique(detail::ControlBlock* control, detail::Limit limit) override {
    return pusher().push_unique(control, {time_of(limit), limit.stop()});
  }
  Status put_shared(detail::ControlBlock* control, const void* object,
                    detail::Limit limit) override {
    return pusher().push_shared(control, object, {time_of(limit), limit.stop()});
  }

  bool take(detail::Claim& claim, detail::Limit limit) override {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    if (!has_workers()) {
      throw Error(EINVAL, name_, "the queue was made without QueueOptions::redeliver",
                  "pop its items, or set redeliver in each process that uses it");
    }
    Place place(*this, false);
    return look_or_wait(claim.item, limit, place, &claim);
  }
  void finish(const detail::Claim& claim) override {
    participant_->check_usable();
    {
      const std::lock_guard guard(mutex_);
      puller_->finish(claim);
    }
    claim.item.control->drop_pointer();
  }
  void give_back(const detail::Claim& claim) noexcept override {
    if (participant_->inert()) return;
    {
      const std::lock_guard guard(mutex_);
      puller_->give_back(claim);
    }
    claim.item.control->drop_pointer();
  }

  bool pop(detail::Borrowed& item, detail::Limit limit, bool may_come_back) override {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    if (has_workers()) {
      throw Error(EINVAL, name_, "an item of a queue that redelivers cannot be popped",
                  "wait_and_take() it, and finish() it when it is done");
    }
    Place place(*this, may_come_back);
    if (!look_or_wait(item, limit, place, nullptr)) return false;
    place.keep();
    return true;
  }

  // Relaxed: see Place::reserve().
  void copied() noexcept override { in_hand_.fetch_sub(1, std::memory_order_relaxed); }

  void hand_back(const detail::Borrowed& item) noexcept override {
    if (participant_->inert()) return;
    const std::lock_guard guard(mutex_);
    returned_.push_back(item);  // its pop has made room
    copied();
    wake_waiters();
  }

  void listen() override {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    const std::lock_guard guard(mutex_);
    puller();
  }
  std::size_t size() override {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    const std::lock_guard guard(mutex_);
    return returned_.size() + puller().size();
  }
  std::size_t capacity() const noexcept override { return putting_.depth; }

  int fd() override {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    const std::lock_guard guard(mutex_);
    if (!notifier_) {
      notifier_ = std::make_unique<waiting::Notifier>(participant_->descriptors());
      notifier_->watch(held_);
    }
    return notifier_->fd();
  }
  bool ready() override {
    const std::lock_guard guard(mutex_);
    return has_items();
  }
  std::optional<Clock::time_point> arm(detail::FutexWaits& waits) override {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    const std::lock_guard guard(mutex_);
    return arm_held(waits);
  }
  std::shared_ptr<waiting::EarOwner> ear_owner() noexcept override { return participant_; }

 private:
  /// Keeps room in returned_ for the item of one pop, from before the pop looks until its item is
  /// copied.
  class Place {
   public:
    Place(Queue& queue, bool is_needed) : queue_(queue), is_needed_(is_needed) {}
    ~Place() {
      if (has_) queue_.copied();
    }
    Place(const Place&) = delete;
    Place& operator=(const Place&) = delete;
    /// REQUIRES: the queue's mutex.
    void reserve() {
      if (!is_needed_ || has_) return;
      // Relaxed, here and elsewhere: in_hand_ grows only under the mutex. If it is less by now,
      // there is more room than needed.
      const std::size_t in_hand = queue_.in_hand_.load(std::memory_order_relaxed);
      queue_.returned_.reserve(queue_.returned_.size() + in_hand + 1);
      queue_.in_hand_.fetch_add(1, std::memory_order_relaxed);  // as above
      has_ = true;
    }
    /// Leaves the room to copied() or hand_back(), which give it up.
    void keep() noexcept { has_ = false; }

   private:
    Queue& queue_;
    bool is_needed_;
    bool has_ = false;
  };

  bool has_workers() const { return delivery_ == detail::Delivery::ToWorker; }

  /// Looks for an item, and waits as `limit` says. With a claim, it also notes where the item lies
  /// in the queue.
  bool look_or_wait(detail::Borrowed& item, detail::Limit limit, Place& place,
                    detail::Claim* claim) {
    if (limit.is_stopped()) return false;
    ForItem next(*this, item, place, claim);
    if (next.look()) return true;
    if (limit.waits() && waiting::wait(next, limit.deadline(), limit.stop())) return true;
    if (notifier_) notifier_->watch(held_);
    return false;
  }

  /// The queue as its notifier sees it, which is told of it by a thread that has the mutex.
  struct Held : detail::Waitable {
    explicit Held(Queue& queue) : queue_(queue) {}
    bool ready() override { return queue_.has_items(); }
    std::optional<Clock::time_point> arm(detail::FutexWaits& waits) override {
      return queue_.arm_held(waits);
    }

   private:
    Queue& queue_;
  };
  /// Both REQUIRE mutex_.
  bool has_items() { return !returned_.empty() || puller().ready(); }
  std::optional<Clock::time_point> arm_held(detail::FutexWaits& waits) {
    if (!returned_.empty()) return std::nullopt;
    return puller().arm(waits);
  }

  /// How a pop and a take wait for an item. It has the queue's mutex, except while it waits.
  struct ForItem : waiting::Steps<ForItem> {
    ForItem(Queue& queue, detail::Borrowed& item, Place& place, detail::Claim* claim)
        : queue_(queue), item_(item), place_(place), claim_(claim), lock_(queue.mutex_) {}
    bool look() {
      place_.reserve();
      if (!queue_.look(item_)) return false;
      if (claim_ != nullptr) queue_.puller().describe(*claim_);
      return true;
    }
    waiting::SpinHabit* spins() noexcept { return &queue_.habit_; }
    std::optional<waiting::Sleep<detail::FutexWaits&>> arm() {
      waits_.clear();
      if (const auto again = queue_.puller().arm(waits_)) return {{waits_, again}};
      lock_.unlock();  // other threads of this handle get in, however often this one has to look
      lock_.lock();
      return std::nullopt;
    }
    void unlock() { lock_.unlock(); }
    void lock() { lock_.lock(); }

   private:
    Queue& queue_;
    detail::Borrowed& item_;
    Place& place_;
    detail::Claim* claim_;
    std::unique_lock<detail::Mutex> lock_;
    detail::FutexWaits waits_;
  };

  /// Takes an item that came back first: it is older than what lies in the queue. REQUIRES: mutex_.
  bool look(detail::Borrowed& item) {
    if (returned_.empty()) {
      const Status status = puller().pull(item, detail::Limit::now());
      if (status == Status::HoldsTooMuch) puller().refuse_to_hold();
      return status == Status::Ok;
    }
    item = returned_.front();
    returned_.erase(returned_.begin());
    return true;
  }

  /// Wakes the threads of this handle that sleep on the puller's words. A thread that has not begun
  /// to sleep misses the wake-up and sleeps until it looks again by itself, after a second at most.
  /// REQUIRES: mutex_.
  void wake_waiters() noexcept {
    try {
      detail::FutexWaits waits;
      puller().arm(waits);
      puller().ring_own_ears();
      for (const auto& wait : waits) futex::wake_all(wait.word);
    } catch (const std::exception&) {  // no memory: they look by themselves after a second
    }
  }

  /// The handle is destroyed: puts an item that came back to it into the queue, so that another
  /// handle can get it.
  void put_back(const detail::Borrowed& item) noexcept {
    try {
      if (pusher().push_unique(item.control, {0ns}) == Status::Ok) return;
    } catch (const std::exception&) {  // no memory, or no room for another ring
    }
    item.control->drop_pointer();
  }

  static std::chrono::nanoseconds time_of(detail::Limit limit) {
    if (!limit.waits()) return 0ns;
    const auto deadline = limit.deadline();
    if (!deadline) return std::chrono::nanoseconds::max();
    const auto now = Clock::now();
    return *deadline > now ? *deadline - now : 0ns;  // no difference that overflows
  }

  detail::PusherCore& pusher() {
    participant_->check_usable();
    std::call_once(pusher_made_, [this] {
      pusher_ = detail::make_pusher(participant_, name_, type_, putting_, delivery_);
    });
    return *pusher_;
  }
  /// REQUIRES: mutex_.
  detail::PullerCore& puller() {
    if (!puller_) puller_ = detail::make_puller(participant_, name_, type_, popping_, delivery_);
    return *puller_;
  }

  std::shared_ptr<Participant> participant_;
  std::string name_;
  const detail::MessageType& type_;
  PusherOptions putting_;
  PullerOptions popping_;
  detail::Delivery delivery_;
  std::uint32_t topic_;
  std::once_flag pusher_made_;
  std::unique_ptr<detail::PusherCore> pusher_;
  /// guards what follows; no thread sleeps while it holds it
  detail::Mutex mutex_{detail::Rank::Queue};
  waiting::SpinHabit habit_;
  std::unique_ptr<detail::PullerCore> puller_;
  Held held_{*this};
  std::unique_ptr<waiting::Notifier> notifier_;  ///< once fd() was called
  /// Items that this handle has taken and could not copy. There is room for in_hand_ more.
  std::vector<detail::Borrowed> returned_;
  std::atomic<std::size_t> in_hand_{0};  ///< pops that may hand an item back, or look for one
};

}  // namespace
}  // namespace lot::transport

namespace lot::detail {

std::unique_ptr<QueueCore> make_queue(std::shared_ptr<transport::Participant> participant,
                                      std::string_view name, const MessageType& type,
                                      const PusherOptions& putting, const PullerOptions& popping,
                                      Delivery delivery) {
  participant->check_usable();
  return std::make_unique<transport::Queue>(std::move(participant), name, type, putting, popping,
                                            delivery);
}

}  // namespace lot::detail
