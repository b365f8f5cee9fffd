// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <map>
#include <new>
#include <string>
#include <string_view>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

#include "lot/detail/core.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"
#include "lot/signals.hpp"

#include "gateway/keeper.hpp"
#include "gateway/names.hpp"
#include "gateway/ros_types.hpp"
#include "gateway/settings.hpp"
#include "gateway/settings_file.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::gateway;

constexpr const char* kFooter =
    "Signals:\n"
    "  SIGINT, SIGTERM  ends, and says what was carried\n"
    "  SIGHUP           reads the file again: its topics count from then on\n"
    "  SIGUSR1          says what was carried until now\n"
    "\n"
    "CYCLONEDDS_URI: further settings of CycloneDDS, which come before all others.";

volatile std::sig_atomic_t change_was_asked = 0;
volatile std::sig_atomic_t report_was_asked = 0;
void ask_for_change(int) { change_was_asked = 1; }
void ask_for_report(int) { report_was_asked = 1; }

struct Arguments {
  std::vector<std::string> out;
  std::vector<std::string> in;
  std::string file;
  std::string segment;
  std::string state;
  int domain = -1;
  std::string interface;
};

/// NAME or NAME:TYPE.
RouteSettings incoming_row(const std::string& word) {
  RouteSettings row;
  const std::size_t colon = word.find(':');
  row.topics = word.substr(0, colon);
  if (colon != word.npos) row.type = word.substr(colon + 1);
  return row;
}

/// What is wrong with a word of --out; empty: nothing is.
std::string wrong_name(const std::string& word) { return word.empty() ? "an empty name" : ""; }

/// What is wrong with a word of --in; empty: nothing is.
std::string wrong_with(const std::string& word) {
  const RouteSettings row = incoming_row(word);
  if (row.topics.empty()) return wrong_name(row.topics);
  const bool is_right = row.type.empty() ? row.topics == word : is_ros_type(dds_type_of(row.type));
  return is_right ? "" : "the gateway knows no fields of a type \"" + row.type + '"';
}

/// What the command line and the file say together: the command line comes first.
Settings settings_of(const Arguments& arguments) {
  Settings settings;
  for (const std::string& topics : arguments.out) {
    RouteSettings row;
    row.topics = topics;
    settings.out.push_back(std::move(row));
  }
  for (const std::string& word : arguments.in) settings.in.push_back(incoming_row(word));
  if (!arguments.file.empty()) read_settings(arguments.file, settings);
  if (arguments.domain >= 0) settings.domain.id = static_cast<std::uint32_t>(arguments.domain);
  if (!arguments.interface.empty()) settings.domain.interface = arguments.interface;
  settings.state = arguments.state;
  return settings;
}

void say(std::string_view text) {
  constexpr std::string_view kLibrary = "lot: ";  // what errors of the library begin with
  if (text.starts_with(kLibrary)) text.remove_prefix(kLibrary.size());
  std::fprintf(stderr, "lot_gateway: %.*s\n", static_cast<int>(text.size()), text.data());
}

/// Says on standard error what is new in a report.
class News {
 public:
  void tell(const Report& now) {
    if (now.segment != segment_ && !now.segment.empty()) say("in the segment " + now.segment);
    segment_ = now.segment;
    for (const Report::Route& route : now.routes) {
      const std::string name = (route.is_out ? "out " : "in ") + route.topic;
      bool& was_there = there_[name];
      if (route.is_there != was_there) {
        say(name + (route.is_there ? (route.is_out ? " -> " : " <- ") + route.dds_topic
                                   : std::string(": ended")));
      }
      was_there = route.is_there;
      tell_error(name, route.counts.error);
    }
    for (const auto& [topic, why] : now.refused) tell_error(topic, why);
    tell_error("", now.error);
  }

 private:
  void tell_error(const std::string& about, const std::string& what) {
    std::string& last = errors_[about];
    if (what != last && !what.empty()) say(what);
    last = what;
  }

  std::string segment_;
  std::map<std::string, bool> there_;
  std::map<std::string, std::string> errors_;
};

