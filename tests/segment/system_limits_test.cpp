// SPDX-License-Identifier: Apache-2.0

// What the system lets a process have: too little is an error that names the limit, and leaves
// nothing behind.

#include "segment/system_limits.hpp"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/death_notice.hpp"
#include "segment/segment.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "support/sanitizers.hpp"
#include "support/users.hpp"

namespace {

using namespace lot::testing;
namespace fs = std::filesystem;
using lot::segment::kUnlimited;
using lot::segment::memory_limit;

constexpr std::uint64_t kMiB = 1 << 20;

struct Frame {
  lot::ShmVector<std::uint8_t> data;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

bool files_are_left(const lot::EngineOptions& options) {
  for (const auto& entry : fs::directory_iterator(options.directory)) {
    if (entry.path().filename().string().rfind(options.segment, 0) == 0) return true;
  }
  return false;
}

void limit(__rlimit_resource resource, std::uint64_t value) {
  const rlimit both{value, value};
  must(setrlimit(resource, &both) == 0, "a limit");
}

/// What joining gives in a process that has such a limit.
template <class Limit>
void check_refused(const lot::EngineOptions& options, Limit&& limits, int number,
                   const char* part) {
  Child child([&] {
    limits();
    const auto [error, text] = error_of([&] { const lot::ShmEngine engine(options); });
    must(error == number && names(text, part), text.c_str());
  });
  CHECK(child.wait() == 0);
  CHECK_FALSE(files_are_left(options));
}

/// A tree of control groups, as the kernel shows it.
class Groups {
 public:
  Groups() { fs::create_directories(root_); }
  ~Groups() { fs::remove_all(root_); }
  Groups(const Groups&) = delete;
  Groups& operator=(const Groups&) = delete;

  void write(const std::string& file, const std::string& text) const {
    fs::create_directories(fs::path(root_ + "/" + file).parent_path());
    std::ofstream(root_ + "/" + file) << text << "\n";
  }
  std::uint64_t limit() const { return memory_limit(root_ + "/self", root_); }

 private:
  const std::string root_ = fs::temp_directory_path() / unique_name();
};

/// A control group of the kernel's, of version 1 or 2, with a limit of memory.
class RealGroup {
 public:
  explicit RealGroup(std::uint64_t bytes) {
    for (const auto& [mount, file] : {std::pair("/sys/fs/cgroup/memory", "memory.limit_in_bytes"),
                                      std::pair("/sys/fs/cgroup", "memory.max")}) {
      path_ = std::string(mount) + "/" + unique_name();
      if (fs::exists(std::string(mount) + "/cgroup.procs") && mkdir(path_.c_str(), 0755) == 0) {
        if (write(file, std::to_string(bytes))) return;
        rmdir(path_.c_str());
      }
      path_.clear();
    }
  }
  ~RealGroup() {
    if (is_there()) CHECK(eventually([&] { return rmdir(path_.c_str()) == 0; }));
  }
  RealGroup(const RealGroup&) = delete;
  RealGroup& operator=(const RealGroup&) = delete;

  bool is_there() const { return !path_.empty(); }
  bool enter() const { return write("cgroup.procs", std::to_string(getpid())); }

 private:
  bool write(const std::string& file, const std::string& text) const {
    std::ofstream out(path_ + "/" + file);
    out << text << std::flush;
    return out.good();
  }

  std::string path_;
};

}  // namespace

TEST_SUITE_BEGIN("system_limits");

TEST_CASE("a limit of a file's size is an error that names it, not a signal") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.size_bytes = 64 * kMiB;
  check_refused(
      options, [] { limit(RLIMIT_FSIZE, 32 * kMiB); }, EFBIG, "RLIMIT_FSIZE");
  options.size_bytes = 0;
  check_refused(
      options, [] { limit(RLIMIT_FSIZE, kMiB); }, ENOSPC, "a file of this process may have 1 MiB");
  check_refused(
      options, [] { limit(RLIMIT_FSIZE, 1000 << 10); }, ENOSPC,
      "a file of this process may have 1000 KiB (No space left on device); raise RLIMIT_FSIZE");
}

TEST_CASE("a segment of the default size fits the limit of a file's size") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.size_bytes = 0;
  Child child([&] {
    limit(RLIMIT_FSIZE, 100 * kMiB);
    const lot::ShmEngine engine(options);
    must(fs::file_size(engine.path()) == 100 * kMiB, "its size");
  });
  CHECK(child.wait() == 0);
  CHECK_FALSE(files_are_left(options));
}

