// SPDX-License-Identifier: Apache-2.0

// What lies under the names of LOT's files, but is not what it should be.

#include <cerrno>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"
#include "support/users.hpp"

namespace {

using namespace lot::testing;
namespace fs = std::filesystem;

[[maybe_unused]] const bool has_janitor = start_janitor();

struct Number {
  std::uint64_t value;
};

constexpr const char* kRubbish = "a text of mine that nobody may remove";

std::string text_of(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

/// Joins and hands one message over; the text of the lot::Error, or "".
std::string use(const lot::EngineOptions& options) {
  try {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t");
    auto puller = engine.subscribe<Number>("/t");
    must_go(pusher.push(pusher.loan(std::uint64_t{7})));
    const auto seen = puller.pull(10s);
    must(seen && seen->value == 7, "the message");
  } catch (const lot::Error& e) {
    return e.what();
  }
  return "";
}
bool says(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace

TEST_SUITE_BEGIN("leftovers");

TEST_CASE("an unfinished file of whatever kind and permissions does not stand in the way") {
  const Watchdog watchdog(60);
  for (const mode_t mode : {0000U, 0400U, 0666U, 0777U}) {
    CAPTURE(mode);
    const Ground options;
    const std::string unfinished = file_of(options) + ".new";
    std::ofstream(unfinished) << kRubbish;
    REQUIRE(chmod(unfinished.c_str(), mode) == 0);
    {
      const lot::ShmEngine engine(options);
      CHECK(!fs::exists(unfinished));
      struct stat status {};
      REQUIRE(stat(engine.path().c_str(), &status) == 0);
      CHECK((status.st_mode & 07777) == 0600);  // nothing of it is in the segment
    }
    CHECK(use(options) == "");
    CHECK(files_of(options) == 0);
  }
  {
    const Ground options;
    REQUIRE(mkfifo((file_of(options) + ".new").c_str(), 0600) == 0);
    CHECK(use(options) == "");
    CHECK(files_of(options) == 0);
  }
  {
    const Ground options;
    const std::string elsewhere = file_of(options) + "_elsewhere";
    std::ofstream(elsewhere) << kRubbish;
    fs::create_symlink(elsewhere, file_of(options) + ".new");
    CHECK(use(options) == "");
    CHECK(text_of(elsewhere) == kRubbish);
    fs::remove(elsewhere);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a directory under the unfinished file's name is an error that names it") {
  const Watchdog watchdog(60);
  const Ground options;
  const std::string unfinished = file_of(options) + ".new";
  fs::create_directory(unfinished);
  const std::string text = use(options);
  CHECK(says(text, unfinished));
  CHECK(fs::is_directory(unfinished));
  fs::remove(unfinished);
  CHECK(files_of(options) == 0);
}

TEST_CASE("another user's unfinished file is an error, and is left as it was" *
          doctest::skip(!can_be_another_user())) {
  const Watchdog watchdog(60);
  const Ground options;
  const std::string unfinished = file_of(options) + ".new";
  std::ofstream(unfinished) << kRubbish;
  REQUIRE(chmod(unfinished.c_str(), 0666) == 0);
  Child nobody([&] {
    must(setgid(65534) == 0 && setuid(65534) == 0, "another user");
    must(says(use(options), file_of(options)), "an error that names it");
  });
  CHECK(nobody.wait() == 0);
  CHECK(fs::file_size(unfinished) == std::string(kRubbish).size());
  CHECK(text_of(unfinished) == kRubbish);
  CHECK(files_of(options) == 1);
}

TEST_CASE("a segment that is a directory, a FIFO or a device is an error, and is left alone") {
  const Watchdog watchdog(60);
  for (const int kind : {S_IFDIR, S_IFIFO, S_IFCHR, S_IFSOCK}) {
    CAPTURE(kind);
    const Ground options;
    const std::string path = file_of(options);
    if (kind == S_IFDIR) {
      REQUIRE(mkdir(path.c_str(), 0700) == 0);
    } else if (mknod(path.c_str(), static_cast<mode_t>(kind) | 0600, makedev(1, 3)) != 0) {
      REQUIRE(errno == EPERM);  // devices are root's
      continue;
    }
    struct stat before {
    }, after{};
    REQUIRE(lstat(path.c_str(), &before) == 0);
    CHECK(says(use(options), path));
    REQUIRE(lstat(path.c_str(), &after) == 0);
    CHECK(after.st_ino == before.st_ino);
    CHECK(after.st_mode == before.st_mode);
    CHECK(files_of(options) == 1);  // and no lock file beside it
  }
}

TEST_CASE("a lock file that is a directory or a link is an error, and is left alone") {
  const Watchdog watchdog(60);
  for (const bool link : {true, false}) {
    CAPTURE(link);
    const Ground options;
    const std::string path = file_of(options) + ".lock";
    if (link) {
      fs::create_symlink("/dev/null", path);
    } else {
      fs::create_directory(path);
    }
    CHECK(says(use(options), path));
    CHECK(fs::exists(fs::symlink_status(path)));
    CHECK(files_of(options) == 1);
  }
}

TEST_CASE("a lock file that is a FIFO, a device or a user's text is an error, and is left alone") {
  const Watchdog watchdog(60);
  for (const int kind : {S_IFIFO, S_IFCHR, S_IFREG}) {
    CAPTURE(kind);
    const Ground options;
    const std::string path = file_of(options) + ".lock";
    if (kind == S_IFREG) {
      std::ofstream(path) << kRubbish;
    } else if (mknod(path.c_str(), static_cast<mode_t>(kind) | 0644, makedev(1, 3)) != 0) {
      REQUIRE(errno == EPERM);
      continue;
    }
    struct stat before {
    }, after{};
    REQUIRE(lstat(path.c_str(), &before) == 0);
    CHECK(says(use(options), path));
    CHECK(lstat(path.c_str(), &after) == 0);
    CHECK(after.st_ino == before.st_ino);
    CHECK(after.st_mode == before.st_mode);
    CHECK(files_of(options) == 1);
  }
}

TEST_SUITE_END();
