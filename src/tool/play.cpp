// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <sys/prctl.h>
#include <utility>
#include <vector>

#include "lot/detail/core.hpp"
#include "lot/engine.hpp"
#include "lot/error.hpp"
#include "lot/recording.hpp"
#include "lot/signals.hpp"

#include "record/pattern.hpp"
#include "record/types.hpp"
#include "tool/audience.hpp"
#include "tool/commands.hpp"
#include "tool/keys.hpp"
#include "tool/nearest.hpp"
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

/// So long topics are there before their first message where this process makes them: programs that
/// wait for a topic look for it ten times a second.
constexpr auto kForThoseThatWait = 500ms;
/// Between two looks for a key, and for a subscriber.
constexpr auto kLookForKeys = 20ms;
/// Further behind than this it does not publish faster to make up for it.
constexpr auto kMostBehindPlay = 1s;
/// A wait as long as this is told: else it looks as if the player stood still.
constexpr auto kLongWait = 10s;
/// In nanoseconds: what is due later than in 200 years is never due. A file may say any time.
constexpr double kNever = 7e18;

/// A file that is no recording.
struct NoRecording {
  Error why;
};

/// As the constructor of Recording; NoRecording for what is none.
Recording opened(const std::vector<std::string>& files) {
  try {
    return Recording(files);
  } catch (const Error& e) {
    if (e.error_number() != EINVAL) throw;
    throw NoRecording{e};
  }
}

class Play {
 public:
  Play(const Settings& settings, const PlayOptions& options)
      : where_(settings.where), options_(options), report_(settings) {}

  Exit run() {
    std::signal(SIGPIPE, SIG_IGN);
    if (options_.paused && !keys_.can_come()) {
      std::fprintf(stderr, "lot play: --paused needs a terminal, whose space bar goes on\n");
      return kUsage;
    }
    try {
      return play_all();
    } catch (const NoRecording& none) {
      return refuse(none.why, kDamaged);
    } catch (const Error& e) {
      return refuse(e, e.error_number() == EBADMSG ? kDamaged : kWrong);
    }
  }

 private:
  Exit play_all() {
    recording_.emplace(opened(options_.files));
    require_named();
    const auto participant = join();
    const StopToken stop = stop_on_signals();
    ShmEngine engine(participant);
    const bool is_new = open_topics(engine, *participant);
    if (outs_.empty()) {
      report_.hint("nothing of it can be published");
      report_.ends(kWrong);
    } else if (begin(is_new, stop)) {
      if (paused_at_) say_whether_paused();
      do {
        ++rounds_;
      } while (play_once(stop) && options_.loop);
      stay(*participant);
    }
    tell();
    return report_.finish();
  }

  Exit refuse(const Error& why, Exit exit) {
    fill_document();
    return report_.refuse(shown(why.what(), kLine), exit);
  }

  /// A topic that is published.
  struct Out {
    Out(const RecordedTopic& its_topic, std::string its_name, AnyPusher its_pusher)
        : topic(&its_topic), name(std::move(its_name)), pusher(std::move(its_pusher)) {}
    const RecordedTopic* topic;
    std::string name;
    AnyPusher pusher;
    std::uint64_t pushed = 0;
  };

  // ---- before ----

  /// The one segment there, or the named one. It is made where there is none.
  std::shared_ptr<transport::Participant> join() {
    std::string name = where_.name;
    if (name.empty()) {
      for (const Sight& s : sights(where_)) {
        if (s.window == nullptr) continue;
        if (!name.empty()) {
          throw Error(EINVAL, where_.directory, "there are the segments " + name + " and " + s.name,
                      "say which one you mean: --segment NAME");
        }
        name = s.name;
      }
    }
    EngineOptions made;
    segment_ = name.empty() ? made.segment : name;
    try {
      return visit(where_, segment_, "lot play");
    } catch (const Error& e) {
      if (e.error_number() != ENOENT) throw;
    }
    const std::string absent = where_.name.empty() ? "" : why_no_segment(where_);
    made.name = "lot play";
    // What the command says comes before what the environment said.
    setenv("LOT_SEGMENT", segment_.c_str(), 1);
    setenv("LOT_DIR", where_.directory.c_str(), 1);
    auto participant = transport::Participant::join(made);
    if (!absent.empty()) std::fprintf(stderr, "* %s: it is made\n", shown(absent, kLine).c_str());
    return participant;
  }

