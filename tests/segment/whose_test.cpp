// SPDX-License-Identifier: Apache-2.0

// Whose files are trusted: a table of owners, groups and modes; what is said of each, and advised.

#include <cerrno>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>
#include <utility>

#include <doctest/doctest.h>

#include "lot/error.hpp"

#include "segment/trust.hpp"
#include "support/error_of.hpp"
#include "support/scratch.hpp"
#include "support/users.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
using lot::segment::Trust;

struct File {
  uid_t user;
  gid_t group;
  mode_t mode;
};

/// A file of that user at a place of its own. REQUIRES: root.
std::string put(const Directory& room, const File& file, const std::string& name = "s") {
  const std::string path = room.file(name);
  std::ofstream(path) << "";
  must(chown(path.c_str(), file.user, file.group) == 0 && chmod(path.c_str(), file.mode) == 0,
       "a file of that user");
  return path;
}

/// What require() says of it, without the system's words; the path is FILE.
std::string said(const Trust& trust, const std::string& path, int flags = O_RDONLY) {
  const int fd = open(path.c_str(), flags | O_CLOEXEC);
  must(fd != -1, "it can be opened");
  auto [error, text] = error_of([&] { trust.require(fd, path); });
  close(fd);
  const std::string words = error == EPERM ? " (Operation not permitted)" : " (Invalid argument)";
  if (const auto at = text.find(words); at != text.npos) text.erase(at, words.size());
  for (auto at = text.find(path); at != text.npos; at = text.find(path)) {
    text.replace(at, path.size(), "FILE");
  }
  return text;
}

}  // namespace

TEST_SUITE_BEGIN("whose");

TEST_CASE("a file is trusted by its user, its group and its mode; else the error says what to do") {
  if (getuid() != 0 && !can_be_another_user()) return;
  const Directory room;
  const std::optional<uid_t> none;
  const std::string others =
      "have it removed, or made anew with LOT_GROUP=<a common group>, and set the same as a member "
      "of that group; for a segment of your own set LOT_SEGMENT or LOT_DIR";
  const auto neither = [](const std::string& whose) {
    return "lot: FILE: it belongs to " + whose +
           ": neither to you or root, nor to a user or group that was named; ";
  };
  const auto trusting = [&](const std::string& variables, const std::string& otherwise) {
    return "if you trust its users, set " + variables + "; else " + otherwise;
  };
  const std::string directory = std::filesystem::path(room.file()).parent_path();
  const std::string anew =
      "set LOT_SEGMENT, or end all that use it, and remove what a kill has left "
      "by ";
  const auto clean = [&](const std::string& variables) {
    return "`" + variables + "lot clean --dir " + directory + " --segment s`";
  };
  const auto mode_is_none = [](const std::string& mode) {
    return "lot: FILE: no file of LOT has such a mode: it belongs to uid 0 (root), gid 0 (root), "
           "mode " +
           mode + "; chmod it to 0600, or remove it, or set LOT_SEGMENT";
  };
  struct Case {
    File file;
    Trust trust;
    std::string says;
  };
  const Case kCases[] = {
      {{0, 0, 0600}, {}, "no error"},
      {{0, 0, 0400}, {}, "no error"},
      {{0, kGroup, 0600}, {}, "no error"},
      {{kAnn, kGroup, 0600}, {kAnn, none}, "no error"},
      {{kAnn, kGroup, 0660}, {none, kGroup, 0660}, "no error"},
      {{kAnn, kGroup, 0600}, {none, kGroup, 0660}, "no error"},
      {{0, kOtherGroup, 0600}, {none, kGroup, 0660}, "no error"},
      {{0, 0, 0666}, {none, none, 0666}, "no error"},
      {{kAnn, kGroup, 0600},
       {},
       neither("uid 65531, gid 65533, mode 0600") + trusting("LOT_USER=65531", others)},
      {{kAnn, kGroup, 0600},
       {kBob, none},
       neither("uid 65531, gid 65533, mode 0600") + trusting("LOT_USER=65531", others)},
      {{kAnn, kGroup, 0660},
       {},
       neither("uid 65531, gid 65533, mode 0660") + trusting("LOT_GROUP=65533", others)},
      {{kAnn, kOtherGroup, 0660},
       {none, kGroup, 0660},
       neither("uid 65531, gid 65530, mode 0660") + trusting("LOT_GROUP=65530", others)},
      {{kAnn, kGroup, 0666},
       {},
       neither("uid 65531, gid 65533, mode 0666") + others +
           "; only if you trust every user of this machine, set LOT_USER=65531 "
           "LOT_PERMISSIONS=0666"},
      {{kAnn, kGroup, 0606},
       {},
       neither("uid 65531, gid 65533, mode 0606") + others +
           "; only if you trust every user of this machine, set LOT_USER=65531 "
           "LOT_PERMISSIONS=0606"},
      {{kAnn, kGroup, 0640}, {}, neither("uid 65531, gid 65533, mode 0640") + others},
      {{kAnn, kGroup, 0620}, {}, neither("uid 65531, gid 65533, mode 0620") + others},
      {{0, kGroup, 0660},
       {},
       "lot: FILE: it gives others more than was asked for: it belongs to uid 0 (root), gid 65533, "
       "mode 0660, and 0600 was asked for; " +
           trusting("LOT_GROUP=65533", anew + clean("LOT_GROUP=65533 "))},
      {{0, 0, 0666},
       {none, none, 0660},
       "lot: FILE: it gives others more than was asked for: it belongs to uid 0 (root), gid 0 "
       "(root), mode 0666, and 0660 was asked for; " +
           anew + clean("LOT_PERMISSIONS=0666 ") +
           "; only if you trust every user of this machine, set LOT_PERMISSIONS=0666"},
      {{0, kOtherGroup, 0660},
       {none, kGroup, 0660},
       "lot: FILE: it gives rights to another group than gid 65533: it belongs to uid 0 (root), "
       "gid 65530, mode 0660; " +
           trusting("LOT_GROUP=65530", anew + clean("LOT_GROUP=65530 "))},
      {{0, 0, 0640}, {}, mode_is_none("0640")},
      {{0, 0, 0604}, {}, mode_is_none("0604")},
      {{0, 0, 0700}, {}, mode_is_none("0700")},
      {{0, 0, 0601}, {none, none, 0666}, mode_is_none("0601")},
      {{0, 0, 04600}, {}, mode_is_none("04600")}};
  for (const auto& [file, trust, says] : kCases) CHECK(said(trust, put(room, file)) == says);
  for (const auto& [owner, error] : {std::pair(kAnn, 0), std::pair(uid_t{0}, 0),
                                     std::pair(kBob, EPERM), std::pair(uid_t{1}, EPERM)}) {
    const std::string path = put(room, {owner, kGroup, 0600});
    const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
    Child ann([&, of = owner, refused = error] {
      become(kAnn, kGroup);
      const auto [number, text] = error_of([&] { Trust().require(fd, path); });
      must(number == refused, text.c_str());
      must(refused == 0 || names(text, of == kBob ? "set LOT_USER=65532" : "set LOT_USER=1;"),
           text.c_str());
    });
    CHECK(ann.wait() == 0);
    close(fd);
  }
}

