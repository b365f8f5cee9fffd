// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

#include <spawn.h>

#include "screen.hpp"

namespace demo {

bool echo_a_frame(const std::string& segment) {
  const std::filesystem::path path(segment);
  std::vector<std::string> words{
      LOT_COMMAND, "echo", kTopic,  "--field",          "head",      "--count",      "1",
      "--timeout", "10",   "--dir", path.parent_path(), "--segment", path.filename()};
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::array<int, 2> output{};
  if (pipe(output.data()) == -1) return false;
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, output[1], STDOUT_FILENO);
  posix_spawn_file_actions_addclose(&actions, output[0]);
  posix_spawn_file_actions_addclose(&actions, output[1]);
  pid_t pid = -1;
  const int error = posix_spawn(&pid, LOT_COMMAND, &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(output[1]);
  FILE* const lines = fdopen(output[0], "r");
  std::array<char, 256> line{};
  while (lines != nullptr && std::fgets(line.data(), line.size(), lines) != nullptr) {
    std::printf("           %s", line.data());
  }
  if (lines != nullptr) std::fclose(lines);
  std::fflush(stdout);
  int status = 0;
  while (error == 0 && waitpid(pid, &status, 0) == -1 && errno == EINTR) {
  }
  if (interrupted()) throw Interrupted();
  return error == 0 && WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

}  // namespace demo
