// SPDX-License-Identifier: Apache-2.0

// A process joins only what it may trust: whose the files are, and what they give to others.

#include "segment/trust.hpp"

#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <string>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/users.hpp"
#include "transport/environment.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Number {
  std::uint64_t value;
};

std::string file_of(const lot::EngineOptions& options) {
  return options.directory + "/" + options.segment;
}

/// Where any user may make files, and remove only his own, as in /dev/shm.
class Room {
 public:
  Room() : path_("/dev/shm/" + prefix() + "room_" + std::to_string(getpid())) {
    must(mkdir(path_.c_str(), 0700) == 0 && chmod(path_.c_str(), 01777) == 0, "a directory");
  }
  ~Room() { std::filesystem::remove_all(path_); }
  Room(const Room&) = delete;
  Room& operator=(const Room&) = delete;

  lot::EngineOptions options() const {
    lot::EngineOptions options = fresh();
    options.directory = path_;
    options.segment = "s";
    return options;
  }

 private:
  std::string path_;
};

/// What joining says: nothing if it works.
struct Answer {
  explicit Answer(const lot::EngineOptions& options) {
    try {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Number>("/numbers");
      auto puller = engine.subscribe<Number>("/numbers");
      must_go(pusher.push(pusher.loan(Number{7})));
      must(puller.pull(10s)->value == 7, "it works");
    } catch (const lot::Error& error) {
      number = error.error_number();
      text = error.what();
    }
  }
  bool says(const std::string& what) const { return text.find(what) != std::string::npos; }

  int number = 0;
  std::string text;
};

/// Someone who has made a segment, and is there.
class Owner {
 public:
  Owner(const lot::EngineOptions& options, uid_t user, gid_t group)
      : child_([&options, user, group, this] {
          if (user != 0) become(user, group);
          umask(0);
          const lot::ShmEngine engine(options);
          ready_.tell();
          over_.next(50s);
        }) {
    must(ready_.next() == '.', "the owner is there");
  }
  ~Owner() {
    over_.tell();
    must(child_.wait() == 0, "the owner leaves");
  }
  Owner(const Owner&) = delete;
  Owner& operator=(const Owner&) = delete;

 private:
  Steps ready_, over_;
  Child child_;
};

void write_to(const std::string& path, const std::string& text) { std::ofstream(path) << text; }
std::string read_from(const std::string& path) {
  std::string text;
  std::getline(std::ifstream(path), text);
  return text;
}

/// Runs as another user.
int as(uid_t user, gid_t group, const std::function<void()>& body) {
  Child child([&] {
    if (user != 0) become(user, group);
    body();
  });
  return child.wait();
}

}  // namespace

TEST_SUITE_BEGIN("trust" * doctest::skip(!can_be_another_user()));

TEST_CASE("a file belongs to the users that are named now, and to none that was named before") {
  const Room room;
  const std::string path = file_of(room.options());
  write_to(path, "");
  must(chown(path.c_str(), kBob, kGroup) == 0, "its user");
  lot::segment::Trust trust;
  CHECK_FALSE(trust.owns(path));
  trust.user = kBob;
  CHECK(trust.owns(path));
  trust.user.reset();
  CHECK_FALSE(trust.owns(path));
  trust.group = kGroup;
  CHECK(trust.owns(path));
  trust.group.reset();
  CHECK_FALSE(trust.owns(path));
}

TEST_CASE("without LOT_USER or LOT_GROUP no process joins another user's segment, nor does root") {
  const Watchdog watchdog(60);
  for (const unsigned permissions : {0660U, 0666U}) {
    CAPTURE(permissions);
    const Room room;
    auto options = room.options();
    options.permissions = permissions;
    const Owner mallory(options, kBob, kOtherGroup);
    const Facts before = facts_of(file_of(options));
    for (const uid_t user : {kAnn, uid_t{0}}) {
      CAPTURE(user);
      CHECK(as(user, kOtherGroup, [&] {
              const Answer answer(options);
              must(answer.number == EPERM, "refused");
              must(answer.says(file_of(options) + ".lock"), "which file");
              must(answer.says("it belongs to uid 65532") && answer.says("gid 65530"), "whose");
              must(answer.says(permissions == 0660 ? "mode 0660: neither" : "mode 0666: neither"),
                   "its mode");
              must(answer.says(permissions == 0660 ? "set LOT_GROUP=65530;"
                                                   : "; only if you trust every user of this "
                                                     "machine, set LOT_USER=65532 "
                                                     "LOT_PERMISSIONS=0666"),
                   "what to do");
            }) == 0);
      auto trusting = options;
      trusting.user = std::to_string(kBob);
      CHECK(as(user, kOtherGroup, [&] { must(Answer(trusting).text.empty(), "joined"); }) == 0);
    }
    CHECK(facts_of(file_of(options)) == before);
  }
}

