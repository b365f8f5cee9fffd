// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <optional>

#include "lot/detail/core.hpp"

#include "lockfree_ring/sleep.hpp"
#include "transport/participant.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
using ring::kNoBlock;

/// A retired message of more than this is reclaimed at once; smaller ones in batches, since looking
/// at every reader's hazard costs more than they do.
constexpr std::uint64_t kBatchedBytes = 64 << 10;
constexpr std::size_t kSmallestBatch = 32;
/// A sender that waits for room looks by itself this often: a reader's ring may have been missed.
constexpr auto kLookPeriod = 1ms;
constexpr auto kSpinTime = 50us;
constexpr unsigned kPausesPerLook = 16;
/// The lines of the block that is replaced so many publishes from now are fetched back in time.
constexpr std::uint32_t kPrefetchAhead = 6;
constexpr unsigned kLooksPerProbe = 4;  ///< and asks whether the laggards live

class Pusher final : public detail::PusherCore, private Participant::Evictor {
 public:
  /// A maker of messages without a topic.
  explicit Pusher(std::shared_ptr<Participant> participant)
      : participant_(std::move(participant)), pool_(participant_->open_pool()) {}

  Pusher(std::shared_ptr<Participant> participant, std::string_view topic,
         const detail::MessageType& type, const PusherOptions& options)
      : participant_(std::move(participant)), pool_(participant_->open_pool()) {
    if (options.depth == 0 || options.depth > segment::Segment::kDeepest) {
      close_without_ring();
      throw Error(EINVAL, std::string(topic), "depth " + std::to_string(options.depth),
                  "use 1 to " + std::to_string(segment::Segment::kDeepest));
    }
    try {
      topic_ = participant_->enter_topic(topic, type);
      const registry::Registry::Lock lock(participant_->registry());
      name_ =
          participant_->registry().open(*topic_, participant_->index(),
                                        {options.depth, participant_->segment().capacity().readers,
                                         options.policy == Policy::Block, 0});
    } catch (...) {
      if (topic_) participant_->leave_topic(*topic_);
      close_without_ring();
      throw;
    }
    writer_.emplace(participant_->segment().ring(name_.channel));
    blocking_ = options.policy == Policy::Block;
    if (!blocking_) participant_->add(*this);
  }

  ~Pusher() override {
    if (participant_->inert()) return;
    if (!writer_) {
      close_without_ring();
      return;
    }
    if (!blocking_) participant_->remove(*this);
    std::vector<std::uint32_t> blocks;
    std::vector<std::uint32_t> foreign;
    {
      const std::lock_guard guard(pool_.lock());
      blocks = pool_.take_retired();
      foreign = pool_.take_foreign();
      const auto& ring = writer_->ring();
      for (std::uint32_t i = 0; i < ring.depth; ++i) {
        const ring::Word b = ring::block(ring.slots[i].load(std::memory_order_relaxed));
        if (b < participant_->blocks()) blocks.push_back(static_cast<std::uint32_t>(b));
      }
    }
    for (const std::uint32_t f : foreign) participant_->holder().release_ring_hold(f);
    participant_->close_pool(pool_, name_, std::move(blocks));
    participant_->close_ring(name_);
    participant_->leave_topic(*topic_);
  }

  detail::Loan loan(const detail::MessageType& type, bool or_throw) override {
    participant_->check_usable();
    std::uint32_t b;
    {
      const std::lock_guard guard(pool_.lock());
      b = pool_.try_loan();
      if (b == Pool::kNone && pool_.retired() >= batch()) {
        scan();
        b = pool_.try_loan();
      }
      if (b == Pool::kNone) b = pool_.claim();
    }
    if (b == Pool::kNone) b = scrape_together();
    if (b == Pool::kNone) {
      if (!or_throw) return {};
      char text[256];
      std::snprintf(
          text, sizeof(text),
          "lot: %s: all %u blocks are in use; keep fewer messages, publish with a smaller "
          "depth, or make the segment with a larger EngineOptions::blocks",
          participant_->segment().path().c_str(), participant_->blocks());
      throw OutOfMemory(text);
    }
    detail::Loan loan{&participant_->holder().cell(b), nullptr, &participant_->segment().arena(b)};
    try {
      loan.root = pool_.lay_out(b, type);
    } catch (const OutOfMemory&) {
      loan.cell->type = nullptr;  // nothing was built
      pool_.give_back(b);
      if (or_throw) throw;
      return {};
    }
    return loan;
  }

