// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <optional>

#include "lot/detail/core.hpp"

#include "lockfree_ring/sleep.hpp"
#include "transport/environment.hpp"
#include "transport/eviction.hpp"
#include "transport/fill.hpp"
#include "transport/participant.hpp"
#include "transport/pieces.hpp"
#include "transport/ring_ends.hpp"
#include "waiting/waiting.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
using ring::kNoBlock;

/// Retired messages are reclaimed in batches, since a look at every reader's hazard costs more than
/// a small message does. A batch of messages of one size holds back at most this much memory.
/// Larger messages are reclaimed at once.
constexpr std::uint64_t kBatchedBytes = 256 << 10;
constexpr std::size_t kUsualBatch = 32;
/// A sender that waits for room looks by itself this often. Readers tell it of room only a few
/// times a lap, and it may miss that.
constexpr auto kLookPeriod = 1ms;
/// A publisher that had to give up its own oldest message does so at once for each of its loans,
/// for this long. Then it looks again whether there is more memory for it.
constexpr auto kBoundFor = 1s;
constexpr std::size_t kRoomAhead = 64;  ///< for how many publishes room to retire is made at once
constexpr unsigned kPausesPerLook = 16;
/// A lossless stream fetches the cache lines of the block that will be replaced this many publishes
/// from now.
constexpr std::uint32_t kPrefetchAhead = 6;
/// after how many looks it checks whether the slow readers live
constexpr unsigned kLooksPerProbe = 4;

constexpr std::uint32_t taken_by(detail::Delivery delivery) {
  switch (delivery) {
    case detail::Delivery::ToOne:
      return segment::kTaken;
    case detail::Delivery::ToWorker:
      return segment::kFinished;
    case detail::Delivery::ToAll:
      break;
  }
  return 0;
}

class Pusher final : public RingPusher, private Evictor {
 public:
  /// A maker of messages without a topic.
  explicit Pusher(std::shared_ptr<Participant> participant)
      : participant_(std::move(participant)), pool_(participant_->stock().open()) {}

  Pusher(std::shared_ptr<Participant> participant, std::string_view topic,
         const detail::MessageType& type, const PusherOptions& options, detail::Delivery delivery,
         std::uint32_t extra)
      : participant_(std::move(participant)),
        pool_(participant_->stock().open(topic)),
        type_(&type) {
    try {
      check_depth(topic, options.depth);
      stamps_ = delivery == detail::Delivery::ToAll && stamps(options.stamp);
      if (extra == 0 && fast_lane(options.fast_lane)) stride_ = segment::stride_for(type, stamps_);
      // Messages for all readers without loss: up to `depth` of them may be unread at once.
      if (stride_ == 0 && options.policy != Policy::Overwrite &&
          delivery == detail::Delivery::ToAll && options.depth >= participant_->blocks()) {
        throw Error(EINVAL, std::string(topic),
                    "PusherOptions::depth " + std::to_string(options.depth) +
                        " without loss, and the segment has " +
                        std::to_string(participant_->blocks()) + " blocks",
                    "use less, or make the segment with a larger EngineOptions::blocks");
      }
      const QueueEngine engine = queue_engine(options.engine);
      topic_ = participant_->topics().enter(topic, type);
      name_ = participant_->rings().open(
          *topic_,
          {options.depth, participant_->segment().capacity().readers, options.policy, engine,
           taken_by(delivery), 0, extra, stamps_, stride_},
          pool_.index());
    } catch (...) {
      if (topic_) participant_->topics().leave(*topic_);
      close_without_ring();
      throw;
    }
    try {
      pool_.limit(options.max_bytes);
      const segment::Ring ring = participant_->segment().ring(name_.channel);
      const bool is_as_asked = ring.depth != 0 && ring.in_slots() == (stride_ != 0) &&
                               (stride_ == 0 || ring.slots.stride() == stride_);
      if (!is_as_asked) {
        throw Error(EBADMSG, participant_->segment().path(),
                    "another process has changed the queue that was made for " + std::string(topic),
                    "end the process that writes where it should not, and try again");
      }
      writer_.emplace(ring);
      words_ = segment::words_of(type);
      fits_vary_ = !type.plain || !segment::is_small(type);
      pool_.make_room(room_to_retire());
      seen_.resize(participant_->blocks());
    } catch (...) {
      participant_->stock().close(pool_, name_, {});
      participant_->rings().close(name_);
      participant_->topics().leave(*topic_);
      throw;
    }
    queue_lock_ = participant_->queue_lock(name_.channel);
    history_ = options.history;
    waits_ = options.policy == Policy::Block;
    block_for_ = std::max(std::chrono::nanoseconds(options.block_for), 0ns);
    participant_->eviction().add(*this);
    if (type.size >= detail::Build::kLargePiece) {
      participant_->ahead().expect(pool_, Pieces::one(type.size));
      participant_->ahead().next(pool_);
    }
  }

  ~Pusher() override {
    if (participant_->inert()) return;
    if (!writer_) {
      close_without_ring();
      return;
    }
    participant_->eviction().remove(*this);
    std::vector<std::uint32_t> blocks;
    {
      std::unique_lock lock(pool_.lock());
      const auto& ring = writer_->ring();
      const auto give_up = [&](ring::Word b) {  // room_to_retire() has made room
        if (b < participant_->blocks()) pool_.retire(static_cast<std::uint32_t>(b), true);
      };
      if (ring.taken) {
        writer_->each_put(give_up);
      } else {
        for (std::uint32_t i = 0; i < ring.depth; ++i) {
          // Relaxed: only this publisher stores blocks there.
          give_up(ring::block(ring.slots[i].load(std::memory_order_relaxed)));
        }
      }
      blocks = pool_.take_retired();
      if (pool_.has_foreign()) release_foreign(lock);
    }
    participant_->stock().close(pool_, name_, std::move(blocks));
    participant_->rings().close(name_);
    participant_->topics().leave(*topic_);
  }

