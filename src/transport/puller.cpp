// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <list>
#include <string>

#include "lot/detail/core.hpp"

#include "lockfree_ring/sleep.hpp"
#include "transport/fill.hpp"
#include "transport/participant.hpp"
#include "transport/quota.hpp"
#include "transport/ring_ends.hpp"
#include "waiting/notifier.hpp"
#include "waiting/waiting.hpp"

namespace lot::transport {
namespace {

using namespace std::chrono_literals;
using ring::kNoBlock;

using Reader = ring::Reader<segment::Atomics>;

/// This many messages without a wait are a stream. The reader then pauses this often after a
/// message before it looks again.
constexpr unsigned kBurst = 4;
constexpr unsigned kPausesAfterBurst = 50;
/// In a stream, the reader fetches the cache lines of the message that is this many places ahead.
constexpr std::uint32_t kLookAhead = 6;
/// A look makes at least so many tries to get a message out of a ring that has some. A publisher
/// that overwrites the only slot of its ring in a burst is as fast as a reader that copies there:
/// two tries were too few now and then, and the reader was told that there was nothing.
constexpr std::uint32_t kTries = 64;
constexpr auto kBusyRegistry = 5ms;
constexpr auto kLongestSleep = 1s;
/// For a subscription that holds too much: the time between two looks whether messages have been
/// let go, and the longest that a pull waits for that. A wait set or a descriptor reports waiting
/// messages once in the longer time.
constexpr auto kLookForRoom = 10ms;
constexpr auto kWaitForRoom = 1s;

class Puller final : public RingPuller {
 public:
  Puller(std::shared_ptr<Participant> participant, std::string_view topic,
         const detail::MessageType& type, const PullerOptions& options, detail::Delivery delivery,
         RingWatcher* watcher)
      : participant_(std::move(participant)),
        directory_(participant_->segment().directory().version),
        taking_(delivery != detail::Delivery::ToAll),
        working_(delivery == detail::Delivery::ToWorker),
        small_(segment::is_small(type)),
        words_(segment::words_of(type)),
        type_(type),
        topic_name_(topic),
        topic_key_(segment::topic_key(topic)),
        quota_(participant_->segment(), participant_->holder(),
               delivery == detail::Delivery::ToAll ? options.max_held_bytes : Quota::kNone),
        role_(options.observer ? Topics::Role::Observer : Topics::Role::User),
        topic_(participant_->topics().enter(topic, type, role_)),
        habit_(options.wait),
        watcher_(watcher) {
    try {
      departure_.emplace_back();
      after_reaping(participant_->reaper(), [&] { subscribe(options); });
    } catch (...) {
      participant_->topics().leave(topic_, role_);
      throw;
    }
  }

  ~Puller() override {
    if (participant_->inert()) {
      (void)notifier_.release();  // a forked child has no such thread
      return;
    }
    notifier_.reset();
    if (spare_.control != nullptr) spare_.control->hub->abandoned(spare_.control);
    note_known();
    leave_sources();
    departure_.front() = {topic_, role_, std::move(passed_)};
    participant_->topics().depart(std::move(departure_));
  }

  [[gnu::hot]] Status borrow(detail::Borrowed& borrowed, detail::Limit limit) override {
    keeping_ = false;
    return look_or_wait(borrowed, limit);
  }

  [[gnu::hot]] void done() noexcept override {
    if (participant_->inert()) return;
    Source& source = sources_[current_];
    const mutex_engine::QueueGuard queue_guard(source.lock, std::nothrow);
    end(source);
  }

  [[gnu::hot]] detail::Kept keep() override {
    participant_->check_usable();
    if (!quota_.allows_one_more()) refuse_to_hold();
    if (!in_slot_) return {hold_it(), root_};
    if (spare_.control == nullptr && !make_spare()) refuse_to_hold();
    std::memcpy(spare_.root, letter_, type_.size);
    return hold_spare();
  }

  [[noreturn, gnu::cold]] void refuse_to_hold() const override {
    if (lacks_spare_) throw OutOfMemory(describe_block_shortage(participant_->memory()).c_str());
    throw Error(EDQUOT, topic_name_, "the subscription " + quota_.describe(),
                "let messages go, or raise PullerOptions::max_held_bytes");
  }

  [[gnu::hot]] Status pull(detail::Borrowed& kept, detail::Limit limit) override {
    keeping_ = true;
    if (!quota_.allows_one_more()) [[unlikely]] {
      const Status status = pull_when_full(limit);
      if (status != Status::Ok) return found_none(kept, status);
    }
    return look_or_wait(kept, limit);
  }

  void describe(detail::Claim& claim) const override {
    const Source& s = sources_[current_];
    claim.origin = {s.name.channel, s.name.generation, ring::claim_sequence(claim_)};
    claim.slot = claimed_slot_;
    claim.word = claim_;
    claim.deliveries = static_cast<std::uint32_t>(ring::claim_deliveries(claim_));
  }

  /// Crash:   killed before the bell, the sender looks by itself. Killed before the other workers
  ///          are told of the end, they look by themselves.
  void finish(const detail::Claim& claim) noexcept override {
    Source* const s = source_of(claim.origin);
    if (s == nullptr) return;  // another process has damaged the segment
    segment::Ring ring = s->reader.ring();
    if (claim.slot >= ring.depth) return;  // the segment is damaged, as above
    ring::empty(ring.slots[claim.slot], claim.origin.sequence);
    if (s->reader.sender_waits()) ring_bell(s->reader);
    if (s->reader.is_closing()) wake_sleepers(ring);
  }