TEST_CASE("what is no file, or has two names, is not used") {
  const Directory room;
  const std::string path = room.file("s");
  std::ofstream(path) << "";
  REQUIRE(chmod(path.c_str(), 0600) == 0);
  const Trust trust;
  std::filesystem::create_hard_link(path, room.file("t"));
  CHECK(said(trust, path) ==
        "lot: FILE: it has another name, too: no file that LOT has made has two; remove it, or set "
        "LOT_SEGMENT or LOT_DIR");
  const std::string folder = room.file("folder");
  std::filesystem::create_directory(folder);
  CHECK(said(trust, folder) ==
        "lot: FILE: it is a directory, no file of LOT; remove it if it is yours, or set "
        "LOT_SEGMENT or LOT_DIR");
  CHECK(error_of([&] { trust.require(-1, path); }).first == EBADF);
  using lot::segment::kind_of;
  CHECK(kind_of(path).empty());
  CHECK(kind_of(room.file("nothing")).empty());
  CHECK(kind_of("/") == "a directory");
  CHECK(kind_of("/dev/null") == "a device");
  std::filesystem::create_symlink(path, room.file("l"));
  CHECK(kind_of(room.file("l")) == "a symbolic link");
  REQUIRE(mkfifo(room.file("f").c_str(), 0600) == 0);
  CHECK(kind_of(room.file("f")) == "a FIFO");
  const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  room.file("k").copy(address.sun_path, sizeof(address.sun_path) - 1);
  REQUIRE(bind(fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)) == 0);
  close(fd);
  CHECK(kind_of(room.file("k")) == "a socket");
}

