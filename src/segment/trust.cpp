// SPDX-License-Identifier: Apache-2.0
#include "segment/trust.hpp"

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <grp.h>
#include <pwd.h>
#include <string_view>
#include <sys/stat.h>
#include <unistd.h>
#include <vector>

#include "lot/error.hpp"

namespace lot::segment {
namespace {

constexpr mode_t kOwn = 0600;
constexpr mode_t kOfGroup = 0060;

/// True when a class (user, group, others) may read and not write, or write and not read.
bool gives_half(mode_t mode) { return ((mode >> 1 ^ mode) & 0222) != 0; }

std::string in_octal(mode_t mode) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "0%o", mode & 07777U);
  return text.data();
}

/// The number that the text is. Nothing: it is a name.
std::optional<unsigned> number_of(const std::string& text) {
  if (text.empty() || text.find_first_not_of("0123456789") != std::string::npos) return {};
  errno = 0;
  const unsigned long number = std::strtoul(text.c_str(), nullptr, 10);
  // The highest number means "none" in many system calls.
  if (errno != 0 || number >= ~0U) return {};
  return static_cast<unsigned>(number);
}

/// Looks a name up by getpwnam_r or getgrnam_r. Entries may be long: a group has a list of members.
template <class Entry, class Lookup>
std::optional<Entry> look_up(const std::string& name, Lookup&& lookup) {
  std::vector<char> text(1024);
  for (;;) {
    Entry entry{};
    Entry* found = nullptr;
    const int error = lookup(name.c_str(), &entry, text.data(), text.size(), &found);
    if (error != ERANGE || text.size() > (std::size_t{1} << 24)) {
      return found != nullptr ? std::optional(entry) : std::nullopt;
    }
    text.resize(2 * text.size());
  }
}

/// Looks a number up by getpwuid_r or getgrgid_r: " (ann)", or "" where it has no name.
template <class Entry, class Lookup>
std::string name_of(unsigned number, char* Entry::*name, Lookup&& lookup) {
  std::vector<char> text(std::size_t{1} << 16);
  Entry entry{};
  Entry* found = nullptr;
  lookup(number, &entry, text.data(), text.size(), &found);
  return found != nullptr ? std::string(" (") + found->*name + ")" : "";
}

/// The word as a shell reads it.
std::string quoted(const std::string& word) {
  constexpr const char* kPlain =
      "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-./+:,@%";
  if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) return word;
  std::string text = "'";
  for (const char c : word) text += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return text + "'";
}

std::string describe(const struct stat& status) {
  return "uid " + std::to_string(status.st_uid) +
         name_of(status.st_uid, &passwd::pw_name, &getpwuid_r) + ", gid " +
         std::to_string(status.st_gid) + name_of(status.st_gid, &group::gr_name, &getgrgid_r) +
         ", mode " + in_octal(status.st_mode);
}

std::string kind_of_mode(mode_t mode) {
  return S_ISREG(mode)    ? ""
         : S_ISLNK(mode)  ? "a symbolic link"
         : S_ISDIR(mode)  ? "a directory"
         : S_ISFIFO(mode) ? "a FIFO"
         : S_ISSOCK(mode) ? "a socket"
                          : "a device";
}

bool is_one_of(const Trust& trust, const struct stat& status) {
  return status.st_uid == geteuid() || status.st_uid == 0 ||
         (trust.user && status.st_uid == *trust.user) ||
         (trust.group && status.st_gid == *trust.group);
}

/// True for the number that stands for all users, or groups, that are not mapped in a user
/// namespace. Everywhere else its name is "nobody", or "nogroup".
bool is_overflow(unsigned number, const char* kind) {
  unsigned overflow = 65534;
  std::ifstream(std::string("/proc/sys/kernel/overflow") + kind) >> overflow;
  return number == overflow;
}

