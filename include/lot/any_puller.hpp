// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

#include "lot/any_message.hpp"
#include "lot/detail/core.hpp"
#include "lot/duration.hpp"
#include "lot/envelope.hpp"
#include "lot/puller.hpp"
#include "lot/stop_token.hpp"
#include "lot/wait_set.hpp"

namespace lot {

/// A message of any type that is looked at in place and not kept: as ShmBorrow.
///
/// Threads: one at a time, as its puller.
/// Errors:  root(), keep() and envelope() throw.
/// Memory:  none: the reader's cell in the queue names the message.
/// Crash:   as ShmBorrow.
class AnyBorrow {
 public:
  /// Empty.
  AnyBorrow() noexcept = default;
  /// For AnyPuller. Throws nothing.
  AnyBorrow(ShmBorrow<std::byte> borrow, AnyType type) noexcept
      : borrow_(std::move(borrow)), type_(std::move(type)) {}

  /// False: no message came, or the borrow has ended.
  [[nodiscard]] explicit operator bool() const noexcept { return static_cast<bool>(borrow_); }
  /// The message, to be read as long as this lives. REQUIRES: there is one. Throws lot::Error:
  /// EBADMSG when the description is damaged; ECHILD.
  Value root() const {
    return detail::borrowed_value_of(type_.description(), borrow_.get(), type_.size());
  }
  /// Where it lies, so many bytes as its type says; null: there is none. Throws nothing.
  const void* data() const noexcept { return borrow_.get(); }
  /// What it is. Throws nothing.
  const AnyType& type() const noexcept { return type_; }
  /// Messages that this reader missed just before this one.
  std::uint64_t missed() const noexcept { return borrow_.missed(); }
  /// Where the message comes from; empty where there is none. It is made when you ask. Throws
  /// lot::Error (ECHILD, ESTALE), std::bad_alloc.
  Envelope envelope() const { return borrow_.envelope(); }
  /// The message, to be kept longer than the borrow; null where there is none. Throws lot::Error as
  /// ShmBorrow::keep().
  [[nodiscard]] AnyMessage keep() const {
    auto kept = borrow_.keep();
    return kept ? AnyMessage(std::move(kept), type_) : AnyMessage();
  }
  /// Ends the borrow early.
  void end() noexcept { borrow_.end(); }

 private:
  ShmBorrow<std::byte> borrow_;
  AnyType type_;
};

/// Receives the messages of a topic without having their type: as ShmPuller. For
/// ShmEngine::subscribe_any().
///
/// Threads: one at a time.
/// Errors:  as ShmPuller; ESTALE as well when it is an observer, and others have made the topic
///          anew with another type: subscribe again.
/// Memory:  as ShmPuller. The process keeps the description of each type that it has met so, once,
///          until it leaves the segment.
/// Crash:   as ShmPuller.
class AnyPuller {
 public:
  /// For ShmEngine::subscribe_any(). Throws nothing.
  AnyPuller(std::unique_ptr<detail::PullerCore> core, AnyType type)
      : puller_(std::move(core)), type_(std::move(type)) {}

  /// What the topic carries. Throws nothing.
  const AnyType& type() const noexcept { return type_; }

  /// As those of ShmPuller: the next message, or null. They throw the same.
  [[nodiscard]] AnyMessage try_pull() { return any(puller_.try_pull()); }
  /// The same, and waits. Throws the same.
  [[nodiscard]] AnyMessage pull(Duration timeout, const StopToken& stop = {}) {
    return any(puller_.pull(timeout, stop));
  }
  /// The same until a time of the steady clock. Throws the same.
  [[nodiscard]] AnyMessage pull_until(Deadline deadline, const StopToken& stop = {}) {
    return any(puller_.pull_until(deadline, stop));
  }
  /// The same without a limit. Throws the same.
  [[nodiscard]] AnyMessage pull(const StopToken& stop = {}) { return any(puller_.pull(stop)); }

  /// The next message in place, or an empty borrow. Throws as ShmPuller.
  [[nodiscard]] AnyBorrow try_borrow() { return {puller_.try_borrow(), type_}; }
  /// The same, and waits. Throws the same.
  [[nodiscard]] AnyBorrow borrow(Duration timeout, const StopToken& stop = {}) {
    return {puller_.borrow(timeout, stop), type_};
  }
  /// The same until a time of the steady clock. Throws the same.
  [[nodiscard]] AnyBorrow borrow_until(Deadline deadline, const StopToken& stop = {}) {
    return {puller_.borrow_until(deadline, stop), type_};
  }
  /// The same without a limit. Throws the same.
  [[nodiscard]] AnyBorrow borrow(const StopToken& stop = {}) {
    return {puller_.borrow(stop), type_};
  }

  /// How the last pull or borrow ended: see ShmPuller::status().
  Status status() const noexcept { return puller_.status(); }
  /// Messages lost to this reader just before the last one that it got.
  std::uint64_t missed() const noexcept { return puller_.missed(); }
  /// Where the last message that it got comes from: see ShmPuller::envelope(). Throws the same.
  Envelope envelope() const { return puller_.envelope(); }
  /// All that were lost to it, also those after the last message that it got.
  std::uint64_t missed_total() const noexcept { return puller_.missed_total(); }
  /// Publishers of the topic that are there now. Throws as ShmPuller::publishers().
  std::size_t publishers() { return puller_.publishers(); }
  /// Messages that are there to be read. Throws lot::Error (ECHILD, ESTALE).
  std::size_t size() { return puller_.size(); }
  /// A descriptor for epoll and others: see ShmPuller::fd(). Throws the same.
  int fd() { return puller_.fd(); }

 private:
  friend class WaitSet;
  friend class ShmListener;
  friend struct detail::PullerAccess;

  AnyMessage any(ShmSharedPtr<const std::byte> message) const {
    return message ? AnyMessage(std::move(message), type_) : AnyMessage();
  }

  ShmPuller<std::byte> puller_;
  AnyType type_;
};

inline void WaitSet::add(AnyPuller& puller, Handler handler) {
  add(puller.puller_, std::move(handler));
}
inline void WaitSet::remove(AnyPuller& puller) { remove(puller.puller_); }
inline detail::PullerCore& ShmListener::core_of(AnyPuller& puller) noexcept {
  return core_of(puller.puller_);
}

}  // namespace lot
