// SPDX-License-Identifier: Apache-2.0

// What each check of `lot doctor` says, at each bound, on machines that the test makes up.

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include <doctest/doctest.h>
#include <fnmatch.h>

#include "machines.hpp"
#include "segment/layout.hpp"
#include "tool/doctor.hpp"

namespace {

using namespace lot::testing;
namespace tool = lot::tool;
using lot::segment::kUnlimited;
using tool::Call;
using tool::Machine;
using Condition = tool::Sight::Condition;

/// "ok|seen|means|advice"
std::string text_of(const tool::Finding& f) {
  return std::string(tool::to_string(f.verdict)) + "|" + f.seen + "|" + f.means + "|" + f.advice;
}

/// What the checks of this name say.
std::string said(const Machine& m, const std::string& check) {
  std::string all;
  for (const auto& finding : tool::diagnose(m)) {
    if (finding.check == check) all += (all.empty() ? "" : "\n") + text_of(finding);
  }
  return all;
}

/// A change of a good machine, and the finding then. `*` stands for a sentence that is always the
/// same, LAYOUT for the number of the layout.
struct Case {
  std::function<void(Machine&)> change;
  const char* says;
};
#define LOT_ON(...) []([[maybe_unused]] Machine& m) { __VA_ARGS__; }

void check_cases(const std::string& check, const std::vector<Case>& cases) {
  for (std::size_t n = 0; n < cases.size(); ++n) {
    CAPTURE(check);
    CAPTURE(n);
    Machine m = good();
    m.segments.front().path = "/dev/shm/absent";
    cases[n].change(m);
    const std::string says = said(m, check);
    CAPTURE(says);
    std::string expected = cases[n].says;
    if (const auto layout = expected.find("LAYOUT"); layout != expected.npos) {
      expected.replace(layout, 6, std::to_string(lot::segment::kLayoutVersion));
    }
    CAPTURE(expected);
    CHECK(fnmatch(expected.c_str(), says.c_str(), FNM_NOESCAPE) == 0);
  }
}

tool::SegmentSeen& first(Machine& m) { return m.segments.front(); }

}  // namespace

TEST_SUITE_BEGIN("doctor_checks");

TEST_CASE("lot doctor's checks have an order; without a directory there are none of it") {
  const auto names = [](const Machine& m) {
    std::string all;
    for (const auto& finding : tool::diagnose(m)) all += finding.check + " ";
    return all;
  };
  Machine m = good();
  const std::string rest =
      "memory memory_group file_size address_space open_files threads locked_memory real_time "
      "page_size file_locks robust_list futex_waitv lock_pi2 membarrier new_memory proc "
      "containers ";
  CHECK(names(m) ==
        "version environment directory file_system space promised huge_pages logind segment " +
            rest);
  m.obstacles = {{"/dev/shm/x", "it is a directory"}};
  m.segments.resize(2);
  CHECK(names(m) ==
        "version environment directory file_system space promised huge_pages logind other_file "
        "segment segment " +
            rest);
  m.directory_error = "gone";
  CHECK(names(m) == "version environment directory " + rest);
}

TEST_CASE("lot doctor on variables of the environment") {
  check_cases(
      "environment",
      {{LOT_ON(), "ok|the LOT_ variables can be read||"},
       {LOT_ON(m.misspelt = {"LOT_DIRS: LOT_DIR"}),
        "warning|LOT_DIRS is set|LOT reads no such variable.|did you mean LOT_DIR?"},
       {LOT_ON(m.misspelt = {"LOT_DIRS: LOT_DIR", "LOT_SIZ: LOT_SIZE"}),
        "warning|LOT_DIRS, LOT_SIZ are set|*|did you mean LOT_DIR, LOT_SIZE?"},
       {LOT_ON(m.bad_options = "LOT_SIZE=x"),
        "problem|LOT_SIZE=x|No process can join with it.|correct the variable, or unset it"},
       {LOT_ON(m.bad_options = "LOT_SIZE=x"; m.misspelt = {"LOT_DIRS: LOT_DIR"}),
        "problem|LOT_SIZE=x; and LOT_DIRS is set, which LOT does not read|*|"
        "correct the variable, or unset it; did you mean LOT_DIR?"}});
  check_cases("version", {{LOT_ON(), "ok|lot *, layout LAYOUT, on Linux 6.1.0||"}});
}

