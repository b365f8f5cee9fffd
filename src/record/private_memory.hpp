// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <new>
#include <sys/mman.h>

#include "lot/description.hpp"
#include "lot/error.hpp"
#include "lot/mutable_value.hpp"

namespace lot::record {

/// Memory of this process for one message at a time.
///
/// Threads: one at a time.
class PrivateMemory {
 public:
  PrivateMemory() = default;
  ~PrivateMemory() { free(); }
  PrivateMemory(const PrivateMemory&) = delete;
  PrivateMemory& operator=(const PrivateMemory&) = delete;

  /// A message in so many bytes, which are touched only as far as they are used. Throws
  /// std::bad_alloc; lot::OutOfMemory when the message grows beyond them.
  MutableValue make(const Description& description, std::size_t bytes) {
    if (bytes > size_) {
      free();
      void* const at = mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                            MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
      if (at == MAP_FAILED) throw std::bad_alloc();
      begin_ = static_cast<std::byte*>(at);
      size_ = bytes;
    }
    used_ = 0;
    void* const at = take(description.root().size, 1);
    const detail::MessageMemory memory{this,
                                       [](void* its, std::size_t more, std::size_t align) {
                                         return static_cast<PrivateMemory*>(its)->take(more, align);
                                       },
                                       [](void*, void*, std::size_t) noexcept {}};
    MutableValue made(description, at, begin_, begin_ + size_, memory);
    made.construct();
    return made;
  }

 private:
  void free() noexcept {
    if (begin_ != nullptr) munmap(begin_, size_);
    begin_ = nullptr;
    size_ = 0;
  }
  void* take(std::size_t bytes, std::size_t align) {
    const std::size_t at = (used_ + align - 1) / align * align;
    if (at > size_ || bytes > size_ - at) throw OutOfMemory("a recorded message is too large");
    used_ = at + bytes;
    return begin_ + at;
  }

  std::byte* begin_ = nullptr;
  std::size_t size_ = 0;
  std::size_t used_ = 0;
};

}  // namespace lot::record
