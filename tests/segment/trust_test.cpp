// SPDX-License-Identifier: Apache-2.0

// A process joins only what it may trust: whose the files are, and what they give to others.

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <sys/stat.h>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/processes.hpp"
#include "support/users.hpp"
#include "transport/participant.hpp"

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
      pusher.push(pusher.loan(Number{7}));
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

TEST_CASE("another user's segment is joined by nobody who has not named him, not by root either") {
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
              must(answer.says("uid 65532, gid 65534, mode 0" +
                               std::string(permissions == 0660U ? "660" : "666")),
                   "whose");
              must(answer.says("LOT_USER=65532 or LOT_GROUP=65534"), "what to do");
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

TEST_CASE("members of a group that is named share a segment, others and strangers do not") {
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
    auto wide = options;
    wide.permissions = 0666;
    CHECK(as(0, 0, [&] { must(Answer(wide).text.empty(), "joined"); }) == 0);
    REQUIRE(chmod(path.c_str(), 0600) == 0);
  }
}

TEST_CASE("a group that one is no member of, or that does not exist: an error, and no file") {
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

TEST_CASE("the environment says nothing to a program that has another user's rights") {
  const Watchdog watchdog(60);
  const Room room;
  // On a file system that knows set-user-id, unlike many a /dev/shm.
  const std::string copy = "/tmp/" + prefix() + "setuid_" + std::to_string(getpid());
  struct Remove {
    const std::string& path;
    ~Remove() { unlink(path.c_str()); }
  } const remove{copy};
  std::filesystem::copy_file("/proc/self/exe", copy);
  for (const bool is_set : {false, true}) {
    CAPTURE(is_set);
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

TEST_CASE("run: it is heard" * doctest::skip()) {
  CHECK(lot::transport::Participant::trust_of_environment().user == 4711);
}
TEST_CASE("run: it is not heard" * doctest::skip()) {
  REQUIRE(geteuid() == kAnn);
  CHECK(!lot::transport::Participant::trust_of_environment().user);
}
