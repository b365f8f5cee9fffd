// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "lot/error.hpp"
#include "lot/options.hpp"

#include "segment/layout.hpp"
#include "tool/commands.hpp"
#include "transport/environment.hpp"

namespace {

constexpr const char* kFooter =
    "Exit status:\n"
    "  0  all is well\n"
    "  1  nothing was found, or something is wrong: the last lines say what to do\n"
    "  2  wrong usage\n"
    "  3  a segment is damaged, cut short, or of another version\n"
    "\n"
    "`ls`, `who` and `doctor` only read. lot-ls(1) and lot-who(1) say what the words mean.";

using namespace lot::tool;

struct Arguments {
  Settings settings;
  bool all = false;
  unsigned interval_ms = 1000;
  CleanOptions cleaning;
};

/// The options of all verbs, also before the verb.
void add_common(CLI::App& app, Settings& settings) {
  app.set_help_flag("-h,--help", "says what there is, and ends");
  app.add_option("-s,--segment", settings.where.name, "only this segment (LOT_SEGMENT)")
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

void add_verbs(CLI::App& app, Arguments& arguments) {
  auto* const ls = add_verb(
      app, "ls", "Segments, processes, topics, publishers and subscribers, memory", arguments);
  ls->add_flag("--all", arguments.all,
               "each publisher, subscriber and process, also where many are alike");
  ls->add_option("--interval", arguments.interval_ms, "how long rates are measured at most")
      ->check(CLI::Range(1, 600000))
      ->type_name("MILLISECONDS")
      ->capture_default_str();
  auto* const who = add_verb(
      app, "who", "Which process holds which message since when, and which reader is behind",
      arguments);
  who->add_flag("--all", arguments.all,
                "queued, loaned and spare messages too, and each publisher by itself");
  auto* const clean = add_verb(
      app, "clean", "Reaps the dead, removes segments without a process, gives unused memory back",
      arguments);
  clean->add_flag("--dry-run", arguments.cleaning.dry_run, "only says what would be done");
  clean->add_flag("--with-items", arguments.cleaning.with_items,
                  "also removes segments in whose queues items wait to be taken");
  add_verb(app, "doctor", "Looks at the machine: what keeps LOT from working well, what to type",
           arguments);
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
  try {
    app.parse(argc, argv);
  } catch (const CLI::RequiredError& e) {  // no verb: an unknown word is told of first
    const std::vector<std::string> unknown = app.remaining();
    if (unknown.empty()) {
      app.exit(e);
    } else {  // which prints them from the last to the first
      app.exit(CLI::ExtrasError("lot", {unknown.rbegin(), unknown.rend()}));
    }
    return kUsage;
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kWell : kUsage;
  }
  if (app.got_subcommand("doctor")) return doctor(settings);
  settings.where.trust = lot::transport::trust_of_environment();
  if (app.got_subcommand("ls")) {
    return ls(settings, std::chrono::milliseconds(arguments.interval_ms), arguments.all);
  }
  if (app.got_subcommand("who")) return who(settings, arguments.all);
  return clean(settings, arguments.cleaning);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const lot::Error& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return lot::tool::kWrong;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "lot: out of memory\n");
    return lot::tool::kWrong;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "lot: %s\n", e.what());
    return lot::tool::kWrong;
  }
}
