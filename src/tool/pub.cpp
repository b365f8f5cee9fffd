// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <optional>
#include <string>
#include <sys/prctl.h>
#include <utility>
#include <vector>

#include <yaml-cpp/yaml.h>

#include "lot/detail/core.hpp"
#include "lot/engine.hpp"
#include "lot/error.hpp"
#include "lot/signals.hpp"

#include "tool/audience.hpp"
#include "tool/documents.hpp"
#include "tool/onlooker.hpp"
#include "tool/report.hpp"
#include "tool/sleep_until.hpp"
#include "tool/text.hpp"
#include "tool/values.hpp"
#include "transport/participant.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// So long a topic is there before its first message where this process makes it: programs that
/// wait for a topic look for it ten times a second.
constexpr std::chrono::milliseconds kForOnlookers = 500ms;
/// So long it waits for memory that subscribers have yet to read.
constexpr std::chrono::seconds kForMemory = 5s;
/// Further behind its schedule than this it does not send faster to make up for it.
constexpr std::chrono::seconds kMostBehind = 1s;

/// When each message is due: at equal distances, whenever the ones before were sent.
class Schedule {
 public:
  explicit Schedule(double hertz) : hertz_(hertz) {}

  Clock::time_point next() {
    const auto now = Clock::now();
    auto due =
        begin_ + std::chrono::nanoseconds(std::llround(static_cast<double>(n_++) * 1e9 / hertz_));
    if (now - due > kMostBehind) {
      behind_ += now - due;
      begin_ += now - due;
      due = now;
    }
    return due;
  }
  /// How much later it is than it was to be, in all.
  std::chrono::nanoseconds behind() const { return behind_; }

 private:
  double hertz_;
  Clock::time_point begin_ = Clock::now();
  std::uint64_t n_ = 0;
  std::chrono::nanoseconds behind_{};
};

class Publication {
 public:
  Publication(const Settings& settings, const PubOptions& options)
      : where_(settings.where),
        search_(settings.where),
        options_(options),
        documents_(options.yaml),
        report_(settings) {}

  Exit run() {
    std::signal(SIGPIPE, SIG_IGN);  // so that it leaves the segment as at any other end
    const StopToken stop = stop_on_signals();
    try {
      return publish(stop);
    } catch (const Error& e) {
      return refuse(reason_of(e), e.error_number() == EBADMSG ? kDamaged : kWrong);
    } catch (const OutOfMemory& e) {
      const std::string_view text = e.what();
      constexpr std::string_view kBegin = "lot: ";
      return refuse(std::string(text.substr(text.starts_with(kBegin) ? kBegin.size() : 0)), kWrong);
    }
  }

 private:
  /// A message, and where it stands in the YAML.
  struct Document {
    YAML::Node node;
    std::string at;  ///< empty: it is the first of the command line
  };

  Exit publish(const StopToken& stop) {
    read_first(stop);
    if (stop.stop_requested()) return kWrong;
    deadline_ = detail::after(options_.wait);
    std::optional<std::string> segment;
    while (!(segment = find_segment())) {
      if (Clock::now() >= deadline_) throw_unknown();
      if (!sleep_until(std::min(deadline_, Clock::now() + 100ms), stop)) return kWrong;
    }
    const auto participant = visit(where_, *segment, "lot pub");
    ShmEngine engine(participant);
    PusherOptions how;
    how.stamp = true;
    if (!options_.hertz) {  // nothing but the readers says how fast the messages go
      how.policy = Policy::Block;
      how.block_for = kForMemory;
    }
    const bool is_new = !engine.type_of(options_.topic);
    const AnyType type = type_on(engine);
    if (type.description().root().kind == Kind::Opaque) {
      throw Error(EINVAL, options_.topic, kOpaque, "nothing was published");
    }
    AnyPusher pusher = engine.advertise_any(options_.topic, type, how);
    const auto begin = is_new ? Clock::now() + kForOnlookers : Clock::now();
    segment_ = *segment;
    type_ = type.name();
    for (const Document& message : messages_) build(pusher, message);  // to say what is wrong now
    if (options_.wait > 0s && !pusher.wait_for_readers(1, deadline_ - Clock::now(), stop)) {
      if (stop.stop_requested()) return kWrong;
      throw Error(0, options_.topic, "no process subscribes to it", "nothing was published");
    }
    if (!sleep_until(begin, stop)) return kWrong;
    try {
      push(pusher, stop);
    } catch (...) {  // what came before is to be read all the same
      stay(*segment, *participant);
      subscribers_ = pusher.readers();
      throw;
    }
    stay(*segment, *participant);
    subscribers_ = pusher.readers();
    tell();
    const Exit exit = report_.finish();
    std::fflush(stdout);
    if (options_.latch) sleep_until(Clock::time_point::max(), stop);
    return exit;
  }

  /// Says what is wrong: with which document, and how many messages it has pushed before.
  Exit refuse(const std::string& reason, Exit exit) {
    std::string text = (at_.empty() ? "" : at_ + ": ") + reason;
    if (comes_in()) {
      text += "; " + plural(pushed_, "message was", "messages were") + " pushed";
    }
    fill_document();
    return report_.refuse(shown("lot: " + text, kLine), exit);
  }

  /// Whether the documents come from standard input.
  bool comes_in() const { return options_.yaml == "-"; }

