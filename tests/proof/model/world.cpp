// SPDX-License-Identifier: Apache-2.0
#include "world.hpp"

#include "waiting/waiting.hpp"

namespace lot::model {

// ---- Channel and Segment
// --------------------------------------------------------------------------

Channel::Channel(const Shape& shape)
    : slots((shape.depth + 1) * shape.slot_words()),
      cells(shape.readers),
      who(shape.readers),
      claims(shape.depth),
      bounds(shape.readers),
      tenants(shape.readers) {
  blocking.write(false);
  used.write(false);
  for (auto& tenant : tenants) tenant.write(0);
}

void Channel::soil() {
  constexpr auto kOrder = std::memory_order_relaxed;
  for (auto& slot : slots) slot.store(ring::make(7, 0), kOrder);
  for (auto& cell : cells) cell.position.store(ring::make(7, 0), kOrder);
  for (auto& claim : claims) claim.store(ring::make_claim(7, 1, kSoiledBy + 1), kOrder);
  returned.store(7, kOrder);
  for (auto& w : who) w.store(kSoiledBy + 1, kOrder);
  roster.store(7, kOrder);
  space.store(7, kOrder);
  floor.store(7, kOrder);
}

Segment::Segment(const Shape& s)
    : shape(s),
      states(kParticipants),
      blocks(s.blocks),
      listeners(s.channels),
      news(1),
      pullers(kParticipants),
      payloads(s.blocks),
      references(s.blocks),
      locks_(kRegistryLock + 1),
      ended_(kParticipants) {
  for (std::uint32_t c = 0; c < s.channels; ++c) channels.emplace_back(s);
  for (auto& reference : references) reference.write(kNoBlock);
  for (auto& block : blocks) {
    for (auto& word : block.own) test::raw(word).watch_bits(Policy::kBitsPerWord);
  }
}

bool Segment::try_lock(std::uint32_t lock, std::uint32_t holder) {
  std::uint32_t nobody = 0;
  return locks_[lock].compare_exchange_strong(nobody, holder + 1, std::memory_order_acq_rel,
                                              std::memory_order_relaxed);
}

void Segment::unlock(std::uint32_t lock) { locks_[lock].store(0, std::memory_order_release); }

bool Segment::lock_queue(std::uint32_t channel, std::uint32_t holder) {
  lock::LockWord<Policy> lock(channels[channel].lock);
  const std::uint32_t name = lock::make_name(holder, 1);
  for (;;) {
    if (lock.try_lock(name, false)) return true;
    const std::uint32_t seen = lock.seen();
    if (seen != 0 && has_ended(lock::participant(lock::name(seen))) && lock.take_over(seen, name)) {
      return false;
    }
    Policy::pause();
  }
}

void Segment::unlock_queue(std::uint32_t channel, std::uint32_t holder) {
  auto& word = channels[channel].lock;
  if (lock::LockWord<Policy>(word).unlock(lock::make_name(holder, 1))) word.wake_one();
}

void Segment::end_process(std::uint32_t participant) {
  for (auto& lock : locks_) {
    if (lock.load(std::memory_order_relaxed) == participant + 1) {
      lock.store(0, std::memory_order_release);
    }
  }
  ended_[participant].store(1, std::memory_order_release);
  ended_[participant].wake_all();
}

bool Segment::has_ended(std::uint32_t participant) const {
  return ended_[participant].load(std::memory_order_acquire) != 0;
}

void Segment::await_end_of(std::uint32_t participant) {
  while (!has_ended(participant)) {
    ended_[participant].wait_while(0);
  }
}

// ---- Turn
// ----------------------------------------------------------------------------------------

Turn::Turn(Process& process, std::uint32_t channel) : process_(process), channel_(channel) {
  lock();
}

void Turn::lock() {
  Segment& segment = process_.segment();
  if (!segment.shape.locked) return;
  const bool clean = segment.lock_queue(channel_, process_.index());
  held_ = true;
  if (clean || garden.omitted.repair) return;
  for (auto* word : {&segment.channels[channel_].arrived, &segment.channels[channel_].space}) {
    RobustCondition(*word).renew();
    word->wake_all();
  }
}

void Turn::unlock() {
  if (!held_ || killer.has_hit()) return;
  process_.segment().unlock_queue(channel_, process_.index());
  held_ = false;
}

// ---- Process
// --------------------------------------------------------------------------------------

Process::Process(Segment& segment, std::uint32_t index)
    : segment_(&segment), own_{index}, holds_(segment.shape.blocks) {}

bool Process::attach() {
  if (!segment_->try_lock(index(), index())) return false;
  if (participant_state(index()).load(std::memory_order_relaxed) !=
      0) {  // a dead one is in there: reap first
    segment_->unlock(index());
    return false;
  }
  participant_state(index()).take();
  return true;
}

void Process::leave() {
  while (!segment_->try_lock(refcount::kOrphanage, index())) Policy::pause();
  Recovery(*this).reap(index());
  segment_->unlock(refcount::kOrphanage);
  segment_->end_process(index());
}

bool Process::reap(std::uint32_t k) {
  if (!segment_->try_lock(k, index())) return false;
  bool reaped = false;
  if (segment_->try_lock(refcount::kOrphanage, index())) {
    reaped = Recovery(*this).reap(k);
    segment_->unlock(refcount::kOrphanage);
  }
  segment_->unlock(k);
  return reaped;
}

void Process::see_reaped(std::uint32_t k) {
  while (!reap(k) && participant_state(k).load(std::memory_order_acquire) != 0) Policy::pause();
}

void Process::collect() {
  if (!segment_->try_lock(refcount::kOrphanage, index())) return;
  Recovery(*this).collect();
  segment_->unlock(refcount::kOrphanage);
}

void Process::take_out(std::uint32_t channel, Word block) {
  if (!segment_->try_lock(refcount::kOrphanage, index())) return;
  Recovery recovery(*this);
  recovery.take_out(channel, block);
  recovery.collect();
  segment_->unlock(refcount::kOrphanage);
}

Word Process::loan() {
  if (const Word b = try_loan(); b != kNone) return b;
  for (std::uint32_t b = 0; b < blocks(); ++b) {
    if (own_.claim(words(b), hold(b))) return b;
  }
  for (Publisher* publisher : publishers_) publisher->scan();
  return try_loan();
}

Word Process::try_loan() {
  Word loaned = kNone;
  lock_pool();
  if (!ready_.empty()) {
    loaned = ready_.front();
    ready_.pop_front();
  }
  for (std::size_t n = kept_.size(); n > 0 && loaned == kNone; --n) {
    const Word b = kept_.front();
    kept_.pop_front();
    if (reclaim(b, 0)) loaned = b;
  }
  unlock_pool();
  if (loaned != kNone) release_reference(loaned);
  return loaned;
}

void Process::lock_pool() {
  std::uint32_t open = 0;
  while (!pool_lock_.compare_exchange_strong(open, 1, std::memory_order_acquire,
                                             std::memory_order_relaxed)) {
    open = 0;
    Policy::pause();
  }
}

/// On failure the block is entered among the kept ones, unless pointers here still hold it: whoever
/// drops the last one comes back. REQUIRES: the pool is locked.
bool Process::reclaim(Word b, std::uint64_t expected) {
  if (own_.reclaim(words(b), hold(b), expected)) return true;
  if ((hold(b).load(std::memory_order_relaxed) & hold::kHolds) == 0 &&
      std::find(kept_.begin(), kept_.end(), b) == kept_.end()) {
    kept_.push_back(b);
  }
  return false;
}

/// The last hold on a message of ours has gone, but for `expected`, which goes now.
void Process::come_home(Word b, std::uint64_t expected) {
  lock_pool();
  const bool dead = reclaim(b, expected);
  unlock_pool();
  if (!dead) return;
  release_reference(b);
  unloan(b);
}

void Process::give_back(Word b) { own_.give_back(words(b), hold(b)); }

void Process::unloan(Word b) {
  lock_pool();
  ready_.push_back(b);
  unlock_pool();
}

void Process::keep(Word b) { own_.acquire(words(b), hold(b), hold::kPointer); }

bool Process::lock_weak(Word b, std::uint32_t generation) {
  return own_.acquire_weak(words(b), hold(b), generation) == refcount::Left::Held;
}

void Process::copy(Word b) { hold(b).add_pointer(); }

void Process::drop(Word b) {
  if (hold(b).drop_pointer_of_several()) return;
  if (own_.release(words(b), hold(b), hold::kPointer) == refcount::Left::Home) come_home(b, 0);
}

void Process::hand_to_ring(Word b) {
  own_.acquire(words(b), hold(b), hold::kRing);
  drop(b);
}

void Process::hand_own_to_ring(Word b) { own_.hand_to_ring(hold(b)); }

void Process::refer(Word b, Word target) {
  own_.acquire(words(target), hold(target), hold::kRing);
  segment_->references[b].write(target);
}

void Process::release_reference(Word b) {
  const Word target = segment_->references[b].read();
  if (target == kNoBlock) return;
  segment_->references[b].write(kNoBlock);
  take_from_ring(target);
}

void Process::take_from_ring(Word b) {
  if (at_home(b)) {
    if (!own_.drop_ring_hold_of_several(hold(b))) come_home(b, hold::kRing);
  } else {
    own_.release(words(b), hold(b), hold::kRing);
  }
}

bool Process::at_home(Word b) {
  return (hold(b).load(std::memory_order_relaxed) & hold::kHome) != 0;
}

std::uint32_t Process::generation(Word b) {
  return refcount::generation_of(words(b).life.load(std::memory_order_relaxed));
}

std::uint64_t Process::read(Word b, std::source_location where) {
  return segment_->payloads[b].read(where);
}

void Process::write(Word b, std::uint64_t message, std::source_location where) {
  segment_->payloads[b].write(message, where);
}

ring::Ring<Policy> Process::ring(std::uint32_t c) {
  Channel& channel = segment_->channels[c];
  if (channel.formed.load(std::memory_order_seq_cst) == 0) return {};  // R13
  return unformed_ring(c);
}

ring::Ring<Policy> Process::unformed_ring(std::uint32_t c) {
  Channel& channel = segment_->channels[c];
  return {&channel.writer,
          segment_->shape.in_slots
              ? ring::Slots<Policy>::with_messages(channel.slots.data(),
                                                   segment_->shape.slot_words() * sizeof(Word))
              : ring::Slots<Policy>(channel.slots.data()),
          channel.cells.data(),
          channel.who.data(),
          &channel.roster,
          &channel.space,
          &channel.floor,
          segment_->shape.depth,
          segment_->shape.readers,
          channel.blocking.read(),
          segment_->shape.taken,
          Segment::kFirst,
          segment_->shape.locked ? &channel.arrived : nullptr,
          segment_->shape.finished ? channel.claims.data() : nullptr,
          segment_->shape.finished ? &channel.returned : nullptr,
          channel.bounds.data(),
          c};
}

void Process::close_ring(std::uint32_t c) {
  auto& writer = channel_writer(c);
  writer.end(ring::writer_generation(writer.load(std::memory_order_relaxed)), index());
  Recovery recovery(*this);
  ring::Ring<Policy> r = ring(c);
  recovery.wake_readers(r);
  while (!segment_->try_lock(refcount::kOrphanage, index())) Policy::pause();
  recovery.orphan_ring(c, index());
  recovery.collect();
  segment_->unlock(refcount::kOrphanage);
}

void Process::wake_sleepers(std::uint32_t c) {
  ring::Ring<Policy> r = ring(c);
  ring::wake_sleepers(
      r, [](const auto& word) { word.wake_all(); }, [this](std::uint32_t of) { ring_ears(of); });
}

bool Process::ring_closed(std::uint32_t c) {
  return ring::writer_owner(channel_writer(c).load(std::memory_order_acquire)) != index();
}

void Process::await_no_reader(std::uint32_t c) {
  const ring::Ring<Policy> r = ring(c);
  for (std::uint32_t i = 0; i < r.readers; ++i) {
    for (;;) {
      const std::uint32_t seen = r.space->load(std::memory_order_acquire);  // carries the position
      if (r.cells[i].position.load(std::memory_order_relaxed) == ring::kIdle) break;
      r.space->wait_while(seen);
    }
  }
}

void Process::move_in(std::uint32_t c, std::uint32_t cell) {
  segment_->channels[c].tenants[cell].write(index());
}

void Process::move_out(std::uint32_t c, std::uint32_t cell) {
  segment_->channels[c].tenants[cell].write(0);
}

void Process::release_extents(const std::vector<bool>& dead) {
  for (std::uint32_t b = 0; b < blocks(); ++b) {
    if (dead[b]) segment_->references[b].write(kNoBlock);
  }
}

// ---- Publisher
// ------------------------------------------------------------------------------------

bool Publisher::open(Process& process, std::uint32_t c, bool blocking) {
  while (!process.lock_rings()) Policy::pause();
  const bool made = make_ring(process, c, blocking);
  process.unlock_rings();
  return made;
}

bool Publisher::advertise(Process& process, std::uint32_t c, bool blocking) {
  while (!process.lock_rings()) Policy::pause();
  const bool made = make_ring(process, c, blocking);
  if (made) announce();
  process.unlock_rings();
  return made;
}

bool Publisher::make_ring(Process& process, std::uint32_t c, bool blocking) {
  Channel& channel = process.segment().channels[c];
  const Word free = channel.writer.load(std::memory_order_relaxed);
  if (ring::writer_state(free) != ring::State::Free) return false;
  if (!channel.writer.claim(free, process.index())) return false;
  const Word generation = ring::writer_generation(free) + 1;
  channel.used.write(true);
  channel.soil();
  channel.blocking.write(blocking);
  ring::Ring<Policy> ring = process.unformed_ring(c);
  for (auto& [from, to] : channel.bounds) {
    from.store(0, std::memory_order_relaxed);
    to.store(0, std::memory_order_relaxed);
  }
  ring.format();
  channel.formed.store(1, std::memory_order_seq_cst);  // R13
  auto& pullers = process.segment().pullers;
  ring.await_pullers(
      kParticipants,
      [&pullers](std::uint32_t p) { return pullers[p].load(std::memory_order_relaxed); },
      [&pullers](std::uint32_t p) {
        return pullers[p].load(std::memory_order_seq_cst) != 0;  // R13
      });
  channel.writer.go_live(generation, process.index());
  process_ = &process;
  channel_ = c;
  writer_ = ring::Writer<Policy>(ring);
  process.enter(*this);
  return true;
}

void Publisher::announce() {
  std::vector<ring::Ring<Policy>> rings;
  for (std::uint32_t c = 0; c < process_->channels(); ++c) {
    const Word writer = process_->channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(writer) == ring::State::Live) rings.push_back(process_->ring(c));
  }
  ring::announce(
      process_->segment().version, rings, [](const auto& word) { word.wake_all(); },
      [this](std::uint32_t c) { process_->ring_ears(c); });
}

