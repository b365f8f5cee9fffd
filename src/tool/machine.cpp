// SPDX-License-Identifier: Apache-2.0
#include "tool/machine.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <linux/futex.h>
#include <linux/membarrier.h>
#include <memory>
#include <pwd.h>
#include <set>
#include <sstream>
#include <string_view>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <sys/utsname.h>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

#include "tool/nearest.hpp"
#include "tool/observation.hpp"
#include "transport/environment.hpp"

namespace lot::tool {
namespace {

using segment::kUnlimited;

constexpr std::array<std::string_view, 11> kVariables = {
    "LOT_SEGMENT", "LOT_DIR",   "LOT_SIZE",  "LOT_PERMISSIONS", "LOT_GROUP",    "LOT_USER",
    "LOT_PERSIST", "LOT_MLOCK", "LOT_QUEUE", "LOT_STAMP",       "LOT_FAST_LANE"};

/// Version 1 of control groups writes no limit as a number above this.
constexpr std::uint64_t kNoLimit = std::uint64_t{1} << 60;

// ---- files -------------------------------------------------------------------------------------

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

/// What stands behind `key` in the last line of the form "key: value" or "key=value".
std::string value_in(const std::string& text, const std::string& key) {
  std::istringstream lines(text);
  std::string found;
  for (std::string line; std::getline(lines, line);) {
    const auto begin = line.find_first_not_of(" \t");
    if (begin == line.npos || line.compare(begin, key.size(), key) != 0) continue;
    const auto sign = line.find_first_not_of(" \t", begin + key.size());
    if (sign == line.npos || (line[sign] != ':' && line[sign] != '=')) continue;
    const auto value = line.find_first_not_of(" \t", sign + 1);
    found = value == line.npos ? "" : line.substr(value);
  }
  return found;
}

/// A number of KiB in /proc/meminfo, in bytes.
std::uint64_t bytes_in(const std::string& meminfo, const std::string& key) {
  const std::string value = value_in(meminfo, key);
  if (value.empty()) return kUnlimited;
  return std::strtoull(value.c_str(), nullptr, 10) * 1024;
}

/// mountinfo writes a blank as \040.
std::string unescaped(const std::string& text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\\' && i + 3 < text.size()) {
      out += static_cast<char>(std::strtoul(text.substr(i + 1, 3).c_str(), nullptr, 8));
      i += 3;
    } else {
      out += text[i];
    }
  }
  return out;
}

bool is_below(const std::string& path, const std::string& directory) {
  return directory == "/" || path == directory ||
         path.compare(0, directory.size() + 1, directory + "/") == 0;
}

// ---- the kernel --------------------------------------------------------------------------------

/// `error` is what a call says that was given nonsense: a kernel that knows it complains of that.
Call judged(bool worked, int error) {
  if (worked || (error != ENOSYS && error != EPERM && error != EACCES)) return Call::Works;
  return error == ENOSYS ? Call::Missing : Call::Refused;
}

Call try_call(long number, long a = 0, long b = 0, long c = 0) {
  const long result = syscall(number, a, b, c, 0, 0);
  return judged(result != -1, errno);
}

Call try_membarrier() {
  const long known = syscall(SYS_membarrier, MEMBARRIER_CMD_QUERY, 0, 0);
  if (known == -1) return judged(false, errno);
  return (known & MEMBARRIER_CMD_PRIVATE_EXPEDITED) != 0 ? Call::Works : Call::Missing;
}

/// Takes a lock that no other thread knows.
Call try_lock_pi2() {
  constexpr int kLockPi2 = 13;
  std::uint32_t word = 0;
  const long result =
      syscall(SYS_futex, &word, kLockPi2 | FUTEX_PRIVATE_FLAG, 0, nullptr, nullptr, 0);
  return judged(result != -1, errno);
}

