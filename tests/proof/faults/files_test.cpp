// SPDX-License-Identifier: Apache-2.0

// An administrator removes, replaces and renames files under living processes.

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <list>
#include <optional>
#include <string>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/death_notice.hpp"
#include "liveness/lock_file.hpp"
#include "puppet.hpp"
#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"
#include "support/raw.hpp"
#include "support/users.hpp"

namespace {

using namespace lot::testing;
namespace fs = std::filesystem;

[[maybe_unused]] const bool has_janitor = start_janitor();

std::string lock_of(const lot::EngineOptions& options) { return file_of(options) + ".lock"; }

/// The lot::Error that joining gives: its number and text; 0 when it works.
struct Refusal {
  int number = 0;
  std::string text;
  explicit Refusal(const lot::EngineOptions& options) {
    try {
      const lot::ShmEngine engine(options);
    } catch (const lot::Error& e) {
      number = e.error_number();
      text = e.what();
    }
  }
  bool says(const std::string& part) const { return text.find(part) != std::string::npos; }
};

/// What a file is: other than before when it was removed or written to.
struct Look {
  explicit Look(const std::string& path) { there = lstat(path.c_str(), &status) == 0; }
  bool operator==(const Look& other) const {
    return there && other.there && status.st_ino == other.status.st_ino &&
           status.st_dev == other.status.st_dev && status.st_mode == other.status.st_mode &&
           status.st_uid == other.status.st_uid && status.st_size == other.status.st_size &&
           status.st_mtim.tv_sec == other.status.st_mtim.tv_sec &&
           status.st_mtim.tv_nsec == other.status.st_mtim.tv_nsec;
  }
  bool there;
  struct stat status {};
};

struct Number {
  std::uint64_t value;
};

std::atomic<bool> first_joiner_is_quicker{false};

constexpr const char* kRubbish = "a text of mine that nobody may remove";

/// Two processes that know each other, and the segment they are in, whatever its path names now.
struct Insiders {
  explicit Insiders(const lot::EngineOptions& options)
      : a(options, 'a'),
        b(options, 'b'),
        segment(file_of(options), lot::segment::Segment::Access::ReadWrite,
                lot::segment::Trust::of(options)) {
    REQUIRE(a.joined());
    REQUIRE(b.joined());
    CHECK(a.talks_to(b));
  }
  /// They have not noticed anything.
  void check() {
    CHECK(a.talks_to(b));
    CHECK(index_of(segment, "a") != 0);
    CHECK(index_of(segment, "b") != 0);
  }
  void leave() {
    CHECK(a.leave());
    CHECK(b.leave());
  }
  Puppet a, b;
  lot::segment::Segment segment;
};

/// Two processes that come later.
struct Newcomers {
  explicit Newcomers(const lot::EngineOptions& options) : c(options, 'c'), d(options, 'd') {
    REQUIRE(c.joined());
    REQUIRE(d.joined());
    CHECK(c.talks_to(d));
  }
  void leave() {
    CHECK(c.leave());
    CHECK(d.leave());
  }
  Puppet c, d;
};

/// Time for a look of every warden, which may be one that was not woken.
void let_wardens_look() { usleep(1250000); }

void remove_segment(const lot::EngineOptions& options) { fs::remove(file_of(options)); }
void remove_lock_file(const lot::EngineOptions& options) { fs::remove(lock_of(options)); }
void remove_both(const lot::EngineOptions& options) {
  remove_segment(options);
  remove_lock_file(options);
}

}  // namespace

// The linker (--wrap) sends the callers of DeathNotice::claim() to the second of these.
using lot::liveness::DeathNotice;
bool really_claim(DeathNotice*, DeathNotice::Seat&, std::uint64_t) asm(
    "__real__ZN3lot8liveness11DeathNotice5claimERNS_6detail9ChangedByISt6atomicImES1_EEm");
bool claim_second(DeathNotice*, DeathNotice::Seat&, std::uint64_t) asm(
    "__wrap__ZN3lot8liveness11DeathNotice5claimERNS_6detail9ChangedByISt6atomicImES1_EEm");