bool Publisher::send() {
  if (process_->segment().shape.in_slots) {
    Turn turn(*process_, channel_);
    if (!writer_.room()) return false;
    publish_letter(turn);
    return true;
  }
  const Word b = process_->loan();
  if (b == Process::kNone) return false;
  process_->write(b, sent_);
  Turn turn(*process_, channel_);
  if (!writer_.room()) {
    turn.unlock();
    process_->unloan(b);
    return false;
  }
  process_->hand_own_to_ring(b);
  publish(b, turn);
  return true;
}

namespace {

/// What the library's strategy of waiting runs on. No time passes.
struct Machine {
  struct Space {
    const Atomic<std::uint32_t>& word;
    std::uint32_t value;
  };
  static futex::Clock::time_point now() { return {}; }
  static void pause() { Policy::pause(); }
  static void yield() { Policy::pause(); }
  static bool sleep(const Space& space, const futex::Deadline&) {
    space.word.wait_while(space.value);
    return true;
  }
};

/// As the library's sender waits for room.
class ForRoom : public waiting::Steps<ForRoom> {
 public:
  ForRoom(ring::Writer<Policy>& writer, Turn& turn) : writer_(writer), turn_(turn) {}
  bool look() { return writer_.room(); }
  std::optional<waiting::Sleep<Machine::Space>> arm() {
    const auto odd = ring::arm_for_room(writer_, [this] { return writer_.room(); });
    if (!odd) return std::nullopt;
    return {{{*writer_.ring().space, *odd}, std::nullopt}};
  }
  void unlock() { turn_.unlock(); }
  void lock() { turn_.lock(); }