TEST_CASE("lot doctor on the directory and its file system") {
  check_cases(
      "directory",
      {{LOT_ON(), "ok|/dev/shm can be used||"},
       {LOT_ON(m.directory_error = "No such file"; m.strangers_may_remove = true),
        "problem|/dev/shm: No such file|*|make it (`mkdir -p /dev/shm`), *"},
       {LOT_ON(m.strangers_may_remove = true),
        "warning|/dev/shm lets every user write, and has no sticky bit|*|`chmod +t /dev/shm`"}});
  check_cases(
      "file_system",
      {{LOT_ON(), "ok|/dev/shm is tmpfs, mounted at /dev/shm||"},
       {LOT_ON(m.mount.point = ""), "ok|/dev/shm is tmpfs||"},
       {LOT_ON(m.mount = {}),
        "warning|/dev/shm is of a file system that /proc does not name|LOT is made for *|*"},
       {LOT_ON(m.mount.type = "f2fs"), "warning|*f2fs, mounted *|The kernel writes messages *|*"},
       {LOT_ON(m.mount.type = "ext4"), "warning|*ext4, mounted *|The kernel writes messages *|*"},
       {LOT_ON(m.mount.type = "overlay"), "warning|*|This is the layer *|share a tmpfs: *"},
       {LOT_ON(m.mount.type = "nfs"),
        "problem|*nfs, mounted *|Nothing shows *|`mount -t tmpfs *"}});
  check_cases("logind", {{LOT_ON(), "ok|no session's end removes files here||"},
                         {LOT_ON(m.logind_removes = true), "warning|logind removes *|*|*"}});
}

TEST_CASE("lot doctor on the room of the file system") {
  check_cases(
      "space",
      {{LOT_ON(), "ok|4 GiB of 8 GiB are free in /dev/shm||"},
       {LOT_ON(m.wanted_bytes = m.free_bytes), "ok|4 GiB of 8 GiB are free in /dev/shm||"},
       {LOT_ON(m.wanted_bytes = m.free_bytes + 4096 * kMiB),
        "problem|4 GiB of 8 GiB are free in /dev/shm, and LOT_SIZE asks for 8 GiB|*(ENOSPC).|"
        "lower LOT_SIZE, or `mount -o remount,size=2G /dev/shm`; *"},
       {LOT_ON(m.wanted_bytes = m.free_bytes + 1), "problem|*asks for 4.0 GiB|*|*"},
       {LOT_ON(m.wanted_bytes = 16 * kMiB), "ok|*"},
       {LOT_ON(m.wanted_bytes = 16 * kMiB - 1),
        "problem|4 GiB of 8 GiB *|A new segment needs at least 16 MiB, *|`lot clean`; or `mount *"},
       {LOT_ON(m.free_bytes = 22369620; m.mount.point = ""),
        "problem|21 MiB of 8 GiB *|*|*size=2G /dev/shm`; *"},
       {LOT_ON(m.free_bytes = 22369624; m.mount.point = "/dev"),
        "warning|21 MiB of 8 GiB *|A new segment gets 16 MiB: few *|*size=2G /dev`; *"},
       {LOT_ON(m.free_bytes = 357913943),  // three quarters of it are a byte below 256 MiB
        "warning|341 MiB of 8 GiB *|A new segment gets 256 MiB: *|*"},
       {LOT_ON(m.free_bytes = 357913944), "ok|341 MiB of 8 GiB *"}});
  check_cases(
      "promised",
      {{LOT_ON(), "ok|the segments here may take 960 MiB more||"},
       {LOT_ON(m.free_bytes = m.available_bytes = 960 * kMiB), "ok|*960 MiB more||"},
       {LOT_ON(m.free_bytes = 960 * kMiB - 4096),
        "warning|*960 MiB more, and 960 MiB are free in /dev/shm|Loans will *|*"},
       {LOT_ON(m.available_bytes = 960 * kMiB - 4096),
        "warning|*960 MiB more, and the machine has 960 MiB available|The kernel *|*"},
       {LOT_ON(m.segments.push_back(first(m))), "ok|the segments here may take 1.9 GiB more||"},
       {LOT_ON(m.segments.push_back(first(m)); m.segments[1].condition = Condition::Damaged),
        "ok|*take 960 MiB more||"},
       {LOT_ON(m.segments.push_back(first(m)); m.segments[1].taken = 1025 * kMiB),
        "ok|*take 960 MiB more||"}});
}

