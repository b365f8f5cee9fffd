// SPDX-License-Identifier: Apache-2.0
#include "lot/error.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>

namespace lot {
namespace {

/// what() is a C string: a NUL in a name must not end it.
std::string printable(std::string name) {
  std::replace(name.begin(), name.end(), '\0', '?');
  return name;
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
    : std::runtime_error("lot: " + printable(object) + ": " + reason +
                         (error_number != 0 ? std::string(" (") + std::strerror(error_number) + ")"
                                            : std::string()) +
                         (advice.empty() ? std::string() : "; " + advice)),
      errno_(error_number),
      object_(std::move(object)) {}

OutOfMemory::OutOfMemory(const char* what) noexcept : what_{} {
  std::snprintf(what_, sizeof(what_), "%s", what);
}

}  // namespace lot
