// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <memory>
#include <thread>
#include <unistd.h>

#include "lot/error.hpp"

#include "liveness/lock_file.hpp"
#include "tool/onlooker.hpp"
#include "tool/report.hpp"
#include "tool/text.hpp"
#include "transport/participant.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;

constexpr std::chrono::milliseconds kGatePatience = 2s;
/// A reaper may be reaping the dead process just now.
constexpr auto kReapPatience = 2s;

/// Byte locks of living processes, whatever the version of their segment.
constexpr std::uint32_t kAnybody = segment::kMaxParticipants;

/// True when a process in the segment lives by its witnesses: it may have lost its locks. Only for
/// a segment that this build can read, and of this boot.
bool has_witnesses(const Sight& s) { return s.window != nullptr && !living(*s.window).empty(); }

/// Only for a segment that this build can read, and of this boot.
Waiting items_in(const Sight& s) { return s.window != nullptr ? waiting(*s.window) : Waiting(); }

class Cleaner {
 public:
  Cleaner(const Settings& settings, const CleanOptions& options, Report& report)
      : where_(settings.where),
        dry_(options.dry_run),
        with_items_(options.with_items),
        report_(report) {
    report_.document()["command"] = "clean";
    for (const char* list : {"removed", "reaped", "given_back", "left_alone", "in_use"}) {
      report_.document()[list] = Json::array();
    }
    report_.document()["dry_run"] = dry_;
  }

  void clean(Sight s) {
    using Condition = Sight::Condition;
    if (s.condition == Condition::Unreadable || s.condition == Condition::Untrusted)
      return leave_alone(s.path, s.reason, kWrong);
    const liveness::LockProbe locks(s.path + ".lock");
    if (!locks.is_held(0, kAnybody) && !has_witnesses(s)) {
      const Waiting items = items_in(s);
      s.window.reset();
      if (!items.empty() && !with_items_) return leave_items(s, items);
      return remove(s.name, s.path,
                    "no process lives in it" + (items.empty() ? "" : ", " + waiting_text(items)));
    }
    if (s.window == nullptr) return leave_alone(s.path, s.reason + ", and it is in use", kDamaged);
    tend(s);
  }

  void remove(const std::string& name, const std::string& path, const std::string& why) {
    if (!segment::may_remove(path)) {
      return leave_alone(path,
                         why + ", and it belongs to " + segment::owner_and_mode(path) +
                             ": that user, or root, can remove it",
                         kWrong);
    }
    const Files files = files_of(name);
    if (dry_) return removed(path, why, files);
    try {
      if (try_remove(name)) {
        removed(path, why, files);
      } else if (exists(path)) {
        leave_alone(path, "it has been taken meanwhile", kWell);
      }
    } catch (const Error& e) {
      leave_alone(path, e.what(), kWrong);
    }
  }

  /// Says so when there was nothing to do, or to leave alone.
  void conclude() {
    for (const char* list : {"removed", "reaped", "given_back", "left_alone"}) {
      if (!report_.document()[list].empty()) return;
    }
    const Json& in_use = report_.document()["in_use"];
    std::string why;
    if (in_use.empty()) {
      why = where_.name.empty() ? "no segment lies in " + where_.directory
                                : "no segment lies at " + path_of(where_, where_.name);
    } else if (in_use.size() == 1) {
      why = in_use.front().at("path").get<std::string>() +
            " is in use, without a dead process or idle memory";
    } else {
      why = std::to_string(in_use.size()) + " segments of " + where_.directory +
            " are in use, without a dead process or idle memory";
    }
    report_.print("nothing to do: " + printable(why, kLine) + "\n");
  }

  void leave_alone(const std::string& path, const std::string& why, Exit exit,
                   const Waiting& items = {}) {
    report_.document()["left_alone"].push_back(
        {{"path", path}, {"why", why}, {"waiting", waiting_json(items)}});
    report_.print("left alone  " + printable(path, 200) + ": " + printable(why, kLine) + "\n");
    report_.ends(exit);
  }

