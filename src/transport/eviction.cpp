// SPDX-License-Identifier: Apache-2.0
#include "transport/eviction.hpp"

#include <algorithm>
#include <chrono>

#include "futex/futex.hpp"

namespace lot::transport {
namespace {

/// no publisher of this process: another process asks
constexpr std::uint32_t kNoAsker = ~std::uint32_t{0};
/// A warden gives no more at once, since it has to answer, and to watch the other processes.
constexpr unsigned kMostAtOnce = 64;
constexpr std::chrono::milliseconds kLongestGift{20};

}  // namespace

void Eviction::add(Evictor& evictor) {
  const std::lock_guard guard(mutex_);
  evictors_.push_back(&evictor);
}

void Eviction::remove(Evictor& evictor) noexcept {
  const std::lock_guard guard(mutex_);
  std::erase(evictors_, &evictor);
}

bool Eviction::settle() noexcept {
  const std::lock_guard guard(mutex_);
  bool any = false;
  for (Evictor* e : evictors_) any |= e->settle();
  return any;
}

std::size_t Eviction::look(std::uint32_t pool, std::span<std::uint32_t> foreign) noexcept {
  const std::lock_guard guard(mutex_);
  for (Evictor* e : evictors_) {
    if (e->pool() == pool) return e->look(foreign);
  }
  return 0;
}

bool Eviction::give_up(std::uint32_t pool) noexcept {
  const std::lock_guard guard(mutex_);
  for (Evictor* e : evictors_) {
    if (e->pool() == pool) return e->give_up();
  }
  return false;
}

std::uint64_t Eviction::could_give(std::uint32_t pool, Shortage shortage) noexcept {
  const std::lock_guard guard(mutex_);
  for (Evictor* e : evictors_) {
    if (e->pool() == pool) return e->stock(shortage).own();
  }
  return 0;
}

bool Eviction::has_unread(Shortage shortage) noexcept {
  const std::lock_guard guard(mutex_);
  return survey(shortage).has_unread() ||
         std::any_of(evictors_.begin(), evictors_.end(),
                     [shortage](Evictor* e) { return e->stock(shortage).unread != 0; });
}

std::chrono::nanoseconds Eviction::patience(std::uint32_t pool) noexcept {
  const std::lock_guard guard(mutex_);
  for (Evictor* e : evictors_) {
    if (e->pool() == pool) return e->patience();
  }
  return {};
}

void Eviction::look_at_others(Shortage shortage) noexcept {
  const std::lock_guard guard(mutex_);
  survey_.look(holder_.own.self, shortage);
}

Survey& Eviction::survey(Shortage shortage) noexcept {
  if (survey_.shortage() != shortage) survey_.look(holder_.own.self, shortage);
  return survey_;
}

bool Eviction::can_free_run(std::uint32_t asker, std::uint32_t granules, const Givers& givers,
                            Backing backing) noexcept {
  const std::lock_guard guard(mutex_);
  std::fill(marked_.begin(), marked_.end(), false);
  bool unread = false;
  for (Evictor* e : evictors_) unread |= e->pool() == asker && e->patience().count() != 0;
  // When the rules have been applied to the end, the asker has given up all that it had.
  for (Evictor* e : evictors_) {
    e->mark(e->pool() == asker, segment::kGranule * granules, unread, marked_);
  }
  survey(Shortage::Memory).mark(granules, unread, marked_, [&](std::uint32_t k) {
    return givers[k];
  });
  return has_run(granules, backing);
}

bool Eviction::has_run(std::uint32_t run, Backing backing) const noexcept {
  segment::Segment& s = *holder_.segment;
  const auto& granules = s.granules();
  constexpr std::uint64_t kUnit = segment::kUnit;
  // The file system still has to give memory that was never used.
  bool more = backing == Backing::Asked;
  std::uint32_t length = 0;  // the length of the run that ends here
  for (std::uint32_t i = 0; i < granules.count(); ++i) {
    const std::uint32_t tag = granules.tag(i);
    if (tag != 0 && (tag > marked_.size() || !marked_[tag - 1])) {
      length = 0;
      continue;
    }
    if (++length < run) continue;
    const std::uint32_t first = i + 1 - run;
    if (backing == Backing::All || s.is_backed(first, run)) return true;
    if (more && s.can_back_run(first, run)) return true;
    more = false;
    // The next run that may be backed begins in another unit.
    const std::uint64_t at = s.granule_offset(first);
    const std::uint64_t step = (kUnit - at % kUnit) / segment::kGranule;
    length = step < run ? run - static_cast<std::uint32_t>(step) : 0;
  }
  return false;
}

Evictor* Eviction::richest(std::uint32_t asker, std::uint64_t keep, Shortage shortage,
                           Evictor::Stock& stock) noexcept {
  Evictor* richest = nullptr;
  stock = {};
  for (Evictor* e : evictors_) {
    if (e->pool() == asker) continue;
    const Evictor::Stock its = e->stock(shortage);
    if (its.oldest == 0 || its.held <= stock.held || its.held - its.oldest < keep) continue;
    richest = e;
    stock = its;
  }
  return richest;
}

Eviction::Step Eviction::evict(std::uint32_t asker, std::uint64_t need, Shortage shortage,
                               const Givers& givers) noexcept {
  using What = Step::What;
  const std::lock_guard guard(mutex_);
  const Survey& others = survey(shortage);
  const auto take_out = [&](bool all) -> Step {
    const Survey::Publisher* const p = givers[refcount::kOrphanage] ? others.ended(all) : nullptr;
    if (p == nullptr) return {};
    return {What::TakeOut, p->channel, {}, p->first};
  };
  if (const Step step = take_out(false); step.what != What::Nothing) return step;
  Evictor* own = nullptr;
  std::uint64_t own_held = 0;
  bool can_give = false;
  for (Evictor* e : evictors_) {
    if (e->pool() != asker) continue;
    own = e;
    const Evictor::Stock stock = e->stock(shortage);
    own_held = stock.held;
    can_give = stock.own() != 0;
  }
  const std::uint64_t unit = shortage == Shortage::Memory ? segment::kGranule : 1;
  const std::uint64_t keep = own_held + need;
  const Request request{shortage, (keep + unit - 1) / unit, (need + unit - 1) / unit};
  const Survey::Publisher* const other =
      others.richest(request.keep, [&](std::uint32_t k) { return givers[k]; });
  // A publisher that refuses has changed meanwhile. Then another one is chosen, at most once for
  // each publisher.
  for (std::size_t n = 0; n < evictors_.size(); ++n) {
    Evictor::Stock stock;
    Evictor* const ours = richest(asker, keep, shortage, stock);
    if (ours == nullptr || (other != nullptr && other->held * unit > stock.held)) break;
    if (ours->give_up_to_other(shortage, keep)) return {What::Given, 0, {}, 0};
  }
  if (other != nullptr) return {What::Ask, other->owner, request, 0};
  const bool others_refer =
      own != nullptr && others.would_follow([&](std::uint32_t k) { return givers[k]; });
  if ((can_give || others_refer) && own->give_up()) {
    return {others_refer ? What::Left : What::Given, 0, {}, 0};
  }
  return take_out(true);
}

bool Eviction::give(const Request& request) noexcept {
  const std::lock_guard guard(mutex_);
  const std::uint64_t unit = request.shortage == Shortage::Memory ? segment::kGranule : 1;
  const auto until = futex::Clock::now() + kLongestGift;
  bool any = false;
  std::uint64_t given = 0;
  for (unsigned n = 0; n < kMostAtOnce && given < request.need * unit; ++n) {
    if (futex::Clock::now() >= until) break;
    Evictor::Stock stock;
    Evictor* const giver = richest(kNoAsker, request.keep * unit, request.shortage, stock);
    if (giver == nullptr || !giver->give_up_to_other(request.shortage, request.keep * unit)) break;
    given += stock.frees;
    any = true;
  }
  return any;
}

}  // namespace lot::transport
