// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "item_books.hpp"

namespace lot::chaos {

/// The books of one worker of tasks.
///
/// A worker that gets a task writes its mark beside it on the board, takes the mark away before it
/// gives the task back, and says there before and after finish() that it is at that. So a worker
/// that gets a task that is finished, or that a living one works on, sees it. The count of its
/// deliveries rises each time. A worker that is killed between a take and its mark was not noted:
/// Unfinished looks whether there were so many. Tasks of one putter are delivered for the first
/// time in their order.
class Deliveries : private ItemBooks {
 public:
  Deliveries(Life& life, std::uint32_t topic) : ItemBooks(life, topic) {}

  void got(const Stamp& stamp, std::uint32_t deliveries);
  void before_finish(const Stamp& stamp);
  void finished(const Stamp& stamp);
  void before_give_back(const Stamp& stamp);

 private:
  struct Ring {
    std::uint32_t incarnation;
    std::uint64_t next;  ///< no task before this one is new
  };
  void got_first(const Stamp& stamp);

  std::vector<Ring> rings_;
};

}  // namespace lot::chaos
