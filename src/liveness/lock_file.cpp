// SPDX-License-Identifier: Apache-2.0
#include "liveness/lock_file.hpp"

#include <algorithm>
#include <cerrno>
#include <fcntl.h>
#include <thread>
#include <unistd.h>
#include <utility>

#include "lot/error.hpp"

#include "robust_mutex/robust_mutex.hpp"
#include "segment/descriptors.hpp"
#include "segment/segment.hpp"

namespace lot::liveness {
namespace {

/// Hundreds of processes that wait at the gate must not keep the one in it from the processor.
constexpr std::chrono::milliseconds kLongestPause{16};
/// A pause counts as waiting for at most this many times its planned length.
constexpr int kMostOversleep = 2;
/// A process that is stopped in the gate keeps others out for this long. Then they look at all
/// processes in /proc.
constexpr auto kStoppedPatience = LockOwner::kStoppedPatience;

struct flock byte_range(short type, std::uint32_t first, std::uint32_t count) {
  struct flock range {};
  range.l_type = type;
  range.l_whence = SEEK_SET;
  range.l_start = first;
  range.l_len = count;
  return range;
}

/// True when another open file description holds a byte of the range. True on failure, too: no
/// process must be reaped because a system call failed.
bool held_by_another(int fd, struct flock range) {
  if (fcntl(fd, F_OFD_GETLK, &range) == -1) return true;
  return range.l_type != F_UNLCK;
}

}  // namespace

LockFile::LockFile(std::string path, const segment::Trust& trust)
    : path_(std::move(path)), fd_(segment::open_private(path_, trust)) {
  struct stat status {};
  fstat(fd_, &status);
  if (!S_ISREG(status.st_mode) || status.st_size != 0) {
    ::close(fd_);
    throw Error(EINVAL, path_,
                "it is a file of " + std::to_string(status.st_size) + " bytes, no lock file",
                "remove it if it is yours, or set LOT_SEGMENT");
  }
  device_ = status.st_dev;
  inode_ = status.st_ino;
}

LockFile::~LockFile() { abandon(); }

bool LockFile::try_lock(std::uint32_t byte) noexcept {
  if (!intact()) {  // the descriptor may be a file of the application by now
    errno = EBADF;
    return false;
  }
  struct flock range = byte_range(F_WRLCK, byte, 1);
  int result;
  do {
    result = fcntl(fd_, F_OFD_SETLK, &range);
  } while (result == -1 && errno == EINTR);
  return result == 0;
}

void LockFile::unlock(std::uint32_t byte, std::uint32_t count) noexcept {
  if (!intact()) return;
  struct flock range = byte_range(F_UNLCK, byte, count);
  fcntl(fd_, F_OFD_SETLK, &range);
}

bool LockFile::held_by_other(std::uint32_t first, std::uint32_t count) const noexcept {
  return !intact() || held_by_another(fd_, byte_range(F_WRLCK, first, count));
}

bool LockFile::enter_gate(std::chrono::milliseconds timeout) {
  using Clock = std::chrono::steady_clock;
  Clock::duration waited{};  // while the same turn has lasted
  Clock::duration next_look = kStoppedPatience;
  std::uint32_t turn = 0;
  auto pause = std::chrono::milliseconds(1);
  while (!try_lock(kGate)) {
    require_intact();
    if (errno != EAGAIN && errno != EACCES) {
      throw Error(errno, path_, "cannot lock it", "does its file system support fcntl locks?");
    }
    if (const std::uint32_t now = this->turn(); now != turn) {
      turn = now;
      waited = {};
      next_look = kStoppedPatience;
    }
    if (waited >= next_look || waited >= timeout) {
      refuse_if_stopped(waited >= timeout);
      next_look += kStoppedPatience;
    }
    const auto before = Clock::now();
    std::this_thread::sleep_for(pause);
    waited += std::min<Clock::duration>(Clock::now() - before, kMostOversleep * pause);
    pause = std::min(2 * pause, kLongestPause);
  }
  take_turn();
  struct stat named {};
  if (stat(path_.c_str(), &named) == 0 && named.st_dev == device_ && named.st_ino == inode_) {
    return true;
  }
  leave_gate();
  return false;
}

/// Throws if the process that has the gate is stopped, or `in_any_case`. That process may also be
/// at work: a large segment takes time.
void LockFile::refuse_if_stopped(bool in_any_case) const {
  const auto holder = this->holder(kGate);
  if (holder && holder->is_stopped) {
    throw Error(EBUSY, path_,
                holder->describe() + " is stopped while it opens or closes the segment",
                holder->advice());
  }
  if (!in_any_case) return;
  throw Error(
      EBUSY, path_,
      (holder ? holder->describe() : "another process") +
          " has been opening or closing the segment all the time",
      holder ? "look what it does, or kill it"
             : "look for a stopped process that uses it, of another user or in another container "
               "(state T in ps), and continue or kill it");
}

void LockFile::take_turn() noexcept {
  const auto now = std::chrono::steady_clock::now().time_since_epoch().count();
  const std::uint32_t before =
      std::exchange(turn_, kFirstTurn + static_cast<std::uint32_t>(now) % kTurns);
  if (before == turn_) return;  // happens once in 65536 times
  if (before != 0) unlock(before);
  try_lock(turn_);
}

void LockFile::leave_gate() noexcept {
  turn_ = 0;
  unlock(kGate, 1 + kTurns);
}

std::uint32_t LockFile::turn() const noexcept {
  struct flock held = byte_range(F_WRLCK, kFirstTurn, kTurns);
  const bool is_held = fcntl(fd_, F_OFD_GETLK, &held) == 0 && held.l_type != F_UNLCK;
  return is_held ? static_cast<std::uint32_t>(held.l_start) : kGate;
}

bool LockFile::intact() const noexcept {
  struct stat status {};
  return fstat(fd_, &status) == 0 && status.st_dev == device_ && status.st_ino == inode_;
}

void LockFile::require_intact() const {
  if (intact()) return;
  throw Error(EBADF, path_, "its descriptor was closed meanwhile",
              "try again; in a process with other threads do not close descriptors of others");
}

void LockFile::require(const segment::Trust& trust) const {
  if (intact()) trust.require(fd_, path_);
}

std::string LockFile::shortfall(const segment::Trust& trust) const {
  return intact() ? trust.shortfall(fd_) : "";
}

bool LockFile::reopen() noexcept {
  const int fd = segment::open_file(path_, O_RDWR | O_NOFOLLOW | O_NONBLOCK);
  if (fd == -1) return false;
  struct stat status {};
  if (fstat(fd, &status) == -1 || status.st_dev != device_ || status.st_ino != inode_) {
    ::close(fd);
    return false;
  }
  fd_ = fd;
  return true;
}

void LockFile::abandon() noexcept {
  if (intact()) ::close(fd_);
  fd_ = -1;
}

LockProbe::LockProbe(const std::string& path) noexcept
    : path_(path), fd_(segment::open_file(path, O_RDONLY | O_NOFOLLOW | O_NONBLOCK)) {
  struct stat status {};
  if (fd_ == -1 || (fstat(fd_, &status) == 0 && S_ISREG(status.st_mode) && status.st_size == 0)) {
    return;
  }
  ::close(fd_);
  fd_ = -1;
}

LockProbe::~LockProbe() {
  if (fd_ != -1) ::close(fd_);
}

void LockProbe::require(const segment::Trust& trust, const std::string& path) const {
  if (fd_ != -1) trust.require(fd_, path);
}

bool LockProbe::is_held(std::uint32_t first, std::uint32_t count) const noexcept {
  return fd_ != -1 && held_by_another(fd_, byte_range(F_WRLCK, first, count));
}

std::optional<LockHolder> LockProbe::holder(std::uint32_t byte) const {
  struct stat status {};
  if (!is_held(byte) || fstat(fd_, &status) == -1) return {};
  return LockHolder::find(path_, status.st_ino, byte);
}

}  // namespace lot::liveness
