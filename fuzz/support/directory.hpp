// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <unistd.h>

#include "support/processes.hpp"

namespace lot::fuzz {

/// A directory for segments that goes when this process goes, however it ends: a child waits for
/// that and removes it. Made before any thread.
class Directory {
 public:
  Directory() {
    std::string pattern = "/dev/shm/" + testing::prefix() + "_XXXXXX";
    int ends[2];
    if (mkdtemp(pattern.data()) == nullptr || pipe2(ends, O_CLOEXEC) != 0) {
      throw std::runtime_error("cannot make " + pattern);
    }
    path_ = pattern;
    const pid_t child = fork();
    if (child == -1) throw std::runtime_error("cannot fork");
    if (child == 0) wait_and_remove(ends);
    close(ends[0]);  // the other end stays open for as long as this process lives
  }

  const std::string& path() const { return path_; }

 private:
  [[noreturn]] void wait_and_remove(const int* ends) const {
    for (const int s : {SIGINT, SIGTERM, SIGHUP, SIGQUIT}) signal(s, SIG_IGN);
    close(ends[1]);
    char byte;
    while (read(ends[0], &byte, 1) == -1 && errno == EINTR) {
    }
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
    _exit(0);
  }

  std::string path_;
};

}  // namespace lot::fuzz