 private:
  /// Leaves a segment alone because items wait in it. A process has put them there to be taken:
  /// they go only when the user says so.
  void leave_items(const Sight& s, const Waiting& items) {
    leave_alone(s.path, "no process lives in it, but " + waiting_text(items), kWell, items);
    report_.hint(printable(s.name) + ": start a process that takes the items, or drop them by " +
                 command("clean --with-items", s.path));
  }

  struct Files {
    std::vector<std::string> paths;
    std::uint64_t bytes = 0;  ///< that the file system has for them
  };
  /// What is there of a segment: the file, an unfinished one, the lock file.
  Files files_of(const std::string& name) const {
    Files files;
    for (const char* suffix : {"", ".new", ".lock"}) {
      const std::string path = path_of(where_, name) + suffix;
      if (!exists(path)) continue;
      files.paths.push_back(path);
      files.bytes += bytes_on_disk(path);
    }
    return files;
  }

  void removed(const std::string& path, const std::string& why, const Files& files) {
    report_.document()["removed"].push_back(
        {{"path", path}, {"why", why}, {"files", files.paths}, {"bytes", files.bytes}});
    std::string with;
    for (const auto& file : files.paths) {
      if (file != path) with += (with.empty() ? " with " : ", ") + file.substr(file.rfind('/') + 1);
    }
    report_.print((dry_ ? "would remove  " : "removed  ") + printable(path, 200) +
                  printable(with, 200) + ": " + why +
                  (files.bytes != 0 ? "; that gives " + bytes_text(files.bytes) + " back" : "") +
                  "\n");
  }

  /// Removes a segment and its lock file. No process can join while the tool has the gate; a
  /// process that comes later finds nothing and makes the segment anew. False: a process is in the
  /// segment, or has put something else in its place.
  bool try_remove(const std::string& name) {
    const std::string path = path_of(where_, name);
    const std::string lock_path = path + ".lock";
    for (;;) {
      const bool made = !exists(lock_path);
      liveness::LockFile lock(lock_path, where_.trust);
      if (!lock.enter_gate(kGatePatience)) continue;  // the lock file was removed: once more
      struct Gate {
        liveness::LockFile& lock;
        ~Gate() { lock.leave_gate(); }
      } gate{lock};
      const bool is_ours = !exists(path) || (begins_as_a_segment(path) && where_.trust.owns(path));
      if (!is_ours || lock.held_by_other(0, kAnybody) || (exists(path) && stays(name))) {
        if (made) ::unlink(lock_path.c_str());
        return false;
      }
      segment::Segment::remove(path, where_.trust);
      ::unlink(lock_path.c_str());
      for (const auto& left : {path, path + ".new", lock_path}) {
        if (exists(left)) throw Error(EACCES, left, "cannot remove it", "its owner can, or root");
      }
      return true;
    }
  }

  /// True when the segment must stay. Called in the gate: since the first look a process may have
  /// joined, or put an item.
  bool stays(const std::string& name) const {
    const Sight now = sight(where_, name);
    return has_witnesses(now) || (!with_items_ && !items_in(now).empty());
  }