/// False: standard output has not taken it, and standard error says so.
bool print(const Report& report) {
  std::printf("%-4s %10s %14s %8s %8s %8s %8s %8s %8s %8s  %s\n", "", "carried", "bytes", "missed",
              "before", "lost", "refused", "damaged", "looped", "unheard", "topic");
  for (const Report::Route& route : report.routes) {
    const Counts& c = route.counts;
    std::printf("%-4s %10lu %14lu %8lu %8lu %8lu %8lu %8lu %8lu %8lu  %s\n",
                route.is_out ? "out" : "in", c.carried, c.bytes, c.missed, c.before, c.lost,
                c.refused, c.damaged, c.looped, c.unheard, route.topic.c_str());
  }
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return true;
  say(std::string("standard output: ") + std::strerror(errno));
  return false;
}

bool is_empty(const Settings& settings) { return settings.out.empty() && settings.in.empty(); }

/// Says what a file that was read again has, and has in vain.
void tell_change(const Settings& first, const Settings& now) {
  say("the file was read again: " + std::to_string(now.out.size()) + " rows out, " +
      std::to_string(now.in.size()) + " in");
  const bool is_other = now.domain != first.domain || now.most_incoming != first.most_incoming ||
                        now.node != first.node || now.gid_bytes != first.gid_bytes;
  if (is_other) say("domain, interface, sizes, node and ros count from the next start");
}

/// CycloneDDS ends its thread that receives by a packet to its own address. The packet does not
/// come where the interface is down: then the process ends without that. It has left the segment
/// before.
void end_in_any_case() {
  constexpr unsigned kPatience = 3;
  std::signal(SIGALRM, [](int) { _exit(0); });
  alarm(kPatience);
}

int work(const Arguments& arguments) {
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGHUP, ask_for_change);
  std::signal(SIGUSR1, ask_for_report);
  const lot::StopToken stop = lot::stop_on_signals();
  lot::EngineOptions where;
  where.name = kProcessName;
  const Settings first = settings_of(arguments);
  if (is_empty(first)) {
    say("which topics? --out TOPICS, --in TOPICS, or --config FILE that names some");
    return 2;
  }
  News news;
  Keeper keeper(first, [where] { return lot::detail::join(where); });
  while (!stop.stop_requested()) {
    if (change_was_asked != 0) {
      change_was_asked = 0;
      try {
        const Settings changed = settings_of(arguments);
        keeper.change(changed.out, changed.in);
        tell_change(first, changed);
      } catch (const lot::Error& e) {
        say(e.what());  // the earlier ones stay
      }
    }
    keeper.step();
    const Report report = keeper.told();
    news.tell(report);
    if (report_was_asked != 0) {
      report_was_asked = 0;
      (void)print(report);
    }
  }
  const bool is_printed = print(keeper.end());
  end_in_any_case();
  return is_printed ? 0 : 1;
}

int run(int argc, char** argv) {
  CLI::App app{"Carries topics between a LOT segment and a DDS domain, as ROS 2 names them",
               "lot_gateway"};
  Arguments arguments;
  app.add_option("--out", arguments.out, "topics of the segment that go out: a name or a pattern")
      ->type_name("TOPICS")
      ->check(CLI::Validator(wrong_name, ""));
  app.add_option("--in", arguments.in,
                 "topics of the domain that come in; TOPICS:TYPE where nothing else says the type")
      ->type_name("TOPICS[:TYPE]")
      ->check(CLI::Validator(wrong_with, ""));
  app.add_option("--config", arguments.file, "a file of YAML, with topics and more")
      ->type_name("FILE")
      ->check(CLI::Validator(CLI::ExistingFile).description(""));
  app.add_option("--domain", arguments.domain, "the DDS domain, 0 to 232; 0, if it is not said")
      ->check(CLI::Validator(CLI::Range(0, 232)).description(""))
      ->type_name("NUMBER");
  app.add_option("--interface", arguments.interface, "a network interface: its name, or address")
      ->type_name("NAME");
  app.add_option("--state", arguments.state,
                 "a file by which a gateway that is started again counts what was lost meanwhile")
      ->type_name("FILE");
  app.add_option("-s,--segment", arguments.segment, "the segment (LOT_SEGMENT)")->type_name("NAME");
  app.set_version_flag("--version", "lot_gateway " LOT_VERSION);
  app.footer(kFooter);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }
  if (!arguments.segment.empty()) setenv("LOT_SEGMENT", arguments.segment.c_str(), 1);
  return work(arguments);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& e) {
    say(e.what());
    return 1;
  }
}
