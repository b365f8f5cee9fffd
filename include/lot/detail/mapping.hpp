// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>

namespace lot::detail {

/// A word of shared memory that others may change, read once: what was checked is what is used. For
/// words that hand nothing over.
template <class T>
T read_once(const T& word) noexcept {
  return __atomic_load_n(&word, __ATOMIC_RELAXED);
}

/// A place where a segment is mapped in this process, and where in it the memory of messages is: no
/// word of the segment leads a builder of messages elsewhere. Kept in private memory, since any
/// participant can change a word of the segment.
///
/// Threads: any. Memory: one for each place at which a segment was ever mapped, never freed, so
/// that a lookup takes no lock and a child of fork() finds what its parent had.
class Mapping {
 public:
  /// A block's small payload, and its arena: both lie equally far into their tables.
  static constexpr std::uint64_t kSmallBytes = 256;

  /// Where what is: the first byte, and offsets from it.
  struct Layout {
    unsigned char* base;
    std::uint64_t size;
    std::uint64_t arenas;
    std::uint64_t small;
    std::uint64_t data;  ///< granules, to the end

    friend bool operator==(const Layout& a, const Layout& b) noexcept {
      return a.base == b.base && a.size == b.size && a.arenas == b.arenas && a.small == b.small &&
             a.data == b.data;
    }
  };

  /// Says that a segment is mapped there, as long as the object lives.
  class Scope {
   public:
    Scope() = default;
    /// Throws std::bad_alloc.
    explicit Scope(const Layout& layout);
    Scope& operator=(Scope&& other) noexcept;
    ~Scope();

   private:
    Mapping* mapping_ = nullptr;
  };

  /// The one that an address lies in, or null.
  static const Mapping* of(const void* address) noexcept {
    for (const Mapping* m = newest.load(std::memory_order_acquire); m != nullptr; m = m->older_) {
      if (m->offset_of(address) < m->size_.load(std::memory_order_relaxed)) return m;
    }
    return nullptr;
  }

  std::uint64_t offset_of(const void* address) const noexcept {
    return static_cast<std::uint64_t>(static_cast<const unsigned char*>(address) - layout_.base);
  }
  /// Where these bytes are; null when they lie neither in granules nor in the small payload of the
  /// block whose arena it is.
  unsigned char* place(std::uint64_t offset, std::uint64_t bytes,
                       const void* arena) const noexcept {
    std::uint64_t begin = layout_.data;
    std::uint64_t end = layout_.size;
    if (offset < begin) {
      begin = layout_.small + (offset_of(arena) - layout_.arenas);
      end = begin + kSmallBytes;
    }
    return offset >= begin && offset <= end && bytes <= end - offset ? layout_.base + offset
                                                                     : nullptr;
  }
  /// The offset of so many bytes behind the first granule.
  std::uint64_t in_granules(std::uint64_t bytes) const noexcept { return layout_.data + bytes; }

 private:
  Mapping(const Layout& layout, Mapping* older)
      : layout_(layout), size_(layout.size), older_(older) {}

  static std::atomic<Mapping*> newest;  // private to the process

  const Layout layout_;
  std::atomic<std::uint64_t> size_;  ///< 0: nothing is mapped there any more
  Mapping* older_;
};

}  // namespace lot::detail