TEST_CASE("lot doctor on memory") {
  check_cases(
      "memory",
      {{LOT_ON(), "ok|8 GiB are available||"},
       {LOT_ON(m.available_bytes = kUnlimited), "ok|/proc does not say what is available||"},
       {LOT_ON(m.available_bytes = 256 * kMiB), "ok|256 MiB are available||"},
       {LOT_ON(m.available_bytes = 256 * kMiB - 1), "warning|256 MiB are available|*|end *"},
       {LOT_ON(m.is_strict = true; m.commit_left = 1024 * kMiB), "ok|8 GiB are available||"},
       {LOT_ON(m.commit_left = 0), "ok|8 GiB are available||"},
       {LOT_ON(m.is_strict = true; m.commit_left = 1024 * kMiB - 1),
        "warning|vm.overcommit_memory is 2, and 1.0 GiB can still be promised|*|`sysctl *"}});
  check_cases(
      "memory_group",
      {{LOT_ON(), "ok|the control group has no limit of memory||"},
       {LOT_ON(m.group_bytes = 512 * kMiB), "ok|the control group may have 512 MiB||"},
       {LOT_ON(m.group_bytes = 510 * kMiB),
        "warning|the control group may have 510 MiB|*at most half of it, 255 MiB.|raise *"},
       {LOT_ON(m.group_bytes = 512 * kMiB - 1), "warning|*|*at most half of it, 256 MiB.|*"},
       {LOT_ON(m.group_bytes = m.wanted_bytes = 100 * kMiB), "ok|*may have 100 MiB||"},
       {LOT_ON(m.group_bytes = 512 * kMiB; m.wanted_bytes = 513 * kMiB),
        "warning|*may have 512 MiB, and LOT_SIZE asks for 513 MiB|*|lower LOT_SIZE, or *"}});
  check_cases("page_size", {{LOT_ON(), "ok|a page has 4 KiB||"},
                            {LOT_ON(m.page_bytes = 65536), "warning|a page has 64 KiB|*|*"}});
}

TEST_CASE("lot doctor on limits of sizes: files, addresses, locked memory") {
  check_cases("file_size",
              {{LOT_ON(), "ok|a process may write files of any size||"},
               {LOT_ON(m.file_bytes = 1024 * kMiB), "ok|a process may write files of 1 GiB||"},
               {LOT_ON(m.file_bytes = 1023 * kMiB),
                "warning|a process may write files of 1023 MiB|A new segment is no larger.|*"},
               {LOT_ON(m.file_bytes = 1024 * kMiB - 1), "warning|*"},
               {LOT_ON(m.file_bytes = m.wanted_bytes = 100 * kMiB), "ok|*100 MiB||"},
               {LOT_ON(m.file_bytes = 100 * kMiB; m.wanted_bytes = 101 * kMiB),
                "problem|*100 MiB, and LOT_SIZE asks for 101 MiB|*(EFBIG).|*"}});
  check_cases(
      "address_space",
      {{LOT_ON(), "ok|a process may map any amount||"},
       {LOT_ON(m.address_bytes = 1280 * kMiB), "ok|a process may map 1.2 GiB||"},
       {LOT_ON(m.address_bytes = 1280 * kMiB - 1),
        "problem|a process may map 1.2 GiB|A segment of 1 GiB can not be mapped (ENOMEM).|*"},
       {LOT_ON(m.address_bytes = 300 * kMiB; m.free_bytes = 64 * kMiB),
        "problem|*300 MiB|A segment of 48 MiB can *|*"},
       {LOT_ON(m.address_bytes = 300 * kMiB; m.file_bytes = 50 * kMiB),
        "problem|*300 MiB|A segment of 50 MiB can *|*"},
       {LOT_ON(m.address_bytes = 300 * kMiB; m.group_bytes = 90 * kMiB),
        "problem|*300 MiB|A segment of 45 MiB can *|*"},
       {LOT_ON(m.address_bytes = 300 * kMiB; m.wanted_bytes = 44 * kMiB), "ok|*300 MiB||"},
       {LOT_ON(m.address_bytes = 300 * kMiB; m.wanted_bytes = 45 * kMiB),
        "problem|*300 MiB|A segment of 45 MiB can *|*"}});
  const char* const raise = "`ulimit -l 1048576`, memlock in *";
  const std::string better = std::string("for LOT_MLOCK=1: ") + raise;
  check_cases(
      "locked_memory",
      {{LOT_ON(), "ok|a process may lock any amount||"},
       {LOT_ON(m.locked_bytes = 0; m.may_lock_memory = true), "ok|a process may lock all memory||"},
       {LOT_ON(m.locked_bytes = 1024 * kMiB), "ok|a process may lock 1 GiB||"},
       {LOT_ON(m.locked_bytes = 8 * kMiB), ("ok|a process may lock 8 MiB||" + better).c_str()},
       {LOT_ON(m.locked_bytes = 8 * kMiB; m.wanted_bytes = 16 * kMiB),
        "ok|a process may lock 8 MiB||for LOT_MLOCK=1: `ulimit -l 16384`, *"},
       {LOT_ON(m.locked_bytes = 8 * kMiB; m.locks_memory = true),
        (std::string("problem|a process may lock 8 MiB, and LOT_MLOCK is set|"
                     "A segment of 1 GiB can not be locked.|") +
         raise)
            .c_str()}});
}

