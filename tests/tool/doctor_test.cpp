// SPDX-License-Identifier: Apache-2.0

// What `lot doctor` finds: on machines that the test makes up, and on this one.

#include "tool/doctor.hpp"

#include <filesystem>
#include <fstream>
#include <functional>
#include <set>
#include <string>
#include <sys/stat.h>
#include <vector>

#include <doctest/doctest.h>

#include "actor.hpp"
#include "command.hpp"
#include "machines.hpp"
#include "support/janitor.hpp"
#include "support/users.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
namespace tool = lot::tool;
using Verdict = tool::Finding::Verdict;
using tool::Call;
using tool::Machine;
using Condition = tool::Sight::Condition;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// The findings that are not ok.
std::vector<tool::Finding> wrong_with(const Machine& m) {
  std::vector<tool::Finding> wrong;
  for (auto& finding : tool::diagnose(m)) {
    if (finding.verdict != Verdict::Ok) wrong.push_back(finding);
  }
  return wrong;
}

struct Case {
  const char* check;
  Verdict verdict;
  std::function<void(Machine&)> change;
};

/// Each change of a good machine makes one finding, and that one alone.
void check_cases(const std::vector<Case>& cases) {
  for (std::size_t n = 0; n < cases.size(); ++n) {
    const Case& c = cases[n];
    CAPTURE(n);
    CAPTURE(c.check);
    Machine m = good();
    c.change(m);
    const auto wrong = wrong_with(m);
    REQUIRE(wrong.size() == 1);
    CHECK(wrong.front().check == c.check);
    CHECK(wrong.front().verdict == c.verdict);
    CHECK(!wrong.front().seen.empty());
    CHECK(!wrong.front().means.empty());
    CHECK(!wrong.front().advice.empty());
  }
}

/// The advice of a check that is well and could be better; "" where it could not.
std::string better(const Machine& m, const std::string& check) {
  for (const auto& finding : tool::diagnose(m)) {
    if (finding.check == check) return finding.verdict == Verdict::Ok ? finding.advice : "not ok";
  }
  return "no such check";
}

void write(const std::string& path, const std::string& text) {
  std::filesystem::create_directories(std::filesystem::path(path).parent_path());
  std::ofstream(path) << text;
}

tool::Settings settings_for(const std::string& directory) {
  tool::Settings settings;
  settings.where.directory = directory;
  return settings;
}

Json finding_of(const Json& document, const std::string& check) {
  for (const auto& finding : document.at("findings")) {
    if (finding.at("check") == check) return finding;
  }
  return nullptr;
}

}  // namespace

TEST_SUITE_BEGIN("doctor");

TEST_CASE("lot doctor finds nothing on a machine that is well, and says what it has looked at") {
  const auto all = tool::diagnose(good());
  std::set<std::string> checks;
  for (const auto& finding : all) {
    CAPTURE(finding.check);
    CAPTURE(finding.seen);
    CHECK(finding.verdict == Verdict::Ok);
    CHECK(finding.means.empty());
    CHECK(!finding.seen.empty());
    checks.insert(finding.check);
  }
  CHECK(checks.size() == all.size());
  CHECK(checks.size() == 26);
}

TEST_CASE("lot doctor finds what is wrong with the directory of segments and its file system") {
  check_cases({
      {"environment", Verdict::Problem,
       [](Machine& m) { m.bad_options = "LOT_SIZE=many: not a size"; }},
      {"environment", Verdict::Warning,
       [](Machine& m) { m.misspelt = {"LOT_SEGEMENT: LOT_SEGMENT"}; }},
      {"directory", Verdict::Problem,
       [](Machine& m) { m.directory_error = "No such file or directory"; }},
      {"directory", Verdict::Warning, [](Machine& m) { m.strangers_may_remove = true; }},
      {"file_system", Verdict::Warning, [](Machine& m) { m.mount.type = "ext4"; }},
      {"file_system", Verdict::Warning, [](Machine& m) { m.mount.type = "overlay"; }},
      {"file_system", Verdict::Warning, [](Machine& m) { m.mount.type = ""; }},
      {"file_system", Verdict::Problem, [](Machine& m) { m.mount.type = "nfs4"; }},
      {"file_system", Verdict::Problem, [](Machine& m) { m.mount.type = "hugetlbfs"; }},
      {"space", Verdict::Problem,
       [](Machine& m) {
         m.free_bytes = 20 * kMiB;
         m.segments.clear();
       }},
      {"space", Verdict::Warning,
       [](Machine& m) {
         m.free_bytes = 64 * kMiB;
         m.segments.clear();
       }},
      {"space", Verdict::Problem, [](Machine& m) { m.wanted_bytes = m.free_bytes + 1; }},
      {"promised", Verdict::Warning, [](Machine& m) { m.free_bytes = 900 * kMiB; }},
      {"promised", Verdict::Warning, [](Machine& m) { m.available_bytes = 900 * kMiB; }},
      {"logind", Verdict::Warning, [](Machine& m) { m.logind_removes = true; }},
  });
}