TEST_CASE("a file has owners, may let fewer in than was asked for, and users may remove it") {
  if (getuid() != 0 && !can_be_another_user()) return;
  const Directory room;
  const std::optional<uid_t> none;
  const std::string anns = put(room, {kAnn, kGroup, 0600});
  const std::string roots = put(room, {0, kOtherGroup, 0660}, "r");
  CHECK(!Trust().owns(anns));
  CHECK(Trust{kAnn, none}.owns(anns));
  CHECK(!Trust{kBob, none}.owns(anns));
  CHECK(Trust{none, kGroup}.owns(anns));
  CHECK(!Trust{none, kOtherGroup}.owns(anns));
  CHECK(Trust().owns(roots));
  CHECK(!Trust().owns(room.file("nothing")));
  CHECK(lot::segment::owner_and_mode(anns) == "uid 65531, gid 65533, mode 0600");
  CHECK(lot::segment::owner_and_mode(room.file("nothing")).empty());
  const auto shortfall = [](Trust trust, const std::string& path, bool wants_all = true) {
    trust.wants_all = wants_all;
    const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
    const std::string text = trust.shortfall(fd);
    close(fd);
    return text;
  };
  const std::string narrow = put(room, {0, 0, 0600}, "n");
  CHECK(shortfall({none, kGroup, 0660}, narrow) ==
        "it lets fewer in than was asked for: it belongs to uid 0 (root), gid 0 (root), mode 0600, "
        "and mode 0660 of gid 65533 was asked for");
  CHECK(shortfall({none, none, 0666}, narrow) ==
        "it lets fewer in than was asked for: it belongs to uid 0 (root), gid 0 (root), mode 0600, "
        "and mode 0666 was asked for");
  CHECK(shortfall({none, none, 0600}, narrow).empty());
  CHECK(shortfall({none, kGroup, 0660}, narrow, false).empty());
  CHECK(shortfall({none, kGroup, 0660}, anns).empty());  // another user's may be as narrow
  const std::string own = "; for a segment of your own set LOT_SEGMENT or LOT_DIR";
  const std::string owner =
      "let its owner end all that use it, and make it anew with LOT_GROUP=<a common group>; set "
      "the "
      "same, as a member of that group" +
      own;
  const auto member = [&](const std::string& group) {
    return "become a member of its group (a new login knows of that), and set LOT_GROUP=" + group +
           own;
  };
  CHECK(lot::segment::way_in(anns) == owner);
  CHECK(lot::segment::way_in(roots) == member("65530"));
  CHECK(lot::segment::way_in(put(room, {0, kGroup, 0640}, "h")) == owner);
  CHECK(lot::segment::way_in(put(room, {0, 65534, 0660}, "h")) == owner);
  CHECK(lot::segment::way_in(put(room, {0, kGroup, 0661}, "h")) == member("65533"));
  CHECK(lot::segment::way_in(room.file("nothing")) == owner);
  CHECK(lot::segment::may_remove(anns));  // root may
  const std::string shared = room.file("shared");
  const auto bob_may_remove = [&](const File& directory, uid_t of) {
    std::filesystem::create_directories(shared);
    must(
        chown(shared.c_str(), directory.user, 0) == 0 && chmod(shared.c_str(), directory.mode) == 0,
        "a directory");
    put(room, {of, 0, 0666}, "shared/s");
    Child child([&] {
      become(kBob, kGroup);
      _exit(lot::segment::may_remove(shared + "/s") ? 1 : 0);
    });
    return child.wait() == 1;
  };
  REQUIRE(chmod(std::filesystem::path(anns).parent_path().c_str(), 0755) == 0);
  CHECK(!bob_may_remove({0, 0, 01777}, 0));
  CHECK(!bob_may_remove({0, 0, 01777}, kAnn));
  CHECK(bob_may_remove({0, 0, 01777}, kBob));
  CHECK(bob_may_remove({kBob, 0, 01777}, kAnn));
  CHECK(bob_may_remove({0, 0, 0777}, kAnn));
  CHECK(lot::segment::may_remove(room.file("nothing")));
}