  void give_back(const detail::Claim& claim) noexcept override {
    Source* const s = source_of(claim.origin);
    if (s == nullptr) return;
    segment::Ring ring = s->reader.ring();
    if (claim.slot >= ring.depth) return;
    ring.give_back(claim.slot, claim.word);
    wake_sleepers(ring);
  }

  std::size_t size() override {
    participant_->check_usable();
    // Acquire, here and wherever the version is compared: D1. It carries nothing: the registry's
    // lock carries the rings.
    if (directory_.load(std::memory_order_acquire) != version_) find_new_rings();
    std::size_t n = 0;
    for (const Source& s : sources_) n += s.reader.size();
    return n;
  }

  bool ready() override {
    if (keeping_ && may_be_full()) return false;  // arm() says when to look again
    // Relaxed: a hint. The next look acquires.
    return (directory_.load(std::memory_order_relaxed) != version_ && !not_before_) || is_over() ||
           std::any_of(sources_.begin(), sources_.end(),
                       [](const Source& s) { return s.reader.ready() || s.reader.is_closing(); });
  }

  std::span<const Source> sources() const noexcept override { return sources_; }

  std::uint32_t topic() const noexcept override { return topic_; }

  Envelope envelope() const override {
    participant_->check_usable();
    if (last_ == 0) return {};
    if (last_source() == kLeft) {
      return envelope_from(left_.name, left_.publisher, left_.first, left_.stamps);
    }
    const Source& s = sources_[last_source()];
    return envelope_from(s.name, s.publisher, s.reader.ring().first, s.stamps);
  }

  detail::Origin origin() const noexcept override {
    const Source& s = sources_[current_];
    return {s.name.channel, s.name.generation, s.reader.cursor()};
  }

  std::optional<detail::Clock::time_point> pushed() const noexcept override {
    return sources_[current_].stamps ? time_of_push() : std::nullopt;
  }

  std::uint64_t memory() const noexcept override {
    if (in_slot_) return sources_[current_].reader.ring().slots.stride();
    return std::max(granules() * segment::kGranule, segment::kSmallBytes);
  }

  bool join_anew(const registry::ChannelName& name) override {
    const auto s = std::find_if(sources_.begin(), sources_.end(),
                                [&name](const Source& source) { return source.name == name; });
    if (s == sources_.end()) return false;
    bool full = false;
    const auto again = join(s->reader.ring(), name, Reader::kFromTheStart, full);
    if (!again) return false;
    leave(s->reader);
    s->reader = *again;
    participant_->segment().ring_ears(name.channel);  // its marks are not where it goes on
    return true;
  }

  int fd() override {
    participant_->check_usable();
    if (!notifier_) {
      notifier_ = std::make_unique<waiting::Notifier>(participant_->descriptors());
      notifier_->watch(*this);
    }
    return notifier_->fd();
  }

  [[gnu::hot]] std::optional<detail::Clock::time_point> arm(detail::FutexWaits& waits) override {
    participant_->check_usable();
    if (borrowing_) return std::nullopt;  // the next look reports what is wrong
    if (directory_.load(std::memory_order_acquire) != version_) find_new_rings();  // D1
    if (has_messages()) {
      const bool is_full = keeping_ && may_be_full() && !may_keep_one();
      return is_full ? when_to_tell() : std::nullopt;
    }
    const std::size_t rings = sources_.size();
    if (!settle()) return std::nullopt;
    // The caller looks first: it may have kept messages of a ring that has ended just now.
    if (watcher_ != nullptr && sources_.size() != rings) return std::nullopt;
    if (is_forsaken() || is_over()) return std::nullopt;  // the next look tells it
    const ring::Rest rest = waits.hearer() != nullptr ? arm_by(*waits.hearer()) : arm_words(waits);
    if (rest == ring::Rest::Look) return std::nullopt;
    // Doze: another process keeps the registry's lock for a short time, else the new rings would
    // have been found. Sleep: the low half of a slot repeats after 1024 messages, so a sleeper that
    // was delayed for exactly 1024 messages can miss its wake-up. It looks again after
    // kLongestSleep.
    return futex::Clock::now() + (rest == ring::Rest::Sleep ? kLongestSleep : kBusyRegistry);
  }

  std::shared_ptr<waiting::EarOwner> ear_owner() noexcept override { return participant_; }

  void ring_own_ears() noexcept override {
    for (const Source& s : sources_) participant_->segment().ring_ears(s.name.channel);
    participant_->call_watchers();
  }

  std::size_t publishers() override {
    participant_->check_usable();
    if (directory_.load(std::memory_order_acquire) != version_) {  // D1
      const registry::Registry::Lock lock(participant_->registry());
      find_rings();
    }
    return static_cast<std::size_t>(std::count_if(
        sources_.begin(), sources_.end(), [](const Source& s) { return !s.reader.orphaned(); }));
  }

 private:
  /// What last_ says: {sequence : 42 | index in sources_ : 21 | 1}. One word, since each message
  /// writes it.
  static constexpr ring::Word kSeen = 1;
  static constexpr unsigned kIndexShift = 1;
  static constexpr ring::Word kLeft = (ring::Word{1} << (ring::kSequenceShift - kIndexShift)) - 1;

  /// What an envelope says of a ring that this puller has left.
  struct LeftRing {
    registry::ChannelName name{};
    std::string publisher;
    ring::Word first = 0;
    bool stamps = false;
  };