/// Of a length of 0 the kernel looks at the advice alone.
Call try_populate() {
  constexpr int kPopulateWrite = 23;
  if (madvise(nullptr, 0, kPopulateWrite) == 0) return Call::Works;
  return errno == EINVAL ? Call::Missing : judged(false, errno);
}

/// By a nameless file in memory.
void try_files(Machine& m) {
  const int file = memfd_create("lot doctor", MFD_CLOEXEC);
  if (file == -1) return;  // nothing is known: the calls may work
  const bool has_memory = fallocate(file, 0, 0, 4096) == 0;
  m.fallocate = judged(has_memory, errno);
  struct flock lock {};
  lock.l_type = F_WRLCK;
  const bool asked = fcntl(file, F_OFD_GETLK, &lock) == 0;
  m.file_locks = asked ? Call::Works : errno == EINVAL ? Call::Missing : judged(false, errno);
  close(file);
}

void ask_the_kernel(Machine& m) {
  utsname name{};
  if (uname(&name) == 0) m.release = name.release;
  constexpr long kFutexWaitv = 449;
  m.futex_waitv = try_call(kFutexWaitv);
  m.robust_list = try_call(SYS_set_robust_list);  // a length of 0 is EINVAL
  m.membarrier = try_membarrier();
  m.lock_pi2 = try_lock_pi2();
  m.populate = try_populate();
  try_files(m);
  m.page_bytes = static_cast<std::uint64_t>(getpagesize());
}

// ---- limits ------------------------------------------------------------------------------------

std::uint64_t limit_of(int resource) {
  rlimit limit{};
  if (getrlimit(static_cast<__rlimit_resource_t>(resource), &limit) == -1) return kUnlimited;
  return limit.rlim_cur == RLIM_INFINITY ? kUnlimited : std::uint64_t{limit.rlim_cur};
}

/// `status`: of this process in /proc.
bool is_in_pid_namespace(const std::string& root, const std::string& status) {
  std::istringstream pids(value_in(status, "NSpid"));  // one for each namespace, from that of /proc
  std::string first;
  std::string second;
  if (pids >> first >> second) return true;
  // Process 2 of the first namespace is a thread of the kernel, and no other namespace has it.
  return text_of(root + "/proc/2/comm") != "kthreadd\n";
}

