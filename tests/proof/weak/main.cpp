// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <new>
#include <optional>

#include "choices.hpp"
#include "explorer.hpp"
#include "litmus.hpp"
#include "plant.hpp"
#include "scenario.hpp"
#include "support/seed.hpp"

namespace lot::weak {
namespace {

using model::garden;
using model::Garden;
using model::Scenario;

constexpr const char* kUsage =
    R"(lot_weak: explores the headers of the protocol under the memory model of C++20, in which a
read-modify-write is no fence.

usage: lot_weak [--litmus] [--random N | --bounded N | --replay TRACE]
                [--weaken SITE=DAMAGE | --plant NAME] [SCENARIO...]

  --random N      N random executions of each scenario (default: 3000); the n-th is seeded with n
  --bounded N     at most N executions of each scenario: first all with one forced switch, or one
                  old value, or one store that goes before a newer one; then all with two of these,
                  and so on
  --replay TRACE  does an execution once more, as a failure has printed it, and tells its steps
  --litmus        the explorer's own tests: programs whose outcomes are known
  --mistake NAME  with --litmus: in a machine that is wrong; exit status 0 then means that it was
                  NOT found
  --one-in N      one of each N scenarios, others with each LOT_TEST_SEED
  --weaken SITE=DAMAGE, --plant NAME, --stop, --list, --sites
                  as lot_model has them
  SCENARIO        only these; all, if none is named

Exit status: 0 every scenario holds, 1 some fail, 2 wrong usage.
)";

struct Options {
  std::uint64_t executions = 3000;
  bool bounded = false;
  std::optional<Trace> replay;
  bool litmus = false;
  bool stop = false;
  bool sites = false;
  bool list = false;
  unsigned shares = 1;
  std::vector<std::string_view> names;
};

struct Totals {
  unsigned run = 0;
  unsigned failed = 0;
  std::uint64_t executions = 0;
  double seconds = 0;
};

template <class T>
bool parse(const char* text, T& value) {
  const char* end = text + std::strlen(text);
  return std::from_chars(text, end, value).ptr == end && text != end && value != 0;
}

bool parse_flag(std::string_view word, Options& options) {
  if (word == "--litmus") return options.litmus = true;
  if (word == "--stop") return options.stop = true;
  if (word == "--list") return options.list = true;
  if (word == "--sites") {
    garden.record_steps();
    return options.sites = true;
  }
  return false;
}

bool parse_value(std::string_view word, const char* value, Options& options) {
  if (word == "--random") return parse(value, options.executions);
  if (word == "--bounded") return (options.bounded = parse(value, options.executions));
  if (word == "--replay") return from_text(value, options.replay.emplace());
  if (word == "--one-in") return parse(value, options.shares);
  if (word == "--weaken") return garden.plant(value);
  if (word == "--plant") return garden.plant_named(value);
  if (word == "--mistake") return Memory::make_mistake(value);
  return false;
}

bool parse(int argc, char** argv, Options& options) {
  for (int i = 1; i < argc; ++i) {
    const std::string_view word = argv[i];
    if (!word.starts_with('-')) {
      options.names.push_back(word);
    } else if (!parse_flag(word, options) &&
               !(i + 1 < argc && parse_value(word, argv[++i], options))) {
      return false;
    }
  }
  return true;
}

void list() {
  for (const Scenario& s : model::scenarios()) std::cout << s.name << ": " << s.says << '\n';
  std::cout << "mistakes to plant:\n";
  Garden::list_names(std::cout);
  std::cout << "mistakes of the machine:\n";
  Memory::list_mistakes(std::cout);
}

/// A scenario as the explorer sees it: each execution begins with a new one, in the same memory.
class Stage {
 public:
  explicit Stage(const model::Cast& cast)
      : cast_(cast), memory_(::operator new (cast.bytes, std::align_val_t{cast.alignment})) {}
  ~Stage() { ::operator delete (memory_, std::align_val_t{cast_.alignment}); }
  Stage(const Stage&) = delete;
  Stage& operator=(const Stage&) = delete;

