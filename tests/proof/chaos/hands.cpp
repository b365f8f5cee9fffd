// SPDX-License-Identifier: Apache-2.0
#include "hands.hpp"

#include <algorithm>
#include <limits>

#include "life.hpp"

namespace lot::chaos {

void Hands::ended(unsigned slot) {
  NodeRecord& node = board_.nodes[slot];
  const std::int64_t since = node.taking.exchange(0);
  if (since == 0) return;
  hands_.push_back({node.doing.load() & 0xffff, {since, Life::now()}});
  ++seen_;
  ++seen_in_segment_[hands_.back().topic];
}

std::vector<Hands::Missing> Hands::missing(const Living& living) const {
  std::vector<Missing> all;
  for (std::uint32_t topic = kFirstTaken; topic < kFirstTask; ++topic) {
    for (std::uint32_t i = board_.newest[topic].load(); i != 0; i = board_.incarnations[i].before) {
      const Incarnation& r = board_.incarnations[i];
      if (r.blocking == 0) continue;
      const bool waits = living.pullers[topic] != 0 && board_.lives(r);
      const std::uint64_t end = waits ? r.done.load() : r.cleared.load();
      for (std::uint64_t n = 0; n < end; ++n) {
        const Item& item = board_.item(r, n);
        if (item.taken_by.load() != 0) continue;
        const std::uint64_t behind = n + r.depth + 1;  // is put when the one before it has room
        all.push_back({i,
                       n,
                       {item.put_at.load(), behind < r.done.load()
                                                ? board_.item(r, behind).put_at.load()
                                                : std::numeric_limits<std::int64_t>::max()}});
      }
    }
  }
  return all;
}

bool Hands::explain(const std::vector<Missing>& missing, std::size_t item,
                    std::vector<std::optional<std::size_t>>& item_of,
                    std::vector<bool>& tried) const {
  const Missing& m = missing[item];
  for (std::size_t h = 0; h < hands_.size(); ++h) {
    const Hand& hand = hands_[h];
    if (tried[h] || hand.topic != board_.incarnations[m.incarnation].topic ||
        hand.time.to < m.time.from || hand.time.from > m.time.to) {
      continue;
    }
    tried[h] = true;
    if (!item_of[h] || explain(missing, *item_of[h], item_of, tried)) {
      item_of[h] = item;
      return true;
    }
  }
  return false;
}

std::string Hands::unexplained(const Living& living) const {
  const std::vector<Missing> all = missing(living);
  std::vector<std::optional<std::size_t>> item_of(hands_.size());
  for (std::size_t item = 0; item < all.size(); ++item) {
    std::vector<bool> tried(hands_.size(), false);
    if (explain(all, item, item_of, tried)) continue;
    return describe(all[item]) + "; " + std::to_string(all.size()) + " are missing, " +
           std::to_string(hands_.size()) + " takers were killed over a take";
  }
  return "";
}

std::uint32_t Hands::write_off(const Living& living) {
  const std::vector<Missing> all = missing(living);
  for (const Missing& m : all) {
    board_.item(board_.incarnations[m.incarnation], m.number).taken_by.store(Item::kWrittenOff);
  }
  hands_.clear();
  return static_cast<std::uint32_t>(all.size());
}

std::string Hands::describe(const Missing& m) const {
  const Incarnation& r = board_.incarnations[m.incarnation];
  return std::string(kTopic[r.topic].name) + ": nobody has taken item " + std::to_string(m.number) +
         " of incarnation " + std::to_string(m.incarnation) + ", chaos" + std::to_string(r.slot) +
         " life " + std::to_string(r.life) + (board_.lives(r) ? " (lives)" : " (ended)") +
         ", depth " + std::to_string(r.depth) + ", done " + std::to_string(r.done.load()) +
         ", looked for up to " + std::to_string(r.cleared.load());
}

}  // namespace lot::chaos