bool claim_second(DeathNotice* notice, DeathNotice::Seat& seat, std::uint64_t seen) {
  namespace words = lot::liveness::seat;
  if (!first_joiner_is_quicker.exchange(false)) return really_claim(notice, seat, seen);
  const std::uint32_t incarnation = words::incarnation(seen) + 1;
  const std::uint64_t others = words::make(incarnation, 1 | words::kSleepers);
  lot::test::raw(seat) = others;  // another one, with the other lock file
  const bool claimed = really_claim(notice, seat, seen);
  must(!claimed && seat.load() == others, "the other one's seat");
  lot::test::raw(seat) = words::make(incarnation, 0);  // it has left again
  return claimed;
}

TEST_SUITE_BEGIN("files");

TEST_CASE("the segment, or both files, removed: those inside go on, newcomers meet in a new one") {
  const Watchdog watchdog(60);
  for (const auto remove : {&remove_segment, &remove_both}) {
    for (const bool insiders_leave_first : {true, false}) {
      CAPTURE((remove == &remove_both));
      CAPTURE(insiders_leave_first);
      const Ground options;
      Insiders inside(options);
      remove(options);
      inside.check();
      Newcomers outside(options);
      lot::segment::Segment s(file_of(options));
      CHECK(s.header().identity.instance != inside.segment.header().identity.instance);
      CHECK(outside.c.knows_nothing_of(inside.a));
      let_wardens_look();
      inside.check();
      CHECK(taken(inside.segment).size() == 2);
      CHECK(taken(s).size() == 2);
      if (insiders_leave_first) {
        inside.leave();
        CHECK(files_of(options) == 2);
        Puppet late(options, 'l');
        CHECK(late.talks_to(outside.c));
        CHECK(late.leave());
        outside.leave();
      } else {
        outside.leave();
        inside.check();
        inside.leave();
      }
      CHECK(taken(inside.segment).empty());
      CHECK(files_of(options) == 0);
    }
  }
}

TEST_CASE("the segment removed: those inside reap their dead, whatever newcomers do") {
  const Watchdog watchdog(60);
  const Ground options;
  Insiders inside(options);
  remove_segment(options);
  inside.a.stop();
  inside.b.kill9();
  Newcomers outside(options);  // they look for free indexes before `a` can reap
  inside.a.go_on();
  CHECK(eventually([&] { return index_of(inside.segment, "b") == 0; }));
  CHECK(index_of(inside.segment, "a") != 0);
  CHECK(inside.a.leave());
  outside.leave();
  CHECK(files_of(options) == 0);
}

