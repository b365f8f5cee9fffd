// SPDX-License-Identifier: Apache-2.0
#include "lot/error.hpp"

#include <cstdio>
#include <cstring>

namespace lot {

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
    case Status::OutOfMemory:
      return "out of memory";
  }
  return "?";
}

Error::Error(int error_number, std::string object, const std::string& reason,
             const std::string& advice)
    : std::runtime_error("lot: " + object + ": " + reason +
                         (error_number != 0 ? std::string(" (") + std::strerror(error_number) + ")"
                                            : std::string()) +
                         (advice.empty() ? std::string() : "; " + advice)),
      errno_(error_number),
      object_(std::move(object)) {}

OutOfMemory::OutOfMemory(const char* what) noexcept : what_{} {
  std::snprintf(what_, sizeof(what_), "%s", what);
}

}  // namespace lot
