// SPDX-License-Identifier: Apache-2.0
/// The core of ShmQueue: a pusher and a puller, each made when it is first needed, for all threads.
#include <algorithm>
#include <mutex>

#include "lot/detail/core.hpp"

#include "futex/futex.hpp"
#include "transport/participant.hpp"
#include "transport/spin_habit.hpp"

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
    topic_ = participant_->enter_topic(name, type);
  }
  ~Queue() override {
    if (!participant_->inert()) participant_->leave_topic(topic_);
  }

  detail::Loan loan(const detail::MessageType& type) override { return pusher().loan(type, true); }

  Status put_unique(detail::ControlCell* cell, Clock::time_point deadline) override {
    return pusher().push_unique(cell, until(deadline));
  }
  Status put_shared(const detail::ControlCell* cell, const void* object,
                    Clock::time_point deadline) override {
    return pusher().push_shared(cell, object, until(deadline));
  }

  bool pop(detail::Borrowed& item, Wait wait, Clock::time_point deadline) override {
    participant_->check_usable();  // before the lock: a child may have inherited it
    detail::FutexWaits waits;
    std::optional<Clock::time_point> start;
    bool spinning = false;
    for (;;) {
      std::optional<Clock::time_point> again;
      {
        const std::lock_guard guard(mutex_);
        const bool found = puller().pull(item, false, {}, false) == Status::Ok;
        if (found && !spinning) return true;
        if (!found && wait == Wait::Never) return false;
        const auto now = Clock::now();
        if (!start) {
          start = now;
          spinning = habit_.worthwhile();
        }
        if (spinning && (found || habit_.enough(now - *start))) {
          spinning = false;
          habit_.spun(now - *start);
        }
        if (found) return true;
        if (wait == Wait::Until && now >= deadline) return false;
        if (!spinning) {
          waits.clear();
          again = puller().arm(waits);
          if (!again) continue;
        }
      }
      if (!again) {
        segment::Atomics::pause();
      } else if (wait == Wait::Until) {
        futex::wait_any(waits, std::min(*again, deadline));
      } else {
        futex::wait_any(waits, *again);
      }
    }
  }

  void listen() override {
    participant_->check_usable();  // before the lock: a child may have inherited it
    const std::lock_guard guard(mutex_);
    puller();
  }
  std::size_t size() override {
    participant_->check_usable();  // before the lock: a child may have inherited it
    const std::lock_guard guard(mutex_);
    return puller().size();
  }
  std::size_t capacity() const noexcept override { return putting_.depth; }

 private:
  static std::chrono::nanoseconds until(Clock::time_point deadline) {
    if (deadline == Clock::time_point::min()) return 0ns;
    const auto now = Clock::now();
    return deadline > now ? deadline - now : 0ns;
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
  std::mutex mutex_;  ///< the puller's and the habit's; nobody sleeps with it
  SpinHabit habit_;
  std::unique_ptr<detail::PullerCore> puller_;
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
