// SPDX-License-Identifier: Apache-2.0

// What `lot doctor` reads of a machine: of files that the test writes, of limits that it sets, of a
// kernel that refuses calls.

#include "tool/machine.hpp"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/utsname.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "command.hpp"
#include "support/error_of.hpp"
#include "support/janitor.hpp"
#include "support/sandbox.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
namespace tool = lot::tool;
using lot::segment::kUnlimited;
using tool::Call;
using tool::Machine;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// A machine of files, and a directory for segments.
struct Place {
  Room room;
  std::string root = room.path() + "/root";
  std::string directory = room.path() + "/segments";

  Place() { std::filesystem::create_directories(directory); }
  void write(const std::string& file, const std::string& text) const {
    const std::filesystem::path path = root + file;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path) << text;
  }
  Machine look() const {
    prefix();
    tool::Settings settings;
    settings.where.directory = directory;
    return tool::look_at_machine(settings, root);
  }
  template <class T>
  T with(const std::string& file, const std::string& text, T Machine::*member) const {
    write(file, text);
    return look().*member;
  }
};

using Texts = std::vector<std::pair<const char*, std::uint64_t>>;

}  // namespace

TEST_SUITE_BEGIN("machine");

TEST_CASE("numbers of /proc/meminfo are read from lines of every form, and others are not") {
  const Place place;
  const Texts kLines = {{"MemAvailable:     2048 kB\n", 2048 << 10},
                        {"MemTotal: 9 kB\n \tMemAvailable\t=\t1 kB", 1 << 10},
                        {"MemAvailable : 7", 7 << 10},
                        {"MemAvailable:1\nMemAvailable:3\n\n", 3 << 10},
                        {"\n\nMemAvailable: 5\nMemAvailableX: 6\n", 5 << 10},
                        {"MemAvailable 5\n", kUnlimited},
                        {"MemAvailableX: 5\n", kUnlimited},
                        {"XMemAvailable: 5\n", kUnlimited},
                        {"MemAvailable", kUnlimited},
                        {"MemAvailable:", kUnlimited},
                        {"MemAvailable: \t\n", kUnlimited},
                        {"", kUnlimited}};
  for (const auto& [text, bytes] : kLines) {
    CAPTURE(std::string(text));
    CHECK(place.with("/proc/meminfo", text, &Machine::available_bytes) == bytes);
  }
  const Texts kCommit = {{"CommitLimit: 300 kB\nCommitted_AS: 100 kB\n", 200 << 10},
                         {"CommitLimit: 300 kB\nCommitted_AS: 300 kB\n", 0},
                         {"CommitLimit: 300 kB\nCommitted_AS: 400 kB\n", 0},
                         {"CommitLimit: 300 kB\n", kUnlimited},
                         {"Committed_AS: 300 kB\n", kUnlimited}};
  for (const auto& [text, bytes] : kCommit) {
    CAPTURE(std::string(text));
    CHECK(place.with("/proc/meminfo", text, &Machine::commit_left) == bytes);
  }
  for (const auto& [text, strict] : Texts{{"2\n", 1}, {"1\n", 0}, {"2", 0}, {"22\n", 0}}) {
    CHECK(place.with("/proc/sys/vm/overcommit_memory", text, &Machine::is_strict) == (strict != 0));
  }
  using Names = std::vector<std::pair<const char*, const char*>>;
  for (const auto& [text, name] : Names{{"always [never] deny\n", "never"},
                                        {"[always] never\n", "always"},
                                        {"always never\n", ""},
                                        {"always [never\n", ""},
                                        {"always never]\n", ""},
                                        {"[]", ""}}) {
    CHECK(place.with("/sys/kernel/mm/transparent_hugepage/shmem_enabled", text,
                     &Machine::huge_pages) == name);
  }
}

