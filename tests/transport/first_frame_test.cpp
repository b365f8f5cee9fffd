// SPDX-License-Identifier: Apache-2.0

// The first frames of a publisher: what is made ahead, for whom not, what becomes of it; memory
// that others have used, huge pages, mlock.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <memory>
#include <optional>
#include <random>
#include <sched.h>
#include <string>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/small_disk.hpp"
#include "support/users.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;

constexpr std::size_t kMiB = std::size_t{1} << 20;
constexpr std::size_t kFrame = 16 * kMiB;
/// What a thread may fault beside the frame: a page of its stack, code that it has not run yet.
constexpr long kFew = 32;

struct Frame {
  int number;
  lot::ShmVector<char> data;
};
struct Stereo {
  lot::ShmString note;
  lot::ShmVector<char> left;
  lot::ShmVector<char> right;
};
struct Plain {
  char data[4 * kMiB];
};

lot::transport::Pool& pool_of(const void* message) {
  lot::transport::Participant& p = *lot::transport::Participant::at(message);
  auto& segment = p.segment();
  const std::uint64_t at = segment.offset_of(message);
  const std::uint64_t granules = segment.granule_offset(0);
  const std::uint64_t block =
      at < granules ? (at - segment.offset_of(segment.small(0))) / lot::segment::kSmallBytes
                    : segment.granules().tag(
                          static_cast<std::uint32_t>((at - granules) / lot::segment::kGranule)) -
                          1;
  return p.holder().pool_of(static_cast<std::uint32_t>(block));
}

bool is_made(const lot::transport::Pool& pool) {
  return eventually([&] { return pool.has_ahead(); });
}

/// Faults of this thread in f().
template <class F>
long faults(F&& f) {
  rusage before{};
  getrusage(RUSAGE_THREAD, &before);
  f();
  rusage after{};
  getrusage(RUSAGE_THREAD, &after);
  return after.ru_minflt - before.ru_minflt;
}

lot::ShmUniquePtr<Frame> filled(lot::ShmPusher<Frame>& pusher, std::size_t bytes) {
  auto frame = pusher.loan();
  frame->data.resize(bytes);
  std::memset(frame->data.data(), 1, bytes);
  return frame;
}

/// Pushes one; the pool that it came from.
lot::transport::Pool& push(lot::ShmPusher<Frame>& pusher, std::size_t bytes) {
  auto frame = filled(pusher, bytes);
  lot::transport::Pool& pool = pool_of(frame.get());
  REQUIRE(pusher.push(std::move(frame)) == Status::Ok);
  return pool;
}

std::uint64_t taken(const lot::ShmEngine& engine) {
  struct stat status {};
  REQUIRE(stat(engine.path().c_str(), &status) == 0);
  return static_cast<std::uint64_t>(status.st_blocks) * 512;
}

/// A line of /proc/self/smaps, in KiB, of the mappings of that file.
long of_mapping(const std::string& path, const std::string& name) {
  std::ifstream smaps("/proc/self/smaps");
  std::string line;
  bool is_ours = false;
  long sum = 0;
  while (std::getline(smaps, line)) {
    if (line.find('-') < line.find(' ') && line.find(':') > line.find(' ')) {
      is_ours = line.size() >= path.size() &&
                line.compare(line.size() - path.size(), path.size(), path) == 0;
    }
    if (is_ours && line.rfind(name + ":", 0) == 0) sum += std::stol(line.substr(name.size() + 1));
  }
  return sum;
}

TEST_SUITE_BEGIN("transport");

TEST_CASE("the second frame of a publisher faults no page") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(256 * kMiB));
  auto pusher = engine.advertise<Frame>("frames");
  lot::transport::Pool& pool = push(pusher, kFrame);
  for (int i = 0; i < 3; ++i) {
    REQUIRE(is_made(pool));
    CHECK(faults([&] { push(pusher, kFrame); }) < kFew);
  }
}