TEST_CASE("lot doctor on limits of numbers: files, threads, priorities") {
  check_cases("open_files",
              {{LOT_ON(), "ok|a process may have any number of open files||"},
               {LOT_ON(m.open_files = 64), "ok|a process may have 64 open files||"},
               {LOT_ON(m.open_files = 63), "warning|a process may have 63 open files|*|*"}});
  check_cases("threads",
              {{LOT_ON(), "ok|a user may have any number of threads||"},
               {LOT_ON(m.threads = m.group_threads = 64), "ok|a user may have 64 threads||"},
               {LOT_ON(m.threads = 63), "warning|a user may have 63 threads|*|`ulimit -u 4096`, *"},
               {LOT_ON(m.threads = 63; m.is_root = true), "ok|a user may have 63 threads||"},
               {LOT_ON(m.group_threads = 63; m.is_root = true),
                "warning|the control group may begin 63 more threads|*|raise its limit *"}});
  check_cases("real_time",
              {{LOT_ON(), "ok|a thread may have a real-time priority of 50||"},
               {LOT_ON(m.may_be_real_time = true), "ok|a thread may have any priority||"},
               {LOT_ON(m.real_time_priority = 0),
                "ok|a thread may not have a real-time priority||for ThreadOptions::priority: *"}});
}

TEST_CASE("lot doctor on what the kernel or a sandbox does not give") {
  const auto of_call = [](const std::string& name, Call Machine::*how, const std::string& since) {
    const std::string check = name == "set_robust_list"  ? "robust_list"
                              : name == "FUTEX_LOCK_PI2" ? "lock_pi2"
                                                         : name;
    Machine m = good();
    CHECK(said(m, check) == "ok|" + name + " works||");
    m.*how = Call::Refused;
    const auto fits = [&](const std::string& pattern) {
      return fnmatch(pattern.c_str(), said(m, check).c_str(), FNM_NOESCAPE) == 0;
    };
    CHECK(fits("warning|" + name + " is refused|*|allow it in the sandbox *"));
    m.*how = Call::Missing;
    CHECK(fits("warning|" + name + " is missing|*|a kernel from Linux " + since + ", and *"));
  };
  of_call("set_robust_list", &Machine::robust_list, "2.6.17");
  of_call("futex_waitv", &Machine::futex_waitv, "5.16");
  of_call("FUTEX_LOCK_PI2", &Machine::lock_pi2, "5.14");
  of_call("membarrier", &Machine::membarrier, "4.14");
  check_cases("file_locks", {{LOT_ON(), "ok|locks of open file descriptions work||"},
                             {LOT_ON(m.file_locks = Call::Refused), "problem|*are missing|*|*"}});
  check_cases("new_memory", {{LOT_ON(), "ok|madvise(MADV_POPULATE_WRITE) works||"},
                             {LOT_ON(m.fallocate = Call::Missing), "ok|*"},
                             {LOT_ON(m.populate = Call::Missing), "warning|*|First messages *|*"},
                             {LOT_ON(m.populate = m.fallocate = Call::Refused),
                              "problem|madvise and fallocate are refused|*|*"}});
  check_cases("proc", {{LOT_ON(), "ok|/proc shows processes||"},
                       {LOT_ON(m.has_proc = false), "warning|/proc is not mounted|*|*"}});
  check_cases(
      "containers",
      {{LOT_ON(), "ok|this is the first PID namespace||"},
       {LOT_ON(m.in_pid_namespace = true), "ok|this is a PID namespace of its own (a container)||"},
       {LOT_ON(first(m).hidden = 1),
        "ok|this is the first PID namespace; 1 process lives in another||their pids *"},
       {LOT_ON(first(m).hidden = 2; m.segments.push_back(first(m))),
        "ok|this is the first PID namespace; 4 processes live in another||*"}});
}

