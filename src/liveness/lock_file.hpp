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

/// Who is alive is said by the kernel: each participant holds a write lock on its byte of the lock
/// file, and the kernel drops it when the process dies. No process ids: they mean nothing in
/// another container.
///
/// The locks belong to the open file description (F_OFD_SETLK). They do not exclude threads that
/// share it, so whoever locks another's byte holds a process-private mutex as well. The descriptor
/// is never mapped: a mapping would keep a dead owner's lock.
///
/// The application may close the descriptor, and use its number for a file of its own, at any time:
/// so each lock and unlock looks first whether it still is the lock file.
///
/// Bytes: 1 .. N-1 are participants, 0 is the orphanage (who acts for it holds it), kGate guards
/// creating, opening and removing the segment; who has it also holds one byte of the turns behind
/// it, any one, by which others see that it has changed hands.
///
/// Source: fcntl(2), "Open file description locks".
namespace lot::liveness {

class LockFile {
 public:
  static constexpr std::uint32_t kGate = 1 << 20;
  static constexpr std::uint32_t kFirstTurn = kGate + 1;
  static constexpr std::uint32_t kTurns = 1 << 16;

  /// Opens the lock file, made if absent. Throws lot::Error, also when it is no lock file (not an
  /// empty regular one), or not trusted: that is left alone.
  explicit LockFile(std::string path, const segment::Trust& trust = {});
  ~LockFile();
  LockFile(const LockFile&) = delete;
  LockFile& operator=(const LockFile&) = delete;

  bool try_lock(std::uint32_t byte) noexcept;
  void unlock(std::uint32_t byte, std::uint32_t count = 1) noexcept;
  /// True when somebody else holds a byte of [first, first + count).
  bool held_by_other(std::uint32_t first, std::uint32_t count = 1) const noexcept;

  /// Takes the gate; throws lot::Error (EBUSY) when one turn there takes longer than `timeout`:
  /// where hundreds start at once, each waits for the others' turns. It names the process that has
  /// the gate, where /proc shows it, and does so within a second when that one is stopped. Returns
  /// false when the file was removed meanwhile: open it again.
  ///
  /// Only time in which we look counts: where the machine is so busy that we come to look seldom,
  /// who has the gate comes to its work as seldom.
  bool enter_gate(std::chrono::milliseconds timeout);
  /// Another turn, said between two steps in the gate: who waits sees that we are at work, and not
  /// stopped, and has its patience anew. REQUIRES: the gate.
  void take_turn() noexcept;
  void leave_gate() noexcept;

  /// The process that holds a byte, for people to read; see LockHolder.
  std::optional<LockHolder> holder(std::uint32_t byte) const {
    return LockHolder::find(path_, inode_, byte);
  }

  /// False when the descriptor was closed behind our back (closefrom) and our locks are gone.
  bool intact() const noexcept;
  /// Throws lot::Error (EBADF) when it is not intact(): with our locks the gate is gone, too, and
  /// held_by_other() knows nothing.
  void require_intact() const;
  /// Throws lot::Error when it is not trusted by such a one.
  void require(const segment::Trust& trust) const;
  /// Why it is narrow for such a one, or "".
  std::string shortfall(const segment::Trust& trust) const;
  /// Opens the file again after that. False when it is another file by now.
  bool reopen() noexcept;

  /// In a forked child: closes the descriptor, so that the child does not keep the parent's locks.
  void abandon() noexcept;

  const std::string& path() const noexcept { return path_; }

 private:
  /// The turn of who has the gate; kGate when it has not taken one yet.
  std::uint32_t turn() const noexcept;
  void refuse_if_stopped(bool in_any_case) const;

  std::string path_;
  std::atomic<int> fd_;
  std::uint32_t turn_ = 0;  ///< ours, while we have the gate; 0: none
  dev_t device_ = 0;
  ino_t inode_ = 0;
};

/// Asks the locks of a lock file, and takes none: for who looks from outside.
class LockProbe {
 public:
  /// A file that is not there, or is no lock file, holds no locks.
  explicit LockProbe(const std::string& path) noexcept;
  ~LockProbe();
  LockProbe(const LockProbe&) = delete;
  LockProbe& operator=(const LockProbe&) = delete;

  bool is_lock_file() const noexcept { return fd_ != -1; }
  /// Throws lot::Error when it is there and not trusted.
  void require(const segment::Trust& trust, const std::string& path) const;
  /// True when somebody holds a byte of [first, first + count).
  bool is_held(std::uint32_t first, std::uint32_t count = 1) const noexcept;
  /// The process that holds a byte, for people to read; see LockHolder.
  std::optional<LockHolder> holder(std::uint32_t byte) const;

 private:
  std::string path_;
  int fd_;
};

}  // namespace lot::liveness
