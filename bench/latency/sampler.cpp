// SPDX-License-Identifier: Apache-2.0
#include "sampler.hpp"

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <linux/perf_event.h>
#include <map>
#include <memory>
#include <string>
#include <sys/syscall.h>
#include <sys/time.h>
#include <ucontext.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include <cxxabi.h>
#include <elfutils/libdwfl.h>

#include "throw_errno.hpp"

namespace ab {
namespace {

constexpr std::uint32_t kMost = 1 << 18;  // more than four minutes of one core
constexpr std::uint64_t kWaiting = std::uint64_t{1} << 63;

std::atomic<std::uint32_t> count{0};
std::unique_ptr<std::uint64_t[]> counters;
std::atomic<bool> waiting{false};

void take(int, siginfo_t*, void* context) {
  const std::uint32_t n = count.fetch_add(1, std::memory_order_relaxed);
  if (n >= kMost) return;
  const auto& registers = static_cast<ucontext_t*>(context)->uc_mcontext;
#if defined(__x86_64__)
  const auto at = static_cast<std::uint64_t>(registers.gregs[REG_RIP]);
#elif defined(__aarch64__)
  const auto at = static_cast<std::uint64_t>(registers.pc);
#else
#error "where is the program counter here?"
#endif
  counters[n] = at | (waiting.load(std::memory_order_relaxed) ? kWaiting : 0);
}

constexpr int kPeriodUs = 1000;

void set_timer(long microseconds) {
  itimerval timer{};
  timer.it_interval.tv_usec = microseconds;
  timer.it_value.tv_usec = microseconds;
  setitimer(ITIMER_PROF, &timer, nullptr);
}

/// Clocks of the processor time of each thread that there is, which send it SIGPROF.
std::vector<int> clocks;

/// -1: this system does not let us.
int try_start_clock(pid_t thread) {
  perf_event_attr clock{};
  clock.size = sizeof clock;
  clock.type = PERF_TYPE_SOFTWARE;
  clock.config = PERF_COUNT_SW_TASK_CLOCK;
  clock.sample_period = kPeriodUs * 1000;
  clock.wakeup_events = 1;
  const long opened = syscall(SYS_perf_event_open, &clock, thread, -1, -1, PERF_FLAG_FD_CLOEXEC);
  const int fd = static_cast<int>(opened);
  const f_owner_ex owner{F_OWNER_TID, thread};
  if (fd == -1 || (fcntl(fd, F_SETSIG, SIGPROF) == 0 && fcntl(fd, F_SETOWN_EX, &owner) == 0 &&
                   fcntl(fd, F_SETFL, O_ASYNC | O_NONBLOCK) == 0)) {
    return fd;
  }
  close(fd);
  return -1;
}

void stop_clocks() {
  for (const int fd : clocks) close(fd);
  clocks.clear();
}

bool try_start_clocks() {
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/task")) {
    const int fd = try_start_clock(std::stoi(entry.path().filename()));
    if (fd == -1) {
      stop_clocks();
      return false;
    }
    clocks.push_back(fd);
  }
  return true;
}

std::string demangled(const char* name) {
  int status = 0;
  const std::unique_ptr<char, void (*)(void*)> text(
      abi::__cxa_demangle(name, nullptr, nullptr, &status), std::free);
  std::string whole = status == 0 ? text.get() : name;
  if (status != 0) whole.resize(std::min(whole.size(), whole.find('@')));  // send@@GLIBC_2.2.5
  if (const auto arguments = whole.find('(');
      arguments != std::string::npos && arguments > 0 && whole.rfind("(anonymous", 0) != 0) {
    // Up to the argument list; "(anonymous namespace)" is no argument list.
    const auto last = whole.rfind('(');
    if (whole.compare(last, 10, "(anonymous") != 0) whole.resize(last);
  }
  return whole;
}

/// Names of this process's own functions.
class Symbols {
 public:
  Symbols() : dwfl_(dwfl_begin(&kCallbacks)) {
    if (dwfl_ == nullptr) return;
    dwfl_report_begin(dwfl_);
    dwfl_linux_proc_report(dwfl_, getpid());
    dwfl_report_end(dwfl_, nullptr, nullptr);
  }
  ~Symbols() {
    if (dwfl_ != nullptr) dwfl_end(dwfl_);
  }
  Symbols(const Symbols&) = delete;
  Symbols& operator=(const Symbols&) = delete;