  Source* source_of(const detail::Origin& origin) {
    for (Source& s : sources_) {
      if (s.name.channel == origin.channel && s.name.generation == origin.generation) return &s;
    }
    return nullptr;
  }

  Status look_or_wait(detail::Borrowed& borrowed, detail::Limit limit) {
    const Status status = try_or_wait(borrowed, limit);
    return status == Status::Ok ? status : found_none(borrowed, status);
  }

  Status found_none(detail::Borrowed& borrowed, Status status) {
    borrowed.missed = std::exchange(missed_, 0);
    if (notifier_) notifier_->watch(*this);
    return status;
  }

  Status try_or_wait(detail::Borrowed& borrowed, detail::Limit limit) {
    if (limit.is_stopped()) return Status::Stopped;
    if (look(borrowed)) {
      ++burst_;
      return Status::Ok;
    }
    if (lacks_spare_) [[unlikely]]
      return wait_for_spare(borrowed, limit);
    if (!limit.waits()) {
      if (!settle() && look(borrowed)) return Status::Ok;
      return why_none(Status::Empty);
    }
    return wait_and_look(borrowed, limit);
  }

  /// True: no publisher has a ring. A ring that this reader has not found yet may hold what was
  /// published: the registry's lock was taken. Acquire: D1.
  bool is_alone() const noexcept {
    return sources_.empty() && directory_.load(std::memory_order_acquire) == version_;
  }
  /// True: the topic carries another type now, and what it carried before was read.
  bool is_over() const noexcept { return is_superseded_ && sources_.empty(); }
  /// True: a publisher was there since this was told last, and none is now.
  bool is_forsaken() const noexcept { return had_publisher_ && is_alone(); }
  /// PublisherGone where there is no publisher, or what the look says otherwise.
  Status why_none(Status otherwise) noexcept { return is_alone() ? tell_gone() : otherwise; }
  Status tell_gone() noexcept {
    had_publisher_ = false;
    return Status::PublisherGone;
  }

  /// Looks once at every ring, beginning behind the ring that had the last message.
  [[gnu::hot]] bool look(detail::Borrowed& borrowed) {
    if (participant_->inert() || borrowing_) [[unlikely]]
      refuse();
    if (directory_.load(std::memory_order_acquire) != version_) [[unlikely]]  // D1
      find_new_rings();
    const std::size_t n = sources_.size();
    lacks_spare_ = false;
    if (working_) [[unlikely]]
      begin_with_returns();
    for (std::size_t i = 0; i < n; ++i) {
      if (++current_ >= n) current_ = 0;
      Source& source = sources_[current_];
      const Reader& reader = source.reader;
      // A mutex ring is looked at only if it is ready: else other threads would wait for its lock
      // for nothing.
      if (reader.ring().arrived != nullptr && !reader.ready()) continue;
      if (reader.ring().in_slots()) {
        // The block first: once its copy is there, a message can be kept.
        if (keeping_ && spare_.control == nullptr && reader.ready() && !make_spare()) continue;
        // A reader that borrows is as fast as its publisher: it would take away lines that are
        // being written. One that keeps lags behind, and its messages are there before their turn.
        if (keeping_ && burst_ >= kBurst) reader.prefetch(kLookAhead);
      } else {
        prefetch(reader.peek(0));
        if (burst_ >= kBurst) prefetch(reader.peek(kLookAhead));
      }
      if (look_into(source, borrowed)) return true;
    }
    if (is_over()) [[unlikely]]
      refuse_superseded();
    return false;
  }

  /// Looks into one ring, at most for twice its depth, or kTries. Without that limit it could go on
  /// for ever: other readers may be faster each time, and a faulty process may change the words all
  /// the time. The poll finds by itself where words lead round and round the sequence numbers.
  [[gnu::hot]] bool look_into(Source& source, detail::Borrowed& borrowed) {
    const Source::Turn turn(source);
    ring::Word lapped = 0;
    const std::uint32_t most = std::max(2 * source.reader.ring().depth, kTries);
    for (std::uint32_t tries = 0; tries < most; ++tries) {
      const ring::Word b = working_ ? source.reader.poll_unclaimed(missed_, lapped)
                                    : source.reader.poll(missed_, lapped);
      if (b == kNoBlock) return false;
      if (source.reader.ring().in_slots()) {
        if (b != ring::kInSlot) [[unlikely]]
          skip_damaged("its slot in the queue cannot be right");
        // It has come since: the next look has a block for it.
        if (keeping_ && spare_.control == nullptr) return false;
        if (!copied(borrowed, source)) continue;
        if (!keeping_) return true;
        const bool ours = !taking_ || take(source);
        end(source);
        if (!ours) continue;
        borrowed.control = hold_spare().control;
        return true;
      }
      found(borrowed, b);
      if (!keeping_) return true;
      borrowed.control = hold_it();
      const bool ours = !taking_ || take(source);
      end(source);
      if (ours) return true;
      borrowed.control->drop_pointer();
    }
    return false;
  }

  bool may_keep_one() { return quota_.allows_one_more() && (!lacks_spare_ || make_spare()); }
  /// Whether it could keep no more when it last tried.
  bool may_be_full() const noexcept { return quota_.is_full() || lacks_spare_; }

