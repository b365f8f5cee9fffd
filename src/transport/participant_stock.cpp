// SPDX-License-Identifier: Apache-2.0
/// What a participant owns: rings, pools, memory, topics.
#include <algorithm>
#include <array>
#include <cerrno>
#include <exception>
#include <new>
#include <optional>
#include <utility>

#include "lot/error.hpp"

#include "transport/fill.hpp"
#include "transport/participant.hpp"

namespace lot::transport {

void Participant::close_ring(const registry::ChannelName& name) noexcept {
  {
    // finish_closing() takes this mutex before it gives the ring to the orphanage. Until then no
    // process can recycle the ring.
    const std::lock_guard guard(reap_mutex_);
    channel_writer(name.channel)
        .store(ring::make_writer(name.generation, ring::State::Orphan, index()),
               std::memory_order_release);  // R9
    segment::Ring r = ring(name.channel);
    Recovery(*this).wake_readers(r);
  }
  settle_closing();
}

void Participant::settle_closing() noexcept {
  if (!finish_closing() || has_orphan_rings()) ring_warden();
}

bool Participant::ring_closed(const registry::ChannelName& name) const noexcept {
  // Acquire: the orphanage's name is stored (release) after it has adopted all blocks of the ring.
  const auto w = segment_.channels()[name.channel].writer.load(std::memory_order_acquire);
  return ring::writer_generation(w) != name.generation || ring::writer_owner(w) != index();
}

bool Participant::is_closing(std::uint32_t channel) noexcept {
  // Acquire: as in ring_closed().
  const auto w = channel_writer(channel).load(std::memory_order_acquire);
  return ring::writer_state(w) == ring::State::Orphan && ring::writer_owner(w) == index();
}

bool Participant::rings_closed() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    if (is_closing(c)) return false;
  }
  const std::lock_guard guard(pools_mutex_);
  return std::all_of(draining_.begin(), draining_.end(),
                     [](const Draining& d) { return d.blocks.empty() && !d.releasing; });
}

bool Participant::is_releasing() noexcept {
  const std::lock_guard guard(pools_mutex_);
  return std::any_of(draining_.begin(), draining_.end(),
                     [](const Draining& d) { return d.releasing; });
}

bool Participant::finish_closing() noexcept {
  bool any = false;
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used && !any; ++c) any = is_closing(c);
  if (any) {
    const std::lock_guard guard(reap_mutex_);
    if (!enter_orphanage()) return false;
    bool all = true;
    try {
      Recovery recovery(*this);
      for (std::uint32_t c = 0; c < used; ++c) {
        if (is_closing(c)) recovery.orphan_ring(c, index());
      }
      recovery.collect();
    } catch (const std::bad_alloc&) {
      all = false;  // memory is short: as if killed here; the warden's next look does it again
    }
    leave_orphanage();
    if (!all) return false;
  }
  // The orphanage holds now what the closed rings held. So the holds of this process may go.
  const auto is_due = [this](const Draining& d) {
    return !d.blocks.empty() && !d.releasing && ring_closed(d.ring);
  };
  std::unique_lock lock(pools_mutex_);
  for (auto d = draining_.begin();
       (d = std::find_if(draining_.begin(), draining_.end(), is_due)) != draining_.end();) {
    const std::vector<std::uint32_t> blocks = std::exchange(d->blocks, {});
    const Pool* const pool = d->pool;
    d->releasing = true;
    lock.unlock();
    for (const std::uint32_t b : blocks) holder_.release(b, hold::kRing);
    lock.lock();
    const auto of_pool = [pool](const Draining& e) { return e.pool == pool; };
    std::find_if(draining_.begin(), draining_.end(), of_pool)->releasing = false;
  }
  for (std::size_t i = 0; i < draining_.size();) {
    const auto& d = draining_[i];
    if (d.blocks.empty() && !d.releasing && d.pool->drain()) {
      idle_.push_back(draining_[i].pool);
      draining_.erase(draining_.begin() + static_cast<std::ptrdiff_t>(i));
    } else {
      ++i;
    }
  }
  return draining_.empty();
}

