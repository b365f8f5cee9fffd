// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <sys/stat.h>

#include "liveness/lock_holder.hpp"
#include "segment/trust.hpp"

/// The kernel says which participants live. Each participant holds a write lock on its byte of the
/// lock file, and the kernel drops that lock when the process dies. LOT asks no process ids: they
/// mean nothing in another container.
///
/// The locks belong to the open file description (F_OFD_SETLK). They do not exclude threads that
/// share it. So a thread that locks another participant's byte holds a process-private mutex as
/// well. The descriptor is never mapped: a mapping would keep a dead owner's lock.
///
/// The application may close the descriptor at any time, and use its number for a file of its own.
/// So each lock and unlock first looks whether the descriptor still is the lock file.
///
/// Bytes: 1 .. N-1 are participants. Byte 0 is the orphanage: the process that acts for it holds
/// it. kGate guards creating, opening and removing the segment. The process that has the gate also
/// holds one byte of the turns behind it, any one. By that byte others see that the gate has
/// changed hands.
///
/// Source: fcntl(2), "Open file description locks".
namespace lot::liveness {

class LockFile {
 public:
  static constexpr std::uint32_t kGate = 1 << 20;
  static constexpr std::uint32_t kFirstTurn = kGate + 1;
  static constexpr std::uint32_t kTurns = 1 << 16;

  /// Opens the lock file, and makes it if it is absent. Throws lot::Error, also when the file is no
  /// lock file (not an empty regular file) or is not trusted. Such a file is left alone.
  explicit LockFile(std::string path, const segment::Trust& trust = {});
  ~LockFile();
  LockFile(const LockFile&) = delete;
  LockFile& operator=(const LockFile&) = delete;

  bool try_lock(std::uint32_t byte) noexcept;
  void unlock(std::uint32_t byte, std::uint32_t count = 1) noexcept;
  /// True when another open file description holds a byte of [first, first + count). True as well
  /// when the question fails.
  bool held_by_other(std::uint32_t first, std::uint32_t count = 1) const noexcept;

  /// Takes the gate. Throws lot::Error (EBUSY) when one turn there takes longer than `timeout`. The
  /// limit is on one turn: where hundreds of processes start at once, each waits for the turns of
  /// the others. The error names the process that has the gate, where /proc shows it, and comes
  /// within a second when that process is stopped. Returns false when the file was removed
  /// meanwhile: the caller opens it again.
  ///
  /// Only time in which this process runs and looks counts. Where the machine is so busy that this
  /// process looks seldom, the process in the gate works as seldom.
  bool enter_gate(std::chrono::milliseconds timeout);
  /// Begins another turn between two steps in the gate. A process that waits sees that we work and
  /// are not stopped, and begins its patience anew. REQUIRES: the gate.
  void take_turn() noexcept;
  void leave_gate() noexcept;

  /// The process that holds a byte, for people to read; see LockHolder.
  std::optional<LockHolder> holder(std::uint32_t byte) const {
    return LockHolder::find(path_, inode_, byte);
  }

  /// False when the application has closed the descriptor (closefrom) and our locks are gone.
  bool intact() const noexcept;
  /// Throws lot::Error (EBADF) when it is not intact(). Then the gate is gone with our other locks,
  /// and held_by_other() knows nothing.
  void require_intact() const;
  /// Throws lot::Error when `trust` does not trust the file.
  void require(const segment::Trust& trust) const;
  /// Why the file is narrow for `trust`, or "".
  std::string shortfall(const segment::Trust& trust) const;
  /// Opens the file again when it was not intact(). False when the path has another file by now.
  bool reopen() noexcept;

  /// For a forked child: closes the descriptor, so that the child does not keep the parent's locks.
  void abandon() noexcept;

  const std::string& path() const noexcept { return path_; }

 private:
  /// The turn of the process that has the gate; kGate when it has not taken one yet.
  std::uint32_t turn() const noexcept;
  void refuse_if_stopped(bool in_any_case) const;

  std::string path_;
  std::atomic<int> fd_;
  std::uint32_t turn_ = 0;  ///< our turn while we have the gate; 0: none
  dev_t device_ = 0;
  ino_t inode_ = 0;
};

/// Asks for the locks of a lock file and takes none: for a process that looks from outside.
class LockProbe {
 public:
  /// A file that is not there, or is no lock file, holds no locks.
  explicit LockProbe(const std::string& path) noexcept;
  ~LockProbe();
  LockProbe(const LockProbe&) = delete;
  LockProbe& operator=(const LockProbe&) = delete;

  bool is_lock_file() const noexcept { return fd_ != -1; }
  /// Throws lot::Error when the file is there and not trusted.
  void require(const segment::Trust& trust, const std::string& path) const;
  /// True when a process holds a byte of [first, first + count).
  bool is_held(std::uint32_t first, std::uint32_t count = 1) const noexcept;
  /// The process that holds a byte, for people to read; see LockHolder.
  std::optional<LockHolder> holder(std::uint32_t byte) const;

 private:
  std::string path_;
  int fd_;
};

}  // namespace lot::liveness
