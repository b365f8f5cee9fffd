// SPDX-License-Identifier: Apache-2.0

// Kills, or stops, a process at every instruction of every operation that has changed something.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <functional>
#include <memory>
#include <new>
#include <sched.h>
#include <string>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>

#include "support/processes.hpp"
#include "trial.hpp"

namespace lot::kill {
namespace {

struct Options {
  bool stop = false;
  bool fail = false;
  bool list = false;
  bool self_test = false;
  unsigned every = 1;
  unsigned jobs = 1;
  unsigned shares = 1;
  std::int64_t only = -1;
  std::vector<std::string> names;
};

/// What the neighbours of a stopped process needed.
struct Neighbour {
  std::atomic<std::uint64_t> most{0}, runs{0}, counted{0}, waits{0};
};

/// What the workers have in common.
struct Shared {
  std::atomic<std::size_t> next{0};  ///< operation to be done next
  std::atomic<std::uint64_t> operations{0}, instructions{0}, points{0}, kills{0}, not_reached{0},
      spared{0}, shorter{0}, strayed{0}, violations{0};
  Neighbour neighbours[48];
};

using Violations = std::vector<std::string>;

/// What came of a run up to a point.
struct At {
  Trial::Walk walk;
  Violations violations;
  bool reached = false;  ///< the point was there
};

/// Of so many points one may be missed.
constexpr std::uint64_t kMissesPer = 20;
/// Of so many neighbours' operations the instructions of one are counted: that takes the time.
constexpr std::uint64_t kStepped = 4;

std::string current_segment;

/// Workers are forks: what is unique in one process is not among them.
std::string fresh_name() { return testing::unique_name() + "_" + std::to_string(getpid()); }

/// Ctrl-C leaves nothing behind: the processes die with this one.
void end_at_once(int signal) {
  for (const char* suffix : {"", ".lock", ".new", ".left"}) {
    unlink(("/dev/shm/" + current_segment + suffix).c_str());
  }
  _exit(128 + signal);
}

/// Those that the program may use when it starts; the first is where it was put, so that two of it
/// that run at once do not share one.
std::vector<std::size_t> usable_cores() {
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  sched_getaffinity(0, sizeof(allowed), &allowed);
  std::vector<std::size_t> cores;
  for (std::size_t c = 0; c < CPU_SETSIZE; ++c) {
    if (CPU_ISSET(c, &allowed)) cores.push_back(c);
  }
  const auto here = std::find(cores.begin(), cores.end(), static_cast<std::size_t>(sched_getcpu()));
  std::rotate(cores.begin(), here, cores.end());
  return cores;
}

/// Tracer and traced hand over to each other at each step: on one core that costs least.
void stay_on_one_core(unsigned job) {
  static const std::vector<std::size_t> cores = usable_cores();  // before anybody has pinned us
  if (cores.empty()) return;
  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(cores[job % cores.size()], &one);
  sched_setaffinity(0, sizeof(one), &one);
}

class Run {
 public:
  explicit Run(Options options)
      : options_(std::move(options)),
        totals_(*new (mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE,
                           MAP_SHARED | MAP_ANONYMOUS, -1, 0)) Shared) {
    if (all_probes().size() > std::size(totals_.neighbours)) std::abort();
  }