TEST_CASE("options of trust are a user, a group and permissions that fit each other") {
  const auto of = [](const char* user, const char* group, unsigned permissions) {
    lot::EngineOptions options;
    options.user = user;
    options.group = group;
    options.permissions = permissions;
    std::string text;
    const auto [error, what] = error_of([&] {
      const Trust trust = Trust::of(options);
      text = (trust.user ? "user " + std::to_string(*trust.user) + " " : "") +
             (trust.group ? "group " + std::to_string(*trust.group) + " " : "") +
             std::to_string((trust.mode >> 6 & 7) * 100 + (trust.mode >> 3 & 7) * 10 +
                            (trust.mode & 7));
    });
    return error == 0 ? text : what.substr(5, what.find(" (Invalid") - 5);
  };
  const std::pair<std::string, std::string> kTexts[] = {
      {of("", "", 0), "600"},
      {of("17", "", 0), "user 17 600"},
      {of("root", "root", 0), "user 0 group 0 660"},
      {of("daemon", "daemon", 0), "user 1 group 1 660"},
      {of("", "4294967294", 0), "group 4294967294 660"},
      {of("", "4294967295", 0), "group (LOT_GROUP) 4294967295: there is no such group"},
      {of("99999999999999999999", "", 0),
       "user (LOT_USER) 99999999999999999999: there is no such user"},
      {of("no such name", "", 0), "user (LOT_USER) no such name: there is no such user"},
      {of("-1", "", 0), "user (LOT_USER) -1: there is no such user"},
      {of("", "1x", 0), "group (LOT_GROUP) 1x: there is no such group"},
      {of("", "", 0660), "660"},
      {of("", "", 0606), "606"},
      {of("", "", 0666), "666"},
      {of("", "5", 0666), "group 5 666"},
      {of("", "5", 0600), "group (LOT_GROUP) 5: with the permissions 0600 its members cannot join"},
      {of("", "5", 0640), "group (LOT_GROUP) 5: with the permissions 0640 its members cannot join"},
      {of("", "", 0640),
       "permissions (LOT_PERMISSIONS) 0640: nobody could join by one right alone: joining reads "
       "and writes"},
      {of("", "", 0602),
       "permissions (LOT_PERMISSIONS) 0602: nobody could join by one right alone: joining reads "
       "and writes"},
      {of("", "", 0400), "permissions (LOT_PERMISSIONS) 0400: not usable permissions"},
      {of("", "", 0200), "permissions (LOT_PERMISSIONS) 0200: not usable permissions"},
      {of("", "", 0700), "permissions (LOT_PERMISSIONS) 0700: not usable permissions"},
      {of("", "", 04600), "permissions (LOT_PERMISSIONS) 04600: not usable permissions"}};
  for (const auto& [text, expected] : kTexts) CHECK(text == expected);
}

TEST_CASE("a command names the segment as a shell takes it, with the variables that it needs") {
  using lot::segment::command;
  CHECK(command("ls", "/dev/shm/absent") == "`lot ls --segment absent`");
  CHECK(command("clean", "/dev/shm/absent.lock") == "`lot clean --segment absent`");
  CHECK(command("clean", "/dev/shm/absent.new") == "`lot clean --segment absent`");
  CHECK(command("ls", "/a b/c") == "`lot ls --dir '/a b' --segment c`");
  CHECK(command("ls", "/d/it's") == "`lot ls --dir /d --segment 'it'\\''s'`");
  CHECK(command("ls", "/d/") == "`lot ls --dir /d --segment ''`");
  {
    const Variable elsewhere("LOT_DIR", "/tmp");
    CHECK(command("ls", "/dev/shm/absent") == "`lot ls --dir /dev/shm --segment absent`");
    const Variable empty("LOT_DIR", "");
    CHECK(command("ls", "/dev/shm/absent") == "`lot ls --segment absent`");
  }
  if (getuid() != 0 && !can_be_another_user()) return;
  const Directory room;
  const std::string end = "lot ls --dir " +
                          std::string(std::filesystem::path(room.file()).parent_path()) +
                          " --segment s`";
  const std::pair<File, const char*> kFiles[] = {
      {{0, 0, 0600}, "`"},
      {{0, kGroup, 0660}, "`LOT_GROUP=65533 "},
      {{kAnn, kGroup, 0600}, "`LOT_USER=65531 "},
      {{kAnn, kGroup, 0660}, "`LOT_GROUP=65533 "},
      {{kAnn, kGroup, 0666}, "`LOT_USER=65531 LOT_PERMISSIONS=0666 "},
      {{0, 0, 0606}, "`LOT_PERMISSIONS=0606 "},
      {{kAnn, 65534, 0660}, "`LOT_USER=65531 LOT_PERMISSIONS=0660 "},
      {{65534, kGroup, 0600}, "`"},
      {{0, 0, 0640}, "`"}};
  for (const auto& [file, begin] : kFiles) {
    CHECK(command("ls", put(room, file)) == begin + end);
  }
  {
    const Variable empty("LOT_USER", "");
    CHECK(command("ls", put(room, {0, kGroup, 0660})) == "`LOT_GROUP=65533 " + end);
  }
  const Variable user("LOT_USER", "5"), group("LOT_GROUP", "6");
  CHECK(command("ls", put(room, {kAnn, kGroup, 0660})) == "`LOT_GROUP=65533 LOT_USER= " + end);
  CHECK(command("ls", put(room, {kAnn, kGroup, 0600})) == "`LOT_USER=65531 LOT_GROUP= " + end);
  CHECK(command("ls", put(room, {0, 0, 0600})) == "`" + end);
  std::filesystem::rename(room.file("s"), room.file("s.lock"));
  CHECK(command("ls", put(room, {kAnn, kGroup, 0600}, "s.lock")) ==
        "`LOT_USER=65531 LOT_GROUP= " + end);
}

TEST_SUITE_END();