/// The variables with which a process trusts such a file: "LOT_GROUP=1002". "" where no process
/// needs one, or where no variable names the file's users alone.
std::string variables_for(const struct stat& status) {
  const mode_t rights = status.st_mode & 0666;
  if (gives_half(rights)) return "";
  if (rights == (kOwn | kOfGroup) && !is_overflow(status.st_gid, "gid")) {
    return "LOT_GROUP=" + std::to_string(status.st_gid);
  }
  const bool is_known = status.st_uid == geteuid() || status.st_uid == 0;
  if (!is_known && is_overflow(status.st_uid, "uid")) return "";
  const std::string user = is_known ? "" : "LOT_USER=" + std::to_string(status.st_uid);
  const std::string mode = rights == kOwn ? "" : "LOT_PERMISSIONS=" + in_octal(rights);
  return user + (user.empty() || mode.empty() ? "" : " ") + mode;
}

/// What a user can do about a file that was refused. To let in every user of the machine comes
/// last.
std::string advice(const struct stat& status, const std::string& otherwise) {
  const std::string variables = variables_for(status);
  if (variables.empty()) return otherwise;
  if ((status.st_mode & 0006) != 0) {
    return otherwise + "; only if you trust every user of this machine, set " + variables;
  }
  return "if you trust its users, set " + variables + "; else " + otherwise;
}

uid_t user_of(const std::string& text) {
  if (const auto number = number_of(text)) return *number;
  if (const auto entry = look_up<passwd>(text, &getpwnam_r)) return entry->pw_uid;
  throw Error(EINVAL, "user (LOT_USER) " + text, "there is no such user",
              "name one, or write its number");
}

gid_t group_of(const std::string& text) {
  if (const auto number = number_of(text)) return *number;
  if (const auto entry = look_up<group>(text, &getgrnam_r)) return entry->gr_gid;
  throw Error(EINVAL, "group (LOT_GROUP) " + text, "there is no such group",
              "name one, or write its number");
}

}  // namespace

Trust Trust::of(const EngineOptions& options) {
  Trust trust;
  if (!options.user.empty()) trust.user = user_of(options.user);
  if (!options.group.empty()) trust.group = group_of(options.group);
  trust.mode = options.permissions != 0 ? options.permissions
               : trust.group            ? kOwn | kOfGroup
                                        : kOwn;
  if ((trust.mode & ~mode_t{0666}) != 0 || (trust.mode & kOwn) != kOwn) {
    throw Error(EINVAL, "permissions (LOT_PERMISSIONS) " + in_octal(trust.mode),
                "not usable permissions",
                "use 0600 (you), 0660 (and your group), 0606 (and all others), 0666 (all users)");
  }
  if (trust.group && (trust.mode & kOfGroup) != kOfGroup) {
    throw Error(EINVAL, "group (LOT_GROUP) " + options.group,
                "with the permissions " + in_octal(trust.mode) + " its members cannot join",
                "leave LOT_PERMISSIONS away, or write 0660");
  }
  if (gives_half(trust.mode)) {
    throw Error(EINVAL, "permissions (LOT_PERMISSIONS) " + in_octal(trust.mode),
                "nobody could join by one right alone: joining reads and writes",
                "use 0600 (you), 0660 (and your group), 0606 (and all others), 0666 (all users)");
  }
  return trust;
}

void Trust::require(int fd, const std::string& path) const {
  struct stat status {};
  if (fstat(fd, &status) == -1) {
    throw Error(errno, path, "its descriptor was closed meanwhile",
                "try again; in a process with other threads do not close descriptors of others");
  }
  if (!S_ISREG(status.st_mode)) {
    throw Error(EINVAL, path, "it is " + kind_of_mode(status.st_mode) + ", no file of LOT",
                "remove it if it is yours, or set LOT_SEGMENT or LOT_DIR");
  }
  if (!is_one_of(*this, status)) {
    throw Error(EPERM, path,
                "it belongs to " + describe(status) +
                    ": neither to you or root, nor to a user or group that was named",
                advice(status,
                       "have it removed, or made anew with LOT_GROUP=<a common group>, and set the "
                       "same as a member of that group; for a segment of your own set LOT_SEGMENT "
                       "or LOT_DIR"));
  }
  if (status.st_nlink > 1) {
    throw Error(EPERM, path, "it has another name, too: no file that LOT has made has two",
                "remove it, or set LOT_SEGMENT or LOT_DIR");
  }
  const auto anew = [&] {
    return "set LOT_SEGMENT, or end all that use it, and remove what a kill has left by " +
           command("clean", path);
  };
  const mode_t wider = status.st_mode & 07777 & ~mode;
  if ((wider & ~mode_t{0666}) != 0 || (wider != 0 && gives_half(status.st_mode))) {
    throw Error(EPERM, path, "no file of LOT has such a mode: it belongs to " + describe(status),
                "chmod it to 0600, or remove it, or set LOT_SEGMENT");
  }
  if (wider != 0) {
    throw Error(EPERM, path,
                "it gives others more than was asked for: it belongs to " + describe(status) +
                    ", and " + in_octal(mode) + " was asked for",
                advice(status, anew()));
  }
  if (group && (status.st_mode & kOfGroup) != 0 && status.st_gid != *group) {
    throw Error(EPERM, path,
                "it gives rights to another group than gid " + std::to_string(*group) +
                    ": it belongs to " + describe(status),
                advice(status, anew()));
  }
}