TEST_CASE("lot doctor finds limits of a process and of the machine that are too low") {
  check_cases({
      {"memory", Verdict::Warning,
       [](Machine& m) {
         m.available_bytes = 100 * kMiB;
         m.segments.clear();
       }},
      {"memory", Verdict::Warning,
       [](Machine& m) {
         m.is_strict = true;
         m.commit_left = 10 * kMiB;
       }},
      {"memory_group", Verdict::Warning, [](Machine& m) { m.group_bytes = 128 * kMiB; }},
      {"memory_group", Verdict::Warning,
       [](Machine& m) {
         m.wanted_bytes = 600 * kMiB;
         m.group_bytes = 512 * kMiB;
       }},
      {"file_size", Verdict::Warning, [](Machine& m) { m.file_bytes = 512 * kMiB; }},
      {"file_size", Verdict::Problem,
       [](Machine& m) {
         m.wanted_bytes = 600 * kMiB;
         m.file_bytes = 512 * kMiB;
       }},
      {"address_space", Verdict::Problem, [](Machine& m) { m.address_bytes = 512 * kMiB; }},
      {"open_files", Verdict::Warning, [](Machine& m) { m.open_files = 10; }},
      {"threads", Verdict::Warning, [](Machine& m) { m.threads = 10; }},
      {"threads", Verdict::Warning, [](Machine& m) { m.group_threads = 3; }},
      {"locked_memory", Verdict::Problem,
       [](Machine& m) {
         m.locks_memory = true;
         m.locked_bytes = 8 * kMiB;
       }},
  });
  const auto well = [](auto&& change) {
    Machine m = good();
    change(m);
    return wrong_with(m).empty();
  };
  CHECK(well([](Machine& m) {
    m.is_strict = true;
    m.commit_left = 4096 * kMiB;
  }));
  CHECK(well([](Machine& m) { m.group_bytes = 4096 * kMiB; }));
  CHECK(well([](Machine& m) { m.file_bytes = 1024 * kMiB; }));  // just what a new segment takes
  CHECK(well([](Machine& m) { m.segments.at(0).bytes = m.free_bytes + 64 * kMiB; }));
  CHECK(well([](Machine& m) {
    m.wanted_bytes = 100 * kMiB;
    m.file_bytes = 512 * kMiB;
  }));
  CHECK(well([](Machine& m) {
    m.threads = 10;
    m.is_root = true;
  }));
  CHECK(well([](Machine& m) {
    m.locks_memory = true;
    m.locked_bytes = 0;
    m.may_lock_memory = true;
  }));
}

TEST_CASE("lot doctor finds what the kernel or a sandbox does not give") {
  check_cases({
      {"page_size", Verdict::Warning, [](Machine& m) { m.page_bytes = 65536; }},
      {"file_locks", Verdict::Problem, [](Machine& m) { m.file_locks = Call::Missing; }},
      {"robust_list", Verdict::Warning, [](Machine& m) { m.robust_list = Call::Refused; }},
      {"futex_waitv", Verdict::Warning, [](Machine& m) { m.futex_waitv = Call::Missing; }},
      {"futex_waitv", Verdict::Warning, [](Machine& m) { m.futex_waitv = Call::Refused; }},
      {"lock_pi2", Verdict::Warning, [](Machine& m) { m.lock_pi2 = Call::Missing; }},
      {"membarrier", Verdict::Warning, [](Machine& m) { m.membarrier = Call::Refused; }},
      {"new_memory", Verdict::Warning, [](Machine& m) { m.populate = Call::Missing; }},
      {"new_memory", Verdict::Problem,
       [](Machine& m) { m.populate = m.fallocate = Call::Refused; }},
      {"proc", Verdict::Warning, [](Machine& m) { m.has_proc = false; }},
  });
}