  /// Copies the message that the poll has found in its slot: into the spare block if it is to be
  /// kept. False: it has gone meanwhile.
  [[gnu::hot]] bool copied(detail::Borrowed& borrowed, Source& source) {
    void* const into = keeping_ ? spare_.root : letter_;
    ring::Word time = 0;
    const ring::Copy copy =
        source.reader.copy(into, words_, source.stamps ? &time : nullptr, missed_);
    if (copy == ring::Copy::Overwritten) return false;
    if (copy == ring::Copy::Damaged) [[unlikely]]
      skip_damaged("its slot in the queue says what no publisher says");
    note_found(borrowed);
    pushed_ns_ = time;
    borrowed.root = into;
    borrowed.control = nullptr;
    in_slot_ = true;
    return true;
  }

  /// Makes a block into which a message can be copied. False: there is none.
  bool make_spare() {
    participant_->check_usable();  // before the lock: a forked child may have inherited it locked
    if (!keeper_) {
      keeper_ = participant_->keeper(
          [this] { return std::shared_ptr<detail::PusherCore>(detail::make_maker(participant_)); });
    }
    spare_ = keeper_->loan(type_.element != nullptr ? *type_.element : type_, false);
    lacks_spare_ = spare_.control == nullptr;
    return !lacks_spare_;
  }
  /// Makes the message in the spare block one that the caller has a pointer to. REQUIRES:
  /// there is one, and the quota allows one more.
  [[gnu::hot]] detail::Kept hold_spare() {
    const detail::Loan message = std::exchange(spare_, {});
    block_ = message.control->block;
    if (!taking_) {  // a taken message has one owner, as one that is loaned
      HardwareOwnership::keep_unseen(participant_->segment().block(block_), message.control->hold);
    }
    detail::write_once(participant_->segment().arena(block_).topic, topic_key_);  // for people
    note_held(0);
    return {message.control, message.root};
  }

  /// Items that have come back are the oldest there are: the next look begins at their ring.
  void begin_with_returns() {
    for (std::size_t i = 0; i < sources_.size(); ++i) {
      if (!sources_[i].reader.has_returns()) continue;
      current_ = i == 0 ? sources_.size() - 1 : i - 1;
      return;
    }
  }

  /// REQUIRES: the quota allows one more.
  [[gnu::hot]] detail::ControlBlock* hold_it() {
    participant_->holder().acquire(block_, hold::kPointer);
    note_held(small_ && type_.plain ? 0 : granules());
    return &participant_->holder().control(block_);
  }
  /// Notes that a pointer was made of the last message, which is in block_.
  void note_held(std::uint64_t granules) noexcept {
    held_ = last_;
    held_life_ = quota_.counts() ? quota_.note(block_, granules) : generation_of(block_);
  }

  std::uint64_t granules() const noexcept {
    segment::Segment& s = participant_->segment();
    return segment::granules_of(s.arena(block_), s.granules().count());
  }

  bool looks_into_slots() const noexcept {
    return current_ < sources_.size() && sources_[current_].reader.ring().in_slots();
  }
  bool has_messages() const noexcept {
    return std::any_of(sources_.begin(), sources_.end(),
                       [](const Source& s) { return s.reader.ready(); });
  }

  /// A pull while the quota is full. Ok: the caller may look. Where there is no message the pull
  /// ends, or waits, as any other.
  [[gnu::noinline]] Status pull_when_full(detail::Limit limit) {
    if (limit.is_stopped()) return Status::Stopped;
    ForAny any(*this);
    if (!any.look()) {
      if (!limit.waits()) return why_none(Status::Empty);
      if (!waiting::wait(any, limit.deadline(), limit.stop())) return why_ended(limit);
    }
    if (is_forsaken()) return tell_gone();
    if (limit.waits() && wait_for_quota(limit)) return Status::Ok;
    return limit.is_stopped() ? Status::Stopped : Status::HoldsTooMuch;
  }
  /// False: the time is up, or it was told to stop, and the process has let no message go.
  bool wait_for_quota(detail::Limit limit) {
    if (may_keep_one()) return true;
    auto until = futex::Clock::now() + kWaitForRoom;
    if (const auto deadline = limit.deadline()) until = std::min(until, *deadline);
    ForQuota let_go(*this);
    return waiting::wait(let_go, until, limit.stop());
  }
  /// Of a wait in which nothing came.
  Status why_ended(detail::Limit limit) noexcept {
    return limit.is_stopped() ? Status::Stopped : why_none(Status::Timeout);
  }
  /// When to report messages that wait while the subscription holds too much. Nothing: report them
  /// now.
  std::optional<detail::Clock::time_point> when_to_tell() {
    const auto now = futex::Clock::now();
    if (now >= tell_again_) {
      tell_again_ = now + kWaitForRoom;
      return std::nullopt;
    }
    return now + kLookForRoom;
  }

  /// Takes the message that this process holds out of the queue, or claims it. False: another
  /// reader was faster.
  ///
  /// Crash:   killed before the item says that it has changed hands, this process has not changed
  ///          it.
  bool take(Source& source) {
    if (working_) {
      claimed_slot_ = source.reader.index();
      claim_ = source.reader.claim(participant_->index());
      return claim_ != 0;
    }
    if (!source.reader.take()) return false;
    if (in_slot_) return true;
    // Only after the take: the reader that was faster may be the home.
    if (participant_->holder().is_home(block_)) {
      participant_->segment().build(block_).take_again();
    } else {
      participant_->segment().arena(block_).change_hands();
    }
    return true;
  }

