// SPDX-License-Identifier: Apache-2.0

// `lot clean` removes segments without a process, reaps the dead, and never touches the living.

#include <cerrno>
#include <memory>
#include <random>
#include <string>
#include <sys/resource.h>
#include <sys/stat.h>
#include <vector>

#include <doctest/doctest.h>

#include "actor.hpp"
#include "command.hpp"
#include "support/error_of.hpp"
#include "support/janitor.hpp"
#include "support/raw.hpp"
#include "support/sanitizers.hpp"
#include "support/users.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
namespace fs = std::filesystem;

[[maybe_unused]] const bool has_janitor = start_janitor();

std::string path_of(const lot::EngineOptions& options) {
  return options.directory + "/" + options.segment;
}

struct Picture {
  lot::ShmVector<char> data;
};

lot::QueueOptions redelivering() {
  lot::QueueOptions options;
  options.redeliver = true;
  return options;
}

void leave_a_dead_segment(const lot::EngineOptions& options) {
  Actor actor(options, "actor");
  actor.act(kParcels, "advertise", 1);
  actor.act(kParcels, "loan");
  actor.act(kParcels, "push");
  actor.kill9();
  REQUIRE(fs::exists(path_of(options)));
  REQUIRE(fs::exists(path_of(options) + ".lock"));
}

/// The two go on talking: they are in one segment, and it is whole.
void check_they_talk(Actor& publisher, Actor& reader) {
  publisher.act(kLetters, "loan");
  publisher.act(kLetters, "push");
  const std::size_t kept = reader.truth().at(kLetters).at("kept").size();
  reader.act(kLetters, "pull");
  CHECK(reader.truth().at(kLetters).at("kept").size() == kept + 1);
  reader.act(kLetters, "release");
}

/// For a child: well, or something was to be done.
void must_not_break(const Ran& clean) {
  must(clean.exit == 0 || clean.exit == 1,
       ("clean does not break: exit " + std::to_string(clean.exit) + "\n" + clean.out + clean.err)
           .c_str());
}

/// Killed with items in two queues, of one a worker has a task.
void leave_items(const lot::EngineOptions& options) {
  Steps ready;
  Child putter([&] {
    lot::ShmEngine engine(options);
    auto jobs = engine.queue<std::uint64_t>("jobs", redelivering());
    auto notes = engine.queue<lot::ShmUniquePtr<Picture>>("notes");
    auto shared = engine.queue<lot::ShmSharedPtr<const Picture>>("shared");
    for (std::uint64_t n = 0; n < 4; ++n) must(jobs.put(n) == lot::Status::Ok, "put");
    auto task = jobs.try_take();
    must(task && *task == 0, "the first one");
    auto other = jobs.try_take();
    other.finish();
    for (int n = 0; n < 2; ++n) must(notes.put(notes.make()) == lot::Status::Ok, "put");
    must(shared.put(shared.make()) == lot::Status::Ok, "put");  // nobody will get it
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() != 0);
  putter.kill9();
}

/// What `clean` says of the segment that it leaves alone.
void check_left_alone(const Ran& ran, const lot::EngineOptions& options) {
  CHECK(ran.exit == 0);
  const Json document = ran.json();
  CHECK(document.at("removed").empty());
  REQUIRE(document.at("left_alone").size() == 1);
  const Json& left = document.at("left_alone").at(0);
  CHECK(left.at("path") == path_of(options));
  CHECK(left.at("why") == "no process lives in it, but 3 items wait in jobs, 2 in notes");
  CHECK(left.at("waiting") == Json::parse(R"([{"queue": "jobs", "items": 3},
                                              {"queue": "notes", "items": 2}])"));
  REQUIRE(document.at("hints").size() == 1);
  CHECK(document.at("hints").at(0).get<std::string>().find("lot clean --with-items") !=
        std::string::npos);
}

void overwrite(const std::string& path, std::uint64_t offset, std::uint64_t value) {
  const int file = open(path.c_str(), O_RDWR | O_CLOEXEC);
  REQUIRE(file != -1);
  REQUIRE(pwrite(file, &value, sizeof(value), static_cast<off_t>(offset)) == sizeof(value));
  close(file);
}

}  // namespace

