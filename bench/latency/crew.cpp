// SPDX-License-Identifier: Apache-2.0
#include "crew.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fcntl.h>
#include <filesystem>
#include <poll.h>
#include <sched.h>
#include <stdexcept>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include "node.hpp"
#include "throw_errno.hpp"

namespace ab {
namespace {

using namespace std::chrono_literals;

std::string self() { return std::filesystem::read_symlink("/proc/self/exe"); }

/// Replaces this process; only after fork().
[[noreturn]] void become(const std::vector<std::string>& command) {
  std::vector<char*> arguments;
  arguments.reserve(command.size() + 1);
  for (const std::string& c : command) arguments.push_back(const_cast<char*>(c.c_str()));
  arguments.push_back(nullptr);
  execvp(arguments[0], arguments.data());
  std::fprintf(stderr, "lot_ab: %s: %s\n", arguments[0], std::strerror(errno));
  _exit(127);
}

std::string end_of(int status) {
  return WIFSIGNALED(status) ? std::string("killed by signal ") + std::to_string(WTERMSIG(status))
                             : "exit status " + std::to_string(WEXITSTATUS(status));
}

int wait_for(pid_t pid) {
  int status = 0;
  while (waitpid(pid, &status, 0) == -1 && errno == EINTR) {
  }
  return status;
}

bool finds(const char* program) {
  const char* const path = std::getenv("PATH");
  for (std::string rest = path != nullptr ? path : "/usr/bin:/bin"; !rest.empty();) {
    const auto colon = rest.find(':');
    if (access((rest.substr(0, colon) + "/" + program).c_str(), X_OK) == 0) return true;
    rest = colon == std::string::npos ? "" : rest.substr(colon + 1);
  }
  return false;
}

/// What a command in a container begins with.
std::vector<std::string> container_in(const std::string& directory) {
  return {"bwrap",
          "--ro-bind",
          "/",
          "/",
          "--dev",
          "/dev",
          "--bind",
          directory,
          "/dev/shm",
          "--tmpfs",
          "/tmp",
          "--proc",
          "/proc",
          "--unshare-pid",
          "--unshare-ipc",
          "--unshare-uts",
          "--unshare-net",
          "--die-with-parent"};
}

/// Runs a command to its end. Returns "" when it has succeeded; else the first line that it said.
std::string complaint_of(const std::vector<std::string>& command) {
  int said[2] = {-1, -1};
  if (pipe2(said, O_CLOEXEC) != 0) throw_errno("pipe");
  std::fflush(nullptr);
  const pid_t pid = fork();
  if (pid == -1) throw_errno("fork");
  if (pid == 0) {
    setpgid(0, 0);  // Ctrl-C is ours to deal with
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(said[1], STDOUT_FILENO);
    dup2(said[1], STDERR_FILENO);
    become(command);
  }
  close(said[1]);
  std::string text;
  char piece[256];
  for (ssize_t n = 0; (n = read(said[0], piece, sizeof piece)) > 0 || (n == -1 && errno == EINTR);)
    text.append(piece, n > 0 ? static_cast<std::size_t>(n) : 0);
  close(said[0]);
  const int status = wait_for(pid);
  if (status == 0) return "";
  return text.empty() ? command[0] + ": " + end_of(status) : text.substr(0, text.find('\n'));
}

/// Tries to make a container. Returns "", or why there is none.
std::string refused_container() {
  std::vector<std::string> command = container_in("/dev/shm");
  command.emplace_back("true");
  const std::string why = complaint_of(command);
  return why.empty() ? "" : "no containers here: " + why;
}

/// Tries to make the ends of a link in a network of its own, and to enter that. Returns "", or why
/// it cannot be done.
std::string refused_link() {
  int told[2] = {-1, -1};
  if (pipe2(told, O_CLOEXEC) != 0) throw_errno("pipe");
  std::fflush(nullptr);
  const pid_t pid = fork();
  if (pid == -1) throw_errno("fork");
  if (pid == 0) {
    setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    const int error = unshare(CLONE_NEWNET) == 0 ? 0 : errno;
    if (write(told[1], &error, sizeof error) == sizeof error) pause();
    _exit(1);
  }
  close(told[1]);
  int error = EIO;
  if (read(told[0], &error, sizeof error) != sizeof error) error = EIO;
  close(told[0]);
  const std::string there = std::to_string(pid);
  std::string why = error == 0 ? "" : std::string("unshare: ") + std::strerror(error);
  if (why.empty()) {
    why = complaint_of({"ip", "link", "add", "to0", "netns", there, "type", "veth", "peer", "name",
                        "from0", "netns", there});
  }
  if (why.empty()) {
    why = complaint_of({"nsenter", "-t", there, "-n", "ip", "link", "set", "to0", "up"});
  }
  kill(pid, SIGKILL);
  wait_for(pid);
  return why.empty() ? "" : "no network between containers here: " + why;
}

/// Each link between two containers has a network of its own; containers hide them from each other
/// and from the system.
std::string network_of(unsigned publisher, unsigned subscriber) {
  return "10." + std::to_string(publisher + 1) + "." + std::to_string(subscriber + 1) + ".";
}

void run_threads(Board& board, const Plan& plan, const std::vector<unsigned>& nodes,
                 std::atomic<int>& status) {
  std::vector<std::thread> threads;
  threads.reserve(nodes.size());
  for (const unsigned node : nodes) {
    threads.emplace_back([&, node] {
      if (run_node(board, plan, node) != 0) status = 1;
    });
  }
  for (std::thread& t : threads) t.join();
}

/// And waits for all of it: while a node dies it still has its files locked.
void kill_group(pid_t group) {
  kill(-group, SIGKILL);
  while (waitpid(-group, nullptr, 0) != -1 || errno == EINTR) {
  }
}

int run_processes(Board& board, const Plan& plan, const std::vector<unsigned>& nodes) {
  const pid_t me = getpid();
  std::vector<std::pair<pid_t, unsigned>> children;
  for (const unsigned node : nodes) {
    std::fflush(nullptr);
    const pid_t pid = fork();
    if (pid == -1) throw_errno("fork");
    if (pid == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      if (getppid() != me) _exit(1);
      _exit(run_node(board, plan, node));
    }
    children.emplace_back(pid, node);
  }
  int result = 0;
  for (std::size_t left = children.size(); left > 0;) {
    int status = 0;
    const pid_t pid = wait(&status);
    if (pid == -1 && errno == EINTR) continue;
    if (pid == -1) throw_errno("wait");
    const auto at = std::find_if(children.begin(), children.end(),
                                 [pid](const auto& child) { return child.first == pid; });
    if (at == children.end()) continue;  // somebody else's
    --left;
    if (status == 0) continue;
    NodeRecord& record = board.node(at->second);
    if (record.state.load() != NodeState::Failed) {
      std::snprintf(record.error, sizeof record.error, "%s", end_of(status).c_str());
      record.state.store(NodeState::Failed);
    }
    result = 1;
    board.head().arrivals.raise();
  }
  return result;
}

}  // namespace

int run_group(int fd, unsigned arm, unsigned group) {
  Board board(fd);
  const Plan plan = nlohmann::json::parse(board.plan()).get<Plan>();
  const ArmPlan& mine = plan.arms.at(arm);
  const auto goes_on = [&board] { return board.head().stop.load() == 0; };
  if (!board.arm(arm).network.wait_for(1, goes_on)) return 0;
  const Transport* const transport = find_transport(mine.transport);
  if (transport != nullptr && transport->threads) {
    std::atomic<int> status{0};
    run_threads(board, plan, mine.groups.at(group), status);
    return status;
  }
  return run_processes(board, plan, mine.groups.at(group));
}

void must_run(const std::vector<std::string>& command) {
  std::fflush(nullptr);
  const pid_t pid = fork();
  if (pid == -1) throw_errno("fork");
  if (pid == 0) {
    setpgid(0, 0);  // Ctrl-C is ours to deal with
    become(command);
  }
  const int status = wait_for(pid);
  if (status == 0) return;
  std::string text;
  for (const std::string& c : command) text += c + " ";
  throw std::runtime_error(text + ": " + end_of(status));
}

Crew::Crew(const Board& board, const Plan& plan, unsigned arm, Place place,
           const std::string& directory)
    : board_(board), arm_(arm) {
  prctl(PR_SET_CHILD_SUBREAPER, 1);  // nodes whose group's leader is killed are ours to wait for
  try {
    const ArmPlan& mine = plan.arms[arm];
    for (unsigned g = 0; g < mine.groups.size(); ++g) start(g, place, directory);
    if (place == Place::Containers && !mine.streams[0].stream.address.empty()) connect(plan);
    board.arm(arm).network.set(1);
  } catch (...) {
    kill_all();
    throw;
  }
}

Crew::~Crew() { kill_all(); }

void Crew::kill_all() {
  for (Member& m : members_) {
    if (m.pid == -1) continue;
    kill_group(m.pid);
    m.pid = -1;
  }
}

void Crew::start(unsigned group, Place place, const std::string& directory) {
  const std::vector<std::string> inner{self(), "group", std::to_string(board_.fd()),
                                       std::to_string(arm_), std::to_string(group)};
  std::vector<std::string> command;
  int told[2] = {-1, -1};
  if (place != Place::Host) {
    if (pipe(told) != 0) throw_errno("pipe");
    fcntl(told[0], F_SETFD, FD_CLOEXEC);
    command = container_in(directory);
    command.insert(command.end(), {"--info-fd", std::to_string(told[1])});
  }
  command.insert(command.end(), inner.begin(), inner.end());
  std::fflush(nullptr);
  const pid_t me = getpid();
  const pid_t pid = fork();
  if (pid == -1) throw_errno("fork");
  if (pid == 0) {
    setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != me) _exit(1);
    // What is asked of the library is said in code, for every node alike.
    for (const char* name : {"LOT_SEGMENT", "LOT_DIR", "LOT_SIZE", "LOT_PERMISSIONS", "LOT_PERSIST",
                             "LOT_MLOCK", "LOT_QUEUE", "LOT_STAMP"}) {
      unsetenv(name);
    }
    become(command);
  }
  setpgid(pid, pid);
  members_.push_back({pid, -1});
  if (place == Place::Host) return;
  close(told[1]);
  std::string text;
  char c = 0;
  pollfd ready{told[0], POLLIN, 0};
  while (poll(&ready, 1, 10'000) > 0 && read(told[0], &c, 1) == 1) text += c;
  close(told[0]);
  const auto info = nlohmann::json::parse(text, nullptr, false);
  if (info.is_discarded() || !info.contains("child-pid")) {
    throw std::runtime_error("bubblewrap could not make a container (see above)");
  }
  members_.back().inside = info["child-pid"].get<pid_t>();
}

void Crew::connect(const Plan& plan) {
  const ArmPlan& mine = plan.arms[arm_];
  // A group is one node here.
  const auto inside = [&](Role role, unsigned stream, unsigned index) {
    for (std::size_t g = 0; g < mine.groups.size(); ++g) {
      const NodePlan& n = plan.nodes[mine.groups[g][0]];
      if (n.role == role && n.stream == stream && n.index == index) return members_[g].inside;
    }
    throw std::logic_error("a node is in no group");
  };
  const auto in = [](pid_t pid, std::vector<std::string> command) {
    std::vector<std::string> whole{"nsenter", "-t", std::to_string(pid), "-n"};
    whole.insert(whole.end(), command.begin(), command.end());
    must_run(whole);
  };
  // Ping-pong goes back over the link on which it came.
  const std::size_t streams = plan.mode == "ping-pong" ? 1 : mine.streams.size();
  for (unsigned s = 0; s < streams; ++s) {
    const Stream& stream = mine.streams[s].stream;
    for (unsigned p = 0; p < stream.publishers; ++p) {
      for (unsigned r = 0; r < stream.subscribers; ++r) {
        const pid_t from = inside(Role::Publish, s, p);
        const pid_t to = inside(Role::Subscribe, s, r);
        const std::string here = "to" + std::to_string(r);
        const std::string there = "from" + std::to_string(p);
        must_run({"ip", "link", "add", here, "netns", std::to_string(from), "type", "veth", "peer",
                  "name", there, "netns", std::to_string(to)});
        const std::string network = network_of(p, r);
        in(from, {"ip", "addr", "add", network + "1/24", "dev", here});
        in(to, {"ip", "addr", "add", network + "2/24", "dev", there});
        in(from, {"ip", "link", "set", here, "up"});
        in(to, {"ip", "link", "set", there, "up"});
        // Every node reaches every other one of its stream, through publisher 0 or subscriber 0.
        if (p == 0) in(to, {"ip", "route", "add", "default", "via", network + "1"});
        if (r == 0) in(from, {"ip", "route", "add", "default", "via", network + "2"});
        if (r == 0 && p == 0) {
          for (const pid_t hub : {from, to}) {
            in(hub, {"sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward"});
          }
        }
      }
    }
  }
}

std::string Crew::address(Place place, unsigned publisher, unsigned subscriber, bool back) {
  if (place != Place::Containers) return "127.0.0.1";
  return network_of(publisher, subscriber) + (back ? "2" : "1");
}

std::string Crew::unavailable(Place place, bool network) {
  if (place == Place::Host) return "";
  if (!finds("bwrap")) return "containers need bubblewrap (Debian: bubblewrap)";
  static const std::string no_container = refused_container();
  if (!no_container.empty() || place != Place::Containers || !network) return no_container;
  if (geteuid() != 0) return "a network between containers needs root";
  if (!finds("ip") || !finds("nsenter")) {
    return "a network between containers needs ip and nsenter (Debian: iproute2, util-linux)";
  }
  static const std::string no_link = refused_link();
  return no_link;
}

std::string Crew::ended() {
  for (Member& m : members_) {
    if (m.pid == -1) return "has ended";
    int status = 0;
    if (waitpid(m.pid, &status, WNOHANG) != m.pid) continue;
    kill_group(m.pid);  // what it started
    m.pid = -1;
    return end_of(status);
  }
  return "";
}

void Crew::join() {
  const auto until = std::chrono::steady_clock::now() + 20s;
  for (Member& m : members_) {
    while (m.pid != -1) {
      if (waitpid(m.pid, nullptr, WNOHANG) == m.pid) {
        m.pid = -1;
      } else if (std::chrono::steady_clock::now() > until) {
        break;  // the destructor kills it
      } else {
        std::this_thread::sleep_for(2ms);
      }
    }
  }
}

}  // namespace ab
