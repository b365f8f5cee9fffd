// SPDX-License-Identifier: Apache-2.0
#include "workplace.hpp"

#include <cstdio>
#include <fcntl.h>
#include <filesystem>
#include <random>
#include <sys/file.h>
#include <unistd.h>

#include "throw_errno.hpp"

namespace ab {
namespace {

namespace fs = std::filesystem;

const fs::path kMemory = "/dev/shm";
constexpr const char* kPrefix = "lot_ab_";
constexpr std::size_t kNameLength = 7 + 8;

/// A run holds this file locked while it lives, so that others see whether it does.
fs::path lock_of(const std::string& name) { return kMemory / (name + ".lock"); }

void remove_all_of(const std::string& name) {
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(kMemory, ignored)) {
    if (entry.path().filename().string().rfind(name, 0) == 0) fs::remove_all(entry.path(), ignored);
  }
}

void remove_stale() {
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(kMemory, ignored)) {
    const std::string file = entry.path().filename();
    if (file.rfind(kPrefix, 0) != 0 || entry.path().extension() != ".lock") continue;
    if (file.size() != kNameLength + 5) continue;
    const int fd = open(entry.path().c_str(), O_RDWR | O_CLOEXEC);
    if (fd < 0) continue;
    if (flock(fd, LOCK_EX | LOCK_NB) == 0) remove_all_of(file.substr(0, kNameLength));
    close(fd);
  }
}

}  // namespace

Workplace::Workplace() {
  remove_stale();
  std::random_device random;
  constexpr const char* kDigits = "0123456789abcdef";
  name_ = kPrefix;
  for (unsigned i = 0; i < 8; ++i) name_ += kDigits[random() % 16];
  // Locked before it has its name: nobody can take it for one that was left behind.
  const std::string unnamed = lock_of(name_).string() + ".new";
  lock_ = open(unnamed.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (lock_ < 0 || flock(lock_, LOCK_EX | LOCK_NB) != 0 ||
      rename(unnamed.c_str(), lock_of(name_).c_str()) != 0) {
    throw_errno(lock_of(name_));
  }
}

Workplace::~Workplace() {
  remove_all_of(name_);
  close(lock_);
}

std::string Workplace::directory(const std::string& name) const {
  const fs::path path = kMemory / name;
  fs::create_directory(path);
  return path;
}

}  // namespace ab
