// SPDX-License-Identifier: Apache-2.0
#include "lot/detail/stop_word.hpp"

#include <cerrno>

#include "futex/futex.hpp"

namespace lot::detail {

bool StopWord::set() noexcept {
  const int error = errno;
  const bool first = word_.exchange(1, std::memory_order_release) == 0;  // W1
  futex::wake_all(&word_);
  errno = error;
  return first;
}

}  // namespace lot::detail