  std::string of(std::uint64_t at) const {
    // The C library has no names for what it chooses at start-up; all of them are near.
    for (const auto& [function, name] : copying()) {
      if (at >= function && at < function + 2048) return name;
    }
    Dwfl_Module* const module = dwfl_ != nullptr ? dwfl_addrmodule(dwfl_, at) : nullptr;
    if (module == nullptr) return "?";
    GElf_Off offset = 0;
    GElf_Sym symbol{};
    const char* const name =
        dwfl_module_addrinfo(module, at, &offset, &symbol, nullptr, nullptr, nullptr);
    if (name != nullptr && (symbol.st_size == 0 || offset < symbol.st_size)) return demangled(name);
    const char* const path =
        dwfl_module_info(module, nullptr, nullptr, nullptr, nullptr, nullptr, nullptr, nullptr);
    const char* const slash = path != nullptr ? std::strrchr(path, '/') : nullptr;
    return std::string("? in ") + (slash != nullptr ? slash + 1 : "?");
  }

 private:
  static std::vector<std::pair<std::uint64_t, const char*>> copying() {
    void* (*volatile copy)(void*, const void*, std::size_t) = std::memcpy;
    void* (*volatile move)(void*, const void*, std::size_t) = std::memmove;
    void* (*volatile set)(void*, int, std::size_t) = std::memset;
    return {{reinterpret_cast<std::uint64_t>(copy), "memcpy"},
            {reinterpret_cast<std::uint64_t>(move), "memcpy"},
            {reinterpret_cast<std::uint64_t>(set), "memset"}};
  }

  static constexpr Dwfl_Callbacks kCallbacks{dwfl_linux_proc_find_elf, dwfl_standard_find_debuginfo,
                                             nullptr, nullptr};
  Dwfl* dwfl_;
};

}  // namespace

void sampler_waiting(bool yes) noexcept { waiting.store(yes, std::memory_order_relaxed); }

void start_sampler() {
  if (!counters) {
    counters = std::make_unique<std::uint64_t[]>(kMost);  // touched: the handler takes no fault
    struct sigaction action {};
    action.sa_sigaction = take;
    action.sa_flags = SA_SIGINFO | SA_RESTART;
    if (sigaction(SIGPROF, &action, nullptr) != 0) {
      throw_errno("SIGPROF");
    }
  }
  // The interval timer is asked only when the kernel's clock ticks: few samples of who runs
  // shortly.
  if (!try_start_clocks()) set_timer(kPeriodUs);
}

void stop_sampler() {
  stop_clocks();
  set_timer(0);
}

std::string sampled() {
  const Symbols symbols;
  std::map<std::pair<std::string, bool>, std::uint64_t> found;
  const std::uint32_t n = std::min(count.load(), kMost);
  std::map<std::uint64_t, std::uint64_t> at;
  for (std::uint32_t i = 0; i < n; ++i) ++at[counters[i]];
  for (const auto& [counter, times] : at) {
    found[{symbols.of(counter & ~kWaiting), (counter & kWaiting) != 0}] += times;
  }
  std::vector<std::pair<std::uint64_t, std::pair<std::string, bool>>> order;
  order.reserve(found.size());
  for (const auto& [what, times] : found) order.emplace_back(times, what);
  std::sort(order.rbegin(), order.rend());
  std::string text;
  for (const auto& [times, what] : order) {
    text += std::to_string(times) + (what.second ? " 1 " : " 0 ") + what.first + "\n";
  }
  return text;
}

}  // namespace ab
