// SPDX-License-Identifier: Apache-2.0
#include "transport/ahead.hpp"

#include <algorithm>
#include <exception>
#include <pthread.h>
#include <sched.h>

#include "lot/detail/no_signals.hpp"

namespace lot::transport {
namespace {

/// The block that is made takes at most one part in kShare of the free granules. One part in kShare
/// of the blocks is left to others.
constexpr std::uint64_t kShare = 4;
/// After memory was short, nothing is made for this long: what has become free is for the publisher
/// that asked.
constexpr std::chrono::seconds kShortFor{1};

}  // namespace

std::vector<Ahead::Want>::iterator Ahead::find(const Pool& pool) noexcept {
  return std::find_if(wants_.begin(), wants_.end(),
                      [&](const Want& want) { return want.pool == &pool; });
}

void Ahead::expect(Pool& pool, const Pieces& pieces) noexcept {
  try {
    const std::lock_guard guard(mutex_);
    // forget() comes after the pool is closed. So what it has forgotten does not come back.
    if (is_ending_ || !pool.has_publisher()) return;
    start();
    auto want = find(pool);
    if (want == wants_.end()) want = wants_.insert(want, {&pool, {}, false});
    want->pieces = pieces;
    pool.expects(true);
  } catch (const std::exception&) {  // no memory: that frame is as slow as without Ahead
  }
}

void Ahead::next(Pool& pool) noexcept {
  if (!pool.expects()) return;
  {
    const std::lock_guard guard(mutex_);
    const auto want = find(pool);
    if (want == wants_.end()) return;
    want->is_due = true;
  }
  signal_.notify_all();
}

void Ahead::forget(Pool& pool) noexcept {
  std::unique_lock lock(mutex_);
  pool.expects(false);
  const auto want = find(pool);
  if (want == wants_.end()) return;
  wants_.erase(want);
  if (at_ == &pool) call_off(lock);
}

void Ahead::leave_off(Pool& pool) noexcept {
  if (!pool.expects()) return;
  std::unique_lock lock(mutex_);
  const auto want = find(pool);
  if (want != wants_.end()) want->is_due = false;
  if (at_ == &pool) call_off(lock);
}

void Ahead::leave_off() noexcept {
  std::unique_lock lock(mutex_);
  if (wants_.empty()) return;
  short_until_ = futex::Clock::now() + kShortFor;
  call_off(lock);
}

void Ahead::call_off(std::unique_lock<detail::Mutex>& lock) noexcept {
  is_called_off_.store(true, std::memory_order_relaxed);  // relaxed: it carries nothing
  const std::uint64_t turn = turn_;
  signal_.wait(lock, [&] { return at_ == nullptr || turn_ != turn; });
}

void Ahead::stop() noexcept {
  {
    const std::lock_guard guard(mutex_);
    is_ending_ = true;
    is_called_off_.store(true, std::memory_order_relaxed);  // relaxed: it carries nothing
  }
  signal_.notify_all();
  if (thread_.joinable()) thread_.join();
}

/// REQUIRES: mutex_. Throws where the system has no thread.
void Ahead::start() {
  if (thread_.joinable()) return;
  const detail::NoSignals quiet;
  thread_ = std::thread([this] { run(); });
}

void Ahead::run() noexcept {
  pthread_setname_np(pthread_self(), "lot-ahead");
  warden_.place_beside();
  std::unique_lock lock(mutex_);
  for (;;) {
    auto want = wants_.end();
    signal_.wait(lock, [&] {
      want = std::find_if(wants_.begin(), wants_.end(), [](const Want& w) { return w.is_due; });
      return is_ending_ || want != wants_.end();
    });
    if (is_ending_) return;
    Pool& pool = *want->pool;
    const Pieces pieces = want->pieces;
    want->is_due = false;
    if (futex::Clock::now() < short_until_) continue;
    at_ = &pool;
    ++turn_;
    // relaxed: mutex_ orders it with the others
    is_called_off_.store(false, std::memory_order_relaxed);
    lock.unlock();
    make(pool, pieces);
    lock.lock();
    at_ = nullptr;
    signal_.notify_all();
  }
}

/// Makes the block. One that exists already but is not suitable gets other extents.
void Ahead::make(Pool& pool, const Pieces& pieces) noexcept {
  std::uint32_t b = pool.take_ahead();
  if (b == Pool::kNone && may_make(pool, pieces)) b = pool.claim();
  if (b == Pool::kNone) return;
  if (!furnish(pool, b, pieces) || !pool.put_ahead(b)) pool.release(b);
}

/// True if enough is free now. What is claimed meanwhile belongs to the claimer.
bool Ahead::may_make(const Pool& pool, const Pieces& pieces) const noexcept {
  const std::uint64_t needed = pieces.granules();
  if (!pool.may_take(2 * needed)) return false;  // the publisher may be filling one now
  const auto& tags = segment_.granules();
  std::uint64_t free = 0;
  for (std::uint32_t i = 0; i < tags.count() && free < kShare * needed; ++i)
    free += tags.tag(i) == 0;
  if (free < kShare * needed) return false;
  const std::uint64_t left = segment_.capacity().blocks / kShare;
  std::uint64_t idle = 0;
  for (std::uint32_t b = segment_.capacity().blocks; b-- != 0 && idle <= left;) {
    // Relaxed: a hint.
    idle += segment_.block(b).home.load(std::memory_order_relaxed) == refcount::kHomeFree;
  }
  return idle > left;
}

/// Gives an exclusively owned block extents for such pieces. False: there is no memory for them
/// now.
bool Ahead::furnish(Pool& pool, std::uint32_t b, const Pieces& pieces) noexcept {
  detail::Build& build = segment_.build(b);
  unsigned i = 0;
  for (const Pieces::Piece& piece : pieces) {
    if (i < build.extents) {
      detail::Build::Extent& extent = build.extent[i];
      if (extent.kind == piece.kind && extent.granules >= piece.granules) {
        ++i;
        continue;
      }
      pool.release_run(extent.granule, extent.granules);
      extent = build.extent[--build.extents];
    }
    if (build.extents == build.kMaxExtents) return false;  // a message has no more extents
    // Relaxed: it carries nothing. Seen late, one more unit is mapped.
    const std::uint32_t run = pool.claim_run_while(
        piece.granules, b + 1, [this] { return !is_called_off_.load(std::memory_order_relaxed); });
    if (run == Pool::kNoRun) return false;
    build.extent[build.extents++] = build.extent[i];
    build.extent[i++] = {run, piece.granules, 0, piece.kind};
  }
  while (build.extents > i) {
    const detail::Build::Extent gone = build.extent[--build.extents];
    pool.release_run(gone.granule, gone.granules);
  }
  return true;
}

}  // namespace lot::transport