/// How many threads the control group, and those above it, may still begin: the hierarchy that
/// version 2 has, or that of `pids` in version 1.
std::uint64_t threads_left(const std::string& root) {
  std::uint64_t least = kUnlimited;
  std::istringstream lines(text_of(root + "/proc/self/cgroup"));  // NUMBER:CONTROLLERS:GROUP
  for (std::string line; std::getline(lines, line);) {
    const auto first = line.find(':');
    const auto second = line.find(':', first + 1);
    if (second == line.npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    if (!controllers.empty() && controllers != "pids") continue;
    const std::string mount = root + "/sys/fs/cgroup" + (controllers.empty() ? "" : "/pids");
    std::string group = line.substr(second + 1);
    for (;; group.erase(group.rfind('/'))) {
      std::uint64_t most = 0;
      std::uint64_t now = 0;
      if (std::istringstream(text_of(mount + group + "/pids.max")) >> most &&
          std::istringstream(text_of(mount + group + "/pids.current")) >> now) {
        least = std::min(least, most > now ? most - now : 0);
      }
      if (group.find('/') == group.npos) break;
    }
  }
  return least;
}

void ask_for_limits(const std::string& root, Machine& m) {
  m.file_bytes = segment::file_limit();
  m.locked_bytes = limit_of(RLIMIT_MEMLOCK);
  m.address_bytes = limit_of(RLIMIT_AS);
  m.open_files = limit_of(RLIMIT_NOFILE);
  m.threads = limit_of(RLIMIT_NPROC);
  m.real_time_priority = limit_of(RLIMIT_RTPRIO);
  m.group_threads = threads_left(root);
  m.group_bytes = segment::memory_limit(root + "/proc/self/cgroup", root + "/sys/fs/cgroup");
  if (m.group_bytes > kNoLimit) m.group_bytes = kUnlimited;
  const std::string status = text_of(root + "/proc/self/status");
  const auto rights = std::strtoull(value_in(status, "CapEff").c_str(), nullptr, 16);
  constexpr unsigned kIpcLock = 14;
  constexpr unsigned kSysNice = 23;
  m.may_lock_memory = (rights >> kIpcLock & 1) != 0;
  m.may_be_real_time = (rights >> kSysNice & 1) != 0;
  m.has_proc = !status.empty();
  m.in_pid_namespace = m.has_proc && is_in_pid_namespace(root, status);
}

void ask_for_memory(const std::string& root, Machine& m) {
  const std::string memory = text_of(root + "/proc/meminfo");
  m.available_bytes = bytes_in(memory, "MemAvailable");
  m.is_strict = text_of(root + "/proc/sys/vm/overcommit_memory") == "2\n";
  const std::uint64_t limit = bytes_in(memory, "CommitLimit");
  const std::uint64_t used = bytes_in(memory, "Committed_AS");
  if (limit != kUnlimited && used != kUnlimited) m.commit_left = limit > used ? limit - used : 0;
  const std::string modes = text_of(root + "/sys/kernel/mm/transparent_hugepage/shmem_enabled");
  const auto begin = modes.find('[');  // "always within_size [never] deny"
  const auto end = modes.find(']');
  if (begin != modes.npos && end != modes.npos)
    m.huge_pages = modes.substr(begin + 1, end - begin - 1);
}

// ---- the directory -----------------------------------------------------------------------------

void look_at_directory(const std::string& root, Machine& m) {
  struct stat status {};
  if (::stat(m.directory.c_str(), &status) == -1) {
    m.directory_error = std::generic_category().message(errno);
    return;
  }
  if (!S_ISDIR(status.st_mode)) {
    m.directory_error = "it is no directory";
  } else if (access(m.directory.c_str(), R_OK | W_OK | X_OK) == -1) {
    m.directory_error = std::generic_category().message(errno);
  }
  m.strangers_may_remove = (status.st_mode & (S_IWOTH | S_ISVTX)) == S_IWOTH;
  struct statvfs room {};
  if (statvfs(m.directory.c_str(), &room) == 0) {
    m.total_bytes = std::uint64_t{room.f_blocks} * room.f_frsize;
    m.free_bytes = std::uint64_t{room.f_bavail} * room.f_frsize;
  }
  const std::unique_ptr<char, decltype(&std::free)> real(realpath(m.directory.c_str(), nullptr),
                                                         &std::free);
  if (real == nullptr) return;
  m.mount = mount_of(real.get(), text_of(root + "/proc/self/mountinfo"));
  const passwd* const user = getpwuid(geteuid());
  m.logind_removes = is_below(real.get(), "/dev/shm") && user != nullptr &&
                     logind_removes_ipc(root, user->pw_uid, user->pw_name);
}

SegmentSeen seen(Sight& sight, const std::string& root) {
  SegmentSeen s;
  s.name = sight.name;
  s.path = sight.path;
  s.condition = sight.condition;
  s.reason = sight.reason;
  s.taken = bytes_on_disk(sight.path);
  if (sight.window == nullptr) return s;
  s.bytes = sight.window->segment().size();
  s.living = living(*sight.window).size();
  s.dead = dead(*sight.window).size();
  s.has_items = !waiting(*sight.window).empty();
  for (const std::uint32_t k : living(*sight.window)) {
    const auto pid = detail::read_once(sight.window->segment().participants()[k].pid);
    s.hidden +=
        exists(root + "/proc/self") && !exists(root + "/proc/" + std::to_string(pid)) ? 1 : 0;
  }
  return s;
}

void look_at_segments(const Settings& settings, const std::string& root, Machine& m) {
  for (auto& sight : sights(settings.where)) {
    m.segments.push_back(seen(sight, root));
    m.segments.back().is_wanted = sight.name == m.segment;
  }
  m.obstacles = find_places(settings.where).obstacles;
  const std::string path = path_of(settings.where, m.segment);
  const std::string lock = path + ".lock";
  if (!exists(path) && exists(lock) && !settings.where.trust.owns(lock)) {
    m.obstacles.push_back({lock, "it belongs to " + segment::owner_and_mode(lock)});
  }
}

}  // namespace

