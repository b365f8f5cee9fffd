// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "lot/detail/core.hpp"
#include "lot/error.hpp"
#include "lot/recorder.hpp"
#include "lot/signals.hpp"

#include "mcap/files.hpp"
#include "mcap/reader.hpp"
#include "record/pattern.hpp"
#include "tool/commands.hpp"
#include "tool/nearest.hpp"
#include "tool/onlooker.hpp"
#include "tool/report.hpp"
#include "tool/sleep_until.hpp"
#include "tool/status_line.hpp"
#include "tool/text.hpp"
#include "tool/writers.hpp"
#include "transport/participant.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// Between two looks at what the recorder does.
constexpr auto kLookAtRecorder = 100ms;
/// Between two lines about what goes wrong.
constexpr auto kSayErrorAgain = 10s;
/// So long topics may take to come before it says which ones are missing.
constexpr auto kForTopics = 1s;
/// Between two states of the line that is renewed.
constexpr auto kShowAgain = 1s;
/// Between two looks at what is there beside the segment that is recorded.
constexpr auto kLookAround = 1s;
/// So many names are tried where the user has named no file.
constexpr unsigned kMostNames = 100;
constexpr const char* kWaits = ": waiting (Ctrl-C ends)";

volatile std::sig_atomic_t trigger_was_asked = 0;
void ask_for_trigger(int) { trigger_was_asked = 1; }

/// Joins the one segment that `where` names. Throws lot::Error: ENOENT where there is none that it
/// can look into, EINVAL where there are several. `is_first`: of one that the user has named, also
/// what keeps it from looking there; later it waits.
std::shared_ptr<transport::Participant> join_the_one(const Where& where, bool is_first) {
  if (is_first && !where.name.empty()) return visit(where, where.name, "lot record");
  std::string name;
  for (const Sight& s : sights(where)) {
    if (s.window == nullptr) continue;
    if (!name.empty()) {
      throw Error(EINVAL, where.directory, "there are the segments " + name + " and " + s.name,
                  "say which one you mean: --segment NAME");
    }
    name = s.name;
  }
  if (name.empty()) throw Error(ENOENT, where.directory, "there is no segment", "");
  return visit(where, name, "lot record");
}

/// Removes a file that no recorder writes any more, if no message is in it. True: it is gone.
bool remove_empty(const std::string& file) {
  try {
    // The lock tells it from a file of the same name that another recorder has made meanwhile.
    const mcap::OutFile lock = mcap::OutFile::open(file);
    if (mcap::Reader(file).statistics().messages != 0) return false;
  } catch (const Error&) {
    return false;  // it is not there, or is another's
  }
  std::error_code ignored;
  return std::filesystem::remove(file, ignored);
}

/// "lot_1.mcap" for "lot.mcap".
std::string numbered(const std::string& file, unsigned number) {
  std::filesystem::path path(file);
  const std::string ending = path.extension();
  path.replace_extension();
  return path.string() + "_" + std::to_string(number) + ending;
}

std::string short_seconds(std::chrono::nanoseconds time) {
  const double seconds = std::chrono::duration<double>(time).count();
  char text[32];
  std::snprintf(text, sizeof(text), seconds < 100 ? "%.2g s" : "%.0f s", seconds);
  return text;
}

/// What the topics of a status are together.
RecorderStatus::Topic sum_of(const RecorderStatus& status) {
  RecorderStatus::Topic sum;
  for (const auto& topic : status.topics) {
    sum.messages += topic.messages;
    sum.bytes += topic.bytes;
    sum.missed += topic.missed;
    sum.lost += topic.lost + topic.damaged;
    sum.left_out += topic.left_out;
  }
  return sum;
}

class Record {
 public:
  Record(const Settings& settings, const RecordOptions& options)
      : where_(settings.where), options_(options), report_(settings) {}

  Exit run() {
    std::signal(SIGPIPE, SIG_IGN);
    const StopToken stop = stop_on_signals();
    std::signal(SIGUSR1, ask_for_trigger);
    std::unique_ptr<Recorder> recorder;
    try {
      recorder = begin();
    } catch (const Error& e) {
      fill_document(RecorderStatus());
      std::string text = e.what();
      if (options_.has_default_name && e.object() == options_.what.path) {
        text += "; -o FILE names the file";
      }
      return report_.refuse(shown(text, kLine), e.error_number() == EBADMSG ? kDamaged : kWrong);
    }
    if (keeps_last()) say_what_triggers();
    const Clock::time_point end = detail::after(options_.duration);
    while (sleep_until(std::min(end, Clock::now() + kLookAtRecorder), stop) && Clock::now() < end) {
      pass_trigger_on(*recorder);
      look(recorder->status());
    }
    pass_trigger_on(*recorder);
    line_.clear();
    try {
      recorder->stop();
    } catch (const Error& e) {
      report_.hint(printable(reason_of(e), kLine));
      report_.ends(kWrong);
    }
    RecorderStatus told = recorder->status();
    say_files(told);
    tell(std::move(told));
    return report_.finish();
  }

