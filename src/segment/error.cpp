// SPDX-License-Identifier: Apache-2.0
#include "lot/error.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>
#include <new>

#include "lot/detail/raise.hpp"

namespace lot {
namespace {

/// what() is a C string: a NUL in a name must not end it.
std::string printable(std::string name) {
  std::replace(name.begin(), name.end(), '\0', '?');
  return name;
}

/// The system's words for the number, in brackets. None for a number that is only the kind of a
/// failure: its words tell of sockets and disks.
std::string words_of(int error_number) {
  if (error_number == 0 || error_number == EPROTOTYPE || error_number == EREMOTEIO) return "";
  return std::string(" (") + std::strerror(error_number) + ")";
}

}  // namespace

const char* to_string(Status status) noexcept {
  switch (status) {
    case Status::Ok:
      return "ok";
    case Status::Empty:
      return "empty";
    case Status::Full:
      return "full";
    case Status::Timeout:
      return "timeout";
    case Status::PublisherGone:
      return "publisher gone";
    case Status::HoldsTooMuch:
      return "holds too much";
    case Status::Stopped:
      return "stopped";
    case Status::ServerGone:
      return "server gone";
  }
  return "?";
}

Error::Error(int error_number, std::string object, const std::string& reason,
             const std::string& advice)
    : std::runtime_error("lot: " + printable(object) + ": " + reason + words_of(error_number) +
                         (advice.empty() ? std::string() : "; " + advice)),
      errno_(error_number),
      object_(std::move(object)) {}

OutOfMemory::OutOfMemory(const char* what) noexcept : what_{} {
  std::snprintf(what_, sizeof(what_), "%s", what);
}

namespace detail {

void raise_too_large() { throw std::bad_alloc(); }
void raise_expired() { throw std::bad_weak_ptr(); }
void raise_not_redelivered(const char* name) {
  throw Error(EINVAL, name, "items that each reader gets cannot be redelivered",
              "use ShmQueue<ShmUniquePtr<T>>, or ShmQueue<T>, whose items one worker gets");
}

}  // namespace detail

}  // namespace lot
