// SPDX-License-Identifier: Apache-2.0

// Runs a fuzz target on given inputs without libFuzzer, so that every compiler and sanitizer
// repeats what fuzzing has found before.
//
//     ring_fuzz_replay FILE_OR_DIRECTORY...
//
// An input that takes longer than LOT_FUZZ_PATIENCE seconds (60) hangs: the process is ended.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <unistd.h>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

namespace fs = std::filesystem;

unsigned patience() {
  const char* seconds = std::getenv("LOT_FUZZ_PATIENCE");
  return seconds != nullptr ? static_cast<unsigned>(std::strtoul(seconds, nullptr, 10)) : 60;
}

/// The files named by the arguments; of a directory, all that lie in it, in a fixed order.
std::vector<fs::path> inputs(int argc, char** argv) {
  std::vector<fs::path> files;
  for (int i = 1; i < argc; ++i) {
    if (!fs::is_directory(argv[i])) {
      files.emplace_back(argv[i]);
      continue;
    }
    for (const auto& entry : fs::recursive_directory_iterator(argv[i])) {
      if (entry.is_regular_file()) files.push_back(entry.path());
    }
  }
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<std::uint8_t> read(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  if (!stream) throw std::runtime_error("cannot read " + file.string());
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  return {bytes.begin(), bytes.end()};
}

}  // namespace

int main(int argc, char** argv) try {
  const auto files = inputs(argc, argv);
  for (const auto& file : files) {
    std::printf("%s\n", file.c_str());
    std::fflush(stdout);  // a failing input aborts: its name is the last line
    alarm(patience());
    const auto bytes = read(file);
    LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
  }
  std::printf("%zu inputs\n", files.size());
  return files.empty() ? 1 : 0;  // a replay of nothing proves nothing
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