  /// Cleans up in a segment that living processes use, and in which others may be dead. It joins as
  /// any process does: so the dead are reaped, and memory goes back.
  void tend(Sight& s) {
    const auto the_dead = dead(*s.window);
    const Observation seen = observe(*s.window);
    if (!seen.damage.empty()) {
      return leave_alone(s.path, "it is damaged (" + seen.damage.front() + "), and it is in use",
                         kDamaged);
    }
    std::vector<std::uint32_t> left = the_dead;
    std::uint64_t given_back = dry_ ? unused(s.window->segment()) : 0;
    if (!dry_) {
      try {
        const auto participant = visit(where_, s.name, "lot clean");
        const auto until = std::chrono::steady_clock::now() + kReapPatience;
        while (!(left = still_dead(s, the_dead)).empty() &&
               std::chrono::steady_clock::now() < until) {
          participant->reaper().reap_dead();
          participant->reaper().collect();
          std::this_thread::sleep_for(1ms);
        }
        given_back = participant->memory().give_all_back_to_system();
      } catch (const Error& e) {
        if (e.error_number() == ENOENT) return;  // the last process of the segment has removed it
        const bool is_full = e.error_number() == EUSERS || e.error_number() == EBUSY;
        return leave_alone(s.path, e.what(), the_dead.empty() && is_full ? kWell : kWrong);
      }
    }
    for (const std::uint32_t k : the_dead) {
      const bool gone = dry_ || std::count(left.begin(), left.end(), k) == 0;
      if (gone) {
        reaped(s, seen, k);
      } else {
        leave_alone(s.path,
                    seen.who(k) +
                        " is dead and could not be reaped: look for a stopped "
                        "process (state T in ps)",
                    kWrong);
      }
    }
    report_.document()["in_use"].push_back({{"path", s.path}});
    if (given_back == 0) return;
    report_.document()["given_back"].push_back({{"path", s.path}, {"bytes", given_back}});
    report_.print((dry_ ? "would give back  " : "gave back  ") + printable(s.path, 200) + ": " +
                  bytes_text(given_back) + " that no process uses\n");
  }

  void reaped(const Sight& s, const Observation& seen, std::uint32_t k) {
    const Process* const p = seen.process(k);  // nothing: its place was empty when we observed
    report_.document()["reaped"].push_back({{"path", s.path},
                                            {"process", k},
                                            {"name", p != nullptr ? p->name : ""},
                                            {"pid", p != nullptr ? Json(p->pid) : Json(nullptr)}});
    report_.print((dry_ ? "would reap  " : "reaped  ") + printable(seen.who(k)) +
                  (p != nullptr ? " (pid " + std::to_string(p->pid) + ")" : "") + " in " +
                  printable(s.path, 200) + "\n");
  }

  static std::uint64_t unused(const segment::Segment& s) {
    std::uint64_t bytes = 0;
    for (std::uint32_t unit = s.first_unit(); unit < s.units(); ++unit) {
      if (s.is_unused(unit, 0)) bytes += s.bytes_of_unit(unit);
    }
    return bytes;
  }

  static std::vector<std::uint32_t> still_dead(Sight& s, const std::vector<std::uint32_t>& were) {
    auto now = dead(*s.window);
    std::erase_if(now,
                  [&](std::uint32_t k) { return std::count(were.begin(), were.end(), k) == 0; });
    return now;
  }

  Where where_;
  bool dry_;
  bool with_items_;
  Report& report_;
};

}  // namespace

Exit clean(const Settings& settings, const CleanOptions& options) {
  // The library would read these variables when it joins.
  for (const char* name : {"LOT_SEGMENT", "LOT_DIR", "LOT_SIZE", "LOT_PERMISSIONS", "LOT_USER",
                           "LOT_GROUP", "LOT_PERSIST", "LOT_MLOCK"}) {
    unsetenv(name);
  }
  Report report(settings);
  Cleaner cleaner(settings, options, report);
  const Places places = find_places(settings.where);
  for (auto& s : sights(settings.where)) cleaner.clean(std::move(s));
  for (const auto& name : places.unfinished) {
    const std::string path = path_of(settings.where, name);
    if (!exists(path)) cleaner.remove(name, path + ".new", "its maker has died");
  }
  for (const auto& name : places.locks) {
    cleaner.remove(name, path_of(settings.where, name) + ".lock", "it has no segment");
  }
  for (const auto& name : places.doubtful) {
    const std::string path = path_of(settings.where, name) + ".lock";
    cleaner.leave_alone(
        path, "another program may own it; " + command("clean", path) + " removes it", kWell);
  }
  for (const auto& obstacle : places.obstacles) {
    cleaner.leave_alone(obstacle.path, obstacle.advice(), kWrong);
  }
  cleaner.conclude();
  return report.finish();
}

}  // namespace lot::tool
