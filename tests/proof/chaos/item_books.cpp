// SPDX-License-Identifier: Apache-2.0
#include "item_books.hpp"

namespace lot::chaos {

void ItemBooks::check_origin(const Stamp& stamp) const {
  const std::uint32_t i = stamp.incarnation;
  if (i == 0 || i >= life_.board.incarnations_begun.load()) {
    fail(Finding::Torn, "an item of nobody", stamp);
  }
  if (record(i).topic != topic_) fail(Finding::Torn, "an item of another queue", stamp);
  if (stamp.number >= record(i).begun.load(std::memory_order_acquire)) {
    fail(Finding::Torn, "it was never put", stamp);
  }
}

std::string ItemBooks::name_of(std::uint32_t mark) {
  return "chaos" + std::to_string((mark & 0xff) - 1) + " life " + std::to_string(mark >> 8);
}

void ItemBooks::fail(Finding finding, const std::string& what, const Stamp& stamp) const {
  std::string text = std::string(kTopic[topic_].name) + ": item " + std::to_string(stamp.number) +
                     " of incarnation " + std::to_string(stamp.incarnation) + ": " + what;
  if (stamp.incarnation < kIncarnations) {
    const Incarnation& r = record(stamp.incarnation);
    text += "; putter: chaos" + std::to_string(r.slot) + " life " + std::to_string(r.life) +
            (life_.lives(r) ? " (lives)" : " (ended)") + ", " +
            (r.blocking != 0 ? "lossless" : "Overwrite") + " depth " + std::to_string(r.depth) +
            ", done " + std::to_string(r.done.load()) + ", begun " + std::to_string(r.begun.load());
  }
  life_.fail(finding, text);
}

}  // namespace lot::chaos