  /// A name that was mistyped would be published where its owner does not expect it, or though it
  /// was to be left out.
  void require_named() const {
    std::vector<std::string> there;
    for (const RecordedTopic& topic : recording_->topics()) there.push_back(topic.name);
    sort_out(there);
    const auto require = [&](const std::string& wanted, const char* option, bool is_there) {
      if (is_there) return;
      const std::string advice = advice_for(wanted, there);
      throw Error(0, wanted,
                  std::string("the recording has no such topic, and ") + option + " names it",
                  advice.empty() ? "it has no topic" : advice);
    };
    const auto fits = [&](const std::string& pattern) {
      return std::ranges::any_of(
          there, [&](const std::string& name) { return lot::record::matches(pattern, name); });
    };
    for (const auto& [name, its_new_name] : options_.renamed) {
      require(name, "--remap", std::ranges::count(there, name) != 0);
    }
    for (const std::string& pattern : options_.query.topics) {
      require(pattern, "--topic", fits(pattern));
    }
    for (const std::string& pattern : options_.except) require(pattern, "--except", fits(pattern));
  }

  /// True: a topic was not there before.
  bool open_topics(ShmEngine& engine, const transport::Participant& me) {
    bool is_new = false;
    for (const RecordedTopic& topic : recording_->topics()) {
      const auto& chosen = options_.query.topics;
      if (!chosen.empty() && !lot::record::matches_any(chosen, topic.name)) continue;
      if (lot::record::matches_any(options_.except, topic.name)) continue;
      const auto renamed = options_.renamed.find(topic.name);
      const std::string name = renamed == options_.renamed.end() ? topic.name : renamed->second;
      try {
        const AnyType there = engine.type_of(name);
        is_new = is_new || !there;
        if (there) tell_who_publishes(me, name);
        PusherOptions how;
        how.stamp = true;
        outs_.emplace_back(topic, name,
                           engine.advertise_any(name, type_on(topic, name, there), how));
      } catch (const Error& e) {
        left_out_.emplace_back(topic.name, reason_of(e));
        report_.hint(printable(topic.name, 200) +
                     " is left out: " + printable(reason_of(e), kLine));
        report_.ends(kWrong);
      }
    }
    return is_new;
  }

  /// Subscribers of a topic cannot tell messages of two publishers apart.
  void tell_who_publishes(const transport::Participant& me, const std::string& topic) {
    const std::set<std::string> names = publishers_of(where_, segment_, me.index(), topic);
    if (names.empty()) return;
    std::string list;
    for (const std::string& name : names) list += (list.empty() ? "" : ", ") + printable(name);
    const std::string text = printable(topic, 200) + ": " + list +
                             " publishes on it as well, and its subscribers get both: --remap "
                             "plays it under another name";
    std::fprintf(stderr, "* %s\n", text.c_str());
    report_.hint(text);
  }

  /// What a topic is to carry: the type that it has, if that has the same fields.
  AnyType type_on(const RecordedTopic& topic, const std::string& name, const AnyType& there) const {
    const AnyType recorded = recording_->type_of(topic);
    if (!there || there.is_same(recorded)) return recorded;
    if (lot::record::is_like(there, topic.schema)) return there;
    throw Error(EINVAL, name,
                "it carries " + there.name() + ", whose fields are not those of " + topic.type,
                "play it under another name: --remap " + topic.name + ":=/other");
  }

