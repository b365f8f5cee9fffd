// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <new>
#include <sys/mman.h>

#include "lot/detail/control.hpp"

namespace lot::transport {

/// The control cells of all blocks of a segment: what pointers of this process point to.
///
/// Threads: as detail::ControlCell says.
/// Memory:  private to the process. A page that no block has used takes none.
class Cells {
 public:
  /// Throws std::bad_alloc.
  Cells(std::uint32_t blocks, const detail::Hub& hub)
      : bytes_(blocks * sizeof(detail::ControlCell)) {
    void* cells = mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (cells == MAP_FAILED) throw std::bad_alloc();
    cells_ = static_cast<detail::ControlCell*>(cells);
    for (std::uint32_t b = 0; b < blocks; ++b) {
      auto* cell = new (&cells_[b]) detail::ControlCell{};
      cell->hub = &hub;
      cell->block = b;
    }
  }
  ~Cells() { munmap(cells_, bytes_); }
  Cells(const Cells&) = delete;
  Cells& operator=(const Cells&) = delete;

  detail::ControlCell* all() noexcept { return cells_; }

 private:
  std::size_t bytes_;
  detail::ControlCell* cells_;
};

}  // namespace lot::transport