TEST_CASE("a message of several pieces finds all of them") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(128 * kMiB));
  auto pusher = engine.advertise<Stereo>("stereo");
  const std::string note(1000, 'n');  // more than a block's small payload
  const auto build = [&] {
    auto pair = pusher.loan();
    pair->note = note;
    pair->left.resize(4 * kMiB);
    pair->right.resize(2 * kMiB);
    std::memset(pair->left.data(), 1, 4 * kMiB);
    std::memset(pair->right.data(), 1, 2 * kMiB);
    return pair;
  };
  auto first = build();
  lot::transport::Pool& pool = pool_of(first.get());
  must_go(pusher.push(std::move(first)));
  // The request for the second piece may come when the first one is made.
  REQUIRE(is_made(pool));
  CHECK(eventually([&] { return faults([&] { must_go(pusher.push(build())); }) < kFew; }));
}

TEST_CASE("a struct that is large by itself has its memory from advertise() on") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 * kMiB));
  lot::segment::Segment segment(engine.path());
  auto pusher = engine.advertise<Plain>("plain");
  REQUIRE(eventually([&] { return Audit(segment).granules >= sizeof(Plain) / 4096; }));
  auto warm_up = engine.make<Frame>();  // the code
  auto& pool = *[&] {
    auto probe = pusher.loan();
    auto* const p = &pool_of(probe.get());
    must_go(pusher.push(std::move(probe)));
    return p;
  }();
  REQUIRE(is_made(pool));
  std::vector<lot::ShmUniquePtr<Plain>> loans;
  for (int i = 0; i < 2; ++i) {
    REQUIRE(is_made(pool));
    CHECK(faults([&] {
            loans.push_back(pusher.loan());
            std::memset(loans.back()->data, 1, sizeof(Plain));
          }) < kFew);
    must_go(pusher.push(std::move(loans.back())));
  }
}

TEST_CASE("a vector that grows by steps leaves what it has at its end to be made") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(256 * kMiB));
  auto pusher = engine.advertise<Frame>("frames");
  auto frame = pusher.loan();
  for (std::size_t bytes = kMiB; bytes <= 8 * kMiB; bytes *= 2) frame->data.resize(bytes);
  lot::transport::Pool& pool = pool_of(frame.get());
  must_go(pusher.push(std::move(frame)));
  REQUIRE(is_made(pool));
  const std::uint64_t pushed = 8 * kMiB / 4096;
  CHECK(eventually([&] { return pool.has_ahead() && pool.granules() == 2 * pushed; }));
  CHECK(faults([&] { push(pusher, 8 * kMiB); }) < kFew);
}

TEST_CASE("what reserve() made suffices: nothing is made beside it") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(128 * kMiB));
  auto pusher = engine.advertise<Frame>("frames", {Policy::Overwrite, 2, {}});
  pusher.reserve(3, 4 * kMiB);
  lot::segment::Segment segment(engine.path());
  for (int i = 0; i < 5; ++i) {
    CHECK(faults([&] { push(pusher, 4 * kMiB); }) < kFew);
  }
  auto frame = pusher.loan();
  CHECK(!pool_of(frame.get()).has_ahead());
  CHECK(pool_of(frame.get()).granules() == 3 * 4 * kMiB / 4096);
}

TEST_CASE("what is made ahead stays within max_bytes, and leaves nothing of it unused") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(128 * kMiB));
  lot::PusherOptions options;
  options.max_bytes = 6 * kMiB;
  auto pusher = engine.advertise<Frame>("frames", options);
  for (int i = 0; i < 20; ++i) {
    lot::transport::Pool& pool = push(pusher, kMiB);
    CHECK(pool.granules() <= pool.limit());
    usleep(1000);
    CHECK(pool.granules() <= pool.limit());
  }
  lot::PullerOptions all;
  all.history = 64;
  CHECK(engine.subscribe<Frame>("frames", all).size() == 6);
}

TEST_CASE("nothing is made ahead where more than a quarter of what is free would go") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(64 * kMiB));
  auto large = engine.advertise<Frame>("large", {Policy::Overwrite, 2, {}});
  lot::transport::Pool& pool = push(large, 14 * kMiB);
  auto small = engine.advertise<Frame>("small", {Policy::Overwrite, 2, {}});
  // The thread goes through them in the order in which they came.
  REQUIRE(is_made(push(small, kMiB)));
  CHECK(!pool.has_ahead());
}