TEST_SUITE_BEGIN("clean");

TEST_CASE("lot clean removes a segment whose last process was killed, with its lock file") {
  const Watchdog watchdog(60);
  const Room room;
  leave_a_dead_segment(room.options());
  const Ran dry = run_lot(on(room.options(), {"clean", "--dry-run", "--json"}));
  CHECK(dry.exit == 0);
  CHECK(dry.json().at("removed").size() == 1);
  CHECK(room.files() == 2);
  const Ran ran = run_lot(on(room.options(), {"clean", "--json"}));
  CHECK(ran.exit == 0);
  CHECK(ran.json().at("removed") == dry.json().at("removed"));
  CHECK(room.files() == 0);
}

TEST_CASE("lot clean says which files it removes, and how much memory that gives back") {
  const Watchdog watchdog(60);
  const Room room;
  leave_a_dead_segment(room.options());
  const std::string path = path_of(room.options());
  struct stat status {};
  REQUIRE(stat(path.c_str(), &status) == 0);
  const auto bytes = static_cast<std::uint64_t>(status.st_blocks) * 512;
  const Ran dry = run_lot(on(room.options(), {"clean", "--dry-run", "--json"}));
  const Json removed = dry.json().at("removed").at(0);
  CHECK(removed.at("files") == Json({path, path + ".lock"}));
  CHECK(removed.at("bytes") == bytes);
  CHECK(bytes > 0);
  const std::string would = run_lot(on(room.options(), {"clean", "--dry-run"})).out;
  CHECK_MESSAGE(would.find("would remove  " + path +
                           " with s.lock: no process lives in it; that gives ") == 0,
                would);
  const std::string did = run_lot(on(room.options(), {"clean"})).out;
  CHECK(did == "removed" + would.substr(std::string("would remove").size()));
}

TEST_CASE("lot clean says that there is nothing to do, and why") {
  const Watchdog watchdog(60);
  const Room room;
  const auto says_nothing = [&](const std::vector<std::string>& where, const std::string& why) {
    for (const char* option : {"--dry-run", "--with-items"}) {
      std::vector<std::string> words = {"clean", option};
      words.insert(words.end(), where.begin(), where.end());
      const Ran ran = run_lot(words);
      CHECK(ran.exit == 0);
      CHECK(ran.out == "nothing to do: " + why + "\n");
    }
  };
  const std::vector<std::string> all = {"--dir", room.path()};
  const auto one = on(room.options(), {});
  const std::string path = path_of(room.options());
  says_nothing(all, "no segment lies in " + room.path());
  says_nothing(one, "no segment lies at " + path);
  const Actor actor(room.options(), "actor");
  REQUIRE(run_lot(on(room.options(), {"clean"})).exit == 0);  // what was idle has gone
  says_nothing(one, path + " is in use, without a dead process or idle memory");
  says_nothing(all, path + " is in use, without a dead process or idle memory");
  const Actor other(room.options("t"), "other");
  REQUIRE(run_lot({"clean", "--dir", room.path()}).exit == 0);
  says_nothing(
      all, "2 segments of " + room.path() + " are in use, without a dead process or idle memory");
  const Json in_use = run_lot({"clean", "--json", "--dir", room.path()}).json().at("in_use");
  REQUIRE(in_use.size() == 2);
  CHECK(in_use.at(0).at("path") == path);
}

