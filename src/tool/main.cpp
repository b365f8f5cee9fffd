// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <string>

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
    "  3  a segment is damaged, or of another version\n"
    "\n"
    "`ls`, `who` and `doctor` only read. docs/tool.md says what the words mean.";

int run(int argc, char** argv) {
  using namespace lot::tool;
  CLI::App app{"Looks at LOT segments, and cleans up what the dead have left", "lot"};
  Settings settings;
  // Not by CLI11's envname(): that one reads the environment of a set-user-ID program, too.
  using lot::transport::environment;
  if (const char* name = environment("LOT_SEGMENT")) settings.where.name = name;
  const char* const directory = environment("LOT_DIR");
  settings.where.directory = directory != nullptr ? directory : lot::EngineOptions().directory;
  app.set_version_flag("--version", std::string("lot " LOT_VERSION ", layout ") +
                                        std::to_string(lot::segment::kLayoutVersion));
  app.footer(kFooter);
  app.require_subcommand(1);
  app.fallthrough();
  app.add_option("-s,--segment", settings.where.name, "only this segment (LOT_SEGMENT)");
  app.add_option("-d,--dir", settings.where.directory, "where segments lie (LOT_DIR)")
      ->capture_default_str();
  app.add_flag("--json", settings.json, "for programs");

  auto* const list =
      app.add_subcommand("ls", "Segments, processes, topics, publishers and subscribers, memory");
  bool all = false;
  list->add_flag("--all", all, "each publisher, subscriber and process, also where many are alike");
  unsigned interval_ms = 1000;
  list->add_option("--interval", interval_ms, "milliseconds for which rates are measured at most")
      ->check(CLI::Range(1, 600000))
      ->capture_default_str();
  auto* const holders =
      app.add_subcommand("who", "Who holds which message since when, and who is behind");
  holders->add_flag("--all", all,
                    "queued messages too, and those that are loaned or spare; each publisher");
  auto* const cleaner = app.add_subcommand(
      "clean", "Reaps the dead, removes what nobody lives in, gives unused memory back");
  CleanOptions cleaning;
  cleaner->add_flag("--dry-run", cleaning.dry_run, "only says what would be done");
  cleaner->add_flag("--with-items", cleaning.with_items,
                    "also removes segments in whose queues items wait to be taken");

  auto* const examiner = app.add_subcommand(
      "doctor", "Looks at the machine: what keeps LOT from working well, and what to type");

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kWell : kUsage;
  }
  if (*examiner) return doctor(settings);
  settings.where.trust = lot::transport::trust_of_environment();
  if (*list) return ls(settings, std::chrono::milliseconds(interval_ms), all);
  if (*holders) return who(settings, all);
  return clean(settings, cleaning);
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
