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

bool Eviction::can_free_run(std::uint32_t asker, unsigned order) noexcept {
  const std::lock_guard guard(mutex_);
  std::fill(marked_.begin(), marked_.end(), false);
  // At the end of what the rules allow, the asker has given all that it had.
  for (Evictor* e : evictors_) e->mark(e->pool() == asker, segment::kGranule << order, marked_);
  return has_run(order);
}

bool Eviction::has_run(unsigned order) const noexcept {
  const auto& granules = holder_.segment->granules();
  const std::uint32_t run = std::uint32_t{1} << order;
  for (std::uint32_t first = 0; granules.count() - first >= run; first += run) {
    std::uint32_t i = 0;
    for (; i < run; ++i) {
      const std::uint32_t tag = granules.tag(first + i);
      if (tag != 0 && (tag > marked_.size() || !marked_[tag - 1])) break;
    }
    if (i == run) return true;
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
  Evictor* richest = nullptr;
  std::uint64_t most = 0;
  for (Evictor* e : evictors_) {
    if (e == own) continue;
    const Evictor::Stock stock = e->stock(shortage);
    if (stock.oldest == 0 || stock.held <= most) continue;
    if (stock.held - stock.oldest < own_held + need) continue;
    richest = e;
    most = stock.held;
  }
  if (richest != nullptr) return richest->give_up(false);
  return own_held != 0 && own->give_up(true);
}

}  // namespace lot::transport