  [[gnu::hot]] detail::Loan loan(const detail::MessageType& type, bool or_throw) override {
    participant_->check_usable();
    if (history_ != PusherOptions::kAll) [[unlikely]]
      take_back_read();
    std::uint32_t b;
    {
      const std::lock_guard guard(pool_.lock());
      if (writer_) writer_->prefetch();
      b = pool_.try_loan();
    }
    if (b == Pool::kNone) [[unlikely]] {
      b = find_block(or_throw);
      if (b == Pool::kNone) {
        if (!or_throw) return {};
        refuse_without_blocks();
      }
    }
    detail::Loan loan{&participant_->holder().control(b), nullptr,
                      &participant_->segment().arena(b)};
    try {
      loan.root = pool_.lay_out(*loan.control, type, or_throw);
    } catch (const OutOfMemory&) {
      take_back(b);
      if (or_throw) throw;
      return {};
    } catch (...) {
      take_back(b);
      throw;
    }
    return loan;
  }

  [[gnu::hot]] Status push_unique(detail::ControlBlock* control, detail::RoomLimit limit) override {
    check(control);
    if (limit.is_stopped()) return Status::Stopped;
    if (stride_ != 0) return push_unique_copy(control, limit);
    if (control->hub != participant_->hub() || participant_->was_received(*control)) {
      return push_of_others(control, limit);
    }
    if (!type_->plain) participant_->holder().complete(control->block);
    std::unique_lock lock(pool_.lock());
    mutex_engine::QueueGuard queue_guard(queue_lock_);
    if (!writer_->room() && !wait_for_room(lock, queue_guard, limit)) return why_full(limit);
    make_room();
    HardwareOwnership::hand_to_ring(control->hold);
    if (!type_->plain) participant_->holder().freeze_references(control->block);
    publish(lock, queue_guard, control->block);
    return Status::Ok;
  }

  [[gnu::hot]] Status push_shared(detail::ControlBlock* control, const void* object,
                                  detail::RoomLimit limit) override {
    check(control);
    if (!participant_->same_segment(*control)) refuse_elsewhere(*control);
    if (!is_whole(*control, object)) refuse_part(*control, object);
    if (limit.is_stopped()) return Status::Stopped;
    return stride_ != 0 ? push_copy(control, limit, false) : push_held(control, limit, true);
  }

  std::size_t readers() override {
    participant_->check_usable();
    const std::lock_guard guard(pool_.lock());
    const auto& ring = writer_->ring();
    std::size_t n = 0;
    for (std::uint32_t c = 0; c < ring.readers; ++c) {
      if (ring.who[c].load(std::memory_order_acquire) == 0) continue;  // R8
      // Relaxed: an observer says so before the ring's roster tells of it.
      n += !ring::is_observer(ring.cells[c].position.load(std::memory_order_relaxed));
    }
    return n;
  }

  bool wait_for_readers(std::size_t count, detail::Limit limit) override {
    ForReaders enough(*this, count);
    return enough.look() || waiting::wait(enough, limit.deadline(), limit.stop());
  }

  Held hold() override { return {std::unique_lock(pool_.lock()), *writer_}; }

  bool accepts(const detail::ControlBlock& control, const void* object) const override {
    return participant_->same_segment(control) && is_whole(control, object);
  }

  const segment::Ring& ring() const noexcept override { return writer_->ring(); }
  std::uint32_t topic() const noexcept override { return *topic_; }

  void reserve(std::size_t count, std::size_t bytes) override {
    static const detail::MessageType nothing{1, 1, 0, "", nullptr, false, nullptr};
    std::vector<std::uint32_t> blocks;
    try {
      blocks.reserve(count);
      for (std::size_t i = 0; i < count; ++i) {
        const detail::Loan loan = this->loan(nothing, true);
        blocks.push_back(loan.control->block);
        touch(loan.arena->allocate(bytes, 64), bytes);
      }
    } catch (...) {
      for (const std::uint32_t b : blocks) pool_.give_back(b);
      throw;
    }
    for (const std::uint32_t b : blocks) {
      // only now: the blocks of a reserve() that fails serve all publishers
      pool_.keep_reserved(b);
      pool_.give_back(b);
    }
    // The publisher now has what it needs. So no block is made ahead for it.
    participant_->ahead().forget(pool_);
    pool_.trim_ahead();
  }

 private:
  /// Maps the pages of a piece for writing. The message belongs to this publisher alone.
  void touch(const void* piece, std::size_t bytes) {
    segment::Segment& s = participant_->segment();
    const std::uint64_t begin = s.offset_of(piece) - s.granule_offset(0);
    // the piece lies in the small payload
    if (s.offset_of(piece) < s.granule_offset(0) || bytes == 0) return;
    const auto first = static_cast<std::uint32_t>(begin / segment::kGranule);
    const auto last = static_cast<std::uint32_t>((begin + bytes - 1) / segment::kGranule);
    s.map_for_writing(first, last - first + 1);
  }

  /// Takes back what all readers have read, except for PusherOptions::history messages. The message
  /// that was read last is then at hand for the next loan.
  [[gnu::noinline]] void take_back_read() noexcept {
    std::unique_lock lock(pool_.lock());
    take_back_read_locked();
    if (pool_.has_foreign()) release_foreign(lock);
  }
  void take_back_read_locked() noexcept {
    {
      const mutex_engine::QueueGuard queue_guard(queue_lock_, std::nothrow);
      writer_->take_back(history_, [&](ring::Word b) {  // room_to_retire() has made room
        if (b >= participant_->blocks()) return;
        pool_.retire(static_cast<std::uint32_t>(b), writer_->readers_may_look());
      });
    }
    scan();
    pool_.poll_free();
  }

