// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <optional>

#include <pybind11/pybind11.h>

#include "lot/duration.hpp"
#include "lot/error.hpp"

#include "python/gil.hpp"

namespace lot::python {

using Clock = std::chrono::steady_clock;

/// A thread works on what one thread at a time may use, and leaves the GIL to others meanwhile.
///
/// Threads: under the GIL.
class Use {
 public:
  /// Throws lot::Error (EBUSY) where another thread does.
  Use(bool& is_used, const char* what) : is_used_(is_used) {
    if (is_used) {
      throw Error(EBUSY, what, "another thread uses it", "give each thread one of its own");
    }
    is_used = true;
  }
  ~Use() { is_used_ = false; }
  Use(const Use&) = delete;
  Use& operator=(const Use&) = delete;

 private:
  bool& is_used_;
};

/// Seconds, as Python gives them; none: for ever.
using Seconds = std::optional<double>;

inline Clock::time_point deadline_after(Seconds timeout) {
  if (!timeout) return Clock::time_point::max();
  const std::chrono::nanoseconds time = Duration(std::chrono::duration<double>(*timeout));
  const auto now = Clock::now();
  return time < Clock::time_point::max() - now ? now + time : Clock::time_point::max();
}

/// Python runs its handlers of signals between two steps of its own. So a wait is cut into steps.
inline constexpr std::chrono::milliseconds kStep{50};

/// Waits by step(end), without the GIL, until it says something else than that the time is up; a
/// publisher that has gone is told by the step in which it has gone. Throws what a handler of a
/// signal raises, what the step throws, and SystemExit at the end of the interpreter.
template <class Step>
Status wait(Clock::time_point deadline, Step&& step) {
  const Waiting waiting;
  for (bool had_publisher = false;;) {
    waiting.require_interpreter();
    const auto end = std::min(deadline, Clock::now() + kStep);
    Status said;
    {
      const Released release;
      said = step(end);
    }
    const auto now = Clock::now();
    if (said != Status::Timeout && said != Status::PublisherGone && said != Status::Full)
      return said;
    if (now >= deadline) return said;
    // A step that is over says so, too, where there is no publisher at all.
    if (said == Status::PublisherGone && (had_publisher || now < end)) return said;
    had_publisher = said == Status::Timeout;
    if (PyErr_CheckSignals() != 0) throw pybind11::error_already_set();
  }
}

}  // namespace lot::python