TEST_CASE("what is made ahead is the first that goes when memory is short") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(48 * kMiB));
  auto ours = engine.advertise<Frame>("ours", {Policy::Overwrite, 8, {}});
  lot::transport::Pool& pool = push(ours, 4 * kMiB);
  push(ours, 4 * kMiB);
  REQUIRE(is_made(pool));
  // All that is free, and half of what is ahead, in pieces that fit everywhere.
  const auto fill = [](lot::ShmEngine& by) {
    auto other = by.advertise<Frame>("other");
    const auto probe = other.loan();
    const auto& tags = lot::transport::Participant::at(probe.get())->segment().granules();
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    const std::uint64_t count = tags.count() - tags.used() + 512;
    for (std::uint64_t n = 0; n + 16 < count; n += 16) {
      loans.push_back(other.loan());
      loans.back()->data.resize(kMiB / 16);
    }
  };
  lot::PullerOptions latched;
  latched.history = 8;
  SUBCASE("to another publisher of the process") { fill(engine); }
  SUBCASE("to another process") {
    Child child([&] {
      lot::EngineOptions same;
      same.segment = std::filesystem::path(engine.path()).filename();
      lot::ShmEngine theirs(same);
      fill(theirs);
    });
    CHECK(child.wait() == 0);
  }
  CHECK(!pool.has_ahead());
  CHECK(engine.subscribe<Frame>("ours", latched).size() == 2);  // no message went for it
}

TEST_CASE("frames are made ahead again a second after memory was short, and not before") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(48 * kMiB));
  std::chrono::steady_clock::time_point before;  // the shortage
  {
    auto other = engine.advertise<Frame>("other");
    REQUIRE(is_made(push(other, 4 * kMiB)));
    std::vector<lot::ShmUniquePtr<Frame>> loans;
    try {
      for (;;) {
        before = std::chrono::steady_clock::now();
        loans.push_back(filled(other, 4 * kMiB));
      }
    } catch (const lot::OutOfMemory&) {
    }
  }
  for (bool made = false; !made;) {  // else the watchdog
    auto later = engine.advertise<Frame>("later");
    const lot::transport::Pool& pool = push(later, 4 * kMiB);
    made = eventually([&] { return pool.has_ahead(); }, 100ms);
  }
  CHECK(std::chrono::steady_clock::now() >= before + 1s);  // a machine at work may be later
}

TEST_CASE("what is made ahead and not loaned goes back") {
  const Watchdog watchdog(120);
  lot::ShmEngine engine(fresh(128 * kMiB));
  auto pusher = engine.advertise<Frame>("frames");
  lot::transport::Pool& pool = push(pusher, kFrame);
  REQUIRE(is_made(pool));
  const std::uint64_t before = taken(engine);
  CHECK(eventually([&] { return !pool.has_ahead(); }, 60s));
  CHECK(pool.granules() == kFrame / 4096);
  CHECK(eventually([&] { return taken(engine) + kFrame - 4 * kMiB <= before; }, 60s));
}

TEST_CASE("whenever a process leaves, what is being made ahead goes with it") {
  const Watchdog watchdog(100);
  std::mt19937_64 random(seed());
  const auto options = fresh(128 * kMiB);
  for (int round = 0; round < 40; ++round) {
    lot::ShmUniquePtr<Frame> outlives;
    {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Frame>("frames");
      push(pusher, 8 * kMiB);
      usleep(static_cast<useconds_t>(random() % 4000));
      push(pusher, 8 * kMiB);
      if (round % 2 == 0) outlives = pusher.loan();
      usleep(static_cast<useconds_t>(random() % 4000));
    }
    // It may still grow, and nothing is made for it.
    if (outlives) outlives->data.resize(kMiB);
    outlives.reset();
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a process that is killed while it makes a block leaves what the others repair") {
  const Watchdog watchdog(120);
  std::mt19937_64 random(seed());
  const auto options = fresh(128 * kMiB);
  lot::ShmEngine engine(options);
  lot::segment::Segment segment(engine.path());
  for (int round = 0; round < 30; ++round) {
    const Steps begun;
    Child child([&] {
      lot::ShmEngine theirs(options);
      for (;;) {
        auto pusher = theirs.advertise<Frame>("frames", {Policy::Overwrite, 2, {}});
        auto frame = pusher.loan();
        begun.tell();
        frame->data.resize(8 * kMiB);
        must_go(pusher.push(std::move(frame)));
        usleep(3000);
        must_go(pusher.push(pusher.loan()));
      }
    });
    REQUIRE(begun.next() != 0);
    usleep(static_cast<useconds_t>(random() % 12000));
    child.kill9();
    CHECK(eventually([&] {
      const Audit audit(segment);
      return audit.participants == 1 && audit.granules == 0 && audit.homes == 0;
    }));
    lot::transport::Participant::join(options)
        ->memory()
        .give_all_back_to_system();  // so that it is new
  }
}

TEST_CASE("a forked child has nothing of what its parent makes ahead, and ends") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(256 * kMiB));
  auto pusher = engine.advertise<Frame>("frames");
  for (int i = 0; i < 8; ++i) {
    push(pusher, kFrame);  // it makes one now
    Child child([&] {
      bool refused = false;
      try {
        (void)pusher.loan();  // it throws
      } catch (const lot::Error&) {
        refused = true;
      }
      must(refused, "the child is inert");
    });
    CHECK(child.wait() == 0);
  }
}

