// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>

#include "lot/detail/core.hpp"

#include "lockfree_ring/sleep.hpp"
#include "transport/participant.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
using ring::kNoBlock;

using Policy = segment::Atomics;
using Reader = ring::Reader<Policy>;

/// Adaptive waiting spins this long: a little more than what a wake-up across cores costs.
constexpr auto kSpinTime = 50us;
constexpr unsigned kPollsPerClock = 64;
/// The first polls of a wait follow each other at once: a pause would add to the latency.
constexpr unsigned kEagerPolls = 4096;
/// So many messages without a wait are a stream; its reader then waits so long before it looks
/// again.
constexpr unsigned kBurst = 4;
constexpr unsigned kPausesAfterBurst = 200;
/// In a stream, the lines of this message are fetched while those before it are read.
constexpr std::uint32_t kPrefetchAhead = 6;
constexpr auto kBusyRegistry = 5ms;
constexpr auto kLongestSleep = 1s;

class Puller final : public detail::PullerCore {
 public:
  Puller(std::shared_ptr<Participant> participant, std::string_view topic,
         const detail::MessageType& type, const PullerOptions& options)
      : participant_(std::move(participant)),
        directory_(participant_->segment().directory().version),
        topic_(participant_->enter_topic(topic, type)),
        type_(type),
        small_(type.size <= segment::kSmallBytes && type.align <= 64),
        wait_(options.wait == Wait::Adaptive && !has_several_cores() ? Wait::Park : options.wait) {
    try {
      const registry::Registry::Lock lock(participant_->registry());
      find_rings(options.history, true);
    } catch (...) {
      leave_all();
      participant_->leave_topic(topic_);
      throw;
    }
  }

  ~Puller() override {
    if (participant_->inert()) return;
    leave_all();
    participant_->leave_topic(topic_);
  }

  Status borrow(detail::Borrowed& borrowed, bool wait, detail::Clock::time_point deadline,
                bool forever) override {
    if (look(borrowed)) {
      ++burst_;
      return Status::Ok;
    }
    if (!wait) {
      if (!settle() && look(borrowed)) return Status::Ok;
      return sources_.empty() ? Status::PublisherGone : Status::Empty;
    }
    return wait_and_look(borrowed, forever ? futex::Deadline() : futex::Deadline(deadline));
  }

  void done() noexcept override {
    if (participant_->inert()) return;
    Reader& reader = sources_[current_].reader;
    if (reader.done()) ring_bell(reader);
    borrowing_ = false;
  }

  detail::ControlCell* keep() override {
    participant_->check_usable();
    participant_->holder().acquire(block_, hold::kPointer);
    return &participant_->holder().cell(block_);
  }

  Status pull(detail::Borrowed& kept, bool wait, detail::Clock::time_point deadline,
              bool forever) override {
    keeping_ = true;
    const Status status = borrow(kept, wait, deadline, forever);
    keeping_ = false;
    if (status == Status::Ok) {
      kept.cell = keep();
      done();
    }
    return status;
  }

  std::size_t publishers() override {
    participant_->check_usable();
    if (directory_.load(std::memory_order_acquire) != version_) find_new_rings();
    return static_cast<std::size_t>(std::count_if(
        sources_.begin(), sources_.end(), [](const Source& s) { return !s.reader.orphaned(); }));
  }

 private:
  struct Source {
    registry::ChannelName name;
    Reader reader;
  };

  /// One look at every ring, beginning behind the one that had the last message.
  bool look(detail::Borrowed& borrowed) {
    if (participant_->inert() || borrowing_) [[unlikely]]
      refuse();
    if (directory_.load(std::memory_order_acquire) != version_) [[unlikely]]
      find_new_rings();
    const std::size_t n = sources_.size();
    for (std::size_t i = 0; i < n; ++i) {
      if (++current_ >= n) current_ = 0;
      Reader& reader = sources_[current_].reader;
      prefetch(reader.peek(0));
      if (burst_ >= kBurst) prefetch(reader.peek(kPrefetchAhead));
      const ring::Word b = reader.poll(missed_);
      if (b == kNoBlock) continue;
      found(borrowed, b);
      return true;
    }
    return false;
  }