 private:
  bool keeps_last() const { return options_.what.keep_last > Duration(); }

  /// Where the user has named no file, and there is one of this second's name: the next name.
  std::unique_ptr<Recorder> begin() const {
    RecorderOptions what = options_.what;
    for (unsigned n = 1;; ++n) {
      try {
        return std::make_unique<Recorder>(what, [where = where_, is_first = true]() mutable {
          return join_the_one(where, std::exchange(is_first, false));
        });
      } catch (const Error& e) {
        if (!options_.has_default_name || e.error_number() != EEXIST || n > kMostNames) throw;
      }
      what.path = numbered(options_.what.path, n);
    }
  }

  void pass_trigger_on(Recorder& recorder) {
    if (trigger_was_asked == 0) return;
    trigger_was_asked = 0;
    if (keeps_last()) return recorder.trigger();
    say("SIGUSR1 is a trigger with --last alone: nothing is done");
  }

  void say(const std::string& text) {
    line_.clear();
    std::fprintf(stderr, "* %s\n", shown(text, kLine).c_str());
  }

  void say_what_triggers() {
    const std::string& topic = options_.what.trigger;
    say("keeps the last messages in memory: SIGUSR1" +
        (topic.empty() ? "" : ", or a message on " + topic + ",") + " writes them");
  }

  /// Says on standard error what is new.
  void look(const RecorderStatus& now) {
    look_around(now);
    say_what_is_missing(now);
    say_cut(now);
    for (const auto& refused : now.refused) {
      if (said_.insert(refused.name).second) say(left_out_text(refused));
    }
    say_files(now);
    if (now.error != error_ && Clock::now() >= say_again_) {
      say(error_.empty() ? now.first_error : now.error);
      error_ = now.error;
      say_again_ = Clock::now() + kSayErrorAgain;
    }
    show_how_it_goes(now);
  }

  static std::string left_out_text(const RecorderStatus::Refused& refused) {
    return printable(refused.name, 200) + " is left out: " + refused.why;
  }

  void say_files(const RecorderStatus& now) {
    for (; files_ < now.files.size(); ++files_) say("writes " + now.files[files_]);
  }

  std::string cut_text(const RecorderStatus& now) const {
    char memory[32];
    std::snprintf(memory, sizeof(memory), "%g",
                  static_cast<double>(options_.what.keep_last_bytes) / (1 << 20));
    return "of the last " + short_seconds(options_.what.keep_last) + " only " +
           short_seconds(now.cut_time) + " fit in --memory " + memory;
  }
  void say_cut(const RecorderStatus& now) {
    if (now.cut_messages != 0 && !std::exchange(has_said_cut_, true)) say(cut_text(now));
  }

  /// Says what is there beside what it records, or in its place: files that it cannot look into,
  /// and other segments.
  void look_around(const RecorderStatus& now) {
    if (Clock::now() < look_around_) return;
    look_around_ = Clock::now() + kLookAround;
    const Surroundings there = surroundings(now);
    is_hindered_ = !there.hindrances.empty();
    const std::string end = there.is_recording ? "" : kWaits;
    for (const std::string& line : there.hindrances) {
      if (said_.insert(line).second) say(line + end);
    }
    for (const std::string& line : there.others) {
      if (said_.insert(line).second) say(line);
    }
  }

  /// Lines about what is there and is not recorded.
  struct Surroundings {
    std::vector<std::string> hindrances;
    std::vector<std::string> others;
    bool is_recording = false;  ///< a segment that it has joined is there
  };
  Surroundings surroundings(const RecorderStatus& now) const try {
    Surroundings there;
    const std::vector<Sight> all = sights(where_);
    for (const Hindrance& h : hindrances(where_, all)) {
      there.hindrances.push_back(printable(h.path, 200) + ": " + printable(h.reason, kLine));
    }
    const auto is_recorded = [&](const Sight& s) {
      return s.window != nullptr && std::ranges::count(now.segments, s.path) != 0;
    };
    there.is_recording = std::ranges::any_of(all, is_recorded);
    for (const Sight& s : all) {
      // Without one that it records it may join this one at its next look.
      if (!there.is_recording || s.window == nullptr || is_recorded(s)) continue;
      there.others.push_back(printable(s.path, 200) +
                             " is there, too, and is not recorded: `lot "
                             "record --segment " +
                             printable(s.name, 200) + "` records it");
    }
    return there;
  } catch (const Error&) {
    return {};  // there is no directory: why_no_segment() says it
  }

