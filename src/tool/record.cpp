// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "lot/detail/core.hpp"
#include "lot/error.hpp"
#include "lot/recorder.hpp"
#include "lot/signals.hpp"

#include "tool/commands.hpp"
#include "tool/onlooker.hpp"
#include "tool/report.hpp"
#include "tool/sleep_until.hpp"
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

volatile std::sig_atomic_t trigger_was_asked = 0;
void ask_for_trigger(int) { trigger_was_asked = 1; }

void say(const std::string& text) { std::fprintf(stderr, "* %s\n", shown(text, 400).c_str()); }

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

class Record {
 public:
  Record(const Settings& settings, const RecordOptions& options)
      : where_(settings.where), options_(options), report_(settings) {}

  Exit run() {
    std::signal(SIGPIPE, SIG_IGN);
    const StopToken stop = stop_on_signals();
    if (options_.what.keep_last > Duration()) std::signal(SIGUSR1, ask_for_trigger);
    const Where where = where_;
    Recorder recorder(options_.what, [where] { return join_the_one(where); });
    if (options_.what.keep_last > Duration()) say_what_triggers();
    const Clock::time_point end = detail::after(options_.duration);
    while (sleep_until(std::min(end, Clock::now() + kLookAtRecorder), stop) && Clock::now() < end) {
      if (trigger_was_asked != 0) {
        trigger_was_asked = 0;
        recorder.trigger();
      }
      look(recorder.status());
    }
    try {
      recorder.stop();
    } catch (const Error& e) {
      report_.hint(printable(reason_of(e), 500));
      report_.ends(kWrong);
    }
    tell(recorder.status());
    return report_.finish();
  }

 private:
  void say_what_triggers() const {
    const std::string& topic = options_.what.trigger;
    say("keeps the last messages in memory: SIGUSR1" +
        (topic.empty() ? "" : ", or a message on " + topic + ",") + " writes them");
  }

  /// Says on standard error what is new.
  void look(const RecorderStatus& now) {
    if (now.topics.empty() && now.refused.empty() && !has_said_that_it_waits_) {
      say("no topic of these has a publisher yet: waiting (Ctrl-C ends)");
      has_said_that_it_waits_ = true;
    }
    for (const auto& refused : now.refused) {
      if (said_.insert(refused.name).second) say("left out: " + refused.why);
    }
    for (; files_ < now.files.size(); ++files_) say("writes " + now.files[files_]);
    if (now.error != error_ && Clock::now() >= say_again_) {
      error_ = now.error;
      say_again_ = Clock::now() + kSayErrorAgain;
      say(error_);
    }
  }

  void tell(const RecorderStatus& now) {
    Json& out = report_.document();
    out["command"] = "record";
    out["files"] = now.files;
    out["topics"] = Json::array();
    Table table({"TOPIC", "TYPE", "MESSAGES", "BYTES", "MISSED", "LOST"}, {0, 1});
    std::uint64_t messages = 0;
    std::uint64_t missed = 0;
    std::uint64_t lost = 0;
    for (const auto& topic : now.topics) {
      messages += topic.messages;
      missed += topic.missed;
      lost += topic.lost + topic.damaged;
      table.add({printable(topic.name, 200), printable(topic.type), std::to_string(topic.messages),
                 bytes_text(topic.bytes), std::to_string(topic.missed),
                 std::to_string(topic.lost + topic.damaged)});
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
    for (const std::string& file : now.files) report_.print(printable(file, 200) + "\n");
    if (!table.empty()) report_.print(table.text());
    for (const auto& topic : now.topics) {
      if (topic.messages != 0 || topic.in_segment == topic.name) continue;
      report_.hint(printable(topic.name, 200) +
                   " is a topic of ROS: its messages are in the segment while a node of LOT in "
                   "another process subscribes to it, and else on ROS's own links");
    }
    if (messages == 0) report_.hint("nothing was recorded");
    if (messages == 0 || lost != 0) report_.ends(kWrong);
    if (missed != 0) {
      report_.hint(plural(missed, "message was", "messages were") +
                   " overwritten before it looked: a deeper queue of the publisher "
                   "(PusherOptions::depth), or a larger --quota, helps");
    }
  }

  const Where where_;
  const RecordOptions& options_;
  Report report_;
  bool has_said_that_it_waits_ = false;
  std::set<std::string> said_;
  std::size_t files_ = 0;
  std::string error_;
  Clock::time_point say_again_{};
};

}  // namespace

Exit record(const Settings& settings, const RecordOptions& options) {
  return Record(settings, options).run();
}

}  // namespace lot::tool