Pool& Participant::open_pool(std::string_view topic) {
  const std::uint64_t key = topic.empty() ? 0 : segment::topic_key(topic);
  const std::lock_guard guard(pools_mutex_);
  if (!idle_.empty()) {
    Pool* pool = idle_.back();
    idle_.pop_back();
    pool->serve(key);
    return *pool;
  }
  if (pools_.size() == pools_.capacity()) {
    throw Error(ENOSPC, segment_.path(), "too many publishers in this process",
                "make the segment with a larger EngineOptions::channels");
  }
  pools_.push_back(std::make_unique<Pool>(holder_, static_cast<std::uint32_t>(pools_.size())));
  pools_.back()->serve(key);
  return *pools_.back();
}

void Participant::close_pool(Pool& pool, const registry::ChannelName& ring,
                             std::vector<std::uint32_t> blocks) noexcept {
  pool.close();
  ahead_.forget(pool);
  const std::lock_guard guard(pools_mutex_);
  draining_.push_back({&pool, ring, std::move(blocks), false});
}

bool Participant::trim(std::uint32_t asker) noexcept {
  ahead_.leave_off();
  const std::lock_guard guard(pools_mutex_);
  bool any = false;
  for (std::uint32_t i = 0; i < pools_.size(); ++i) any |= pools_[i]->trim(i == asker);
  return take_spare([](std::uint32_t) { return true; }) || any;
}

template <class May>
bool Participant::take_spare(May&& may) noexcept {
  bool any = false;
  std::array<std::uint32_t, 64> wanted;
  // Relaxed: a hint. A block that is held for the first time just now is no idle one.
  for (std::uint32_t b = holder_.known.load(std::memory_order_relaxed); b != 0;) {
    std::size_t n = 0;
    while (b != 0 && n < wanted.size()) {
      --b;
      // Relaxed: want_spare() looks again.
      if (!holder_.is_home(b) || !segment_.build(b).is_spare()) continue;
      Pool& pool = holder_.pool_of(b);
      if (may(pool.index()) && pool.want_spare(b)) wanted[n++] = b;
    }
    if (n != 0) ProcessBarrier::pass();  // M1
    for (std::size_t i = 0; i < n; ++i) any |= holder_.pool_of(wanted[i]).take_spare(wanted[i]);
  }
  return any;
}

bool Participant::trim_pools() noexcept {
  bool any = false;
  for (auto& pool : pools_) any |= pool->trim(true);
  return any;
}

void Participant::tidy(std::uint32_t asker) noexcept {
  reap_dead();
  collect();
  eviction_.settle();
  trim(asker);
}

std::uint32_t Participant::try_claim_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  constexpr auto kNone = segment::Granules<segment::Atomics>::kNone;
  Pool& pool = holder_.pool_of(tag - 1);
  if (!pool.take(granules)) {
    errno = EDQUOT;
    return kNone;
  }
  const std::uint32_t run = segment_.claim_run(granules, tag);
  if (run == kNone) pool.count_out(granules);
  return run;
}

bool Participant::extend_run(std::uint32_t end, std::uint32_t granules,
                             std::uint32_t tag) noexcept {
  Pool& pool = holder_.pool_of(tag - 1);
  if (!pool.take(granules)) return false;
  const bool is_longer = segment_.extend_run(end, granules, tag);
  if (!is_longer) pool.count_out(granules);
  return is_longer;
}

/// Makes room under the publisher's own limit. Idle memory goes first, then the publisher's oldest
/// messages. Nothing goes for a run that can never fit under the limit.
bool Participant::make_room_in(Pool& pool, std::uint32_t granules) noexcept {
  if (granules > pool.limit()) return false;
  ahead_.leave_off(pool);
  pool.trim(true);
  if (pool.may_take(granules)) return true;
  {
    const std::lock_guard guard(pools_mutex_);
    take_spare([&](std::uint32_t index) { return index == pool.index(); });
  }
  const std::uint64_t could_go =
      eviction_.could_give(pool.index(), Shortage::Memory) / segment::kGranule;
  if (pool.granules() + granules > pool.limit() + could_go) return false;
  while (!pool.may_take(granules)) {
    if (!eviction_.give_up(pool.index())) return false;
    pool.trim(true);
  }
  return true;
}