TEST_CASE("a process with such a limit works in a segment that another one has made") {
  const Watchdog watchdog(60);
  const auto options = fresh(64 * kMiB);
  const lot::ShmEngine engine(options);
  Child child([&] {
    limit(RLIMIT_FSIZE, kMiB);
    lot::ShmEngine mine(options);
    auto pusher = mine.advertise<Frame>("/t");
    auto frame = pusher.loan();
    frame->data.resize(16 * kMiB);
    std::memset(frame->data.data(), 1, frame->data.size());
    must(pusher.push(std::move(frame)) == lot::Status::Ok, "a message");
  });
  CHECK(child.wait() == 0);
}

TEST_CASE("too few descriptors are an error that says so, and of no other user") {
  const Watchdog watchdog(60);
  auto options = fresh();
  Child child([&] {
    const auto joins = [&](std::uint64_t descriptors) {
      limit(RLIMIT_NOFILE, descriptors);
      return error_of([&] { const lot::ShmEngine engine(options); });
    };
    const int next = dup(STDIN_FILENO);
    close(next);
    // With more and more of them, from the highest number on that a limit may be raised to.
    for (auto n = static_cast<std::uint64_t>(next); n < static_cast<std::uint64_t>(next) + 8; ++n) {
      Child one([&] {
        const auto [error, text] = joins(n);
        if (text == "no error") return;
        must(error == EMFILE && names(text, "ulimit -n"), text.c_str());
        must(!names(text, "user"), text.c_str());
      });
      must(one.wait() == 0, "an error that says so");
    }
  });
  CHECK(child.wait() == 0);
  CHECK_FALSE(files_are_left(options));
}

TEST_CASE("too few threads are an error that says so") {
  const Watchdog watchdog(60);
  if (getuid() != 0) {
    MESSAGE("skipped: the limit is of a user, who may have other processes");
    return;
  }
  if (!can_be_another_user()) return;
  auto options = fresh();
  options.permissions = 0666;
  constexpr uid_t kUser = 64123;  // nobody's: it has no other process
  for (const std::uint64_t threads : {std::uint64_t{1}, std::uint64_t{2}}) {
    CAPTURE(threads);
    Child child([&] {
      must(setgid(kUser) == 0 && setuid(kUser) == 0, "a user");
      limit(RLIMIT_NPROC, threads);
      const auto [error, text] = error_of([&] { const lot::ShmEngine engine(options); });
      must(error == EAGAIN && names(text, "ulimit -u"), text.c_str());
    });
    CHECK(child.wait() == 0);
    CHECK_FALSE(files_are_left(options));
  }
}

TEST_CASE("too little address space is an error that names the limit" *
          doctest::skip(kIsSanitized)) {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.size_bytes = 512 * kMiB;
  check_refused(
      options, [] { limit(RLIMIT_AS, 256 * kMiB); }, ENOMEM, "RLIMIT_AS (ulimit -v) is");
}

TEST_CASE("a joiner without room for a segment is not told to make it smaller at once" *
          doctest::skip(kIsSanitized)) {
  const Watchdog watchdog(60);
  const auto options = fresh(512 * kMiB);
  const lot::ShmEngine engine(options);
  Child child([&] {
    const auto joins = [&] { return error_of([&] { const lot::ShmEngine mine(options); }); };
    limit(RLIMIT_AS, 256 * kMiB);
    const auto [error, text] = joins();
    must(error == ENOMEM && names(text,
                                  "RLIMIT_AS (ulimit -v) is 256 MiB: raise it, or have the "
                                  "segment made anew with a smaller LOT_SIZE, when all that "
                                  "use it have ended"),
         text.c_str());
  });
  CHECK(child.wait() == 0);
}

TEST_CASE("too little memory for the threads is an error that names the limit" *
          doctest::skip(kIsSanitized)) {
  const Watchdog watchdog(60);
  auto options = fresh();
  int refused = 0;
  for (const std::uint64_t mib : {1U, 4U, 8U, 12U}) {
    CAPTURE(mib);
    Child child([&] {
      limit(RLIMIT_DATA, mib * kMiB);
      const auto [error, text] = error_of([&] { const lot::ShmEngine engine(options); });
      if (text == "no error") return;
      must(error == ENOMEM || error == EAGAIN, text.c_str());
      must(names(text, "RLIMIT_DATA (ulimit -d) is"), text.c_str());
      _exit(7);
    });
    refused += child.wait() == 7;
    CHECK_FALSE(files_are_left(options));
  }
  CHECK(refused > 0);
}

