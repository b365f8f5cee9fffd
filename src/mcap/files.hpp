// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <sys/types.h>
#include <sys/uio.h>
#include <utility>
#include <vector>

#include "mcap/bytes.hpp"

namespace lot::mcap {

/// A descriptor that is closed with it.
class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor();
  int get() const { return fd_; }

 private:
  int fd_ = -1;
};

/// A file that grows at its end, a whole write at a time.
///
/// Threads: one at a time.
/// Errors:  lot::Error with the system's errno.
/// Crash:   a write may be there in part.
class OutFile {
 public:
  /// Makes it. EEXIST: it is there already.
  static OutFile make(const std::string& path);
  /// Opens one that is there. EWOULDBLOCK: another process writes it.
  static OutFile open(const std::string& path);

  /// Appends the pieces as a whole, or throws, and the file is as it was.
  void append(std::span<const iovec> pieces);
  /// Gives it this mode, but for what the umask takes away; of what make() has made it is 0600.
  void permit(mode_t mode) noexcept;
  /// Cuts it off, and goes on there.
  void cut(std::uint64_t bytes);

  std::uint64_t size() const { return size_; }
  const std::string& path() const { return path_; }

 private:
  OutFile(std::string path, int flags);
  /// REQUIRES: not all is written.
  void write_rest(std::span<iovec> pieces);

  std::string path_;
  Descriptor fd_;
  std::uint64_t size_ = 0;
  std::vector<iovec> left_;  ///< of a write: what has not been written
};

/// A file that is read at any place. Its size is that of the moment when it was opened.
///
/// Threads: one at a time.
/// Errors:  lot::Error with the system's errno; EIO: another process has cut it off.
class InFile {
 public:
  explicit InFile(const std::string& path);

  /// Fills `to` from there. Throws Malformed when that leads out of the file.
  void read(std::uint64_t at, std::span<std::byte> to) const;
  /// At least `wanted` bytes from there, or what there is until the end of the file; valid until
  /// the next call. Reads ahead, for small records. REQUIRES: wanted <= kAhead.
  View peek(std::uint64_t at, std::size_t wanted);
  static constexpr std::size_t kAhead = 64 << 10;

  std::uint64_t size() const { return size_; }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
  Descriptor fd_;
  std::uint64_t size_ = 0;
  Bytes ahead_;
  std::uint64_t ahead_at_ = 0;
};

}  // namespace lot::mcap