std::uint32_t Participant::claim_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  constexpr auto kNone = segment::Granules<segment::Atomics>::kNone;
  if (Pool& pool = holder_.pool_of(tag - 1);
      !pool.may_take(granules) && !make_room_in(pool, granules)) {
    errno = EDQUOT;
    return kNone;
  }
  std::uint32_t run = try_claim_run(granules, tag);
  if (run != kNone) return run;
  // Relaxed: the caller has the block, so its pool does not change.
  const std::uint32_t asker = holder_.cell(tag - 1).pool.load(std::memory_order_relaxed);
  int error = errno;
  make_room_for_run(granules, asker, [&] {
    run = try_claim_run(granules, tag);
    error = errno;
    // EDQUOT: another thread has used up the limit. No other publisher gives a message for that.
    return run != kNone || error == EDQUOT;
  });
  errno = error;  // why there was no run: the looks for what could go have changed errno
  return run;
}

registry::ChannelName Participant::open_ring(std::uint32_t topic,
                                             const registry::RingOptions& options,
                                             std::uint32_t asker) {
  std::optional<registry::ChannelName> name;
  int error = 0;
  const auto try_open = [&] {
    const registry::Registry::Lock lock(registry_);
    name = registry_.open(topic, index(), options);
    error = errno;
    return name.has_value();
  };
  const std::uint32_t granules = registry::Registry::granules_of(options);
  after_reaping(*this, [&] {
    if (try_open()) return;
    // Without the registry's lock: a warden that is asked to give may want it, and a stopped warden
    // is waited for.
    std::exception_ptr failure;
    make_room_for_run(granules, asker, [&] {
      try {
        return try_open();
      } catch (...) {
        failure = std::current_exception();
        return true;
      }
    });
    if (failure) std::rethrow_exception(failure);
  });
  if (!name)
    throw OutOfMemory(describe_ring_shortage(*this, {asker, granules, error}, topic).c_str());
  return *name;
}

std::uint32_t Participant::await_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  constexpr auto kNone = segment::Granules<segment::Atomics>::kNone;
  std::uint32_t run = claim_run(granules, tag);
  const Pool& pool = holder_.pool_of(tag - 1);
  if (run != kNone || granules > pool.limit() || granules > segment_.granules().count() ||
      !may_await_readers(pool.index())) {
    return run;
  }
  int error = errno;
  const auto look = [&] {
    run = try_claim_run(granules, tag);
    error = errno;
    return run != kNone;
  };
  const auto search = [&] {
    const bool is_possible =
        !pool.may_take(granules) || eviction_.can_free_run(pool.index(), granules, likely_givers());
    run = claim_run(granules, tag);
    error = errno;
    return run != kNone || !is_possible;
  };
  await_readers(search, look, pool.index(), Shortage::Memory);
  errno = error;
  return run;
}

/// Claims a free block. For a moment its tag marks the granules of a unit that goes back to the
/// system. It is not the last free block: a publisher that finds none gives messages up.
std::optional<std::uint32_t> Participant::claim_spare_block() noexcept {
  bool is_last = true;
  for (std::uint32_t b = blocks(); b-- != 0;) {
    // Relaxed: a hint. Holder::claim() decides (O3).
    if (block(b).home.load(std::memory_order_relaxed) != refcount::kHomeFree) continue;
    if (!std::exchange(is_last, false) && holder_.claim(b, 0)) return b;
  }
  return std::nullopt;
}

std::uint64_t Participant::give_back_unit(std::uint32_t unit, std::uint32_t looks) noexcept {
  // Under this lock holds_pointers() does not see the block. A thread that is short of memory waits
  // for this one unit (trim()).
  const std::lock_guard guard(pools_mutex_);
  const auto b = claim_spare_block();
  if (!b) return 0;
  const std::uint64_t bytes = segment_.give_back(unit, looks, *b + 1);
  holder_.give_back(*b);
  return bytes;
}