  /// Once: where there is nothing at all, and a while later where some of it has not come.
  void say_what_is_missing(const RecorderStatus& now) {
    const bool is_nothing = now.topics.empty() && now.refused.empty();
    if (has_said_what_is_missing_ || (!is_nothing && Clock::now() < begin_ + kForTopics)) return;
    has_said_what_is_missing_ = true;
    for (const std::string& line : missing(now, kWaits)) say(line);
  }

  /// For each name or pattern that no topic has fitted a line that says what is there. `end`: of a
  /// line about a topic that may still come.
  std::vector<std::string> missing(const RecorderStatus& now, const std::string& end) const {
    if (now.unmatched.empty()) return {};
    std::vector<std::string> there = topics_there(where_);
    for (const auto& topic : now.topics) there.push_back(topic.name);
    for (const auto& refused : now.refused) there.push_back(refused.name);
    if (there.empty() && now.segments.empty()) {
      if (is_hindered_) return {};
      if (const std::string why = why_no_segment(where_); !why.empty()) return {why + end};
    }
    sort_out(there);
    std::vector<std::string> lines;
    for (const std::string& wanted : now.unmatched) {
      const bool is_trigger = wanted == options_.what.trigger;
      const bool is_wanted = std::ranges::count(options_.what.topics, wanted) != 0;
      const std::string name = printable(wanted, 200);
      // It has come since the recorder looked last.
      if (std::ranges::any_of(there, [&](const auto& t) { return record::matches(wanted, t); })) {
        if (end.empty() && is_wanted) lines.push_back(name + " came too late to be recorded");
        continue;
      }
      const std::string advice = advice_for(wanted, there);
      std::string line = is_wanted ? "" : is_trigger ? "--trigger: " : "--except: ";
      line += wanted == "*"                ? "no process uses a topic"
              : record::is_pattern(wanted) ? "no topic fits " + name
                                           : "no topic is called " + name;
      if (!advice.empty()) line += "; " + advice;
      if (is_wanted || is_trigger) line += end;
      lines.push_back(std::move(line));
    }
    return lines;
  }

  void show_how_it_goes(const RecorderStatus& now) {
    const auto time = Clock::now();
    if (!line_.can_be_shown() || time < show_again_) return;
    const auto seconds = [](Clock::duration span) {
      return std::chrono::duration<double>(span).count();
    };
    const RecorderStatus::Topic sum = sum_of(now);
    const double span = std::max(seconds(time - shown_), 0.001);
    const auto since = static_cast<double>(sum.bytes - std::min(sum.bytes, shown_bytes_));
    std::string text = age_text(seconds(time - begin_)) + ": " +
                       plural(sum.messages, "message", "messages") + ", " + bytes_text(sum.bytes) +
                       ", " + bandwidth_text(since / span) + "; " + std::to_string(sum.missed) +
                       " missed, " + std::to_string(sum.lost) + " lost; " +
                       bytes_text(now.held_bytes) + " held";
    if (keeps_last()) {
      text += "; kept: " + plural(now.kept_messages, "message", "messages") + ", " +
              bytes_text(now.kept_bytes);
    }
    line_.show(text);
    shown_ = time;
    shown_bytes_ = sum.bytes;
    show_again_ = time + kShowAgain;
  }

  // ---- at the end ----

  void tell(RecorderStatus now) {
    const RecorderStatus::Topic sum = sum_of(now);
    std::vector<std::string> removed;
    std::erase_if(now.files, [&](const std::string& file) {
      const bool may_be_empty = sum.messages == 0 || sum.lost != 0;
      const bool is_gone = may_be_empty && remove_empty(file);
      if (is_gone) removed.push_back(file);
      return is_gone;
    });
    for (const std::string& file : now.files) report_.print(printable(file, 200) + "\n");
    for (const std::string& segment : now.segments) {
      report_.print("  segment " + printable(segment, 200) + "\n");
    }
    fill_document(now);
    print_topics(now);
    for (const std::string& file : removed) {
      report_.hint(printable(file, 200) + " had no message, and was removed");
    }
    if (sum.lost != 0) report_.ends(kWrong);
    for (const auto& topic : now.topics) {
      const bool is_empty = topic.messages == 0 && now.kept_messages == 0;
      if (!is_empty || topic.in_segment == topic.name) continue;
      report_.hint(printable(topic.name, 200) +
                   " is a topic of ROS: its messages are in the segment while a node of LOT in "
                   "another process subscribes to it, and else on ROS's own links");
    }
    for (const auto& refused : now.refused) {
      report_.hint(left_out_text(refused));
      const auto& named = options_.what.topics;
      if (std::find(named.begin(), named.end(), refused.name) != named.end()) report_.ends(kWrong);
    }
    if (sum.messages == 0) tell_why_nothing(now);
    if (now.cut_messages != 0) {
      report_.hint(cut_text(now) + ": " +
                   plural(now.cut_messages, "message went", "messages went") +
                   " before the time was over; a larger --memory keeps more");
    }
    tell_surroundings(now);
    tell_what_is_missing(now);
    if (sum.missed != 0) {
      report_.hint(plural(sum.missed, "message was", "messages were") +
                   " overwritten before it looked: a deeper queue of the publisher "
                   "(PusherOptions::depth), or a larger --quota, helps");
    }
  }

