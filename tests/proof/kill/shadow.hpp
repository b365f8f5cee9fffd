// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <sys/types.h>
#include <vector>

#include "lot/options.hpp"

#include "segment/layout.hpp"

namespace lot::kill {

/// A copy of a segment's bytes, to see what an instruction has changed in it.
///
/// After each instruction the tables and all granules that have an owner are compared. Of the table
/// of descriptions those bytes are that a description can get: up to the last one that a topic
/// names, and the largest one behind it. The rest, and granules without an owner, are compared at
/// the end (stray()).
class Shadow {
 public:
  explicit Shadow(const EngineOptions& options);
  ~Shadow();
  Shadow(const Shadow&) = delete;
  Shadow& operator=(const Shadow&) = delete;

  /// After a system call: the file may have come, grown, or been replaced by another.
  void look_for_file();
  /// True when something has changed since the last call. The copy is brought up to date.
  bool changed();
  /// Granules that changed without an owner, and the rest of the table of descriptions if it
  /// did.
  std::size_t stray();

 private:
  void unmap();
  void watch();
  std::uint64_t end_of_descriptions() const;
  bool compare(std::uint64_t begin, std::uint64_t bytes);
  std::uint32_t tag(const unsigned char* bytes, std::uint64_t granule) const;

  std::string path_;
  segment::Capacity capacity_;
  segment::Geometry geometry_{};
  const unsigned char* now_ = nullptr;
  std::uint64_t size_ = 0;
  dev_t device_ = 0;
  ino_t inode_ = 0;
  std::vector<unsigned char> before_;
  std::uint64_t described_ = 0;  ///< so much of the table of descriptions is compared each time
  std::vector<bool> ever_owned_;
  std::vector<std::uint64_t> watched_;  ///< the granules of ever_owned_
};

}  // namespace lot::kill
