// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include "lot/detail/core.hpp"
#include "lot/duration.hpp"
#include "lot/envelope.hpp"
#include "lot/pointers.hpp"
#include "lot/stop_token.hpp"

namespace lot {

namespace detail {

/// How the command `lot` gets at a puller's core.
struct PullerAccess;

inline Envelope envelope_of(const PullerCore& core, std::uint64_t missed) {
  Envelope envelope = core.envelope();
  envelope.missed = missed;
  return envelope;
}

}  // namespace detail

/// A message that is looked at in place and not kept: cheaper than a pointer. One that has come in
/// a slot (PusherOptions::fast_lane) is a copy in private memory.
///
/// It ends with the object. While it lives the message can not change, however far the publisher
/// runs ahead. One at a time per puller, which it must not outlive.
///
/// Threads: one at a time, as its puller: what the thread of the puller and the thread of the
///          borrow do must not overlap.
/// Errors:  only keep() and envelope() throw.
/// Memory:  none: the reader's cell in the queue names the message. Its publisher cannot reuse the
///          message's memory meanwhile.
/// Crash:   another process frees the cell, and the publisher has the memory again.
template <class T>
class ShmBorrow {
 public:
  ShmBorrow() noexcept = default;
  ShmBorrow(ShmBorrow&& other) noexcept
      : core_(std::exchange(other.core_, nullptr)),
        borrowed_(std::exchange(other.borrowed_, detail::Borrowed())) {}
  ShmBorrow& operator=(ShmBorrow&& other) noexcept {
    if (this != &other) {
      end();
      core_ = std::exchange(other.core_, nullptr);
      borrowed_ = std::exchange(other.borrowed_, detail::Borrowed());
    }
    return *this;
  }
  ~ShmBorrow() { end(); }

  /// False: no message came, or the borrow has ended.
  [[nodiscard]] explicit operator bool() const noexcept { return core_ != nullptr; }
  /// The message where it lies, or null.
  const T* get() const noexcept { return static_cast<const T*>(borrowed_.root); }
  /// The message. REQUIRES: there is one.
  const T& operator*() const noexcept { return *get(); }
  /// A member of the message. REQUIRES: there is one.
  const T* operator->() const noexcept { return get(); }

  /// Messages that this reader missed just before this one.
  std::uint64_t missed() const noexcept { return borrowed_.missed; }
  /// Where the message comes from; empty where there is none. It is made when you ask. Throws
  /// lot::Error (ECHILD, ESTALE), std::bad_alloc.
  Envelope envelope() const {
    return core_ != nullptr ? detail::envelope_of(*core_, missed()) : Envelope();
  }

  /// A pointer to the message that outlives the borrow; null where there is none. Throws
  /// lot::Error: EDQUOT when the subscription holds all that it may
  /// (PullerOptions::max_held_bytes); ECHILD, ESTALE. lot::OutOfMemory when the message has come in
  /// a slot (PusherOptions::fast_lane), and there is no block for the copy.
  [[nodiscard]] ShmSharedPtr<const T> keep() const {
    if (core_ == nullptr) return {};
    const detail::Kept kept = core_->keep();
    return detail::PointerAccess::shared(static_cast<const T*>(kept.root), kept.control);
  }

  /// Ends the borrow early.
  void end() noexcept {
    if (core_ != nullptr) std::exchange(core_, nullptr)->done();
    borrowed_ = detail::Borrowed();
  }

 private:
  template <class U>
  friend class ShmPuller;

  detail::PullerCore* core_ = nullptr;
  detail::Borrowed borrowed_;
};

/// Receives the messages of a topic, from all its publishers; those that come later are found.
///
/// Threads: one at a time.
/// Errors:  lot::Error: ECHILD in a forked child, ESTALE in a process that was taken for dead;
///          EBUSY when this puller has a borrow that has not ended, and with QueueEngine::Mutex
///          when a stopped process keeps the queue's lock for five seconds; EBADMSG for a message
///          that another process has damaged: it counts as missed, and the next look goes on behind
///          it. std::bad_alloc when there is no memory to join a new publisher. That nothing came
///          is no error: see status().
/// Memory:  a cell in the queue of each publisher of the topic. What is pulled stays in the segment
///          until its last pointer has gone, at most PullerOptions::max_held_bytes of it.
/// Crash:   another process frees its cells, and a publisher that waits for it goes on.
template <class T>
class ShmPuller {
 public:
  /// For ShmEngine::subscribe(). Throws nothing.
  explicit ShmPuller(std::unique_ptr<detail::PullerCore> core) : core_(std::move(core)) {}

  /// The next message, or null; status() says why, missed() how many were lost before it. Never
  /// waits, also not for the registry's lock: while another thread or process has it, a publisher
  /// that has just come is found 5 ms later. Throws lot::Error as the class says.
  [[nodiscard]] ShmSharedPtr<const T> try_pull() { return pull_kept(detail::Limit::now()); }
  /// The next message, or null: none came in time; its last publisher has gone meanwhile; it was
  /// told to stop; or one came a second ago that may not be kept (HoldsTooMuch). status() says
  /// which. Throws lot::Error as the class says.
  [[nodiscard]] ShmSharedPtr<const T> pull(Duration timeout, const StopToken& stop = {}) {
    return pull_kept(detail::Limit::until(detail::after(timeout), stop));
  }
  /// The same until a time of the steady clock. Throws the same.
  [[nodiscard]] ShmSharedPtr<const T> pull_until(Deadline deadline, const StopToken& stop = {}) {
    return pull_kept(detail::Limit::until(deadline, stop));
  }
  /// The same without a limit. A signal handler does not end it, but by a StopToken. Throws the
  /// same.
  [[nodiscard]] ShmSharedPtr<const T> pull(const StopToken& stop = {}) {
    return pull_kept(detail::Limit::forever(stop));
  }