  void tell_surroundings(const RecorderStatus& now) {
    const Surroundings there = surroundings(now);
    is_hindered_ = !there.hindrances.empty();
    for (const std::string& line : there.hindrances) report_.hint(line);
    for (const std::string& line : there.others) report_.hint(line);
  }

  void print_topics(const RecorderStatus& now) {
    const bool has_left_out = sum_of(now).left_out != 0;
    std::vector<std::string> head = {"TOPIC", "TYPE", "MESSAGES", "BYTES", "MISSED", "LOST"};
    if (has_left_out) head.emplace_back("LEFT OUT");
    Table table(head, {0, 1});
    for (const auto& topic : now.topics) {
      std::vector<std::string> row = {
          printable(topic.name, 200),     printable(topic.type),
          std::to_string(topic.messages), bytes_text(topic.bytes),
          std::to_string(topic.missed),   std::to_string(topic.lost + topic.damaged)};
      if (has_left_out) row.push_back(std::to_string(topic.left_out));
      table.add(std::move(row));
    }
    if (!table.empty()) report_.print(table.text());
  }

  void fill_document(const RecorderStatus& now) {
    Json& out = report_.document();
    out["command"] = "record";
    out["segments"] = Json::array();
    for (const std::string& path : now.segments) {
      out["segments"].push_back(std::filesystem::path(path).filename().string());
    }
    out["files"] = now.files;
    out["topics"] = Json::array();
    for (const auto& topic : now.topics) {
      out["topics"].push_back({{"name", topic.name},
                               {"type", topic.type},
                               {"messages", topic.messages},
                               {"bytes", topic.bytes},
                               {"missed", topic.missed},
                               {"lost", topic.lost},
                               {"damaged", topic.damaged},
                               {"left_out", topic.left_out}});
    }
    out["refused"] = Json::array();
    for (const auto& refused : now.refused) {
      out["refused"].push_back({{"name", refused.name}, {"why", refused.why}});
    }
    out["unmatched"] = now.unmatched;
  }

  void tell_why_nothing(const RecorderStatus& now) {
    if (keeps_last() && now.triggers == 0 && !now.topics.empty()) {
      return report_.hint("no trigger came: " + plural(now.kept_messages, "message", "messages") +
                          " of the last seconds were kept, and are not written");
    }
    report_.hint(now.triggers == 0 ? "nothing was recorded"
                 : now.first_error.empty()
                     ? "nothing was recorded: no message was there when the trigger came"
                     : "nothing was recorded: a trigger came, and its file could not be written");
    report_.ends(kWrong);
  }

  /// A name is one that there should be. A pattern may fit nothing.
  void tell_what_is_missing(const RecorderStatus& now) {
    for (const std::string& line : missing(now, "")) report_.hint(line);
    const auto is_asked_for = [&](const std::string& name) {
      return !record::is_pattern(name) && std::ranges::count(options_.what.topics, name) != 0;
    };
    if (std::ranges::any_of(now.unmatched, is_asked_for)) report_.ends(kWrong);
  }

  const Where where_;
  const RecordOptions& options_;
  Report report_;
  StatusLine line_;
  const Clock::time_point begin_ = Clock::now();
  bool has_said_what_is_missing_ = false;
  bool has_said_cut_ = false;
  bool is_hindered_ = false;  ///< at the last look around
  Clock::time_point look_around_{};
  std::set<std::string> said_;
  std::size_t files_ = 0;
  std::string error_;
  Clock::time_point say_again_{};
  Clock::time_point show_again_{};
  Clock::time_point shown_ = begin_;
  std::uint64_t shown_bytes_ = 0;
};

}  // namespace

Exit record(const Settings& settings, const RecordOptions& options) {
  return Record(settings, options).run();
}

}  // namespace lot::tool