  /// Waits for those that are to hear it. False: it is to publish nothing.
  bool begin(bool is_new, const StopToken& stop) {
    const auto from = is_new ? Clock::now() + kForThoseThatWait : Clock::now();
    const auto until = detail::after(options_.wait);
    const auto has_reader = [](const Out& out) { return out.pusher.readers() != 0; };
    while (options_.wait > Duration() && std::ranges::none_of(outs_, has_reader)) {
      if (Clock::now() >= until) {
        report_.hint("no process subscribes to it: nothing was published");
        report_.ends(kWrong);
        return false;
      }
      if (!sleep_until(Clock::now() + kLookForKeys, stop)) return false;
    }
    return sleep_until(from, stop);
  }

  // ---- messages ----

  /// False: it was told to stop, or there is nothing to be published again.
  bool play_once(const StopToken& stop) {
    RecordingQuery query;
    for (const Out& out : outs_) query.topics.push_back(out.topic->name);
    if (options_.start > recording_->end() - recording_->begin()) return false;
    const RecordedTime first = recording_->begin() + options_.start;
    query.from = first;
    if (options_.end < recording_->end() - recording_->begin()) {
      query.until = recording_->begin() + options_.end;
    }
    RecordedMessages messages = recording_->messages(query);
    begin_ = Clock::now();
    if (paused_at_) paused_at_ = begin_;
    const std::uint64_t before = pushed_;
    prctl(PR_SET_TIMERSLACK, 1UL);  // else the kernel wakes a sleeper up to 50 us late
    while (const auto message = messages.next()) {
      Out* const out = out_of(message->topic());
      if (out == nullptr) continue;
      std::optional<AnyLoan> loan = built(*out, *message);
      if (!wait_until(message->log_time() - first, stop)) return false;
      if (!loan) continue;
      if (out->pusher.push(std::move(*loan), Duration::max(), stop) != Status::Ok) return false;
      ++out->pushed;
      ++pushed_;
    }
    return pushed_ != before && !stop.stop_requested();
  }

  Out* out_of(const RecordedTopic& topic) {
    const auto found =
        std::ranges::find_if(outs_, [&](const Out& out) { return out.topic == &topic; });
    return found == outs_.end() ? nullptr : &*found;
  }

  /// Nothing: it cannot be built, and that is noted.
  std::optional<AnyLoan> built(Out& out, const RecordedMessage& message) {
    try {
      AnyLoan loan = out.pusher.loan();
      message.copy_to(loan);
      return loan;
    } catch (const Error& e) {
      if (e.error_number() == ESTALE) throw;
      why_ = reason_of(e);
    } catch (const OutOfMemory& e) {
      why_ = e.what();
    }
    ++damaged_;
    return std::nullopt;
  }

  /// Waits until the message is due that was recorded so long behind the first one. False: it was
  /// told to stop.
  bool wait_until(std::chrono::nanoseconds behind_first, const StopToken& stop) {
    const double after = static_cast<double>(behind_first.count()) / options_.rate;
    for (bool is_told = false;;) {
      look_at_keys();
      const auto now = Clock::now();
      if (paused_at_) {
        if (!sleep_until(now + kLookForKeys, stop)) return false;
        continue;
      }
      const auto due = after > kNever ? Clock::time_point::max()
                                      : begin_ + std::chrono::nanoseconds(std::llround(after));
      if (now - due > kMostBehindPlay) {
        behind_ += now - due;
        begin_ += now - due;
      }
      if (now >= due) return !stop.stop_requested();
      if (due - now > kLongWait && !std::exchange(is_told, true)) {
        const std::string span = age_text(std::chrono::duration<double>(due - now).count());
        std::fprintf(stderr, "* the next message comes in %s\n", span.c_str());
      }
      const auto next = keys_.can_come() ? std::min(due, now + kLookForKeys) : due;
      if (!sleep_until(next, stop)) return false;
    }
  }

  void look_at_keys() {
    while (const auto key = keys_.next()) {
      if (*key != ' ') continue;
      if (paused_at_) {
        begin_ += Clock::now() - *paused_at_;
        paused_at_.reset();
      } else {
        paused_at_ = Clock::now();
      }
      say_whether_paused();
    }
  }
  void say_whether_paused() const {
    std::fprintf(stderr, "* %s\n", paused_at_ ? "paused: the space bar goes on" : "goes on");
  }