TEST_CASE("a segment of another boot or version, or damaged, is removed when no process is there") {
  const Watchdog watchdog(60);
  for (const unsigned offset : {40U, 8U, 72U, 16U}) {
    CAPTURE(offset);
    const Room room;
    leave_a_dead_segment(room.options());
    overwrite(path_of(room.options()), offset, 12345);
    CHECK(run_lot({"clean", "--dir", room.path()}).exit == 0);
    CHECK(room.files() == 0);
  }
  const Room room;
  leave_a_dead_segment(room.options());
  fs::resize_file(path_of(room.options()), 80);
  CHECK(run_lot({"clean", "--dir", room.path()}).exit == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("a segment in which items wait is left alone until the command names them") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  leave_items(options);
  check_left_alone(run_lot(on(options, {"clean", "--dry-run", "--json"})), options);
  check_left_alone(run_lot(on(options, {"clean", "--json"})), options);
  check_left_alone(run_lot({"clean", "--json", "--dir", room.path()}), options);
  CHECK(room.files() == 2);
  {
    lot::ShmEngine engine(options);  // what waits is still there
    auto jobs = engine.queue<std::uint64_t>("jobs", redelivering());
    CHECK(eventually([&] { return jobs.size() == 3; }));
    const auto task = jobs.try_take();
    REQUIRE(task);
    CHECK(*task == 0);
    CHECK(task.deliveries() == 2);
  }
  CHECK(room.files() == 0);
  leave_items(options);
  const Ran dry = run_lot(on(options, {"clean", "--with-items", "--dry-run", "--json"}));
  CHECK(dry.exit == 0);
  REQUIRE(dry.json().at("removed").size() == 1);
  CHECK(dry.json().at("removed").at(0).at("why") ==
        "no process lives in it, 3 items wait in jobs, 2 in notes");
  CHECK(room.files() == 2);
  const Ran ran = run_lot(on(options, {"clean", "--with-items", "--json"}));
  CHECK(ran.exit == 0);
  CHECK(ran.json().at("removed") == dry.json().at("removed"));
  CHECK(room.files() == 0);
}

TEST_CASE("a process that was killed while it recycled a ring costs no items of the others") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  leave_items(options);
  {
    lot::segment::Segment segment(path_of(options));
    // As between the ring's memory and its channel: an ended ring without memory.
    auto& channel = segment.channels().back();
    lot::test::raw(channel.formed).store(1);
    lot::test::raw(channel.writer)
        .store(lot::ring::make_writer(1, lot::ring::State::Orphan, lot::refcount::kOrphanage));
  }
  CHECK(run_lot(on(options, {"ls"})).exit == 3);  // it looks damaged
  check_left_alone(run_lot(on(options, {"clean", "--json"})), options);
  CHECK(room.files() == 2);
}