TEST_CASE("another user's segment alone, or lock file alone, is not used") {
  const Watchdog watchdog(60);
  for (const bool has_lock : {false, true}) {
    CAPTURE(has_lock);
    const Room room;
    const auto options = room.options();
    const std::string path = file_of(options) + (has_lock ? ".lock" : "");
    REQUIRE(as(kBob, kOtherGroup, [&] {
              auto wide = options;
              wide.permissions = 0666;
              wide.persist = true;
              { const lot::ShmEngine engine(wide); }
              unlink((file_of(options) + (has_lock ? "" : ".lock")).c_str());
            }) == 0);
    for (const uid_t user : {kAnn, uid_t{0}}) {
      CHECK(as(user, kOtherGroup, [&] {
              const Answer answer(options);
              must(answer.number == EPERM && answer.says(path + ": it belongs to uid 65532"),
                   answer.text.c_str());
            }) == 0);
    }
    CHECK(facts_of(path) == Facts{kBob, kOtherGroup, 0666});
    // What they have made themselves meanwhile has gone.
    CHECK(std::distance(std::filesystem::directory_iterator(options.directory), {}) == 1);
  }
}

TEST_CASE("members of the LOT_GROUP share a segment, other users and strangers do not") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.group = std::to_string(kGroup);
  const Owner ann(options, kAnn, kGroup);
  for (const char* suffix : {"", ".lock"}) {
    CHECK(facts_of(file_of(options) + suffix) == Facts{kAnn, kGroup, 0660});
  }
  CHECK(as(kBob, kGroup, [&] { must(Answer(options).text.empty(), "joined"); }) == 0);
  CHECK(as(0, 0, [&] { must(Answer(options).text.empty(), "joined"); }) == 0);
  CHECK(as(kBob, kGroup, [&] {
          const Answer answer(room.options());  // names no group
          must(answer.number == EPERM && answer.says("LOT_GROUP=65533"), answer.text.c_str());
        }) == 0);
  CHECK(as(kBob, kOtherGroup, [&] { must(Answer(options).number == EACCES, "refused"); }) == 0);
}

TEST_CASE("no error advises LOT_GROUP for a user whom the system does not know") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.group = std::to_string(kNoGroup);
  const Owner bob(options, kBob, kNoGroup);
  for (const bool can_open : {true, false}) {
    CAPTURE(can_open);
    CHECK(as(can_open ? 0 : kAnn, kGroup, [&] {
            const Answer answer(room.options());
            must(answer.number == (can_open ? EPERM : EACCES), answer.text.c_str());
            must(!answer.says("LOT_GROUP=65534") && !answer.says("become a member"),
                 answer.text.c_str());
            must(answer.says("LOT_GROUP=<a common group>"), answer.text.c_str());
            must(answer.says("set LOT_USER=65532 LOT_PERMISSIONS=0660;") == can_open,
                 answer.text.c_str());
          }) == 0);
  }
}

TEST_CASE("what a kill has left with a wider mode goes by the command that the error says") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.permissions = 0666;
  options.persist = true;
  { const lot::ShmEngine engine(options); }
  const Answer answer(room.options());
  CHECK(answer.number == EPERM);
  CHECK_MESSAGE(answer.says("`LOT_PERMISSIONS=0666 lot clean --dir " + options.directory +
                            " --segment s`; only if you trust every user of this machine, set "
                            "LOT_PERMISSIONS=0666"),
                answer.text);
  // It clears what is exported where it is pasted.
  CHECK(as(0, 0, [&] {
          setenv("LOT_GROUP", "65533", 1);
          const Answer exported(room.options());
          must(exported.says("`LOT_PERMISSIONS=0666 LOT_GROUP= lot clean --dir "),
               exported.text.c_str());
        }) == 0);
}