  /// The pool has no block at hand: looks where there are some, and waits for readers if told to.
  [[gnu::noinline]] std::uint32_t find_block(bool waits) {
    std::uint32_t b;
    {
      std::unique_lock lock(pool_.lock());
      b = replenish();
      if (pool_.has_foreign()) release_foreign(lock);
    }
    return b != Pool::kNone ? b : scrape_together(waits);
  }
  [[noreturn, gnu::cold]] void refuse_without_blocks() const {
    throw OutOfMemory(describe_block_shortage(participant_->memory()).c_str());
  }

  /// Takes back a block in which no message could be built.
  void take_back(std::uint32_t b) noexcept {
    participant_->holder().control(b).type = nullptr;
    pool_.give_back(b);
  }

  void check(const detail::ControlBlock* control) const {
    participant_->check_usable();
    if (control == nullptr) {
      throw Error(EINVAL, participant_->segment().path(), "an empty pointer was pushed",
                  "loan() a message, or look at the pointer before");
    }
  }

  /// Publishes a message in its slot. The caller keeps its pointer. REQUIRES: the message lies in
  /// this segment. `goes_home`: the caller has no pointer afterwards, and the block is this pool's.
  /// It goes back with the same lock.
  [[gnu::hot]] Status push_copy(const detail::ControlBlock* control, detail::RoomLimit limit,
                                bool goes_home) {
    std::unique_lock lock(pool_.lock());
    mutex_engine::QueueGuard queue_guard(queue_lock_);
    if (!writer_->room() && !wait_for_room(lock, queue_guard, limit)) return why_full(limit);
    ring::Word time = 0;
    if (stamps_) [[unlikely]]
      time = now_ns();
    const auto published = writer_->publish(participant_->segment().small(control->block), words_,
                                            stamps_ ? &time : nullptr);
    queue_guard.unlock();
    if (goes_home) pool_.take_back(control->block);  // a message for a slot is plain and small
    lock.unlock();
    if (published.wake) wake_readers(*published.slot);
    return Status::Ok;
  }
  /// The same of a message that the caller then has no more.
  [[gnu::hot]] Status push_unique_copy(detail::ControlBlock* control, detail::RoomLimit limit) {
    const bool ours = control->hub == participant_->hub() && !participant_->was_received(*control);
    if (!ours && !participant_->same_segment(*control)) refuse_elsewhere(*control);
    const bool goes_home = ours && &participant_->holder().pool_of(*control) == &pool_;
    const Status status = push_copy(control, limit, goes_home);
    if (status != Status::Ok || goes_home) return status;
    if (ours) {
      participant_->holder().pool_of(*control).give_back(*control);
    } else {
      control->hub->abandoned(control);
    }
    return status;
  }

  /// Publishes a message that another copy of the library has made, or that was taken from a queue.
  [[gnu::noinline]] Status push_of_others(detail::ControlBlock* control, detail::RoomLimit limit) {
    if (!participant_->same_segment(*control)) refuse_elsewhere(*control);
    control->hub->shared_from_unique(control);  // its home writes down where its pieces are
    const Status status = push_held(control, limit, false);
    if (status == Status::Ok) control->drop_pointer();
    return status;
  }

  /// Publishes a message that the caller keeps a pointer to. `shared`: other threads of this
  /// process may have pointers, too, and could make the message grow. REQUIRES: the message lies in
  /// this segment.
  [[gnu::hot]] Status push_held(detail::ControlBlock* control, detail::RoomLimit limit,
                                bool shared) {
    // read before the locked operations
    const bool was_received = participant_->was_received(*control);
    std::unique_lock lock(pool_.lock());
    mutex_engine::QueueGuard queue_guard(queue_lock_);
    if (!writer_->room() && !wait_for_room(lock, queue_guard, limit)) return why_full(limit);
    make_room();
    // Its mark is of the copy of the library that made the pointer: this one's hold does not end
    // it.
    if (control->hub != participant_->hub()) HardwareOwnership::end_unseen(control->hold);
    participant_->holder().acquire(control->block, hold::kRing);
    if (!type_->plain) {
      if (participant_->holder().is_home(control->block))
        participant_->holder().tell(control->block);
      if (shared) participant_->holder().freeze(*control);
      participant_->holder().freeze_references(control->block);
    }
    // After freeze(), which looks whether the message was handed over.
    if (was_received && !writer_->ring().taken) {
      participant_->segment().arena(control->block).show();
    }
    publish(lock, queue_guard, control->block);
    return Status::Ok;
  }

  /// True when readers of the topic will find `object` where they look for the message, and it has
  /// the topic's type. The type of a message is known where its home is in this process. Elsewhere
  /// it is enough that a T fits where the message begins. REQUIRES: the message lies in this
  /// segment.
  bool is_whole(const detail::ControlBlock& control, const void* object) const {
    segment::Segment& s = participant_->segment();
    const bool is_small = segment::is_small(*type_);
    const std::uint64_t root =
        is_small ? s.offset_of(s.small(control.block)) : s.arena(control.block).root;
    const bool ours = control.hub == participant_->hub();
    const unsigned char* const base = ours ? s.base() : control.hub->base(&control);
    if (object != base + root) return false;
    // Relaxed: the caller has a pointer, so the block stays at home.
    if ((control.hold.load(std::memory_order_relaxed) & hold::kHome) != 0 &&
        control.type != nullptr) {
      return control.type == type_ || detail::is_same(*control.type, *type_);
    }
    return is_small || s.holds(control.block, root, type_->size);
  }

