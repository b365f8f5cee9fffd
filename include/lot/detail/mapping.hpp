// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

namespace lot::detail {

/// Reads a word of shared memory once, since other processes may change it: the caller then uses
/// the value that it has checked. Relaxed: such a word hands nothing over.
template <class T>
T read_once(const T& word) noexcept {
  return __atomic_load_n(&word, __ATOMIC_RELAXED);
}
/// Writes a word that other processes may read meanwhile. Relaxed: it hands nothing over.
template <class T>
void write_once(T& word, T value) noexcept {
  __atomic_store_n(&word, value, __ATOMIC_RELAXED);
}

/// A place where a segment is mapped in this process, with what the process knows of its blocks'
/// messages while it builds them (Build). It lies in private memory, since any participant can
/// change a word of the segment: so no such word can lead a builder elsewhere.
///
/// Threads: any.
/// Memory:  one for each place at which a segment was ever mapped. It is never freed, so that a
///          lookup takes no lock and a child of fork() finds the places that its parent had. While
///          the segment is mapped, 256 bytes for each block; the system gives the pages that are
///          touched.
class Mapping {
 public:
  /// Size of a block's small payload, of its arena and of its Build: all three lie equally far into
  /// their tables.
  static constexpr std::uint64_t kSmallBytes = 256;

  /// Where the parts of a segment are: the first byte, and offsets from it.
  struct Layout {
    unsigned char* base;
    std::uint64_t size;
    std::uint64_t arenas;
    std::uint64_t small;
    std::uint64_t data;  ///< the granules, to the end of the segment
    std::uint64_t blocks;

    friend bool operator==(const Layout& a, const Layout& b) noexcept {
      return a.base == b.base && a.size == b.size && a.arenas == b.arenas && a.small == b.small &&
             a.data == b.data && a.blocks == b.blocks;
    }
  };

  /// While it lives, a segment is mapped at that place.
  class Scope {
   public:
    Scope() = default;
    /// Throws std::bad_alloc.
    explicit Scope(const Layout& layout);
    Scope& operator=(Scope&& other) noexcept;
    ~Scope();

    const Mapping& mapping() const noexcept { return *mapping_; }

   private:
    Mapping* mapping_ = nullptr;
  };

  /// The mapping that an address lies in, or null.
  /// Acquire: with the release in Scope, the fields of the Mapping. `size_` is relaxed: the caller
  /// got the address from a thread that had the segment mapped.
  static const Mapping* of(const void* address) noexcept {
    for (const Mapping* m = newest.load(std::memory_order_acquire); m != nullptr; m = m->older_) {
      if (m->offset_of(address) < m->size_.load(std::memory_order_relaxed)) return m;
    }
    return nullptr;
  }

  unsigned char* base() const noexcept { return layout_.base; }
  std::uint64_t size() const noexcept { return layout_.size; }
  std::uint64_t offset_of(const void* address) const noexcept {
    return static_cast<std::uint64_t>(static_cast<const unsigned char*>(address) - layout_.base);
  }
  /// The Build of the block that has an arena; null when there is no arena.
  void* build_of(const void* arena) const noexcept {
    const std::uint64_t distance = offset_of(arena) - layout_.arenas;
    return distance < layout_.blocks * kSmallBytes ? builds_ + distance / kSmallBytes * kSmallBytes
                                                   : nullptr;
  }
  /// The small payload of the block that has an arena, as an offset. REQUIRES: it is an arena.
  std::uint64_t small_of(const void* arena) const noexcept {
    return layout_.small + (offset_of(arena) - layout_.arenas);
  }
  /// The offset of the byte that lies `bytes` behind the begin of the first granule.
  std::uint64_t in_granules(std::uint64_t bytes) const noexcept { return layout_.data + bytes; }

 private:
  Mapping(const Layout& layout, unsigned char* builds, Mapping* older)
      : layout_(layout), builds_(builds), size_(layout.size), older_(older) {}

  static std::atomic<Mapping*> newest;  // private to the process

  const Layout layout_;
  unsigned char* builds_;            ///< of the segment that is mapped there now
  std::atomic<std::uint64_t> size_;  ///< 0: nothing is mapped there any more
  Mapping* older_;
};

}  // namespace lot::detail