TEST_CASE("root's segment is trusted") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.permissions = 0666;
  const Owner root(options, 0, 0);
  CHECK(as(kBob, kOtherGroup, [&] { must(Answer(options).text.empty(), "joined"); }) == 0);
}

TEST_CASE("one's own segment that gives others more than was asked for is not joined") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  const lot::ShmEngine maker(options);
  for (const char* suffix : {"", ".lock"}) {
    CAPTURE(suffix);
    const std::string path = file_of(options) + suffix;
    REQUIRE(chmod(path.c_str(), 0606) == 0);
    CHECK(as(0, 0, [&] {
            const Answer answer(options);
            must(answer.number == EPERM && answer.says(path) && answer.says("mode 0606") &&
                     answer.says("0600 was asked for") && answer.says("LOT_PERMISSIONS=0606"),
                 answer.text.c_str());
          }) == 0);
    // Nor by who has joined it before.
    if (std::string(suffix) == ".lock") CHECK(Answer(options).number == EPERM);
    auto wide = options;
    wide.permissions = 0606;
    for (const mode_t mode : {mode_t{0606}, mode_t{0600}}) {
      for (const char* each : {"", ".lock"}) {
        REQUIRE(chmod((file_of(options) + each).c_str(), mode) == 0);
      }
      if (mode == 0606) {
        CHECK(as(0, 0, [&] { must(Answer(wide).text.empty(), "joined"); }) == 0);
      }
    }
  }
}

TEST_CASE("one's own segment that lets fewer in than a group was asked for is in use: an error") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  auto shared = options;
  shared.group = std::to_string(kGroup);
  const lot::ShmEngine maker(options);
  const auto is_refused = [&](const char* suffix) {
    const Answer answer(shared);
    must(answer.number == EPERM &&
             answer.says(file_of(options) + suffix +
                         ": it lets fewer in than was asked for: it belongs to uid 0 (root)") &&
             answer.says("mode 0600, and mode 0660 of gid 65533 was asked for; and it is in use") &&
             answer.says("`lot ls --dir " + options.directory + " --segment s`"),
         answer.text.c_str());
  };
  CHECK(as(0, 0, [&] { is_refused(""); }) == 0);
  is_refused(".lock");  // who has joined it before
  CHECK(as(0, 0, [&] { must(Answer(options).text.empty(), "joined as it is"); }) == 0);
  CHECK(facts_of(file_of(options)) == Facts{0, getgid(), 0600});
}

TEST_CASE("what a kill has left that lets fewer in than a group was asked for is made anew") {
  const Watchdog watchdog(60);
  for (const bool has_lock : {true, false}) {
    CAPTURE(has_lock);
    const Room room;
    const auto options = room.options();
    auto shared = options;
    shared.group = std::to_string(kGroup);
    Steps ready;
    Child maker([&] {
      const lot::ShmEngine engine(options);
      ready.tell();
      pause();
    });
    REQUIRE(ready.next() == '.');
    maker.kill9();
    if (!has_lock) REQUIRE(unlink((file_of(options) + ".lock").c_str()) == 0);
    const lot::ShmEngine engine(shared);
    for (const char* suffix : {"", ".lock"}) {
      CHECK(facts_of(file_of(options) + suffix) == Facts{0, kGroup, 0660});
    }
    CHECK(as(kBob, kGroup, [&] { must(Answer(shared).text.empty(), "joined"); }) == 0);
  }
}

TEST_CASE("a narrow segment of a process that has closed its descriptors is in use") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  auto shared = options;
  shared.group = std::to_string(kGroup);
  Steps ready, over;
  Child maker([&] {
    const lot::ShmEngine engine(options);
    // Again and again, since LOT opens the lock file once more and takes its byte back.
    while (over.next(0ms) == '\0') {
      for (int fd = 3; fd < 256; ++fd) {
        std::error_code none;
        const auto name =
            std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(fd), none);
        if (name == file_of(options) + ".lock") close(fd);
      }
      ready.tell();
      std::this_thread::sleep_for(1ms);
    }
  });
  REQUIRE(ready.next() == '.');
  for (int n = 0; n < 20; ++n) {
    const Answer answer(shared);
    REQUIRE(answer.number == EPERM);
    REQUIRE_MESSAGE(answer.says("and it is in use"), answer.text);
    REQUIRE(ready.next() == '.');
  }
  CHECK(facts_of(file_of(options)) == Facts{0, getgid(), 0600});
  over.tell();
  CHECK(maker.wait() == 0);
}

