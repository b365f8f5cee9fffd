// SPDX-License-Identifier: Apache-2.0
#include "transport/gate.hpp"

#include <atomic>
#include <cerrno>
#include <new>
#include <unistd.h>

#include "lot/error.hpp"

#include "liveness/death_notice.hpp"
#include "segment/segment.hpp"
#include "segment/system_limits.hpp"

namespace lot::transport {

void refuse_without_memory(const std::string& path) {
  throw Error(ENOMEM, path, "no memory for what a process needs to join",
              segment::advice_on_address_space());
}

void refuse_narrow(const std::string& path, const std::string& reason) {
  throw Error(EPERM, path, reason + "; and it is in use",
              "end all that use it (" + segment::command("ls", path) +
                  " names them) and start again, then it is made anew; or ask for no more than "
                  "those do (LOT_GROUP, LOT_PERMISSIONS), or set LOT_SEGMENT");
}

void refuse_stale(const std::string& path, const std::string& reason) {
  throw Error(EBUSY, path, reason + ", and it is in use",
              "leave LOT_SIZE as those have it who use it, stop them, or set LOT_SEGMENT");
}

namespace {

/// The contents of a segment that would be removed and made anew.
struct Contents {
  std::uint64_t items = 0;  ///< items that wait in queues and are to stay
  bool is_narrow = false;   ///< it lets fewer users in than was asked for
  /// A notice stands: that process may have lost its byte to closefrom().
  bool is_lived_in = false;
};

/// `has_size`: the segment has the size that was asked for. It would be joined if it let all users
/// in.
///
/// REQUIRES: the gate is held.
Contents look_into(const std::string& path, const segment::Trust& trust, bool has_size) {
  using segment::Segment;
  Contents contents;
  std::string ignored;
  const auto fit = Segment::examine(path, 0, trust, ignored);
  contents.is_narrow = fit == Segment::Fit::Narrow;
  if (fit != Segment::Fit::Fits && !contents.is_narrow) return contents;
  try {
    const Segment segment(path, Segment::Access::ReadOnly, trust);
    for (std::uint32_t k = 1; k < segment.capacity().participants; ++k) {
      contents.is_lived_in |=
          // Acquire: edges "state" and "seat".
          segment.participants()[k].state.load(std::memory_order_acquire) != 0 &&
          liveness::seat::stands(segment.witnesses()[k].seat.load(std::memory_order_acquire));
    }
    if (!has_size && !segment.keeps_files()) return contents;
    for (std::uint32_t c = 0; c < segment.capacity().channels; ++c) {
      contents.items += segment.waiting_items(c);
    }
  } catch (const std::bad_alloc&) {
    refuse_without_memory(path);
  } catch (const Error& e) {
    if (!segment::means_damage(e)) throw;
    return {};  // it is damaged: no process can take what is in there
  }
  return contents;
}

using Fit = segment::Segment::Fit;

/// What a process finds at the path where it wants to join, seen with the gate held.
struct Found {
  Fit fit = Fit::Absent;
  std::string reason;       ///< why it does not fit
  std::string lock_reason;  ///< why its lock file lets fewer users in than was asked for
  bool used = false;  ///< by other processes; looked for only where the segment or the lock file
                      ///< would be removed
  Contents contents;  ///< looked at in that case only
};

/// Throws if what was found can neither be joined nor made anew.
void require_free(const std::string& path, const Found& found, IfAbsent if_absent) {
  const bool is_narrow = found.fit == Fit::Narrow;
  if (found.fit == Fit::Stale && found.used) refuse_stale(path, found.reason);
  if (found.used && is_narrow) refuse_narrow(path, found.reason);
  if (found.used && !found.lock_reason.empty()) refuse_narrow(path + ".lock", found.lock_reason);
  if (found.fit == Fit::Fits) return;
  if (if_absent == IfAbsent::Throw) {
    throw Error(ENOENT, path, "nobody uses it any more", "there is nothing to be done");
  }
  const std::uint64_t items = found.contents.items;
  if (items == 0) return;
  const std::string size = is_narrow ? "" : "LOT_SIZE";
  const std::string rights = found.contents.is_narrow ? "LOT_GROUP and LOT_PERMISSIONS" : "";
  throw Error(
      ENOTEMPTY, path,
      found.reason + ", and " + std::to_string(items) +
          (items == 1 ? " item waits in it that is to stay" : " items wait in it that are to stay"),
      "take them without " + size + (size.empty() || rights.empty() ? "" : ", ") + rights +
          ", or drop them by " + segment::command("clean --with-items", path));
}

/// Removes the lock file. The next process makes a new one.
void remove_lock_file(const std::string& path, const std::string& reason,
                      const std::string& advice) {
  if (::unlink((path + ".lock").c_str()) == -1 && errno != ENOENT) {
    throw Error(errno, path + ".lock", reason, advice);
  }
}

/// The lock file is made anew at most this often. Each time a process that asks for less may have
/// made the new one.
constexpr int kMostRenewals = 8;

/// Removes a lock file whose mode is too narrow. A file that exists keeps its mode; a new one gets
/// the mode that was asked for.
void renew_lock_file(const std::string& path, const std::string& lock_reason, int renewed) {
  if (renewed > kMostRenewals) {
    throw Error(EPERM, path + ".lock", lock_reason + "; and new ones are so, too",
                "name a directory with LOT_DIR whose file system has such modes");
  }
  remove_lock_file(path, lock_reason + "; and it cannot be removed",
                   "remove it as the owner of its directory, or set LOT_SEGMENT or LOT_DIR");
}

segment::Capacity capacity_of(const EngineOptions& options) {
  return {options.size_bytes, options.processes + 1, options.blocks,
          options.topics,     options.channels,      options.readers};
}

/// Leaves the gate at its end. The segment is opened, made and removed only inside the gate.
class GateGuard {
 public:
  explicit GateGuard(liveness::LockFile& file) : file_(&file) {}
  ~GateGuard() { file_->leave_gate(); }
  GateGuard(const GateGuard&) = delete;
  GateGuard& operator=(const GateGuard&) = delete;