  /// The index of the last message's ring in sources_, or kLeft: it is in left_. REQUIRES: there
  /// was a message.
  std::size_t last_source() const noexcept { return last_ >> kIndexShift & kLeft; }

  Envelope envelope_from(const registry::ChannelName& name, const std::string& publisher,
                         ring::Word first, bool stamps) const {
    Envelope envelope;
    envelope.sequence = ring::advance(ring::sequence(last_), ring::kSequenceMask + 1 - first);
    envelope.publisher = publisher;
    envelope.publisher_id = std::uint64_t{name.generation} << 32 | name.channel;
    if (stamps) envelope.pushed = time_of_push();
    return envelope;
  }

  /// When the last message was pushed. None: that message is not there any more. REQUIRES: its ring
  /// is of a publisher that stamps.
  ///
  /// The word may belong to a later message of the block, if this process has let go of its own.
  /// That message's home has bumped the block's generation before any process could write the word
  /// for it. So the word is loaded first, by acquire, and then the generation.
  std::optional<futex::Clock::time_point> time_of_push() const noexcept {
    const std::uint64_t ns =
        in_slot_
            ? pushed_ns_
            : __atomic_load_n(&participant_->segment().arena(block_).pushed_ns, __ATOMIC_ACQUIRE);
    const bool is_there = borrowing_ || (held_ == last_ && generation_of(block_) == held_life_);
    // A number that the clock cannot have, as the difference to its times may not be one.
    if (!is_there || ns == 0 || ns > std::uint64_t{INT64_MAX}) return std::nullopt;
    return futex::Clock::time_point(std::chrono::nanoseconds(static_cast<std::int64_t>(ns)));
  }
  /// Relaxed: a message that is held keeps its generation. For others, see time_of_push().
  std::uint32_t generation_of(std::uint32_t b) const noexcept {
    return refcount::generation_of(
        participant_->segment().block(b).life.load(std::memory_order_relaxed));
  }

  /// Ends the borrow.
  void end(Source& source) noexcept {
    if (source.reader.done()) ring_bell(source.reader);
    borrowing_ = false;
  }

  void prefetch(ring::Word b) const {
    if (b >= participant_->blocks()) return;
    const auto index = static_cast<std::uint32_t>(b);
    segment::Atomics::prefetch_read(participant_->segment().small(index));
    if (keeping_) segment::Atomics::prefetch_write(&participant_->holder().words(index));
  }

  void found(detail::Borrowed& borrowed, ring::Word b) {
    segment::Segment& s = participant_->segment();
    if (b >= participant_->blocks()) [[unlikely]]
      skip_damaged("its slot in the queue cannot be right");
    const auto block = static_cast<std::uint32_t>(b);
    if (small_) {
      borrowed.root = s.small(block);
    } else {
      borrowed.root = s.message_at(block, type_);
      if (borrowed.root == nullptr) [[unlikely]]
        skip_damaged("it is said to lie where it cannot be");
    }
    block_ = block;
    root_ = borrowed.root;
    in_slot_ = false;
    note_found(borrowed);
    borrowed.control = &participant_->holder().control(block_);
  }
  void note_found(detail::Borrowed& borrowed) noexcept {
    last_ = ring::make(sources_[current_].reader.cursor(), current_ << kIndexShift | kSeen);
    borrowed.missed = missed_;
    missed_ = 0;
    borrowing_ = true;
  }

  /// Called after a look that found nothing. False: there is something to look at after all.
  [[gnu::hot]] bool settle() {
    return ring::settle(
        sources_, [this](Reader& reader) { ring_bell(reader); },
        [this](Reader& reader) {
          if (watcher_ != nullptr) watcher_->leaving(source_with(reader));
          remember(reader);
          pass(reader);
          leave(reader);
          participant_->reaper().collect();
        });
  }

  [[gnu::hot]] Status wait_and_look(detail::Borrowed& borrowed, detail::Limit limit) {
    ForMessage message(*this, borrowed, std::exchange(burst_, 0) >= kBurst);
    if (!waiting::wait(message, limit.deadline(), limit.stop())) return why_ended(limit);
    if (message.is_there()) return Status::Ok;
    return lacks_spare_ ? wait_for_spare(borrowed, limit) : tell_gone();
  }
  /// There is a message in a slot, and no block to keep it in.
  [[gnu::noinline]] Status wait_for_spare(detail::Borrowed& borrowed, detail::Limit limit) {
    if (limit.waits() && wait_for_quota(limit) && look(borrowed)) return Status::Ok;
    return limit.is_stopped() ? Status::Stopped : Status::HoldsTooMuch;
  }

  ring::Rest arm_words(detail::FutexWaits& waits) {
    return ring::prepare_to_sleep(
        sources_, directory_, version_, [&waits](const auto& word, auto value, bool stood) {
          waits.push_back_marked(futex_of(word), static_cast<std::uint32_t>(value), stood);
        });
  }
  ring::Rest arm_by(detail::Hearer& hearer) {
    for (const Source& s : sources_) hearer.listen(s.name.channel);  // before the marks: H1
    return ring::prepare_to_sleep(sources_, directory_, version_,
                                  [&](const auto& word, auto value, bool /*stood*/) {
                                    if (futex_of(word) == &directory_.word()) {
                                      hearer.watch_directory(static_cast<std::uint32_t>(value));
                                    }
                                  });
  }

