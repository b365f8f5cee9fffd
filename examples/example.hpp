// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include <lot/lot.hpp>

/// What the examples share: processes, and a segment of their own.
namespace example {

/// Calls `body`, which returns whether all went well, or early where Ctrl-C stops it. Returns the
/// exit code.
template <class Body>
int guarded(const char* name, Body&& body) {
  try {
    const lot::StopToken stop = lot::stop_on_signals();
    return body() || stop.stop_requested() ? 0 : 1;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s: %s\n", name, e.what());
    return 1;
  }
}

/// main(): segment lot_NAME_PID unless the caller names one.
template <class Body>
int run(const char* name, Body&& body) {
  setenv("LOT_SEGMENT", ("lot_" + std::string(name) + "_" + std::to_string(getpid())).c_str(), 0);
  std::setvbuf(stdout, nullptr, _IOLBF, BUFSIZ);
  return guarded(name, std::forward<Body>(body));
}

/// Calls `body` in a process of its own, which ends when we do.
template <class Body>
pid_t start(const char* name, Body&& body) {
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child == -1) throw std::system_error(errno, std::generic_category(), "fork");
  if (child != 0) return child;
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (getppid() != parent) _exit(1);
  const int code = guarded(name, std::forward<Body>(body));
  std::fflush(stdout);
  _exit(code);  // what we have inherited is the parent's to destroy
}

/// Waits for its end, and stops it where this process is to stop. True when all went well.
inline bool finish(pid_t child) {
  const lot::StopToken stop = lot::stop_on_signals();
  int status = -1;
  do {
    if (stop.stop_requested()) kill(child, SIGTERM);
  } while (waitpid(child, &status, 0) == -1 && errno == EINTR);
  return status == 0;
}

}  // namespace example
