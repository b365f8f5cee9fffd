// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <new>
#include <stdexcept>
#include <string>

namespace lot {

/// How an operation that may come to nothing in ordinary life ended. Not an error.
enum class Status {
  Ok,             ///< it has done what it was asked for
  Empty,          ///< nothing to read now
  Full,           ///< a slow reader holds the queue back, and the deadline has passed
  Timeout,        ///< nothing came until the deadline
  PublisherGone,  ///< nothing to read, and the topic has no publisher now
  HoldsTooMuch,   ///< the subscription holds all the memory that it may: let messages go
  Stopped,        ///< its StopToken was told to stop
  ServerGone      ///< of a call: its server has died or left, or no server has come
};

/// The status in words, as "publisher gone".
[[nodiscard]] const char* to_string(Status status) noexcept;

/// A failure from outside: the system said no, or a segment is not what it should be. what() names
/// the object, the reason and what to do about it.
class [[gnu::visibility("default")]] Error : public std::runtime_error {
 public:
  /// `reason` and `advice` make what(). Throws std::bad_alloc.
  Error(int error_number, std::string object, const std::string& reason, const std::string& advice);

  /// The kind of the failure, as a value of errno, also where no system call has failed; or 0.
  int error_number() const noexcept { return errno_; }
  /// The path or name it is about.
  const std::string& object() const noexcept { return object_; }

 private:
  int errno_;
  std::string object_;
};

/// The segment has no room for a message. what() says how full it is and what to raise.
class [[gnu::visibility("default")]] OutOfMemory : public std::bad_alloc {
 public:
  /// Keeps a copy of the text, cut at 1023 bytes.
  explicit OutOfMemory(const char* what) noexcept;
  /// How full the segment is, and what to raise.
  const char* what() const noexcept override { return what_; }

 private:
  char what_[1024];
};

}  // namespace lot
