// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <iostream>
#include <new>
#include <optional>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

#include <CLI/CLI.hpp>

#include "lot/error.hpp"
#include "lot/options.hpp"
#include "lot/stop_token.hpp"

#include "segment/layout.hpp"
#include "segment/segment.hpp"
#include "tool/commands.hpp"
#include "tool/onlooker.hpp"
#include "tool/output.hpp"
#include "tool/writers.hpp"
#include "transport/environment.hpp"

namespace {

constexpr const char* kFooter =
    "Exit status:\n"
    "  0  all is well\n"
    "  1  nothing was found, or something is wrong: the last lines say what to do\n"
    "  2  wrong usage\n"
    "  3  a segment is damaged, cut short, or of another version\n"
    "\n"
    "`ls`, `top`, `who` and `doctor` only read. `echo`, `hz`, `bw` and `delay` look on: no\n"
    "publisher waits for them. lot-ls(1) and lot-who(1) say what the words mean.";

using namespace lot::tool;

/// Of an error.
constexpr std::size_t kLine = 2000;
/// All of a message, but a tree of references without end.
constexpr lot::TextLimits kInFull{~std::uint64_t{0}, ~std::uint64_t{0}, std::uint64_t{1} << 26};

struct Arguments {
  Settings settings;
  bool all = false;
  bool once = false;
  unsigned interval_ms = 1000;
  CleanOptions cleaning;
  EchoOptions echo;
  bool in_full = false;
  std::optional<double> timeout;
  PubOptions pub;
  double wait = 0;
  GaugeOptions gauge;
  double window_seconds = 5;
  double duration_seconds = 0;
};

/// What is wrong with the name of a segment; nothing: a segment can have it.
std::string objection_to(const std::string& name) {
  try {
    (void)lot::segment::path_of("", name);
    return "";
  } catch (const lot::Error& e) {
    return shown(reason_of(e), kLine);
  }
}

/// The options of all verbs, also before the verb.
void add_common(CLI::App& app, Settings& settings) {
  app.set_help_flag("-h,--help", "says what there is, and ends");
  app.add_option("-s,--segment", settings.where.name, "only this segment (LOT_SEGMENT)")
      ->check(objection_to)
      ->type_name("NAME");
  app.add_option("-d,--dir", settings.where.directory, "where segments lie (LOT_DIR)")
      ->type_name("DIR")
      ->capture_default_str();
  app.add_flag("--json", settings.json, "writes a document for programs");
}

CLI::App* add_verb(CLI::App& app, const char* name, const char* does, Arguments& arguments) {
  CLI::App* const verb = app.add_subcommand(name, does);
  add_common(*verb, arguments.settings);
  return verb;
}

/// Of a number, which `nan` is none of.
auto between(double least, double most) {
  return [=](const std::string& text) -> std::string {
    double number = 0;
    if (CLI::detail::lexical_cast(text, number) && number >= least && number <= most) return "";
    return text + " is no number from " + CLI::detail::to_string(least) + " to " +
           CLI::detail::to_string(most);
  };
}

/// Of a whole number.
auto at_least(std::uint64_t least) {
  return [=](const std::string& text) -> std::string {
    std::uint64_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error == std::errc() && end == text.data() + text.size() && number >= least) return "";
    return text + " is no whole number from " + std::to_string(least) + " on";
  };
}

/// A topic's name, as the registry takes it.
void add_topic(CLI::App& verb, const char* name, std::string& topic, const char* is) {
  verb.add_option(name, topic, is)
      ->type_name(name[0] == '-' ? "TOPIC" : "")
      ->check([](const std::string& text) {
        const bool fits = !text.empty() && text.size() < lot::segment::kTopicNameBytes;
        return fits ? std::string() : "a topic has a name of 1 to 199 bytes";
      });
}

void add_echo(CLI::App& app, Arguments& arguments) {
  auto* const echo = add_verb(
      app, "echo", "Prints the messages of a topic as they come, as YAML or JSON", arguments);
  EchoOptions& options = arguments.echo;
  add_topic(*echo, "TOPIC", options.topic, "whose messages are printed");
  echo->get_option("TOPIC")->required();
  echo->add_option("--field", options.field, "prints this part alone, such as labels[2].name")
      ->type_name("PATH");
  auto* const full = echo->add_flag("--full", arguments.in_full, "shortens nothing");
  echo->add_option("--elements", options.limits.elements, "so many of a list are printed")
      ->excludes(full)
      ->check(at_least(0))
      ->type_name("NUMBER")
      ->capture_default_str();
  echo->add_option("--characters", options.limits.characters, "so many of a text are printed")
      ->excludes(full)
      ->check(at_least(0))
      ->type_name("NUMBER")
      ->capture_default_str();
  echo->add_flag("--envelope", options.envelope, "prints where each message comes from as well");
  echo->add_option("--history", options.history,
                   "begins with so many messages of each publisher that are there already")
      ->check(at_least(0))
      ->type_name("NUMBER")
      ->capture_default_str();
  echo->add_option("--count", options.count, "ends after so many")
      ->check(at_least(1))
      ->type_name("NUMBER");
  echo->add_option("--timeout", arguments.timeout,
                   "ends when it has printed no message for so long")
      ->check(between(0, 1e9))
      ->type_name("SECONDS");
}