TEST_CASE("lot doctor finds segments and files that are in the way, or of another version") {
  const auto condition = [](Condition c, bool is_wanted) {
    return [=](Machine& m) {
      m.segments.front().condition = c;
      m.segments.front().reason = "it has layout version 12, ours is 15";
      m.segments.front().is_wanted = is_wanted;
    };
  };
  check_cases({
      {"other_file", Verdict::Problem,
       [](Machine& m) {
         m.obstacles = {{"/dev/shm/LOTROS", "it is a directory"}};
       }},
      {"segment", Verdict::Problem, condition(Condition::Damaged, true)},
      {"segment", Verdict::Warning, condition(Condition::Damaged, false)},
      {"segment", Verdict::Problem, condition(Condition::Untrusted, true)},
      {"segment", Verdict::Problem, condition(Condition::Unreadable, true)},
      {"segment", Verdict::Warning, condition(Condition::Unreadable, false)},
      {"segment", Verdict::Warning, condition(Condition::OtherBoot, true)},
      {"segment", Verdict::Warning, [](Machine& m) { m.segments.front().dead = 1; }},
      {"segment", Verdict::Warning, [](Machine& m) { m.segments.front().living = 0; }},
      {"segment", Verdict::Warning,
       [](Machine& m) {
         m.segments.front().living = 0;
         m.segments.front().has_items = true;
       }},
  });
  Machine m = good();
  condition(Condition::Untrusted, false)(m);
  CHECK(wrong_with(m).empty());  // another user's segment of another name
  m.segments.assign(100, segment_seen());
  m.free_bytes = m.available_bytes = 1000 * 1024 * kMiB;
  CHECK(wrong_with(m).empty());
  CHECK(tool::diagnose(m).size() < 60);
}

TEST_CASE("of what is well lot doctor says what could be better: huge pages, locks, real time") {
  Machine m = good();
  for (const char* check : {"huge_pages", "locked_memory", "real_time", "containers"}) {
    CHECK(better(m, check).empty());
  }
  m.mount.options = "rw,size=1g";
  CHECK(better(m, "huge_pages").find("huge=advise") != std::string::npos);
  m.huge_pages = "force";
  CHECK(better(m, "huge_pages").empty());
  m.huge_pages = "";
  CHECK(better(m, "huge_pages").empty());
  m.mount.options = "rw,huge=always";
  m.huge_pages = "deny";
  CHECK(better(m, "huge_pages").find("shmem_enabled") != std::string::npos);
  m.locked_bytes = 8 * kMiB;
  CHECK(better(m, "locked_memory").find("ulimit -l 1048576") != std::string::npos);
  m.real_time_priority = 0;
  CHECK(better(m, "real_time").find("rtprio") != std::string::npos);
  m.may_be_real_time = true;
  CHECK(better(m, "real_time").empty());
  m.segments.front().hidden = 2;
  CHECK(!better(m, "containers").empty());
}

TEST_CASE("the file system of a directory is that of the innermost mount, and of the last there") {
  const std::string mounts =
      "21 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw\n"
      "22 21 0:5 / /dev rw,nosuid shared:2 - devtmpfs udev rw,size=10k\n"
      "23 22 0:6 / /dev/shm rw,nosuid,nodev shared:3 master:4 - tmpfs tmpfs rw,size=65536k\n"
      "24 21 0:7 / /mnt/my\\040shm rw - tmpfs lot rw,huge=advise\n"
      "25 21 0:8 / /run rw - tmpfs a rw,size=1k\n"
      "26 21 0:9 / /run rw - ramfs b rw\n";
  const auto type = [&](const char* directory) { return tool::mount_of(directory, mounts).type; };
  CHECK(type("/dev/shm") == "tmpfs");
  CHECK(type("/dev/shm/below") == "tmpfs");
  CHECK(type("/dev/shmoo") == "devtmpfs");
  CHECK(type("/home") == "ext4");
  CHECK(type("/run/lot") == "ramfs");
  CHECK(tool::mount_of("/mnt/my shm", mounts).options == "rw,huge=advise");
  CHECK(tool::mount_of("/dev/shm", mounts).point == "/dev/shm");
  CHECK(tool::mount_of("/dev/shm", "").type.empty());
  CHECK(tool::mount_of("/dev/shm", "nonsense\n- \n").type.empty());
}

