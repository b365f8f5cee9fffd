// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <linux/futex.h>
#include <map>
#include <random>
#include <sched.h>
#include <string>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include "micro.hpp"

namespace bench {
namespace {

/// One line of the final table: what a counter of a benchmark should reach.
struct Figure {
  const char* benchmark;
  const char* text;
  const char* counter;
  bool at_most;
  double target;
};

constexpr Figure kFigures[] = {
    {"latency/borrowed/overwrite", "ping-pong, borrowed / line hand-over", "ratio", true, 1.8},
    {"latency/borrowed/block", "  the same under back-pressure", "ratio", true, 1.8},
    {"latency/kept/overwrite", "ping-pong, kept / line hand-over", "ratio", true, 2.5},
    {"latency/kept/block", "  the same under back-pressure", "ratio", true, 2.5},
    {"latency/48B/block/borrowed", "  48 B in blocks, borrowed", "ratio", true, 1.8},
    {"latency/48B/slot/borrowed", "  48 B in slots, borrowed", "ratio", true, 1.2},
    {"latency/48B/block/kept", "  48 B in blocks, kept", "ratio", true, 2.5},
    {"latency/48B/slot/kept", "  48 B in slots, kept", "ratio", true, 1.8},
    {"latency/128B/block/borrowed", "  128 B in blocks, borrowed", "ratio", true, 1.8},
    {"latency/128B/slot/borrowed", "  128 B in slots, borrowed", "ratio", true, 1.5},
    {"latency/128B/block/kept", "  128 B in blocks, kept", "ratio", true, 2.5},
    {"latency/128B/slot/kept", "  128 B in slots, kept", "ratio", true, 1.8},
    {"latency/16MiB_vs_128B", "16 MiB / 128 B, not rewritten", "ratio", true, 1.05},
    {"latency/parked/one_core", "parked / futex hand-over, one core", "ratio", true, 1.15},
    {"latency/parked/across", "  across cores, upper end", "hi", true, 1.1},
    {"own_loop/borrowed/O1", "a caller's own loop, -O1, borrowed", "ratio", true, 1.1},
    {"own_loop/borrowed/O2", "  -O2, borrowed", "ratio", true, 1.1},
    {"own_loop/borrowed/O3", "  -O3, borrowed", "ratio", true, 1.1},
    {"own_loop/borrowed/O3_words", "  -O3, borrowed, written by words", "ratio", true, 1.1},
    {"own_loop/kept/O1", "  -O1, kept", "ratio", true, 1.1},
    {"own_loop/kept/O2", "  -O2, kept", "ratio", true, 1.1},
    {"own_loop/kept/O3", "  -O3, kept", "ratio", true, 1.1},
    {"publish/vs_exchange", "publish / locked exchange", "ratio", true, 4},
    {"publish/slot/vs_exchange", "  in slots", "ratio", true, 2.5},
    {"publish/readers_250_vs_1", "publish, 250 readers / 1 reader", "ratio", true, 1.1},
    {"publish/deep_vs_shallow", "loan + push, depth = blocks / depth 64", "ratio", true, 4},
    {"publish/full_vs_roomy", "  16 MiB, full segment / depth 8", "ratio", true, 2},
    {"loan/128B", "loan + reset, 128 B / make_shared", "ratio", true, 4},
    {"loan/16MiB", "loan + reset, 16 MiB / make_shared", "ratio", true, 3.5},
    {"loan/128B/two_processes", "  128 B, two processes / one", "ratio", true, 1.25},
    {"loan/16MiB/two_processes", "  16 MiB, two processes / one", "ratio", true, 1.25},
    {"frames/4M/overwrite/depth:1/bare:1", "frames, 4 MiB, depth 1 / one bare buffer", "faster",
     false, 0.85},
    {"frames/4M/overwrite/depth:2/bare:1", "  4 MiB, depth 2 / one bare buffer", "faster", false,
     0.85},
    {"frames/4M/overwrite/depth:4/bare:1", "  4 MiB, depth 4 / one bare buffer", "faster", false,
     0.85},
    {"frames/8M/overwrite/depth:1/bare:1", "  8 MiB, depth 1 / one bare buffer", "faster", false,
     0.85},
    {"frames/8M/overwrite/depth:2/bare:1", "  8 MiB, depth 2 / one bare buffer", "faster", false,
     0.85},
    {"frames/8M/overwrite/depth:4/bare:1", "  8 MiB, depth 4 / one bare buffer", "faster", false,
     0.85},
    {"frames/16M/overwrite/depth:1/bare:1", "  16 MiB, depth 1 / one bare buffer", "faster", false,
     0.85},
    {"frames/16M/overwrite/depth:2/bare:1", "  16 MiB, depth 2 / one bare buffer", "faster", false,
     0.85},
    {"frames/16M/overwrite/depth:4/bare:1", "  16 MiB, depth 4 / one bare buffer", "faster", false,
     0.85},
    {"topics/wake", "a wait set woken, 1000 topics / 10", "ratio", true, 1.3},
    {"topics/wake", "  processor time", "cpu_ratio", true, 1.3},
    {"topics/descriptors", "threads for fd() of 1000 pullers", "threads", true, 1},
    {"advertise/first", "us that a description adds, first publisher", "more_us", true, 20},
    {"advertise/another", "  first publisher of another type", "more_us", true, 20},
    {"advertise/again", "  later publishers of the type", "more_us", true, 20},
    {"codec/16MiB/encode", "16 MiB image to CDR / memcpy", "ratio", true, 1.1},
    {"codec/16MiB/decode", "  back / memcpy", "ratio", true, 1.1},
    {"codec/16MiB/both", "  both / two", "ratio", true, 1.1},
    {"codec/16MiB/encode_in_pieces", "  to CDR, pixels where they are / memcpy", "ratio", true,
     0.1},
    {"locks/vs_pthread", "lock + unlock / pthread's robust mutex", "ratio", true, 0.8},
    {"pointers/vs_std", "copy + destroy / std::shared_ptr", "ratio", true, 1.1},
    {"pointers/two_processes_vs_boost", "  two processes: faster than Boost", "faster", false, 5},
    {"throughput/borrowed", "64 B, M/s, none lost, in blocks, borrowed", "M/s", false, 20},
    {"throughput/kept", "64 B, M/s, none lost, in blocks, kept", "M/s", false, 8},
    {"throughput/slot/borrowed", "  in slots, borrowed / one-line ring", "ratio", true, 2},
    {"throughput/slot/kept", "  in slots, kept / one-line ring", "ratio", true, 3},
};

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return (*middle + *std::max_element(values.begin(), middle)) / 2;
}

/// The 95 % interval of the median, by bootstrap with a fixed seed.
std::pair<double, double> interval(const std::vector<double>& values) {
  constexpr std::size_t kResamples = 1000;
  std::mt19937_64 random(1);
  std::uniform_int_distribution<std::size_t> any(0, values.size() - 1);
  std::vector<double> medians;
  std::vector<double> sample(values.size());
  for (std::size_t n = 0; n < kResamples; ++n) {
    for (double& v : sample) v = values[any(random)];
    medians.push_back(median(sample));
  }
  std::sort(medians.begin(), medians.end());
  return {medians[kResamples / 40], medians[kResamples - 1 - kResamples / 40]};
}

/// The console, and behind it the table of figures. With repetitions: their medians.
class Table final : public benchmark::ConsoleReporter {
 public:
  using ConsoleReporter::ConsoleReporter;

  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs) {
      if (run.run_type != Run::RT_Iteration || run.error_occurred) continue;
      for (const auto& [name, counter] : run.counters) {
        seen_[run.run_name.function_name + ' ' + name].push_back(counter.value);
      }
    }
  }

  void Finalize() override {
    ConsoleReporter::Finalize();
    std::printf("\n%-42s %9s %17s %10s  %s\n", "figure", "reached", "95 %", "target", "met");
    for (const Figure& f : kFigures) {
      const auto value = [&](const char* counter) {
        return median(seen_[std::string(f.benchmark) + ' ' + counter]);
      };
      const double reached = value(f.counter);
      if (reached == 0) continue;  // not run
      const bool met = f.at_most ? reached <= f.target : reached >= f.target;
      std::printf("%-42s %9.2f %8.2f ..%6.2f %4s %6.2f  %s\n", f.text, reached, value("lo"),
                  value("hi"), f.at_most ? "<=" : ">=", f.target, met ? "yes" : "no");
    }
  }

 private:
  std::map<std::string, std::vector<double>> seen_;
};

