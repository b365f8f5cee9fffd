// SPDX-License-Identifier: Apache-2.0
#include "machine.hpp"

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <sched.h>
#include <set>
#include <sys/sysinfo.h>
#include <sys/utsname.h>

namespace ab {
namespace {

std::string first_line(const std::string& path) {
  std::string line;
  std::getline(std::ifstream(path), line);
  return line;
}

/// The value of the first line that begins with `key`.
std::string value_in(const char* path, const std::string& key, char separator) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(key, 0) != 0) continue;
    const auto at = line.find(separator);
    if (at == std::string::npos) continue;
    std::string value = line.substr(at + 1);
    value.erase(0, value.find_first_not_of(" \t\""));
    while (!value.empty() && value.back() == '"') value.pop_back();
    return value;
  }
  return "unknown";
}

}  // namespace

std::vector<int> usable_cores() {
  cpu_set_t set;
  CPU_ZERO(&set);
  sched_getaffinity(0, sizeof set, &set);
  std::vector<int> cores;
  for (int core = 0; core < CPU_SETSIZE; ++core) {
    if (CPU_ISSET(core, &set)) cores.push_back(core);
  }
  return cores;
}

unsigned socket_of(int core) {
  const std::string text = first_line("/sys/devices/system/cpu/cpu" + std::to_string(core) +
                                      "/topology/physical_package_id");
  return static_cast<unsigned>(std::strtoul(text.c_str(), nullptr, 10));
}

std::uint64_t free_memory() {
  const std::uint64_t available =
      std::strtoull(value_in("/proc/meminfo", "MemAvailable", ':').c_str(), nullptr, 10) * 1024;
  std::error_code ignored;
  const auto space = std::filesystem::space("/dev/shm", ignored);
  return ignored ? available : std::min<std::uint64_t>(available, space.available);
}

std::string utc_now() {
  const std::time_t now = std::time(nullptr);
  char text[32];
  std::strftime(text, sizeof text, "%FT%TZ", std::gmtime(&now));
  return text;
}

Machine this_machine() {
  Machine m;
  m.cpu = value_in("/proc/cpuinfo", "model name", ':');
  const std::vector<int> cores = usable_cores();
  m.cores = static_cast<unsigned>(cores.size());
  std::set<unsigned> sockets;
  for (const int core : cores) sockets.insert(socket_of(core));
  m.sockets = static_cast<unsigned>(sockets.size());
  struct sysinfo info {};
  sysinfo(&info);
  m.memory_gib = static_cast<double>(info.totalram) * info.mem_unit / (1 << 30);
  utsname name{};
  uname(&name);
  m.kernel = std::string(name.sysname) + " " + name.release + " " + name.machine;
  m.distribution = value_in("/etc/os-release", "PRETTY_NAME", '=');
#if defined(__clang__)
  m.compiler = "clang " __clang_version__;
#else
  m.compiler = "g++ " __VERSION__;
#endif
  m.governor = first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
  if (m.governor.empty()) m.governor = "unknown";
  const std::string flags = value_in("/proc/cpuinfo", "flags", ':');
  m.virtualised = flags.find(" hypervisor") != std::string::npos ? "under a hypervisor" : "no";
  m.load_before = first_line("/proc/loadavg");
  return m;
}

}  // namespace ab