TEST_CASE("a variable that is nearly one of LOT's is found, others are not") {
  CHECK(tool::misspelt_of({"LOT_SEGEMENT"}) ==
        std::vector<std::string>{"LOT_SEGEMENT: LOT_SEGMENT"});
  CHECK(tool::misspelt_of({"LOT_SIZES", "lot_DIR"}).size() == 1);
  CHECK(tool::misspelt_of({"LOT_SEGMENT", "LOT_DIR", "LOT_SIZE", "LOT_PERMISSIONS", "LOT_GROUP",
                           "LOT_USER", "LOT_PERSIST", "LOT_MLOCK", "LOT_QUEUE", "LOT_STAMP",
                           "LOT_FAST_LANE", "LOT_TEST_SEED", "PATH", ""})
            .empty());
}

TEST_CASE("logind removes files of an ordinary user, unless it is told not to") {
  const Room room;
  const std::string root = room.path();
  const auto removes = [&](unsigned user = 1000) {
    return tool::logind_removes_ipc(root, user, "ann");
  };
  CHECK(!removes());  // no logind
  std::filesystem::create_directories(root + "/run/systemd/seats");
  CHECK(removes());
  CHECK(!removes(0));
  CHECK(!removes(999));
  write(root + "/etc/systemd/logind.conf", "[Login]\n#RemoveIPC=yes\n");
  CHECK(removes());
  write(root + "/etc/systemd/logind.conf", "[Login]\nRemoveIPC=no\n");
  CHECK(!removes());
  write(root + "/etc/systemd/logind.conf.d/a.conf", "[Login]\nRemoveIPC=yes\n");
  CHECK(removes());
  write(root + "/var/lib/systemd/linger/ann", "");
  CHECK(!removes());
}

TEST_CASE("what a machine says in /proc and /sys is read") {
  const Room room;
  const Room segments;
  const std::string root = room.path();
  const auto look = [&] { return tool::look_at_machine(settings_for(segments.path()), root); };
  const Machine empty = look();
  CHECK(!empty.has_proc);
  CHECK(empty.available_bytes == lot::segment::kUnlimited);
  CHECK(empty.group_bytes == lot::segment::kUnlimited);
  CHECK(empty.huge_pages.empty());
  CHECK(empty.mount.type.empty());
  CHECK(empty.directory_error.empty());
  CHECK(empty.total_bytes > 0);
  CHECK(!empty.release.empty());
  write(root + "/proc/meminfo",
        "MemTotal: 99 kB\nMemAvailable:     2048 kB\nCommitLimit:  300 kB\nCommitted_AS: 100 kB\n");
  write(root + "/proc/sys/vm/overcommit_memory", "2\n");
  write(root + "/sys/kernel/mm/transparent_hugepage/shmem_enabled",
        "always within_size advise [never] deny force\n");
  write(root + "/proc/self/status", "Name:\tlot\nNSpid:\t7\nCapEff:\t0000000000804000\n");
  write(root + "/proc/self/mountinfo", "1 0 0:1 / / rw - tmpfs none rw\n");
  write(root + "/proc/self/cgroup", "0::/a\n");
  write(root + "/sys/fs/cgroup/a/memory.max", "4096\n");
  write(root + "/sys/fs/cgroup/a/pids.max", "100\n");
  write(root + "/sys/fs/cgroup/a/pids.current", "30\n");
  const Machine m = look();
  CHECK(m.group_threads == 70);
  CHECK(m.has_proc);
  CHECK(m.available_bytes == 2 * kMiB);
  CHECK(m.is_strict);
  CHECK(m.commit_left == 200 * 1024);
  CHECK(m.huge_pages == "never");
  CHECK(m.mount.type == "tmpfs");
  CHECK(m.group_bytes == 4096);
  CHECK(m.may_lock_memory);
  CHECK(m.may_be_real_time);
  CHECK(m.in_pid_namespace);
  write(root + "/proc/2/comm", "kthreadd\n");
  CHECK(!look().in_pid_namespace);
  write(root + "/proc/self/status", "NSpid:\t7\t1\nCapEff:\t0\n");
  CHECK(look().in_pid_namespace);
  CHECK(!look().may_lock_memory);
  write(root + "/proc/self/cgroup", "7:pids:/a/b\n3:cpu:/a\n");
  CHECK(look().group_threads == lot::segment::kUnlimited);
  for (const auto& [group, most] :
       {std::pair("a/b", "90"), std::pair("a", "50"), std::pair("", "max")}) {
    write(root + "/sys/fs/cgroup/pids/" + group + "/pids.max", most);
    write(root + "/sys/fs/cgroup/pids/" + group + "/pids.current", "40");
  }
  CHECK(look().group_threads == 10);
}

