// SPDX-License-Identifier: Apache-2.0
#include "namespaces.hpp"

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <sched.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <system_error>
#include <unistd.h>

namespace lot::chaos {
namespace {

std::string reason(const char* what) { return std::string(what) + ": " + std::strerror(errno); }

volatile pid_t supervised = 0;

/// Outside of the user namespace: passes signals on, and ends as the supervisor does.
[[noreturn]] void wait_outside(pid_t child) {
  supervised = child;
  for (const int s : {SIGINT, SIGTERM, SIGHUP}) {
    signal(s, [](int number) { kill(supervised, number); });
  }
  int status = 0;
  while (waitpid(child, &status, 0) == -1 && errno == EINTR) {
  }
  _exit(WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status));
}

}  // namespace

Namespaces::~Namespaces() {
  if (own_ != -1) close(own_);
}

std::string Namespaces::enter() {
  if (!wanted_) return "";
  if (unshare(CLONE_NEWPID) == -1) {
    if (errno != EPERM) return reason("unshare(CLONE_NEWPID)");
    if (const std::string why = enter_user_namespace(); !why.empty()) return why;
  }
  own_ = open("/proc/self/ns/pid", O_RDONLY | O_CLOEXEC);
  if (own_ == -1 || setns(own_, CLONE_NEWPID) == -1) return reason("/proc/self/ns/pid");
  return "";
}

std::string Namespaces::enter_user_namespace() {
  const uid_t uid = getuid();
  const gid_t gid = getgid();
  if (unshare(CLONE_NEWUSER | CLONE_NEWPID | CLONE_NEWNS) == -1)
    return reason("unshare(CLONE_NEWUSER)");
  std::ofstream("/proc/self/setgroups") << "deny";
  std::ofstream("/proc/self/uid_map") << uid << ' ' << uid << " 1";
  std::ofstream("/proc/self/gid_map") << gid << ' ' << gid << " 1";
  std::fflush(nullptr);
  const pid_t child = ::fork();
  if (child == -1) return reason("fork");
  if (child > 0) wait_outside(child);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  // Of our own PIDs, to say who is stuck where; the tests themselves do not need it.
  (void)mount("proc", "/proc", "proc", 0, nullptr);
  return "";
}

pid_t Namespaces::fork() {
  if (wanted_ && (setns(own_, CLONE_NEWPID) == -1 || unshare(CLONE_NEWPID) == -1)) {
    throw std::system_error(errno, std::generic_category(), "a new PID namespace");
  }
  std::fflush(nullptr);
  const pid_t pid = ::fork();
  if (pid == -1) throw std::system_error(errno, std::generic_category(), "fork");
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (wanted_ && unshare(CLONE_NEWIPC | CLONE_NEWNS) == -1) std::abort();
  }
  return pid;
}

}  // namespace lot::chaos
