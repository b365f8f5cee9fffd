// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <exception>
#include <random>

#include <CLI/CLI.hpp>

#include "board.hpp"
#include "namespaces.hpp"
#include "settings.hpp"
#include "supervisor.hpp"

namespace lot::chaos {
namespace {

constexpr int kFound = 1;
constexpr int kCannot = 2;
constexpr int kInterrupted = 130;

std::string mistakes() {
  std::string text = "Mistakes to plant (the exit status must then be 1):";
  for (const Mistake& m : kMistakes) {
    text += "\n  " + std::string(m.name) + std::string(13 - std::string(m.name).size(), ' ') +
            m.says + " (" + kFindingNames[static_cast<std::size_t>(m.expected)] + ")";
  }
  return text;
}

void describe(CLI::App& app, Settings& s, std::string& plant, long& at_most, long& patience,
              bool& no_namespaces, bool& or_without) {
  app.add_option("--kills", s.kills, "SIGKILLs to send")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  app.add_option("--processes", s.processes, "Nodes that live at once")
      ->check(CLI::Range(8U, kMostNodes))
      ->capture_default_str();
  app.add_option("--seed", s.seed, "Of a former run; default: random");
  app.add_option("--checkpoint", s.checkpoint, "Kills between two audits with everybody alive")
      ->check(CLI::Range(20, 100000))
      ->capture_default_str();
  app.add_option("--seconds-at-most", at_most, "Ends sooner, as if the kills were done")
      ->check(CLI::Range(1, 1000000));
  app.add_option("--patience", patience, "Seconds without progress that mean: wedged")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--plant", plant, "Makes a mistake that must be found (see below)");
  app.add_flag("--no-namespaces", no_namespaces, "All in the PID, IPC and mount namespace of this");
  app.add_flag("--or-without", or_without, "The same where the system refuses namespaces");
  app.add_flag("--carry-on", s.carry_on, "Goes on after something was found");
  app.add_option("--save-segment", s.save_segment,
                 "Copies the segment to this file when something is found");
  app.footer(
      "All that is decided here follows from the seed: who does what in which life, when it is\n"
      "killed, stopped or told to leave, and what each node chooses. What the system's scheduler\n"
      "makes of it does not: a run with the same seed is alike, not the same.\n\n" +
      mistakes() + "\n\nExit status: 0 nothing was found, 1 something was, 2 it cannot run here.");
}

/// False when there are no namespaces and nothing can be done without.
bool enter(Namespaces& namespaces, bool or_without) {
  const std::string why = namespaces.enter();
  if (why.empty()) return true;
  if (!or_without) {
    std::fprintf(stderr,
                 "lot_chaos: no namespaces here (%s); run it as root, or with --no-namespaces\n",
                 why.c_str());
    return false;
  }
  std::printf("no namespaces: %s\nskipped: no PID namespaces here\n", why.c_str());
  std::fflush(stdout);
  namespaces.do_without();
  return true;
}

int run(int argc, char** argv) {
  Settings settings;
  std::string plant;
  long at_most = 0;
  long patience = settings.patience.count();
  bool no_namespaces = false;
  bool or_without = false;
  CLI::App app(
      "Chaos: publishers, readers and relays in many processes that are killed and stopped"
      " at random,\nand started again at once; nothing may be lost, torn, leaked or stuck.",
      "lot_chaos");
  describe(app, settings, plant, at_most, patience, no_namespaces, or_without);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kCannot;
  }
  if (app.count("--seed") == 0) settings.seed = std::random_device{}();
  settings.at_most = std::chrono::seconds(at_most);
  settings.patience = std::chrono::seconds(patience);
  settings.namespaces = !no_namespaces;
  for (const Mistake& m : kMistakes) {
    if (plant == m.name) settings.plant = m.plant;
  }
  if (!plant.empty() && settings.plant == Plant::None) {
    std::fprintf(stderr, "lot_chaos: there is no mistake '%s' to plant; see --help\n",
                 plant.c_str());
    return kCannot;
  }
  std::printf("seed: %llu (--seed %llu --kills %u --processes %u --checkpoint %u%s)\n",
              static_cast<unsigned long long>(settings.seed),
              static_cast<unsigned long long>(settings.seed), settings.kills, settings.processes,
              settings.checkpoint, no_namespaces ? " --no-namespaces" : "");
  std::fflush(stdout);

  Namespaces namespaces(settings.namespaces);
  if (!enter(namespaces, or_without)) return kCannot;
  Board& board = Board::make();
  Supervisor supervisor(settings, board, namespaces);
  supervisor.run();
  supervisor.tally().print(board, settings);
  if (supervisor.interrupted()) return kInterrupted;
  return board.findings() == 0 ? 0 : kFound;
}

}  // namespace
}  // namespace lot::chaos

int main(int argc, char** argv) {
  try {
    return lot::chaos::run(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "lot_chaos: %s\n", e.what());
    return 2;
  }
}
