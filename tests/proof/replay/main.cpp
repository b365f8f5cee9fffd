// SPDX-License-Identifier: Apache-2.0

// Runs workers of which one seed says everything: which thread runs, for how long, what is killed
// (docs/verification.md, "One seed repeats a run").

#include <algorithm>
#include <cerrno>
#include <cinttypes>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fcntl.h>
#include <filesystem>
#include <sched.h>
#include <string>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include "chaos/namespaces.hpp"
#include "conductor.hpp"
#include "record.hpp"
#include "support/seed.hpp"
#include "tracing.hpp"
#include "worker.hpp"

namespace lot::replay {
namespace {

struct Options {
  static constexpr std::uint64_t kNone = ~std::uint64_t{0};
  std::uint64_t seed = kNone;
  std::uint64_t runs = 1;
  bool twice = false;
  bool stop = false;  ///< at the first violation
  bool only_letters = false;
  std::uint64_t operations = 0;  ///< 0: the seed says
  std::uint64_t worker = kNone;  ///< this process is that worker: the conductor has started it
  std::uint64_t life = 0;
};

/// All threads of all runs are on the first core that there is: what it is called is the same in
/// each run.
void stay_on_one_core() {
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  sched_getaffinity(0, sizeof(allowed), &allowed);
  cpu_set_t one;
  CPU_ZERO(&one);
  for (unsigned c = 0; c < CPU_SETSIZE && CPU_COUNT(&one) == 0; ++c) {
    if (CPU_ISSET(c, &allowed)) CPU_SET(c, &one);
  }
  sched_setaffinity(0, sizeof(one), &one);
}

/// As process 1 of a new PID namespace: an empty /dev/shm, and the namespace's /proc. "" when done.
std::string make_the_place() {
  const auto mounts = [](const char* what, const char* where, const char* type, unsigned long flags,
                         const char* how) {
    return mount(what, where, type, flags, how) == 0
               ? ""
               : std::string(where) + " cannot be mounted: " + std::strerror(errno);
  };
  std::string why = mounts("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr);
  if (why.empty()) why = mounts("replay", "/dev/shm", "tmpfs", 0, "size=256m");
  if (why.empty()) why = mounts("proc", "/proc", "proc", 0, nullptr);
  return why;
}

/// The workers would inherit what happens to be open, and it differs from run to run.
void keep_no_descriptors() {
  const int null = open("/dev/null", O_RDWR);
  for (int standard = 0; standard < 3; ++standard) dup2(null, standard);
  close_range(3, ~0U, 0);
}

void conduct(const Options& options, std::uint64_t seed, const std::string& program,
             Record& record) {
  try {
    if (const std::string why = make_the_place(); !why.empty()) {
      return record.finish(Record::End::Skipped, why + "\nskipped: can not mount a tmpfs");
    }
    keep_no_descriptors();
    Plan plan = options.only_letters ? Plan::of_letters(seed) : Plan::of(seed);
    if (options.operations != 0) plan.operations = static_cast<unsigned>(options.operations);
    Conductor(plan, program, record).run();
  } catch (const Refused& e) {
    record.finish(Record::End::Skipped, std::string(e.what()) + "\nskipped: no tracing here");
  } catch (const std::exception& e) {
    record.finish(Record::End::Unfinished, e.what());
  }
}

/// A run in a process, and in namespaces, of its own.
void run(chaos::Namespaces& namespaces, const Options& options, std::uint64_t seed,
         const std::string& program, Record& record) {
  const pid_t conductor = namespaces.fork();
  if (conductor == 0) {
    conduct(options, seed, program, record);
    std::fflush(nullptr);
    _exit(0);
  }
  int status = 0;
  while (waitpid(conductor, &status, 0) == -1 && errno == EINTR) {
  }
  if (record.text[0] == '\0' && record.end == Record::End::Unfinished) {
    record.finish(Record::End::Unfinished, "the conductor was killed");
  }
}

/// What repeats the run.
std::string command(const Options& options, std::uint64_t seed) {
  std::string words = "lot_replay --seed " + std::to_string(seed);
  if (options.only_letters) words += " --letters";
  if (options.operations != 0) words += " --operations " + std::to_string(options.operations);
  return words;
}

void print(const Options& options, std::uint64_t seed, const Record& r) {
  std::printf("seed %" PRIu64 ": fingerprint %016" PRIx64 ", %" PRIu64
              " steps in %zu turns, %" PRIu64 " calls, %" PRIu64 " kills, %" PRIu64
              " operations, %" PRIu64 " messages\n",
              seed, r.fingerprint, r.steps, r.count, r.calls, r.kills, r.operations, r.messages);
  if (r.end == Record::End::Passed) return;
  constexpr std::size_t kShown = 12;
  for (std::size_t i = r.count - std::min(r.count, kShown); i < r.count; ++i) {
    const Record::Turn& t = r.turns[i];
    std::printf("  step %" PRIu64 ": thread %u, at 0x%" PRIx64 "%s\n", t.steps, t.thread, t.place,
                t.call == 0 ? "" : (", system call " + std::to_string(t.call - 1)).c_str());
  }
  std::printf("%s of seed %" PRIu64 " in step %" PRIu64 ": %s\n",
              r.end == Record::End::Violation ? "VIOLATION" : "UNFINISHED", seed, r.steps, r.text);
  std::printf("once more: %s\n", command(options, seed).c_str());
}

/// Where the second run has gone another way; "" if it has not.
std::string difference(const Record& a, const Record& b) {
  const std::size_t count = std::min(a.count, b.count);
  for (std::size_t i = 0; i < count; ++i) {
    if (a.turns[i].fingerprint == b.turns[i].fingerprint) continue;
    const std::uint64_t from = i == 0 ? 0 : a.turns[i - 1].steps;
    char text[200];
    std::snprintf(text, sizeof(text),
                  "turn %zu, behind step %" PRIu64 ": thread %u at 0x%" PRIx64
                  ", and thread %u at 0x%" PRIx64 " (call %u, %u)",
                  i, from, a.turns[i].thread, a.turns[i].place, b.turns[i].thread, b.turns[i].place,
                  a.turns[i].call, b.turns[i].call);
    return text;
  }
  if (a.fingerprint == b.fingerprint && a.end == b.end && std::strcmp(a.text, b.text) == 0) {
    return "";
  }
  return "the end";
}

struct Sum {
  std::uint64_t seeds = 0, twice = 0, steps = 0, kills = 0, violations = 0, differences = 0;
};

/// False: the system refuses what a run needs.
bool try_seed(chaos::Namespaces& namespaces, const Options& options, std::uint64_t seed,
              const std::string& program, Sum& sum) {
  Record& first = Record::make();
  run(namespaces, options, seed, program, first);
  if (first.end == Record::End::Skipped) {
    std::printf("%s\n", first.text);
    return false;
  }
  print(options, seed, first);
  ++sum.seeds;
  sum.violations += first.end != Record::End::Passed;
  sum.steps += first.steps;
  sum.kills += first.kills;
  if (options.twice) {
    Record& second = Record::make();
    run(namespaces, options, seed, program, second);
    ++sum.twice;
    if (const std::string where = difference(first, second); !where.empty()) {
      ++sum.differences;
      std::printf("DIFFERS in the second run of seed %" PRIu64 ": %s\n", seed, where.c_str());
      print(options, seed, second);
    }
    Record::let_go(second);
  }
  Record::let_go(first);
  return true;
}

int all(Options options) {
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  if (options.seed == Options::kNone) options.seed = testing::seed();
  const std::string program = std::filesystem::read_symlink("/proc/self/exe");
  chaos::Namespaces namespaces(true);
  if (const std::string why = namespaces.enter(); !why.empty()) {
    std::printf("%s\nskipped: no PID namespaces here\n", why.c_str());
    return 0;
  }
  stay_on_one_core();
  Sum sum;
  for (std::uint64_t seed = options.seed; seed < options.seed + options.runs; ++seed) {
    if (!try_seed(namespaces, options, seed, program, sum)) return 0;
    if (options.stop && sum.violations + sum.differences != 0) break;
  }
  std::printf("summary: %" PRIu64 " seeds, %" PRIu64 " of them twice, %" PRIu64 " steps, %" PRIu64
              " kills, %" PRIu64 " violations, %" PRIu64 " differences\n",
              sum.seeds, sum.twice, sum.steps, sum.kills, sum.violations, sum.differences);
  return sum.violations + sum.differences == 0 ? 0 : 1;
}

constexpr const char* kUsage =
    "usage: lot_replay [--seed N] [--runs M] [--twice] [--stop] [--letters] [--operations K]\n"
    "  --seed N        the first seed (default: LOT_TEST_SEED, or a new one)\n"
    "  --runs M        so many seeds (default: 1)\n"
    "  --twice         each seed twice: both runs must be the same\n"
    "  --stop          at the first violation\n"
    "  --letters       two workers that only push and pull letters, and no kill\n"
    "  --operations K  of each worker; otherwise the seed says\n";

/// Where the value of an option goes; null: there is no such option.
std::uint64_t* value_of(Options& options, const std::string& name) {
  if (name == "--seed") return &options.seed;
  if (name == "--runs") return &options.runs;
  if (name == "--operations") return &options.operations;
  if (name == "--worker") return &options.worker;
  if (name == "--life") return &options.life;
  return nullptr;
}

/// The same of an option without a value.
bool* flag_of(Options& options, const std::string& name) {
  if (name == "--twice") return &options.twice;
  if (name == "--stop") return &options.stop;
  if (name == "--letters") return &options.only_letters;
  return nullptr;
}

bool parse(int argc, char** argv, Options& options) {
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    if (bool* const flag = flag_of(options, name)) {
      *flag = true;
      continue;
    }
    std::uint64_t* const value = value_of(options, name);
    char* end = nullptr;
    if (value == nullptr || ++i == argc) return false;
    *value = std::strtoull(argv[i], &end, 10);
    if (end == argv[i] || *end != '\0') return false;
  }
  return options.runs != 0;
}

}  // namespace
}  // namespace lot::replay

int main(int argc, char** argv) {
  using namespace lot::replay;
  Options options;
  if (!parse(argc, argv, options)) {
    std::fputs(kUsage, stderr);
    return 2;
  }
  if (options.worker != Options::kNone) {
    return work({options.seed, static_cast<unsigned>(options.worker),
                 static_cast<unsigned>(options.life), static_cast<unsigned>(options.operations),
                 options.only_letters});
  }
  return all(options);
}