TEST_CASE("rights and namespaces are those of /proc/self/status") {
  const Place place;
  CHECK(!place.look().has_proc);
  CHECK(!place.look().in_pid_namespace);
  struct Right {
    const char* text;
    bool may_lock, may_be_real_time, in_namespace;
  };
  const auto check = [&](const Right& right) {
    place.write("/proc/self/status", right.text);
    const Machine m = place.look();
    CAPTURE(std::string(right.text));
    CHECK(m.has_proc);
    CHECK(m.may_lock_memory == right.may_lock);
    CHECK(m.may_be_real_time == right.may_be_real_time);
    CHECK(m.in_pid_namespace == right.in_namespace);
  };
  check({"CapEff:\t0000000000004000\n", true, false, true});  // no process 2 is there
  place.write("/proc/2/comm", "bash\n");
  check({"CapEff:\t0000000000800000\n", false, true, true});
  place.write("/proc/2/comm", "kthreadd\n");
  check({"CapEff:\tffffffffff7fbfff\n", false, false, false});
  check({"CapEff:\t0\nNSpid:\t7\n", false, false, false});
  check({"CapEff:\tffffffffffffffff\nNSpid:\t7\t1\n", true, true, true});
}

TEST_CASE("threads and memory that are left are those of the tightest control group") {
  const Place place;
  const auto group = [&](const std::string& path, const char* most, const char* now) {
    place.write("/sys/fs/cgroup" + path + "/pids.max", most);
    place.write("/sys/fs/cgroup" + path + "/pids.current", now);
  };
  group("/a/b", "100", "30");
  group("/a", "90", "40");
  group("/full", "40", "40");
  group("/over", "30", "40");
  group("/free", "max", "40");
  group("/pids/c", "20", "9");
  group("/pids", "20", "8");
  group("/cpu/d", "20", "15");
  const Texts kGroups = {{"0::/a/b\n", 50},
                         {"0::/a\n", 50},
                         {"0::/full\n", 0},
                         {"0::/over", 0},
                         {"0::/free", kUnlimited},
                         {"0::/", kUnlimited},
                         {"7:pids:/c", 11},
                         {"7:pids:/", 12},
                         {"7:cpu:/d\n", kUnlimited},
                         {"", kUnlimited},
                         {"nonsense\n0:\n7:pids:/c\n3:cpu:/d\n0::/a\n", 11},
                         {"pids:/c\n0::/a\n", 50}};
  for (const auto& [text, threads] : kGroups) {
    CAPTURE(std::string(text));
    CHECK(place.with("/proc/self/cgroup", text, &Machine::group_threads) == threads);
  }
  place.write("/proc/self/cgroup", "0::/a\n");
  const Texts kMemory = {{"4096\n", 4096},
                         {"1152921504606846976\n", std::uint64_t{1} << 60},
                         {"1152921504606846977\n", kUnlimited},
                         {"max\n", kUnlimited}};
  for (const auto& [text, bytes] : kMemory) {
    CHECK(place.with("/sys/fs/cgroup/a/memory.max", text, &Machine::group_bytes) == bytes);
  }
}

TEST_CASE("limits of a process are those that the kernel says") {
  const Place place;
  const std::pair<int, std::uint64_t Machine::*> kLimits[] = {
      {RLIMIT_MEMLOCK, &Machine::locked_bytes}, {RLIMIT_AS, &Machine::address_bytes},
      {RLIMIT_NOFILE, &Machine::open_files},    {RLIMIT_NPROC, &Machine::threads},
      {RLIMIT_FSIZE, &Machine::file_bytes},     {RLIMIT_RTPRIO, &Machine::real_time_priority}};
  rlim_t value = std::uint64_t{1} << 50;  // AddressSanitizer wants many addresses
  for (const auto& [resource, member] : kLimits) {
    CAPTURE(resource);
    Child child([&, limited = resource, said = member] {
      rlimit limit{};
      const auto which = static_cast<__rlimit_resource_t>(limited);
      must(getrlimit(which, &limit) == 0, "a limit");
      const rlim_t wanted = limited == RLIMIT_NOFILE ? 77 : value;
      limit.rlim_cur = std::min(wanted, limit.rlim_max);
      must(setrlimit(which, &limit) == 0, "another limit");
      must(place.look().*said == limit.rlim_cur, "it is read");
      if (limit.rlim_max != RLIM_INFINITY) return;
      limit.rlim_cur = RLIM_INFINITY;
      must(setrlimit(which, &limit) == 0, "no limit");
      must(place.look().*said == kUnlimited, "there is none");
    });
    CHECK(child.wait() == 0);
    ++value;
  }
  utsname name{};
  REQUIRE(uname(&name) == 0);
  CHECK(place.look().release == name.release);
  CHECK(place.look().page_bytes == static_cast<std::uint64_t>(getpagesize()));
  CHECK(place.look().is_root == (geteuid() == 0));
}