  [[noreturn, gnu::cold]] void refuse_elsewhere(const detail::ControlBlock& control) const {
    throw Error(EINVAL, participant_->segment().path(),
                std::string("the message lies in another segment, ") + control.hub->path(&control),
                "copy it into a loan()");
  }

  [[noreturn, gnu::cold]] void refuse_part(const detail::ControlBlock& control,
                                           const void* object) const {
    const segment::Segment& s = participant_->segment();
    const auto* base = control.hub->base(&control);
    const auto offset =
        static_cast<std::uint64_t>(static_cast<const unsigned char*>(object) - base);
    // Relaxed: as in is_whole().
    const bool home = (control.hold.load(std::memory_order_relaxed) & hold::kHome) != 0;
    std::string what = "the pointer that was pushed points to ";
    if (object == nullptr) {
      what += "nothing, though it holds a message";
    } else if (!s.holds(control.block, offset, 1)) {
      what += "memory outside of the message that it holds";
    } else if (offset != s.arena(control.block).root) {
      what += "a part of a message";
    } else {
      what += "the beginning of a message of another type";
    }
    if (home && control.type != nullptr)
      what += std::string(" (of type ") + control.type->name + ")";
    throw Error(EINVAL, s.path(), what + "; readers get whole messages of type " + type_->name,
                "push the pointer to the whole message, or copy the object into a loan()");
  }

  void close_without_ring() noexcept {
    participant_->stock().close(pool_, {}, {});
    participant_->rings().settle_closing();
  }

  /// The room for retired blocks, besides those that are retired now: the whole ring, when it
  /// closes or its messages are taken; the block that a publish replaces; and the blocks that other
  /// threads have replaced and not retired yet.
  std::size_t room_to_retire() const { return writer_->ring().depth + std::size_t{1} + owed_; }
  /// Makes room for several publishes at once. Each publish retires one block at most. Locked.
  void make_room() {
    if (room_ahead_ == 0) [[unlikely]] {
      pool_.make_room(room_to_retire() + kRoomAhead);
      room_ahead_ = kRoomAhead;
    }
    --room_ahead_;
  }

  /// True when `retired` fill a batch. The readers are counted only if that may be so.
  bool is_batch(std::size_t retired) {
    return retired >= std::min(fit_, kUsualBatch) && retired >= batch();
  }
  std::size_t batch() {
    if (!writer_ || fit_ == 1) return 1;
    return std::min(fit_, std::max(kUsualBatch, 2 * writer_->active_readers()));
  }

  /// Retires messages that readers have taken. True when there were some. Locked.
  bool retire_taken() {
    bool any = false;
    if (!writer_ || !writer_->ring().taken) return any;
    writer_->each_taken([&](ring::Word b) {
      pool_.retire(static_cast<std::uint32_t>(b), true);
      any = true;
    });
    return any;
  }

  /// The pool has no block at hand: gets one from the overwritten messages, or a free one of the
  /// segment. Locked.
  std::uint32_t replenish() {
    retire_taken();
    const bool was_short = is_short();
    if (pool_.retired() >= (was_short ? 1 : batch())) {
      scan();
      const std::uint32_t b = pool_.try_loan();
      if (b != Pool::kNone) return b;
    }
    if (was_short && is_bound_ && evict_own()) {
      const std::uint32_t b = pool_.try_loan();
      if (b != Pool::kNone) return b;
    }
    const std::uint32_t b = claim();
    if (b == Pool::kNone) short_until_ = futex::Clock::now() + kBoundFor;
    return b;
  }

  /// Claims the block that was made ahead, or a free one of the segment. Locked.
  std::uint32_t claim() {
    const std::uint32_t b = pool_.take_ahead();
    will_need_next_ = true;
    return b != Pool::kNone ? b : pool_.claim();
  }

  /// True for a while after memory or blocks were short. Locked.
  bool is_short() {
    if (short_until_ == futex::Clock::time_point{}) return false;
    if (futex::Clock::now() < short_until_) return true;
    short_until_ = {};
    is_bound_ = false;
    return false;
  }

  /// Takes the oldest message out of the ring, unless a reader still needs it that must not lose
  /// it. The block keeps its memory for the next loan. Locked.
  bool evict_own() noexcept {
    return evict_own([](ring::Word) { return true; });
  }
  /// The same, for messages that may(block) allows.
  template <class May>
  bool evict_own(May&& may) noexcept {
    if (!writer_ || stride_ != 0) return false;
    const mutex_engine::QueueGuard queue_guard(queue_lock_, std::nothrow);
    const ring::Word b = writer_->evict_oldest(may);
    if (b < participant_->blocks()) pool_.retire(static_cast<std::uint32_t>(b), true);
    scan();
    pool_.note_batches();  // a reader may still look at it
    return b != kNoBlock;
  }

  /// Frees retired blocks that no reader's hazard names. Locked.
  void scan() {
    if (!writer_ || pool_.retired() == 0) return;
    see_hazards();
    pool_.scan([this](std::uint32_t b) { return seen_[b] == scan_; });
  }

  /// Notes which blocks readers may be looking at right now. Locked.
  void see_hazards() {
    ++scan_;
    writer_->hazards([this](ring::Word b) {
      if (b < seen_.size()) seen_[static_cast<std::size_t>(b)] = scan_;
    });
  }

