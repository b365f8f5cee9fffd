// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <sys/mman.h>

#include "lot/detail/control.hpp"

namespace lot::transport {

/// The control blocks of all blocks of a segment: what pointers of this process point to.
///
/// Threads: as detail::ControlBlock says.
/// Memory:  private to the process. A page that no block has used takes none.
class ControlBlocks {
 public:
  /// Throws std::bad_alloc.
  ControlBlocks(std::uint32_t blocks, const detail::Hub& hub)
      : bytes_(blocks * sizeof(detail::ControlBlock)) {
    void* controls =
        mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (controls == MAP_FAILED) throw std::bad_alloc();
    blocks_ = static_cast<detail::ControlBlock*>(controls);
    for (std::uint32_t b = 0; b < blocks; ++b) {
      auto* control = new (&blocks_[b]) detail::ControlBlock{};
      control->hub = &hub;
      control->block = b;
    }
  }
  ~ControlBlocks() { munmap(blocks_, bytes_); }
  ControlBlocks(const ControlBlocks&) = delete;
  ControlBlocks& operator=(const ControlBlocks&) = delete;

  detail::ControlBlock* all() noexcept { return blocks_; }

 private:
  std::size_t bytes_;
  detail::ControlBlock* blocks_;
};

}  // namespace lot::transport
