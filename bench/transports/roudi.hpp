// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <string>

#include <iceoryx_hoofs/posix_wrapper/posix_access_rights.hpp>

/// What lot_ab_roudi and who starts it agree on.
namespace ab {

constexpr int kRoudiReadyFd = 3;  ///< it writes a byte there when it answers

constexpr const char* kRoudiSocket = "/tmp/roudi";
constexpr const char* kRoudiLock = "/tmp/iox-unique-roudi.lock";
constexpr const char* kRoudiManagement = "/dev/shm/iceoryx_mgmt";

/// The messages' segment has the name of our group.
inline std::string roudi_segment() {
  return "/dev/shm/" +
         std::string(iox::posix::PosixGroup::getGroupOfCurrentProcess().getName().c_str());
}

/// All that a RouDi has made; the lock last, since it guards the others.
inline std::array<std::string, 5> roudi_files() {
  return {roudi_segment(), kRoudiManagement, kRoudiSocket, std::string(kRoudiSocket) + ".lock",
          kRoudiLock};
}

}  // namespace ab
