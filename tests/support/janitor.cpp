// SPDX-License-Identifier: Apache-2.0
#include "support/janitor.hpp"

#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <unistd.h>

#include "support/processes.hpp"

namespace lot::testing {
namespace {

int bell = -1;  ///< closed by the deaths of all who have it
pid_t test = 0;

/// Waits until everybody has gone; a byte says that the test has come to its end.
[[noreturn]] void wait_and_sweep(int ears) {
  for (const int s : {SIGINT, SIGTERM, SIGHUP, SIGQUIT}) std::signal(s, SIG_IGN);
  char end = 0;
  ssize_t n;
  do {
    n = read(ears, &end, 1);
  } while (n == -1 && errno == EINTR);
  if (n == 0) {
    std::error_code ignored;
    for (const auto& entry : std::filesystem::directory_iterator("/dev/shm", ignored)) {
      if (entry.path().filename().string().starts_with(prefix() + "_")) {
        std::filesystem::remove_all(entry, ignored);
      }
    }
  }
  _exit(0);
}

}  // namespace

bool start_janitor() {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return false;
  prefix();  // the name of the test's process, not of the janitor's
  test = getpid();
  const pid_t janitor = fork();
  if (janitor == 0) {
    close(ends[1]);
    wait_and_sweep(ends[0]);
  }
  close(ends[0]);
  bell = ends[1];
  return janitor > 0 && std::atexit([] {
                          if (getpid() == test) (void)!write(bell, ".", 1);
                        }) == 0;
}

}  // namespace lot::testing