  /// Leaves the marks for whatever this puller waits for. Nothing: look at once.
  [[gnu::hot]] std::optional<waiting::Sleep<detail::FutexWaits&>> prepare_to_sleep() {
    waits_.clear();
    const auto again = arm(waits_);
    if (!again) return std::nullopt;
    return {{waits_, again}};
  }

  /// How a borrow and a pull wait for the next message, or until the last publisher goes.
  struct ForMessage : waiting::Steps<ForMessage> {
    static constexpr unsigned kPollsPerClock = 64;
    /// They follow each other at once: a pause would add to the latency.
    static constexpr unsigned kEagerPolls = 4096;

    ForMessage(Puller& puller, detail::Borrowed& borrowed, bool streaming)
        : puller_(puller), borrowed_(borrowed), streaming_(streaming) {}
    bool look() {
      is_there_ = puller_.look(borrowed_);
      return is_there_ || puller_.is_forsaken() || puller_.lacks_spare_;
    }
    bool is_there() const noexcept { return is_there_; }
    waiting::SpinHabit* spins() noexcept { return &puller_.habit_; }
    /// A publisher on the same core gets ahead then, instead of waking this reader for each
    /// message.
    waiting::YieldHabit* yields() noexcept { return streaming_ ? &puller_.yield_ : nullptr; }
    /// Right behind a streaming publisher, every message would cost both sides the slot's cache
    /// line. So the reader first lets the publisher get ahead. And where the message lies in its
    /// slot, each look takes the line away from the publisher that is writing there.
    unsigned pauses(unsigned n) const noexcept {
      if (n == 0 && streaming_) return kPausesAfterBurst;
      return n < kEagerPolls && !puller_.looks_into_slots() ? 0 : 1;
    }
    void settle() { puller_.settle(); }  // else a publisher that waits for room may sleep
    auto arm() { return puller_.prepare_to_sleep(); }

   private:
    Puller& puller_;
    detail::Borrowed& borrowed_;
    bool streaming_;
    bool is_there_ = false;
  };

  /// How a pull that may keep no more waits until there is any message.
  struct ForAny : waiting::Steps<ForAny> {
    explicit ForAny(Puller& puller) : puller_(puller) {}
    bool look() {
      if (puller_.participant_->inert() || puller_.borrowing_) puller_.refuse();
      // D1
      if (puller_.directory_.load(std::memory_order_acquire) != puller_.version_) {
        puller_.find_new_rings();
      }
      if (puller_.is_over()) puller_.refuse_superseded();
      return puller_.has_messages() || !puller_.settle() || puller_.is_forsaken();
    }
    auto arm() { return puller_.prepare_to_sleep(); }

   private:
    Puller& puller_;
  };

  /// How it then waits until the process lets messages go, which changes no word.
  struct ForQuota : waiting::Steps<ForQuota> {
    explicit ForQuota(Puller& puller) : puller_(puller) {}
    bool look() { return puller_.may_keep_one(); }
    std::optional<waiting::Sleep<waiting::NoWords>> arm() const {
      return {{{}, futex::Clock::now() + kLookForRoom}};
    }

   private:
    Puller& puller_;
  };

  void wake_sleepers(segment::Ring& ring) noexcept {
    ring::wake_sleepers(
        ring, [](const auto& word) { futex::wake_all(futex_of(word)); },
        [this](std::uint32_t channel) { participant_->segment().ring_ears(channel); });
  }

  static const void* futex_of(const std::atomic<ring::Word>& word) { return futex::low_half(word); }
  static const void* futex_of(const std::atomic<std::uint32_t>& word) { return &word; }

  bool knows(const registry::ChannelName& name) const {
    return std::any_of(sources_.begin(), sources_.end(),
                       [&](const Source& s) { return s.name == name; }) ||
           std::find(passed_.begin(), passed_.end(), name) != passed_.end();
  }

  void subscribe(const PullerOptions& options) {
    try {
      const registry::Registry::Lock lock(participant_->registry());
      announce_and_join(taking_ ? Reader::kFromTheStart : options.history);
    } catch (...) {
      leave_sources();
      passed_.clear();
      throw;
    }
  }

  /// If it fails, no cell awaits this puller, since a new ring needs the lock, too. Cells
  /// that await other pullers of this process remain. REQUIRES: the registry's lock.
  void announce_and_join(std::uint64_t history) {
    registry::Registry& registry = participant_->registry();
    if (watcher_ != nullptr) watcher_->announcing(topic_);
    if (observes()) return join_what_is_there(history);
    registry.add_puller(topic_, participant_->index());
    try {
      join_what_is_there(history);
    } catch (...) {
      registry.remove_puller(topic_, participant_->index());
      throw;
    }
  }

  /// Joins the open rings of the topic when it is subscribed to.
  void join_what_is_there(std::uint64_t history) {
    const std::uint32_t version = directory_.load(std::memory_order_acquire);  // D1
    for (const auto& name : participant_->registry().rings(topic_)) {
      make_room_for_one();
      const segment::Ring ring = participant_->segment().ring(name.channel);
      std::string publisher = publisher_of(ring);
      bool full = false;
      std::optional<Reader> reader;
      if (participant_->registry().is_open(name)) {
        if (!is_of_our_kind(ring)) {
          throw Error(EBADMSG, participant_->segment().path(),
                      "the queue of a publisher of the topic is damaged", "restart the publisher");
        }
        reader = join(ring, name, history, full);
      }
      if (full) refuse_full(ring);
      if (reader) {
        begin(*reader, name, std::move(publisher));
      } else {  // the ring has ended before
        passed_.push_back(name);
      }
    }
    version_ = version;
  }

