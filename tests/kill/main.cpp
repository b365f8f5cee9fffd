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
  std::int64_t only = -1;
  std::vector<std::string> names;
};

/// What the neighbours of a stopped process needed.
struct Neighbour {
  std::atomic<std::uint64_t> most{0}, runs{0}, waits{0};
};

/// What the workers have in common.
struct Shared {
  std::atomic<std::size_t> next{0};  ///< operation to be done next
  std::atomic<std::uint64_t> operations{0}, instructions{0}, points{0}, kills{0}, violations{0};
  Neighbour neighbours[16];
};

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

/// Tracer and traced hand over to each other at each step: on one core that costs least.
void stay_on_one_core(unsigned job) {
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  sched_getaffinity(0, sizeof(allowed), &allowed);
  std::vector<std::size_t> cores;
  for (std::size_t c = 0; c < CPU_SETSIZE; ++c) {
    if (CPU_ISSET(c, &allowed)) cores.push_back(c);
  }
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
                           MAP_SHARED | MAP_ANONYMOUS, -1, 0)) Shared) {}

  /// Everything that is planted must be found.
  int self_test() {
    unsigned missed = 0;
    unsigned planted = 0;
    const auto judge = [&](const std::string& name, std::uint64_t found) {
      std::printf("%-56s %s\n", name.c_str(), found != 0 ? "found" : "NOT FOUND");
      ++planted;
      missed += found == 0;
    };
    for (const Operation& operation : planted_operations()) {
      judge(operation.name, at(operation, Trial::kMost));
    }
    options_.stop = true;
    strict_ = true;
    std::uint64_t waits = 0;
    for (const Operation& operation : all_operations()) {
      if (operation.name == "advertise, a new topic") waits = at(operation, 8);
    }
    judge("a neighbour must wait", waits);
    std::printf("summary: %u planted mistakes, %u not found\n", planted, missed);
    return missed == 0 ? 0 : 1;
  }

  int all() {
    const auto operations = all_operations();
    if (options_.fail) {
      std::printf("%-56s %6s %9s %7s %9s %10s %7s\n", "operation", "calls", "failures", "thrown",
                  "survived", "violations", "seconds");
    } else {
      std::printf("%-56s %-10s %12s %7s %6s %10s %7s\n", "operation", "promise", "instructions",
                  "points", options_.stop ? "stops" : "kills", "violations", "seconds");
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
      std::printf("summary: %llu operations, %llu failed system calls, %llu violations\n",
                  ull(totals_.operations), ull(totals_.kills), ull(totals_.violations));
      return totals_.violations == 0 && totals_.kills > 0 ? 0 : 1;
    }
    std::printf(
        "summary: %llu operations, %llu instructions, %llu points, %llu %s, %llu violations\n",
        ull(totals_.operations), ull(totals_.instructions), ull(totals_.points), ull(totals_.kills),
        options_.stop ? "stops" : "kills", ull(totals_.violations));
    return totals_.violations == 0 && totals_.kills > 0 ? 0 : 1;
  }

 private:
  static unsigned long long ull(std::uint64_t n) { return n; }

  void work(const std::vector<Operation>& operations, unsigned job) {
    stay_on_one_core(job);
    for (std::size_t i; (i = totals_.next++) < operations.size();) {
      if (chosen(operations[i].name)) options_.fail ? fail(operations[i]) : one(operations[i]);
    }
  }

  bool chosen(const std::string& name) const {
    return options_.names.empty() ||
           std::any_of(options_.names.begin(), options_.names.end(),
                       [&](const std::string& n) { return name.find(n) != std::string::npos; });
  }

  void one(const Operation& operation) {
    const auto start = std::chrono::steady_clock::now();
    std::uint64_t kills = 0;
    std::uint64_t violations = 0;
    Trial::Walk whole;
    if (options_.only >= 0) {
      violations += at(operation, static_cast<std::uint64_t>(options_.only));
      ++kills;
    } else {
      violations += at(operation, Trial::kMost, &whole);
      ++kills;
      for (std::uint64_t point = 0; point < whole.points; point += options_.every) {
        violations += at(operation, point);
        ++kills;
      }
    }
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    std::printf("%-56s %-10s %12llu %7llu %6llu %10llu %7.1f\n", operation.name.c_str(),
                name_of(operation.promise), ull(whole.instructions), ull(whole.points), ull(kills),
                ull(violations), took.count());
    std::fflush(stdout);
    ++totals_.operations;
    totals_.instructions += whole.instructions;
    totals_.points += whole.points;
    totals_.kills += kills;
    totals_.violations += violations;
  }

  /// Each of the operation's system calls fails in each way.
  void fail(const Operation& operation) {
    const auto start = std::chrono::steady_clock::now();
    std::uint64_t calls = 0, failures = 0, thrown = 0, violations = 0;
    try {
      current_segment = fresh_name();
      calls = Trial(operation, current_segment, false).walk(Trial::kMost).calls;
      for (std::uint64_t nth = 0; nth < calls; ++nth) {
        for (const int error : {EINTR, ENOMEM, ENOSPC, EPERM, EMFILE}) {
          current_segment = fresh_name();
          Trial trial(operation, current_segment, false);
          const Trial::Failure f = trial.fail_call(nth, error);
          failures += f.call.has_value();
          thrown += f.call && !f.error.empty();
          violations += f.violations.size();
          for (const auto& v : f.violations) {
            std::printf("  VIOLATION %s, call %llu (number %ld) fails by %s: %s%s%s\n",
                        operation.name.c_str(), ull(nth), f.call.value_or(-1),
                        strerrorname_np(error), v.c_str(),
                        f.error.empty() ? "" : "; thrown: ", f.error.c_str());
          }
        }
      }
    } catch (const std::exception& e) {
      std::printf("  VIOLATION %s: %s\n", operation.name.c_str(), e.what());
      ++violations;
    }
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    std::printf("%-56s %6llu %9llu %7llu %9llu %10llu %7.1f\n", operation.name.c_str(), ull(calls),
                ull(failures), ull(thrown), ull(failures - thrown), ull(violations), took.count());
    std::fflush(stdout);
    ++totals_.operations;
    totals_.kills += failures;
    totals_.violations += violations;
  }

  /// Runs the operation up to a point, and kills. Returns the number of violations.
  std::uint64_t at(const Operation& operation, std::uint64_t point, Trial::Walk* whole = nullptr) {
    std::vector<std::string> violations;
    try {
      current_segment = fresh_name();
      Trial trial(operation, current_segment, options_.stop);
      const Trial::Walk walk = trial.walk(point);
      if (whole != nullptr) *whole = walk;
      if (options_.stop) {
        const auto probed = trial.probe(point, strict_);
        for (std::size_t i = 0; i < probed.size(); ++i) {
          if (probed[i].instructions == 0 && !probed[i].waited) continue;
          Neighbour& n = totals_.neighbours[i];
          ++n.runs;
          n.waits += probed[i].waited;
          if (probed[i].waited) continue;
          std::uint64_t most = n.most;
          while (most < probed[i].instructions &&
                 !n.most.compare_exchange_weak(most, probed[i].instructions)) {
          }
        }
      }
      violations = trial.kill_and_inspect();
    } catch (const std::exception& e) {
      violations.push_back(e.what());
    }
    for (const auto& v : violations) {
      std::printf("  VIOLATION %s, point %lld: %s\n", operation.name.c_str(),
                  static_cast<long long>(point), v.c_str());
      std::fflush(stdout);
    }
    return violations.size();
  }

  void table_of_neighbours() const {
    std::printf("\n%-36s %-10s %8s %18s %8s\n", "beside a stopped process", "promise", "runs",
                "most instructions", "waited");
    for (std::size_t i = 0; i < all_probes().size(); ++i) {
      const Probe& p = all_probes()[i];
      const Neighbour& n = totals_.neighbours[i];
      std::printf("%-36s %-10s %8llu %18llu %8llu\n", p.name, name_of(p.promise), ull(n.runs),
                  ull(n.most), ull(n.waits));
    }
  }

  Options options_;
  bool strict_ = false;
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
  app.add_option("--every", options.every, "only every Nth point")->check(CLI::PositiveNumber);
  app.add_option("--jobs", options.jobs, "so many at once, each on a core of its own")
      ->check(CLI::PositiveNumber);
  app.add_option("--point", options.only, "this point only");
  app.add_option("operation", options.names, "operations whose names contain this; all by default");
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