TEST_CASE("a narrow segment in which items wait is not made anew") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  auto shared = options;
  shared.group = std::to_string(kGroup);
  Steps ready;
  Child putter([&] {
    lot::ShmEngine engine(options);
    must(engine.queue<std::uint64_t>("jobs").put(7) == lot::Status::Ok, "put");
    ready.tell();
    pause();
  });
  REQUIRE(ready.next() == '.');
  putter.kill9();
  const Answer answer(shared);
  CHECK(answer.number == ENOTEMPTY);
  CHECK_MESSAGE(answer.says("it lets fewer in than was asked for"), answer.text);
  CHECK_MESSAGE(answer.says("1 item waits in it"), answer.text);
  CHECK_MESSAGE(answer.says("`lot clean --with-items --dir " + options.directory + " --segment s`"),
                answer.text);
  lot::ShmEngine engine(options);
  CHECK(engine.queue<std::uint64_t>("jobs").try_pop() == 7);
}

TEST_CASE("what is another user's may let fewer in than was asked for") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.group = std::to_string(kGroup);
  const Owner ann(options, kAnn, kGroup);
  options.permissions = 0666;
  CHECK(as(kBob, kGroup, [&] { must(Answer(options).text.empty(), "joined"); }) == 0);
}

TEST_CASE("an unfinished segment of another user is not removed") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  const std::string path = file_of(options) + ".new";
  REQUIRE(as(kBob, kOtherGroup, [&] { write_to(path, "Bob's own"); }) == 0);
  CHECK(as(0, 0, [&] {
          const Answer answer(options);
          must(answer.number == EEXIST && answer.says(path), answer.text.c_str());
        }) == 0);
  CHECK(read_from(path) == "Bob's own");
}

TEST_CASE("one's own segment that gives rights to another group is not joined") {
  const Watchdog watchdog(60);
  const Room room;
  auto options = room.options();
  options.group = std::to_string(kOtherGroup);
  const Owner other(options, 0, 0);
  options.group = std::to_string(kGroup);
  const Answer answer(options);
  CHECK(answer.number == EPERM);
  CHECK(answer.says("another group than gid 65533"));
  CHECK(answer.says("set LOT_GROUP=65530;"));
}

TEST_CASE("a file with a second name is not used") {
  const Watchdog watchdog(60);
  const Room room;
  const auto options = room.options();
  const Owner owner(options, 0, 0);
  for (const char* suffix : {"", ".lock"}) {
    CAPTURE(suffix);
    const std::string path = file_of(options) + suffix;
    REQUIRE(link(path.c_str(), (path + ".other").c_str()) == 0);
    CHECK(Answer(options).number == EPERM);
    REQUIRE(unlink((path + ".other").c_str()) == 0);
  }
}

TEST_CASE("a lease on the file holds no joiner up") {
  const Watchdog watchdog(30);  // the kernel waits for 45 seconds, unless it is told not to
  for (const char* suffix : {"", ".lock"}) {
    CAPTURE(suffix);
    const Room room;
    auto options = room.options();
    options.permissions = 0666;
    options.persist = true;
    options.user = std::to_string(kBob);
    Steps ready, over;
    Child bob([&] {
      signal(SIGIO, SIG_IGN);
      become(kBob, kOtherGroup);
      { const lot::ShmEngine engine(options); }
      const int file = open((file_of(options) + suffix).c_str(), O_RDONLY | O_CLOEXEC);
      must(fcntl(file, F_SETLEASE, F_RDLCK) == 0, "a lease");
      ready.tell();
      over.next(25s);
    });
    REQUIRE(ready.next() == '.');
    const Answer answer(options);
    CHECK(answer.number == EAGAIN);
    CHECK(answer.says("lease"));
    over.tell();
    CHECK(bob.wait() == 0);
  }
}

