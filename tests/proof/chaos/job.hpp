// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::chaos {

/// One of the things that a node does by turns.
class Job {
 public:
  Job() = default;
  virtual ~Job() = default;
  Job(const Job&) = delete;
  Job& operator=(const Job&) = delete;

  /// Does its work for some milliseconds at most.
  virtual void turn() = 0;
  /// No node publishes any more: the same without publishing.
  virtual void quiet() = 0;
  /// Reads to the end and lets go of everything; true when there is nothing left to do.
  virtual bool settle() = 0;
};

}  // namespace lot::chaos