  /// Publishes, wakes readers, and retires what was overwritten. Called with both locks held. It
  /// returns without them. Inlined, so that the registers of a push are saved once.
  [[gnu::always_inline]] void publish(std::unique_lock<BiasedLock>& lock,
                                      mutex_engine::QueueGuard& queue_guard, std::uint32_t b) {
    bool guarded = writer_->ring().guarded();
    // before publishing, since a reader that takes it may change it
    if (guarded && fits_vary_) note_fit(fit(b));
    // Relaxed: publishing carries it (R1).
    if (writer_->ring().taken) participant_->holder().queued(b).store(1, std::memory_order_relaxed);
    if (stamps_) [[unlikely]]
      stamp(b);
    const auto published = writer_->publish(b);
    if (!guarded && writer_->observers_may_look()) [[unlikely]] {
      guarded = true;
      if (fits_vary_) note_fit(fit(b));
    }
    queue_guard.unlock();
    // Wakes first: after a pause, all that is read here is out of the caches, and the sleeper would
    // wait for it.
    if (published.wake) wake_unlocked(lock, *published.slot);
    if (published.replaced == b) {
      pool_.retire_foreign(
          b);  // the same message again: the ring has it, and this hold is one too many
    } else if (published.replaced < participant_->blocks()) {  // else none, or damaged
      pool_.retire(static_cast<std::uint32_t>(published.replaced), guarded);
      if (guarded) {
        // Small messages wait for the next loan to look at them, unless nothing is ever loaned
        // here.
        if (fit_ == 1 || is_batch(pool_.retired() / 2)) scan();
      }
    }
    const bool taken = writer_->ring().taken;
    if (taken && retire_taken() && batch() == 1) scan();
    if (guarded && fit_ == 1) {  // large messages wait for no loan
      pool_.poll_free();
      // Else messages wait in the ring as well.
      if (!taken && history_ == PusherOptions::kAll) pool_.note_waiting();
    }
    if (!published.wake) {
      if (!pool_.has_free() && is_batch(pool_.retired())) scan();
      pool_.prepare();
      if (guarded || !fetch_ahead()) pool_.fetch_ready();
    }
    const bool is_short_of_blocks = will_need_next_;
    if (pool_.has_foreign()) release_foreign(lock);
    if (is_short_of_blocks) [[unlikely]]
      ask_for_next(lock);
  }

  /// In a lossless stream: fetches the block that will be replaced some publishes from now. True
  /// when this was done for the block that has been replaced now, which is loaned next. A hint.
  bool fetch_ahead() noexcept {
    const ring::Word b = writer_->upcoming(kPrefetchAhead);
    fetched_ = fetched_ << 1 | static_cast<std::uint32_t>(b != kNoBlock);
    if (b != kNoBlock) pool_.prefetch(b);
    return (fetched_ >> (kPrefetchAhead + 1) & 1) != 0;
  }

  /// Notes when the message is pushed, for readers of this ring that ask. Killed in between, the
  /// number tells nothing to any process.
  [[gnu::noinline]] void stamp(std::uint32_t b) noexcept {
    // Release: see Puller::time_of_push().
    __atomic_store_n(&participant_->segment().arena(b).pushed_ns, now_ns(), __ATOMIC_RELEASE);
  }
  static std::uint64_t now_ns() noexcept {
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return static_cast<std::uint64_t>(std::chrono::nanoseconds(now).count());
  }

  /// Asks Ahead for the next block. Only now, after the frame is out: the publisher needs its core
  /// to fill the frame.
  [[gnu::noinline]] void ask_for_next(std::unique_lock<BiasedLock>& lock) {
    if (!lock.owns_lock()) lock.lock();
    will_need_next_ = false;
    lock.unlock();
    participant_->ahead().next(pool_);
  }

  /// Releases the ring's holds on blocks of other pools. That takes the locks of those pools. So it
  /// is called with the lock and returns without it.
  [[gnu::noinline]] void release_foreign(std::unique_lock<BiasedLock>& lock) noexcept {
    std::array<std::uint32_t, 16> foreign;
    for (;;) {
      const std::size_t n = pool_.take_foreign(foreign);
      lock.unlock();
      for (std::size_t i = 0; i < n; ++i) participant_->holder().release(foreign[i], hold::kRing);
      if (n < foreign.size()) return;
      lock.lock();
    }
  }

  /// Wakes without the lock, since the thread that is woken may want it, on this core.
  [[gnu::noinline]] void wake_unlocked(std::unique_lock<BiasedLock>& lock,
                                       const std::atomic<ring::Word>& slot) {
    fetched_ = 0;  // this publish fetches nothing ahead
    ++owed_;
    lock.unlock();
    wake_readers(slot);
    lock.lock();
    --owed_;
  }
  [[gnu::noinline]] void wake_readers(const std::atomic<ring::Word>& slot) const {
    int woken = 0;
    participant_->segment().ring_ears(name_.channel, [&](const void* bell, bool is_asleep) {
      if (!is_asleep) return;
      ++woken <= futex::kWakes ? futex::wake_all(bell) : participant_->rouser().rouse(bell);
    });
    const std::atomic<std::uint32_t>* arrived = writer_->ring().arrived;
    const void* const word = arrived != nullptr ? arrived : futex::low_half(slot);
    if (futex::wake(word, futex::kWakes) == futex::kWakes) participant_->rouser().rouse(word);
  }

  /// How many messages like this one a batch may hold, at least one.
  std::size_t fit(std::uint32_t b) const {
    const detail::MessageType* type = participant_->holder().control(b).type;
    if (type != nullptr && type->plain && type->size <= segment::kSmallBytes) return kBatchedBytes;
    const detail::Arena& arena = participant_->segment().arena(b);
    if (arena.references != 0) return 1;  // the messages that it refers to may be big
    return std::max<std::size_t>(kBatchedBytes / std::max<std::uint64_t>(own_bytes(b), 1), 1);
  }