TEST_CASE("memory that another process has used is mapped when it is claimed") {
  const Watchdog watchdog(60);
  const auto options = fresh(64 * kMiB);
  lot::ShmEngine engine(options);
  Child child([&] {
    lot::ShmEngine theirs(options);
    auto pusher = theirs.advertise<Frame>("frames", {Policy::Overwrite, 2, {}});
    for (int i = 0; i < 3; ++i) filled(pusher, kFrame);
  });
  CHECK(child.wait() == 0);
  const std::uint64_t before = taken(engine);
  auto pusher = engine.advertise<Frame>("frames", {Policy::Overwrite, 2, {}});
  auto frame = pusher.loan();
  frame->data.resize(kFrame);
  CHECK(taken(engine) == before);
  CHECK(faults([&] { std::memset(frame->data.data(), 1, kFrame); }) < kFew);
}

/// From now on this process has a kernel without MADV_POPULATE_WRITE, as before Linux 5.14.
bool forget_populate() {
  constexpr std::uint32_t kPopulateWrite = 23;
  sock_filter filter[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_madvise, 0, 3),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, args[2])),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, kPopulateWrite, 0, 1),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EINVAL),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog program{6, filter};
  return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
         prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}

TEST_CASE("where the kernel can not map at once, each page is touched") {
  const Watchdog watchdog(60);
  Child child([&] {
    must(forget_populate(), "a filter");
    lot::ShmEngine engine(fresh(256 * kMiB));
    auto pusher = engine.advertise<Frame>("frames");
    auto frame = filled(pusher, kFrame);
    lot::transport::Pool& pool = pool_of(frame.get());
    must(pusher.push(std::move(frame)) == Status::Ok, "pushed");
    must(is_made(pool), "made");
    must(faults([&] { filled(pusher, kFrame); }) < kFew, "no faults");
  });
  CHECK(child.wait() == 0);
}

TEST_CASE("a file system that has huge pages gives one for each unit, and takes it back") {
  const Watchdog watchdog(60);
  std::string huge;
  SUBCASE("to all") { huge = "always"; }
  SUBCASE("to who asks") { huge = "advise"; }
  SUBCASE("within the file") { huge = "within_size"; }
  const SmallDisk disk("size=256m,huge=" + huge);
  if (disk.path.empty()) {
    MESSAGE("skipped: no huge pages here");
    return;
  }
  lot::EngineOptions options = fresh(128 * kMiB);
  options.directory = disk.path;
  {
    lot::ShmEngine engine(options);
    auto pusher = std::make_optional(engine.advertise<Frame>("frames", {Policy::Overwrite, 2, {}}));
    const auto participant = lot::transport::Participant::join(options);
    CHECK(reinterpret_cast<std::uintptr_t>(participant->segment().base()) % lot::segment::kUnit ==
          0);
    push(*pusher, kFrame);
    const long mapped = of_mapping(engine.path(), "ShmemPmdMapped");
    if (mapped == 0) {
      MESSAGE("skipped: no huge pages here");
      return;
    }
    CHECK(mapped >= 14 * 1024);  // KiB, of whole units in the frame
    pusher.reset();
    const std::uint64_t before = taken(engine);
    CHECK(participant->memory().give_all_back_to_system() >= 14 * kMiB);
    CHECK(taken(engine) + 14 * kMiB <= before);
    CHECK(of_mapping(engine.path(), "ShmemPmdMapped") <= mapped - 14 * 1024);
  }
}

