// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

#include "lot/detail/core.hpp"
#include "lot/error.hpp"
#include "lot/signals.hpp"

#include "tool/commands.hpp"
#include "tool/field_path.hpp"
#include "tool/onlooker.hpp"
#include "tool/output.hpp"
#include "tool/text.hpp"
#include "tool/values.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// Between two looks whether a process still reads what is printed.
constexpr std::chrono::milliseconds kLookAtOutput = 500ms;
/// Between two lines about messages that could not be printed.
constexpr std::chrono::seconds kSayAgain = 10s;
/// For what is there already, where messages that can not be printed come first.
constexpr std::chrono::milliseconds kForTheOthers = 500ms;

std::string seconds_text(std::chrono::nanoseconds time) {
  char text[64];
  std::snprintf(text, sizeof(text), "%.9f", std::chrono::duration<double>(time).count());
  return text;
}

class Echo {
 public:
  Echo(const Settings& settings, const EchoOptions& options)
      : json_(settings.json),
        options_(options),
        onlooker_(settings.where, options.topic, "lot echo", options.history) {}

  Exit run() {
    std::signal(SIGPIPE, SIG_IGN);  // so that it leaves the segment as at any other end
    const StopToken stop = stop_on_signals();
    auto deadline = detail::after(options_.timeout);
    while (printed_ < options_.count) {
      AnyBorrow message = next(std::min(deadline, Clock::now() + kLookAtOutput), stop);
      const std::uint64_t before = printed_;
      if (message && !tell(message, stop)) break;
      if (printed_ != before) {
        deadline = detail::after(options_.timeout);
        continue;
      }
      if (message) ++left_out_;
      if (stop.stop_requested() || output_is_gone()) break;
      const auto now = Clock::now();
      if (now - (message ? kForTheOthers : 0ms) >= deadline) {
        onlooker_.say(left_out_ == 0 ? "no message came in time"
                                     : "no message that can be printed came in time");
        break;
      }
      if (now >= say_again_) say_left_out();
    }
    say_left_out();
    const bool are_too_few = options_.count != EchoOptions::kNoLimit && printed_ < options_.count;
    return graver(printed_ == 0 || are_too_few ? kWrong : kWell, complaints_.exit());
  }

 private:
  AnyBorrow next(Clock::time_point until, const StopToken& stop) {
    try {
      return onlooker_.next(until, stop);
    } catch (const Error& e) {
      if (!onlooker_.has_topic()) throw;
      complaints_.note(e);  // of one message, or of one publisher
      ++left_out_;
      return {};
    }
  }

  /// How many messages it has not printed since it has said so last.
  void say_left_out() {
    if (left_out_ != said_) {
      onlooker_.say(plural(left_out_, "message", "messages") + " could not be printed so far");
    }
    said_ = left_out_;
    say_again_ = Clock::now() + kSayAgain;
  }

  /// Prints a message, if it can be printed. False: nothing more can be printed.
  bool tell(AnyBorrow& message, const StopToken& stop) {
    const auto now = Clock::now();
    if (const std::uint64_t n = message.missed(); n != 0) {
      onlooker_.say(plural(n, "message", "messages") + " missed");
    }
    if (!has_field(message.type())) return true;
    std::string text;
    std::optional<Error> unset;  // a bool that is neither true nor false
    try {
      const auto whole = json_ ? document<JsonWriter>(message, now, stop, unset)
                               : document<YamlWriter>(message, now, stop, unset);
      if (!whole) return false;
      text = json_ ? *whole + "\n" : (printed_ == 0 ? "" : "---\n") + *whole;
    } catch (const Error& e) {
      complaints_.note(e);
      return true;
    }
    // Output may be slow, and a borrow keeps the message's memory from its publisher.
    message.end();
    unset ? complaints_.note(*unset) : complaints_.forget();
    if (!write_out(text, stop)) return false;
    ++printed_;
    return true;
  }

  /// Whether messages of the type can have the field. Throws lot::Error where the first type can
  /// not, and for a description that is damaged.
  bool has_field(const AnyType& type) {
    if (times_ == onlooker_.times()) return has_field_;
    const bool is_first = std::exchange(times_, onlooker_.times()) == 0;
    has_field_ = true;
    if (type.description().root().kind == Kind::Opaque) onlooker_.say(kOpaque);
    try {
      (void)type_at(type.description(), options_.field);
    } catch (const Error& e) {
      if (is_first || e.error_number() != EINVAL) throw;
      onlooker_.say(reason_of(e));
      has_field_ = false;
    }
    return has_field_;
  }

  /// Nothing: it was told to stop meanwhile.
  template <class Writer>
  std::optional<std::string> document(const AnyBorrow& message, Clock::time_point now,
                                      const StopToken& stop, std::optional<Error>& unset) const {
    const Value value = message.root().at(options_.field);
    Writer out;
    if (!options_.envelope) {
      if (!write(out, value, options_.limits, stop, &unset)) return std::nullopt;
      return out.take();
    }
    const Envelope envelope = message.envelope();
    out.begin_map();
    if constexpr (std::is_same_v<Writer, JsonWriter>) {
      out.key("command");
      out.text("echo");
      out.key("topic");
      out.text(options_.topic);
    }
    out.key("sequence");
    out.number(std::to_string(envelope.sequence));
    out.key("missed");
    out.number(std::to_string(envelope.missed));
    out.key("publisher");
    out.text(envelope.publisher);
    out.key("publisher_id");
    char id[17];  // a name, since many JSON readers keep numbers only up to 2^53
    std::snprintf(id, sizeof(id), "%016llx",
                  static_cast<unsigned long long>(envelope.publisher_id));
    out.text(id);
    write_time(out, "pushed_seconds", envelope.pushed, Clock::time_point());
    write_time(out, "age_seconds", envelope.pushed ? std::optional(now) : std::nullopt,
               envelope.pushed.value_or(now));
    out.key("message");
    if (!write(out, value, options_.limits, stop, &unset)) return std::nullopt;
    out.end_map();
    return out.take();
  }

  template <class Writer>
  static void write_time(Writer& out, const char* name,
                         const std::optional<Clock::time_point>& time, Clock::time_point since) {
    out.key(name);
    time ? out.number(seconds_text(*time - since)) : out.null();
  }

  const bool json_;
  const EchoOptions& options_;
  Onlooker onlooker_;
  std::uint64_t printed_ = 0;
  std::uint64_t left_out_ = 0;
  std::uint64_t said_ = 0;  ///< of those left out
  Clock::time_point say_again_ = Clock::now() + kSayAgain;
  unsigned times_ = 0;
  bool has_field_ = true;
  Complaints complaints_{onlooker_};
};

}  // namespace

Exit echo(const Settings& settings, const EchoOptions& options) {
  return Echo(settings, options).run();
}

}  // namespace lot::tool