cpu_set_t affinity() {
  cpu_set_t set;
  expect(sched_getaffinity(0, sizeof(set), &set) == 0, "sched_getaffinity");
  return set;
}
const cpu_set_t& affinity_at_start() {
  static const cpu_set_t set = affinity();
  return set;
}

std::string segment_name;  // of this run; children inherit it
std::string segment_files[2];

/// Interrupted: the children die with us, and nobody is left to remove the segment.
void sweep(int signal) {
  for (const std::string& file : segment_files) unlink(file.c_str());
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

/// Names the segment for this run alone, or as LOT_SEGMENT says.
void name_segment() {
  segment_name = "lot_micro_" + std::to_string(getpid());
  {
    const lot::ShmEngine engine(segment());
    segment_files[0] = engine.path();
  }
  segment_files[1] = segment_files[0] + ".lock";
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGABRT}) std::signal(signal, sweep);
}

/// A benchmark that leaves something behind has failed.
bool swept() {
  for (const std::string& file : segment_files) {
    if (access(file.c_str(), F_OK) != 0) continue;
    std::fprintf(stderr, "lot_micro: %s is still there\n", file.c_str());
    return false;
  }
  return true;
}

}  // namespace

void expect(bool good, const char* what) {
  if (good) [[likely]]
    return;
  std::fprintf(stderr, "lot_micro[%d]: failed: %s\n", static_cast<int>(getpid()), what);
  std::abort();
}

lot::EngineOptions segment() {
  lot::EngineOptions options;
  options.segment = segment_name;
  return options;
}

