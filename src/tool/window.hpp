// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <csignal>
#include <string>

#include "segment/segment.hpp"

namespace lot::tool {

/// A segment that is looked at from outside: mapped read-only, joined by nobody.
///
/// Whoever may write to the file may also truncate it, and then reading raises SIGBUS. While a
/// Window lives, such a page reads as zeros instead, and torn() says that it has happened.
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

  /// Until the segment is mapped nobody knows where.
  struct Opening {
    Opening();
    ~Opening();
  };
  static segment::Segment open(const std::string& path, const segment::Trust& trust);

  segment::Segment segment_;
  volatile bool torn_ = false;  ///< by the handler
  Window* next_;                ///< of all that live
};

}  // namespace lot::tool
