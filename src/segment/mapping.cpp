// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/mapping.hpp"

#include <utility>

namespace lot::detail {

std::atomic<Mapping*> Mapping::newest{nullptr};

Mapping::Scope::Scope(const Layout& layout) {
  Mapping* first = newest.load(std::memory_order_acquire);
  for (Mapping* m = first; m != nullptr; m = m->older_) {
    // Two are never at one place: the one that was there has gone.
    if (m->layout_ == layout) {
      mapping_ = m;
      m->size_.store(layout.size, std::memory_order_relaxed);
      return;
    }
  }
  mapping_ = new Mapping(layout, first);
  while (!newest.compare_exchange_weak(first, mapping_, std::memory_order_release,
                                       std::memory_order_relaxed)) {
    mapping_->older_ = first;
  }
}

Mapping::Scope& Mapping::Scope::operator=(Scope&& other) noexcept {
  std::swap(mapping_, other.mapping_);
  return *this;
}

Mapping::Scope::~Scope() {
  if (mapping_ != nullptr) mapping_->size_.store(0, std::memory_order_relaxed);
}

}  // namespace lot::detail