void add_pub(CLI::App& app, Arguments& arguments) {
  auto* const pub =
      add_verb(app, "pub", "Publishes messages on a topic, which YAML describes", arguments);
  PubOptions& options = arguments.pub;
  add_topic(*pub, "TOPIC", options.topic, "where they are published");
  pub->get_option("TOPIC")->required();
  pub->add_option("YAML", options.yaml,
                  "the message: '{x: 1, name: left}'; several behind `---`; -: standard input")
      ->required()
      ->type_name("");
  auto* const rate = pub->add_option("--rate", options.hertz, "again and again, so many a second")
                         ->check(between(1e-6, 1e7))
                         ->type_name("HERTZ");
  pub->add_option("--count", options.count, "ends after so many")
      ->needs(rate)
      ->check(at_least(1))
      ->type_name("NUMBER");
  add_topic(*pub, "--like", options.like, "has the type, where no process uses the topic yet");
  pub->add_option("--wait", arguments.wait, "waits so long for a subscriber, and for the topic")
      ->check(between(0, 1e9))
      ->type_name("SECONDS");
  pub->add_flag("--latch", options.latch, "stays until Ctrl-C, for subscribers that come later")
      ->excludes(rate);
}

/// What the verbs have in common that look at each message of a topic.
void add_gauge_options(CLI::App& verb, Arguments& arguments) {
  add_topic(verb, "TOPIC", arguments.gauge.topic, "whose messages are measured");
  verb.get_option("TOPIC")->required();
  verb.add_option("--interval", arguments.interval_ms, "how often it writes a line")
      ->check(CLI::Range(1, 600000))
      ->type_name("MILLISECONDS")
      ->capture_default_str();
  verb.add_option("--window", arguments.window_seconds, "the time that a line is about")
      ->check(between(0.001, 86400))
      ->type_name("SECONDS")
      ->capture_default_str();
  verb.add_option("--count", arguments.gauge.count, "ends after so many messages")
      ->check(at_least(1))
      ->type_name("MESSAGES");
  verb.add_option("--duration", arguments.duration_seconds, "ends after so long")
      ->check(between(0.001, 1e9))
      ->type_name("SECONDS");
}

void add_gauges(CLI::App& app, Arguments& arguments) {
  auto* const hz =
      add_verb(app, "hz", "How often messages come on a topic, and how evenly", arguments);
  add_gauge_options(*hz, arguments);
  hz->add_flag("--all", arguments.gauge.each, "each publisher by itself, too");
  auto* const bw = add_verb(
      app, "bw", "How many bytes come on a topic, and how large its messages are", arguments);
  add_gauge_options(*bw, arguments);
  auto* const delay =
      add_verb(app, "delay", "How long the messages of a topic have been under way", arguments);
  add_gauge_options(*delay, arguments);
  delay->add_option("--field", arguments.gauge.field, "since a time in the message: header.stamp")
      ->type_name("PATH");
}

GaugeOptions gauge_options(const Arguments& arguments) {
  const auto nanoseconds = [](double seconds) {
    return std::chrono::nanoseconds(static_cast<std::int64_t>(seconds * 1e9));
  };
  GaugeOptions options = arguments.gauge;
  options.interval = std::chrono::milliseconds(arguments.interval_ms);
  options.window = nanoseconds(arguments.window_seconds);
  options.duration = nanoseconds(arguments.duration_seconds);
  return options;
}

void add_verbs(CLI::App& app, Arguments& arguments) {
  auto* const ls = add_verb(
      app, "ls", "Segments, processes, topics, publishers and subscribers, memory", arguments);
  ls->add_flag("--all", arguments.all,
               "each publisher, subscriber and process, also where many are alike");
  ls->add_option("--interval", arguments.interval_ms, "how long rates are measured at most")
      ->check(CLI::Range(1, 600000))
      ->type_name("MILLISECONDS")
      ->capture_default_str();
  auto* const top = add_verb(
      app, "top", "A screen that stays: rates, bandwidth, memory, laggards of topics and processes",
      arguments);
  top->add_flag("--once", arguments.once, "one screen as text, as where there is no terminal");
  top->add_option("--interval", arguments.interval_ms, "how often the screen is renewed")
      ->check(CLI::Range(1, 600000))
      ->type_name("MILLISECONDS")
      ->capture_default_str();
  auto* const who = add_verb(
      app, "who", "Which process holds which message since when, and which reader is behind",
      arguments);
  who->add_flag("--all", arguments.all,
                "queued, loaned and spare messages too, and each publisher by itself");
  add_echo(app, arguments);
  add_pub(app, arguments);
  add_gauges(app, arguments);
  auto* const clean = add_verb(
      app, "clean", "Reaps the dead, removes segments without a process, gives unused memory back",
      arguments);
  clean->add_flag("--dry-run", arguments.cleaning.dry_run, "only says what would be done");
  clean->add_flag("--with-items", arguments.cleaning.with_items,
                  "also removes segments in whose queues items wait to be taken");
  add_verb(app, "doctor", "Looks at the machine: what keeps LOT from working well, what to type",
           arguments);
}

