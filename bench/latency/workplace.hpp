// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace ab {

/// Everything that this run leaves in file systems lies under its name, and goes with it. What a
/// run has left that was killed goes when the next one begins.
class Workplace {
 public:
  Workplace();
  ~Workplace();
  Workplace(const Workplace&) = delete;
  Workplace& operator=(const Workplace&) = delete;
  const std::string& name() const { return name_; }
  /// A new directory in memory.
  std::string directory(const std::string& name) const;

 private:
  std::string name_;
  int lock_ = -1;
};

}  // namespace ab