  std::optional<Reader> join(const segment::Ring& ring, const registry::ChannelName& name,
                             std::uint64_t history, bool& full) {
    return Reader::join(
        ring, name.generation, participant_->index(), history, full,
        [&](std::uint32_t cell) {
          if (watcher_ != nullptr) watcher_->joining(ring, cell);
        },
        observes() ? Reader::Manner::Observes : Reader::Manner::Reads);
  }

  /// Finds rings that were made since. Each has a cell for this puller, which reads it from its
  /// first message, also when it has ended meanwhile. No cell awaits an observer: it joins the ring
  /// if that has not ended. REQUIRES: the registry's lock.
  void find_rings() {
    const std::uint32_t version = directory_.load(std::memory_order_acquire);  // D1
    const auto rings = participant_->registry().rings(topic_);
    std::erase_if(passed_, [&rings](const auto& name) {
      return std::find(rings.begin(), rings.end(), name) == rings.end();
    });
    for (const auto& name : rings) {
      if (knows(name)) continue;
      make_room_for_one();
      const segment::Ring ring = participant_->segment().ring(name.channel);
      std::string publisher = publisher_of(ring);
      std::optional<Reader> reader;
      if (is_of_our_kind(ring)) reader = find_place(ring, name);
      if (reader) {
        begin(*reader, name, std::move(publisher));
      } else {  // its control is damaged
        passed_.push_back(name);
      }
    }
    if (observes()) is_superseded_ = participant_->registry().is_superseded(topic_);
    version_ = version;
    not_before_.reset();
  }

  std::optional<Reader> find_place(const segment::Ring& ring, const registry::ChannelName& name) {
    if (!observes()) return Reader::take_awaited(ring, participant_->index());
    if (!participant_->registry().is_open(name)) return std::nullopt;
    bool full = false;
    const auto reader = join(ring, name, Reader::kFromTheStart, full);
    if (full) {
      passed_.push_back(name);  // the next look goes on
      refuse_full(ring);
    }
    return reader;
  }
  bool observes() const noexcept { return role_ == Topics::Role::Observer; }

  /// True if the ring is of this puller's kind, as the type of the topic says. It is unless the
  /// segment is damaged.
  bool is_of_our_kind(const segment::Ring& ring) const {
    return ring.depth != 0 && ring.taken == taking_ && (ring.claims != nullptr) == working_ &&
           (!ring.in_slots() || fits_into_slots(ring));
  }

  bool fits_into_slots(const segment::Ring& ring) const {
    const bool with_time = detail::read_once(segment::Segment::head_of(ring).stamps) == 1;
    // A type without a description here is not plain, and has no destructor.
    return (type_.plain || type_.destroy == nullptr) &&
           type_.size <= ring::Slots<segment::Atomics>::room(ring.slots.stride(), with_time);
  }

  /// Makes room first, as publisher_of() does: where there is no memory, no cell is lost. A source
  /// that ends is passed.
  void make_room_for_one() {
    sources_.reserve(sources_.size() + 1);
    passed_.reserve(passed_.size() + sources_.size() + 1);
  }

  /// A copy, as any process may change the name. Empty: the ring is damaged. REQUIRES: no process
  /// recycles the ring meanwhile.
  static std::string publisher_of(const segment::Ring& ring) {
    std::string name;
    if (ring.depth == 0) return name;
    (void)ring.writer->load(std::memory_order_acquire);  // R7
    for (const char& shared : segment::Segment::head_of(ring).publisher) {
      const char c = detail::read_once(shared);
      if (c == '\0') break;
      name += c;
    }
    return name;
  }

  void begin(const Reader& reader, const registry::ChannelName& name,
             std::string publisher) noexcept {
    missed_ += reader.skipped();
    had_publisher_ = true;
    const bool stamps = detail::read_once(segment::Segment::head_of(reader.ring()).stamps) == 1;
    sources_.push_back(
        {reader, name, participant_->queue_lock(name.channel), std::move(publisher), stamps});
  }

  Source& source_with(const Reader& reader) {
    return *std::find_if(sources_.begin(), sources_.end(),
                         [&reader](const Source& s) { return &s.reader == &reader; });
  }
  /// Keeps what envelope() needs, before this ring leaves sources_.
  void remember(const Reader& reader) noexcept {
    Source& s = source_with(reader);
    const auto index = static_cast<std::size_t>(&s - sources_.data());
    const bool is_held = held_ == last_;
    held_ = is_held ? last_ : 0;  // else it could name a place that another ring will have
    if (last_ == 0 || last_source() == kLeft || index > last_source()) return;
    if (index < last_source()) {
      last_ -= ring::Word{1} << kIndexShift;
    } else {
      left_ = {s.name, std::move(s.publisher), s.reader.ring().first, s.stamps};
      last_ |= kLeft << kIndexShift;
    }
    held_ = is_held ? last_ : 0;
  }
  void pass(const Reader& reader) { passed_.push_back(source_with(reader).name); }

  /// On the data path. So it never waits for the registry's lock, and the next look tries again.
  void find_new_rings() {
    if (not_before_ && futex::Clock::now() < *not_before_) return;
    registry::Registry& registry = participant_->registry();
    if (!registry.try_lock()) {
      not_before_ = futex::Clock::now() + kBusyRegistry;
      return;
    }
    const struct Unlock {
      registry::Registry& registry;
      ~Unlock() { registry.unlock(); }
    } unlock{registry};
    find_rings();
  }

