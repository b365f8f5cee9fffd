// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>
#include <iostream>
#include <map>
#include <string>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

#include "conductor.hpp"
#include "crew.hpp"
#include "machine.hpp"
#include "transport.hpp"

namespace {

using namespace ab;

std::atomic<int> signalled{0};

struct Choice {
  std::vector<std::string> transports;
  std::vector<std::string> graphs{"1p1s"};
  std::vector<std::size_t> sizes{128};
  std::vector<std::string> modes{"paced"};
  std::vector<std::string> waits{"park"};
  std::vector<std::string> pins{"none"};
  std::vector<std::string> places{"host"};
  Conditions rest;
  std::string lossless = "auto";
  std::string fill = "auto";
  bool profile = false;
  std::uint64_t seed = 1;
};

/// Every combination, in the order in which tables are read.
std::vector<Conditions> cells(const Choice& choice) {
  std::vector<Conditions> all;
  for (const auto& mode : choice.modes) {
    for (const auto& graph : choice.graphs) {
      for (const auto& wait : choice.waits) {
        for (const auto& pin : choice.pins) {
          for (const auto& place : choice.places) {
            for (const auto size : choice.sizes) {
              Conditions c = choice.rest;
              c.mode = mode;
              c.graph = graph;
              c.wait = wait;
              c.pin = pin;
              c.place = place;
              c.size = graph.rfind("av", 0) == 0 ? 0 : size;
              const bool paced = mode == "paced";
              c.rate_hz = paced ? c.rate_hz : 0;
              c.lossless =
                  choice.lossless == "auto" ? mode == "throughput" : choice.lossless == "yes";
              c.fill = choice.fill == "auto" ? paced : choice.fill == "yes";
              all.push_back(c);
            }
          }
        }
      }
    }
  }
  return all;
}

int run(const Choice& choice) {
  const std::vector<Conditions> wanted = cells(choice);
  for (const Conditions& c : wanted) {
    if (const std::string why = refused(c); !why.empty()) {
      std::cerr << "lot_ab: " << why << "\n";
      return 2;
    }
  }
  const Workplace workplace;
  for (const int s : {SIGINT, SIGTERM, SIGHUP}) std::signal(s, [](int n) { signalled = n; });
  std::signal(SIGPIPE, SIG_IGN);
  const bool lively = isatty(STDERR_FILENO) != 0;
  int status = 0;
  for (std::size_t i = 0; i < wanted.size() && signalled == 0; ++i) {
    CellOptions options;
    options.conditions = wanted[i];
    options.transports = choice.transports;
    options.profile = choice.profile;
    options.seed = choice.seed + i;
    const std::string where = std::to_string(i + 1) + "/" + std::to_string(wanted.size());
    const Cell cell = run_cell(
        options, workplace,
        [&](const std::string& text) {
          if (lively) std::cerr << "\r\033[K[" << where << "] " << text << std::flush;
        },
        [] { return signalled != 0; });
    if (lively) std::cerr << "\r\033[K";
    for (const Arm& arm : cell.arms) {
      std::printf("%s %s", arm.transport.c_str(), arm.refused.c_str());
      for (const auto& s : arm.streams) {
        std::uint64_t sent = 0;
        double cpu = 0;
        for (const auto& p : s.publishers) {
          sent += p.sent;
          cpu += p.usage.cpu_us;
        }
        for (const auto& r : s.subscribers) {
          std::vector<double> us;
          for (const auto& x : r.samples)
            us.push_back(static_cast<double>(x.entered_at - x.pushed_at) / 1e3);
          std::sort(us.begin(), us.end());
          std::printf(
              "  [%s %u: sent %lu got %lu missed %lu lost %lu median %.2f p99 %.2f cpu %.2f/%.2f]",
              s.name.c_str(), r.index, sent, r.received, r.missed, r.lost,
              us.empty() ? 0 : us[us.size() / 2], us.empty() ? 0 : us[us.size() * 99 / 100],
              cpu / double(sent), r.usage.cpu_us / double(sent));
        }
        for (const auto& b : s.blocks)
          std::printf(" %.3f", double(b.took) / double(b.messages) / 1e3);
      }
      std::printf("\n");
      if (arm.refused.rfind("failed", 0) == 0) status = 1;
    }
  }
  return signalled != 0 ? 128 + signalled : status;
}

}  // namespace

int main(int argc, char** argv) {
  // How nodes are started; not for people.
  if (argc == 5 && std::string(argv[1]) == "group") {
    try {
      return run_group(std::stoi(argv[2]), static_cast<unsigned>(std::stoul(argv[3])),
                       static_cast<unsigned>(std::stoul(argv[4])));
    } catch (const std::exception& e) {
      std::cerr << "lot_ab: a group of nodes: " << e.what() << "\n";
      return 1;
    }
  }
  CLI::App app("Compares ways to move messages between processes, under equal conditions.");
  Choice choice;
  app.add_option("--transports", choice.transports, "")->delimiter(',');
  app.add_option("--graph", choice.graphs)->delimiter(',');
  app.add_option("--size", choice.sizes)->delimiter(',')->transform(CLI::AsSizeValue(false));
  app.add_option("--mode", choice.modes)->delimiter(',');
  app.add_option("--wait", choice.waits)->delimiter(',');
  app.add_option("--pin", choice.pins)->delimiter(',');
  app.add_option("--place", choice.places)->delimiter(',');
  app.add_option("--messages", choice.rest.messages);
  app.add_option("--block", choice.rest.block);
  app.add_option("--rate", choice.rest.rate_hz);
  app.add_option("--pool", choice.rest.pool);
  app.add_option("--depth", choice.rest.depth);
  app.add_flag("--ordered", choice.rest.ordered);
  app.add_flag("--profile", choice.profile);
  CLI11_PARSE(app, argc, argv);
  try {
    return run(choice);
  } catch (const std::exception& e) {
    std::cerr << "lot_ab: " << e.what() << "\n";
    return 2;
  }
}