  /// The memory of a message beside its small payload.
  std::uint64_t own_bytes(std::uint32_t b) const noexcept {
    segment::Segment& s = participant_->segment();
    return segment::kGranule * segment::granules_of(s.arena(b), s.granules().count());
  }

  /// Sets the batch to what the largest message in the ring allows.
  void note_fit(std::size_t fit) noexcept {
    if (fit == fit_ && since_fit_ == 0) return;
    if (fit > fit_ && since_fit_ < writer_->ring().depth) {
      ++since_fit_;
    } else {
      if (fit_ == 1 && fit != 1) pool_.note_batches();
      fit_ = fit;
      since_fit_ = 0;
    }
  }

  /// Waits until the slowest reader has read, or died. A reader that is at work makes room within
  /// microseconds. Where that has been so, the sender spins first. Called with both locks held. It
  /// returns with both.
  bool wait_for_room(std::unique_lock<BiasedLock>& lock, mutex_engine::QueueGuard& queue_guard,
                     detail::RoomLimit limit) {
    if (!waits_) return false;
    ForRoom room(*this, lock, queue_guard);
    return waiting::wait(room, detail::after(std::max(limit.time, 0ns)), limit.stop);
  }
  static Status why_full(detail::RoomLimit limit) noexcept {
    return limit.is_stopped() ? Status::Stopped : Status::Full;
  }

  /// How wait_for_readers() waits: readers that come change no word.
  struct ForReaders : waiting::Steps<ForReaders> {
    ForReaders(Pusher& pusher, std::size_t count) : pusher_(pusher), count_(count) {}
    bool look() { return pusher_.readers() >= count_; }
    std::optional<waiting::Sleep<waiting::NoWords>> arm() const {
      return {{{}, futex::Clock::now() + kLookPeriod}};
    }

   private:
    Pusher& pusher_;
    std::size_t count_;
  };

  /// How a push waits for room in the ring. Meanwhile it has no lock.
  struct ForRoom : waiting::Steps<ForRoom> {
    ForRoom(Pusher& pusher, std::unique_lock<BiasedLock>& lock,
            mutex_engine::QueueGuard& queue_guard)
        : pusher_(pusher), lock_(lock), queue_guard_(queue_guard) {}
    bool look() { return pusher_.writer_->room(); }
    waiting::SpinHabit* spins() noexcept { return &pusher_.habit_; }
    /// A reader on the same core makes room then, and need not wake this thread.
    waiting::YieldHabit* yields() noexcept { return &pusher_.yield_; }
    /// The looks are far enough apart to leave the cache line of the reader's cursor with the
    /// reader, and to find room for more than one message.
    unsigned pauses(unsigned /*n*/) const noexcept { return kPausesPerLook; }
    /// Leaves the mark, too: people see by it that a publisher has found no room (`lot ls`).
    bool last_look() { return !mark(); }
    std::optional<waiting::Sleep<detail::FutexWait>> arm() {
      auto& writer = *pusher_.writer_;
      const auto value = mark();
      if (!value) return std::nullopt;
      if (++sleeps_ % kLooksPerProbe == 0) {
        writer.laggards([&](std::uint32_t c) {
          // Acquire: R8.
          const std::uint32_t who = writer.ring().who[c].load(std::memory_order_acquire);
          if (who != 0) laggards_.push_back(who - 1);
        });
      }
      return {{{writer.ring().space, *value}, futex::Clock::now() + kLookPeriod}};
    }
    void unlock() noexcept {
      queue_guard_.unlock();
      lock_.unlock();
    }
    void lock() {
      lock_.lock();
      queue_guard_.lock();
    }
    void before_sleep() {
      for (const std::uint32_t k : laggards_) pusher_.participant_->reaper().reap_if_dead(k);
      laggards_.clear();
    }

   private:
    /// The value of `space` to sleep on; nothing: there is room.
    std::optional<std::uint32_t> mark() {
      return ring::arm_for_room(*pusher_.writer_, [this] { return look(); });
    }

    Pusher& pusher_;
    std::unique_lock<BiasedLock>& lock_;
    mutex_engine::QueueGuard& queue_guard_;
    unsigned sleeps_ = 0;
    std::vector<std::uint32_t> laggards_;  ///< slow readers that may be dead
  };

  /// The pool has no block and all blocks are taken: looks everywhere.
  std::uint32_t scrape_together(bool waits) {
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
    const auto search = [&] {
      participant_->memory().tidy(pool_.index());
      if (look()) return true;
      return participant_->memory().gather_or_evict(look, pool_.index(), 1, Shortage::Blocks,
                                                    [](const Eviction::Givers&) { return true; });
    };
    if (!search() && waits && participant_->memory().may_await_readers(pool_.index())) {
      participant_->memory().await_readers(search, look, pool_.index(), Shortage::Blocks);
    }
    return b;
  }

  std::uint32_t pool() const noexcept override { return pool_.index(); }
  std::chrono::nanoseconds patience() const noexcept override { return waits_ ? block_for_ : 0ns; }

  bool settle() noexcept override {
    std::unique_lock lock(pool_.lock());
    const std::size_t before = pool_.retired();
    const bool any = retire_taken();
    scan();
    const bool fewer = any || pool_.retired() < before;
    if (pool_.has_foreign()) release_foreign(lock);
    return fewer;
  }

