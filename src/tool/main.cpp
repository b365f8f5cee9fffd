// SPDX-License-Identifier: Apache-2.0
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <iostream>
#include <new>
#include <optional>
#include <set>
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
#include "tool/text.hpp"
#include "tool/writers.hpp"
#include "transport/environment.hpp"

namespace {

constexpr const char* kFooter =
    "Exit status:\n"
    "  0  all is well\n"
    "  1  nothing was found, or something is wrong: the last lines say what to do\n"
    "  2  wrong usage\n"
    "  3  a segment or a recording is damaged or cut short, or a segment of another version\n"
    "\n"
    "`ls`, `top`, `who` and `doctor` only read. `echo`, `hz`, `bw`, `delay` and `record` look on:\n"
    "no publisher waits for them. lot-ls(1) and lot-who(1) say what the words mean.";

using namespace lot::tool;

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
  RecordOptions record;
  bool all_topics = false;
  bool no_crc = false;
  std::string compression = "none";
  double split_mib = 0;
  double split_seconds = 0;
  double last_seconds = 0;
  double after_seconds = 0;
  double memory_mib = 1024;
  double quota_mib = 0;
  InfoOptions info;
  PlayOptions play;
  std::vector<std::string> remaps;
  double start_seconds = 0;
  std::optional<double> end_seconds;
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

void add_record(CLI::App& app, Arguments& arguments) {
  auto* const record = add_verb(
      app, "record", "Records topics into MCAP files, which ROS 2 and Foxglove read", arguments);
  lot::RecorderOptions& what = arguments.record.what;
  auto* const topics =
      record->add_option("TOPIC", what.topics, "names, or patterns such as '/camera/*'")
          ->type_name("");
  record->add_flag("--all", arguments.all_topics, "all topics")->excludes(topics);
  record->add_option("--except", what.except, "leaves these out: names or patterns")
      ->allow_extra_args(false)
      ->type_name("TOPIC");
  record->add_option("-o,--output", what.path, "the file; default: a name with the time")
      ->check([](const std::string& text) -> std::string {
        if (text == "-") return "a recording is no stream: name a file";
        return text.empty() ? "a file has a name" : "";
      })
      ->type_name("FILE");
  record->add_option("--compression", arguments.compression, "none, lz4 or zstd")
      ->check(CLI::IsMember({"none", "lz4", "zstd"}))
      ->type_name("NAME")
      ->capture_default_str();
  record->add_flag("--no-crc", arguments.no_crc, "leaves checksums out");
  record->add_option("--split-size", arguments.split_mib, "begins a new file after so much")
      ->check(between(0.001, 1e9))
      ->type_name("MEBIBYTES");
  record->add_option("--split-time", arguments.split_seconds, "begins a new file after so long")
      ->check(between(0.001, 1e9))
      ->type_name("SECONDS");
  record->add_option("--duration", arguments.duration_seconds, "ends after so long")
      ->check(between(0.001, 1e9))
      ->type_name("SECONDS");
  record->add_option("--max-rate", what.max_rate, "at most so many messages a second of each topic")
      ->check(between(1e-6, 1e9))
      ->type_name("HERTZ");
  record
      ->add_option("--quota", arguments.quota_mib,
                   "messages that wait to be written take at most so much of the segment")
      ->check(between(0.001, 1e9))
      ->type_name("MEBIBYTES");
  auto* const last =
      record
          ->add_option("--last", arguments.last_seconds,
                       "keeps only the last seconds, and writes them when a trigger comes")
          ->check(between(0.001, 1e9))
          ->type_name("SECONDS");
  record->add_option("--after", arguments.after_seconds, "and writes so long behind that, too")
      ->needs(last)
      ->check(between(0.001, 1e9))
      ->type_name("SECONDS");
  record->add_option("--memory", arguments.memory_mib, "what is kept takes at most so much memory")
      ->needs(last)
      ->check(between(0.001, 1e9))
      ->type_name("MEBIBYTES")
      ->capture_default_str();
  add_topic(*record, "--trigger", what.trigger, "each message of it is a trigger");
  record->get_option("--trigger")->needs(last);
}

void add_info(CLI::App& app, Arguments& arguments) {
  auto* const info = add_verb(app, "info", "What recordings hold, also damaged ones", arguments);
  info->add_option("FILE", arguments.info.files, "MCAP files")->required()->type_name("");
  info->add_flag("--recover", arguments.info.recover,
                 "writes the index of a file whose recorder was killed");
  info->add_flag("--quick", arguments.info.quick,
                 "reads only the index: damage elsewhere is not found");
}

void add_play(CLI::App& app, Arguments& arguments) {
  auto* const play = add_verb(app, "play", "Publishes what was recorded", arguments);
  PlayOptions& options = arguments.play;
  play->add_option("FILE", options.files, "MCAP files, which are played as one")
      ->required()
      ->type_name("");
  play->add_option("--topic", options.query.topics, "only these: names or patterns")
      ->allow_extra_args(false)
      ->type_name("TOPIC");
  play->add_option("--except", options.except, "leaves these out: names or patterns")
      ->allow_extra_args(false)
      ->type_name("TOPIC");
  play->add_option("--remap", arguments.remaps, "publishes a topic under another name: /a:=/b")
      ->allow_extra_args(false)
      ->check([](const std::string& text) {
        const auto at = text.find(":=");
        const bool fits = at != std::string::npos && at != 0 && at + 2 < text.size();
        return fits ? std::string() : text + " is not of the form /a:=/b";
      })
      ->type_name("NAMES");
  play->add_option("--rate", options.rate, "so many times as fast")
      ->check(between(1e-3, 1e6))
      ->type_name("FACTOR")
      ->capture_default_str();
  play->add_option("--start", arguments.start_seconds, "begins so long behind the first message")
      ->check(between(0, 1e9))
      ->type_name("SECONDS");
  play->add_option("--end", arguments.end_seconds, "ends so long behind the first message")
      ->check(between(0, 1e9))
      ->type_name("SECONDS");
  play->add_option("--wait", arguments.wait, "waits so long for a subscriber")
      ->check(between(0, 1e9))
      ->type_name("SECONDS");
  play->add_flag("--loop", options.loop, "again and again, until Ctrl-C");
  play->add_flag("--paused", options.paused, "begins with a pause: the space bar goes on");
}

/// "lot_2026-11-30_02-19-48.mcap"
std::string name_by_time() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  char text[64];
  if (localtime_r(&now, &parts) == nullptr) return "lot.mcap";
  std::strftime(text, sizeof(text), "lot_%Y-%m-%d_%H-%M-%S.mcap", &parts);
  return text;
}