 private:
  ring::Writer<Policy>& writer_;
  Turn& turn_;
};

}  // namespace

void Publisher::send_and_wait() {
  const bool in_slots = process_->segment().shape.in_slots;
  const Word b = in_slots ? ring::kInSlot : process_->loan();
  RL_ASSERT(b != Process::kNone);
  if (!in_slots) process_->write(b, sent_);
  Turn turn(*process_, channel_);
  ForRoom room(writer_, turn);
  if (!room.look()) RL_ASSERT(waiting::wait<Machine>(room, std::nullopt));
  if (in_slots) return publish_letter(turn);
  process_->hand_own_to_ring(b);
  publish(b, turn);
}

void Publisher::send_own(Word b) {
  Turn turn(*process_, channel_);
  process_->hand_own_to_ring(b);
  publish(b, turn);
}

void Publisher::forward(Word b) {
  Turn turn(*process_, channel_);
  process_->hand_to_ring(b);
  publish(b, turn);
}

std::optional<Word> Publisher::evict() {
  Turn turn(*process_, channel_);
  const Word b = writer_.evict_oldest();
  turn.unlock();
  if (b == kNoBlock) return std::nullopt;
  retire(b);
  return b;
}

void Publisher::take_back(std::uint32_t keep) {
  std::vector<Word> gone;
  Turn turn(*process_, channel_);
  writer_.take_back(keep, [&](Word b) {
    if (b != ring::kInSlot) gone.push_back(b);
  });
  turn.unlock();
  for (const Word b : gone) retire(b);
}

