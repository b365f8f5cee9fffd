// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/mapping.hpp"

#include <new>
#include <sys/mman.h>
#include <utility>

namespace lot::detail {
namespace {

/// A table of zeros. The system gives memory only for the pages that are touched. A child of fork()
/// finds zeros as well: it builds none of its parent's messages.
unsigned char* make_table(std::uint64_t bytes) {
  void* const table = mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                           MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (table == MAP_FAILED) throw std::bad_alloc();
  madvise(table, bytes, MADV_WIPEONFORK);
  return static_cast<unsigned char*>(table);
}

}  // namespace

std::atomic<Mapping*> Mapping::newest{nullptr};

Mapping::Scope::Scope(const Layout& layout) {
  const std::uint64_t bytes = layout.blocks * kSmallBytes;
  unsigned char* const builds = make_table(bytes);
  Mapping* first = newest.load(std::memory_order_acquire);  // the mappings in the list
  for (Mapping* m = first; m != nullptr; m = m->older_) {
    // Two segments are never mapped at one place: the former one has gone.
    if (m->layout_ == layout) {
      mapping_ = m;
      m->builds_ = builds;
      // Relaxed: a thread that looks an address up got it from the owner of this Scope.
      m->size_.store(layout.size, std::memory_order_relaxed);
      return;
    }
  }
  try {
    mapping_ = new Mapping(layout, builds, first);
  } catch (...) {
    munmap(builds, bytes);
    throw;
  }
  // Release: the new Mapping, for of().
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
  mapping_->size_.store(0, std::memory_order_relaxed);  // no thread uses an address there any more
  munmap(mapping_->builds_, mapping_->layout_.blocks * kSmallBytes);
}

}  // namespace lot::detail
