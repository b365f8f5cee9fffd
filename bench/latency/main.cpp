// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

#include "compare.hpp"
#include "conditions.hpp"
#include "conductor.hpp"
#include "crew.hpp"
#include "figures.hpp"
#include "json.hpp"
#include "machine.hpp"
#include "report.hpp"
#include "resume.hpp"
#include "revision.hpp"
#include "throw_errno.hpp"
#include "transport.hpp"

namespace {

using namespace ab;

// Exit statuses besides 0 and 128 + a signal. compare has kNothingInCommon, too (compare.hpp).
constexpr int kFailed = 1;   ///< of what was measured something is wrong
constexpr int kBadUse = 2;   ///< std::invalid_argument, and what CLI11 refuses
constexpr int kTrouble = 4;  ///< a file, the system, or a mistake of this program

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
  SavedPolicy saved;
  bool dry_run = false;
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

/// Transports, or arms.
void check(const std::vector<std::string>& names) {
  for (const std::string& arm : names) {
    const std::string name = transport_of(arm);
    if (find_transport(name) != nullptr) continue;
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
  run.revision = ab::revision();
  run.seed = seed;
  return run;
}

/// The cells that a run of this choice measures, with all arms that each wants.
std::vector<CellArms> plan(const Choice& choice, const Machine& machine) {
  const std::vector<std::string> names =
      choice.transports.empty() ? every_transport() : choice.transports;
  check(names);
  if (const auto twin = std::find_if(names.begin(), names.end(), is_quiet); twin != names.end()) {
    throw std::invalid_argument("no transport '" + *twin +
                                "'; --graph av has quiet twins by itself");
  }
  std::vector<CellArms> wanted;
  for (const Conditions& c : cells(choice)) {
    if (const std::string why = refused(c); !why.empty()) throw std::invalid_argument(why);
    CellArms cell{c, {}};
    const auto add = [&](const std::vector<std::string>& some) {
      for (const std::string& name : some) {
        const bool is_there =
            std::find(cell.arms.begin(), cell.arms.end(), name) != cell.arms.end();
        if (!is_there) cell.arms.push_back(name);
      }
    };
    add(arms_of(c, names));
    if (!choice.no_floors) add(arms_of(c, floors_of(c)));
    wanted.push_back(std::move(cell));
  }
  if (choice.out.empty()) return wanted;
  std::vector<CellArms> rest = to_measure(wanted, saved_cells(choice.out, machine), choice.saved);
  for (const CellArms& cell : rest) check(cell.arms);  // what was saved may be missing here
  return rest;
}

/// What is known of it before it runs: its pace. Starting and ending come on top.
std::string time_word(const std::vector<CellArms>& cells) {
  double seconds = 0;
  std::size_t unpaced = 0;
  for (const CellArms& cell : cells) {
    const Conditions& c = cell.conditions;
    if (c.mode != "paced") {
      ++unpaced;
      continue;
    }
    const Topic first = topics(c).front();
    double each = static_cast<double>(c.messages) / first.rate_hz;
    if (c.ordered) each += 2.0 * (first.publishers + first.subscribers - 1);
    seconds += each * static_cast<double>(cell.arms.size());
  }
  std::string word = std::to_string(cells.size()) + (cells.size() == 1 ? " cell" : " cells");
  if (unpaced < cells.size()) {
    const auto whole = static_cast<std::uint64_t>(std::ceil(seconds));
    word +=
        ", at least " + std::to_string(whole / 60) + " min " + std::to_string(whole % 60) + " s";
  }
  if (unpaced > 0) {
    word += "; of " + std::to_string(unpaced) + " that " + (unpaced == 1 ? "is" : "are") +
            " not paced nobody knows how long";
  }
  return word;
}

void print_plan(const std::vector<CellArms>& cells) {
  for (const CellArms& cell : cells) {
    std::cout << title_of(cell.conditions) << "\n ";
    for (const std::string& name : cell.arms) std::cout << " " << name;
    std::cout << "\n";
  }
  std::cout << time_word(cells) << "\n";
}

/// One line that changes on a terminal; elsewhere a line for each cell.
class Progress {
 public:
  explicit Progress(std::size_t cells) : cells_(cells) {}
  void begin(std::size_t cell, const Conditions& conditions) {
    where_ = "[" + std::to_string(cell + 1) + "/" + std::to_string(cells_) + "] ";
    if (!lively_) std::cerr << where_ << title_of(conditions) << std::endl;
  }
  void say(const std::string& text) const {
    if (lively_) std::cerr << "\r\033[K" << where_ << text << std::flush;
  }
  void end() const {
    if (lively_) std::cerr << "\r\033[K";
  }

 private:
  std::size_t cells_;
  std::string where_;
  bool lively_ = isatty(STDERR_FILENO) != 0;
};

/// Before hours are spent on what cannot be kept.
void must_be_writable(const std::string& dir) {
  std::filesystem::create_directories(dir);
  if (access(dir.c_str(), W_OK | X_OK) != 0) {
    throw_errno("--out " + dir);
  }
}

int run(const Choice& choice, const Run& about) {
  const std::vector<CellArms> wanted = plan(choice, about.machine);
  if (choice.dry_run) {
    print_plan(wanted);
    return 0;
  }
  if (!choice.out.empty()) must_be_writable(choice.out);
  for (const Missing& missing : missing_transports()) {
    if (choice.transports.empty()) std::cout << missing.name << " " << missing.why << "\n";
  }
  std::cerr << time_word(wanted) << std::endl;
  const Workplace workplace;
  for (const int s : {SIGINT, SIGTERM, SIGHUP}) std::signal(s, [](int n) { signalled = n; });
  std::signal(SIGPIPE, SIG_IGN);
  Progress progress(wanted.size());
  int status = 0;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    CellOptions options;
    options.conditions = wanted[i].conditions;
    options.transports = wanted[i].arms;
    options.profile = choice.profile;
    options.seed = choice.seed + i;
    progress.begin(i, options.conditions);
    Cell cell;
    try {
      cell = run_cell(
          options, workplace, [&](const std::string& text) { progress.say(text); },
          [] { return signalled != 0; });
    } catch (const std::invalid_argument& e) {  // too large for this machine, now; others may do
      progress.end();
      std::cerr << "lot_ab: not measured: " << title_of(options.conditions) << ": " << e.what()
                << std::endl;
      status = kFailed;
      continue;
    }
    progress.end();
    if (signalled != 0) break;
    print(std::cout, cell, report_options(choice));
    std::cout << std::endl;
    for (const Arm& arm : cell.arms) {
      if (has_failed(arm.refused)) status = kFailed;
    }
    if (!counts_add_up(cell)) status = kFailed;
    if (choice.out.empty()) continue;
    cell.command = about.command;
    cell.revision = about.revision;
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

int show(const Choice& choice, const std::string& dir) {
  const Run saved = load(dir);
  print(std::cout, saved, report_options(choice));
  return std::all_of(saved.cells.begin(), saved.cells.end(), counts_add_up) ? 0 : kFailed;
}

void list() {
  for (const Transport& t : transports())
    std::printf("%-12s  %s\n", t.name.c_str(), t.about.c_str());
  for (const Missing& m : missing_transports()) {
    std::printf("%-12s  (%s)\n", m.name.c_str(), m.why.c_str());
  }
}

void add_report_options(CLI::App& app, Choice& choice, const char* group) {
  app.add_flag("--per-subscriber", choice.per_subscriber, "a row for each subscriber")
      ->group(group);
  app.add_option("--stamp", choice.stamp,
                 "latency of the tables counts from: loan (before its memory is asked for), fill "
                 "(after it is filled, as the paper), push; files have all three")
      ->check(CLI::IsMember({"loan", "fill", "push"}))
      ->group(group)
      ->capture_default_str();
}

void add_options(CLI::App& app, Choice& choice) {
  const char* const what = "What is measured";
  app.add_option("-t,--transports", choice.transports,
                 "names, with commas (lot_ab list); default: all. Floors are added")
      ->delimiter(',')
      ->group(what);
  app.add_option("-m,--mode", choice.modes, "paced, ping-pong, throughput")
      ->delimiter(',')
      ->group(what)
      ->capture_default_str();
  app.add_option("-g,--graph", choice.graphs,
                 "NpMs: N publishers and M subscribers of one topic; av: the paper's vehicle, with "
                 "its cameras and (quiet) without them")
      ->delimiter(',')
      ->group(what)
      ->capture_default_str();
  app.add_option("-s,--size", choice.sizes, "bytes of a message: 128, 64K, 16M")
      ->delimiter(',')
      ->group(what)
      ->transform(CLI::AsSizeValue(false));
  app.add_option("-n,--messages", choice.rest.messages, "of each publisher")
      ->check(CLI::Range(1.0, 1e9))
      ->group(what)
      ->capture_default_str();
  app.add_option("-r,--rate", choice.rest.rate_hz, "of each publisher when paced, in Hz")
      ->group(what)
      ->capture_default_str();
  app.add_option("--block", choice.rest.block,
                 "messages after which the next transport has its turn")
      ->check(CLI::Range(1.0, 1e9))
      ->group(what)
      ->capture_default_str();

  const char* const conditions = "Under which conditions";
  app.add_option("-w,--wait", choice.waits, "spin, adaptive, park")
      ->delimiter(',')
      ->group(conditions)
      ->capture_default_str();
  app.add_option("--pin", choice.pins, "none, same-core, other-core, socket, other-socket")
      ->delimiter(',')
      ->group(conditions)
      ->capture_default_str();
  app.add_option(
         "--place", choice.places,
         "host; container: all nodes in one; containers: each in one of its own (bubblewrap; "
         "TCP and UDP over veth, which needs root)")
      ->delimiter(',')
      ->group(conditions)
      ->capture_default_str();
  app.add_option("--pool", choice.rest.pool,
                 "messages that a publisher prepares and uses again; 0: makes each anew")
      ->group(conditions)
      ->capture_default_str();
  app.add_option("--depth", choice.rest.depth, "messages that wait for a slow subscriber")
      ->group(conditions)
      ->capture_default_str();
  app.add_option("--lossless", choice.lossless,
                 "publishers wait for slow subscribers: yes, no; auto: for throughput")
      ->check(CLI::IsMember({"auto", "yes", "no"}))
      ->group(conditions)
      ->capture_default_str();
  app.add_option(
         "--fill", choice.fill,
         "every byte of a message is written before it is pushed: yes, no; auto: when paced")
      ->check(CLI::IsMember({"auto", "yes", "no"}))
      ->group(conditions)
      ->capture_default_str();
  app.add_flag("--ordered", choice.rest.ordered,
               "nodes come one by one, 2 s apart, publishers first")
      ->group(conditions);
  app.add_flag("--no-floors", choice.no_floors, "adds no floors")->group(conditions);
  app.add_flag("--profile", choice.profile,
               "where processor time goes (SIGPROF), and, with --place host, when")
      ->group(conditions);
  app.add_option("--seed", choice.seed, "of the order of turns")
      ->check(CLI::Range(0.0, 1e18))
      ->group(conditions)
      ->capture_default_str();

  const char* const output = "What comes out";
  auto* const out = app.add_option("-o,--out", choice.out,
                                   "directory for run.json and raw/; cells are added to it")
                        ->group(output);
  app.add_flag(
         "--resume", choice.saved.resume,
         "leaves out cells that --out has with all wanted arms; measures others with what they had")
      ->needs(out)
      ->group(output);
  app.add_flag("--replace", choice.saved.replace,
               "deletes what --out has of the cells that are measured; without it or --resume such "
               "a run is refused")
      ->needs(out)
      ->group(output);
  app.add_flag("--dry-run", choice.dry_run, "says what would be measured, and how long it takes")
      ->group(output);
  add_report_options(app, choice, output);
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
      "Compares ways to move messages between processes, under equal conditions: all transports\n"
      "are started, then take turns, together with the floors that nobody can beat.\n"
      "Exit status: 0; 1 if a transport failed, a cell needs more memory than there is, or\n"
      "messages do not add up; 2 for bad use; 4 for what else went wrong (a file that cannot be\n"
      "read or written); 128 and a signal's number.");
  app.footer(
      "Every combination of the lists is a cell. Example:\n"
      "  lot_ab -t ring,tcp -s 128,1M,16M -g 1p1s,1p5s -n 500 -o results\n"
      "  lot_ab plot results");
  app.require_subcommand(0, 1);
  Choice choice;
  add_options(app, choice);
  auto* const listing = app.add_subcommand("list", "says which transports there are");
  const std::string a_run = "a run.json, or its directory";
  std::string a;
  std::string b;
  auto* const showing = app.add_subcommand("show", "prints the tables of saved cells");
  showing->add_option("DIR", a, a_run)->required()->check(CLI::ExistingPath);
  add_report_options(*showing, choice, "Options");
  auto* const plot = app.add_subcommand("plot", "draws the paper's figures from saved cells");
  plot->add_option("DIR", a, "what --out named")->required()->check(CLI::ExistingDirectory);
  auto* const comparing = app.add_subcommand("compare", kCompareRule);
  comparing->add_option("A", a, a_run)->required()->check(CLI::ExistingPath);
  comparing->add_option("B", b, "the other one")->required()->check(CLI::ExistingPath);
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
    if (*showing) return show(choice, a);
    if (*plot) {
      for (const std::string& line : draw(load(a), a)) std::cout << line << "\n";
      return 0;
    }
    if (*comparing) return compare(std::cout, load(a), load(b));
    return run(choice, header(argc, argv, choice.seed));
  } catch (const std::invalid_argument& e) {
    std::cerr << "lot_ab: " << e.what() << "\n";
    return kBadUse;
  } catch (const std::exception& e) {
    std::cerr << "lot_ab: " << e.what() << "\n";
    return kTrouble;
  }
}