  /// The next message in place, or an empty borrow; status() and missed() as after try_pull().
  /// Never waits. Throws lot::Error as the class says.
  [[nodiscard]] ShmBorrow<T> try_borrow() { return look(detail::Limit::now()); }
  /// The next message in place; empty when none came in time, when the last publisher has gone
  /// meanwhile, or when it was told to stop. Throws the same.
  [[nodiscard]] ShmBorrow<T> borrow(Duration timeout, const StopToken& stop = {}) {
    return look(detail::Limit::until(detail::after(timeout), stop));
  }
  /// The same until a time of the steady clock. Throws the same.
  [[nodiscard]] ShmBorrow<T> borrow_until(Deadline deadline, const StopToken& stop = {}) {
    return look(detail::Limit::until(deadline, stop));
  }
  /// The same without a limit. Throws the same.
  [[nodiscard]] ShmBorrow<T> borrow(const StopToken& stop = {}) {
    return look(detail::Limit::forever(stop));
  }

  /// How the last pull or borrow ended:
  ///
  ///     Ok             there is a message
  ///     Empty          of a try_: there is none now
  ///     Timeout        none came in time
  ///     PublisherGone  there is none, and no publisher now, or yet
  ///     HoldsTooMuch   of a pull: the process may keep no more; it waits a second at most
  ///     Stopped        its StopToken was told to stop; messages may be there
  ///
  /// A wait ends at once when the last publisher goes whose messages this puller has read, and does
  /// so once: the next one waits for another publisher, as one does that begins before there is
  /// any.
  Status status() const noexcept { return status_; }
  /// Messages lost to this reader just before the last one that it got.
  std::uint64_t missed() const noexcept { return missed_; }
  /// Where the last message that it got comes from; empty before the first. It is made when you
  /// ask: ask for the time of the push while you have the message. Throws lot::Error (ECHILD,
  /// ESTALE), std::bad_alloc.
  Envelope envelope() const { return detail::envelope_of(*core_, missed_); }
  /// All that were lost to it, also those after the last message that it got.
  std::uint64_t missed_total() const noexcept { return missed_total_; }
  /// Publishers of the topic that are there now. It may wait for other processes that advertise,
  /// subscribe or leave. Throws lot::Error: EBUSY when a stopped one keeps it waiting, five seconds
  /// at most; ECHILD, ESTALE.
  std::size_t publishers() { return core_->publishers(); }
  /// Messages that are there to be read. Throws lot::Error (ECHILD, ESTALE).
  std::size_t size() { return core_->size(); }

  /// A descriptor for epoll, poll, Asio or GLib: readable (level-triggered) from when a message may
  /// have come until try_pull() or try_borrow() has found none. It may say so for nothing, each
  /// second at most (each 10 ms while the subscription holds too much). From the first call on, a
  /// thread of the library's watches the queue whenever a look has found nothing. It belongs to the
  /// puller, which closes it. Throws lot::Error: EMFILE, ENFILE or ENOMEM where there is no
  /// descriptor, EAGAIN where there is no thread; ECHILD, ESTALE.
  int fd() { return core_->fd(); }

 private:
  friend class WaitSet;
  friend class ShmListener;
  friend struct detail::PullerAccess;

  ShmSharedPtr<const T> pull_kept(detail::Limit limit) {
    detail::Borrowed kept;
    status_ = core_->pull(kept, limit);
    count(kept);
    if (status_ != Status::Ok) return {};
    return detail::PointerAccess::shared(static_cast<const T*>(detail::alone(kept.root)),
                                         detail::alone(kept.control));
  }
  ShmBorrow<T> look(detail::Limit limit) {
    ShmBorrow<T> borrow;  // filled where it stays: see detail::alone()
    status_ = core_->borrow(borrow.borrowed_, limit);
    count(borrow.borrowed_);
    if (status_ == Status::Ok) {
      borrow.core_ = core_.get();
    } else {
      borrow.borrowed_ = detail::Borrowed();
    }
    return borrow;
  }
  /// A look that found no message may have found that some were lost: those count at once in the
  /// total, and in missed() with the next message.
  void count(detail::Borrowed& borrowed) noexcept {
    missed_total_ += borrowed.missed;
    borrowed.missed += std::exchange(untold_, 0);
    (status_ == Status::Ok ? missed_ : untold_) = borrowed.missed;
  }

  std::unique_ptr<detail::PullerCore> core_;
  Status status_ = Status::Empty;
  std::uint64_t missed_ = 0;
  std::uint64_t missed_total_ = 0;
  std::uint64_t untold_ = 0;  ///< lost since the last message
};

}  // namespace lot