  void ring_bell(Reader& reader) noexcept {
    auto& space = *reader.ring().space;
    if (Reader::ring_bell(space)) futex::wake_all(&space);
  }

  void leave(Reader& reader) noexcept {
    reader.leave();
    futex::wake_all(reader.ring().space);
  }

  void leave_sources() noexcept {
    for (Source& s : sources_) leave(s.reader);
    sources_.clear();
    participant_->reaper()
        .collect();  // this may have been the last reader of a ring that has ended
  }

  /// Notes the rings that this puller need not leave, or has left. In all other rings a cell awaits
  /// it.
  void note_known() noexcept {
    // make_room_for_one() has made room.
    for (const Source& s : sources_) passed_.push_back(s.name);
  }

  [[noreturn]] void refuse() const {
    participant_->check_usable();
    throw Error(EBUSY, participant_->segment().path(),
                "this puller has a borrow that has not ended",
                "end it (one borrow at a time), or keep() the message");
  }

  [[noreturn, gnu::cold]] void refuse_full(const segment::Ring& ring) const {
    std::uint32_t observers = 0;
    for (std::uint32_t c = 0; c < ring.readers; ++c) {
      observers +=
          ring::is_observer(ring.cells[c].position.load(std::memory_order_relaxed));  // a hint
    }
    throw Error(EUSERS, participant_->segment().path(),
                "a publisher of the topic has all the " + std::to_string(ring.readers) +
                    " readers that it can have, of which " + std::to_string(observers) +
                    " only observe",
                "make the segment with a larger EngineOptions::readers");
  }

  [[noreturn, gnu::cold]] void refuse_superseded() const {
    throw Error(ESTALE, topic_name_, "the topic carries another type now", "subscribe to it again");
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

  // These are read for each message, so they lie close to each other.
  std::shared_ptr<Participant> participant_;
  ring::DirectoryVersion<segment::Atomics>& directory_;
  std::vector<Source> sources_;
  std::size_t current_ = 0;
  std::uint64_t missed_ = 0;
  std::uint32_t version_ = 0;  ///< the directory's version that sources_ is right for
  std::uint32_t block_ = 0;
  const void* root_ = nullptr;   ///< the last message that was borrowed from its block
  unsigned burst_ = 0;           ///< messages since the last wait
  ring::Word last_ = 0;          ///< the last message, in block_, for envelope(); 0: none
  ring::Word held_ = 0;          ///< last_, if a pointer was made of that message
  std::uint32_t held_life_ = 0;  ///< and its generation
  bool borrowing_ = false;
  bool keeping_ = false;        ///< a message that is found is kept at once
  bool had_publisher_ = false;  ///< since PublisherGone was told last
  bool taking_;                 ///< each message is for one reader, which takes it
  bool working_;                ///< and it stays in the queue until that reader has finished it
  bool is_superseded_ = false;  ///< the topic was made anew, with another type
  bool small_;                  ///< the messages lie in their blocks' small payload
  const std::uint32_t words_;   ///< so many words are in a slot
  bool in_slot_ = false;        ///< the last message did
  const detail::MessageType& type_;
  std::unique_ptr<waiting::Notifier> notifier_;  ///< once fd() was called
  const std::string topic_name_;
  const std::uint64_t topic_key_;
  Quota quota_;
  futex::Clock::time_point tell_again_{};

  const Topics::Role role_;
  std::uint32_t topic_;
  waiting::SpinHabit habit_;
  waiting::YieldHabit yield_;
  futex::Deadline not_before_;  ///< until then it does not look for new rings
  detail::FutexWaits waits_;
  /// Rings that are not for this puller, or not any more, and still exist. Another puller of the
  /// process may have a cell in them that it has not looked at yet.
  std::vector<registry::ChannelName> passed_;
  std::list<registry::Departure> departure_;  ///< one entry, made before it is needed
  LeftRing left_;                             ///< the last message's ring, when it was left
  std::uint64_t pushed_ns_ = 0;  ///< when the last message that travelled in its slot was pushed
  std::shared_ptr<detail::PusherCore> keeper_;  ///< makes blocks for what is kept of slots
  detail::Loan spare_;                          ///< for the next one
  bool lacks_spare_ = false;  ///< the last look has found a message, and no block for it
  /// A message that was borrowed from its slot.
  alignas(64) unsigned char letter_[segment::kSmallBytes];
  std::uint32_t claimed_slot_ = 0;  ///< the slot of the message that was claimed last
  ring::Word claim_ = 0;
  RingWatcher* const watcher_;  ///< null: there is none
};

}  // namespace

std::unique_ptr<RingPuller> make_ring_puller(std::shared_ptr<Participant> participant,
                                             std::string_view topic,
                                             const detail::MessageType& type,
                                             const PullerOptions& options,
                                             detail::Delivery delivery, RingWatcher* watcher) {
  participant->check_usable();
  return std::make_unique<Puller>(std::move(participant), topic, type, options, delivery, watcher);
}

}  // namespace lot::transport

namespace lot::detail {

std::unique_ptr<PullerCore> make_puller(std::shared_ptr<transport::Participant> participant,
                                        std::string_view topic, const MessageType& type,
                                        const PullerOptions& options, Delivery delivery) {
  return transport::make_ring_puller(std::move(participant), topic, type, options, delivery,
                                     nullptr);
}

}  // namespace lot::detail
