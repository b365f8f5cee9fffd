// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <filesystem>
#include <sstream>
#include <stdexcept>
#include <string>

#include "command.hpp"
#include "screen.hpp"

namespace demo {

bool echo_a_frame(const std::string& segment) {
  const std::filesystem::path path(segment);
  Command echo({LOT_COMMAND, "echo", kTopic, "--field", "head", "--count", "1", "--timeout", "10",
                "--dir", path.parent_path(), "--segment", path.filename()});
  std::istringstream lines(echo.read_all());
  for (std::string line; std::getline(lines, line);) std::printf("           %s\n", line.c_str());
  std::fflush(stdout);
  try {
    echo.finish();
    return true;
  } catch (const std::runtime_error&) {
    return false;  // it has said why on standard error
  }
}

}  // namespace demo
