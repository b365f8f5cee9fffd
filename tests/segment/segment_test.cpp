// SPDX-License-Identifier: Apache-2.0

// A segment is absent or complete, and what can not be a segment is an error that says what to do.

#include "segment/segment.hpp"

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <string>
#include <sys/mount.h>
#include <sys/stat.h>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/local_segment.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/small_disk.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;

struct Frame {
  std::uint64_t number;
  lot::ShmVector<std::uint64_t> data;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// The text of the lot::Error that joining gives, or "" when it works.
std::string refusal(const lot::EngineOptions& options) {
  try {
    const lot::ShmEngine engine(options);
  } catch (const lot::Error& e) {
    return e.what();
  }
  return "";
}
bool says(const std::string& text, const std::string& what) {
  return text.find(what) != std::string::npos;
}

/// A directory that is not in shared memory.
struct Directory {
  Directory() { std::filesystem::create_directory(path); }
  ~Directory() { std::filesystem::remove_all(path); }
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;
  const std::string path = std::filesystem::temp_directory_path() / unique_name();
};

lot::PullerOptions latched(std::uint64_t history) {
  lot::PullerOptions options;
  options.history = history;
  return options;
}

std::string file_of(const lot::EngineOptions& options) {
  return options.directory + "/" + options.segment;
}
void overwrite(const std::string& path, std::streamoff at, std::uint32_t value) {
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  file.seekp(at);
  file.write(reinterpret_cast<const char*>(&value), sizeof(value));
}

}  // namespace

TEST_SUITE_BEGIN("segment");

TEST_CASE("processes that start at once find the segment absent or complete") {
  const Watchdog watchdog(60);
  for (int round = 0; round < 10; ++round) {
    const auto options = fresh(16 << 20);
    Steps go;
    std::vector<Child> nodes;
    for (int n = 0; n < 6; ++n) {
      nodes.emplace_back([&] {
        go.next();
        const lot::ShmEngine engine(options);
        must(lot::segment::Segment(engine.path()).size() == 16 << 20, "a complete segment");
      });
    }
    for (int n = 0; n < 6; ++n) go.tell();
    for (auto& node : nodes) CHECK(node.wait() == 0);
    REQUIRE(files_of(options) == 0);
  }
}

TEST_CASE("a creator that is killed leaves nothing that the next one stumbles over") {
  const Watchdog watchdog(60);
  std::mt19937_64 random(seed());
  for (int round = 0; round < 30; ++round) {
    const auto options = fresh(64 << 20);
    Child creator([&] { const lot::ShmEngine engine(options); });
    usleep(static_cast<useconds_t>(random() % 4000));
    creator.kill9();
    CHECK(refusal(options) == "");
    REQUIRE(files_of(options) == 0);
  }
}

TEST_CASE("a file that is no segment is named and never touched") {
  for (const char* content : {"", "x",
                              "this is a text of mine that nobody may remove, and it is "
                              "longer than a header would be, by some bytes at least: so "
                              "there is enough to look at, and no magic is in it at all"}) {
    const auto options = fresh();
    std::ofstream(file_of(options)) << content;
    const std::string text = refusal(options);
    CHECK(says(text, file_of(options).c_str()));
    CHECK(says(text, "remove it if it is yours"));
    std::string still;
    std::getline(std::ifstream(file_of(options)), still);
    CHECK(still == content);
    CHECK(files_of(options) == 1);  // and no lock file beside it
    std::filesystem::remove(file_of(options));
    std::filesystem::remove(file_of(options) + ".lock");
  }
}