TEST_CASE("a call that the kernel does not know is missing, one that is forbidden is refused") {
  Place place;
  place.directory = "/nothing";  // to look into one takes some of the calls
  const Machine before = place.look();
  struct Answer {
    std::uint32_t call;
    int error;
    Call Machine::*member;
    Call says;
  };
  const Answer kAnswers[] = {{SYS_set_robust_list, ENOSYS, &Machine::robust_list, Call::Missing},
                             {SYS_set_robust_list, EPERM, &Machine::robust_list, Call::Refused},
                             {SYS_set_robust_list, EACCES, &Machine::robust_list, Call::Refused},
                             {SYS_set_robust_list, EINVAL, &Machine::robust_list, Call::Works},
                             {kFutexWaitv, ENOSYS, &Machine::futex_waitv, Call::Missing},
                             {kFutexWaitv, EPERM, &Machine::futex_waitv, Call::Refused},
                             {kFutexWaitv, EINVAL, &Machine::futex_waitv, Call::Works},
                             {SYS_membarrier, ENOSYS, &Machine::membarrier, Call::Missing},
                             {SYS_membarrier, EPERM, &Machine::membarrier, Call::Refused},
                             {SYS_futex, ENOSYS, &Machine::lock_pi2, Call::Missing},
                             {SYS_futex, EPERM, &Machine::lock_pi2, Call::Refused},
                             {SYS_futex, EINVAL, &Machine::lock_pi2, Call::Works},
                             {SYS_madvise, EINVAL, &Machine::populate, Call::Missing},
                             {SYS_madvise, ENOSYS, &Machine::populate, Call::Missing},
                             {SYS_madvise, EPERM, &Machine::populate, Call::Refused},
                             {SYS_fallocate, ENOSYS, &Machine::fallocate, Call::Missing},
                             {SYS_fallocate, EPERM, &Machine::fallocate, Call::Refused},
                             {SYS_fallocate, ENOSPC, &Machine::fallocate, Call::Works},
                             {SYS_fcntl, EINVAL, &Machine::file_locks, Call::Missing},
                             {SYS_fcntl, ENOSYS, &Machine::file_locks, Call::Missing},
                             {SYS_fcntl, EPERM, &Machine::file_locks, Call::Refused},
                             {SYS_memfd_create, EPERM, &Machine::file_locks, Call::Works},
                             {SYS_memfd_create, EPERM, &Machine::fallocate, Call::Works}};
  for (const Answer& answer : kAnswers) {
    CAPTURE(answer.call);
    CAPTURE(answer.error);
    Child child([&] {
      must(refuse(answer.call, answer.error), "a filter");
      const Machine m = place.look();
      must(m.*answer.member == answer.says, "what it says");
      for (const auto other :
           {&Machine::robust_list, &Machine::futex_waitv, &Machine::membarrier, &Machine::lock_pi2,
            &Machine::populate, &Machine::fallocate, &Machine::file_locks}) {
        must(other == answer.member || m.*other == before.*other, "of other calls the same");
      }
    });
    CHECK(child.wait() == 0);
  }
  Child nameless([&] {
    must(refuse(SYS_uname, EPERM), "a filter");
    must(place.look().release.empty(), "no name");
  });
  CHECK(nameless.wait() == 0);
}

