// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/mapping.hpp"

#include <cstring>
#include <new>
#include <sys/mman.h>
#include <utility>

namespace lot::detail {
namespace {

/// Zeros, for which the system gives the pages that are touched.
unsigned char* make_table(std::uint64_t bytes) {
  void* const table = mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                           MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (table == MAP_FAILED) throw std::bad_alloc();
  return static_cast<unsigned char*>(table);
}

}  // namespace

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
  const std::uint64_t bytes = layout.blocks * kSmallBytes;
  unsigned char* const builds = make_table(bytes);
  try {
    mapping_ = new Mapping(layout, builds, first);
  } catch (...) {
    munmap(builds, bytes);
    throw;
  }
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
  if (mapping_ == nullptr) return;
  mapping_->size_.store(0, std::memory_order_relaxed);
  // Zeros again, also where the application has locked its memory.
  const std::uint64_t bytes = mapping_->layout_.blocks * kSmallBytes;
  if (madvise(mapping_->builds_, bytes, MADV_DONTNEED) != 0) {
    std::memset(mapping_->builds_, 0, bytes);
  }
}

}  // namespace lot::detail