  std::size_t look(std::span<std::uint32_t> foreign) noexcept override {
    const std::lock_guard guard(pool_.lock());
    retire_taken();
    if (history_ != PusherOptions::kAll) take_back_read_locked();
    scan();
    return pool_.take_foreign(foreign);
  }

  bool give_up() noexcept override {
    std::unique_lock lock(pool_.lock());
    short_until_ = futex::Clock::now() + kBoundFor;
    is_bound_ = true;
    const bool any = evict_own();
    if (pool_.has_foreign()) release_foreign(lock);
    return any;
  }

  bool give_up_to_other(Shortage shortage, std::uint64_t keep) noexcept override {
    std::unique_lock lock(pool_.lock());
    const Stock now = weigh(shortage);
    // Gives up that message, unless it has been kept since.
    const bool any = now.oldest != 0 && now.held - now.oldest >= keep &&
                     is_in_ring_only(now.block) &&
                     evict_own([&](ring::Word b) { return b == now.block; });
    if (pool_.has_foreign()) release_foreign(lock);
    return any;
  }

  Stock stock(Shortage shortage) noexcept override {
    const std::lock_guard guard(pool_.lock());
    return weigh(shortage);
  }

  /// REQUIRES: the pool's lock and Eviction's.
  Stock weigh(Shortage shortage) noexcept {
    Stock stock;
    begin_to_weigh();
    bool seeks = true;  // none that frees something has come
    std::optional<std::uint32_t> first;
    each_of_ring([&](std::uint32_t b, std::uint32_t newer, bool was_read) {
      if (!is_in_ring_only(b)) return true;
      if (is_reserved(b)) {
        if (was_read) stock.reserved += shortage == Shortage::Blocks ? 1 : own_bytes(b);
        return true;
      }
      if (stays(b, shortage)) return true;
      leave(b);
      const std::uint64_t weight = weight_of(b, shortage);
      stock.held += weight;
      if (!was_read) stock.unread += weight;
      if (seeks) {
        const bool may_go = newer >= kNewest && was_read;
        if (may_go) {
          if (!first) first = b;
          stock.oldest = weight;
          stock.block = *first;
          stock.frees = *first == b ? weight : 0;
        }
        seeks = may_go && weight == 0;
      }
      return true;
    });
    return stock;
  }

  void mark(bool own, std::uint64_t keep, bool unread,
            std::vector<bool>& blocks) noexcept override {
    std::uint64_t held = own ? 0 : stock(Shortage::Memory).held;
    const std::lock_guard guard(pool_.lock());
    begin_to_weigh();
    each_of_ring([&](std::uint32_t b, std::uint32_t newer, bool was_read) {
      if (!was_read && !unread) return false;
      if (!own && stays(b, Shortage::Memory)) return true;
      leave(b);
      if (!own) {
        const std::uint64_t weight = weight_of(b, Shortage::Memory);
        if (newer < kNewest || held < keep + weight) return false;
        held -= weight;
      }
      each_that_dies(b, [&](std::uint32_t t) { blocks[t] = true; });
      return true;
    });
  }

  /// Calls f(block, number of newer ones in the ring, whether it may go) for each message in the
  /// ring, oldest first, until f says false. A message may go if no reader that must not lose it
  /// still needs it. Locked. REQUIRES: begin_to_weigh().
  template <class F>
  void each_of_ring(F&& f) const {
    const std::uint32_t depth = writer_->ring().depth;
    std::uint32_t left = 0;
    for (std::uint32_t i = 0; i < depth; ++i) left += writer_->held(i) < participant_->blocks();
    for (std::uint32_t i = 0; i < depth && left != 0; ++i) {
      const ring::Word b = writer_->held(i);
      if (b >= participant_->blocks()) continue;
      if (!f(static_cast<std::uint32_t>(b), --left, i < read_slots_)) return;
    }
  }

  /// True when the message dies as soon as it leaves the ring: no pointer, no reader and no other
  /// process has it, as far as can be seen. REQUIRES: see_hazards().
  bool is_in_ring_only(std::uint32_t b) const noexcept {
    // Relaxed: a hint. The pool looks again before the message dies.
    const std::uint64_t word =
        participant_->holder().control(b).hold.load(std::memory_order_relaxed);
    return (word & hold::kHome) != 0 && has_no_other_holder(b, participant_->holder().own.self);
  }

  /// True when no pointer, no reader and no process but this one and `home` has the message, as far
  /// as can be seen. REQUIRES: see_hazards().
  bool has_no_other_holder(std::uint32_t b, std::uint32_t home) const noexcept {
    const Holder& holder = participant_->holder();
    // Relaxed: a hint, as above.
    const std::uint64_t word = holder.control(b).hold.load(std::memory_order_relaxed);
    return hold::pointers(word) == 0 && seen_[b] != scan_ &&
           !HardwareOwnership::has_holder_besides(holder.words(b), holder.own.self, home);
  }

  /// True when another process has made the message and has let go of it, as far as can be seen: it
  /// gets the memory back as soon as no process has the message. False for what reserve() made,
  /// which stays with that process.
  bool goes_home(std::uint32_t b) const noexcept {
    const Holder& holder = participant_->holder();
    // Relaxed, here and below: hints, as in is_in_ring_only().
    const std::uint32_t home = holder.words(b).home.load(std::memory_order_relaxed);
    if (home == refcount::kHomeFree || home == holder.own.self + 1) return false;
    const bool has_let_go = home == refcount::kHomeOrphanage ||
                            (HardwareOwnership::is_awaited(holder.words(b)) && !is_reserved(b));
    return has_let_go &&
           holder.words(b).home_points.load(std::memory_order_relaxed) == 0 &&  // as above
           has_no_other_holder(b, home - 1);
  }