void Publisher::close() {
  std::vector<Word> put;
  writer_.each_put([&](Word b) { put.push_back(b); });
  process_->close_ring(channel_);
  for (const Word b : put) process_->take_from_ring(b);
}

void Publisher::publish(Word b, Turn& turn) { tell(writer_.publish(b), turn); }

void Publisher::publish_letter(Turn& turn) {
  const Letter letter = Letter::of(sent_);
  tell(writer_.publish(&letter, Letter::kWords, &letter.time), turn);
}

void Publisher::tell(const ring::Writer<Policy>::Published& published, Turn& turn) {
  turn.unlock();
  ++sent_;
  if (published.wake && !garden.omitted.wake_readers) {
    process_->tell_ears(writer_.ring().channel, [](const auto& bell, bool is_asleep) {
      if (is_asleep) bell.wake_all();
    });
    // What the rouser does comes next here: how the two run side by side is the business of Spin.
    const auto rouse = [](const auto& word) {
      if (word.wake(futex::kWakes) == futex::kWakes) word.wake_all();
    };
    auto* arrived = writer_.ring().arrived;
    arrived != nullptr ? rouse(*arrived) : rouse(*published.slot);
  }
  if (published.replaced != kNoBlock) retire(published.replaced);
  retire_taken();
}

void Publisher::retire(Word b) {
  if (!writer_.readers_may_look() || garden.omitted.hazards) {
    process_->take_from_ring(b);
  } else {
    retired_.push_back(b);
  }
}