TEST_CASE("items of another boot go without a word, as the segment does") {
  const Watchdog watchdog(60);
  const Room room;
  leave_items(room.options());
  overwrite(path_of(room.options()), 40, 12345);
  CHECK(run_lot(on(room.options(), {"clean"})).exit == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("where there is no room to map it, a segment is not taken for damaged" *
          doctest::skip(kIsSanitized || is_other_command())) {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.size_bytes = 512 << 20;
  leave_items(options);
  Child limited([&] {
    const rlimit room_to_work{256 << 20, 256 << 20};
    must(setrlimit(RLIMIT_AS, &room_to_work) == 0, "a limit");
    const Ran ran = run_lot(on(options, {"clean"}));
    must(ran.exit == 1, ran.out.c_str());
    must(names(ran.out, "RLIMIT_AS (ulimit -v) is 256 MiB"), ran.out.c_str());
    must(run_lot(on(options, {"clean", "--dry-run"})).exit == 1, "the same, dry");
    auto smaller = options;
    smaller.size_bytes = 16 << 20;
    const auto [error, text] = error_of([&] { const lot::ShmEngine engine(smaller); });
    must(error == ENOMEM && names(text, "RLIMIT_AS"), text.c_str());
  });
  CHECK(limited.wait() == 0);
  lot::ShmEngine engine(options);
  auto jobs = engine.queue<std::uint64_t>("jobs", redelivering());
  CHECK(eventually([&] { return jobs.size() == 3; }));
}

TEST_CASE("items that come while lot clean waits for the gate are not removed") {
  const Watchdog watchdog(60);
  const Room room;
  leave_items(room.options("full"));
  leave_a_dead_segment(room.options());
  {
    lot::liveness::LockFile lock(path_of(room.options()) + ".lock");
    REQUIRE(lock.enter_gate(10s));
    Child cleaner([&] {
      const Ran ran = run_lot(on(room.options(), {"clean", "--json"}));
      must(ran.exit == 0 && ran.json().at("removed").empty(), ran.out.c_str());
    });
    std::this_thread::sleep_for(500ms);  // it has looked by now, or sees the items at once
    fs::rename(path_of(room.options("full")), path_of(room.options()));
    lock.leave_gate();
    CHECK(cleaner.wait() == 0);
  }
  CHECK(fs::exists(path_of(room.options())));
}

TEST_CASE("a segment with persist goes when no process is there and nothing waits in it") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.persist = true;
  { const lot::ShmEngine engine(options); }
  CHECK(room.files() == 2);
  CHECK(run_lot(on(options, {"clean"})).exit == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("lot clean is a visitor: what it finds in its environment changes no segment") {
  const Watchdog watchdog(60);
  const Room room;
  Actor actor(room.options(), "actor");
  (void)prefix();
  REQUIRE(setenv("LOT_PERSIST", "1", 1) == 0);
  const Ran ran = run_lot(on(room.options(), {"clean", "--json"}));
  unsetenv("LOT_PERSIST");
  CHECK(ran.exit == 0);
  CHECK(ran.json().at("left_alone").empty());
  CHECK(actor.leave() == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("memory that no process uses goes back at once") {
  const Watchdog watchdog(60);
  const Room room;
  lot::EngineOptions options = room.options();
  options.size_bytes = 64 << 20;
  const Steps idle, go;
  Child camera([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Picture>("/pictures");
    {
      std::vector<lot::ShmUniquePtr<Picture>> loans;
      for (int i = 0; i < 8; ++i) {
        loans.push_back(pusher.loan());
        loans.back()->data.assign(4 << 20, 'x');
      }
    }
    idle.tell();
    go.next();
    auto picture = pusher.loan();
    picture->data.resize(4 << 20);
    must(picture->data.back() == 0, "memory that went back is as new");
  });
  REQUIRE(idle.next() != 0);
  const auto taken = [&] {
    return run_lot(on(options, {"ls", "--json"}))
        .json()
        .at("segments")
        .at(0)
        .at("memory")
        .at("taken_bytes")
        .get<std::uint64_t>();
  };
  const std::uint64_t before = taken();
  const Ran dry = run_lot(on(options, {"clean", "--dry-run"}));
  CHECK(dry.exit == 0);
  CHECK(taken() == before);
  const Ran ran = run_lot(on(options, {"clean", "--json"}));
  CHECK(ran.exit == 0);
  const auto bytes = ran.json().at("given_back").at(0).at("bytes").get<std::uint64_t>();
  CHECK(bytes >= 28 << 20);
  CHECK(taken() + bytes == before);
  CHECK(run_lot(on(options, {"clean", "--json"})).json().at("given_back").empty());
  go.tell();
  CHECK(camera.wait() == 0);
}

TEST_CASE("a damaged segment in which a process lives is left alone") {
  const Watchdog watchdog(60);
  const Room room;
  const Actor actor(room.options(), "actor");
  overwrite(path_of(room.options()), 8, 12345);
  const Ran ran = run_lot(on(room.options(), {"clean"}));
  CHECK(ran.exit == 3);
  CHECK(room.files() == 2);
}

TEST_CASE("a living process is left alone when its lock file is gone, or its lock") {
  const Watchdog watchdog(60);
  for (const bool stopped : {false, true}) {
    CAPTURE(stopped);
    const Room room;
    Actor publisher(room.options(), "publisher");
    Actor reader(room.options(), "reader");
    publisher.act(kLetters, "advertise", 1);
    reader.act(kLetters, "subscribe");
    fs::remove(path_of(room.options()) + ".lock");
    if (stopped) {
      stop(publisher.child());
      stop(reader.child());
    }
    for (int n = 0; n < 3; ++n) {
      const Ran ran = run_lot(on(room.options(), {"clean", "--json"}));
      CHECK(ran.exit == 0);
      CHECK(ran.json().at("removed").empty());
      CHECK(ran.json().at("reaped").empty());
    }
    CHECK(fs::exists(path_of(room.options())));
    publisher.child().send(SIGCONT);
    reader.child().send(SIGCONT);
    check_they_talk(publisher, reader);
  }
}

TEST_CASE("living processes whose segment was removed keep their lock file") {
  const Watchdog watchdog(60);
  const Room room;
  const Actor actor(room.options(), "actor");
  fs::remove(path_of(room.options()));
  CHECK(run_lot(on(room.options(), {"clean"})).exit == 0);
  CHECK(fs::exists(path_of(room.options()) + ".lock"));
}

TEST_CASE("the dead among stopped processes are reaped, and the stopped go on afterwards") {
  const Watchdog watchdog(60);
  const Room room;
  Actor publisher(room.options(), "publisher");
  Actor reader(room.options(), "reader");
  Actor dead(room.options(), "victim");
  publisher.act(kLetters, "advertise", 1);
  reader.act(kLetters, "subscribe");
  dead.act(kParcels, "advertise", 2);
  dead.act(kParcels, "loan");
  const std::uint32_t index = dead.index();
  const pid_t pid = dead.child().pid();
  stop(publisher.child());  // nobody reaps
  stop(reader.child());
  dead.kill9();
  CHECK(run_lot(on(room.options(), {"ls"})).exit == 1);
  const Ran dry = run_lot(on(room.options(), {"clean", "--dry-run", "--json"}));
  CHECK(dry.json().at("reaped").size() == 1);
  const std::string would = run_lot(on(room.options(), {"clean", "--dry-run"})).out;
  CHECK(run_lot(on(room.options(), {"ls"})).exit == 1);
  const Ran ran = run_lot(on(room.options(), {"clean", "--json"}));
  CHECK(ran.exit == 0);
  REQUIRE(ran.json().at("reaped").size() == 1);
  CHECK(ran.json().at("reaped").at(0).at("process") == index);
  CHECK(ran.json().at("reaped").at(0).at("name") == "victim");
  CHECK(ran.json().at("reaped").at(0).at("pid") == pid);
  CHECK_MESSAGE(
      would.find("would reap  " + std::to_string(index) + " victim (pid " + std::to_string(pid) +
                 ") in " + path_of(room.options()) + "\n") != std::string::npos,
      would);
  CHECK(run_lot(on(room.options(), {"ls"})).exit == 0);
  publisher.child().send(SIGCONT);
  reader.child().send(SIGCONT);
  check_they_talk(publisher, reader);
}

TEST_CASE("leftovers of killed makers go; files that may be a user's stay") {
  const Watchdog watchdog(60);
  const Room room;
  const auto touch = [&](const std::string& name, const std::string& text = "") {
    std::ofstream(room.path() + "/" + name) << text;
    fs::permissions(room.path() + "/" + name, fs::perms(0600));  // as the library makes its own
  };
  // Ours: a half-made segment beside its lock file, and one that has its header already.
  touch("early.lock");
  touch("early.new");
  leave_a_dead_segment(room.options("late"));
  fs::rename(room.path() + "/late", room.path() + "/late.new");
  fs::remove(room.path() + "/late.lock");
  // Anybody's.
  touch("alone.new");
  touch("note.new", "a text of mine");
  touch("note.lock", "a text of mine");
  touch("empty.lock");
  const Ran ran = run_lot({"clean", "--json", "--dir", room.path()});
  CHECK(ran.exit == 0);
  CHECK(ran.json().at("removed").size() == 2);
  REQUIRE(ran.json().at("left_alone").size() == 1);
  CHECK(ran.json().at("left_alone").at(0).at("path") == room.path() + "/empty.lock");
  for (const char* gone : {"early.lock", "early.new", "late.new", "late.lock"}) {
    CAPTURE(gone);
    CHECK(!fs::exists(room.path() + "/" + gone));
  }
  for (const char* stays : {"alone.new", "note.new", "note.lock", "empty.lock"}) {
    CAPTURE(stays);
    CHECK(fs::exists(room.path() + "/" + stays));
  }
  // Who names it, means it.
  CHECK(run_lot({"clean", "--dir", room.path(), "--segment", "empty"}).exit == 0);
  CHECK(!fs::exists(room.path() + "/empty.lock"));
  const Ran named = run_lot({"clean", "--dir", room.path(), "--segment", "note"});
  CHECK(named.exit == 1);
  CHECK(names(named.out, "note.lock: it is a file of 14 bytes, and no lock file"));
  CHECK(bytes_of(room.path() + "/note.lock") == "a text of mine");
}

TEST_CASE("a maker at work is left alone") {
  const Watchdog watchdog(60);
  const Room room;
  std::ofstream(room.path() + "/s.new") << "half of it";
  lot::liveness::LockFile lock(room.path() + "/s.lock");
  REQUIRE(lock.enter_gate(10s));
  const Ran ran = run_lot(on(room.options(), {"clean"}));
  CHECK(ran.exit == 1);
  CHECK(room.files() == 2);
}

TEST_CASE("root looks into another user's segment, and cleans it, when that one is named" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(60);
  const Room room;
  REQUIRE(chmod(room.path().c_str(), 01777) == 0);
  auto options = room.options();
  options.permissions = 0666;
  options.persist = true;
  Child bob([&] {
    become(kBob, kOtherGroup);
    const lot::ShmEngine engine(options);
  });
  REQUIRE(bob.wait() == 0);
  const Variable permissions("LOT_PERMISSIONS", "0666");
  for (const char* command : {"ls", "top", "who", "clean"}) {
    CAPTURE(command);
    const Ran ran = run_lot(on(options, {command}));
    CHECK(ran.exit == 1);
    CHECK(ran.out.find("uid 65532") != std::string::npos);
    CHECK(ran.out.find("LOT_USER=65532 LOT_PERMISSIONS=0666") != std::string::npos);
    CHECK(room.files() == 2);
  }
  const Variable user("LOT_USER", "65532");
  const Ran seen = run_lot(on(options, {"ls", "--json"}));
  CHECK(seen.json().at("segments").at(0).at("condition") == "sound");
  CHECK(run_lot(on(options, {"clean"})).exit == 0);
  CHECK(room.files() == 0);
}

TEST_CASE("lot clean removes no user's files by a name that another user has chosen" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(60);
  const Room room;
  REQUIRE(chmod(room.path().c_str(), 01777) == 0);
  const auto make = [&](uid_t user, const std::string& name, const std::string& text) {
    Child child([&] {
      become(user, kOtherGroup);
      std::ofstream(room.path() + "/" + name) << text;
    });
    REQUIRE(child.wait() == 0);
  };
  make(kBob, "foo", "LOTSHM\r\n");
  make(kAnn, "foo.new", "Ann's own");
  make(kBob, "bar.lock", "");
  make(kAnn, "bar.new", "Ann's own");
  make(kAnn, "baz.new", "LOTSHM\r\n");
  CHECK(run_lot({"clean", "--dir", room.path()}).exit == 1);
  CHECK(room.files() == 5);
}

TEST_CASE("a segment is not looked into beside a lock file that is not trusted") {
  const Watchdog watchdog(60);
  const Room room;
  leave_a_dead_segment(room.options());
  REQUIRE(chmod((path_of(room.options()) + ".lock").c_str(), 0666) == 0);
  for (const char* command : {"ls", "top", "who", "clean"}) {
    CAPTURE(command);
    const Ran ran = run_lot(on(room.options(), {command}));
    CHECK(ran.exit == 1);
    CHECK(ran.out.find(".lock: it gives others more than was asked for") != std::string::npos);
  }
  CHECK(room.files() == 2);
}

TEST_CASE("what only its owner can remove is said to be his, by a dry run, too" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(60);
  const Room room;
  REQUIRE(chmod(room.path().c_str(), 01777) == 0);
  auto options = room.options();
  options.group = std::to_string(kGroup);
  Steps ready, over;
  Child ann([&] {
    become(kAnn, kGroup);
    const lot::ShmEngine engine(options);
    ready.tell();
    over.next(50s);
    _exit(0);  // as when it is killed: its files stay
  });
  REQUIRE(ready.next() == '.');
  over.tell();
  REQUIRE(ann.wait() == 0);
  command_file();
  Child bob([&] {
    become(kBob, kGroup);
    const Variable group("LOT_GROUP", std::to_string(kGroup).c_str());
    for (const auto& words : {std::vector<std::string>{"ls"}, {"clean", "--dry-run"}, {"clean"}}) {
      const Ran ran = run_lot(on(options, words));
      must(ran.exit == 1 && ran.out.find("it belongs to uid 65531") != std::string::npos &&
               ran.out.find("root") != std::string::npos,
           ran.out.c_str());
    }
    auto larger = options;
    larger.size_bytes *= 2;
    try {
      const lot::ShmEngine engine(larger);
      must(false, "refused");
    } catch (const lot::Error& error) {
      const std::string text = error.what();
      must(text.find("it belongs to uid 65531") != std::string::npos &&
               text.find("lot clean") != std::string::npos,
           text.c_str());
    }
    const lot::ShmEngine engine(options);  // it goes on with what is there
  });
  CHECK(bob.wait() == 0);
  CHECK(room.files() == 2);
  const Variable group("LOT_GROUP", std::to_string(kGroup).c_str());
  CHECK(run_lot(on(options, {"clean"})).exit == 0);  // root
  CHECK(room.files() == 0);
}

TEST_CASE("the permissions of a shared segment's lock file are not changed") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.permissions = 0666;
  const Actor actor(options, "actor");
  Actor dead(options, "victim");
  stop(actor.child());
  dead.kill9();
  CHECK(run_lot(on(options, {"clean"})).exit == 1);  // it was not asked for such a one
  {
    const Variable permissions("LOT_PERMISSIONS", "0666");
    CHECK(run_lot(on(options, {"clean"})).exit == 0);
  }
  struct stat status {};
  REQUIRE(stat((path_of(options) + ".lock").c_str(), &status) == 0);
  CHECK((status.st_mode & 07777) == 0666);
}

TEST_CASE("lot clean in a loop harms no process of those that come, talk, die and leave") {
  const Watchdog watchdog(120);
  const Room room;
  const auto options = room.options();
  std::mt19937_64 random(seed());
  Actor publisher(options, "publisher");
  Actor reader(options, "reader");
  publisher.act(kLetters, "advertise", 1);
  reader.act(kLetters, "subscribe");
  struct stat before {
  }, after{};
  REQUIRE(stat(path_of(options).c_str(), &before) == 0);
  Steps halt;
  Child cleaner([&] {
    while (halt.next(0ms) == '\0') must_not_break(run_lot(on(options, {"clean"})));
  });
  std::vector<std::unique_ptr<Actor>> others;
  for (unsigned n = 0; n < 150; ++n) {
    check_they_talk(publisher, reader);
    if (others.size() < 3) {
      others.push_back(std::make_unique<Actor>(options, "other"));
      others.back()->act(kLetters, "subscribe");
      others.back()->act(kParcels, "advertise", n + 2);
      others.back()->act(kParcels, "loan");
    } else {
      const std::size_t which = random() % others.size();
      if (random() % 2 == 0) {
        others[which]->kill9();
      } else {
        CHECK(others[which]->leave() == 0);
      }
      others.erase(others.begin() + static_cast<std::ptrdiff_t>(which));
    }
  }
  halt.tell();
  CHECK(cleaner.wait() == 0);
  REQUIRE(stat(path_of(options).c_str(), &after) == 0);
  CHECK(after.st_ino == before.st_ino);
}

TEST_CASE("lot clean in a loop hinders no process of those that make the segment and leave it") {
  const Watchdog watchdog(120);
  const Room room;
  const auto options = room.options();
  Steps halt;
  Child cleaner([&] {
    while (halt.next(0ms) == '\0') must_not_break(run_lot({"clean", "--dir", options.directory}));
  });
  for (unsigned n = 0; n < 60; ++n) {
    Actor publisher(options, "publisher");
    Actor reader(options, "reader");
    publisher.act(kLetters, "advertise", 1);
    reader.act(kLetters, "subscribe");
    check_they_talk(publisher, reader);
    if (n % 3 == 0) {
      publisher.kill9();
      reader.kill9();
    } else {
      CHECK(publisher.leave() == 0);
      CHECK(reader.leave() == 0);
    }
  }
  halt.tell();
  CHECK(cleaner.wait() == 0);
  CHECK(run_lot(on(options, {"clean"})).exit == 0);
  CHECK(room.files() == 0);
}

TEST_SUITE_END();
