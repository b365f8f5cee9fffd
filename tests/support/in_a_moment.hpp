// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <thread>
#include <utility>

namespace lot::testing {

/// While it lives, another thread does something in a moment: most likely the caller waits by then.
class InAMoment {
 public:
  template <class What>
  explicit InAMoment(What what)
      : thread_([what = std::move(what)]() mutable {
          std::this_thread::sleep_for(std::chrono::milliseconds(2));
          what();
        }) {}
  ~InAMoment() { thread_.join(); }
  InAMoment(const InAMoment&) = delete;
  InAMoment& operator=(const InAMoment&) = delete;

 private:
  std::thread thread_;
};

}  // namespace lot::testing
