// SPDX-License-Identifier: Apache-2.0
#include "transport/memory.hpp"

#include <atomic>
#include <cerrno>

namespace lot::transport {

void Memory::tidy(std::uint32_t asker) noexcept {
  reaper_.reap_dead();
  reaper_.collect();
  eviction_.settle();
  stock_.trim(asker);
}

/// Makes room under the publisher's own limit. Idle memory goes first, then the publisher's oldest
/// messages. Nothing goes for a run that can never fit under the limit.
bool Memory::make_room_in(Pool& pool, std::uint32_t granules) noexcept {
  if (granules > pool.limit()) return false;
  ahead_.leave_off(pool);
  pool.trim(true);
  if (pool.may_take(granules)) return true;
  stock_.trim_spare_of(pool);
  const std::uint64_t could_go =
      eviction_.could_give(pool.index(), Shortage::Memory) / segment::kGranule;
  if (pool.granules() + granules > pool.limit() + could_go) return false;
  while (!pool.may_take(granules)) {
    if (!eviction_.give_up(pool.index())) return false;
    pool.trim(true);
  }
  return true;
}

std::uint32_t Memory::claim_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  Pool& pool = holder_.pool_of(tag - 1);
  if (!pool.may_take(granules) && !make_room_in(pool, granules)) {
    errno = EDQUOT;
    return Pool::kNoRun;
  }
  std::uint32_t run = pool.try_claim_run(granules, tag);
  if (run != Pool::kNoRun) return run;
  int error = errno;
  make_room_for_run(granules, pool.index(), [&] {
    run = pool.try_claim_run(granules, tag);
    error = errno;
    // EDQUOT: another thread has used up the limit. No other publisher gives a message for that.
    return run != Pool::kNoRun || error == EDQUOT;
  });
  errno = error;  // why there was no run: the looks for what could go have changed errno
  return run;
}

std::uint32_t Memory::await_run(std::uint32_t granules, std::uint32_t tag) noexcept {
  std::uint32_t run = claim_run(granules, tag);
  Pool& pool = holder_.pool_of(tag - 1);
  if (run != Pool::kNoRun || granules > pool.limit() || granules > segment_.granules().count() ||
      !may_await_readers(pool.index())) {
    return run;
  }
  int error = errno;
  const auto look = [&] {
    run = pool.try_claim_run(granules, tag);
    error = errno;
    return run != Pool::kNoRun;
  };
  const auto search = [&] {
    const bool is_possible =
        !pool.may_take(granules) || eviction_.can_free_run(pool.index(), granules, likely_givers());
    run = claim_run(granules, tag);
    error = errno;
    return run != Pool::kNoRun || !is_possible;
  };
  await_readers(search, look, pool.index(), Shortage::Memory);
  errno = error;
  return run;
}

std::uint32_t Memory::longest_run(std::uint32_t asker, std::uint32_t granules,
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

bool Memory::take_out(std::uint32_t channel, std::uint32_t b) noexcept {
  // Relaxed: a hint. Recovery looks again in the orphanage.
  const std::uint32_t home = world_.block(b).home.load(std::memory_order_relaxed);
  const bool is_elsewhere = home > refcount::kHomeOrphanage && home <= world_.participants();
  // Its warden does not answer, so it would not free the block.
  if (is_elsewhere && neighbours_.is_silent(home - 1)) return false;
  // Relaxed: the number is all that it tells. Whoever claims the memory acquires it (G1).
  const auto generation = [&] {
    return refcount::generation_of(world_.block(b).life.load(std::memory_order_relaxed));
  };
  const std::uint32_t before = generation();
  const auto until = futex::Clock::now() + Neighbours::kAnswerPatience;
  if (!reaper_.take_out(channel, b, until)) return false;
  // The publisher has gone, but the process that has the memory has not. It may be this process.
  return !is_elsewhere ? generation() != before
                       : neighbours_.ask_and_wait(home - 1, segment::errand::kTrim, [&] {
                           // Relaxed: G1 and O3 carry what a new owner gets.
                           return world_.block(b).home.load(std::memory_order_relaxed) != home;
                         });
}

Eviction::Givers Memory::likely_givers() const noexcept {
  Eviction::Givers givers{};
  if (warden_.is_current()) return givers;
  for (std::uint32_t k = 0; k < world_.participants(); ++k) {
    givers[k] = k == refcount::kOrphanage || !neighbours_.is_silent(k);
  }
  return givers;
}

std::uint64_t Memory::give_all_back_to_system() noexcept {
  neighbours_.gather([] { return false; }, Neighbours::kGiverPatience);
  stock_.trim(Stock::kNobody);
  return stock_.give_back_to_system(0, [] { return false; });
}

}  // namespace lot::transport