RecordOptions record_options(const Arguments& arguments) {
  using Seconds = std::chrono::duration<double>;
  const auto bytes = [](double mib) { return static_cast<std::uint64_t>(mib * (1 << 20)); };
  RecordOptions options = arguments.record;
  lot::RecorderOptions& what = options.what;
  if (arguments.all_topics) what.topics = {"*"};
  options.has_default_name = what.path.empty();
  if (options.has_default_name) what.path = name_by_time();
  if (arguments.compression == "lz4") what.compression = lot::Compression::Lz4;
  if (arguments.compression == "zstd") what.compression = lot::Compression::Zstd;
  what.crcs = !arguments.no_crc;
  what.split_bytes = bytes(arguments.split_mib);
  what.split_time = Seconds(arguments.split_seconds);
  what.keep_last = Seconds(arguments.last_seconds);
  what.keep_after = Seconds(arguments.after_seconds);
  what.keep_last_bytes = bytes(arguments.memory_mib);
  what.max_held_bytes = bytes(arguments.quota_mib);
  if (arguments.duration_seconds > 0) options.duration = Seconds(arguments.duration_seconds);
  return options;
}

/// A topic that has two new names; empty: there is none.
std::string remapped_twice(const std::vector<std::string>& remaps) {
  std::set<std::string> topics;
  for (const std::string& remap : remaps) {
    const std::string topic = remap.substr(0, remap.find(":="));
    if (!topics.insert(topic).second) return topic;
  }
  return "";
}

PlayOptions play_options(const Arguments& arguments) {
  using Seconds = std::chrono::duration<double>;
  PlayOptions options = arguments.play;
  for (const std::string& remap : arguments.remaps) {
    const auto at = remap.find(":=");
    options.renamed[remap.substr(0, at)] = remap.substr(at + 2);
  }
  options.start = Seconds(arguments.start_seconds);
  if (arguments.end_seconds) options.end = Seconds(*arguments.end_seconds);
  options.wait = Seconds(arguments.wait);
  return options;
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
  add_record(app, arguments);
  add_info(app, arguments);
  add_play(app, arguments);
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
  } catch (const CLI::ArgumentMismatch& e) {
    const std::string text = e.what();
    const auto at = text.find(": At Most 1 required");  // an option of one value
    const std::string plain = text.substr(0, at) + " stands there twice: write it once";
    app.exit(at == text.npos ? e : CLI::ArgumentMismatch(plain, e.get_exit_code()));
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
  if (app.got_subcommand("record")) {
    if (arguments.record.what.topics.empty() && !arguments.all_topics) {
      std::fprintf(stderr, "lot record: which topics? Name them, or say --all\n");
      return kUsage;
    }
    return record(settings, record_options(arguments));
  }
  if (app.got_subcommand("info")) return info(settings, arguments.info);
  if (app.got_subcommand("play")) {
    if (const std::string topic = remapped_twice(arguments.remaps); !topic.empty()) {
      std::fprintf(stderr, "lot play: --remap gives %s two names: a topic is published under one\n",
                   shown(topic, kLine).c_str());
      return kUsage;
    }
    return play(settings, play_options(arguments));
  }
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