  /// Everything that is planted must be found, and as what it is.
  int self_test() {
    unsigned missed = 0;
    unsigned planted = 0;
    std::uint64_t number = 0;
    const auto is_mine = [&](const std::string& name) { return chosen(number++, name); };
    const auto judge = [&](const std::string& name, const Violations& violations,
                           const std::string& text) {
      const bool found = std::any_of(violations.begin(), violations.end(), [&](const auto& v) {
        return v.find(text) != std::string::npos;
      });
      std::printf("%-56s %s\n", name.c_str(), found ? "found" : "NOT FOUND");
      if (!found) std::printf("  it must be found as: %s\n", text.c_str());
      ++planted;
      missed += !found;
    };
    for (const auto& plants :
         {planted_operations(), planted_beside_observers(), planted_in_slots()}) {
      for (const auto& [operation, text] : plants) {
        if (is_mine(operation.name))
          judge(operation.name, at(operation, Trial::kMost).violations, text);
      }
    }
    options_.every = 5;  // a leak that stays takes its time
    const Plant failure = planted_failure();
    if (is_mine(failure.operation.name))
      judge(failure.operation.name, fail(failure.operation), failure.found_as);
    const Plant shrinking = planted_shrinking();
    if (is_mine(shrinking.operation.name))
      judge(shrinking.operation.name, one(shrinking.operation), shrinking.found_as);
    options_.every = 100;  // one, in the middle
    const Plant on_the_way = planted_on_the_way();
    if (is_mine(on_the_way.operation.name)) {
      const std::uint64_t strayed = totals_.strayed;
      auto found = one(on_the_way.operation);
      if (totals_.strayed != strayed) found = {"it strayed"};
      judge(on_the_way.operation.name, found, on_the_way.found_as);
    }
    for (const Operation& operation : planted_changes()) {
      if (!is_mine(operation.name)) continue;
      const std::uint64_t strayed = totals_.strayed;
      one(operation);
      judge(operation.name, {totals_.strayed == strayed ? "it did not stray" : "it strayed"},
            "it strayed");
    }
    for (const Operation& operation : planted_pledges()) {
      if (is_mine(operation.name)) judge(operation.name, unshown({operation}), operation.name);
    }
    options_.stop = true;
    options_.every = 1;
    const auto operations = all_operations();
    const auto locked = std::find_if(
        operations.begin(), operations.end(),
        [](const Operation& operation) { return operation.name == "advertise, a new topic"; });
    for (std::uint32_t i = 0; i < all_probes().size(); ++i) {
      const Probe& p = all_probes()[i];
      if (p.found_as == nullptr || !is_mine(p.name)) continue;
      probes_ = {{i, true}};
      // At its end the operation has no lock.
      const std::uint64_t point = p.waits_for_registry ? Trial::kMost : 8;
      judge(p.name, at(*locked, point).violations, p.found_as);
    }
    std::printf("summary: %u planted mistakes, %u not found\n", planted, missed);
    return missed == 0 && planted > 0 ? 0 : 1;
  }

  int all() {
    const auto operations = all_operations();
    for (const auto& v : unshown(operations)) {
      std::printf("  VIOLATION %s\n", v.c_str());
      ++totals_.violations;
    }
    if (options_.fail) {
      std::printf("%-56s %6s %9s %7s %9s %7s %6s %10s %7s\n", "operation", "calls", "failures",
                  "thrown", "survived", "spared", "missed", "violations", "seconds");
    } else {
      std::printf("%-56s %-10s %12s %7s %6s %6s %10s %7s\n", "operation", "promise", "instructions",
                  "points", options_.stop ? "stops" : "kills", "missed", "violations", "seconds");
    }
    std::fflush(stdout);
    std::vector<pid_t> workers;
    for (unsigned job = 1; job < options_.jobs; ++job) {
      const pid_t pid = fork();
      if (pid == 0) {
        prctl(PR_SET_PDEATHSIG, SIGTERM);
        work(operations, job);
        _exit(0);
      }
      workers.push_back(pid);
    }
    work(operations, 0);
    for (const pid_t pid : workers) {
      int status = 0;
      if (waitpid(pid, &status, 0) != pid || status != 0) ++totals_.violations;
    }
    if (options_.stop) table_of_neighbours();
    if (options_.fail) {
      std::printf(
          "summary: %llu operations, %llu failed system calls, %llu spared, %llu not reached, "
          "%llu not there a second time, %llu strayed and stepped again, %llu violations\n",
          ull(totals_.operations), ull(totals_.kills), ull(totals_.spared),
          ull(totals_.not_reached), ull(totals_.shorter), ull(totals_.strayed),
          ull(totals_.violations));
    } else {
      std::printf(
          "summary: %llu operations, %llu instructions, %llu points, %llu %s, %llu points not "
          "reached, %llu strayed and stepped again, %llu violations\n",
          ull(totals_.operations), ull(totals_.instructions), ull(totals_.points),
          ull(totals_.kills), options_.stop ? "stops" : "kills", ull(totals_.not_reached),
          ull(totals_.strayed), ull(totals_.violations));
    }
    return totals_.violations == 0 && totals_.kills > 0 ? 0 : 1;
  }