void Publisher::retire_taken() {
  if (writer_.ring().taken) writer_.each_taken([this](Word b) { retire(b); });
}

void Publisher::scan() {
  retire_taken();
  if (retired_.empty()) return;
  std::vector<Word> hazards;
  writer_.hazards([&](Word b) { hazards.push_back(b); });
  const auto looked_at = [&](Word b) {
    return std::find(hazards.begin(), hazards.end(), b) != hazards.end();
  };
  std::vector<Word> retired;
  retired.swap(retired_);
  for (const Word b : retired) {
    if (looked_at(b)) {
      retired_.push_back(b);
    } else {
      process_->take_from_ring(b);
    }
  }
}

// ---- Subscriber
// -----------------------------------------------------------------------------------

namespace {

/// Joins as a reader that the publisher may select, or as an observer, which begins no round.
std::optional<ring::Reader<Policy>> join_ring(const ring::Ring<Policy>& ring,
                                              std::uint32_t generation, std::uint32_t participant,
                                              std::uint64_t history, Word answer,
                                              Subscriber::Manner manner) {
  bool full = false;
  return ring::Reader<Policy>::join(
      ring, generation, participant, history, full,
      [&](std::uint32_t cell) {
        if (manner == Subscriber::Manner::Reads) selection::begin_round(ring, cell, answer);
      },
      manner);
}

}  // namespace

bool Subscriber::join(Process& process, std::uint32_t c, std::uint32_t generation,
                      std::uint64_t history, Manner manner) {
  const bool locked = !garden.omitted.rings_lock;
  while (locked && !process.lock_rings()) Policy::pause();
  std::optional<ring::Reader<Policy>> reader;
  const Word writer = process.channel_writer(c).load(std::memory_order_relaxed);
  const auto state = ring::writer_state(writer);
  if (state == ring::State::Live ||
      (state == ring::State::Orphan && process.segment().shape.taken)) {
    reader = join_ring(process.ring(c), generation, process.index(), history, 0, manner);
  }
  if (locked) process.unlock_rings();
  if (!reader) return false;
  process.move_in(c, reader->cell());
  process_ = &process;
  channel_ = c;
  generation_ = generation;
  reader_ = *reader;
  return true;
}

bool Subscriber::join_anew(Word answer) {
  const auto reader = join_ring(reader_.ring(), generation_, process_->index(),
                                ring::Reader<Policy>::kFromTheStart, answer, Manner::Reads);
  if (reader) process_->move_in(channel_, reader->cell());
  leave();
  if (reader) reader_ = *reader;
  return reader.has_value();
}