TEST_CASE("LOT_GROUP without this user, or that does not exist, is an error, and leaves no file") {
  const Watchdog watchdog(60);
  const Room room;
  const auto answer_of = [&](const std::string& user, const std::string& group,
                             unsigned permissions) {
    auto options = room.options();
    options.user = user;
    options.group = group;
    options.permissions = permissions;
    return Answer(options);
  };
  CHECK(as(kBob, kOtherGroup, [&] {
          const Answer answer = answer_of("", std::to_string(kGroup), 0);
          must(answer.number == EPERM && answer.says("LOT_GROUP"), answer.text.c_str());
        }) == 0);
  CHECK(answer_of("", "no such group", 0).number == EINVAL);
  CHECK(answer_of("no such user", "", 0).number == EINVAL);
  CHECK(answer_of("", "4294967295", 0).number == EINVAL);  // "none" to the kernel
  CHECK(answer_of("", "-1", 0).number == EINVAL);
  CHECK(answer_of("", "root", 0600).number == EINVAL);  // its members would have no right
  for (const unsigned permissions : {0777U, 01777U, 04600U, 0400U, 0060U}) {
    CAPTURE(permissions);
    CHECK(answer_of("", "", permissions).number == EINVAL);
  }
  CHECK(answer_of("root", "root", 0).number == 0);
  CHECK(std::filesystem::is_empty(room.options().directory));
}

TEST_CASE("of another file, a directory, a link, a pipe in its place nothing is used or changed") {
  const Watchdog watchdog(60);
  for (const char* suffix : {"", ".lock"}) {
    const Room room;
    const auto options = room.options();
    const std::string path = file_of(options) + suffix;
    REQUIRE(mkfifo(path.c_str(), 0600) == 0);
    CHECK(Answer(options).number == EINVAL);
    REQUIRE(unlink(path.c_str()) == 0);
    REQUIRE(mkdir(path.c_str(), 0700) == 0);
    CHECK(Answer(options).number == EISDIR);
    REQUIRE(rmdir(path.c_str()) == 0);
    REQUIRE(symlink("/etc/passwd", path.c_str()) == 0);
    CHECK(Answer(options).number == ELOOP);
    REQUIRE(unlink(path.c_str()) == 0);
    CHECK(std::filesystem::is_empty(options.directory));
  }
}

TEST_CASE("LOT_USER in the environment is not heard by a program with another user's rights") {
  const Watchdog watchdog(60);
  const Room room;
  // On a file system that knows set-user-id, unlike many a /dev/shm.
  const std::string copy = "/tmp/" + prefix() + "setuid_" + std::to_string(getpid());
  struct Remove {
    const std::string& path;
    ~Remove() { unlink(path.c_str()); }
  } const remove{copy};
  std::filesystem::copy_file("/proc/self/exe", copy);
  struct statvfs system {};
  REQUIRE(statvfs(copy.c_str(), &system) == 0);
  const bool knows =
      (system.f_flag & ST_NOSUID) == 0 && prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) == 0;
  if (!knows) std::printf("skipped: the system gives no program another user's rights here\n");
  for (const bool is_set : {false, true}) {
    CAPTURE(is_set);
    if (is_set && !knows) break;
    REQUIRE(chown(copy.c_str(), kAnn, kGroup) == 0);
    REQUIRE(chmod(copy.c_str(), is_set ? 04755 : 0755) == 0);
    CHECK(as(kBob, kGroup, [&] {
            setenv("LOT_USER", "4711", 1);
            execl(copy.c_str(), copy.c_str(), "--no-skip",
                  is_set ? "-tc=run: it is not heard" : "-tc=run: it is heard", nullptr);
          }) == 0);
  }
}

TEST_SUITE_END();

// The programs of the case above. _exit: LeakSanitizer cannot look at a set-user-ID program.
TEST_CASE("run: it is heard" * doctest::skip()) {
  _exit(lot::transport::trust_of_environment().user == 4711 ? 0 : 1);
}
TEST_CASE("run: it is not heard" * doctest::skip()) {
  must(geteuid() == kAnn, "it has Ann's rights");
  _exit(lot::transport::trust_of_environment().user ? 1 : 0);
}
