// SPDX-License-Identifier: Apache-2.0
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstring>

#include "plant.hpp"
#include "scenario.hpp"
#include "support/seed.hpp"

namespace lot::model {
namespace {

constexpr const char* kUsage =
    R"(lot_model: explores the headers of the protocol under Relacy's memory model.

usage: lot_model [--random N | --bounded] [--weaken SITE=DAMAGE | --plant NAME] [SCENARIO...]

  --random N      N random schedules of each scenario (default: 3000); the n-th is seeded with n, so
                  that a run is repeatable
  --bounded       all schedules with few forced switches, of the scenarios that are small enough
  --bound N       with --bounded: N forced switches, whatever the scenario affords
  --one-in N      one of each N scenarios, others with each LOT_TEST_SEED
  --weaken SITE=DAMAGE
                  runs with one atomic step spoilt. SITE is FILE:LINE[:COLUMN] as --sites says it;
                  DAMAGE is another ORDER, fail:ORDER (of a compare-exchange that fails), drop (the
                  step is left out), or stale (a load returns what this thread read there before)
  --plant NAME    runs with a known mistake; exit status 0 then means that it was NOT found
  --stop          ends with the first scenario that fails
  --list          lists the scenarios and the mistakes
  --sites         after the run, lists every atomic step that was seen
  --history       prints the schedule of a failure
  SCENARIO        only these; all, if none is named

Exit status: 0 every scenario holds, 1 some fail, 2 wrong usage.
)";

struct Options {
  unsigned long iterations = 3000;
  bool bounded = false;
  std::optional<unsigned> bound;
  bool history = false;
  bool stop = false;
  bool sites = false;
  bool list = false;
  std::vector<std::string_view> names;
  unsigned shares = 1;
};

struct Totals {
  unsigned run = 0;
  unsigned failed = 0;
  unsigned long executions = 0;
  double seconds = 0;
};

template <class T>
bool parse(const char* text, T& value) {
  const char* end = text + std::strlen(text);
  return std::from_chars(text, end, value).ptr == end && text != end;
}

bool parse(int argc, char** argv, Options& options) {
  for (int i = 1; i < argc; ++i) {
    const std::string_view word = argv[i];
    const auto next = [&] { return i + 1 < argc ? argv[++i] : ""; };
    if (word == "--random") {
      if (!parse(next(), options.iterations) || options.iterations == 0) return false;
    } else if (word == "--bounded") {
      options.bounded = true;
    } else if (word == "--bound") {
      if (!parse(next(), options.bound.emplace())) return false;
    } else if (word == "--one-in") {
      if (!parse(next(), options.shares) || options.shares == 0) return false;
    } else if (word == "--weaken") {
      if (!garden.plant(next())) return false;
    } else if (word == "--plant") {
      if (!garden.plant_named(next())) return false;
    } else if (word == "--stop") {
      options.stop = true;
    } else if (word == "--history") {
      options.history = true;
    } else if (word == "--sites") {
      options.sites = true;
      garden.record_steps();
    } else if (word == "--list") {
      options.list = true;
    } else if (word.starts_with('-')) {
      return false;
    } else {
      options.names.push_back(word);
    }
  }
  return true;
}

void list() {
  for (const Scenario& s : scenarios()) {
    std::cout << s.name << ": " << s.says;
    if (s.bound != 0) std::cout << " (bounded: " << s.bound << ')';
    std::cout << '\n';
  }
  std::cout << "mistakes to plant:\n";
  Garden::list_names(std::cout);
}

void run(const Scenario& scenario, const Options& options, Totals& totals) {
  static std::ostream nowhere(nullptr);
  rl::test_params params;
  params.iteration_count = options.bounded ? ~rl::iteration_t{0} : options.iterations;
  params.search_type = options.bounded ? rl::sched_bound : rl::sched_random;
  params.context_bound = options.bound.value_or(scenario.bound);
  params.execution_depth_limit = 10000;
  params.collect_history = options.history;
  params.output_stream = options.history ? &std::cout : &nowhere;
  params.progress_stream = &nowhere;

  const auto begin = std::chrono::steady_clock::now();
  const bool holds = simulate(scenario, params);
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;

  const auto executions = static_cast<unsigned long>(params.stop_iteration);
  std::printf("%-31s %s %9lu executions %6.1f s  %s\n", scenario.name, holds ? "ok  " : "FAIL",
              executions, took.count(), holds ? "" : rl::test_result_str(params.test_result));
  if (!holds) std::printf("    should hold: %s\n", scenario.says);
  std::fflush(stdout);
  ++totals.run;
  totals.failed += holds ? 0 : 1;
  totals.executions += executions;
  totals.seconds += took.count();
}

int run_all(const Options& options) {
  Totals totals;
  const testing::Share share(options.shares);
  unsigned number = 0;
  for (const Scenario& scenario : scenarios()) {
    const bool named =
        std::find(options.names.begin(), options.names.end(), scenario.name) != options.names.end();
    if (!named && !options.names.empty()) continue;
    if (options.bounded && !options.bound && scenario.bound == 0) continue;
    if (!share.has(number++)) continue;
    run(scenario, options, totals);
    if (options.stop && totals.failed != 0) break;
  }
  if (options.sites) garden.list_steps(std::cout);
  if (!garden.planted_step_was_seen()) {
    std::cout << "the step to be spoilt was never reached\n";
    return 2;
  }
  std::printf("total: %u scenarios, %u failed, %lu executions, %.1f s\n", totals.run, totals.failed,
              totals.executions, totals.seconds);
  if (totals.run == 0) return 2;
  return totals.failed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace lot::model

int main(int argc, char** argv) {
  using namespace lot::model;
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
  return run_all(options);
}