  Suite suite() {
    return {cast_.threads,
            [this] { play_ = cast_.make(memory_); },
            [this] { play_->~Play(); },
            [this] { play_->before(); },
            [this](unsigned thread) { play_->thread(thread); },
            [this] { play_->after(); }};
  }

 private:
  const model::Cast& cast_;
  void* memory_;
  model::Play* play_ = nullptr;
};

/// How far a bounded search has come, and what it has found.
struct Found {
  Outcome outcome;
  std::string how_far;
};

Found search_bounded(const Suite& suite, std::uint64_t executions) {
  Found found;
  for (unsigned bound = 0;; ++bound) {
    Bounded search(bound);
    Explorer::Limits limits;
    limits.executions = executions - found.outcome.executions;
    const std::uint64_t before = found.outcome.executions;
    found.outcome = Explorer(suite, search, limits).run();
    found.outcome.executions += before;
    if (!found.outcome.failure.empty()) return found;
    if (found.outcome.complete) found.how_far = "all with " + std::to_string(bound);
    if (found.outcome.complete && !search.was_cut()) found.how_far = "all";
    if (!found.outcome.complete || !search.was_cut() || found.outcome.executions >= executions) {
      return found;
    }
  }
}

Found search(const Suite& suite, const Options& options) {
  if (options.replay) {
    Replay search(*options.replay);
    Explorer::Limits limits;
    limits.history = true;
    return {Explorer(suite, search, limits).run(), ""};
  }
  if (options.bounded) return search_bounded(suite, options.executions);
  Random search(options.executions);
  return {Explorer(suite, search, {}).run(), ""};
}

void run(const Scenario& scenario, const Options& options, Totals& totals) {
  const auto begin = std::chrono::steady_clock::now();
  Stage stage(scenario.cast);
  const Suite suite = stage.suite();
  const auto [outcome, how_far] = search(suite, options);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
  const bool holds = outcome.failure.empty();

  std::printf("%-31s %s %9llu executions %6.1f s  %s\n", scenario.name, holds ? "ok  " : "FAIL",
              static_cast<unsigned long long>(outcome.executions), took.count(),
              holds ? how_far.c_str() : outcome.failure.c_str());
  if (!outcome.history.empty()) std::fputs(outcome.history.c_str(), stdout);
  if (!holds) {
    std::printf("    should hold: %s\n    %s\n    --replay %s %s\n", scenario.says,
                outcome.where.c_str(), to_text(outcome.trace).c_str(), scenario.name);
  }
  std::fflush(stdout);
  ++totals.run;
  totals.failed += holds ? 0 : 1;
  totals.executions += outcome.executions;
  totals.seconds += took.count();
}

int run_all(const Options& options) {
  Totals totals;
  const testing::Share share(options.shares);
  unsigned number = 0;
  for (const Scenario& scenario : model::scenarios()) {
    const bool named =
        std::find(options.names.begin(), options.names.end(), scenario.name) != options.names.end();
    if (!named && !options.names.empty()) continue;
    if (!share.has(number++)) continue;
    run(scenario, options, totals);
    if (options.stop && totals.failed != 0) break;
  }
  if (options.sites) garden.list_steps(std::cout);
  if (!garden.planted_step_was_seen()) {
    std::cout << "the step to be spoilt was never reached\n";
    return 2;
  }
  std::printf("total: %u scenarios, %u failed, %llu executions, %.1f s\n", totals.run,
              totals.failed, static_cast<unsigned long long>(totals.executions), totals.seconds);
  if (totals.run == 0) return 2;
  return totals.failed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace lot::weak

int main(int argc, char** argv) {
  using namespace lot::weak;
  Options options;
  if (argc == 2 && std::string_view(argv[1]) == "--help") {
    std::cout << kUsage;
    return 0;
  }
  if (!parse(argc, argv, options)) {
    std::cerr << kUsage;
    return 2;
  }
  if (options.list) {
    list();
    return 0;
  }
  if (options.litmus) return run_litmus_tests(options.stop) == 0 ? 0 : 1;
  return run_all(options);
}
