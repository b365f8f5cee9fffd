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

/// Root is refused, too, where a user namespace has one user, or a container no capabilities.
inline bool can_be_another_user() {
  static const bool can = [] {
    Child trial([] {
      const bool may = setgroups(0, nullptr) == 0 && setresgid(kGroup, kGroup, kGroup) == 0 &&
                       setresuid(kAnn, kAnn, kAnn) == 0;
      _exit(may ? 0 : 1);
    });
    if (trial.wait() == 0) return true;
    std::printf("skipped: %s\n",
                getuid() == 0 ? "no other users here" : "only root can be another user");
    return false;
  }();
  return can;
}

/// For what an ordinary user tries himself, and root as another user.
inline bool can_be_ordinary_user() { return getuid() != 0 || can_be_another_user(); }

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