TEST_CASE("lot doctor on huge pages") {
  const char* const gives = "ok|/dev/shm gives huge pages||";
  const char* const could =
      "ok|/dev/shm gives no huge pages||for faster *: `mount -o remount,huge=advise /dev/shm`";
  check_cases(
      "huge_pages",
      {{LOT_ON(), gives},
       {LOT_ON(m.mount.options = "huge=always,rw"), gives},
       {LOT_ON(m.mount.options = "rw,huge=within_size,size=1g"), gives},
       {LOT_ON(m.mount.options = "rw,huge=advised"), could},
       {LOT_ON(m.mount.options = "rw,xhuge=advise"), could},
       {LOT_ON(m.mount.options = ""; m.huge_pages = "force"), gives},
       {LOT_ON(m.mount.options = ""; m.mount.point = "/dev"),
        "ok|/dev/shm gives no huge pages||*remount,huge=advise /dev`"},
       {LOT_ON(m.mount.options = ""; m.mount.point = ""), could},
       {LOT_ON(m.huge_pages = "deny"),
        "ok|/dev/shm gives no huge pages||*huge=advise /dev/shm`, and `echo advise > /sys/*"},
       {LOT_ON(m.huge_pages = ""), "ok|the kernel has no huge pages for shared memory||"},
       {LOT_ON(m.mount = {"/", "ext4", "rw"}), "ok|ext4 gives no huge pages||"}});
}

TEST_CASE("lot doctor on segments") {
  check_cases(
      "segment",
      {{LOT_ON(first(m).living = 1), "ok|/dev/shm/absent: 1 process, layout LAYOUT||"},
       {LOT_ON(), "ok|/dev/shm/absent: 3 processes, layout LAYOUT||"},
       {LOT_ON(first(m).dead = 1),
        "warning|/dev/shm/absent: 1 process is dead and not reaped|*|`lot clean --segment absent`"},
       {LOT_ON(first(m).dead = 2; first(m).has_items = true),
        "warning|/dev/shm/absent: 2 processes are dead and not reaped|*|`lot clean --segment "
        "absent`"},
       {LOT_ON(first(m).living = 0),
        "warning|/dev/shm/absent: no process lives in it|"
        "It takes 64 MiB of memory.|`lot clean --segment absent`"},
       {LOT_ON(first(m).living = 0; first(m).has_items = true),
        "warning|*: no process lives in it, and items wait there|*|"
        "start it, or drop them by `lot clean --with-items --segment absent`"},
       {LOT_ON(m.segments.clear()), ""}});
  const auto with = [](Condition condition, bool is_wanted) {
    return [=](Machine& m) {
      first(m).condition = condition;
      first(m).is_wanted = is_wanted;
      first(m).reason = "reason";
    };
  };
  check_cases(
      "segment",
      {{with(Condition::OtherBoot, true),
        "warning|/dev/shm/absent is of another boot|*|`lot clean --segment absent`"},
       {with(Condition::Unreadable, true), "problem|/dev/shm/absent: reason|*|look as its *"},
       {with(Condition::Unreadable, false), "warning|/dev/shm/absent: reason|*|look as its *"},
       {with(Condition::Damaged, true),
        "problem|/dev/shm/absent: reason|This lot has layout LAYOUT. Programs *|"
        "use one version of LOT in all programs; else end all that use it, and `lot clean "
        "--segment absent`"},
       {with(Condition::Damaged, false), "warning|/dev/shm/absent: reason|This lot has *|*"},
       {with(Condition::Untrusted, true), "problem|/dev/shm/absent: reason|*|use another name *"},
       {with(Condition::Untrusted, false),
        "ok|/dev/shm/absent is another user's, or open to others||"}});
  check_cases("other_file",
              {{LOT_ON(m.obstacles = {{"/dev/shm/a", "it is a directory"}}),
                "problem|/dev/shm/a: it is a directory|*|remove it if it is yours, *"}});
  Machine m = good();
  m.segments.assign(20, segment_seen());
  const std::string twenty = said(m, "segment");
  m.segments.assign(23, segment_seen());
  CHECK(said(m, "segment") == twenty + "\nok|3 more: `lot ls`||");
  CHECK(std::count(twenty.begin(), twenty.end(), '\n') == 19);
}

TEST_SUITE_END();
