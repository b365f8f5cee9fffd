// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <string>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

#include "compare.hpp"
#include "conductor.hpp"
#include "crew.hpp"
#include "figures.hpp"
#include "json.hpp"
#include "machine.hpp"
#include "report.hpp"
#include "transport.hpp"

#ifndef LOT_AB_REVISION
#define LOT_AB_REVISION "unknown"
#endif

namespace {

using namespace ab;

constexpr int kBadUse = 2;

std::atomic<int> signalled{0};

struct Choice {
  std::vector<std::string> transports;
  std::vector<std::string> modes{"paced"};
  std::vector<std::string> graphs{"1p1s"};
  std::vector<std::size_t> sizes{128, 64 << 10, 1 << 20, 16 << 20};
  std::vector<std::string> waits{"park"};
  std::vector<std::string> pins{"none"};
  std::vector<std::string> places{"host"};
  Conditions rest;
  std::string lossless = "auto";
  std::string fill = "auto";
  bool no_floors = false;
  bool profile = false;
  std::uint64_t seed = 1;
  std::string out;
  bool resume = false;
  bool per_subscriber = false;
  std::string stamp = "fill";
};

/// Every combination, in the order in which tables are read.
std::vector<Conditions> cells(const Choice& choice) {
  std::vector<Conditions> all;
  const auto add = [&](const std::string& mode, const std::string& graph, const std::string& wait,
                       const std::string& pin, const std::string& place, std::size_t size) {
    Conditions c = choice.rest;
    const bool paced = mode == "paced";
    c.mode = mode;
    c.graph = graph;
    c.size = size;
    c.rate_hz = paced ? c.rate_hz : 0;
    c.block = std::min(c.block, c.messages);
    c.wait = wait;
    c.pin = pin;
    c.place = place;
    c.lossless = choice.lossless == "auto" ? mode == "throughput" : choice.lossless == "yes";
    c.fill = choice.fill == "auto" ? paced : choice.fill == "yes";
    all.push_back(c);
  };
  for (const auto& mode : choice.modes)
    for (const auto& graph : choice.graphs)
      for (const auto& wait : choice.waits)
        for (const auto& pin : choice.pins)
          for (const auto& place : choice.places) {
            if (is_scenario(graph)) {
              add(mode, graph, wait, pin, place, 0);
              continue;
            }
            for (const std::size_t size : choice.sizes) add(mode, graph, wait, pin, place, size);
          }
  return all;
}

/// All that are here but the floors, which every run has anyway.
std::vector<std::string> every_transport() {
  std::vector<std::string> names;
  for (const Transport& t : transports()) {
    if (!t.is_floor) names.push_back(t.name);
  }
  return names;
}

void check(const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    const auto& all = transports();
    if (std::any_of(all.begin(), all.end(), [&](const Transport& t) { return t.name == name; })) {
      continue;
    }
    for (const Missing& missing : missing_transports()) {
      if (missing.name == name) throw std::invalid_argument(name + " " + missing.why);
    }
    throw std::invalid_argument("no transport '" + name + "'; lot_ab list says which there are");
  }
}

ReportOptions report_options(const Choice& choice) {
  ReportOptions options;
  options.per_subscriber = choice.per_subscriber;
  options.stamp = choice.stamp == "loan"   ? Stamp::Loan
                  : choice.stamp == "push" ? Stamp::Push
                                           : Stamp::Fill;
  return options;
}

/// What is kept after each cell, so that a run that is broken off loses one cell at most.
Run header(int argc, char** argv, std::uint64_t seed) {
  Run run;
  run.machine = this_machine();
  for (int i = 0; i < argc; ++i) run.command += (i == 0 ? "" : " ") + std::string(argv[i]);
  run.started = utc_now();
  run.revision = LOT_AB_REVISION;
  run.seed = seed;
  return run;
}