void Subscriber::leave() {
  process_->move_out(channel_, reader_.cell());
  reader_.leave();
  reader_.ring().space->wake_all();
}

Word Subscriber::borrow() {
  Turn turn(*process_, channel_);
  Word b = reader_.poll(missed_);
  while (!letter_.copy(reader_, b, missed_)) b = reader_.poll(missed_);
  turn.unlock();
  if (b == kNoBlock && reader_.sender_waits()) ring_for_room();
  return b;
}

void Subscriber::done() {
  const Turn turn(*process_, channel_);
  if (reader_.done()) ring_for_room();
}

void Subscriber::ring_for_room() {
  if (garden.omitted.ring_for_room) return;
  auto& space = *reader_.ring().space;
  if (ring::Reader<Policy>::ring_bell(space)) space.wake_all();
}

void Subscriber::sleep(std::uint32_t version) {
  std::array<Source, 1> only{{{reader_, *process_, channel_}}};
  sleep_on(only, process_->segment(), version);
}

bool Subscriber::leave_mark() {
  std::array<Source, 1> only{{{reader_, *process_, channel_}}};
  const ring::Rest rest = ring::prepare_to_sleep(only, process_->segment().version, version_,
                                                 [](const auto&, auto, bool) {});
  if (rest == ring::Rest::Doze) look_at_the_directory();
  return rest == ring::Rest::Sleep;
}

void Subscriber::look_at_the_directory() {
  if (!process_->lock_rings()) return Policy::pause();
  version_ = process_->segment().version.load(std::memory_order_acquire);
  process_->unlock_rings();
}

bool Subscriber::receive() {
  const Word b = borrow();
  if (b == kNoBlock) return false;
  RL_ASSERT(read(b) == number());
  done();
  ++received_;
  return true;
}

std::uint64_t Subscriber::read(Word b) {
  return b == ring::kInSlot ? letter_.read() : process_->read(b);
}

void Subscriber::keep(Word b) {
  if (b != ring::kInSlot) process_->keep(b);
}

void Subscriber::drop(Word b) {
  if (b != ring::kInSlot) process_->drop(b);
}

bool Subscriber::receive_and_keep() {
  const Word b = borrow();
  if (b == kNoBlock) return false;
  const std::uint64_t expected = number();
  keep(b);
  done();
  RL_ASSERT(read(b) == expected);
  drop(b);
  ++received_;
  return true;
}

Word Subscriber::take_one(std::uint64_t& taken) {
  Turn turn(*process_, channel_);
  for (;;) {
    const Word b = reader_.poll(missed_);
    if (b == kNoBlock) {
      turn.unlock();
      if (reader_.sender_waits()) ring_for_room();
      return b;
    }
    if (!letter_.copy(reader_, b, missed_)) continue;
    keep(b);
    taken = number();
    const bool ours = reader_.take();
    if (reader_.done()) ring_for_room();
    if (ours) return b;
    drop(b);
  }
}

bool Subscriber::start_work() {
  Turn turn(*process_, channel_);
  for (;;) {
    const Word b = reader_.poll_unclaimed(missed_);
    if (b == kNoBlock) {
      turn.unlock();
      if (reader_.sender_waits()) ring_for_room();
      return false;
    }
    if (!letter_.copy(reader_, b, missed_)) continue;
    keep(b);
    work_ = {b, number(), reader_.index(), 0};
    work_.claim = reader_.claim(process_->index());
    if (reader_.done()) ring_for_room();
    if (work_.claim != 0) {
      RL_ASSERT(read(b) == work_.number);
      return true;
    }
    drop(b);
  }
}

void Subscriber::finish_work() {
  RL_ASSERT(read(work_.block) == work_.number);
  ring::empty(reader_.ring().slots[work_.slot], ring::claim_sequence(work_.claim));
  if (reader_.sender_waits()) ring_for_room();
  if (reader_.is_closing()) process_->wake_sleepers(channel_);
  drop(work_.block);
  ++received_;
}

void Subscriber::give_work_back() {
  ring::Ring<Policy> ring = reader_.ring();
  ring.give_back(work_.slot, work_.claim);
  process_->wake_sleepers(channel_);
  drop(work_.block);
}

std::uint64_t Subscriber::number() const {
  return static_cast<std::uint64_t>(ring::distance(reader_.cursor(), Segment::kFirst));
}

}  // namespace lot::model
