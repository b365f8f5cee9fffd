// SPDX-License-Identifier: Apache-2.0
#include "liveness/lock_holder.hpp"

#include <algorithm>
#include <cctype>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <sstream>
#include <system_error>

namespace lot::liveness {
namespace {

namespace fs = std::filesystem;

/// What /proc shows of a directory. Nothing where this process may not look at it.
fs::directory_iterator entries(const fs::path& directory) {
  std::error_code refused;
  fs::directory_iterator all(directory, refused);
  return refused ? fs::directory_iterator() : all;
}

/// True when the fdinfo of an open file says that it has a lock on a byte of that inode. A line is
/// "lock: 1: OFDLCK ADVISORY WRITE -1 00:1b:232725 1048576 1048577". The kernel joins neighbouring
/// locks to one.
bool has_lock(const fs::path& fdinfo, ino_t inode, std::uint32_t byte) {
  std::ifstream file(fdinfo);
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string key, number, kind, advisory, how, pid, place, first, last;
    if (!(words >> key >> number >> kind >> advisory >> how >> pid >> place >> first >> last) ||
        key != "lock:" || kind != "OFDLCK") {
      continue;
    }
    const std::string its_inode = place.substr(place.rfind(':') + 1);
    if (its_inode != std::to_string(inode)) continue;
    const auto end = last == "EOF" ? std::numeric_limits<std::uint64_t>::max() : std::stoull(last);
    if (std::stoull(first) <= byte && byte <= end) return true;
  }
  return false;
}

bool holds(const fs::path& process, const fs::path& name, ino_t inode, std::uint32_t byte) {
  std::error_code error;
  for (auto fd = entries(process / "fd"); fd != fs::directory_iterator(); fd.increment(error)) {
    if (error) break;
    std::error_code gone;
    if (fs::read_symlink(fd->path(), gone).filename() != name) continue;
    if (has_lock(process / "fdinfo" / fd->path().filename(), inode, byte)) return true;
  }
  return false;
}

/// Reads /proc/PID/stat: "PID (NAME) STATE ...". The name may have any bytes in it.
std::optional<LockHolder> look_at(const fs::path& process, pid_t pid) {
  std::ifstream file(process / "stat");
  std::string text;
  std::getline(file, text);
  const auto begin = text.find('(');
  const auto end = text.rfind(')');
  if (begin == std::string::npos || end == std::string::npos || end + 2 >= text.size()) return {};
  const char state = text[end + 2];
  std::string name = text.substr(begin + 1, end - begin - 1);
  std::replace_if(
      name.begin(), name.end(), [](unsigned char c) { return std::isprint(c) == 0; }, '?');
  return LockHolder{pid, name, state == 'T' || state == 't'};
}

/// The hexadecimal number behind `key` in /proc/PID/status; 0: none.
std::uint64_t mask_of(const std::string& status, const char* key) {
  const auto at = status.find(key);
  return at == std::string::npos
             ? 0
             : std::strtoull(status.c_str() + at + std::strlen(key), nullptr, 16);
}

}  // namespace

bool is_being_killed(pid_t pid) noexcept try {
  constexpr std::uint64_t kKill = std::uint64_t{1} << (SIGKILL - 1);
  constexpr unsigned long kExiting = 4;  // PF_EXITING
  const fs::path process = fs::path("/proc") / std::to_string(pid);
  std::ifstream status_file(process / "status");
  const std::string status(std::istreambuf_iterator<char>(status_file), {});
  if (((mask_of(status, "SigPnd:") | mask_of(status, "ShdPnd:")) & kKill) != 0) return true;
  // "PID (NAME) STATE PPID PGRP SESSION TTY TPGID FLAGS ...". The name may have any bytes in it.
  std::ifstream file(process / "stat");
  std::string text;
  std::getline(file, text);
  const auto end = text.rfind(')');
  if (end == std::string::npos) return false;
  std::istringstream words(text.substr(end + 1));
  std::string state, parent, group, session, terminal, owner;
  unsigned long flags = 0;
  words >> state >> parent >> group >> session >> terminal >> owner >> flags;
  return state == "Z" || state == "X" || (flags & kExiting) != 0;
} catch (const std::exception&) {  // memory is short
  return false;
}

std::string LockHolder::describe() const {
  return "process " + std::to_string(pid) + " (" + name + ")";
}

std::string LockHolder::advice() const {
  const std::string number = std::to_string(pid);
  return "continue it (kill -CONT " + number + ") or kill it (kill -KILL " + number + ")";
}

std::optional<LockHolder> LockHolder::find(const std::string& path, ino_t inode,
                                           std::uint32_t byte) {
  const fs::path name = fs::path(path).filename();
  std::error_code error;
  for (auto process = entries("/proc"); process != fs::directory_iterator();
       process.increment(error)) {
    if (error) break;
    const std::string number = process->path().filename();
    if (!std::all_of(number.begin(), number.end(), [](char c) { return c >= '0' && c <= '9'; })) {
      continue;
    }
    if (!holds(process->path(), name, inode, byte)) continue;
    return look_at(process->path(), std::stoi(number));
  }
  return {};
}

}  // namespace lot::liveness