 private:
  static unsigned long long ull(std::uint64_t n) { return n; }

  void work(const std::vector<Operation>& operations, unsigned job) {
    stay_on_one_core(job);
    for (std::size_t i; (i = totals_.next++) < operations.size();) {
      if (options_.stop && !operations[i].leaves_blocks) continue;
      if (chosen(i, operations[i].name)) options_.fail ? fail(operations[i]) : one(operations[i]);
    }
  }

  bool chosen(std::uint64_t number, const std::string& name) const {
    if (!options_.names.empty()) {
      return std::any_of(options_.names.begin(), options_.names.end(),
                         [&](const std::string& n) { return name.find(n) != std::string::npos; });
    }
    return testing::Share(options_.shares).has(number);
  }

  /// Of a few stops none is spent on a process that has done its operation.
  bool passes_at_rest() const { return options_.stop && options_.every > 1; }

  Violations one(const Operation& operation) {
    const auto start = std::chrono::steady_clock::now();
    std::uint64_t kills = 0;
    std::uint64_t not_reached = 0;
    Violations all;
    Trial::Walk whole;
    const auto kill_at = [&](std::uint64_t point, const Trial::Path* path = nullptr) {
      At done = at(operation, point, path);
      all.insert(all.end(), done.violations.begin(), done.violations.end());
      if (point == Trial::kMost && passes_at_rest()) return done.walk;
      ++(done.reached ? kills : not_reached);
      return std::move(done.walk);
    };
    if (options_.only >= 0) {
      kill_at(static_cast<std::uint64_t>(options_.only));
    } else {
      whole = kill_at(Trial::kMost);
      // Of a few, those in the middle of the operation.
      const std::uint64_t every = std::uint64_t{options_.every} * operation.every;
      const std::uint64_t first = std::min(every, whole.points) / 2;
      for (std::uint64_t point = first; point < whole.points; point += every) {
        kill_at(point, &whole.path);
      }
    }
    look_at_misses(operation, not_reached, kills, "points", all);
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    std::printf("%-56s %-10s %12llu %7llu %6llu %6llu %10zu %7.1f\n", operation.name.c_str(),
                name_of(operation.pledge.promise), ull(whole.instructions), ull(whole.points),
                ull(kills), ull(not_reached), all.size(), took.count());
    std::fflush(stdout);
    ++totals_.operations;
    totals_.instructions += whole.instructions;
    totals_.points += whole.points;
    totals_.kills += kills;
    totals_.not_reached += not_reached;
    totals_.violations += all.size();
    return all;
  }

  /// Runs differ a little; but where many end early, little was shown.
  static void look_at_misses(const Operation& operation, std::uint64_t missed,
                             std::uint64_t reached, const char* what, Violations& all) {
    if (missed <= (missed + reached + kMissesPer - 1) / kMissesPer) return;
    all.push_back(std::to_string(missed) + " of " + std::to_string(missed + reached) + " " + what +
                  " were not reached");
    std::printf("  VIOLATION %s: %s\n", operation.name.c_str(), all.back().c_str());
  }

