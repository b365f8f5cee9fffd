// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <csignal>
#include <string>

#include "segment/segment.hpp"

namespace lot::tool {

/// A segment that the tool looks at from outside: it maps the segment read-only and does not join.
///
/// A process that may write to the file may also truncate it, and then reading raises SIGBUS. While
/// a Window lives, such a page reads as zeros instead, and torn() says that it has happened.
///
/// Threads: one.
class Window {
 public:
  /// Throws lot::Error when it is no segment that this build can read.
  Window(const std::string& path, const segment::Trust& trust);
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  segment::Segment& segment() noexcept { return segment_; }
  bool torn() const noexcept { return torn_; }

 private:
  static void on_bus_error(int signal, siginfo_t* info, void* context);

  /// While it lives, the handler takes every SIGBUS for one of the segment that is being mapped:
  /// its address is not known yet.
  struct Opening {
    Opening();
    ~Opening();
  };
  static segment::Segment open(const std::string& path, const segment::Trust& trust);

  segment::Segment segment_;
  volatile bool torn_ = false;  ///< the signal handler sets it
  Window* next_;                ///< the next one in the list of all that live
};

}  // namespace lot::tool