  void prefetch(ring::Word b) const {
    if (b >= participant_->blocks()) return;
    const auto index = static_cast<std::uint32_t>(b);
    Policy::prefetch_read(participant_->segment().small(index));
    if (keeping_) Policy::prefetch_write(&participant_->holder().words(index));
  }

  void found(detail::Borrowed& borrowed, ring::Word b) {
    segment::Segment& s = participant_->segment();
    if (b >= participant_->blocks()) [[unlikely]]
      skip_damaged("its slot in the queue cannot be right");
    block_ = static_cast<std::uint32_t>(b);
    if (small_) {
      borrowed.root = s.small(block_);
    } else {
      const std::uint64_t root = s.arena(block_).root;
      if (root % type_.align != 0 || !s.holds(block_, root, type_.size)) [[unlikely]]
        skip_damaged("it is said to lie where it cannot be");
      borrowed.root = s.base() + root;
    }
    borrowed.cell = &participant_->holder().cell(block_);
    borrowed.missed = missed_;
    missed_ = 0;
    borrowing_ = true;
  }

  /// After a look that found nothing. False: there is something to look at after all.
  bool settle() {
    return ring::settle(
        sources_, [this](Reader& reader) { ring_bell(reader); },
        [this](Reader& reader) {
          leave(reader);
          participant_->collect();
        });
  }

  Status wait_and_look(detail::Borrowed& borrowed, const futex::Deadline& deadline) {
    // At the heels of a streaming publisher every message would cost both sides the slot's line:
    // let it get ahead.
    if (std::exchange(burst_, 0) >= kBurst && wait_ != Wait::Park) {
      for (unsigned n = 0; n < kPausesAfterBurst; ++n) Policy::pause();
      if (look(borrowed)) return Status::Ok;
    }
    for (;;) {
      if (wait_ != Wait::Park) {
        const auto start = futex::Clock::now();
        for (unsigned n = 1;; ++n) {
          if (n > kEagerPolls) Policy::pause();
          if (look(borrowed)) return Status::Ok;
          if (n % kPollsPerClock != 0) continue;
          settle();
          const auto now = futex::Clock::now();
          // Once more: we may have been held up since the last look.
          if (deadline && now >= *deadline) return look(borrowed) ? Status::Ok : Status::Timeout;
          if (wait_ == Wait::Adaptive && now - start >= kSpinTime) break;
        }
      }
      const bool in_time = park(deadline);
      if (look(borrowed)) return Status::Ok;
      if (!in_time) return Status::Timeout;
    }
  }

  /// Sleeps until something may have come. False when the deadline has passed.
  bool park(const futex::Deadline& deadline) {
    if (!settle()) return true;
    waits_.clear();
    const ring::Rest rest =
        ring::lie_down(sources_, directory_, version_, [this](const auto& word, auto value) {
          waits_.push_back({futex_of(word), static_cast<std::uint32_t>(value)});
        });
    if (rest == ring::Rest::Look) return true;
    if (rest == ring::Rest::Sleep) {
      // A slot's futex looks the same again after 1024 messages: who was held up for exactly so
      // long before it sleeps looks once more after a while.
      const auto later = futex::Clock::now() + kLongestSleep;
      const bool final = deadline && *deadline <= later;
      return futex::wait_any(waits_.data(), static_cast<unsigned>(waits_.size()),
                             final ? *deadline : later) ||
             !final;
    }
    // Somebody keeps the registry's lock, else look() had found the new rings: not for long.
    const auto soon = futex::Clock::now() + kBusyRegistry;
    const bool last = deadline && *deadline <= soon;
    futex::wait(waits_.back().word, waits_.back().value, last ? *deadline : soon);
    return !last;
  }

  static const void* futex_of(const std::atomic<ring::Word>& word) { return futex::low_half(word); }
  static const void* futex_of(const std::atomic<std::uint32_t>& word) { return &word; }