int run(const Choice& choice, const Run& about) {
  const std::vector<std::string> names =
      choice.transports.empty() ? every_transport() : choice.transports;
  check(names);
  std::vector<Conditions> wanted = cells(choice);
  for (const Conditions& c : wanted) {
    if (const std::string why = refused(c); !why.empty()) throw std::invalid_argument(why);
  }
  if (choice.resume) {
    const std::vector<Conditions> saved = saved_cells(choice.out);
    const auto is_saved = [&](const Conditions& c) {
      return std::find(saved.begin(), saved.end(), c) != saved.end();
    };
    wanted.erase(std::remove_if(wanted.begin(), wanted.end(), is_saved), wanted.end());
  }
  for (const Missing& missing : missing_transports()) {
    if (choice.transports.empty()) std::cout << missing.name << " " << missing.why << "\n";
  }
  const Workplace workplace;
  for (const int s : {SIGINT, SIGTERM, SIGHUP}) std::signal(s, [](int n) { signalled = n; });
  std::signal(SIGPIPE, SIG_IGN);
  const bool lively = isatty(STDERR_FILENO) != 0;
  int status = 0;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    CellOptions options;
    options.conditions = wanted[i];
    options.transports = names;
    options.floors = !choice.no_floors;
    options.profile = choice.profile;
    options.seed = choice.seed + i;
    const std::string where = "[" + std::to_string(i + 1) + "/" + std::to_string(wanted.size()) + "] ";
    const Cell cell = run_cell(
        options, workplace,
        [&](const std::string& text) {
          if (lively) std::cerr << "\r\033[K" << where << text << std::flush;
        },
        [] { return signalled != 0; });
    if (lively) std::cerr << "\r\033[K";
    if (signalled != 0) break;
    print(std::cout, cell, report_options(choice));
    std::cout << std::endl;
    for (const Arm& arm : cell.arms) {
      if (arm.refused.rfind("failed: ", 0) == 0) status = 1;
    }
    if (!counts_add_up(cell)) status = 1;
    if (choice.out.empty()) continue;
    Run one = about;
    one.complete = i + 1 == wanted.size();
    one.cells.push_back(cell);
    add(one, choice.out);
  }
  if (signalled != 0) {
    std::cerr << "lot_ab: ended by signal " << signalled << "; whole cells are kept\n";
    return 128 + signalled;
  }
  return status;
}

void list() {
  for (const Transport& t : transports()) std::printf("%-12s  %s\n", t.name.c_str(), t.about.c_str());
  for (const Missing& m : missing_transports()) {
    std::printf("%-12s  (%s)\n", m.name.c_str(), m.why.c_str());
  }
}

