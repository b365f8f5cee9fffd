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

volatile std::sig_atomic_t trigger_was_asked = 0;
void ask_for_trigger(int) { trigger_was_asked = 1; }

/// Joins the one segment that `where` names. Throws lot::Error: ENOENT where there is none, EINVAL
/// where there are several.
std::shared_ptr<transport::Participant> join_the_one(const Where& where) {
  std::string name = where.name;
  if (name.empty()) {
    for (const Sight& s : sights(where)) {
      if (s.window == nullptr) continue;
      if (!name.empty()) {
        throw Error(EINVAL, where.directory, "there are the segments " + name + " and " + s.name,
                    "say which one you mean: --segment NAME");
      }
      name = s.name;
    }
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
    if (keeps_last()) std::signal(SIGUSR1, ask_for_trigger);
    const Where where = where_;
    Recorder recorder(options_.what, [where] { return join_the_one(where); });
    if (keeps_last()) say_what_triggers();
    const Clock::time_point end = detail::after(options_.duration);
    while (sleep_until(std::min(end, Clock::now() + kLookAtRecorder), stop) && Clock::now() < end) {
      if (trigger_was_asked != 0) {
        trigger_was_asked = 0;
        recorder.trigger();
      }
      look(recorder.status());
    }
    line_.clear();
    try {
      recorder.stop();
    } catch (const Error& e) {
      report_.hint(printable(reason_of(e), 500));
      report_.ends(kWrong);
    }
    RecorderStatus told = recorder.status();
    say_files(told);
    tell(std::move(told));
    return report_.finish();
  }

 private:
  bool keeps_last() const { return options_.what.keep_last > Duration(); }

  void say(const std::string& text) {
    line_.clear();
    std::fprintf(stderr, "* %s\n", shown(text, 400).c_str());
  }

  void say_what_triggers() {
    const std::string& topic = options_.what.trigger;
    say("keeps the last messages in memory: SIGUSR1" +
        (topic.empty() ? "" : ", or a message on " + topic + ",") + " writes them");
  }

  /// Says on standard error what is new.
  void look(const RecorderStatus& now) {
    say_what_is_missing(now);
    for (const auto& refused : now.refused) {
      if (said_.insert(refused.name).second) say("left out: " + refused.why);
    }
    say_files(now);
    if (now.error != error_ && Clock::now() >= say_again_) {
      error_ = now.error;
      say_again_ = Clock::now() + kSayErrorAgain;
      say(error_);
    }
    show_how_it_goes(now);
  }

  void say_files(const RecorderStatus& now) {
    for (; files_ < now.files.size(); ++files_) say("writes " + now.files[files_]);
  }

  /// Once: where there is nothing at all, and a while later where some of it has not come.
  void say_what_is_missing(const RecorderStatus& now) {
    const bool is_nothing = now.topics.empty() && now.refused.empty();
    if (has_said_what_is_missing_ || (!is_nothing && Clock::now() < begin_ + kForTopics)) return;
    has_said_what_is_missing_ = true;
    for (const std::string& line : missing(now, ": waiting (Ctrl-C ends)")) say(line);
  }

  /// For each name or pattern that no topic has fitted a line that says what is there. `end`: of a
  /// line about a topic that may still come.
  std::vector<std::string> missing(const RecorderStatus& now, const std::string& end) const {
    if (now.unmatched.empty()) return {};
    std::vector<std::string> there = topics_there(where_);
    for (const auto& topic : now.topics) there.push_back(topic.name);
    for (const auto& refused : now.refused) there.push_back(refused.name);
    if (there.empty()) {
      if (const std::string why = why_no_segment(where_); !why.empty()) return {why + end};
    }
    sort_out(there);
    std::vector<std::string> lines;
    for (const std::string& wanted : now.unmatched) {
      const bool is_trigger = wanted == options_.what.trigger;
      const bool is_wanted = std::ranges::count(options_.what.topics, wanted) != 0;
      const std::string name = printable(wanted, 200);
      const std::string advice = advice_for(wanted, there);
      std::string line = is_wanted ? "" : is_trigger ? "--trigger: " : "--except: ";
      line += wanted == "*"        ? "no process uses a topic"
              : is_pattern(wanted) ? "no topic fits " + name
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
      const bool is_gone = sum.messages == 0 && remove_empty(file);
      if (is_gone) removed.push_back(file);
      return is_gone;
    });
    report_.document()["command"] = "record";
    report_.document()["files"] = now.files;
    for (const std::string& file : now.files) report_.print(printable(file, 200) + "\n");
    tell_topics(now);
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
    if (sum.messages == 0) tell_why_nothing(now);
    tell_what_is_missing(now);
    if (sum.missed != 0) {
      report_.hint(plural(sum.missed, "message was", "messages were") +
                   " overwritten before it looked: a deeper queue of the publisher "
                   "(PusherOptions::depth), or a larger --quota, helps");
    }
  }

  void tell_topics(const RecorderStatus& now) {
    Json& out = report_.document();
    out["topics"] = Json::array();
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
    if (!table.empty()) report_.print(table.text());
  }

  void tell_why_nothing(const RecorderStatus& now) {
    if (keeps_last() && now.files.empty() && !now.topics.empty()) {
      return report_.hint("no trigger came: " + plural(now.kept_messages, "message", "messages") +
                          " of the last seconds were kept, and are not written");
    }
    report_.hint("nothing was recorded");
    report_.ends(kWrong);
  }

  /// A name is one that there should be. A pattern may fit nothing.
  void tell_what_is_missing(const RecorderStatus& now) {
    for (const std::string& line : missing(now, "")) report_.hint(line);
    const auto is_asked_for = [&](const std::string& name) {
      return !is_pattern(name) && std::ranges::count(options_.what.topics, name) != 0;
    };
    if (std::ranges::any_of(now.unmatched, is_asked_for)) report_.ends(kWrong);
  }

  const Where where_;
  const RecordOptions& options_;
  Report report_;
  StatusLine line_;
  const Clock::time_point begin_ = Clock::now();
  bool has_said_what_is_missing_ = false;
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