TEST_CASE("the lock file removed: newcomers join the same segment, and none is taken for dead") {
  const Watchdog watchdog(60);
  for (const bool insiders_leave_first : {true, false}) {
    CAPTURE(insiders_leave_first);
    const Ground options;
    Neighbour before(options);
    Insiders inside(options);
    remove_lock_file(options);
    inside.check();
    Newcomers outside(options);
    Neighbour after(options);
    CHECK(outside.c.talks_to(inside.a));
    let_wardens_look();
    inside.check();
    CHECK(taken(inside.segment).size() == 6);
    // The dead of either side are reaped by the other.
    inside.b.kill9();
    outside.d.kill9();
    CHECK(eventually([&] { return taken(inside.segment).size() == 4; }));
    CHECK(index_of(inside.segment, "a") != 0);
    CHECK(index_of(inside.segment, "c") != 0);
    CHECK(outside.c.talks_to(inside.a));
    if (insiders_leave_first) {
      CHECK(inside.a.leave());
      CHECK(before.leave() >= 0);
      CHECK(after.leave() >= 0);
      CHECK(files_of(options) == 2);
      CHECK(outside.c.leave());
    } else {
      CHECK(outside.c.leave());
      CHECK(after.leave() >= 0);
      CHECK(files_of(options) == 2);
      CHECK(inside.a.leave());
      CHECK(before.leave() >= 0);
      // Theirs is not the lock file that is there now: the next one takes the files along.
      CHECK(taken(inside.segment).empty());
      CHECK(files_of(options) == 2);
      CHECK(Refusal(options).number == 0);
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("the lock file removed and another size asked for: EBUSY while those inside use it") {
  const Watchdog watchdog(60);
  const Ground options;
  Insiders inside(options);
  remove_lock_file(options);
  lot::EngineOptions bigger = options;
  bigger.size_bytes *= 2;
  const Refusal refusal(bigger);  // the new lock file says nothing of them, their notices do
  CHECK(refusal.number == EBUSY);
  CHECK(refusal.says("it is in use"));
  let_wardens_look();
  inside.check();
  inside.a.kill9();
  CHECK(inside.b.leave());
  CHECK(eventually([&] { return Refusal(bigger).number == 0; }));
  CHECK(files_of(options) == 0);
}

TEST_CASE("both files removed: another engine of a process inside joins those inside") {
  const Watchdog watchdog(60);
  const Ground options;
  Steps joined, removed, done;
  Child inside([&] {
    lot::ShmEngine first(options);
    joined.tell();
    must(removed.next() == '.', "the order");
    lot::ShmEngine second(options);
    must(files_of(options) == 0, "no new segment");
    auto pusher = second.advertise<Number>("/t");
    auto puller = first.subscribe<Number>("/t");
    must_go(pusher.push(pusher.loan(std::uint64_t{7})));
    must(puller.pull(10s)->value == 7, "they are one participant");
    joined.tell();
    must(done.next() == '.', "the end");
  });
  REQUIRE(joined.next() == '.');
  remove_both(options);
  removed.tell();
  REQUIRE(joined.next() == '.');
  CHECK(Refusal(options).number == 0);  // others get a new one
  done.tell();
  CHECK(inside.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("the lock file removed, no newcomer: the segment stays, the next process removes it") {
  const Watchdog watchdog(60);
  const Ground options;
  Insiders inside(options);
  remove_lock_file(options);
  inside.leave();
  CHECK(taken(inside.segment).empty());
  CHECK(files_of(options) == 1);
  CHECK(Refusal(options).number == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("replaced by another segment in use: newcomers meet there, none is reaped, all go on") {
  const Watchdog watchdog(60);
  const Ground options, other;
  Insiders inside(options);
  Puppet stranger(other, 's');
  REQUIRE(stranger.joined());
  lot::segment::Segment s(file_of(other));
  fs::rename(file_of(other), file_of(options));
  inside.check();
  Newcomers outside(options);
  CHECK(outside.c.talks_to(stranger));
  CHECK(outside.c.knows_nothing_of(inside.a));
  let_wardens_look();
  inside.check();
  CHECK(index_of(s, "s") != 0);
  outside.leave();
  CHECK(fs::exists(file_of(options)));  // the stranger lives in it
  inside.leave();
  CHECK(fs::exists(file_of(options)));
  CHECK(stranger.leave());
}

TEST_CASE("replaced by rubbish: newcomers get an error, those inside go on and leave it alone") {
  const Watchdog watchdog(60);
  const Ground options;
  Insiders inside(options);
  remove_segment(options);
  std::ofstream(file_of(options)) << kRubbish;
  const Look rubbish(file_of(options));
  inside.check();
  const Refusal refusal(options);
  CHECK(refusal.number == EINVAL);
  CHECK(refusal.says(file_of(options)));
  CHECK(refusal.says("remove it if it is yours"));
  inside.check();
  inside.leave();
  CHECK(Look(file_of(options)) == rubbish);
  CHECK(!fs::exists(lock_of(options)));
}

TEST_CASE("the lock file replaced by what is none: an error for newcomers, those inside leave it") {
  const Watchdog watchdog(60);
  struct Kind {
    const char* name;
    void (*make)(const std::string& path);
  };
  const Kind kinds[] = {
      {"directory", [](const std::string& path) { fs::create_directory(path); }},
      {"link", [](const std::string& path) { fs::create_symlink("/dev/null", path); }}};
  for (const Kind& kind : kinds) {
    CAPTURE(kind.name);
    const Ground options;
    Insiders inside(options);
    remove_lock_file(options);
    kind.make(lock_of(options));
    const Look before(lock_of(options));
    inside.check();
    const Refusal refusal(options);
    CHECK(refusal.number != 0);
    CHECK(refusal.says(lock_of(options)));
    let_wardens_look();
    inside.check();
    inside.leave();
    CHECK(Look(lock_of(options)) == before);
    fs::remove(lock_of(options));
    CHECK(Refusal(options).number == 0);
    CHECK(files_of(options) == 0);
  }
}

namespace {

/// A directory for segments, that is removed at the end under each of its names.
struct Directory {
  Directory() : name("/dev/shm/" + unique_name() + "_dir"), renamed(name + "_renamed") {
    fs::create_directory(name);
  }
  ~Directory() {
    std::error_code ignored;
    fs::remove_all(name, ignored);
    fs::remove_all(renamed, ignored);
  }
  Directory(const Directory&) = delete;
  Directory& operator=(const Directory&) = delete;

  void rename() const { fs::rename(name, renamed); }
  lot::EngineOptions options(const std::string& in) const {
    auto o = fresh();
    o.segment = "segment";
    o.directory = in;
    return o;
  }
  std::string name, renamed;
};

}  // namespace

TEST_CASE("the segment removed, its lock file another user's: an error, those inside go on" *
          doctest::skip(!can_be_ordinary_user())) {
  const Watchdog watchdog(60);
  const Directory directory;
  auto options = directory.options(directory.name);
  options.permissions = 0666;
  Insiders inside(options);
  remove_segment(options);
  REQUIRE(chmod(directory.name.c_str(), 0555) == 0);  // may open it, may not remove it
  Child newcomer([&] {
    must(getuid() != 0 || (setgid(65534) == 0 && setuid(65534) == 0), "an ordinary user");
    const Refusal refusal(options);
    must(refusal.number == EACCES && refusal.says(lock_of(options)), "an error that names it");
  });
  CHECK(newcomer.wait() == 0);
  REQUIRE(chmod(directory.name.c_str(), 0700) == 0);
  inside.check();
  inside.leave();
  CHECK(files_of(options) == 0);
}

TEST_CASE("the lock file removed while two join: the second one gets another index") {
  const Watchdog watchdog(60);
  const Ground options;
  Insiders inside(options);
  const auto before = taken(inside.segment);
  Child second([&] {
    first_joiner_is_quicker = true;
    const lot::ShmEngine engine(options);
    must(!first_joiner_is_quicker, "it was not quicker");
    lot::segment::Segment s(file_of(options));
    const auto now = taken(s);
    must(now.size() == before.size() + 1 && now.back() > before.back() + 1, "the index behind");
  });
  CHECK(second.wait() == 0);
  inside.check();
  inside.leave();
  CHECK(files_of(options) == 0);
}

TEST_CASE("the directory renamed: those inside go on, and meet newcomers by the new name") {
  const Watchdog watchdog(60);
  for (const bool insiders_leave_first : {true, false}) {
    CAPTURE(insiders_leave_first);
    const Directory directory;
    const auto options = directory.options(directory.name);
    const auto by_new_name = directory.options(directory.renamed);
    Insiders inside(options);
    directory.rename();
    inside.check();
    const Refusal refusal(options);
    CHECK(refusal.number == ENOENT);
    CHECK(refusal.says("LOT_DIR"));
    Newcomers outside(by_new_name);
    CHECK(outside.c.talks_to(inside.a));
    let_wardens_look();
    inside.check();
    if (insiders_leave_first) {
      inside.leave();
      CHECK(files_of(by_new_name) == 2);
      outside.leave();
      CHECK(files_of(by_new_name) == 0);
    } else {
      outside.leave();
      inside.check();
      CHECK(files_of(by_new_name) == 2);
      inside.leave();  // they do not know where their files are
      CHECK(files_of(by_new_name) == 2);
      CHECK(Refusal(by_new_name).number == 0);
      CHECK(files_of(by_new_name) == 0);
    }
  }
}

TEST_CASE("the directory renamed and a new one made: two segments that leave each other alone") {
  const Watchdog watchdog(60);
  for (const bool insiders_leave_first : {true, false}) {
    CAPTURE(insiders_leave_first);
    const Directory directory;
    const auto options = directory.options(directory.name);
    Insiders inside(options);
    directory.rename();
    fs::create_directory(directory.name);
    Newcomers outside(options);
    CHECK(outside.c.knows_nothing_of(inside.a));
    let_wardens_look();
    inside.check();
    if (insiders_leave_first) {
      inside.leave();
      CHECK(files_of(options) == 2);
      outside.leave();
    } else {
      outside.leave();
      inside.check();
      inside.leave();
    }
    CHECK(files_of(options) == 0);
    CHECK(files_of(directory.options(directory.renamed)) == 2);
    CHECK(Refusal(directory.options(directory.renamed)).number == 0);
    CHECK(files_of(directory.options(directory.renamed)) == 0);
  }
}

TEST_SUITE_END();