  /// Joins the rings of the topic that we do not read yet.
  void find_rings(std::uint64_t history, bool complain) {
    const std::uint32_t version = directory_.load(std::memory_order_acquire);
    for (const auto& name : participant_->registry().live(topic_)) {
      if (std::any_of(sources_.begin(), sources_.end(),
                      [&](const Source& s) { return s.name == name; })) {
        continue;
      }
      const segment::Ring ring = participant_->segment().ring(name.channel);
      if (ring.depth == 0) {
        if (!complain) continue;
        throw Error(EBADMSG, participant_->segment().path(),
                    "the queue of a publisher of the topic is damaged", "restart the publisher");
      }
      bool full = false;
      sources_.reserve(sources_.size() + 1);  // else a joined cell may be lost
      auto reader = Reader::join(ring, name.generation, participant_->index(), history, full);
      if (reader) {
        missed_ += reader->skipped();
        sources_.push_back({name, *reader});
      } else if (full && complain) {
        throw Error(EUSERS, participant_->segment().path(),
                    "a publisher of the topic has all the readers that it can have",
                    "make the segment with a larger EngineOptions::readers");
      }
    }
    version_ = version;
  }

  /// Rings that have come since the subscription: read from their first message. On the data path,
  /// so it never waits for the registry's lock; the next look tries again.
  void find_new_rings() {
    registry::Registry& registry = participant_->registry();
    if (!registry.try_lock()) return;
    const struct Unlock {
      registry::Registry& registry;
      ~Unlock() { registry.unlock(); }
    } unlock{registry};
    find_rings(Reader::kFromTheStart, false);
  }

  void ring_bell(Reader& reader) noexcept {
    auto& space = *reader.ring().space;
    if (Reader::ring_bell(space)) futex::wake_all(&space);
  }

  void leave(Reader& reader) noexcept {
    reader.leave();
    futex::wake_all(reader.ring().space);
  }

  void leave_all() noexcept {
    for (Source& s : sources_) leave(s.reader);
    const bool orphans = std::any_of(sources_.begin(), sources_.end(),
                                     [](const Source& s) { return s.reader.orphaned(); });
    sources_.clear();
    if (orphans) participant_->collect();
  }

  [[noreturn]] void refuse() const {
    participant_->check_usable();
    throw Error(EBUSY, participant_->segment().path(),
                "this puller has a borrow that has not ended",
                "end it (one borrow at a time), or keep() the message");
  }

  /// The reader goes on behind the message, which counts as missed.
  [[noreturn]] void skip_damaged(const char* what) {
    Reader& reader = sources_[current_].reader;
    if (reader.done()) ring_bell(reader);
    ++missed_;
    throw Error(EBADMSG, participant_->segment().path(),
                std::string("a message is damaged: ") + what,
                "somebody has written into the segment who should not: look for a process that "
                "writes behind the end of its messages");
  }

  std::shared_ptr<Participant> participant_;
  std::atomic<std::uint32_t>& directory_;
  std::uint32_t topic_;
  const detail::MessageType& type_;
  bool small_;  ///< the messages lie in their blocks' small payload
  Wait wait_;
  bool borrowing_ = false;
  bool keeping_ = false;
  unsigned burst_ = 0;         ///< messages since the last wait
  std::uint32_t version_ = 0;  ///< of the directory, when sources_ was right
  std::uint32_t block_ = 0;
  std::size_t current_ = 0;
  std::uint64_t missed_ = 0;
  std::vector<Source> sources_;
  std::vector<futex::Wait> waits_;
};

}  // namespace
}  // namespace lot::transport

namespace lot::detail {

std::unique_ptr<PullerCore> make_puller(std::shared_ptr<transport::Participant> participant,
                                        std::string_view topic, const MessageType& type,
                                        const PullerOptions& options) {
  participant->check_usable();
  return std::make_unique<transport::Puller>(std::move(participant), topic, type, options);
}

}  // namespace lot::detail
