// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdio>
#include <grp.h>
#include <string>
#include <sys/stat.h>
#include <unistd.h>

#include "support/processes.hpp"

/// Other users, and whose a file is.
namespace lot::testing {

inline constexpr uid_t kAnn = 65531;
inline constexpr uid_t kBob = 65532;
inline constexpr gid_t kGroup = 65533;
inline constexpr gid_t kOtherGroup = 65530;
inline constexpr gid_t kNoGroup = 65534;  ///< the kernel's name of those that it does not know

inline bool can_be_another_user() {
  if (getuid() == 0) return true;
  std::printf("skipped: only root can be another user\n");
  return false;
}

inline void become(uid_t user, gid_t group) {
  must(setgroups(0, nullptr) == 0 && setresgid(group, group, group) == 0 &&
           setresuid(user, user, user) == 0,
       "another user");
}

struct Facts {
  uid_t user;
  gid_t group;
  mode_t mode;
  friend bool operator==(const Facts&, const Facts&) = default;
};
inline Facts facts_of(const std::string& path) {
  struct stat status {};
  must(stat(path.c_str(), &status) == 0, "the file is there");
  return {status.st_uid, status.st_gid, status.st_mode & 07777};
}

}  // namespace lot::testing
