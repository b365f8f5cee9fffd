// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "lot/detail/wait.hpp"

#include "segment/segment.hpp"

namespace lot::waiting {

/// The participant in whose name an ear listens.
class EarOwner {
 public:
  virtual ~EarOwner() = default;
  virtual segment::Segment& ear_segment() noexcept = 0;
  virtual std::uint32_t ear_index() const noexcept = 0;
  /// True when its words in the segment are not its own any more.
  virtual bool has_lost_ears() const noexcept = 0;

  /// Those that watch the directory are due, whatever its version is. The caller then wakes the
  /// sleepers on the directory's version. Relaxed: a call that comes too early for a sleeper is
  /// made up for within a second.
  void call_watchers() noexcept { calls_.fetch_add(1, std::memory_order_relaxed); }
  /// How often they were called. Relaxed: as above.
  std::uint32_t calls() const noexcept { return calls_.load(std::memory_order_relaxed); }

 private:
  std::atomic<std::uint32_t> calls_{0};
};

/// The process's side of one ear (docs/ear.md): which of its clients listens to which ring.
///
/// Threads: one at a time.
/// Memory:  private: 8 bytes for each channel, and 16 for each further client of a ring.
/// Crash:   the words in the segment are freed by the reaper.
class Ear {
 public:
  /// One that the ear hears for. It is forgotten before it is destroyed.
  class Client {
   public:
    Client() = default;
    Client(const Client&) = delete;
    Client& operator=(const Client&) = delete;

   private:
    friend class Ear;
    bool is_on_watch_ = false;  ///< it watches the directory
  };

  /// An ear that the owner claims. Null: there is no free one. Throws std::bad_alloc.
  static std::unique_ptr<Ear> claim(EarOwner& owner);
  /// The ear of the owner's index. REQUIRES: the owner has one at a time. Throws std::bad_alloc.
  explicit Ear(EarOwner& owner) : Ear(owner, owner.ear_index()) {}
  ~Ear();
  Ear(const Ear&) = delete;
  Ear& operator=(const Ear&) = delete;

  /// The client listens to the ring of a channel. It then leaves its mark there.
  void listen(Client& client, std::uint32_t channel);
  /// The client is due when the directory's version is another one. True: no other client watched.
  bool watch_directory(Client& client, std::uint32_t version);
  /// The client is never due again.
  void forget(Client& client) noexcept;

  /// Takes the news. Calls due(client) for each client that should look and arm itself again: it
  /// does not listen any more to the rings that had news. False: the ear is lost, so all clients
  /// should look.
  template <class Due>
  bool take(Due&& due) {
    if (owner_.has_lost_ears()) return false;
    if (std::exchange(sleeps_, false)) shared_.words->bell.wake_up();
    rung_ = shared_.words->bell.rung();
    take_news(due);
    take_watchers(due);
    return true;
  }
  /// The same without the directory, at any time: also while another thread sleeps by the ear,
  /// which will find that these news have gone. REQUIRES: the ear is not lost.
  template <class Due>
  void take_news(Due&& due) {
    shared_.take(segment_.capacity().channels, [&](std::uint32_t channel) {
      Client* const first = std::exchange(first_[channel], nullptr);
      if (first != nullptr) {
        due(*first);
      } else {
        segment_.listeners()[channel].remove(index_);  // no client listens here any more
      }
      std::erase_if(others_, [&](const Listener& other) {
        if (other.channel != channel) return false;
        due(*other.client);
        return true;
      });
    });
  }
  /// True when there may be news since they were taken.
  bool has_rung() const noexcept { return shared_.words->bell.rung() != rung_; }
  /// The caller sleeps now. Appends the words.
  void prepare_to_sleep(detail::FutexWaits& waits);

 private:
  struct Listener {
    Client* client;
    std::uint32_t channel;
  };
  struct Watcher {
    Client* client;
    std::uint32_t version;
  };

  Ear(EarOwner& owner, std::uint32_t index);

  template <class Due>
  void take_watchers(Due& due) {
    const std::uint32_t calls = owner_.calls();
    const bool all = std::exchange(calls_, calls) != calls;
    if (watchers_.empty()) return;
    // Acquire: D1. It carries nothing: the registry's lock carries the rings.
    version_ = segment_.directory().version.load(std::memory_order_acquire);
    std::erase_if(watchers_, [&](const Watcher& watcher) {
      if (!all && watcher.version == version_) return false;
      watcher.client->is_on_watch_ = false;
      due(*watcher.client);
      return true;
    });
  }

  EarOwner& owner_;
  segment::Segment& segment_;
  const std::uint32_t index_;
  segment::Ear shared_;
  std::uint32_t rung_ = 0;        ///< how often it was rung before the news that were taken last
  std::uint32_t version_ = 0;     ///< the directory's, when the watchers were looked at last
  std::uint32_t calls_ = 0;       ///< EarOwner::calls() at that time
  bool sleeps_ = false;           ///< it has said that it sleeps
  std::vector<Client*> first_;    ///< by channel: the first client that listens, or null
  std::vector<Listener> others_;  ///< the others, where there is a first one
  std::vector<Watcher> watchers_;
};

}  // namespace lot::waiting