TEST_CASE("what another version or a crash left is replaced when no process uses it") {
  const Watchdog watchdog(60);
  for (const int how : {0, 1, 2, 3}) {
    CAPTURE(how);
    auto options = fresh();
    options.persist = true;
    { const lot::ShmEngine engine(options); }
    CHECK(files_of(options) == 2);
    options.persist = false;
    if (how == 0) std::filesystem::resize_file(file_of(options), 8 << 20);
    if (how == 1) overwrite(file_of(options), 8, 999);     // layout version
    if (how == 2) overwrite(file_of(options), 40, 12345);  // boot
    if (how == 3) options.size_bytes = 32 << 20;
    CHECK(refusal(options) == "");
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a segment that knows of no boot stays where the system tells of its own") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.persist = true;
  const auto instance = [&] {
    struct stat status {};
    return stat(file_of(options).c_str(), &status) == 0 ? status.st_ino : 0;
  };
  { const lot::ShmEngine engine(options); }
  const ino_t before = instance();
  overwrite(file_of(options), 40, 0);  // boot
  overwrite(file_of(options), 44, 0);
  { const lot::ShmEngine engine(options); }
  CHECK(instance() == before);
  options.persist = false;
  overwrite(file_of(options), 8, 999);  // layout version: the next process makes it anew
  { const lot::ShmEngine engine(options); }
  CHECK(files_of(options) == 0);
}

TEST_CASE("with persist a segment stays, whichever process leaves last") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  auto kept = options;
  kept.persist = true;
  SUBCASE("the one that asked leaves first") {
    std::optional<lot::ShmEngine> other(options);
    Child asking([&] { const lot::ShmEngine engine(kept); });
    CHECK(asking.wait() == 0);
    other.reset();
  }
  SUBCASE("the one that asked is killed, and reaped") {
    lot::ShmEngine other(options);
    Steps joined;
    Child asking([&] {
      const lot::ShmEngine engine(kept);
      joined.tell();
      pause();
    });
    REQUIRE(joined.next() == '.');
    asking.kill9();
    lot::segment::Segment segment(other.path());
    CHECK(eventually([&] { return Audit(segment).participants == 1; }));
  }
  SUBCASE("it asks when it is there already") {
    const lot::ShmEngine first(options);
    const lot::ShmEngine second(kept);
  }
  SUBCASE("it asks by the environment") {
    const Variable persist("LOT_PERSIST", "1");
    const lot::ShmEngine engine(options);
  }
  CHECK(files_of(options) == 2);
  { const lot::ShmEngine visitor(options); }
  CHECK(files_of(options) == 2);
  // What was asked of a segment is not asked of the next one.
  overwrite(file_of(options), 40, 12345);  // boot
  { const lot::ShmEngine next(options); }
  CHECK(files_of(options) == 0);
}