/// Reads the arguments. An exit status: there is nothing more to do than what was said.
std::optional<int> parse(CLI::App& app, int argc, char** argv) {
  try {
    app.parse(argc, argv);
  } catch (const CLI::RequiredError& e) {  // no verb: an unknown word is told of first
    const std::vector<std::string> unknown = app.remaining();
    if (unknown.empty()) {
      app.exit(e);
    } else {  // which prints them from the last to the first
      app.exit(CLI::ExtrasError("lot", {unknown.rbegin(), unknown.rend()}));
      std::string verbs;
      for (const CLI::App* verb : app.get_subcommands({})) verbs += " " + verb->get_name();
      std::fprintf(stderr, "The commands are:%s\n", verbs.c_str());
    }
    return kUsage;
  } catch (const CLI::ParseError& e) {
    std::ostringstream asked;  // the help, or the version
    if (app.exit(e, asked, std::cerr) != 0) return kUsage;
    return write_out(asked.str(), lot::StopToken()) ? kWell : kWrong;
  }
  return std::nullopt;
}

/// Does what the command says.
int call(const CLI::App& app, Arguments& arguments) {
  const Settings& settings = arguments.settings;
  if (app.got_subcommand("ls")) {
    return ls(settings, std::chrono::milliseconds(arguments.interval_ms), arguments.all);
  }
  if (app.got_subcommand("top")) {
    return top(settings, std::chrono::milliseconds(arguments.interval_ms), arguments.once);
  }
  if (app.got_subcommand("who")) return who(settings, arguments.all);
  using Seconds = std::chrono::duration<double>;
  if (app.got_subcommand("echo")) {
    EchoOptions& options = arguments.echo;
    if (arguments.timeout) options.timeout = Seconds(*arguments.timeout);
    if (arguments.in_full) options.limits = kInFull;
    return echo(settings, options);
  }
  if (app.got_subcommand("pub")) {
    arguments.pub.wait = Seconds(arguments.wait);
    return pub(settings, arguments.pub);
  }
  if (app.got_subcommand("hz")) return hz(settings, gauge_options(arguments));
  if (app.got_subcommand("bw")) return bw(settings, gauge_options(arguments));
  if (app.got_subcommand("delay")) return delay(settings, gauge_options(arguments));
  return clean(settings, arguments.cleaning);
}

int run(int argc, char** argv) {
  CLI::App app{"Looks at LOT segments, and cleans up what the dead have left", "lot"};
  Arguments arguments;
  Settings& settings = arguments.settings;
  // Not by CLI11's envname(): that one reads the environment of a set-user-ID program, too.
  using lot::transport::environment;
  if (const char* name = environment("LOT_SEGMENT")) settings.where.name = name;
  const char* const directory = environment("LOT_DIR");
  settings.where.directory = directory != nullptr ? directory : lot::EngineOptions().directory;
  app.set_version_flag(
      "--version",
      std::string("lot " LOT_VERSION ", layout ") + std::to_string(lot::segment::kLayoutVersion),
      "says which version this is, and ends");
  app.footer(kFooter);
  app.require_subcommand(1);
  add_common(app, settings);
  add_verbs(app, arguments);
  app.set_help_all_flag("--help-all", "the same for all verbs");
  if (const auto status = parse(app, argc, argv)) return *status;
  if (app.got_subcommand("doctor")) return doctor(settings);  // which tells of a bad LOT_SEGMENT
  if (const std::string wrong = objection_to(settings.where.name);
      !settings.where.name.empty() && !wrong.empty()) {
    std::fprintf(stderr, "LOT_SEGMENT: %s\n", wrong.c_str());
    return kUsage;
  }
  settings.where.trust = lot::transport::trust_of_environment();
  return call(app, arguments);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const lot::Error& e) {
    // Names come from other processes.
    std::fprintf(stderr, "%s\n", lot::tool::shown(e.what(), kLine).c_str());
    return e.error_number() == EBADMSG ? lot::tool::kDamaged : lot::tool::kWrong;
  } catch (const lot::OutOfMemory& e) {
    std::fprintf(stderr, "%s\n", lot::tool::shown(e.what(), kLine).c_str());
    return lot::tool::kWrong;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "lot: out of memory\n");
    return lot::tool::kWrong;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "lot: %s\n", e.what());
    return lot::tool::kWrong;
  }
}