TEST_CASE("lot doctor sees the segments of a directory, and changes nothing") {
  const Watchdog watchdog(60);
  const Room room;
  const auto doctor = [&](std::vector<std::string> more) {
    more.insert(more.begin(), {"doctor", "--dir", room.path()});
    return run_lot(more);
  };
  Actor one(room.options("s"), "one");
  Actor two(room.options("s"), "two");
  stop(one.child());  // so that it reaps nobody
  const std::string path = room.path() + "/s";
  CHECK(finding_of(doctor({"--json"}).json(), "segment").at("verdict") == "ok");
  two.kill9();
  const auto bytes = bytes_of(path);
  const Ran ran = doctor({"--json"});
  CHECK(ran.exit == 1);
  const Json document = ran.json();
  CHECK(document.at("command") == "doctor");
  CHECK(document.at("exit") == 1);
  const Json finding = finding_of(document, "segment");
  CHECK(finding.at("verdict") == "warning");
  CHECK(finding.at("seen") == path + ": 1 process is dead and not reaped");
  CHECK(finding.at("advice") == "`lot clean --dir " + room.path() + " --segment s`");
  CHECK(doctor({}).out.find("warning  segment        " + path) != std::string::npos);
  CHECK(bytes == bytes_of(path));
  CHECK(room.files() == 2);
  one.child().send(SIGCONT);
}

TEST_CASE("lot doctor ends with 0 where all is well, and with 1 where it says what to change") {
  const Watchdog watchdog(60);
  const Room room;
  const auto doctor = [&] { return run_lot({"doctor", "--json", "--dir", room.path()}); };
  const Ran ran = doctor();
  bool is_well = true;
  const Json document = ran.json();
  for (const auto& finding : document.at("findings")) is_well &= finding.at("verdict") == "ok";
  CHECK(ran.exit == (is_well ? 0 : 1));
  for (const char* name : {"LOT_QUEUE", "LOT_STAMP", "LOT_FAST_LANE"}) {
    CAPTURE(name);
    const Variable wrong(name, "yes");
    CHECK(finding_of(doctor().json(), "environment").dump().find(name) != std::string::npos);
  }
  {
    const Variable size("LOT_SIZE", "many");
    CHECK(doctor().exit == 1);
    CHECK(finding_of(doctor().json(), "environment").at("verdict") == "problem");
    const Variable segment("LOT_SEGEMENT", "mine");
    const Variable directory("LOT_DRI", "/tmp");
    const std::string both = finding_of(doctor().json(), "environment").dump();
    for (const char* name :
         {"LOT_SIZE=many", "LOT_SEGEMENT", "LOT_SEGMENT", "LOT_DRI", "LOT_DIR"}) {
      CAPTURE(name);
      CHECK(both.find(name) != both.npos);
    }
  }
  REQUIRE(mkdir((room.path() + "/LOTROS").c_str(), 0700) == 0);
  CHECK(doctor().exit == 1);
  CHECK(finding_of(doctor().json(), "other_file").at("verdict") == "problem");
  const Ran none = run_lot({"doctor", "--json", "--dir", room.path() + "/none"});
  CHECK(none.exit == 1);
  CHECK(finding_of(none.json(), "directory").at("verdict") == "problem");
}

TEST_CASE("lot doctor names another user's lock file that is in the way" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(60);
  const Room room;
  const std::string lock = room.path() + "/LOTROS.lock";
  const auto found = [&] {
    return finding_of(run_lot({"doctor", "--json", "--dir", room.path()}).json(), "other_file");
  };
  CHECK(found().is_null());
  std::ofstream{lock};
  REQUIRE(chmod(lock.c_str(), 0600) == 0);
  CHECK(found().is_null());
  REQUIRE(chown(lock.c_str(), 65532, 65532) == 0);
  CHECK(found().at("verdict") == "problem");
  CHECK(found().at("seen").get<std::string>().find(lock + ": it belongs to uid 65532") == 0);
}

TEST_SUITE_END();
