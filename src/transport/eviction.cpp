// SPDX-License-Identifier: Apache-2.0
#include "transport/eviction.hpp"

#include <algorithm>

namespace lot::transport {

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

bool Eviction::can_free_run(std::uint32_t asker, unsigned order) noexcept {
  const std::lock_guard guard(mutex_);
  std::fill(marked_.begin(), marked_.end(), false);
  // At the end of what the rules allow, the asker has given all that it had.
  for (Evictor* e : evictors_) e->mark(e->pool() == asker, segment::kGranule << order, marked_);
  return has_run(order);
}

bool Eviction::has_run(unsigned order) const noexcept {
  segment::Segment& s = *holder_.segment;
  const auto& granules = s.granules();
  const std::uint32_t run = std::uint32_t{1} << order;
  bool more = true;  // the system gives memory that nothing has been in yet
  for (std::uint32_t first = 0; granules.count() - first >= run; first += run) {
    std::uint32_t i = 0;
    for (; i < run; ++i) {
      const std::uint32_t tag = granules.tag(first + i);
      if (tag != 0 && (tag > marked_.size() || !marked_[tag - 1])) break;
    }
    if (i != run) continue;
    if (s.is_backed(first, order)) return true;
    if (more && s.back_run(first, order)) return true;
    more = false;
  }
  return false;
}

bool Eviction::evict(std::uint32_t asker, std::uint64_t need, Shortage shortage) noexcept {
  const std::lock_guard guard(mutex_);
  Evictor* own = nullptr;
  std::uint64_t own_held = 0;
  for (Evictor* e : evictors_) {
    if (e->pool() != asker) continue;
    own = e;
    own_held = e->stock(shortage).held;
  }
  const std::uint64_t keep = own_held + need;
  // A publisher that refuses has changed meanwhile. Then another is chosen, once for each of them.
  for (std::size_t n = 0; n < evictors_.size(); ++n) {
    Evictor* richest = nullptr;
    std::uint64_t most = 0;
    for (Evictor* e : evictors_) {
      if (e == own) continue;
      const Evictor::Stock stock = e->stock(shortage);
      if (stock.oldest == 0 || stock.held <= most || stock.held - stock.oldest < keep) continue;
      richest = e;
      most = stock.held;
    }
    if (richest == nullptr) break;
    if (richest->give_up_to_other(shortage, keep)) return true;
  }
  return own_held != 0 && own->give_up();
}

}  // namespace lot::transport