  /// True when reserve() made its memory: other topics have no claim on it.
  bool is_reserved(std::uint32_t b) const noexcept {
    return segment::is_reserved(participant_->segment().arena(b));
  }
  /// True when another topic's need passes the message over. REQUIRES: see_hazards().
  bool stays(std::uint32_t b, Shortage shortage) const noexcept {
    return !is_in_ring_only(b) || is_reserved(b) ||
           (shortage == Shortage::Memory && own_bytes(b) == 0 &&
            participant_->segment().arena(b).references == 0);
  }

  /// Looks at the readers' hazards and places, and forgets what was weighed before.
  void begin_to_weigh() noexcept {
    see_hazards();
    read_slots_ = writer_->read_slots();
    Holder& holder = participant_->holder();
    each_of_ring([&](std::uint32_t b, std::uint32_t, bool) {
      holder.leaving[b] = 0;
      each_reference(*holder.segment, b, [&](std::uint32_t t) { holder.leaving[t] = 0; });
      return true;
    });
  }

  /// Counts that one more place of the message has left its ring, from the oldest on.
  void leave(std::uint32_t b) noexcept {
    Holder& holder = participant_->holder();
    ++holder.leaving[b];
    if (!has_left(b)) return;
    each_reference(*holder.segment, b, [&](std::uint32_t t) { ++holder.leaving[t]; });
  }

  /// True when no ring and no message of this process has the message any more.
  bool have_all_left(std::uint32_t b) const noexcept {
    const Holder& holder = participant_->holder();
    const std::uint64_t places =
        // Relaxed: a hint, as in is_in_ring_only().
        holder.control(b).hold.load(std::memory_order_relaxed) & hold::kRingMask;
    return places != 0 && places == holder.leaving[b] * hold::kRing;
  }
  /// True when nothing holds the message any more, as far as can be seen, so that it dies.
  bool has_left(std::uint32_t b) const noexcept { return have_all_left(b) && is_in_ring_only(b); }

  /// Calls f(block) for the message that has just left, if that was its last place, and for each
  /// message that only it referred to, whatever process has made that one.
  template <class F>
  void each_that_dies(std::uint32_t b, F&& f) const noexcept {
    if (!has_left(b)) return;
    f(b);
    each_reference(participant_->segment(), b, [&](std::uint32_t t) {
      if (have_all_left(t) && (is_in_ring_only(t) || goes_home(t))) f(t);
    });
  }

  std::uint64_t weight_of(std::uint32_t b, Shortage shortage) const noexcept {
    std::uint64_t sum = 0;
    each_that_dies(
        b, [&](std::uint32_t t) { sum += shortage == Shortage::Blocks ? 1 : own_bytes(t); });
    return sum;
  }

  std::shared_ptr<Participant> participant_;
  Pool& pool_;
  const detail::MessageType* type_ = nullptr;  ///< the topic's type; null: there is no topic
  std::optional<std::uint32_t> topic_;
  registry::ChannelName name_{};
  std::optional<ring::Writer<segment::Atomics>> writer_;
  mutex_engine::QueueLock queue_lock_;
  std::uint32_t history_ = PusherOptions::kAll;  ///< this many messages that all have read stay
  bool stamps_ = false;                          ///< each push notes its time
  std::uint16_t stride_ = 0;  ///< not 0: its messages travel in their slots, so far apart,
  std::uint32_t words_ = 0;   ///< and have so many words
  bool waits_ = false;        ///< it waits for room, and for memory at most this long:
  std::chrono::nanoseconds block_for_{};
  waiting::SpinHabit habit_{Wait::Adaptive};
  waiting::YieldHabit yield_;
  /// how many messages like the largest in the ring fit into a batch
  std::size_t fit_ = kBatchedBytes;
  bool fits_vary_ = true;            ///< not all messages are as small as can be
  std::uint32_t since_fit_ = 0;      ///< messages since the last one of that size
  bool will_need_next_ = false;      ///< it has claimed a block since it last told Ahead
  std::vector<std::uint32_t> seen_;  ///< by block: the last scan that saw it in a hazard
  std::uint32_t scan_ = 0;
  std::uint32_t fetched_ = 0;     ///< by publish, the last one in bit 0: fetch_ahead() had a block
  std::uint32_t read_slots_ = 0;  ///< Writer::read_slots() when the ring was last weighed
  std::size_t room_ahead_ = 0;
  std::size_t owed_ = 0;  ///< threads that have published and wake readers before they retire
  /// Blocks or memory were short; until then they count as short. None: they were not.
  futex::Clock::time_point short_until_{};
  /// And a message of its own had to go: the next loan takes the place of the oldest.
  bool is_bound_ = false;
};

}  // namespace

std::unique_ptr<RingPusher> make_ring_pusher(std::shared_ptr<Participant> participant,
                                             std::string_view topic,
                                             const detail::MessageType& type,
                                             const PusherOptions& options,
                                             detail::Delivery delivery, std::uint32_t extra) {
  participant->check_usable();
  return std::make_unique<Pusher>(std::move(participant), topic, type, options, delivery, extra);
}

}  // namespace lot::transport

namespace lot::detail {

std::unique_ptr<PusherCore> make_pusher(std::shared_ptr<transport::Participant> participant,
                                        std::string_view topic, const MessageType& type,
                                        const PusherOptions& options, Delivery delivery) {
  return transport::make_ring_pusher(std::move(participant), topic, type, options, delivery, 0);
}

std::unique_ptr<PusherCore> make_maker(std::shared_ptr<transport::Participant> participant) {
  participant->check_usable();
  return std::make_unique<transport::Pusher>(std::move(participant));
}

}  // namespace lot::detail