 private:
  liveness::LockFile* file_;
};

}  // namespace

void pass_gate(const EngineOptions& options, const std::string& path, const segment::Trust& trust,
               IfAbsent if_absent, const Admit& admit) {
  for (int renewed = 0;;) {
    auto file = std::make_shared<liveness::LockFile>(path + ".lock", trust);
    if (!file->enter_gate(kGatePatience)) continue;  // the last participant has removed the file
    GateGuard gate(*file);
    bool ours = false;  // a segment exists that the lock file belongs to
    bool made = false;  // this call has made the segment
    const auto in_use = [&] { return file->held_by_other(0, segment::kMaxParticipants); };
    try {
      Found found;
      const Fit fit = segment::Segment::examine(path, options.size_bytes, trust, found.reason);
      found.fit = fit;
      ours = fit == Fit::Fits || fit == Fit::Stale || fit == Fit::Narrow;
      if (fit == Fit::Foreign) {
        throw Error(EINVAL, path, found.reason, "remove it if it is yours, or set LOT_SEGMENT");
      }
      found.lock_reason = file->shortfall(trust);
      const bool goes = fit != Fit::Fits || !found.lock_reason.empty();
      if (goes && ours) found.contents = look_into(path, trust, fit != Fit::Stale);
      found.used = goes && (found.contents.is_lived_in || in_use());
      // Without its locks this process is not in the gate, and `used` says nothing.
      file->require_intact();
      if (fit == Fit::Absent && found.used) {
        // The segment of living processes was removed, and the lock file belongs to them.
        remove_lock_file(
            path, "it is used with a segment that was removed",
            "stop those who use it (its owner can also remove it), or set LOT_SEGMENT");
        continue;
      }
      require_free(path, found, if_absent);
      if (fit != Fit::Fits) segment::Segment::remove(path, trust);
      if (!found.lock_reason.empty()) {
        renew_lock_file(path, found.lock_reason, ++renewed);
        continue;
      }
      if (fit != Fit::Fits) {
        ours = false;
        segment::Segment::create(path, capacity_of(options), trust);
        made = true;
      }
      ours = true;
      file->take_turn();
      admit(file);
      return;
    } catch (...) {
      if (made && !in_use()) {
        segment::Segment::remove(path, trust);
        ours = false;
      }
      if (!ours && !in_use()) ::unlink((path + ".lock").c_str());
      throw;
    }
  }
}

}  // namespace lot::transport
