// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "life.hpp"

namespace lot::chaos {

/// What the books of all nodes have in common that get items which are for one reader.
class ItemBooks {
 protected:
  ItemBooks(Life& life, std::uint32_t topic) : life_(life), topic_(topic) {}

  Incarnation& record(std::uint32_t i) const { return life_.board.incarnations[i]; }
  Item& item(const Stamp& stamp) const {
    return life_.board.item(record(stamp.incarnation), stamp.number);
  }
  /// Fails unless a putter has put this item into this queue.
  void check_origin(const Stamp& stamp) const;
  /// The node that has left this mark, by name.
  static std::string name_of(std::uint32_t mark);
  [[noreturn]] void fail(Finding finding, const std::string& what, const Stamp& stamp) const;

  Life& life_;
  std::uint32_t topic_;
};

}  // namespace lot::chaos
