// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <sys/types.h>
#include <vector>

namespace demo {

/// Another program whose output is read. It ends with this object, and with this process.
class Command {
 public:
  /// The program and its words. Throws std::system_error.
  explicit Command(std::vector<std::string> words);
  ~Command();
  Command(const Command&) = delete;
  Command& operator=(const Command&) = delete;

  /// Up to `bytes`; less only at the end. Throws Interrupted, std::system_error.
  std::size_t read(void* to, std::size_t bytes);
  /// Until its output ends. Throws as read().
  std::string read_all();
  /// As Ctrl-C does.
  void interrupt() const;
  /// After the end of its output. Throws std::runtime_error when it has failed.
  void finish();

 private:
  std::string name_;
  pid_t pid_ = -1;
  int fd_ = -1;
};

}  // namespace demo
