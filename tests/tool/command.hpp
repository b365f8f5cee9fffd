// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <fcntl.h>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "support/neighbour.hpp"
#include "support/processes.hpp"

/// What the tests of the tool have in common: the command itself, run as anybody runs it.
namespace lot::testing {

using Json = nlohmann::json;

struct Ran {
  int exit = -1;  ///< 128 + n: ended by signal n; SIGALRM means that it hung
  std::string out;
  std::string err;
  Json json() const { return Json::parse(out); }
};

inline std::string read_all(int fd) {
  std::string text;
  char buffer[4096];
  for (;;) {
    const ssize_t n = read(fd, buffer, sizeof(buffer));
    if (n == -1 && errno == EINTR) continue;
    if (n <= 0) return text;
    text.append(buffer, static_cast<std::size_t>(n));
  }
}

/// The command, open: another user may run it where he may not come to its name.
inline int command_file() {
  static const int file = open(LOT_COMMAND, O_RDONLY | O_CLOEXEC);
  must(file != -1, LOT_COMMAND);
  return file;
}

inline Ran run_lot(std::vector<std::string> words) {
  prefix();  // takes LOT_SEGMENT and the like out of the environment
  int out[2];
  int err[2];
  must(pipe2(out, O_CLOEXEC) == 0 && pipe2(err, O_CLOEXEC) == 0, "pipes");
  std::vector<char*> arguments;
  words.insert(words.begin(), LOT_COMMAND);
  for (auto& w : words) arguments.push_back(w.data());
  arguments.push_back(nullptr);
  const pid_t pid = fork();
  must(pid != -1, "fork");
  if (pid == 0) {
    dup2(out[1], STDOUT_FILENO);
    dup2(err[1], STDERR_FILENO);
    for (const int s : {SIGALRM, SIGSEGV, SIGABRT, SIGFPE, SIGILL, SIGTERM, SIGINT}) {
      signal(s, SIG_DFL);
    }
    alarm(60);
    fexecve(command_file(), arguments.data(), environ);
    _exit(127);
  }
  close(out[1]);
  close(err[1]);
  Ran ran;
  ran.out = read_all(out[0]);
  ran.err = read_all(err[0]);
  close(out[0]);
  close(err[0]);
  int status = 0;
  while (waitpid(pid, &status, 0) == -1 && errno == EINTR) {
  }
  ran.exit = WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
  return ran;
}

/// The words that name this segment alone.
inline std::vector<std::string> on(const EngineOptions& options, std::vector<std::string> words) {
  words.insert(words.end(), {"--dir", options.directory, "--segment", options.segment});
  return words;
}

inline std::string bytes_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

inline void stop(const Child& child) {
  child.send(SIGSTOP);
  int status = 0;
  must(waitpid(child.pid(), &status, WUNTRACED) == child.pid() && WIFSTOPPED(status), "stop");
}

/// A directory of its own for segments, gone at the end.
class Room {
 public:
  Room() {
    std::string pattern = "/dev/shm/" + prefix() + "_XXXXXX";
    must(mkdtemp(pattern.data()) != nullptr, "a directory");
    path_ = pattern;
  }
  ~Room() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Room(const Room&) = delete;
  Room& operator=(const Room&) = delete;

  const std::string& path() const { return path_; }
  EngineOptions options(const std::string& name = "s") const {
    EngineOptions options;
    options.directory = path_;
    options.segment = name;
    options.size_bytes = 12 << 20;
    options.processes = 7;
    options.blocks = 512;
    options.topics = 6;
    options.channels = 64;
    options.readers = 8;
    return options;
  }
  std::size_t files() const {
    return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(path_),
                                                  std::filesystem::directory_iterator()));
  }

 private:
  std::string path_;
};

}  // namespace lot::testing
