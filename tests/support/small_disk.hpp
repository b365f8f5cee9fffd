// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>
#include <string>
#include <sys/mount.h>
#include <unistd.h>

namespace lot::testing {

/// A tmpfs of its own; empty path when it can not be mounted.
struct SmallDisk {
  explicit SmallDisk(const std::string& mount_options) {
    char pattern[] = "/tmp/lot_disk_XXXXXX";
    if (mkdtemp(pattern) == nullptr) return;
    path = pattern;
    if (mount("lot", pattern, "tmpfs", 0, mount_options.c_str()) != 0) {
      rmdir(pattern);
      path.clear();
    }
  }
  ~SmallDisk() {
    if (path.empty()) return;
    umount(path.c_str());
    rmdir(path.c_str());
  }
  SmallDisk(const SmallDisk&) = delete;
  SmallDisk& operator=(const SmallDisk&) = delete;
  std::string path;
};

}  // namespace lot::testing
