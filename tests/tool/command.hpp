// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <fstream>
#include <iterator>
#include <poll.h>
#include <string>
#include <sys/mman.h>
#include <sys/prctl.h>
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

/// The command of this build, or the one that LOT_TEST_COMMAND names: scripts/test has these tests
/// run the one with AddressSanitizer, too.
inline const std::string& command() {
  static const std::string path = [] {
    const char* const other = std::getenv("LOT_TEST_COMMAND");
    return std::string(other != nullptr ? other : LOT_COMMAND);
  }();
  return path;
}

/// It is that of another build.
inline bool is_other_command() { return std::getenv("LOT_TEST_COMMAND") != nullptr; }

/// The command, open: another user may run it where he may not come to its name.
inline int command_file() {
  static const int file = open(command().c_str(), O_RDONLY | O_CLOEXEC);
  must(file != -1, command().c_str());
  return file;
}

/// Runs what `become` makes of the forked process, with these words.
template <class Become>
Ran run_by(std::vector<std::string>& words, Become&& become) {
  prefix();  // takes LOT_SEGMENT and the like out of the environment
  int out[2];
  int err[2];
  must(pipe2(out, O_CLOEXEC) == 0 && pipe2(err, O_CLOEXEC) == 0, "pipes");
  std::vector<char*> arguments;
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
    become(arguments.data());
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

inline Ran run_lot(std::vector<std::string> words) {
  words.insert(words.begin(), command());
  return run_by(words, [](char** arguments) { fexecve(command_file(), arguments, environ); });
}

/// Another program, which the shell would find.
inline Ran run_program(std::vector<std::string> words) {
  return run_by(words, [](char** arguments) { execvp(arguments[0], arguments); });
}

/// The command, as long as it runs. It dies with this object.
class Running {
 public:
  explicit Running(std::vector<std::string> words) : err_(memfd_create("err", MFD_CLOEXEC)) {
    prefix();
    int out[2];
    must(err_ != -1 && pipe2(out, O_CLOEXEC) == 0, "a pipe");
    words.insert(words.begin(), command());
    std::vector<char*> arguments;
    for (auto& w : words) arguments.push_back(w.data());
    arguments.push_back(nullptr);
    command_file();
    child_ = Child([&] {
      dup2(out[1], STDOUT_FILENO);
      dup2(err_, STDERR_FILENO);
      fexecve(command_file(), arguments.data(), environ);
    });
    close(out[1]);
    out_ = out[0];
  }
  ~Running() {
    close_output();
    child_.kill9();
    close(err_);
  }
  Running(const Running&) = delete;
  Running& operator=(const Running&) = delete;

  const Child& child() const { return child_; }
  /// The next line of standard output, without its end; "" where none comes.
  std::string line(std::chrono::milliseconds most = 20s) {
    std::string text;
    for (;;) {
      pollfd p{out_, POLLIN, 0};
      char c = 0;
      if (poll(&p, 1, static_cast<int>(most.count())) != 1 || read(out_, &c, 1) != 1) return text;
      if (c == '\n') return text;
      text += c;
    }
  }
  Json json() { return Json::parse(line()); }
  /// What it has written to standard error so far.
  std::string err() const {
    std::string text(1 << 16, '\0');
    const ssize_t n = pread(err_, text.data(), text.size(), 0);
    text.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
    return text;
  }
  /// Until it has said that on standard error.
  bool says(const std::string& text) const {
    return eventually([&] { return err().find(text) != std::string::npos; });
  }
  /// As the end of the program behind a pipe does.
  void close_output() {
    if (out_ != -1) close(std::exchange(out_, -1));
  }
  /// Reads the rest of its output until it ends.
  Ran finish() {
    Ran ran;
    if (out_ != -1) ran.out = read_all(out_);
    ran.exit = child_.wait();
    ran.err = err();
    return ran;
  }
  Ran interrupt() {
    child_.send(SIGINT);
    return finish();
  }

 private:
  int err_;
  int out_ = -1;
  Child child_;
};

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