  Status push_unique(detail::ControlCell* cell, std::chrono::nanoseconds block_for) override {
    check(cell);
    if (cell->hub != participant_->hub()) {  // made by another copy of the library
      const Status status = push_shared(cell, block_for);
      if (status == Status::Ok) {
        cell->hub->shared_from_unique(cell);
        cell->drop_pointer();
      }
      return status;
    }
    std::unique_lock lock(pool_.lock());
    if (!writer_->room() && !wait_for_room(lock, block_for)) return Status::Full;
    // Nobody else can have this block, not even a weak pointer: the tag keeps those of former
    // messages away. So the hold changes from ours to the ring's by a plain store.
    cell->hold.store(cell->hold.load(std::memory_order_relaxed) - hold::kPointer + hold::kRing,
                     std::memory_order_relaxed);
    publish(lock, cell->block);
    return Status::Ok;
  }

  Status push_shared(const detail::ControlCell* cell, std::chrono::nanoseconds block_for) override {
    check(cell);
    if (!participant_->same_segment(*cell)) {
      throw Error(EINVAL, participant_->segment().path(),
                  std::string("the message lies in another segment, ") + cell->hub->path(cell),
                  "copy it into a loan()");
    }
    std::unique_lock lock(pool_.lock());
    if (!writer_->room() && !wait_for_room(lock, block_for)) return Status::Full;
    participant_->holder().acquire(cell->block, hold::kRing);
    publish(lock, cell->block);
    return Status::Ok;
  }

  std::size_t readers() override {
    participant_->check_usable();
    const std::lock_guard guard(pool_.lock());
    const auto& ring = writer_->ring();
    std::size_t n = 0;
    for (std::uint32_t c = 0; c < ring.readers; ++c) {
      n += ring.who[c].load(std::memory_order_acquire) != 0;
    }
    return n;
  }

  bool wait_for_readers(std::size_t count, std::chrono::nanoseconds timeout) override {
    const auto until = detail::after(timeout);
    while (readers() < count) {
      if (futex::Clock::now() >= until) return false;
      std::this_thread::sleep_for(kLookPeriod);
    }
    return true;
  }

  void reserve(std::size_t count, std::size_t bytes) override {
    static const detail::MessageType nothing{1, 1, 0, "", nullptr, false};
    std::vector<std::uint32_t> blocks;
    try {
      for (std::size_t i = 0; i < count; ++i) {
        const detail::Loan loan = this->loan(nothing, true);
        blocks.push_back(loan.cell->block);
        std::memset(loan.arena->allocate(bytes, 64), 0, bytes);
      }
    } catch (...) {
      for (const std::uint32_t b : blocks) pool_.give_back(b);
      throw;
    }
    for (const std::uint32_t b : blocks) pool_.give_back(b);
  }

 private:
  void check(const detail::ControlCell* cell) const {
    participant_->check_usable();
    if (cell == nullptr) {
      throw Error(EINVAL, participant_->segment().path(), "an empty pointer was pushed",
                  "loan() a message, or look at the pointer before");
    }
  }

  void close_without_ring() noexcept { participant_->close_pool(pool_, {}, {}); }

  std::size_t batch() {
    if (big_) return 1;
    return writer_ ? std::max(kSmallestBatch, 2 * writer_->active_readers()) : 1;
  }

  /// Retired blocks that no reader's hazard names become free. Locked.
  void scan() {
    if (!writer_ || pool_.retired() == 0) return;
    ++scan_;
    if (seen_.empty()) seen_.resize(participant_->blocks());
    writer_->hazards([this](ring::Word b) {
      if (b < seen_.size()) seen_[static_cast<std::size_t>(b)] = scan_;
    });
    pool_.scan([this](std::uint32_t b) { return seen_[b] == scan_; });
  }

  /// Publishes, retires what was overwritten, unlocks, wakes.
  void publish(std::unique_lock<BiasedLock>& lock, std::uint32_t b) {
    const auto published = writer_->publish(b);
    std::vector<std::uint32_t> foreign;
    if (published.replaced == b) {
      foreign.push_back(b);  // the same message again: it is in the ring, so nobody needs this hold
    } else if (published.replaced < participant_->blocks()) {  // else none, or it is damaged
      pool_.retire(static_cast<std::uint32_t>(published.replaced), !blocking_);
      if (!blocking_) {
        big_ = is_big(b);
        // Small ones wait for the next loan to look at them, unless nothing is ever loaned here.
        if (big_ || pool_.retired() >= 2 * batch()) scan();
      }
      if (pool_.has_foreign()) foreign = pool_.take_foreign();
    }
    if (!published.wake) {
      if (!pool_.has_free() && pool_.retired() >= batch()) scan();
      pool_.prepare();
      if (blocking_) pool_.prefetch(writer_->upcoming(kPrefetchAhead));  // a lossless stream
    }
    lock.unlock();
    if (published.wake) futex::wake_all(futex::low_half(*published.slot));
    for (const std::uint32_t f : foreign) participant_->holder().release_ring_hold(f);
  }