TEST_CASE("LOT_PERSIST in the environment comes before the code, and is 1 or 0") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.persist = true;
  {
    const Variable persist("LOT_PERSIST", "0");
    CHECK(refusal(options) == "");
  }
  CHECK(files_of(options) == 0);
  for (const char* bad : {"perhaps", "yes", "2", "01", " 1"}) {
    CAPTURE(bad);
    const Variable persist("LOT_PERSIST", bad);
    CHECK(says(refusal(options), std::string("LOT_PERSIST=") + bad));
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("after a restart of the machine nothing is left of what lay on a disk") {
  const Watchdog watchdog(60);
  const Directory disk;
  auto options = fresh();
  options.directory = disk.path;
  options.persist = true;
  Child before([&] {
    lot::ShmEngine engine(options);
    auto out = engine.advertise<std::uint64_t>("/number");
    for (std::uint64_t n = 0; n < 10; ++n) must_go(out.push(out.loan(n)));
    auto in = engine.subscribe<std::uint64_t>("/number", latched(10));
    const auto kept = in.try_pull();
    must(kept && in.publishers() == 1, "a message");
    kill(getpid(), SIGKILL);  // and the machine with it: nothing is left to reap
  });
  before.wait();
  REQUIRE(files_of(options) == 2);
  overwrite(file_of(options), 40, 12345);  // the boot's number is another one
  {
    lot::ShmEngine engine(options);
    auto in = engine.subscribe<std::uint64_t>("/number", latched(10));
    CHECK(in.publishers() == 0);
    CHECK_FALSE(in.try_pull());
    auto out = engine.advertise<std::uint64_t>("/number");
    must_go(out.push(out.loan(77U)));
    const auto seen = in.try_pull();
    REQUIRE(seen);
    CHECK(*seen == 77);
    CHECK(in.missed_total() == 0);
    lot::segment::Segment segment(engine.path());
    CHECK(Audit(segment).participants == 1);
  }
}

TEST_CASE("a segment in use of another version or size is an error that says so") {
  constexpr std::uint32_t kVersion = lot::segment::kLayoutVersion;
  const Watchdog watchdog(60);
  const auto options = fresh();
  const lot::ShmEngine engine(options);
  Child other([&] {
    auto bigger = options;
    bigger.size_bytes = 128 << 20;
    const std::string text = refusal(bigger);
    must(says(text, "64 MiB") && says(text, "128 MiB were asked for"), "both sizes");
    must(says(text, "in use") && says(text, "LOT_SIZE"), "the advice");
    auto any = options;
    any.size_bytes = 0;
    must(refusal(any) == "", "no size means any");
    const lot::ShmEngine mine(options);
    must(refusal(bigger) == text, "a process that has it open already is told the same");
    must(refusal(options) == "" && refusal(any) == "", "its own size, or any, is no error");
  });
  CHECK(other.wait() == 0);
  overwrite(engine.path(), 8, 999);
  Child newer([&] {
    const std::string text = refusal(options);
    must(says(text, "layout version 999") &&
             says(text, "this library has " + std::to_string(kVersion)),
         "both versions");
    must(says(text, "in use"), "why it can not be replaced");
  });
  CHECK(newer.wait() == 0);
  overwrite(engine.path(), 8, kVersion);
  CHECK(files_of(options) == 2);
}

TEST_CASE("bad names, sizes and permissions are refused, and leave nothing") {
  auto options = fresh();
  const auto with_name = [&](const std::string& name) {
    auto o = options;
    o.segment = name;
    return refusal(o);
  };
  for (const std::string& bad :
       {std::string(), std::string(".."), std::string("a/b"), std::string(".hidden"),
        std::string("a b"), std::string("\xc3\xa4"), std::string(101, 'x'), std::string("a\0b", 3),
        std::string("a.lock"), std::string("a.new")}) {
    CHECK(says(with_name(bad), "not a name for a segment"));
  }
  for (const char* bad : {"x", "12Q", "-5", "0", "5MM", "99999999999G", "18446744073709551616",
                          "1.5G", "M", " ", "+-3"}) {
    CAPTURE(bad);
    const Variable size("LOT_SIZE", bad);
    CHECK(says(refusal(options), "LOT_SIZE"));
  }
  for (const char* bad : {"x", "888", "0777", "0060", "-1", "01666", "600 "}) {
    CAPTURE(bad);
    const Variable permissions("LOT_PERMISSIONS", bad);
    CHECK(says(refusal(options), "LOT_PERMISSIONS"));
  }
  {
    const Variable size("LOT_SIZE", "1M");
    CHECK(says(refusal(options), "raise LOT_SIZE"));
  }
  {
    const Variable size("LOT_SIZE", "1000000G");
    CHECK(says(refusal(options), "lower LOT_SIZE"));
  }
  for (auto member :
       {&lot::EngineOptions::processes, &lot::EngineOptions::blocks, &lot::EngineOptions::topics,
        &lot::EngineOptions::channels, &lot::EngineOptions::readers}) {
    for (const std::uint32_t value : {0U, 0xffffffffU}) {
      auto o = options;
      o.*member = value;
      CHECK(says(refusal(o), "out of range"));
    }
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("LOT_SEGMENT, LOT_SIZE and LOT_PERMISSIONS in the environment come before the code") {
  auto options = fresh();
  const std::string name = unique_name();
  const Variable segment("LOT_SEGMENT", name.c_str());
  const Variable size("LOT_SIZE", "32M");
  const Variable permissions("LOT_PERMISSIONS", "0660");
  const lot::ShmEngine engine(options);
  CHECK(engine.path() == options.directory + "/" + name);
  struct stat status {};
  REQUIRE(stat(engine.path().c_str(), &status) == 0);
  CHECK(status.st_size == 32 << 20);
  CHECK((status.st_mode & 07777) == 0660);
  REQUIRE(stat((engine.path() + ".lock").c_str(), &status) == 0);
  CHECK((status.st_mode & 07777) == 0660);
}

TEST_CASE("a directory that is absent, no directory or read-only is named with an advice") {
  auto options = fresh();
  options.directory = "/nonexistent/lot";
  CHECK(says(refusal(options), "LOT_DIR"));
  options.directory = "/proc/version";
  CHECK(says(refusal(options), "LOT_DIR"));
  const SmallDisk disk("size=64m,ro");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  options.directory = disk.path;
  const std::string text = refusal(options);
  CHECK(says(text, "read-only"));
  CHECK(says(text, "LOT_DIR"));
}

TEST_CASE("a segment in a directory that is mounted read-only: no other directory is advised") {
  const SmallDisk disk("size=64m");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  auto options = fresh();
  options.directory = disk.path;
  options.size_bytes = 16 << 20;
  options.persist = true;
  { const lot::ShmEngine engine(options); }
  REQUIRE(mount("", disk.path.c_str(), nullptr, MS_REMOUNT | MS_RDONLY, nullptr) == 0);
  const std::string text = refusal(options);
  CHECK(says(text, "mounted read-only"));
  CHECK_FALSE(says(text, "LOT_DIR"));
}

TEST_CASE("links are not followed") {
  const auto options = fresh();
  const std::string elsewhere = "/tmp/" + options.segment;
  std::ofstream(elsewhere) << "mine";
  for (const char* suffix : {"", ".lock"}) {
    std::filesystem::create_symlink(elsewhere, file_of(options) + suffix);
    CHECK(says(refusal(options), file_of(options).c_str()));
    std::string still;
    std::getline(std::ifstream(elsewhere), still);
    CHECK(still == "mine");
    std::filesystem::remove(file_of(options) + suffix);
  }
  std::filesystem::remove(elsewhere);
  std::filesystem::remove(file_of(options) + ".lock");
}

TEST_CASE("a directory of 64 MB, as Docker's, works with what is there") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=64m");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  auto options = fresh(0);
  options.directory = disk.path;
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t", {lot::Policy::Overwrite, 1, 1s});
    auto puller = engine.subscribe<Frame>("/t");
    for (int round = 0; round < 3; ++round) {
      std::vector<lot::ShmUniquePtr<Frame>> frames;
      for (;;) {
        REQUIRE(frames.size() < 5);
        auto frame = pusher.loan();
        try {
          frame->data.resize((16 << 20) / 8);
        } catch (const lot::OutOfMemory& e) {
          CHECK(says(e.what(), "LOT_SIZE"));
          break;
        }
        std::fill(frame->data.begin(), frame->data.end(), 5);
        frames.push_back(std::move(frame));
      }
      CHECK(!frames.empty());
      for (auto& frame : frames) {
        CHECK(pusher.push(std::move(frame)) == lot::Status::Ok);
        CHECK(puller.pull(1s)->data.back() == 5);
      }
    }
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a directory that is full, or becomes full later, is an error and never a SIGBUS") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=64m");
  if (disk.path.empty()) {
    MESSAGE("skipped: can not mount a tmpfs");
    return;
  }
  auto options = fresh(0);
  options.directory = disk.path;
  const auto fill_up = [&](std::size_t leave) {
    const std::string ballast = disk.path + "/ballast";
    const int fd = open(ballast.c_str(), O_CREAT | O_RDWR, 0600);
    const auto size = static_cast<off_t>(std::filesystem::space(disk.path).available - leave);
    CHECK(posix_fallocate(fd, 0, size) == 0);
    close(fd);
  };
  fill_up(0);
  const std::string text = refusal(options);
  CHECK(says(text, "are free in " + disk.path + ", and it takes at most three quarters of that"));
  CHECK(says(text, "--shm-size"));
  CHECK(files_of(options) == 0);
  std::filesystem::remove(disk.path + "/ballast");
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t", {lot::Policy::Overwrite, 1, 1s});
    fill_up(5 << 20);
    auto frame = pusher.loan();
    try {
      frame->data.resize((16 << 20) / 8);
      FAIL("no exception");
    } catch (const lot::OutOfMemory& e) {
      CAPTURE(std::string(e.what()));
      CHECK(says(e.what(), "the file system is full"));
    }
    std::filesystem::remove(disk.path + "/ballast");
    frame->data.assign((16 << 20) / 8, 3);
    CHECK(pusher.push(std::move(frame)) == lot::Status::Ok);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("all units of a segment go back to the system, as they were given, and are given again") {
  using lot::segment::kGranule;
  using lot::segment::kUnit;
  lot::testing::LocalSegment local({16 * kUnit, 3, 8, 1, 4, 2});
  lot::segment::Segment& s = local.segment();
  REQUIRE(s.size() == 16 * kUnit);
  REQUIRE(s.units() == 16);
  for (std::uint32_t unit = 0; unit < 16; ++unit) CHECK(s.bytes_of_unit(unit) == kUnit);

  const std::uint32_t all = s.granules().count();
  for (int round = 0; round < 2; ++round) {
    const std::uint32_t run = s.claim_run(all, 1);
    REQUIRE(run == 0);
    s.base()[s.size() - 1] = 7;
    s.granules().release(run, all);
    s.look_at_units();
    // One granule at either end keeps a unit, and no other.
    const auto first = static_cast<std::uint32_t>((9 * kUnit - s.granule_offset(0)) / kGranule);
    for (const std::uint32_t used : {first, first + std::uint32_t{kUnit / kGranule} - 1}) {
      REQUIRE(s.granules().extend(used, 1, 1));
      for (std::uint32_t unit = s.first_unit(); unit < s.units(); ++unit) {
        CHECK(s.is_unused(unit, 1) == (unit != 9));
      }
      CHECK(s.give_back(9, 1, 1) == 0);
      s.look_at_units();
      s.granules().release(used, 1);
      CHECK(!s.is_unused(9, 1));  // no look has found it unused
      s.look_at_units();
    }
    std::uint64_t bytes = 0;
    for (std::uint32_t unit = s.first_unit(); unit < s.units(); ++unit) {
      CHECK(s.is_unused(unit, 1));
      bytes += s.give_back(unit, 1, 1);
      CHECK(!s.is_unused(unit, 1));
    }
    CHECK(bytes == s.size() - s.first_unit() * kUnit);
    CHECK(s.base()[s.size() - 1] == 0);  // it has gone
    CHECK(s.granules().used() == 0);
    CHECK(s.can_give_back());
  }
}

TEST_CASE("two segments in one process have nothing to do with each other") {
  const auto one = fresh();
  const auto two = fresh();
  {
    lot::ShmEngine a(one), b(two);
    auto pusher = a.advertise<Frame>("/t");
    auto puller = b.subscribe<Frame>("/t");
    auto right = a.subscribe<Frame>("/t");
    must_go(pusher.push(pusher.loan()));
    CHECK(puller.try_pull() == nullptr);
    CHECK(puller.status() == lot::Status::PublisherGone);
    CHECK(right.try_pull() != nullptr);
  }
  CHECK(files_of(one) + files_of(two) == 0);
}

TEST_CASE("a run that the segment does not have is no error of the system") {
  LocalSegment local({6 << 20, 4, 64, 2, 3, 3});
  auto& segment = local.segment();
  errno = EIO;
  CHECK(segment.claim_run(segment.granules().count() + 1, 5) ==
        lot::segment::Granules<lot::segment::Atomics>::kNone);
  CHECK(errno == 0);
}

TEST_CASE("each table lies behind the one before it, at a line, and the data at a granule") {
  using namespace lot::segment;
  for (const Capacity& c : {Capacity{6 << 20, 4, 64, 2, 3, 3}, Capacity{7 << 20, 3, 1, 1, 1, 1},
                            Capacity{1 << 30, 320, 16384, 1024, 2048, 256}}) {
    CAPTURE(c.size);
    const auto lines = [](std::uint64_t bytes) { return (bytes + 63) / 64 * 64; };
    const auto pages = [](std::uint64_t bytes) { return (bytes + 4095) / 4096 * 4096; };
    const Geometry g = Geometry::of(c);
    CHECK(g.participants == 4096);
    CHECK(g.witnesses == g.participants + 64 * c.participants);
    CHECK(g.directory == g.witnesses + 64 * c.participants);
    CHECK(g.topics == g.directory + 192);
    CHECK(g.channels == g.topics + 1216 * c.topics);
    CHECK(g.blocks == g.channels + 64 * c.channels);
    CHECK(g.arenas == g.blocks + 64 * c.blocks);
    CHECK(g.tags == g.arenas + 256 * c.blocks);
    CHECK(g.units == g.tags + lines(c.size / 4096 * 4));
    CHECK(g.sightings == g.units + lines((c.size + kUnit - 1) / kUnit * 4));
    CHECK(g.replies == g.sightings + lines(c.participants * sizeof(Sightings)));
    CHECK(g.descriptions == g.replies + lines(80 * c.topics));
    CHECK(g.listeners == g.descriptions + (1 << 20));
    CHECK(g.ears == g.listeners + 64 * c.channels);
    CHECK(g.news == g.ears + 64 * 512);
    CHECK(g.small == pages(g.news + 512 * news_bytes(c.channels)));
    CHECK(g.data == pages(g.small + 256 * c.blocks));
    CHECK(g.granules == (c.size - g.data) / 4096);
  }
}

TEST_CASE("each ear has words and news of its own, and a wait set gets the first that is free") {
  LocalSegment local({6 << 20, 4, 64, 2, 3, 3});
  auto& s = local.segment();
  const auto geometry = lot::segment::Geometry::of(s.capacity());
  for (const std::uint32_t e : {0U, 1U, 2U, 319U, 320U, 511U}) {
    CHECK(s.offset_of(s.ear(e).words) == geometry.ears + e * 64);
    CHECK(s.offset_of(s.ear(e).news) == geometry.news + e * 64);
  }
  for (std::uint32_t e = 320; e < 512; ++e) CHECK(s.claim_ear(e % 2) == e);
  CHECK(s.claim_ear(1) == std::nullopt);
  s.free_ears(1);
  for (std::uint32_t e = 321; e < 512; e += 2) CHECK(s.claim_ear(2) == e);
  CHECK(s.claim_ear(2) == std::nullopt);
}

TEST_CASE("a ring has depth only while each of its granules carries its tag") {
  LocalSegment local({6 << 20, 4, 64, 2, 3, 3});
  auto& s = local.segment();
  const std::uint32_t tag = lot::segment::kRingTag | 1;
  const std::uint32_t run = s.claim_run(3, tag);
  auto& entry = s.channels()[1];
  entry.depth = 1024;
  entry.readers = 1;
  entry.granule = run;
  entry.granules = 3;
  CHECK(s.unformed_ring(1).depth == 1024);
  CHECK(s.ring(1).depth == 0);
  for (std::uint32_t i = 0; i < 3; ++i) {
    s.granules().release(run + i, 1);
    const auto ring = s.unformed_ring(1);
    CHECK(ring.depth == 0);
    CHECK(ring.channel == 1);
    CHECK(s.granules().extend(run + i, 1, tag));
  }
  CHECK(s.unformed_ring(1).depth == 1024);
}

TEST_CASE("of a segment that is not there no reason is left from a look before") {
  using lot::segment::Segment;
  std::string reason = "a reason";
  CHECK(Segment::examine(file_of(fresh()), 0, {}, reason) == Segment::Fit::Absent);
  CHECK(reason.empty());
  reason = "a reason";
  CHECK(Segment::inspect(file_of(fresh()), {}, reason) == Segment::Fit::Absent);
  CHECK(reason.empty());
}

TEST_SUITE_END();
