// SPDX-License-Identifier: Apache-2.0
#include "mcap/files.hpp"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <string_view>
#include <sys/file.h>
#include <sys/stat.h>
#include <system_error>
#include <unistd.h>

#include "lot/error.hpp"

#include "segment/descriptors.hpp"

namespace lot::mcap {
namespace {

bool is_directory(const std::string& path) {
  std::error_code ignored;
  return std::filesystem::is_directory(path, ignored);
}

/// A symbolic link to what is not there.
bool leads_nowhere(const std::string& path) {
  std::error_code ignored;
  return std::filesystem::is_symlink(path, ignored) && !std::filesystem::exists(path, ignored);
}

std::string directory_of(const std::string& path) {
  const std::string parent = std::filesystem::path(path).parent_path();
  std::error_code ignored;
  return parent.empty() ? std::filesystem::current_path(ignored).string() : parent;
}

std::string advice_for(int error, const std::string& path) {
  switch (error) {
    case EEXIST:
    case EISDIR:
      return is_directory(path)    ? "it is a directory: name a file in it"
             : leads_nowhere(path) ? "it is a symbolic link that leads nowhere, and a recording "
                                     "makes its file itself: choose another name, or remove it"
                                   : "a recording is never overwritten: choose another name, or "
                                     "remove it";
    case ENOSPC:
    case EDQUOT:
      return "make room, or record to another disk";
    case EACCES:
    case EROFS:
      return "you may not make files in " + directory_of(path) +
             ": name a file in another directory";
    case ENOENT:
      return is_directory(directory_of(path))
                 ? "its directory takes no new files: record to another one"
                 : "make its directory first";
    default:
      return "";
  }
}

/// Of a file that is there.
std::string advice_to_open(int error) {
  const bool may_read = error == EACCES || error == EROFS || error == EPERM;
  return may_read ? "it can be read and played as it is; a copy of it can be recovered" : "";
}

[[noreturn]] void fail(const std::string& path, const std::string& what, int error = errno) {
  throw Error(error, path, what, advice_for(error, path));
}

/// The process's umask. umask(2) tells it only by changing it, for all threads.
mode_t umask_of_process() {
  constexpr std::string_view kName = "Umask:";
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (!line.starts_with(kName)) continue;
    return static_cast<mode_t>(std::strtoul(line.c_str() + kName.size(), nullptr, 8));
  }
  return 077;  // there is no /proc
}

struct stat status_of(int fd, const std::string& path) {
  struct stat status {};
  if (fstat(fd, &status) != 0) fail(path, "cannot look at the file");
  return status;
}

}  // namespace

Descriptor::~Descriptor() {
  if (fd_ != -1) ::close(fd_);
}

OutFile::OutFile(std::string path, int flags)
    : path_(std::move(path)), fd_(segment::open_file(path_, flags, 0600)) {
  if (fd_.get() == -1) {
    const bool makes_it = (flags & O_CREAT) != 0;
    throw Error(errno, path_, "cannot open the file to write it",
                makes_it ? advice_for(errno, path_) : advice_to_open(errno));
  }
  const struct stat status = status_of(fd_.get(), path_);
  if (!S_ISREG(status.st_mode)) {
    throw Error(EINVAL, path_, "not an ordinary file", "a recording is written at any place of it");
  }
  if (flock(fd_.get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) fail(path_, "cannot lock the file");
    throw Error(EWOULDBLOCK, path_, "another process writes it", "wait until that one has ended");
  }
  size_ = static_cast<std::uint64_t>(status.st_size);
}

OutFile OutFile::make(const std::string& path) { return {path, O_WRONLY | O_CREAT | O_EXCL}; }

OutFile OutFile::open(const std::string& path) { return {path, O_WRONLY}; }

void OutFile::append(std::span<const iovec> pieces) {
  if (status_of(fd_.get(), path_).st_nlink == 0) {
    throw Error(ENOENT, path_, "the file was removed while it was written", "");
  }
  left_.clear();
  for (const iovec& piece : pieces) {
    if (piece.iov_len != 0) left_.push_back(piece);
  }
  const std::uint64_t before = size_;
  try {
    write_rest(left_);
  } catch (const Error&) {
    size_ = before;
    // Where even this fails, the next write begins in the right place all the same.
    (void)!ftruncate(fd_.get(), static_cast<off_t>(before));
    throw;
  }
}

void OutFile::write_rest(std::span<iovec> pieces) {
  while (!pieces.empty()) {
    const auto most = static_cast<int>(std::min<std::size_t>(pieces.size(), IOV_MAX));
    const ssize_t n = pwritev(fd_.get(), pieces.data(), most, static_cast<off_t>(size_));
    if (n == -1 && errno == EINTR) continue;
    if (n == -1) fail(path_, "cannot write");
    if (n == 0) fail(path_, "cannot write", EIO);
    size_ += static_cast<std::uint64_t>(n);
    for (auto written = static_cast<std::size_t>(n); written != 0;) {
      iovec& piece = pieces.front();
      const std::size_t part = std::min(written, piece.iov_len);
      piece.iov_base = static_cast<char*>(piece.iov_base) + part;
      piece.iov_len -= part;
      written -= part;
      if (piece.iov_len == 0) pieces = pieces.subspan(1);
    }
  }
}

void OutFile::permit(mode_t mode) noexcept {
  const mode_t usual = mode & 0666 & ~umask_of_process();
  // A file system without modes has that of its mount.
  (void)!fchmod(fd_.get(), 0600 | usual);
}

void OutFile::cut(std::uint64_t bytes) {
  while (ftruncate(fd_.get(), static_cast<off_t>(bytes)) != 0) {
    if (errno != EINTR) fail(path_, "cannot cut off the file");
  }
  size_ = bytes;
}

InFile::InFile(const std::string& path)
    : path_(path), fd_(segment::open_file(path, O_RDONLY | O_NONBLOCK)) {
  if (fd_.get() == -1) throw Error(errno, path_, "cannot open the file", "");
  const struct stat status = status_of(fd_.get(), path_);
  if (!S_ISREG(status.st_mode)) {
    throw Error(EINVAL, path_, "not an ordinary file", "a recording is read at any place of it");
  }
  size_ = static_cast<std::uint64_t>(status.st_size);
}

void InFile::read(std::uint64_t at, std::span<std::byte> to) const {
  if (at > size_ || to.size() > size_ - at) throw Malformed("it leads out of the file");
  while (!to.empty()) {
    const ssize_t n = pread(fd_.get(), to.data(), to.size(), static_cast<off_t>(at));
    if (n == -1 && errno == EINTR) continue;
    if (n == -1) throw Error(errno, path_, "cannot read", "");
    if (n == 0) throw Error(EIO, path_, "the file became shorter while it was read", "");
    to = to.subspan(static_cast<std::size_t>(n));
    at += static_cast<std::uint64_t>(n);
  }
}

View InFile::peek(std::uint64_t at, std::size_t wanted) {
  if (at >= size_) return {};
  const auto there = static_cast<std::size_t>(std::min<std::uint64_t>(wanted, size_ - at));
  if (at < ahead_at_ || at - ahead_at_ > ahead_.size() ||
      ahead_.size() - (at - ahead_at_) < there) {
    Bytes fresh(static_cast<std::size_t>(std::min<std::uint64_t>(kAhead, size_ - at)));
    read(at, fresh);
    ahead_ = std::move(fresh);
    ahead_at_ = at;
  }
  return View(ahead_).subspan(at - ahead_at_);
}

}  // namespace lot::mcap