TEST_CASE("a directory may be missing, a file, closed to this user, or open to all to remove") {
  Place place;
  const auto mode = [&](mode_t bits) {
    REQUIRE(chmod(place.directory.c_str(), bits) == 0);
    return place.look().strangers_may_remove;
  };
  CHECK(mode(0777));
  CHECK(!mode(01777));
  CHECK(!mode(0775));
  CHECK(!mode(0755));
  struct statvfs room {};
  REQUIRE(statvfs(place.directory.c_str(), &room) == 0);
  const Machine m = place.look();
  CHECK(m.directory_error.empty());
  CHECK(m.total_bytes == room.f_blocks * room.f_frsize);
  CHECK(m.free_bytes % room.f_frsize == 0);
  CHECK(m.free_bytes <= m.total_bytes);
  CHECK(m.free_bytes > m.total_bytes / 1000);
  place.write("/proc/self/mountinfo", "1 0 0:1 / / rw - ext4 a rw\n2 1 0:2 / " + place.room.path() +
                                          " rw - tmpfs b rw,huge=advise\n");
  CHECK(place.look().mount.type == "tmpfs");
  const std::string link = place.room.path() + "/link";
  std::filesystem::create_directory_symlink("/", link);  // the place that a link leads to counts
  place.directory = link;
  CHECK(place.look().mount.type == "ext4");
  place.directory += "_to_nothing";
  CHECK(place.look().directory_error == "No such file or directory");
  std::ofstream(place.directory) << "a file";
  CHECK(place.look().directory_error == "it is no directory");
  CHECK(place.look().segments.empty());
}

TEST_CASE("the file system of a directory is that of the mount that lies over it") {
  const auto point = [](const std::string& directory, const std::string& mounts) {
    const tool::Mount m = tool::mount_of(directory, mounts);
    return m.point + " " + m.type + " " + m.options;
  };
  const auto line = [](const std::string& where, const std::string& type) {
    return "1 0 0:1 / " + where + " rw - " + type + " source opt\n";
  };
  CHECK(point("/a", line("/", "x")) == "/ x opt");
  CHECK(point("/", line("/", "x") + line("/a", "y")) == "/ x opt");
  CHECK(point("/a", line("/", "x") + line("/a", "y")) == "/a y opt");
  CHECK(point("/a/b", line("/a", "y") + line("/", "x")) == "/a y opt");
  CHECK(point("/ab", line("/a", "y") + line("/", "x")) == "/ x opt");
  CHECK(point("/a", line("/a", "y") + line("/a", "z")) == "/a z opt");
  CHECK(point("/b", line("/a", "y")) == "  ");
  CHECK(point("/a b", line("/a\\040b", "y")) == "/a b y opt");
  CHECK(point("/a\\b", line("/a\\134b", "y")) == "/a\\b y opt");
  CHECK(point("/a ", line("/a\\040", "y")) == "/a  y opt");
  CHECK(point("/a\\04", line("/a\\04", "y")) == "/a\\04 y opt");  // it is cut short
  CHECK(point("/a", "1 0 0:1 / /a rw shared:1 master:2 - y source opt\n") == "/a y opt");
  CHECK(point("/a", "1 0 0:1 / /a rw - y source\n") == "  ");
  CHECK(point("/a", "1 0 0:1 / /a rw\n") == "  ");
}

TEST_CASE("a name is taken for the variable that fewest letters part it from, two at most") {
  const std::pair<const char*, const char*> kNames[] = {{"LOT_SEGEMENT", "LOT_SEGMENT"},
                                                        {"LOT_SEGMENTS", "LOT_SEGMENT"},
                                                        {"LOT_DIRS", "LOT_DIR"},
                                                        {"LOT_SIZ", "LOT_SIZE"},
                                                        {"LOT_PERMISSION", "LOT_PERMISSIONS"},
                                                        {"LOT_GRUOP", "LOT_GROUP"},
                                                        {"LOT_USR", "LOT_USER"},
                                                        {"LOT_USE", "LOT_USER"},
                                                        {"LOT_PERSISTS", "LOT_PERSIST"},
                                                        {"LOT_LOCK", "LOT_MLOCK"},
                                                        {"LOT_QUEU", "LOT_QUEUE"},
                                                        {"LOT_STEMP", "LOT_STAMP"},
                                                        {"LOT_FASTLANE", "LOT_FAST_LANE"},
                                                        {"lOT_DIR", "LOT_DIR"},
                                                        {"LT_DR", "LOT_DIR"},
                                                        {"LOT_SIZR", "LOT_SIZE"}};
  for (const auto& [name, variable] : kNames) {
    CHECK(tool::misspelt_of({name}) ==
          std::vector<std::string>{std::string(name) + ": " + variable});
  }
  for (const char* name : {"", "PATH", "LOT_", "LT_DRS", "LOT_QUEUE_DEPTH", "LOT_DIR"}) {
    CHECK(tool::misspelt_of({name}).empty());
  }
  CHECK(tool::misspelt_of({"LOT_DIRS", "PATH", "LOT_SIZ"}).size() == 2);
}

