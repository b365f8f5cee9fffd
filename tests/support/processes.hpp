// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <bit>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>
#include <optional>
#include <poll.h>
#include <stdexcept>
#include <string>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <utility>

#include "lot/options.hpp"

#include "segment/segment.hpp"
#include "support/seed.hpp"

/// What tests with several processes need: children, pipes that tell steps, names, and an audit of
/// what a segment still holds.
namespace lot::testing {

using namespace std::chrono_literals;

/// The prefix of this test's segments: LOT_SEGMENT, which is then unset, since it would come before
/// what a test says in its EngineOptions.
inline const std::string& prefix() {
  static const std::string text = [] {
    const char* v = std::getenv("LOT_SEGMENT");
    std::string p = v != nullptr && *v != '\0' ? v : "lottest";
    for (const char* name : {"LOT_SEGMENT", "LOT_DIR", "LOT_SIZE", "LOT_PERMISSIONS", "LOT_PERSIST",
                             "LOT_MLOCK", "LOT_STAMP"}) {
      unsetenv(name);
    }
    return p + "_" + std::to_string(getpid());
  }();
  return text;
}

inline std::string unique_name() {
  static std::atomic<unsigned> n{0};
  return prefix() + "_" + std::to_string(n++);
}

/// Options of a new segment of its own.
inline EngineOptions fresh(std::uint64_t size_bytes = 64 << 20) {
  EngineOptions options;
  options.segment = unique_name();
  options.size_bytes = size_bytes;
  return options;
}

/// How many files of this segment there are (the lock file and unfinished ones too).
inline std::size_t files_of(const EngineOptions& options) {
  std::size_t n = 0;
  for (const auto& entry : std::filesystem::directory_iterator(options.directory)) {
    const std::string name = entry.path().filename();
    n += name == options.segment || name.rfind(options.segment + ".", 0) == 0;
  }
  return n;
}

/// Removes what `persist` has kept. REQUIRES: no process is in the segment.
inline void remove_files_of(const EngineOptions& options) {
  for (const char* suffix : {"", ".lock"}) {
    std::filesystem::remove(options.directory + "/" + options.segment + suffix);
  }
}

/// Kills the test when it hangs: times are never asserted.
class Watchdog {
 public:
  explicit Watchdog(unsigned seconds) { alarm(seconds); }
  ~Watchdog() { alarm(0); }
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;
};

/// Looks until `condition` holds; false when `most` has passed.
template <class Condition>
bool eventually(Condition&& condition, std::chrono::nanoseconds most = 10s) {
  const auto until = std::chrono::steady_clock::now() + most;
  while (!condition()) {
    if (std::chrono::steady_clock::now() >= until) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

/// The assertion of child processes, where doctest's would be lost.
[[gnu::noinline]] inline void must(bool condition, const char* what) {
  if (!condition) throw std::runtime_error(std::string("child: not so: ") + what);
}

/// Steps that one process tells another, a byte each.
class Steps {
 public:
  Steps() {
    if (pipe(fd_) != 0) throw std::runtime_error("pipe");
  }
  ~Steps() {
    close(fd_[0]);
    close(fd_[1]);
  }
  Steps(const Steps&) = delete;
  Steps& operator=(const Steps&) = delete;

  void tell(char step = '.') const { must(write(fd_[1], &step, 1) == 1, "a step was told"); }
  /// Makes an end (0: to read, 1: to write) descriptor `as` of this process, for another program.
  void become(int end, int as) const { must(dup2(fd_[end], as) == as, "dup2"); }
  /// The next step; 0 when none came in time.
  char next(std::chrono::milliseconds most = 20s) const {
    pollfd p{fd_[0], POLLIN, 0};
    char step = 0;
    int result;
    do {
      result = poll(&p, 1, static_cast<int>(most.count()));
    } while (result == -1 && errno == EINTR);
    return result == 1 && read(fd_[0], &step, 1) == 1 ? step : '\0';
  }

 private:
  int fd_[2];
};

/// A forked process. It dies with its parent's thread, with this object, or after a minute.
class Child {
 public:
  Child() = default;
  template <class F>
  explicit Child(F&& f) {
    std::fflush(nullptr);
    const pid_t parent = getpid();
    pid_ = fork();
    if (pid_ == -1) throw std::runtime_error("fork");
    if (pid_ != 0) return;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(3);
    signal(SIGALRM, SIG_DFL);
    alarm(60);
    // doctest's handlers belong to the parent.
    for (const int s : {SIGSEGV, SIGABRT, SIGFPE, SIGILL, SIGTERM, SIGINT}) signal(s, SIG_DFL);
    try {
      f();
    } catch (const std::exception& e) {
      std::fprintf(stderr, "[%d] %s\n", static_cast<int>(getpid()), e.what());
      _exit(2);
    }
    _exit(0);
  }
  Child(Child&& other) noexcept : pid_(std::exchange(other.pid_, -1)) {}
  Child& operator=(Child&& other) noexcept {
    if (this != &other) {
      end();
      pid_ = std::exchange(other.pid_, -1);
    }
    return *this;
  }
  ~Child() { end(); }

  pid_t pid() const { return pid_; }
  /// Nothing when it has ended: kill(-1) would mean every process there is.
  void send(int signal) const {
    if (pid_ > 0) ::kill(pid_, signal);
  }
  /// kill -9, and waits until it is dead.
  void kill9() {
    send(SIGKILL);
    wait();
  }
  /// Its exit status; 128 + n when signal n ended it.
  int wait() {
    if (pid_ <= 0) return -1;
    int status = 0;
    while (waitpid(std::exchange(pid_, -1), &status, 0) == -1 && errno == EINTR) {
    }
    return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
  }
  bool ended(int& status) {
    int raw = 0;
    if (pid_ <= 0 || waitpid(pid_, &raw, WNOHANG) != pid_) return false;
    pid_ = -1;
    status = WIFSIGNALED(raw) ? 128 + WTERMSIG(raw) : WEXITSTATUS(raw);
    return true;
  }

 private:
  void end() {
    if (pid_ > 0) kill9();
  }
  pid_t pid_ = -1;
};

/// What a segment holds at this moment. Everything but `participants` must be zero when nobody
/// publishes, reads or keeps anything.
struct Audit {
  std::size_t homes = 0;         ///< blocks that somebody owns
  std::size_t own_bits = 0;      ///< holds, all processes together
  std::size_t granules = 0;      ///< message memory in use
  std::size_t channels = 0;      ///< rings that are not free
  std::size_t readers = 0;       ///< cells taken in rings
  std::size_t topics = 0;        ///< in use, or observed
  std::size_t participants = 0;  ///< entries taken

  explicit Audit(segment::Segment& s) {
    for (auto& block : s.blocks()) {
      homes += block.home.load() != 0;
      for (auto& word : block.own) own_bits += static_cast<std::size_t>(std::popcount(word.load()));
    }
    granules = s.granules().used();
    for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
      if (ring::writer_state(s.channels()[c].writer.load()) == ring::State::Free) continue;
      ++channels;
      const auto ring = s.ring(c);
      for (std::uint32_t i = 0; i < ring.readers && ring.who != nullptr; ++i) {
        readers += ring.who[i].load() != 0;
      }
    }
    for (auto& topic : s.topics()) {
      bool used = false;
      for (auto& word : topic.users) used |= word.load() != 0;
      for (auto& word : topic.observers) used |= word.load() != 0;
      for (auto& pullers : topic.pullers) used |= pullers.load() != 0;
      topics += used;
    }
    for (auto& entry : s.participants()) participants += entry.state.load() != 0;
  }

  bool nothing() const { return homes + own_bits + granules + channels + readers + topics == 0; }
  std::string text() const {
    return "homes " + std::to_string(homes) + ", own bits " + std::to_string(own_bits) +
           ", granules " + std::to_string(granules) + ", channels " + std::to_string(channels) +
           ", readers " + std::to_string(readers) + ", topics " + std::to_string(topics) +
           ", participants " + std::to_string(participants);
  }
};

/// Waits until the segment holds nothing; what is left, or "".
inline std::string leak_in(const std::string& path, std::chrono::nanoseconds most = 8s) {
  segment::Segment s(path);
  const bool clean = eventually([&] { return Audit(s).nothing(); }, most);
  return clean ? "" : Audit(s).text();
}

}  // namespace lot::testing
