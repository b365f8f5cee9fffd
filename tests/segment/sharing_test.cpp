// SPDX-License-Identifier: Apache-2.0

// Users of one group share a segment, also where fs.protected_regular is in force; joining changes
// nothing of the files that are there.

#include <cerrno>
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <fcntl.h>
#include <random>
#include <string>
#include <sys/stat.h>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/users.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

bool rule_in_force = false;
unsigned refused = 0;

/// fs.protected_regular: in a sticky directory that others may write to, O_CREAT opens no file of
/// another user. See proc_sys_fs(5), "protected_regular".
bool is_refused(const char* path, int flags) {
  struct stat file {
  }, directory{};
  const std::string name(path);
  return rule_in_force && (flags & O_CREAT) != 0 && stat(path, &file) == 0 &&
         S_ISREG(file.st_mode) &&
         stat(name.substr(0, name.rfind('/') + 1).c_str(), &directory) == 0 &&
         (directory.st_mode & S_ISVTX) != 0 && (directory.st_mode & (S_IWGRP | S_IWOTH)) != 0 &&
         file.st_uid != directory.st_uid && file.st_uid != geteuid();
}

std::string file_of(const lot::EngineOptions& options) {
  return options.directory + "/" + options.segment;
}

lot::EngineOptions with_permissions(unsigned permissions) {
  lot::EngineOptions options = fresh();
  options.permissions = permissions;
  return options;
}
lot::EngineOptions shared() {
  lot::EngineOptions options = fresh();
  options.group = std::to_string(kGroup);
  return options;
}

struct Number {
  std::uint64_t value;
};

}  // namespace

extern "C" {
int __real_open(const char* path, int flags, ...);
int __wrap_open(const char* path, int flags, ...) {
  unsigned mode = 0;
  if ((flags & (O_CREAT | O_TMPFILE)) != 0) {
    va_list arguments;
    va_start(arguments, flags);
    mode = va_arg(arguments, unsigned);
    va_end(arguments);
  }
  // With O_EXCL the kernel says that there is one.
  if ((flags & O_EXCL) == 0 && is_refused(path, flags)) {
    ++refused;
    errno = EACCES;
    return -1;
  }
  return __real_open(path, flags, mode);
}
}

TEST_SUITE_BEGIN("sharing" * doctest::skip(!can_be_another_user()));

