// SPDX-License-Identifier: Apache-2.0
#include "process.hpp"

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>

namespace demo {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t signal_came = 0;

void note_signal(int) { signal_came = 1; }

void catch_signal(int number) {
  struct sigaction action {};
  action.sa_handler = note_signal;  // without SA_RESTART: whoever waits looks up
  sigaction(number, &action, nullptr);
}

[[noreturn]] void fail(const char* what) {
  throw std::system_error(errno, std::generic_category(), what);
}

std::vector<std::string> arguments(const Settings& s) {
  std::vector<std::string> words{"lot_demo",
                                 "--role=" + s.role,
                                 "--number=" + std::to_string(s.number),
                                 "--frames=" + std::to_string(s.frames),
                                 "--hz=" + std::to_string(s.hz),
                                 "--bytes=" + std::to_string(s.bytes),
                                 "--size=" + std::to_string(s.size),
                                 "--depth=" + std::to_string(s.depth),
                                 "--run=" + std::to_string(s.run),
                                 "--port=" + std::to_string(s.port),
                                 "--report-every=" + std::to_string(s.report_every),
                                 "--segment=" + s.segment};
  if (!s.input.empty()) words.push_back("--input=" + s.input);
  if (s.until_told) words.emplace_back("--until-told");
  if (s.hash) words.emplace_back("--hash");
  if (s.mutex) words.emplace_back("--mutex");
  return words;
}

}  // namespace

// ---- in the process that the user has started
// -----------------------------------------------------

void Child::tell(char word) const {
  if (write(control, &word, 1) == -1 && errno != EPIPE) fail("write to a child");
}

void Child::kill() {
  if (pid == -1) return;
  ::kill(pid, SIGKILL);
  waitpid(pid, nullptr, 0);
  pid = -1;
  close(control);
  close(reports);
}

Family::~Family() {
  on_report = nullptr;
  for (auto& [name, child] : children_) {
    if (child->pid == -1) continue;
    close(std::exchange(child->control, -1));
    ::kill(child->pid, SIGTERM);
  }
  const auto patience = Clock::now() + 3s;
  for (auto& [name, child] : children_) {
    while (child->pid != -1) {
      if (waitpid(child->pid, nullptr, WNOHANG) != 0) {
        child->pid = -1;
        close(child->reports);
      } else if (Clock::now() < patience) {
        std::this_thread::sleep_for(5ms);
      } else {
        child->kill();
      }
    }
  }
}

Child& Family::start(const std::string& name, const Settings& settings) {
  auto words = arguments(settings);
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);

  std::array<int, 2> down{};
  std::array<int, 2> up{};
  if (pipe2(down.data(), O_CLOEXEC) == -1 || pipe2(up.data(), O_CLOEXEC) == -1) fail("pipe");
  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid == -1) fail("fork");
  if (pid == 0) {
    // Dies with its parent: SIGTERM, so that it takes what it has in shared memory along.
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) _exit(1);
    dup2(down[0], STDIN_FILENO);
    dup2(up[1], STDOUT_FILENO);
    std::signal(SIGINT, SIG_IGN);  // Ctrl-C is the parent's business
    execv("/proc/self/exe", argv.data());
    _exit(127);
  }
  close(down[0]);
  close(up[1]);
  auto child = std::make_unique<Child>();
  child->name = name;
  child->pid = pid;
  child->control = down[1];
  child->reports = up[0];
  return *(children_[name] = std::move(child));
}

void Family::wait_until(const std::string& what, const std::function<bool()>& done,
                        std::chrono::seconds patience) {
  const auto deadline = Clock::now() + patience;
  while (!done()) {
    if (interrupted()) throw Interrupted();
    if (Clock::now() > deadline) throw std::runtime_error("waited in vain: " + what);
    listen(50ms);
  }
}

void Family::listen(std::chrono::milliseconds timeout) {
  std::vector<pollfd> fds;
  std::vector<Child*> who;
  for (auto& [name, child] : children_) {
    if (child->pid == -1) continue;
    fds.push_back({child->reports, POLLIN, 0});
    who.push_back(child.get());
  }
  if (poll(fds.data(), fds.size(), static_cast<int>(timeout.count())) <= 0) return;
  for (std::size_t i = 0; i < fds.size(); ++i) {
    if (fds[i].revents != 0) hear(*who[i]);
  }
  if (on_report) on_report();
}

void Family::hear(Child& child) {
  std::array<char, 65536> buffer;
  const ssize_t n = read(child.reports, buffer.data(), buffer.size());
  if (n == -1) {
    if (errno == EINTR) return;
    fail("read from a child");
  }
  if (n == 0) {
    int status = 0;
    waitpid(child.pid, &status, 0);
    child.pid = -1;
    close(child.control);
    close(child.reports);
    if (status == 0 && child.has_said("done")) return;
    if (interrupted()) throw Interrupted();
    throw std::runtime_error(child.name + " has ended " +
                             (WIFSIGNALED(status)
                                  ? "by signal " + std::to_string(WTERMSIG(status))
                                  : "with exit code " + std::to_string(WEXITSTATUS(status))));
  }
  child.unfinished_line.append(buffer.data(), static_cast<std::size_t>(n));
  std::size_t begin = 0;
  for (std::size_t end = 0; (end = child.unfinished_line.find('\n', begin)) != std::string::npos;
       begin = end + 1) {
    Json report = Json::parse(child.unfinished_line.substr(begin, end - begin));
    const auto event = report.at("event").get<std::string>();
    child.said[event] = std::move(report);
  }
  child.unfinished_line.erase(0, begin);
}

void Family::dismiss() {
  for (auto& [name, child] : children_) {
    if (child->pid != -1) child->tell(Child::kStop);
  }
  wait_until("all processes leave", [this] {
    for (auto& [name, child] : children_) {
      if (child->pid != -1) return false;
    }
    return true;
  });
}

void catch_signals() {
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) catch_signal(number);
  std::signal(SIGPIPE, SIG_IGN);
}

bool interrupted() { return signal_came != 0; }

std::string consumer_name(unsigned number) { return "consumer " + std::to_string(number); }

// ---- in a child
// -------------------------------------------------------------------------------------

Control::Control(bool leave_in_peace) {
  fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
  if (leave_in_peace) catch_signal(SIGTERM);
}

void Control::listen(int timeout_ms) {
  pollfd fd{STDIN_FILENO, POLLIN, 0};
  if (!stop_ && poll(&fd, 1, timeout_ms) > 0) {
    std::array<char, 64> words;
    const ssize_t n = read(STDIN_FILENO, words.data(), words.size());
    if (n == 0) stop_ = true;  // the parent has gone
    for (ssize_t i = 0; i < n; ++i) {
      const char word = words[static_cast<std::size_t>(i)];
      stop_ = stop_ || word == Child::kStop;
      pause_ = pause_ || word == Child::kPause;
    }
  }
  stop_ = stop_ || interrupted();
}

bool Control::stop() {
  listen(0);
  return stop_;
}

bool Control::pause() {
  listen(0);
  return pause_;
}

void Control::wait() {
  while (!stop()) listen(100);
}

void say(const std::string& event, Json more) {
  more["event"] = event;
  const std::string line = more.dump() + "\n";
  std::fwrite(line.data(), 1, line.size(), stdout);
  std::fflush(stdout);
}

namespace {
double cpu_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}
}  // namespace

CpuTime::CpuTime() : begin_(cpu_seconds()) {}
double CpuTime::seconds() const { return cpu_seconds() - begin_; }

}  // namespace demo
