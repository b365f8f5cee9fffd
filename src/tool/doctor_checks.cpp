// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <string_view>

#include "segment/layout.hpp"
#include "tool/doctor.hpp"
#include "tool/report.hpp"
#include "tool/text.hpp"

namespace lot::tool {
namespace {

using Verdict = Finding::Verdict;
using segment::kUnlimited;

constexpr std::uint64_t kMiB = std::uint64_t{1} << 20;
constexpr std::uint64_t kDefaultSize = 1024 * kMiB;
/// With the default tables a segment has no less.
constexpr std::uint64_t kLeastSize = 16 * kMiB;
/// A default segment below this has no room for a queue of frames.
constexpr std::uint64_t kSmall = 256 * kMiB;
constexpr std::uint64_t kFewFiles = 64;
constexpr std::uint64_t kFewThreads = 64;
constexpr std::size_t kMostSegments = 20;

std::string limit_text(std::uint64_t bytes) {
  return bytes == kUnlimited ? "any amount" : bytes_text(bytes);
}

Finding ok(std::string check, std::string seen, std::string better = "") {
  return {std::move(check), Verdict::Ok, std::move(seen), "", std::move(better)};
}

/// The size that a new segment gets where LOT_SIZE says none.
std::uint64_t default_size(const Machine& m) {
  const std::uint64_t of_the_group = m.group_bytes == kUnlimited ? kUnlimited : m.group_bytes / 2;
  return std::min({kDefaultSize, m.free_bytes / 4 * 3, m.file_bytes, of_the_group});
}

Finding environment(const Machine& m) {
  std::string unread, question;
  for (const std::string& pair : m.misspelt) {
    const auto colon = pair.find(": ");
    unread += (unread.empty() ? "" : ", ") + pair.substr(0, colon);
    question += (question.empty() ? "did you mean " : ", ") + pair.substr(colon + 2);
  }
  if (!unread.empty()) {
    unread += m.misspelt.size() == 1 ? " is set" : " are set";
    question += "?";
  }
  if (!m.bad_options.empty()) {
    return {"environment", Verdict::Problem,
            m.bad_options + (unread.empty() ? "" : "; and " + unread + ", which LOT does not read"),
            "No process can join with it.",
            "correct the variable, or unset it" + (unread.empty() ? "" : "; " + question)};
  }
  if (!unread.empty()) {
    return {"environment", Verdict::Warning, unread, "LOT reads no such variable.", question};
  }
  return ok("environment", "the LOT_ variables can be read");
}

Finding directory(const Machine& m) {
  if (!m.directory_error.empty()) {
    return {"directory", Verdict::Problem, m.directory + ": " + m.directory_error,
            "No process can make or join a segment there.",
            "make it (`mkdir -p " + m.directory +
                "`), give this user all rights there, or name another by LOT_DIR"};
  }
  if (m.strangers_may_remove) {
    return {"directory", Verdict::Warning,
            m.directory + " lets every user write, and has no sticky bit",
            "Any user can remove or replace your segments.", "`chmod +t " + m.directory + "`"};
  }
  return ok("directory", m.directory + " can be used");
}

Finding file_system(const Machine& m) {
  static constexpr std::array<std::string_view, 4> kDisks = {"ext4", "xfs", "btrfs", "f2fs"};
  const std::string seen =
      m.directory + " is " +
      (m.mount.type.empty() ? "of a file system that /proc does not name" : m.mount.type) +
      (m.mount.point.empty() ? "" : ", mounted at " + m.mount.point);
  const std::string another = "`mount -t tmpfs -o size=2G lot /mnt/lot`, and LOT_DIR=/mnt/lot";
  if (m.mount.type == "tmpfs") return ok("file_system", seen);
  if (m.mount.type.empty())
    return {"file_system", Verdict::Warning, seen, "LOT is made for a tmpfs.", another};
  if (std::find(kDisks.begin(), kDisks.end(), m.mount.type) != kDisks.end()) {
    return {"file_system", Verdict::Warning, seen,
            "The kernel writes messages to the disk, which takes time from it and from readers.",
            another};
  }
  if (m.mount.type == "overlay") {
    return {"file_system", Verdict::Warning, seen,
            "This is the layer of one container: processes of other containers do not meet there.",
            "share a tmpfs: `docker run --tmpfs` or `--ipc=host`, and LOT_DIR"};
  }
  return {"file_system", Verdict::Problem, seen,
          "Nothing shows that LOT works there: it needs shared memory, locks of open file "
          "descriptions and memory that "
          "goes back.",
          another};
}

Finding space(const Machine& m) {
  const std::string seen =
      bytes_text(m.free_bytes) + " of " + bytes_text(m.total_bytes) + " are free in " + m.directory;
  const std::string larger = "`mount -o remount,size=2G " +
                             (m.mount.point.empty() ? m.directory : m.mount.point) +
                             "`; in a container: `docker run --shm-size=2g`; or LOT_DIR";
  if (m.wanted_bytes > m.free_bytes) {
    return {"space", Verdict::Problem,
            seen + ", and LOT_SIZE asks for " + bytes_text(m.wanted_bytes),
            "A new segment can not be made (ENOSPC).", "lower LOT_SIZE, or " + larger};
  }
  const std::uint64_t size = m.wanted_bytes != 0 ? m.wanted_bytes : m.free_bytes / 4 * 3;
  if (size < kLeastSize) {
    return {"space", Verdict::Problem, seen,
            "A new segment needs at least 16 MiB, and takes three quarters of what is free.",
            "`lot clean`; or " + larger};
  }
  if (m.wanted_bytes == 0 && size < kSmall) {
    return {"space", Verdict::Warning, seen,
            "A new segment gets " + bytes_text(size) + ": few large messages fit.", larger};
  }
  return ok("space", seen);
}

/// Segments grow as messages need memory. Then the file system, or the machine, may have none left.
Finding promised(const Machine& m) {
  std::uint64_t more = 0;
  for (const auto& s : m.segments) {
    if (s.condition == Sight::Condition::Sound && s.bytes > s.taken) more += s.bytes - s.taken;
  }
  const std::string seen = "the segments here may take " + bytes_text(more) + " more";
  if (more > m.free_bytes) {
    return {"promised", Verdict::Warning,
            seen + ", and " + bytes_text(m.free_bytes) + " are free in " + m.directory,
            "Loans will throw OutOfMemory before a segment is full.",
            "`lot clean`, a smaller LOT_SIZE, or a larger file system"};
  }
  if (more > m.available_bytes) {
    return {"promised", Verdict::Warning,
            seen + ", and the machine has " + bytes_text(m.available_bytes) + " available",
            "The kernel will swap, or end processes.", "set a smaller LOT_SIZE"};
  }
  return ok("promised", seen);
}

Finding memory(const Machine& m) {
  if (m.is_strict && m.commit_left < kDefaultSize) {
    return {
        "memory", Verdict::Warning,
        "vm.overcommit_memory is 2, and " + bytes_text(m.commit_left) + " can still be promised",
        "A message may find no memory while the machine has some.",
        "`sysctl vm.overcommit_memory=0`, or raise vm.overcommit_ratio"};
  }
  if (m.available_bytes != kUnlimited && m.available_bytes < kSmall) {
    return {"memory", Verdict::Warning, bytes_text(m.available_bytes) + " are available",
            "The kernel may end processes when segments grow.",
            "end what needs memory, or set a smaller LOT_SIZE"};
  }
  return ok("memory", m.available_bytes == kUnlimited
                          ? "/proc does not say what is available"
                          : bytes_text(m.available_bytes) + " are available");
}

Finding memory_group(const Machine& m) {
  if (m.group_bytes == kUnlimited)
    return ok("memory_group", "the control group has no limit of memory");
  const std::string seen = "the control group may have " + bytes_text(m.group_bytes);
  const std::uint64_t size = m.group_bytes / 2;
  if (m.wanted_bytes > m.group_bytes) {
    return {"memory_group", Verdict::Warning,
            seen + ", and LOT_SIZE asks for " + bytes_text(m.wanted_bytes),
            "The kernel ends processes of the group when the segment grows.",
            "lower LOT_SIZE, or raise the limit (`docker run --memory`, MemoryMax=)"};
  }
  if (m.wanted_bytes == 0 && size < kSmall) {
    return {"memory_group", Verdict::Warning, seen,
            "A new segment gets at most half of it, " + bytes_text(size) + ".",
            "raise the limit (`docker run --memory`, MemoryMax=), or set LOT_SIZE"};
  }
  return ok("memory_group", seen);
}

Finding file_size(const Machine& m) {
  const std::string seen = "a process may write files of " +
                           (m.file_bytes == kUnlimited ? "any size" : bytes_text(m.file_bytes));
  if (m.wanted_bytes > m.file_bytes) {
    return {"file_size", Verdict::Problem,
            seen + ", and LOT_SIZE asks for " + bytes_text(m.wanted_bytes),
            "A new segment can not be made (EFBIG).", "`ulimit -f unlimited`, or lower LOT_SIZE"};
  }
  if (m.wanted_bytes == 0 && m.file_bytes < kDefaultSize) {
    return {"file_size", Verdict::Warning, seen, "A new segment is no larger.",
            "`ulimit -f unlimited`"};
  }
  return ok("file_size", seen);
}

Finding address_space(const Machine& m) {
  const std::string seen = "a process may map " + limit_text(m.address_bytes);
  const std::uint64_t size = m.wanted_bytes != 0 ? m.wanted_bytes : default_size(m);
  if (m.address_bytes != kUnlimited && m.address_bytes < size + kSmall) {
    return {"address_space", Verdict::Problem, seen,
            "A segment of " + bytes_text(size) + " can not be mapped (ENOMEM).",
            "`ulimit -v unlimited`, or lower LOT_SIZE"};
  }
  return ok("address_space", seen);
}

Finding open_files(const Machine& m) {
  const std::string seen =
      "a process may have " +
      (m.open_files == kUnlimited ? "any number of" : std::to_string(m.open_files)) + " open files";
  if (m.open_files < kFewFiles) {
    return {"open_files", Verdict::Warning, seen, "A process that joins may get EMFILE.",
            "`ulimit -n 1024`"};
  }
  return ok("open_files", seen);
}

Finding threads(const Machine& m) {
  const std::string means = "Each process of LOT has two more than its own: joining may be EAGAIN.";
  if (m.group_threads < kFewThreads) {
    return {"threads", Verdict::Warning,
            "the control group may begin " + std::to_string(m.group_threads) + " more threads",
            means, "raise its limit (`docker run --pids-limit`, TasksMax=)"};
  }
  const std::string seen = "a user may have " +
                           (m.threads == kUnlimited ? "any number of" : std::to_string(m.threads)) +
                           " threads";
  if (m.threads < kFewThreads && !m.is_root) {
    return {"threads", Verdict::Warning, seen, means,
            "`ulimit -u 4096`, or raise nproc in /etc/security/limits.conf"};
  }
  return ok("threads", seen);
}

Finding locked_memory(const Machine& m) {
  const std::string seen = m.may_lock_memory ? "a process may lock all memory"
                                             : "a process may lock " + limit_text(m.locked_bytes);
  const std::uint64_t size = m.wanted_bytes != 0 ? m.wanted_bytes : default_size(m);
  const std::string raise = "`ulimit -l " + std::to_string(size / 1024) +
                            "`, memlock in /etc/security/limits.conf, or LimitMEMLOCK=";
  if (m.may_lock_memory || m.locked_bytes >= size) return ok("locked_memory", seen);
  if (m.locks_memory) {
    return {"locked_memory", Verdict::Problem, seen + ", and LOT_MLOCK is set",
            "A segment of " + bytes_text(size) + " can not be locked.", raise};
  }
  return ok("locked_memory", seen, "for LOT_MLOCK=1: " + raise);
}

Finding real_time(const Machine& m) {
  if (m.may_be_real_time) return ok("real_time", "a thread may have any priority");
  if (m.real_time_priority != 0) {
    return ok("real_time",
              "a thread may have a real-time priority of " + std::to_string(m.real_time_priority));
  }
  return ok("real_time", "a thread may not have a real-time priority",
            "for ThreadOptions::priority: rtprio in /etc/security/limits.conf, or LimitRTPRIO=");
}

/// A system call whose absence LOT bears.
Finding call(const char* check, const char* name, Call how, const char* since, const char* means) {
  if (how == Call::Works) return ok(check, std::string(name) + " works");
  const bool refused = how == Call::Refused;
  return {check, Verdict::Warning, std::string(name) + (refused ? " is refused" : " is missing"),
          means,
          refused ? "allow it in the sandbox (seccomp, SystemCallFilter=)"
                  : std::string("a kernel from Linux ") + since + ", and a sandbox that allows it"};
}

Finding file_locks(const Machine& m) {
  if (m.file_locks == Call::Works) return ok("file_locks", "locks of open file descriptions work");
  return {"file_locks", Verdict::Problem, "locks of open file descriptions are missing",
          "LOT can not say which processes live.",
          "a kernel from Linux 3.15, and a sandbox that allows fcntl"};
}

Finding new_memory(const Machine& m) {
  if (m.populate == Call::Works) return ok("new_memory", "madvise(MADV_POPULATE_WRITE) works");
  if (m.fallocate != Call::Works) {
    return {"new_memory", Verdict::Problem, "madvise and fallocate are refused",
            "No message gets new memory: loans throw OutOfMemory.",
            "allow one of them in the sandbox"};
  }
  return {"new_memory", Verdict::Warning, "madvise(MADV_POPULATE_WRITE) is missing or refused",
          "First messages cost more: LOT touches new memory page by page.",
          "a kernel from Linux 5.14, and a sandbox that allows it"};
}

Finding page_size(const Machine& m) {
  const std::string seen = "a page has " + bytes_text(m.page_bytes);
  if (m.page_bytes == segment::kGranule) return ok("page_size", seen);
  return {"page_size", Verdict::Warning, seen, "LOT is tested with pages of 4 KiB alone.",
          "a kernel with pages of 4 KiB"};
}

Finding huge_pages(const Machine& m) {
  const auto has = [&](const char* option) {
    return ("," + m.mount.options + ",").find(std::string(",huge=") + option + ",") !=
           std::string::npos;
  };
  const bool mounted = has("always") || has("within_size") || has("advise");
  if (m.huge_pages == "force" || (mounted && m.huge_pages != "deny" && !m.huge_pages.empty())) {
    return ok("huge_pages", m.directory + " gives huge pages");
  }
  if (m.mount.type != "tmpfs") return ok("huge_pages", m.mount.type + " gives no huge pages");
  if (m.huge_pages.empty())
    return ok("huge_pages", "the kernel has no huge pages for shared memory");
  return ok("huge_pages", m.directory + " gives no huge pages",
            "for faster first messages: `mount -o remount,huge=advise " +
                (m.mount.point.empty() ? m.directory : m.mount.point) + "`" +
                (m.huge_pages == "deny"
                     ? ", and `echo advise > /sys/kernel/mm/transparent_hugepage/shmem_enabled`"
                     : ""));
}

Finding proc(const Machine& m) {
  if (m.has_proc) return ok("proc", "/proc shows processes");
  return {"proc", Verdict::Warning, "/proc is not mounted",
          "Errors and `lot` can not name a process that is stopped; waits for it are longer.",
          "`mount -t proc proc /proc`"};
}

Finding containers(const Machine& m) {
  std::size_t hidden = 0;
  for (const auto& s : m.segments) hidden += s.hidden;
  const std::string where = m.in_pid_namespace ? "this is a PID namespace of its own (a container)"
                                               : "this is the first PID namespace";
  if (hidden == 0) return ok("containers", where);
  return ok("containers",
            where + "; " + plural(hidden, "process lives", "processes live") + " in another",
            "their pids in `lot ls` are those of their own namespace");
}

Finding logind(const Machine& m) {
  if (!m.logind_removes) return ok("logind", "no session's end removes files here");
  return {"logind", Verdict::Warning,
          "logind removes this user's files in /dev/shm when the last session ends (RemoveIPC)",
          "Processes that go on then lose their segment to newcomers.",
          "`loginctl enable-linger`, RemoveIPC=no in /etc/systemd/logind.conf, or LOT_DIR"};
}

Finding other_file(const Places::Obstacle& o) {
  return {"other_file", Verdict::Problem, o.path + ": " + o.what,
          "It lies in the place of a segment's file: no process can join.",
          "remove it if it is yours, or use another name (LOT_SEGMENT)"};
}

Finding untrusted(const SegmentSeen& s) {
  if (!s.is_wanted) return ok("segment", s.path + " is another user's, or open to others");
  return {"segment", Verdict::Problem, s.path + ": " + s.reason,
          "A process with these variables can not join.",
          "use another name (LOT_SEGMENT), or set LOT_GROUP, LOT_USER or LOT_PERMISSIONS if you "
          "trust its users"};
}

Finding not_sound(const SegmentSeen& s) {
  const std::string clean = "end all that use it, and " + command("clean", s.path);
  switch (s.condition) {
    case Sight::Condition::OtherBoot:
      return {"segment", Verdict::Warning, s.path + " is of another boot",
              "Nothing uses it, and it takes memory.", command("clean", s.path)};
    case Sight::Condition::Unreadable:
      return {"segment", s.is_wanted ? Verdict::Problem : Verdict::Warning,
              s.path + ": " + s.reason, "It can not be looked into.",
              "look as its owner, or as root"};
    case Sight::Condition::Untrusted:
      return untrusted(s);
    default:
      return {"segment", s.is_wanted ? Verdict::Problem : Verdict::Warning,
              s.path + ": " + s.reason,
              "This lot has layout " + std::to_string(segment::kLayoutVersion) +
                  ". Programs of another version, or a damaged segment, do not meet.",
              "use one version of LOT in all programs; else " + clean};
  }
}

Finding segment_of(const SegmentSeen& s) {
  if (s.condition != Sight::Condition::Sound) return not_sound(s);
  if (s.living == 0 && s.has_items) {
    return {"segment", Verdict::Warning, s.path + ": no process lives in it, and items wait there",
            "They wait for a process that takes them.",
            "start it, or drop them by " + command("clean --with-items", s.path)};
  }
  if (s.living == 0) {
    return {"segment", Verdict::Warning, s.path + ": no process lives in it",
            "It takes " + bytes_text(s.taken) + " of memory.", command("clean", s.path)};
  }
  if (s.dead != 0) {
    return {
        "segment", Verdict::Warning,
        s.path + ": " + plural(s.dead, "process is dead", "processes are dead") + " and not reaped",
        "What they had is not free.", command("clean", s.path)};
  }
  return ok("segment", s.path + ": " + plural(s.living, "process", "processes") + ", layout " +
                           std::to_string(segment::kLayoutVersion));
}

void add_segments(const Machine& m, std::vector<Finding>& all) {
  for (const auto& obstacle : m.obstacles) all.push_back(other_file(obstacle));
  const std::size_t n = std::min(m.segments.size(), kMostSegments);
  for (std::size_t i = 0; i < n; ++i) all.push_back(segment_of(m.segments[i]));
  if (n < m.segments.size()) {
    all.push_back(ok("segment", std::to_string(m.segments.size() - n) + " more: `lot ls`"));
  }
}

}  // namespace

const char* to_string(Verdict verdict) {
  return verdict == Verdict::Ok ? "ok" : verdict == Verdict::Warning ? "warning" : "problem";
}

std::vector<Finding> diagnose(const Machine& m) {
  std::vector<Finding> all;
  all.push_back(ok("version", "lot " LOT_VERSION ", layout " +
                                  std::to_string(segment::kLayoutVersion) + ", on Linux " +
                                  m.release));
  all.push_back(environment(m));
  all.push_back(directory(m));
  if (m.directory_error.empty()) {
    for (const auto check : {file_system, space, promised, huge_pages, logind})
      all.push_back(check(m));
    add_segments(m, all);
  }
  for (const auto check : {memory, memory_group, file_size, address_space, open_files, threads,
                           locked_memory, real_time, page_size, file_locks}) {
    all.push_back(check(m));
  }
  all.push_back(call("robust_list", "set_robust_list", m.robust_list, "2.6.17",
                     "The lock file alone says which processes live."));
  all.push_back(call("futex_waitv", "futex_waitv", m.futex_waitv, "5.16",
                     "A reader of several publishers looks every 2 ms instead of sleeping."));
  all.push_back(call("lock_pi2", "FUTEX_LOCK_PI2", m.lock_pi2, "5.14",
                     "Threads that share a publisher lend each other no priority."));
  all.push_back(call("membarrier", "membarrier", m.membarrier, "4.14",
                     "Each push and pull costs some more instructions."));
  all.push_back(new_memory(m));
  all.push_back(proc(m));
  all.push_back(containers(m));
  return all;
}

}  // namespace lot::tool