  /// Each of the operation's system calls fails in each way.
  Violations fail(const Operation& operation) {
    const auto start = std::chrono::steady_clock::now();
    constexpr int kErrors[] = {EINTR, ENOMEM, ENOSPC, EPERM, EMFILE};
    std::uint64_t calls = 0, failures = 0, thrown = 0, spared = 0, not_reached = 0;
    Violations all;
    try {
      current_segment = fresh_name();
      const Trial::Walk whole = Trial(operation, current_segment, false).walk(Trial::kMost);
      calls = whole.calls;
      std::uint64_t turn = 0;
      for (std::uint64_t i = 0; i < calls * std::size(kErrors); i += options_.every) {
        const std::uint64_t nth = i / std::size(kErrors);
        const int error = kErrors[turn++ % std::size(kErrors)];
        const Trial::Failure f = failure(operation, nth, error, whole.path);
        if (!f.call && !f.spared && f.violations.empty() && !has_call(operation, nth)) {
          ++totals_.shorter;
          continue;
        }
        failures += f.call.has_value();
        thrown += f.call && !f.error.empty();
        spared += f.spared;
        not_reached += !f.call && !f.spared;
        for (const auto& v : f.violations) {
          std::printf("  VIOLATION %s, call %llu (number %ld) fails by %s: %s%s%s\n",
                      operation.name.c_str(), ull(nth), f.call.value_or(-1), strerrorname_np(error),
                      v.c_str(), f.error.empty() ? "" : "; thrown: ", f.error.c_str());
          all.push_back(v);
        }
      }
    } catch (const std::exception& e) {
      std::printf("  VIOLATION %s: %s\n", operation.name.c_str(), e.what());
      all.emplace_back(e.what());
    }
    look_at_misses(operation, not_reached, failures + spared, "calls", all);
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    std::printf("%-56s %6llu %9llu %7llu %9llu %7llu %6llu %10zu %7.1f\n", operation.name.c_str(),
                ull(calls), ull(failures), ull(thrown), ull(failures - thrown), ull(spared),
                ull(not_reached), all.size(), took.count());
    std::fflush(stdout);
    ++totals_.operations;
    totals_.kills += failures;
    totals_.spared += spared;
    totals_.not_reached += not_reached;
    totals_.violations += all.size();
    return all;
  }

  /// False: the operation has fewer calls when it is run once more. One that waits for a process
  /// which stands still looks again as often as its time allows.
  bool has_call(const Operation& operation, std::uint64_t nth) {
    current_segment = fresh_name();
    return nth < Trial(operation, current_segment, false).walk(Trial::kMost).calls;
  }

  /// Runs the operation with one system call failing: on the path that another run has gone up to
  /// there, or step by step.
  Trial::Failure failure(const Operation& operation, std::uint64_t nth, int error,
                         const Trial::Path& path) {
    for (const Trial::Path* way = &path;; way = nullptr) {
      current_segment = fresh_name();
      Trial::Failure f = Trial(operation, current_segment, false).fail_call(nth, error, way);
      if (!f.strayed) return f;
      ++totals_.strayed;
    }
  }

  /// A run that stands behind a point. Where the path that another run has gone does not lead
  /// there, it was stepped.
  std::unique_ptr<Trial> come_to(std::uint64_t point, const Operation& operation,
                                 const Trial::Path* path, Trial::Walk& walk) {
    for (;; path = nullptr) {
      current_segment = fresh_name();
      auto trial = std::make_unique<Trial>(operation, current_segment, options_.stop);
      walk = trial->walk(point, path);
      if (!walk.strayed) return trial;
      ++totals_.strayed;
    }
  }

  /// Runs the operation up to a point, and kills.
  At at(const Operation& operation, std::uint64_t point, const Trial::Path* path = nullptr) {
    At done;
    try {
      const auto trial = come_to(point, operation, path, done.walk);
      done.reached = point == Trial::kMost || done.walk.points >= point;
      if (options_.stop) {
        auto which = probes_.empty() ? probes_beside(operation, point) : probes_;
        if (point == Trial::kMost && passes_at_rest()) which.clear();
        const auto probed = trial->probe(which);
        for (const auto& [i, stepped] : which) count(probed[i], totals_.neighbours[i]);
      }
      done.violations = trial->kill_and_inspect();
    } catch (const std::exception& e) {
      done.violations.emplace_back(e.what());
    }
    for (const auto& v : done.violations) {
      std::printf("  VIOLATION %s, point %lld: %s\n", operation.name.c_str(),
                  static_cast<long long>(point), v.c_str());
      std::fflush(stdout);
    }
    return done;
  }

  /// All that promise not to wait, and one of the blocking ones. With --every, only of some
  /// are the instructions counted.
  std::vector<Trial::Asked> probes_beside(const Operation& operation, std::uint64_t point) const {
    // Others at each point of each operation, whatever --every says.
    const std::uint64_t turn =
        (point + std::hash<std::string>()(operation.name)) * 0x9e3779b97f4a7c15U >> 32;
    std::vector<Trial::Asked> which;
    std::vector<std::uint32_t> blocking;
    for (std::uint32_t i = 0; i < all_probes().size(); ++i) {
      const Probe& p = all_probes()[i];
      if (p.found_as != nullptr) continue;
      if (p.promise == Promise::Blocking) {
        blocking.push_back(i);
      } else {
        which.push_back({i, options_.every == 1 || (turn + i) % kStepped == 0});
      }
    }
    which.push_back({blocking[turn % blocking.size()], true});
    return which;
  }