TEST_CASE("lot doctor reads the variables that programs read, and says which is wrong") {
  const Place place;
  prefix();
  CHECK(place.look().bad_options.empty());
  CHECK(place.look().wanted_bytes == 0);
  CHECK(!place.look().locks_memory);
  for (const auto& [name, value] :
       {std::pair("LOT_SIZE", "many"), std::pair("LOT_MLOCK", "x"), std::pair("LOT_QUEUE", "x"),
        std::pair("LOT_STAMP", "x"), std::pair("LOT_FAST_LANE", "x"),
        std::pair("LOT_PERMISSIONS", "x"), std::pair("LOT_GROUP", "no group of this name"),
        std::pair("LOT_USER", "no user of this name")}) {
    CAPTURE(std::string(name));
    const Variable bad(name, value);
    CHECK(names(place.look().bad_options, name));
  }
  const Variable size("LOT_SIZE", "64M"), lock("LOT_MLOCK", "1"), wrong("LOT_SEGMNT", "x=LOT_DIRS");
  const Machine m = place.look();
  CHECK(m.bad_options.empty());
  CHECK(m.wanted_bytes == 64 << 20);
  CHECK(m.locks_memory);
  CHECK(m.misspelt == std::vector<std::string>{"LOT_SEGMNT: LOT_SEGMENT"});
  CHECK(m.segment == lot::EngineOptions().segment);
  tool::Settings settings;
  settings.where = {place.directory, "a/b", {}};
  CHECK(!tool::look_at_machine(settings, place.root).bad_options.empty());
}

TEST_CASE("lot doctor counts who lives in a segment, and whom /proc does not show") {
  const Place place;
  auto options = place.room.options("s");
  options.directory = place.directory;
  lot::ShmEngine engine(options);
  tool::Settings settings;
  settings.where = {place.directory, "", {}};
  const auto look = [&] { return tool::look_at_machine(settings, place.root); };
  const auto text = [&] {
    const auto& all = look().segments;
    REQUIRE(all.size() == 1);
    const tool::SegmentSeen& s = all.front();
    CHECK(s.name == "s");
    CHECK(s.path == place.directory + "/s");
    CHECK(s.condition == tool::Sight::Condition::Sound);
    CHECK(s.bytes == std::filesystem::file_size(s.path));
    CHECK(s.taken > 0);
    CHECK(s.taken <= s.bytes);
    return std::to_string(s.living) + " live, " + std::to_string(s.dead) + " are dead, " +
           std::to_string(s.hidden) + " hidden" + (s.has_items ? ", items" : "") +
           (s.is_wanted ? ", wanted" : "");
  };
  CHECK(text() == "1 live, 0 are dead, 0 hidden");
  place.write("/proc/self/status", "CapEff: 0\n");
  CHECK(text() == "1 live, 0 are dead, 1 hidden");
  place.write("/proc/" + std::to_string(getpid()) + "/comm", "me\n");
  CHECK(text() == "1 live, 0 are dead, 0 hidden");
  settings.where.name = "s";
  auto queue = engine.queue<int>("numbers");
  (void)queue.put(1);
  Steps ready;
  Child other([&] {
    const lot::ShmEngine mine(options);
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  CHECK(text() == "2 live, 0 are dead, 1 hidden, items, wanted");
  std::filesystem::create_directory(place.directory + "/t");
  settings.where.name = "t";
  CHECK(look().obstacles.size() == 1);
  CHECK(look().segments.empty());
}

TEST_SUITE_END();