TEST_CASE("memory under lock_memory is locked where it was touched, and stays") {
  const Watchdog watchdog(100);
  lot::EngineOptions options = fresh(64 * kMiB);
  options.lock_memory = true;
  std::optional<lot::ShmEngine> engine;
  try {
    engine.emplace(options);
  } catch (const lot::Error& e) {
    CHECK(std::string(e.what()).find("RLIMIT_MEMLOCK") != std::string::npos);
    MESSAGE("skipped: so much memory may not be locked here");
    return;
  }
  CHECK(taken(*engine) < 16 * kMiB);  // sparse as ever
  auto pusher = engine->advertise<Frame>("frames", {Policy::Overwrite, 1, {}});
  lot::transport::Pool& pool = push(pusher, 8 * kMiB);
  CHECK(of_mapping(engine->path(), "Locked") >= 8 * 1024);
  REQUIRE(is_made(pool));
  const auto participant = lot::transport::Participant::join(options);
  CHECK(!participant->segment().can_give_back());
  // Of an idle process blocks would go after five looks.
  std::this_thread::sleep_for(8s);
  CHECK(pool.has_ahead());
  CHECK(faults([&] { push(pusher, 8 * kMiB); }) < kFew);
  // Others that are short of memory get it all the same.
  participant->stock().trim(lot::transport::Stock::kNobody);
  CHECK(!pool.has_ahead());
}

TEST_CASE("a process that asks for LOT_MLOCK and may not lock so much is told of the limit" *
          doctest::skip(!can_be_ordinary_user())) {
  const Watchdog watchdog(60);
  Child child([&] {
    const rlimit little{64 << 10, 64 << 10};
    must(setrlimit(RLIMIT_MEMLOCK, &little) == 0, "a limit");
    if (geteuid() == 0) must(setresuid(65534, 65534, 65534) == 0, "another user");
    lot::EngineOptions options = fresh(64 * kMiB);
    must(setenv("LOT_MLOCK", "1", 1) == 0, "an environment");
    std::string what;
    try {
      lot::ShmEngine engine(options);
    } catch (const lot::Error& e) {
      what = e.what();
    }
    must(what.find("RLIMIT_MEMLOCK is 64 KiB") != std::string::npos, "the limit is named");
    must(what.find("ulimit -l") != std::string::npos, "what helps is said");
    must(files_of(options) == 0, "no file is left");
    must(setenv("LOT_MLOCK", "perhaps", 1) == 0, "an environment");
    try {
      lot::ShmEngine engine(options);
    } catch (const lot::Error& e) {
      what = e.what();
    }
    must(what.find("LOT_MLOCK=perhaps") != std::string::npos, "a wrong word is named");
  });
  CHECK(child.wait() == 0);
}

TEST_SUITE_END();

/// The thread of this process with that name; 0: there is none.
pid_t thread_named(const std::string& name) {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string of;
    std::ifstream comm(task.path() / "comm");
    if (std::getline(comm, of) && of == name) return std::stoi(task.path().filename().string());
  }
  return 0;
}

TEST_CASE("the thread that makes frames ahead runs on all cores, not on its publisher's alone") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh(128 * kMiB));
  cpu_set_t all;
  REQUIRE(sched_getaffinity(0, sizeof(all), &all) == 0);
  std::thread publisher([&] {
    cpu_set_t one;
    CPU_ZERO(&one);
    for (int c = 0; CPU_COUNT(&one) == 0; ++c) {
      if (CPU_ISSET(c, &all)) CPU_SET(c, &one);
    }
    must(sched_setaffinity(0, sizeof(one), &one) == 0, "one core");
    auto pusher = engine.advertise<Frame>("/frames");
    push(pusher, kFrame);
    must(eventually([&] { return thread_named("lot-ahead") != 0; }), "it is there");
    must(eventually([&] {
           cpu_set_t its;
           return sched_getaffinity(thread_named("lot-ahead"), sizeof(its), &its) == 0 &&
                  CPU_EQUAL(&its, &all);
         }),
         "on all cores");
  });
  publisher.join();
}

}  // namespace