  /// Stays until all that look at the topics have read, but not for long.
  void stay(const transport::Participant& me) {
    std::set<std::string> names;
    for (const Out& out : outs_) names.insert(out.name);
    (void)linger(where_, segment_, me.index(), names);
  }

  // ---- behind ----

  void fill_document() {
    Json& out = report_.document();
    out["command"] = "play";
    out["segment"] = segment_.empty() ? Json(nullptr) : Json(segment_);
    out["topics"] = Json::array();
    for (const Out& one : outs_) {
      out["topics"].push_back({{"name", one.name},
                               {"recorded_as", one.topic->name},
                               {"type", one.pusher.type().name()},
                               {"pushed", one.pushed}});
    }
    out["left_out"] = Json::array();
    for (const auto& [name, why] : left_out_) {
      out["left_out"].push_back({{"name", name}, {"why", why}});
    }
    out["rounds"] = rounds_;
    out["not_built"] = damaged_;
  }

  void tell() {
    fill_document();
    Table table({"TOPIC", "RECORDED AS", "PUSHED"}, {0, 1});
    for (const Out& one : outs_) {
      table.add(
          {printable(one.name, 200), printable(one.topic->name, 200), std::to_string(one.pushed)});
    }
    if (!table.empty()) report_.print(table.text());
    if (damaged_ != 0) {
      report_.ends(kWrong);
      report_.hint(plural(damaged_, "message", "messages") +
                   " could not be built: " + printable(why_, kLine));
    }
    if (const RecordingDamage damage = recording_->damage(); !damage.first.empty()) {
      report_.ends(kDamaged);
      report_.hint(bytes_text(damage.bytes) +
                   " of the recording cannot be read: " + printable(damage.first, kLine));
    }
    if (behind_ > Clock::duration()) {
      report_.hint("it came " + age_text(std::chrono::duration<double>(behind_).count()) +
                   " behind its schedule: this machine does not publish at that rate");
    }
    if (pushed_ == 0) report_.ends(kWrong);
    const bool is_told = damaged_ != 0 || !recording_->damage().first.empty();
    if (pushed_ == 0 && rounds_ != 0 && !is_told) tell_why_nothing();
  }

  void tell_why_nothing() {
    const auto length = recording_->end() - recording_->begin();
    const auto seconds = [](std::chrono::nanoseconds span) {
      char text[64];
      std::snprintf(text, sizeof(text), "%.3f s", std::chrono::duration<double>(span).count());
      return std::string(text);
    };
    const auto has_any = [](const RecordedTopic& topic) { return topic.messages != 0; };
    if (std::ranges::none_of(recording_->topics(), has_any)) {
      report_.hint("the recording has no message");
    } else if (options_.end < options_.start) {
      report_.hint("--end lies before --start: nothing is between them");
    } else if (options_.start > length) {
      report_.hint("--start lies behind the last message: the recording is " + seconds(length) +
                   " long");
    } else {
      report_.hint(
          "no message was published: the chosen topics have none there, or it was stopped "
          "before the first one");
    }
  }

  const Where where_;
  const PlayOptions& options_;
  std::optional<Recording> recording_;
  Report report_;
  std::string segment_;
  std::deque<Out> outs_;
  std::vector<std::pair<std::string, std::string>> left_out_;
  Keys keys_;
  Clock::time_point begin_;  ///< when the first message was due, later by all pauses
  std::optional<Clock::time_point> paused_at_ =
      options_.paused ? std::optional(Clock::now()) : std::nullopt;
  Clock::duration behind_{};
  std::uint64_t pushed_ = 0;
  std::uint64_t rounds_ = 0;
  std::uint64_t damaged_ = 0;
  std::string why_;  ///< of the last one that could not be built
};

}  // namespace

Exit play(const Settings& settings, const PlayOptions& options) {
  return Play(settings, options).run();
}

}  // namespace lot::tool