std::uint64_t Participant::give_all_back_to_system() noexcept {
  gather_from_others([] { return false; }, kGiverPatience);
  trim(kNobody);
  return give_back_to_system(0, [] { return false; });
}

/// Relaxed, as in Survey: the next look sees what changes meanwhile.
Participant::Kept Participant::weigh_kept() noexcept {
  Kept kept;
  for (std::uint32_t b = 0; b < blocks(); ++b) kept.blocks += is_kept(b);
  const auto& tags = segment_.granules();
  std::uint32_t last = 0;
  bool counts = false;
  for (std::uint32_t i = 0; i < tags.count(); ++i) {
    const std::uint32_t tag = tags.tag(i);
    if (tag != last) {
      last = tag;
      counts = tag != 0 && tag <= blocks() && is_kept(tag - 1);
    }
    kept.granules += counts;
  }
  return kept;
}

bool Participant::is_kept(std::uint32_t b) noexcept {
  const segment::BlockWords& words = segment_.block(b);
  // Relaxed, here and below: see weigh_kept().
  const std::uint32_t home = words.home.load(std::memory_order_relaxed);
  if (home == refcount::kHomeFree) return false;
  if (words.home_points.load(std::memory_order_relaxed) != 0) return true;  // a hint
  for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
    std::uint64_t holders = words.own[w].load(std::memory_order_relaxed);  // a hint
    for (const std::uint32_t k : {refcount::kOrphanage, home - 1}) {
      holders = HardwareOwnership::holders(holders, w, k);
    }
    if (holders != 0) return true;
  }
  return false;
}

bool Participant::may_gather() noexcept {
  constexpr auto kSeldom = std::chrono::milliseconds(100);
  const auto now = futex::Clock::now().time_since_epoch();
  // Relaxed: two threads may ask at once, which does no harm.
  const futex::Clock::duration last(gathered_.load(std::memory_order_relaxed));
  return now - last >= kSeldom;
}

void Participant::ask_others(Questions& questions) noexcept {
  // Relaxed: see may_gather().
  gathered_.store(futex::Clock::now().time_since_epoch().count(), std::memory_order_relaxed);
  for (std::uint32_t k = 1; k < participants(); ++k) {
    // Acquire: edge "state".
    if (k == index() || part(k).load(std::memory_order_acquire) == 0) continue;
    questions.asked[k] = true;
    // Relaxed: an answer to an earlier question is as good as one to this question.
    questions.answers[k] = segment_.witnesses()[k].answers.load(std::memory_order_relaxed);
    holder_.ask(k, segment::errand::kTrim);
  }
}

bool Participant::all_have_answered(const Questions& questions) noexcept {
  for (std::uint32_t k = 1; k < participants(); ++k) {
    // E2. G1 carries the memory itself.
    if (questions.asked[k] &&
        segment_.witnesses()[k].answers.load(std::memory_order_acquire) == questions.answers[k]) {
      return false;
    }
  }
  return true;
}

/// Crash:   killed after the errand, the other participant gives something up and no process uses
///          it at once.
bool Participant::ask_to_give(std::uint32_t k, const Request& request) noexcept {
  auto& word = segment_.witnesses()[k].request;
  word.store(request.word(), std::memory_order_relaxed);  // E1 carries it
  std::uint64_t answer = request.word();
  // Relaxed: G1 carries the memory. Where another process has asked meanwhile, something may have
  // been given.
  return ask_and_wait(k, segment::errand::kGive,
                      [&] {
                        answer = word.load(std::memory_order_relaxed);  // G1
                        return answer != request.word();
                      }) &&
         answer != Request::kRefused;
}

template <class Done>
bool Participant::ask_and_wait(std::uint32_t k, std::uint32_t errand, Done&& done) noexcept {
  const auto& answers = segment_.witnesses()[k].answers;
  // Relaxed: only compared. done() says whether the memory is there.
  const std::uint32_t before = answers.load(std::memory_order_relaxed);
  holder_.ask(k, errand);
  const auto until = futex::Clock::now() + kGiverPatience;
  while (!done()) {
    if (futex::Clock::now() >= until) {
      // Relaxed: it only says how long to wait.
      silent_[k].store(std::uint64_t{before} + 1, std::memory_order_relaxed);
      return false;
    }
    std::this_thread::sleep_for(kAnswerLook);
  }
  return true;
}