void add_options(CLI::App& app, Choice& choice) {
  const char* const what = "What is measured";
  app.add_option("-t,--transports", choice.transports,
                 "names, with commas (lot_ab list); default: all. Floors are added")
      ->delimiter(',')->group(what);
  app.add_option("-m,--mode", choice.modes, "paced, ping-pong, throughput")
      ->delimiter(',')->group(what)->capture_default_str();
  app.add_option("-g,--graph", choice.graphs,
                 "NpMs: N publishers and M subscribers of one topic; av: the paper's vehicle; "
                 "av-quiet: the same without its cameras")
      ->delimiter(',')->group(what)->capture_default_str();
  app.add_option("-s,--size", choice.sizes, "bytes of a message: 128, 64K, 16M")
      ->delimiter(',')->group(what)->transform(CLI::AsSizeValue(false));
  app.add_option("-n,--messages", choice.rest.messages, "of each publisher")
      ->group(what)->capture_default_str();
  app.add_option("-r,--rate", choice.rest.rate_hz, "of each publisher when paced, in Hz")
      ->group(what)->capture_default_str();
  app.add_option("--block", choice.rest.block, "messages after which the next transport has its turn")
      ->group(what)->capture_default_str();

  const char* const conditions = "Under which conditions";
  app.add_option("-w,--wait", choice.waits, "spin, adaptive, park")
      ->delimiter(',')->group(conditions)->capture_default_str();
  app.add_option("--pin", choice.pins, "none, same-core, other-core, socket, other-socket")
      ->delimiter(',')->group(conditions)->capture_default_str();
  app.add_option("--place", choice.places,
                 "host; container: all nodes in one; containers: each in one of its own (bubblewrap; "
                 "TCP and UDP over veth, which needs root)")
      ->delimiter(',')->group(conditions)->capture_default_str();
  app.add_option("--pool", choice.rest.pool,
                 "messages that a publisher prepares and uses again; 0: makes each anew")
      ->group(conditions)->capture_default_str();
  app.add_option("--depth", choice.rest.depth, "messages that wait for a slow subscriber")
      ->group(conditions)->capture_default_str();
  app.add_option("--lossless", choice.lossless,
                 "publishers wait for slow subscribers: yes, no; auto: for throughput")
      ->check(CLI::IsMember({"auto", "yes", "no"}))->group(conditions)->capture_default_str();
  app.add_option("--fill", choice.fill,
                 "every byte of a message is written before it is pushed: yes, no; auto: when paced")
      ->check(CLI::IsMember({"auto", "yes", "no"}))->group(conditions)->capture_default_str();
  app.add_flag("--ordered", choice.rest.ordered, "subscriber k comes k x 2 s after the publishers")
      ->group(conditions);
  app.add_flag("--no-floors", choice.no_floors, "adds no floors")->group(conditions);
  app.add_flag("--profile", choice.profile, "processor time over time, and where it goes (SIGPROF)")
      ->group(conditions);
  app.add_option("--seed", choice.seed, "of the order of turns")
      ->group(conditions)->capture_default_str();

  const char* const output = "What comes out";
  auto* const out =
      app.add_option("-o,--out", choice.out, "directory for run.json and raw/; cells are added to it")
          ->group(output);
  app.add_flag("--resume", choice.resume, "leaves out the cells that --out has already")
      ->needs(out)->group(output);
  app.add_flag("--per-subscriber", choice.per_subscriber, "a row for each subscriber")->group(output);
  app.add_option("--stamp", choice.stamp,
                 "latency of the tables counts from: loan (before its memory is asked for), fill (after "
                 "it is filled, as the paper), push; files have all three")
      ->check(CLI::IsMember({"loan", "fill", "push"}))->group(output)->capture_default_str();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 5 && std::string(argv[1]) == "group") {  // how nodes are started; not for people
    try {
      return run_group(std::stoi(argv[2]), static_cast<unsigned>(std::stoul(argv[3])),
                       static_cast<unsigned>(std::stoul(argv[4])));
    } catch (const std::exception& e) {
      std::cerr << "lot_ab: a group of nodes: " << e.what() << "\n";
      return 1;
    }
  }

  CLI::App app(
      "Compares ways to move messages between processes, under equal conditions: all transports are "
      "started, then take turns, together with the floors that nobody can beat.\n"
      "Exit status: 0; 1 if a transport failed or messages do not add up; 2 for bad use.");
  app.footer("Every combination of the lists is a cell. Example:\n"
             "  lot_ab -t ring,tcp -s 128,1M,16M -g 1p1s,1p5s -n 500 -o results\n"
             "  lot_ab plot results");
  app.require_subcommand(0, 1);
  Choice choice;
  add_options(app, choice);
  auto* const listing = app.add_subcommand("list", "says which transports there are");
  auto* const plot = app.add_subcommand("plot", "draws the paper's figures from saved cells");
  std::string dir;
  plot->add_option("DIR", dir, "what --out named")->required();
  auto* const comparing = app.add_subcommand("compare", kCompareRule);
  std::string a;
  std::string b;
  comparing->add_option("A", a, "a run.json, or its directory")->required();
  comparing->add_option("B", b, "the other one")->required();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kBadUse;
  }
  try {
    if (*listing) {
      list();
      return 0;
    }
    if (*plot) {
      for (const std::string& line : draw(load(dir), dir)) std::cout << line << "\n";
      return 0;
    }
    if (*comparing) return compare(std::cout, load(a), load(b));
    return run(choice, header(argc, argv, choice.seed));
  } catch (const std::exception& e) {
    std::cerr << "lot_ab: " << e.what() << "\n";
    return kBadUse;
  }
}