TEST_CASE("advice names the limits that are set, each, and no other") {
  const Watchdog watchdog(60);
  Child child([] {
    rlimit space{};
    must(getrlimit(RLIMIT_AS, &space) == 0, "a limit");
    const std::string before =
        space.rlim_cur == RLIM_INFINITY
            ? ""
            : "RLIMIT_AS (ulimit -v) is " + lot::segment::size_text(space.rlim_cur) + ", ";
    limit(RLIMIT_DATA, std::uint64_t{1} << 50);  // enough for every build of the test
    const std::string data = before + "RLIMIT_DATA (ulimit -d) is 1073741824 MiB";
    std::string text = lot::segment::advice_on_address_space();
    must(text.rfind(data + ": raise it", 0) == 0, text.c_str());
    limit(RLIMIT_NPROC, 100);
    text = lot::segment::advice_on_threads();
    must(text == data +
                     ", RLIMIT_NPROC (ulimit -u) is 100: raise it, or pids.max of the control "
                     "group",
         text.c_str());
  });
  CHECK(child.wait() == 0);
}

TEST_CASE("a full segment of the most processes does not say to ask for more") {
  const Watchdog watchdog(60);
  for (const std::uint32_t processes : {2U, 319U}) {
    CAPTURE(processes);
    auto options = fresh();
    options.processes = processes;
    const lot::ShmEngine engine(options);
    lot::segment::Segment segment(engine.path());
    std::vector<std::uint64_t> before;
    for (auto& witness : segment.witnesses()) {
      before.push_back(witness.seat.load());
      if (!lot::liveness::seat::stands(before.back()))
        lot::test::raw(witness.seat) = lot::liveness::seat::make(1, 2);
    }
    Child other([&] {
      const auto [error, text] = error_of([&] { const lot::ShmEngine mine(options); });
      must(error == EUSERS, text.c_str());
      must(names(text, "a larger EngineOptions::processes") == (processes == 2), text.c_str());
      must(names(text, "EngineOptions::processes is at its maximum") == (processes != 2),
           text.c_str());
      must(names(text, "use several segments"), text.c_str());
    });
    CHECK(other.wait() == 0);
    for (std::size_t k = 0; k < before.size(); ++k)
      lot::test::raw(segment.witnesses()[k].seat) = before[k];
  }
}

TEST_CASE("the memory limit of a control group is that of the strictest one above it") {
  const Groups groups;
  CHECK(groups.limit() == kUnlimited);
  groups.write("self", "0::/a/b");
  CHECK(groups.limit() == kUnlimited);
  groups.write("a/b/memory.max", "max");
  CHECK(groups.limit() == kUnlimited);
  groups.write("a/memory.max", "1073741824");
  CHECK(groups.limit() == 1073741824);
  groups.write("a/b/memory.max", "536870912");
  CHECK(groups.limit() == 536870912);
  groups.write("memory.max", "4096");  // a container sees its own group as the mount
  CHECK(groups.limit() == 4096);
}

TEST_CASE("the same in version 1, where each controller has a tree of its own") {
  const Groups groups;
  groups.write("self", "4:cpu,cpuacct:/x\n3:memory:/job\n0::/");
  groups.write("memory/job/memory.limit_in_bytes", "268435456");
  groups.write("memory/memory.limit_in_bytes", "9223372036854771712");
  CHECK(groups.limit() == 268435456);
}

TEST_CASE("in a control group with little memory a segment of the default size takes half of it") {
  const Watchdog watchdog(60);
  const RealGroup group(256 * kMiB);
  if (!group.is_there()) {
    MESSAGE("skipped: no control group can be made here");
    return;
  }
  auto options = fresh();
  options.size_bytes = 0;
  Child child([&] {
    must(group.enter(), "a member of the group");
    must(memory_limit() == 256 * kMiB, "its limit");
    const lot::ShmEngine engine(options);
    must(fs::file_size(engine.path()) == 128 * kMiB, "its size");
  });
  CHECK(child.wait() == 0);

  options.size_bytes = 512 * kMiB;
  const std::string said = fs::temp_directory_path() / unique_name();
  Child warned([&] {
    must(group.enter(), "a member of the group");
    must(freopen(said.c_str(), "w", stderr) != nullptr, "a file for what it says");
    const lot::ShmEngine engine(options);
    std::fflush(stderr);
  });
  CHECK(warned.wait() == 0);
  std::string text;
  std::ifstream file(said);
  std::getline(file, text);
  CHECK_MESSAGE(names(text, "the processes of this control group may have 256 MiB"), text);
  fs::remove(said);
  CHECK_FALSE(files_are_left(options));
}

TEST_SUITE_END();