std::string Trust::shortfall(int fd) const {
  struct stat status {};
  if (!wants_all || fstat(fd, &status) == -1 || status.st_uid != geteuid() ||
      (mode & ~status.st_mode) == 0) {
    return "";
  }
  return "it lets fewer in than was asked for: it belongs to " + describe(status) + ", and mode " +
         in_octal(mode) + (group ? " of gid " + std::to_string(*group) : "") + " was asked for";
}

bool Trust::owns(const std::string& path) const noexcept {
  struct stat status {};
  return lstat(path.c_str(), &status) == 0 && is_one_of(*this, status);
}

std::string kind_of(const std::string& path) {
  struct stat status {};
  return lstat(path.c_str(), &status) == 0 ? kind_of_mode(status.st_mode) : "";
}

std::string owner_and_mode(const std::string& path) {
  struct stat status {};
  return lstat(path.c_str(), &status) == 0 ? describe(status) : "";
}

std::string way_in(const std::string& path) {
  struct stat status {};
  const std::string own = "; for a segment of your own set LOT_SEGMENT or LOT_DIR";
  if (lstat(path.c_str(), &status) == 0 && (status.st_mode & kOfGroup) == kOfGroup &&
      !is_overflow(status.st_gid, "gid")) {
    return "become a member of its group (a new login knows of that), and set LOT_GROUP=" +
           std::to_string(status.st_gid) + own;
  }
  return "let its owner end all that use it, and make it anew with LOT_GROUP=<a common group>; set "
         "the same, as a member of that group" +
         own;
}

std::string command(const std::string& words, const std::string& path) {
  std::string segment = path;
  for (const std::string_view suffix : {".lock", ".new"}) {
    if (segment.ends_with(suffix)) segment.resize(segment.size() - suffix.size());
  }
  const auto slash = segment.rfind('/');
  const std::string directory = segment.substr(0, slash);
  struct stat status {};
  std::string text;
  const auto is_file = [&](const std::string& its) {
    return lstat(its.c_str(), &status) == 0 && S_ISREG(status.st_mode);
  };
  if (is_file(segment) || is_file(path)) text = variables_for(status);
  if (!text.empty()) {
    // The user's shell may export other values for these variables: they are cleared.
    for (const char* const name : {"LOT_USER", "LOT_GROUP", "LOT_PERMISSIONS"}) {
      const char* const exported = secure_getenv(name);
      const bool is_said = text.find(name + std::string("=")) != text.npos;
      if (exported != nullptr && *exported != '\0' && !is_said)
        text += std::string(" ") + name + "=";
    }
  }
  text += (text.empty() ? "lot " : " lot ") + words;
  const char* const elsewhere = secure_getenv("LOT_DIR");
  if (directory != EngineOptions().directory || (elsewhere != nullptr && *elsewhere != '\0')) {
    text += " --dir " + quoted(directory);
  }
  return "`" + text + " --segment " + quoted(segment.substr(slash + 1)) + "`";
}

bool may_remove(const std::string& path) {
  struct stat file {
  }, directory{};
  if (lstat(path.c_str(), &file) != 0 ||
      stat(path.substr(0, path.rfind('/') + 1).c_str(), &directory) != 0) {
    return true;
  }
  const uid_t self = geteuid();
  return self == 0 || (directory.st_mode & S_ISVTX) == 0 || file.st_uid == self ||
         directory.st_uid == self;
}

}  // namespace lot::segment