Mount mount_of(const std::string& directory, const std::string& mountinfo) {
  Mount best;
  std::istringstream lines(mountinfo);
  for (std::string line; std::getline(lines, line);) {
    // ID PARENT DEVICE ROOT POINT OPTIONS [FIELD...] - TYPE SOURCE OPTIONS
    std::istringstream words(line);
    std::string word;
    Mount mount;
    for (int n = 0; n < 5 && words >> word; ++n) mount.point = unescaped(word);
    while (words >> word && word != "-") {
    }
    std::string source;
    if (!(words >> mount.type >> source >> mount.options)) continue;
    // A later mount hides an earlier one at the same place.
    if (is_below(directory, mount.point) && mount.point.size() >= best.point.size()) best = mount;
  }
  return best;
}

std::vector<std::string> misspelt_of(const std::vector<std::string>& names) {
  std::vector<std::string> found;
  for (const auto& name : names) {
    const auto far = [&](std::string_view variable) { return letters_apart(name, variable); };
    const auto nearest = std::ranges::min_element(kVariables, {}, far);
    const std::size_t apart = far(*nearest);
    if (apart != 0 && apart <= 2) found.push_back(name + ": " + std::string(*nearest));
  }
  return found;
}

bool logind_removes_ipc(const std::string& root, unsigned user, const std::string& user_name) {
  constexpr unsigned kFirstOrdinary = 1000;
  if (user < kFirstOrdinary || !exists(root + "/run/systemd/seats"))
    return false;  // logind makes it
  if (exists(root + "/var/lib/systemd/linger/" + user_name)) return false;
  std::string text = text_of(root + "/etc/systemd/logind.conf") + "\n";
  std::error_code error;
  std::set<std::string> more;  // in the order of their names, after the file
  for (const auto& file :
       std::filesystem::directory_iterator(root + "/etc/systemd/logind.conf.d", error)) {
    if (file.path().extension() == ".conf") more.insert(file.path());
  }
  for (const auto& file : more) text += text_of(file) + "\n";
  const std::string says = value_in(text, "RemoveIPC");
  return says != "no" && says != "false" && says != "0" && says != "off";
}

Machine look_at_machine(const Settings& settings, const std::string& root) {
  Machine m;
  m.directory = settings.where.directory;
  m.segment = settings.where.name.empty() ? EngineOptions().segment : settings.where.name;
  Settings mine = settings;
  try {
    const EngineOptions options = transport::with_environment(EngineOptions());
    m.wanted_bytes = options.size_bytes;
    m.locks_memory = options.lock_memory;
    (void)segment::path_of(m.directory, m.segment);  // a name that no segment can have throws
    mine.where.trust = transport::trust_of_environment();
    (void)transport::queue_engine({});  // these three are for publishers
    (void)transport::stamps(false);
    (void)transport::fast_lane(false);
  } catch (const Error& e) {
    m.bad_options = e.what();
  }
  std::vector<std::string> names;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string_view text(*entry);
    names.emplace_back(text.substr(0, text.find('=')));
  }
  m.misspelt = misspelt_of(names);
  m.is_root = geteuid() == 0;
  ask_the_kernel(m);
  ask_for_limits(root, m);
  ask_for_memory(root, m);
  look_at_directory(root, m);
  if (m.directory_error.empty()) look_at_segments(mine, root, m);
  return m;
}

}  // namespace lot::tool
