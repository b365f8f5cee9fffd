// SPDX-License-Identifier: Apache-2.0
#include "tool/report.hpp"

#include <cstdio>

#include "liveness/lock_file.hpp"
#include "refcount/ownership.hpp"
#include "robust_mutex/lock_word.hpp"
#include "tool/output.hpp"
#include "tool/rows.hpp"
#include "tool/text.hpp"

namespace lot::tool {

Exit Report::finish() {
  if (json_) {
    document_["hints"] = hints_;
    document_["exit"] = static_cast<int>(exit_);
    // Names may hold any bytes, and JSON is UTF-8.
    text_ = document_.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
  } else if (!hints_.empty()) {
    text_ += "\n";
    for (const auto& hint : hints_) text_ += "* " + hint + "\n";
  }
  if (!write_out(text_, StopToken())) ends(kWrong);
  return exit_;
}

Exit Report::refuse(const std::string& text, Exit exit) {
  std::fprintf(stderr, "%s\n", text.c_str());
  if (!json_) return exit;
  ends(exit);
  hint(text);
  return finish();
}

std::string command(const std::string& words, const std::string& path) {
  return printable(segment::command(words, path), 500);
}

bool introduce(const Sight& sight, Report& report, Json& entry) {
  entry["name"] = sight.name;
  entry["path"] = sight.path;
  entry["condition"] = to_string(sight.condition);
  entry["reason"] = sight.reason;
  report.print(printable(sight.name) + "  " + printable(sight.path, 200));
  if (sight.window != nullptr) {
    entry["bytes"] = sight.window->segment().size();
    return true;
  }
  report.print("\n  " + std::string(to_string(sight.condition)) + ": " +
               printable(sight.reason, kLine) + "\n");
  const std::string name = printable(sight.name);
  switch (sight.condition) {
    case Sight::Condition::OtherBoot:
      report.ends(kWrong);
      report.hint(name + " is of another boot: run " + command("clean", sight.path));
      break;
    case Sight::Condition::Unreadable:
      report.ends(kWrong);
      report.hint(name +
                  " can not be read: ask its owner, or look as root: " + command("ls", sight.path));
      break;
    case Sight::Condition::Untrusted:
      report.ends(kWrong);
      report.hint(name +
                  " is not looked into: above stands why, and what to set if you trust its users");
      break;
    default:
      report.ends(kDamaged);
      report.hint(name +
                  " is damaged, cut short, or of another version: stop what uses it and run " +
                  command("clean", sight.path));
  }
  return false;
}

std::string waiting_text(const Waiting& items) {
  constexpr int kMostNames = 5;
  std::string text;
  int named = 0;
  std::uint64_t others = 0;
  for (const auto& [queue, n] : items) {
    if (named++ >= kMostNames) {
      others += n;
    } else if (text.empty()) {
      text = plural(n, "item waits", "items wait") + " in " + printable(queue, 40);
    } else {
      text += ", " + std::to_string(n) + " in " + printable(queue, 40);
    }
  }
  return others == 0 ? text : text + ", " + std::to_string(others) + " in other queues";
}

Json waiting_json(const Waiting& items) {
  Json list = Json::array();
  for (const auto& [queue, n] : items) list.push_back({{"queue", queue}, {"items", n}});
  return list;
}

void judge(const Sight& sight, const Observation& seen, Report& report, Json& entry) {
  entry["damage"] = seen.damage;
  const std::string name = printable(sight.name);
  for (const auto& what : seen.damage) report.print("  damaged: " + what + "\n");
  if (!seen.damage.empty()) {
    report.ends(kDamaged);
    report.hint(name +
                " is damaged: a process has written behind the end of its messages; stop "
                "all that use it and run " +
                command("clean", sight.path));
  }
  bool any_alive = false;
  for (const auto& p : seen.processes) any_alive |= p.alive;
  if (!any_alive && was_left(sight)) {
    return report.hint(name + " has just gone: its last process has left it");
  }
  if (!any_alive) {
    report.ends(kWrong);
    const Waiting items = waiting(*sight.window);
    report.hint(
        "no process lives in " + name +
        (!items.empty()
             ? "; " + waiting_text(items) + ": start a process that takes them, or drop them by " +
                   command("clean --with-items", sight.path)
         : seen.persists ? ", which was to stay: " + command("clean", sight.path) + " removes it"
                         : ": run " + command("clean", sight.path)) +
        (segment::may_remove(sight.path)
             ? ""
             : ", as its owner or root: it belongs to " + segment::owner_and_mode(sight.path)));
    return;
  }
  for (const auto& group : groups(seen.processes, false)) {
    const Process& p = group.front();
    if (p.alive) continue;
    report.ends(kWrong);
    if (group.size() > 1) {
      report.hint(std::to_string(group.size()) + " processes (" + printable(common_name(group)) +
                  ") in " + name + " are dead: run " + command("clean", sight.path));
      continue;
    }
    report.hint("process " + std::to_string(p.index) + " (" + printable(p.name) + ") in " + name +
                " is dead: run " + command("clean", sight.path));
  }
}

namespace {

/// A stopped process keeps its locks: names each one that others wait for.
void name_the_stopped(const std::string& path, Window* window, Report& report) {
  const liveness::LockProbe locks(path + ".lock");
  const auto ask = [&](std::uint32_t byte, const char* where) {
    const auto holder = locks.holder(byte);
    if (!holder || !holder->is_stopped) return;
    report.ends(kWrong);
    report.hint(holder->describe() + " is stopped while it " + where + " " + printable(path, 200) +
                ", and others wait for it: " + holder->advice());
  };
  ask(liveness::LockFile::kGate, "opens or closes");
  ask(refcount::kOrphanage, "frees what it or the dead have left in");
  if (window == nullptr) return;
  segment::Segment& s = window->segment();
  const std::uint32_t word = s.directory().lock.word.load(std::memory_order_acquire);  // L3
  const std::uint32_t k = lock::participant(lock::name(word));
  if (word != 0 && k < s.capacity().participants) ask(k, "has the registry's lock of");
}

}  // namespace

void look_for_obstacles(const Settings& settings, const std::vector<Sight>& found, Report& report) {
  const Places places = find_places(settings.where);
  for (const auto& obstacle : places.obstacles) {
    report.ends(kWrong);
    report.hint(printable(obstacle.path, 200) + ": " + printable(obstacle.advice(), kLine));
  }
  for (const Sight& sight : found) {
    if (sight.condition != Sight::Condition::Untrusted) {
      name_the_stopped(sight.path, sight.window.get(), report);
    }
  }
  for (const auto* names : {&places.unfinished, &places.locks, &places.doubtful}) {
    for (const auto& name : *names) {
      const std::string path = path_of(settings.where, name);
      if (!exists(path)) name_the_stopped(path, nullptr, report);
    }
  }
}

void nothing_found(const Settings& settings, Report& report) {
  report.ends(kWrong);
  report.print(settings.where.name.empty()
                   ? "no segments in " + printable(settings.where.directory, 200) + "\n"
                   : "no segment " + printable(path_of(settings.where, settings.where.name), 200) +
                         "\n");
}

}  // namespace lot::tool