  /// The next message of the YAML. False: there is none, or it was told to stop.
  bool read_next(const StopToken& stop) {
    const auto name = [&](std::size_t n) {
      return comes_in() || n > 1 ? "document " + std::to_string(n) : std::string();
    };
    at_ = name(documents_.count() + 1);
    auto node = documents_.next(stop);
    at_.clear();
    if (!node) return false;
    std::string at = name(documents_.count());
    if (!at.empty()) at += ", from line " + std::to_string(documents_.line()) + " on";
    messages_.push_back({*node, std::move(at)});
    return true;
  }

  /// Reads all messages; of those that come by and by (standard input, once each) the first.
  void read_first(const StopToken& stop) {
    const bool come_later = comes_in() && !options_.hertz;
    while ((messages_.empty() || !come_later) && read_next(stop)) {
    }
    if (messages_.empty() && !stop.stop_requested()) {
      throw Error(EINVAL, "the YAML", "there is no message in it", "{} is a message of zeros");
    }
  }

  /// The segment that has the topic, or the one that it is like.
  std::optional<std::string> find_segment() {
    auto found = search_.segment_with(options_.topic);
    if (!found && !options_.like.empty()) found = search_.segment_with(options_.like);
    return found;
  }
  [[noreturn]] void throw_unknown() const {
    if (options_.like.empty()) {
      const std::string other = search_.other_name(options_.topic);
      throw Error(ENOENT, options_.topic,
                  "no process uses this topic, so its type is not known" +
                      (other.empty() ? "" : "; " + other),
                  "start one that does, wait for it (--wait SECONDS), or name a topic of the same "
                  "type (--like TOPIC); `lot ls` lists them");
    }
    throw Error(ENOENT, options_.like, "no process uses this topic either",
                "`lot ls` lists those that are used");
  }

  AnyType type_on(ShmEngine& engine) const {
    AnyType type = engine.type_of(options_.topic);
    if (!type && !options_.like.empty()) type = engine.type_of(options_.like);
    if (!type) throw_unknown();
    return type;
  }

  AnyLoan build(AnyPusher& pusher, const Document& message) {
    AnyLoan loan = pusher.loan();
    at_ = message.at;
    fill(loan.root(), message.node);
    at_.clear();
    return loan;
  }

  void push(AnyPusher& pusher, const StopToken& stop) {
    if (options_.hertz) return push_at_rate(pusher, *options_.hertz, stop);
    while (!messages_.empty()) {
      for (const Document& message : messages_) {
        if (pusher.push(build(pusher, message), Duration::max(), stop) != Status::Ok) return;
        ++pushed_;
      }
      messages_.clear();
      read_next(stop);
    }
  }
  void push_at_rate(AnyPusher& pusher, double hertz, const StopToken& stop) {
    constexpr std::uint64_t kForEver = ~std::uint64_t{0};
    prctl(PR_SET_TIMERSLACK, 1UL);  // else the kernel wakes a sleeper up to 50 us late
    Schedule schedule(hertz);
    for (; pushed_ < options_.count.value_or(kForEver); ++pushed_) {
      AnyLoan message = build(pusher, messages_[pushed_ % messages_.size()]);
      if (!sleep_until(schedule.next(), stop)) break;
      if (pusher.push(std::move(message), Duration::max(), stop) != Status::Ok) break;
    }
    if (const auto behind = schedule.behind(); behind > 0s) {
      report_.hint("it came " + age_text(std::chrono::duration<double>(behind).count()) +
                   " behind its schedule: this machine does not send at that rate");
    }
  }

  /// Stays until all that look at the topic have read, but not for long.
  void stay(const std::string& segment, const transport::Participant& me) {
    audience_ = linger(where_, segment, me.index(), {options_.topic});
  }

  void fill_document() {
    Json& out = report_.document();
    out["command"] = "pub";
    out["segment"] = or_null(segment_);
    out["topic"] = options_.topic;
    out["type"] = or_null(type_);
    out["pushed"] = pushed_;
    out["subscribers"] = subscribers_;
    out["observers"] = audience_.observers;
    out["unread"] = audience_.unread;
  }

  void tell() {
    fill_document();
    report_.print("pushed " + plural(pushed_, "message", "messages") + " on " +
                  printable(options_.topic, 200) + " (" + printable(type_.value_or("")) + ") to " +
                  plural(subscribers_, "subscriber", "subscribers") +
                  (audience_.observers == 0
                       ? ""
                       : " and " + plural(audience_.observers, "observer", "observers")) +
                  "\n");
    if (pushed_ == 0) report_.ends(kWrong);
    if (audience_.unread != 0) {
      report_.hint(plural(audience_.unread, "process has", "processes have") +
                   " not read all of it yet: subscribers get it when they look");
    } else if (subscribers_ + audience_.observers == 0 && !options_.latch) {
      report_.hint(
          "no process subscribes to it: --wait SECONDS waits for one, and --latch stays "
          "for those that come later");
    }
  }

  const Where where_;
  Search search_;
  const PubOptions& options_;
  Documents documents_;
  std::vector<Document> messages_;  ///< that are published next; at a rate, again and again
  std::string at_;                  ///< of the document that is read now, or built
  std::optional<std::string> segment_;
  std::optional<std::string> type_;
  Report report_;
  Clock::time_point deadline_;  ///< for the topic and a subscriber
  std::uint64_t pushed_ = 0;
  std::size_t subscribers_ = 0;
  Audience audience_;
};

}  // namespace

Exit pub(const Settings& settings, const PubOptions& options) {
  return Publication(settings, options).run();
}

}  // namespace lot::tool
