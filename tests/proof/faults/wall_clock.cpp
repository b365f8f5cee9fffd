// SPDX-License-Identifier: Apache-2.0
#include "wall_clock.hpp"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string_view>
#include <sys/mman.h>
#include <unistd.h>
#include <vector>

#include "support/processes.hpp"

namespace lot::testing {
namespace {

constexpr const char* kSetting = "FAKETIME_TIMESTAMP_FILE";

std::string library() {
  for (const char* directory :
       {"/usr/lib/x86_64-linux-gnu/faketime/", "/usr/lib/aarch64-linux-gnu/faketime/",
        "/usr/lib/faketime/", "/usr/lib64/faketime/"}) {
    const std::string path = std::string(directory) + "libfaketimeMT.so.1";
    if (std::filesystem::exists(path)) return path;
  }
  return "";
}

void write_setting(const std::string& path, int years) {
  char line[32];
  std::snprintf(line, sizeof(line), "%+dy\n", years);
  const std::string_view text = line;
  const int fd = open(path.c_str(), O_WRONLY | O_CLOEXEC);
  // Longer text first, then the end: who reads meanwhile never finds an empty file.
  must(fd != -1 && pwrite(fd, text.data(), text.size(), 0) == static_cast<ssize_t>(text.size()) &&
           ftruncate(fd, static_cast<off_t>(text.size())) == 0,
       "the clock was set");
  close(fd);
}

/// libfaketime's own files: nobody else needs their names, and so a kill leaves nothing.
void remove_its_names() {
  const std::string pid = std::to_string(getpid());
  unlink(("/dev/shm/faketime_shm_" + pid).c_str());
  unlink(("/dev/shm/sem.faketime_sem_" + pid).c_str());
}

}  // namespace

bool WallClock::take() {
  if (std::getenv(kSetting) != nullptr) {
    remove_its_names();
    return true;
  }
  const std::string path = library();
  const int file = memfd_create("clock", 0);  // to be inherited
  if (path.empty() || file == -1) return false;
  const std::string setting = "/proc/self/fd/" + std::to_string(file);
  write_setting(setting, 0);
  setenv("LD_PRELOAD", path.c_str(), 1);
  setenv(kSetting, setting.c_str(), 1);
  setenv("FAKETIME_NO_CACHE", "1", 1);
  // Its fstat() takes a semaphore that it shares with its children. A child that ends meanwhile, in
  // another thread, would keep it.
  setenv("NO_FAKE_STAT", "1", 1);
  setenv("FAKETIME_DONT_FAKE_MONOTONIC", "1", 1);
  setenv("DONT_FAKE_MONOTONIC", "1", 1);
  std::ifstream commandline("/proc/self/cmdline");
  std::string all{std::istreambuf_iterator<char>(commandline), {}};
  std::vector<char*> arguments;
  for (std::size_t at = 0; at < all.size(); at = all.find('\0', at) + 1) {
    arguments.push_back(&all[at]);
  }
  arguments.push_back(nullptr);
  execv("/proc/self/exe", arguments.data());
  unsetenv("LD_PRELOAD");
  unsetenv(kSetting);
  return false;
}

const std::string& WallClock::lacking() {
  static const std::string why = [] {
    if (library().empty()) return "no libfaketime (Debian: faketime)";
    if (std::getenv(kSetting) == nullptr) return "libfaketime could not be loaded";
    const int before = year();
    set(5);
    const bool moved = year() == before + 5;
    set(0);
    return moved ? "" : "libfaketime does not show the time that it is told";
  }();
  return why;
}

void WallClock::set(int years) { write_setting(std::getenv(kSetting), years); }

int WallClock::year() {
  const std::time_t now = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  std::tm parts{};
  gmtime_r(&now, &parts);
  return parts.tm_year + 1900;
}

}  // namespace lot::testing
