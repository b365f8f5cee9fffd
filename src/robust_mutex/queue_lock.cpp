// SPDX-License-Identifier: Apache-2.0
#include "robust_mutex/queue_lock.hpp"

#include <cerrno>

#include "lot/error.hpp"

namespace lot::mutex_engine {
namespace {
constexpr std::chrono::seconds kPatience{5};
}

bool QueueLock::take() const noexcept {
  RobustMutex mutex(lock_->held, *owner_);
  const auto outcome = mutex.lock_for(kPatience);
  if (outcome == RobustMutex::Outcome::OwnerDied) {
    for (Word* word : {&lock_->arrived, space_}) {
      RobustCondition condition(*word);
      condition.renew();
      condition.wake_all();
    }
  }
  return outcome != RobustMutex::Outcome::Busy;
}

void QueueLock::refuse() const {
  owner_->require_place(*path_);
  throw Error(EBUSY, *path_, "another process has held the lock of a queue all the time",
              "look for a stopped process that uses it (state T in ps) and continue or kill it");
}

}  // namespace lot::mutex_engine