TEST_CASE("users of one group talk where O_CREAT opens no file of another user") {
  const Watchdog watchdog(60);
  rule_in_force = true;
  const auto options = shared();
  Steps ready, done, over;
  Child ann([&] {
    become(kAnn, kGroup);
    umask(077);
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/numbers");
    ready.tell();
    must(pusher.wait_for_readers(1, 20s), "Bob has come");
    must(pusher.push(pusher.loan(Number{7})) == lot::Status::Ok, "pushed");
    must(done.next() != 0, "Bob has read");
    const Facts all{kAnn, kGroup, 0660};
    must(facts_of(engine.path()) == all && facts_of(engine.path() + ".lock") == all,
         "the files are as Ann has made them");
    over.tell();
  });
  REQUIRE(ready.next() != 0);
  Child bob([&] {
    become(kBob, kGroup);
    umask(077);
    // The rule is in force.
    must(open((file_of(options) + ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0660) == -1 &&
             errno == EACCES && refused == 1,
         "O_CREAT is refused");
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Number>("/numbers");
    const auto number = puller.pull(10s);
    must(number && number->value == 7, "Ann's number");
    must(refused == 1, "the library does not ask for it");
    done.tell();
    must(over.next() != 0, "Ann has looked");
  });
  CHECK(bob.wait() == 0);
  CHECK(ann.wait() == 0);
  rule_in_force = false;
  remove_files_of(options);  // Bob may have left last, and may not remove Ann's files
}

TEST_CASE("a joiner with other permissions hears of it, and leaves those of the files alone") {
  const Watchdog watchdog(60);
  for (const unsigned made : {0600U, 0660U, 0666U}) {
    CAPTURE(made);
    auto options = with_permissions(made);
    const lot::ShmEngine maker(options);
    const Facts before = facts_of(maker.path());
    CHECK(before.mode == made);
    for (const unsigned asked : {0600U, 0660U, 0666U}) {
      options.permissions = asked;
      Child joiner([&] {
        try {
          const lot::ShmEngine engine(options);
          must(made == asked, "it gives others what was asked for");
        } catch (const lot::Error& error) {
          must(made != asked && error.error_number() == EPERM, error.what());
          const bool is_narrow = (asked & ~made) != 0;
          must(is_narrow == names(error.what(), "it lets fewer in than was asked for"),
               error.what());
        }
      });
      CHECK(joiner.wait() == 0);
      CHECK(facts_of(maker.path()) == before);
      CHECK(facts_of(maker.path() + ".lock") == before);
    }
  }
}

TEST_CASE("a user outside the group is told whose file it is") {
  const Watchdog watchdog(60);
  const auto options = shared();
  Steps ready, over;
  Child ann([&] {
    become(kAnn, kGroup);
    const lot::ShmEngine engine(options);
    ready.tell();
    must(over.next() != 0, "Bob has tried");
  });
  REQUIRE(ready.next() != 0);
  Child bob([&] {
    become(kBob, kOtherGroup);
    try {
      const lot::ShmEngine engine(options);
    } catch (const lot::Error& error) {
      const std::string text = error.what();
      must(error.error_number() == EACCES, "EACCES");
      must(text.find("uid 65531, gid 65533, mode 0660") != std::string::npos, "whose it is");
      must(text.find("become a member of its group (a new login knows of that), and set "
                     "LOT_GROUP=65533;") != std::string::npos,
           "what to do");
      return;
    }
    must(false, "Bob is not let in");
  });
  CHECK(bob.wait() == 0);
  over.tell();
  CHECK(ann.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("permissions that give one right alone are refused: no process could join by it") {
  for (const unsigned permissions : {0640U, 0644U, 0664U, 0620U, 0602U, 0646U}) {
    CAPTURE(permissions);
    const auto options = with_permissions(permissions);
    const auto [error, text] = error_of([&] { const lot::ShmEngine engine(options); });
    CHECK(error == EINVAL);
    CHECK(names(text, "joining reads and writes"));
    CHECK(files_of(options) == 0);
  }
  for (const unsigned permissions : {0600U, 0660U, 0606U, 0666U}) {
    CAPTURE(permissions);
    const lot::ShmEngine engine(with_permissions(permissions));
    CHECK(facts_of(engine.path()).mode == permissions);
    CHECK(facts_of(engine.path() + ".lock").mode == permissions);
  }
}

TEST_CASE("a file that a user has given such permissions is not joined, and the error says so") {
  const auto options = with_permissions(0600);
  const lot::ShmEngine engine(options);
  REQUIRE(chmod(engine.path().c_str(), 0644) == 0);
  Child other([&] {
    const auto [error, text] = error_of([&] { const lot::ShmEngine mine(options); });
    must(error == EPERM && names(text, "no file of LOT has such a mode"), text.c_str());
  });
  CHECK(other.wait() == 0);
}

TEST_CASE("a maker that is killed leaves no lock file that its group cannot open") {
  const Watchdog watchdog(60);
  std::mt19937_64 random(seed());
  unsigned left = 0;
  for (int round = 0; round < 100; ++round) {
    const auto options = shared();
    Child maker([&] {
      umask(077);
      const lot::ShmEngine engine(options);
      pause();
    });
    usleep(static_cast<useconds_t>(random() % 2000));
    maker.kill9();
    const std::string lock = file_of(options) + ".lock";
    if (access(lock.c_str(), F_OK) != 0) continue;
    ++left;
    CHECK(facts_of(lock) == Facts{getuid(), kGroup, 0660});
    std::remove(lock.c_str());
    std::remove((file_of(options) + ".new").c_str());
    std::remove(file_of(options).c_str());
  }
  CHECK(left > 0);
}