unsigned cores() { return static_cast<unsigned>(CPU_COUNT(&affinity_at_start())); }

void pin(unsigned which) {
  cpu_set_t set;
  CPU_ZERO(&set);
  for (int cpu = 0; cpu < CPU_SETSIZE; ++cpu) {
    if (CPU_ISSET(cpu, &affinity_at_start()) && which-- == 0) CPU_SET(cpu, &set);
  }
  expect(sched_setaffinity(0, sizeof(set), &set) == 0, "sched_setaffinity");
}

void unpin() {
  expect(sched_setaffinity(0, sizeof(cpu_set_t), &affinity_at_start()) == 0, "sched_setaffinity");
}

bool needs_two_cores(benchmark::State& state) {
  if (cores() >= 2) return true;
  state.SkipWithError("needs two cores");
  return false;
}

Companion::Companion(const std::function<void(Companion&)>& body) {
  unpin();
  child_ = fork();
  expect(child_ >= 0, "fork");
  if (child_ > 0) return;
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGABRT}) std::signal(signal, SIG_DFL);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() == 1) _exit(1);  // the parent has died already
  body(*this);
  _exit(0);
}

Companion::~Companion() {
  tell(kStop);
  int status = 0;
  expect(waitpid(child_, &status, 0) == child_ && status == 0, "the second process failed");
  unpin();
}

std::chrono::nanoseconds Companion::cpu_time() const {
  clockid_t clock{};
  timespec used{};
  expect(clock_getcpuclockid(child_, &clock) == 0 && clock_gettime(clock, &used) == 0,
         "the processor time of the second process");
  return std::chrono::seconds(used.tv_sec) + std::chrono::nanoseconds(used.tv_nsec);
}

void Companion::meet() {
  ++meetings_;
  auto& mine = page_->came[child_ == 0];
  auto& other = page_->came[child_ != 0];
  mine.store(meetings_, std::memory_order_release);
  syscall(SYS_futex, &mine, FUTEX_WAKE, 1, nullptr, nullptr, 0);
  for (;;) {
    const std::uint32_t seen = other.load(std::memory_order_acquire);
    if (static_cast<std::int32_t>(seen - meetings_) >= 0) return;
    const timespec limit{1, 0};
    syscall(SYS_futex, &other, FUTEX_WAIT, seen, &limit, nullptr, 0);
    // The last thing it does may be to come here: it is reaped where it is awaited.
    siginfo_t ended{};
    expect(
        child_ == 0 ||
            (waitid(P_PID, static_cast<id_t>(child_), &ended, WEXITED | WNOHANG | WNOWAIT) == 0 &&
             ended.si_pid == 0) ||
            static_cast<std::int32_t>(other.load(std::memory_order_acquire) - meetings_) >= 0,
        "the second process has died");
  }
}

void Companion::tell(std::uint64_t order) {
  page_->order = order;
  meet();
}

std::uint64_t Companion::hear() {
  meet();
  return page_->order;
}

void Rounds::report(benchmark::State& state) const {
  if (arm_.empty()) return;
  std::vector<double> ratios;
  for (std::size_t i = 0; i < arm_.size(); ++i) ratios.push_back(arm_[i] / floor_[i]);
  const auto [lo, hi] = interval(ratios);
  state.counters["ratio"] = median(ratios);
  state.counters["lo"] = lo;
  state.counters["hi"] = hi;
  state.counters["arm_ns"] = median(arm_);
  state.counters["floor_ns"] = median(floor_);
}

void Rounds::report_faster(benchmark::State& state) const {
  report(state);
  const auto inverse = [&](const char* name) { return 1 / state.counters[name]; };
  const double lo = inverse("hi");
  const double hi = inverse("lo");
  state.counters["faster"] = inverse("ratio");
  state.counters["lo"] = lo;
  state.counters["hi"] = hi;
}

void Rounds::report_difference(benchmark::State& state) const {
  report(state);
  std::vector<double> more;
  for (std::size_t i = 0; i < arm_.size(); ++i) more.push_back((arm_[i] - floor_[i]) / 1000);
  if (more.empty()) return;
  const auto [lo, hi] = interval(more);
  state.counters["more_us"] = median(more);
  state.counters["lo"] = lo;
  state.counters["hi"] = hi;
}

void Rounds::report_with_rate(benchmark::State& state) const {
  report(state);
  if (!arm_.empty()) state.counters["M/s"] = 1000 / median(arm_);
}

void Rounds::report_rate(benchmark::State& state) const {
  report_with_rate(state);
  std::vector<double> rates;
  for (const double ns : arm_) rates.push_back(1000 / ns);
  if (rates.empty()) return;
  const auto [lo, hi] = interval(rates);
  state.counters["lo"] = lo;
  state.counters["hi"] = hi;
}

}  // namespace bench

int main(int argc, char** argv) {
  using namespace bench;
  affinity_at_start();
  name_segment();
  std::thread([] {}).join();  // from now on std::shared_ptr counts atomically
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  Table table;
  benchmark::RunSpecifiedBenchmarks(&table);
  benchmark::Shutdown();
  return swept() ? 0 : 1;
}
