// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "lot/detail/mutex.hpp"

#include "codec/encode.hpp"

namespace lot::gateway {

/// Memory for the bytes of one sample: for those that an encoder makes, or for those that come from
/// the network. It keeps what it has got from sample to sample.
struct Buffer {
  codec::Encoded encoded;
  std::unique_ptr<std::byte[]> received;
  std::uint64_t capacity = 0;  ///< of `received`

  /// So many bytes in `received`, which are not zeroed. Throws std::bad_alloc.
  std::byte* room(std::uint64_t bytes) {
    if (bytes > capacity) {
      received = std::make_unique_for_overwrite<std::byte[]>(bytes);
      capacity = bytes;
    }
    return received.get();
  }
};

/// The buffers of one topic that no sample has now. A large buffer of the heap costs a page fault
/// for each 4 KiB the first time: so samples use them again.
///
/// Threads: all members may be called at once.
/// Errors:  std::bad_alloc of take().
/// Memory:  at most kMostIdle buffers that no sample has.
class Buffers {
 public:
  static constexpr std::size_t kMostIdle = 4;

  Buffers() { idle_.reserve(kMostIdle); }

  std::unique_ptr<Buffer> take() {
    const std::lock_guard guard(mutex_);
    if (idle_.empty()) return std::make_unique<Buffer>();
    std::unique_ptr<Buffer> buffer = std::move(idle_.back());
    idle_.pop_back();
    return buffer;
  }
  void give(std::unique_ptr<Buffer> buffer) noexcept {
    const std::lock_guard guard(mutex_);
    if (idle_.size() < kMostIdle) idle_.push_back(std::move(buffer));
  }

 private:
  detail::Mutex mutex_{detail::Rank::Gateway};
  std::vector<std::unique_ptr<Buffer>> idle_;
};

}  // namespace lot::gateway