bool Participant::is_silent(std::uint32_t k) const noexcept {
  // Relaxed, both: they only say how long to wait.
  const std::uint64_t answers = segment_.witnesses()[k].answers.load(std::memory_order_relaxed);
  return silent_[k].load(std::memory_order_relaxed) == answers + 1;  // as above
}

Eviction::Givers Participant::likely_givers() const noexcept {
  Eviction::Givers givers{};
  if (std::this_thread::get_id() == warden_.get_id()) return givers;
  for (std::uint32_t k = 0; k < participants(); ++k) {
    givers[k] = k == refcount::kOrphanage || !is_silent(k);
  }
  return givers;
}

std::uint32_t Participant::longest_run(std::uint32_t asker, std::uint32_t granules,
                                       bool is_full) noexcept {
  const auto backing = is_full ? Eviction::Backing::None : Eviction::Backing::All;
  const Eviction::Givers givers = likely_givers();
  eviction_.look_at_others(Shortage::Memory);
  std::uint32_t possible = 0;
  for (std::uint32_t end = granules; end - possible > 1 + possible / 16;) {
    const std::uint32_t middle = possible + (end - possible) / 2;
    (eviction_.can_free_run(asker, middle, givers, backing) ? possible : end) = middle;
  }
  return possible;
}

bool Participant::take_out(std::uint32_t channel, std::uint32_t b) noexcept {
  // Relaxed: a hint. Recovery looks again in the orphanage.
  const std::uint32_t home = block(b).home.load(std::memory_order_relaxed);
  const bool is_elsewhere = home > refcount::kHomeOrphanage && home <= participants();
  // Its warden does not answer, so it would not free the block.
  if (is_elsewhere && is_silent(home - 1)) return false;
  // Relaxed: the number is all that it tells. Whoever claims the memory acquires it (G1).
  const auto generation = [&] {
    return refcount::generation_of(block(b).life.load(std::memory_order_relaxed));
  };
  const std::uint32_t before = generation();
  {
    std::unique_lock guard(reap_mutex_, std::defer_lock);
    const auto enter = [&] {
      if (!guard.try_lock()) return false;
      if (enter_orphanage()) return true;
      guard.unlock();
      return false;
    };
    const auto until = futex::Clock::now() + kAnswerPatience;
    while (!enter()) {
      if (futex::Clock::now() >= until) return false;
      std::this_thread::sleep_for(kAnswerLook);
    }
    bool is_out = false;
    try {
      Recovery recovery(*this);
      is_out = recovery.take_out(channel, b);
      if (is_out) recovery.collect();
    } catch (const std::bad_alloc&) {  // as if killed here: the next look does it all again
    }
    leave_orphanage();
    if (!is_out) return false;
    tell_homes();
  }
  // The publisher has gone, but the process that has the memory has not. It may be this process.
  return !is_elsewhere ? generation() != before
                       : ask_and_wait(home - 1, segment::errand::kTrim, [&] {
                           // Relaxed: G1 and O3 carry what a new owner gets.
                           return block(b).home.load(std::memory_order_relaxed) != home;
                         });
}

std::uint32_t Participant::enter_topic(std::string_view name, const detail::MessageType& type) {
  std::uint32_t topic = 0;
  after_reaping(*this, [&] {
    const std::lock_guard guard(topics_mutex_);
    const registry::Registry::Lock lock(registry_);
    topic = registry_.enter(name, type, index());
    try {
      ++topic_uses_[topic];
    } catch (...) {  // the entry was not there
      registry_.leave(topic, index());
      throw;
    }
  });
  return topic;
}

void Participant::leave_topic(std::uint32_t topic) noexcept {
  const std::lock_guard guard(topics_mutex_);
  count_out(topic);
}

void Participant::count_out(std::uint32_t topic) noexcept {
  if (--topic_uses_[topic] == 0) {
    topic_uses_.erase(topic);
    registry_.leave(topic, index());
  }
}

}  // namespace lot::transport
