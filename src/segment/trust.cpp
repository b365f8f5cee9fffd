// SPDX-License-Identifier: Apache-2.0
#include "segment/trust.hpp"

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <grp.h>
#include <pwd.h>
#include <sys/stat.h>
#include <unistd.h>
#include <vector>

#include "lot/error.hpp"

namespace lot::segment {
namespace {

constexpr mode_t kOwn = 0600;
constexpr mode_t kOfGroup = 0060;

std::string in_octal(mode_t mode) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "0%o", mode & 07777U);
  return text.data();
}

std::string describe(const struct stat& status) {
  return "uid " + std::to_string(status.st_uid) + ", gid " + std::to_string(status.st_gid) +
         ", mode " + in_octal(status.st_mode);
}

/// A number; nothing: it is a name.
std::optional<unsigned> number_of(const std::string& text) {
  if (text.empty() || text.find_first_not_of("0123456789") != std::string::npos) return {};
  errno = 0;
  const unsigned long number = std::strtoul(text.c_str(), nullptr, 10);
  // The last one means "none" in many calls.
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

uid_t user_of(const std::string& text) {
  if (const auto number = number_of(text)) return *number;
  if (const auto entry = look_up<passwd>(text, &getpwnam_r)) return entry->pw_uid;
  throw Error(EINVAL, "LOT_USER=" + text, "there is no such user", "name one, or write its number");
}

gid_t group_of(const std::string& text) {
  if (const auto number = number_of(text)) return *number;
  if (const auto entry = look_up<group>(text, &getgrnam_r)) return entry->gr_gid;
  throw Error(EINVAL, "LOT_GROUP=" + text, "there is no such group",
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
  if (trust.group && (trust.mode & kOfGroup) == 0) {
    throw Error(EINVAL, "LOT_GROUP=" + options.group,
                "the permissions " + in_octal(trust.mode) + " give a group nothing",
                "leave LOT_PERMISSIONS away, or write 0660");
  }
  return trust;
}

Trust Trust::of_a_lock_file() const {
  Trust its = *this;
  const mode_t both = mode & (mode >> 1) & 0222;  // write bits, where there is a read bit too
  its.mode = both | (both << 1);
  return its;
}

void Trust::require(int fd, const std::string& path) const {
  struct stat status {};
  if (fstat(fd, &status) == -1) {
    throw Error(errno, path, "its descriptor was closed meanwhile",
                "try again; in a process with other threads do not close descriptors of others");
  }
  if (!S_ISREG(status.st_mode)) {
    throw Error(EINVAL, path, "it is no regular file",
                "remove it if it is yours, or set LOT_SEGMENT or LOT_DIR");
  }
  const bool is_owner_trusted = status.st_uid == geteuid() || status.st_uid == 0 ||
                                (user && status.st_uid == *user) ||
                                (group && status.st_gid == *group);
  if (!is_owner_trusted) {
    throw Error(
        EPERM, path,
        "it belongs to " + describe(status) +
            ": neither to you or root, nor to whom you have named",
        "if you trust that user or group, name it (LOT_USER=" + std::to_string(status.st_uid) +
            " or LOT_GROUP=" + std::to_string(status.st_gid) +
            "); else set LOT_SEGMENT or LOT_DIR, or have it removed");
  }
  const mode_t wider = status.st_mode & 07777 & ~mode;
  if (wider != 0) {
    throw Error(EPERM, path,
                "it gives others more than was asked for: it belongs to " + describe(status) +
                    ", and " + in_octal(mode) + " was asked for",
                "set LOT_PERMISSIONS=" + in_octal(status.st_mode & 0666) +
                    " if they may read and change what you send; else set LOT_SEGMENT, or have "
                    "it made anew");
  }
}

std::string owner_and_mode(const std::string& path) {
  struct stat status {};
  return lstat(path.c_str(), &status) == 0 ? describe(status) : "";
}

}  // namespace lot::segment
