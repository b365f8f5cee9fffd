// SPDX-License-Identifier: Apache-2.0
#include "command.hpp"

#include <array>
#include <cerrno>
#include <csignal>
#include <fcntl.h>
#include <stdexcept>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "process.hpp"

namespace demo {

Command::Command(std::vector<std::string> words) : name_(words.front()) {
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::array<int, 2> out{};
  if (pipe2(out.data(), O_CLOEXEC) == -1) {
    throw std::system_error(errno, std::generic_category(), "pipe");
  }
  pid_ = fork();
  if (pid_ == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(out[1], STDOUT_FILENO);
    execvp(argv[0], argv.data());
    _exit(127);
  }
  close(out[1]);
  fd_ = out[0];
  if (pid_ == -1) throw std::system_error(errno, std::generic_category(), "fork");
}

Command::~Command() {
  close(fd_);
  if (pid_ > 0) {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
}

std::size_t Command::read(void* to, std::size_t bytes) {
  std::size_t have = 0;
  while (have < bytes) {
    const ssize_t n = ::read(fd_, static_cast<char*>(to) + have, bytes - have);
    if (interrupted()) throw Interrupted();
    if (n == -1 && errno == EINTR) continue;
    if (n == -1) throw std::system_error(errno, std::generic_category(), name_);
    if (n == 0) break;
    have += static_cast<std::size_t>(n);
  }
  return have;
}

std::string Command::read_all() {
  std::string all;
  std::array<char, 4096> buffer;
  while (const std::size_t n = read(buffer.data(), buffer.size())) all.append(buffer.data(), n);
  return all;
}

void Command::interrupt() const { kill(pid_, SIGINT); }

void Command::finish() {
  int status = 0;
  waitpid(std::exchange(pid_, -1), &status, 0);
  if (status == 0) return;
  throw std::runtime_error(WIFEXITED(status) && WEXITSTATUS(status) == 127
                               ? name_ + " is not installed; try: scripts/setup build video"
                               : name_ + " has failed");
}

}  // namespace demo