  bool is_big(std::uint32_t b) const {
    const detail::MessageType* type = participant_->holder().cell(b).type;
    if (type != nullptr && type->plain && type->size <= segment::kSmallBytes) return false;
    const detail::Arena& arena = participant_->segment().arena(b);
    if (arena.references != 0) return true;  // what it refers to may be big
    std::uint64_t bytes = 0;
    for (unsigned i = 0; i < arena.extents && i < detail::Arena::kMaxExtents; ++i) {
      bytes +=
          segment::kGranule << arena.extent[i].order % segment::Granules<segment::Atomics>::kOrders;
    }
    return bytes > kBatchedBytes;
  }

  /// Waits until the slowest reader has read, or died: a reader that is at work makes room within
  /// microseconds, so it spins first. Called and left with the lock held.
  bool wait_for_room(std::unique_lock<BiasedLock>& lock, std::chrono::nanoseconds block_for) {
    const auto start = futex::Clock::now();
    const auto until = detail::after(block_for);
    while (spins_ && futex::Clock::now() < std::min(until, start + kSpinTime)) {
      lock.unlock();
      // Seldom enough to leave the reader its cursor's line, and to find room for more than one.
      for (unsigned n = 0; n < kPausesPerLook; ++n) segment::Atomics::pause();
      lock.lock();
      if (writer_->room()) return true;
    }
    for (unsigned look = 1;; ++look) {
      const auto value = ring::wait_for_room(*writer_);
      if (!value) return true;
      const auto now = futex::Clock::now();
      if (now >= until) return false;
      std::vector<std::uint32_t> laggards;
      if (look % kLooksPerProbe == 0) {
        writer_->laggards([&](std::uint32_t c) {
          const std::uint32_t who = writer_->ring().who[c].load(std::memory_order_acquire);
          if (who != 0) laggards.push_back(who - 1);
        });
      }
      lock.unlock();
      for (const std::uint32_t k : laggards) participant_->reap_if_dead(k);
      futex::wait(writer_->ring().space, *value, std::min(until, now + kLookPeriod));
      lock.lock();
    }
  }

  /// The pool is dry and all blocks are taken: looks everywhere.
  std::uint32_t scrape_together() {
    std::uint32_t b = Pool::kNone;
    const auto look = [&] {
      const std::lock_guard guard(pool_.lock());
      scan();
      pool_.poll_kept();
      b = pool_.try_loan();
      if (b == Pool::kNone) b = pool_.claim();
      return b != Pool::kNone;
    };
    if (look()) return b;
    participant_->reap_dead();
    participant_->collect();
    participant_->trim();
    while (!look()) {
      if (!participant_->evict()) return Pool::kNone;
      participant_->trim();
    }
    return b;
  }

  bool evict() noexcept override {
    const std::lock_guard guard(pool_.lock());
    const ring::Word b = writer_->evict_oldest();
    if (b < participant_->blocks()) pool_.retire(static_cast<std::uint32_t>(b), true);
    scan();
    return b != kNoBlock;
  }

  std::shared_ptr<Participant> participant_;
  Pool& pool_;
  std::optional<std::uint32_t> topic_;
  registry::ChannelName name_{};
  std::optional<ring::Writer<segment::Atomics>> writer_;
  bool blocking_ = false;
  bool spins_ = has_several_cores();
  bool big_ = false;
  std::vector<std::uint32_t> seen_;  ///< by block: the last scan that saw it in a hazard
  std::uint32_t scan_ = 0;
};

}  // namespace
}  // namespace lot::transport

namespace lot::detail {

std::unique_ptr<PusherCore> make_pusher(std::shared_ptr<transport::Participant> participant,
                                        std::string_view topic, const MessageType& type,
                                        const PusherOptions& options) {
  participant->check_usable();
  return std::make_unique<transport::Pusher>(std::move(participant), topic, type, options);
}

std::unique_ptr<PusherCore> make_maker(std::shared_ptr<transport::Participant> participant) {
  participant->check_usable();
  return std::make_unique<transport::Pusher>(std::move(participant));
}

}  // namespace lot::detail
