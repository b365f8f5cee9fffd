// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "item_books.hpp"

namespace lot::chaos {

/// The books of one taker of items that are each for one of their readers.
///
/// An item that was taken gets a mark on the board: a taker that finds one there already has got
/// what another has got. What must not be there any more is known where it is certain that this
/// taker reads a putter's ring (it was there before listen() began and after that had returned, or
/// an item of it has come): when a look has found nothing, takers have taken all that was put
/// before the look (Incarnation::cleared). Whether it has its marks is seen when no taker is
/// between the two (hands.hpp). So it is with the items of a putter that was killed, as long as one
/// certain reader outlives it; those that no such reader is left for may go with their putter.
class Takings : private ItemBooks {
 public:
  Takings(Life& life, std::uint32_t topic) : ItemBooks(life, topic) {}

  void before_listen();
  void after_listen();

  void before_look();
  void took(const Stamp& stamp);
  void found_nothing();

 private:
  struct Ring {
    std::uint32_t incarnation;
    std::uint64_t next;
    std::uint64_t done;  ///< before the look
    bool over;           ///< its putter had ended before the look
  };
  void mark(const Stamp& stamp);

  std::vector<Ring> rings_;
};

}  // namespace lot::chaos