  static void count(const Trial::Probed& probed, Neighbour& n) {
    if (!probed.ran) return;
    ++n.runs;
    n.waits += probed.waited;
    if (probed.waited || probed.instructions == 0) return;
    ++n.counted;
    std::uint64_t most = n.most;
    while (most < probed.instructions && !n.most.compare_exchange_weak(most, probed.instructions)) {
    }
  }

  /// Operations that promise not to wait, and which no probe shows that promises as much.
  static Violations unshown(const std::vector<Operation>& operations) {
    Violations all;
    for (const Operation& o : operations) {
      const auto& [promise, name] = o.pledge;
      if (promise == Promise::Blocking) continue;
      const bool shown = std::any_of(all_probes().begin(), all_probes().end(),
                                     [&, p = promise, n = name](const Probe& probe) {
                                       return n != nullptr && probe.found_as == nullptr &&
                                              std::strcmp(probe.name, n) == 0 && probe.promise <= p;
                                     });
      if (!shown)
        all.push_back("no probe shows that it is " + std::string(name_of(promise)) + ": " + o.name);
    }
    return all;
  }

  void table_of_neighbours() {
    std::printf("\n%-36s %-10s %8s %8s %18s %8s %8s\n", "beside a stopped process", "promise",
                "runs", "counted", "most instructions", "bound", "waited");
    for (std::size_t i = 0; i < all_probes().size(); ++i) {
      const Probe& p = all_probes()[i];
      if (p.found_as != nullptr) continue;
      const Neighbour& n = totals_.neighbours[i];
      const std::string bound =
          p.promise == Promise::Blocking ? "-" : std::to_string(Trial::bound_of(p.promise));
      std::printf("%-36s %-10s %8llu %8llu %18llu %8s %8llu\n", p.name, name_of(p.promise),
                  ull(n.runs), ull(n.counted), ull(n.most), bound.c_str(), ull(n.waits));
      if (n.runs == 0 && options_.names.empty() && options_.shares == 1) {
        std::printf("  VIOLATION %s: it never ran\n", p.name);
        ++totals_.violations;
      }
    }
  }

  Options options_;
  std::vector<Trial::Asked> probes_;  ///< these only
  Shared& totals_;
};

}  // namespace
}  // namespace lot::kill

int main(int argc, char** argv) {
  using namespace lot::kill;
  lot::testing::prefix();
  Options options;
  CLI::App app(
      "Kills a process at every instruction of every operation that has changed something");
  app.add_flag("--stop", options.stop, "stop it there, and let a neighbour do its operations");
  app.add_flag("--fail", options.fail, "let each of its system calls fail instead");
  app.add_flag("--self-test", options.self_test, "see whether planted mistakes are found");
  app.add_flag("--list", options.list, "list the operations");
  app.add_option("--every", options.every, "only every Nth point, or failure")
      ->check(CLI::PositiveNumber);
  app.add_option("--one-in", options.shares,
                 "one of each N operations, or planted mistakes; others with each LOT_TEST_SEED")
      ->check(CLI::PositiveNumber)
      ->envname("LOT_TEST_ONE_IN");
  app.add_option("--jobs", options.jobs, "so many at once, each on a core of its own")
      ->check(CLI::PositiveNumber);
  app.add_option("--point", options.only, "this point only");
  app.add_option("operation", options.names,
                 "operations, or planted mistakes, whose names contain this; all by default");
  CLI11_PARSE(app, argc, argv);
  if (options.list) {
    for (const auto& o : all_operations()) std::printf("%s\n", o.name.c_str());
    return 0;
  }
  for (const int s : {SIGINT, SIGTERM, SIGHUP}) {
    if (std::signal(s, end_at_once) == SIG_IGN) std::signal(s, SIG_IGN);  // nohup
  }
  stay_on_one_core(0);
  Run run(options);
  return options.self_test ? run.self_test() : run.all();
}
