// SPDX-License-Identifier: Apache-2.0
#include "audit.hpp"

#include <cstdio>
#include <vector>

#include "lockfree_ring/words.hpp"
#include "refcount/ownership.hpp"
#include "support/topic_types.hpp"

namespace lot::chaos {
namespace {

/// The ring (64), two batches of retired ones, and what all readers together kept a moment ago.
constexpr std::uint32_t kBlocksOfPublisher = 400;
/// What a reader keeps out of slots, and a block for the next one.
constexpr std::uint32_t kBlocksOfReader = 10;

using Own = refcount::Ownership<segment::Atomics>;

class Auditor {
 public:
  Auditor(segment::Segment& s, const Living& living)
      : s_(s), living_(living), lives_(s.capacity().participants, false) {}

  std::string look() {
    std::uint32_t taken = 0;
    for (std::uint32_t k = 1; k < s_.capacity().participants; ++k) {
      lives_[k] = s_.participants()[k].state.load() != 0;
      taken += lives_[k];
    }
    expect("participants", taken, living_.participants);
    rings();
    topics();
    blocks();
    granules();
    return text_;
  }

 private:
  void expect(const std::string& what, std::uint64_t there, std::uint64_t wanted) {
    if (there != wanted) {
      say(what + ": " + std::to_string(there) + ", the living have " + std::to_string(wanted));
    }
  }
  void say(const std::string& what) {
    if (!text_.empty()) text_ += "; ";
    text_ += what;
  }
  bool lives(std::uint64_t k) const { return k < lives_.size() && lives_[k]; }

  void rings() {
    std::uint32_t all = 0;
    std::uint64_t cells = 0;
    std::uint32_t pushers = 0;
    std::uint64_t readers = 0;
    for (std::uint32_t t = 0; t < kTopics; ++t) {
      pushers += living_.pushers[t];
      readers += std::uint64_t{living_.pushers[t]} * (living_.pullers[t] + living_.observers[t]);
    }
    for (std::uint32_t c = 0; c < s_.capacity().channels; ++c) {
      const auto w = s_.channels()[c].writer.load();
      if (ring::writer_state(w) == ring::State::Free) continue;
      ++all;
      if (ring::writer_state(w) != ring::State::Live || !lives(ring::writer_owner(w))) {
        say("ring " + std::to_string(c) + " in state " +
            std::to_string(static_cast<int>(ring::writer_state(w))) + " is of " +
            std::to_string(ring::writer_owner(w)));
      }
      const segment::Ring r = s_.ring(c);
      for (std::uint32_t i = 0; r.who != nullptr && i < r.readers; ++i) {
        const std::uint32_t who = r.who[i].load();
        if (who == 0) continue;
        ++cells;
        if (!lives(who - 1)) {
          say("cell " + std::to_string(i) + " of ring " + std::to_string(c) + " is of " +
              std::to_string(who - 1));
        }
      }
    }
    expect("rings", all, pushers);
    expect("readers' cells", cells, readers);
  }

  void topics() {
    std::uint32_t used = 0;
    std::uint32_t observed = 0;
    std::uint32_t wanted_used = 0;
    std::uint32_t wanted_observed = 0;
    for (std::uint32_t t = 0; t < kTopics; ++t) {
      wanted_used += living_.pushers[t] + living_.pullers[t] != 0;
      wanted_observed += living_.observers[t] != 0;
    }
    for (auto& topic : s_.topics()) {
      used += is_anybodys(topic.users, std::string("topic ") + topic.name + " is used by ");
      observed +=
          is_anybodys(topic.observers, std::string("topic ") + topic.name + " is observed by ");
    }
    expect("topics", used, wanted_used);
    expect("observed topics", observed, wanted_observed);
    if (const std::string wrong = testing::wrong_types(s_); !wrong.empty()) say(wrong);
  }
  /// `bits`: users or observers of a topic.
  bool is_anybodys(const auto& bits, const std::string& what) {
    bool any = false;
    for (std::uint32_t k = 0; k < s_.capacity().participants; ++k) {
      if ((bits[k / segment::Atomics::kBitsPerWord].load() & Own::bit(k)) == 0) continue;
      any = true;
      if (!lives(k)) say(what + std::to_string(k));
    }
    return any;
  }

  void blocks() {
    const std::uint32_t n = s_.capacity().blocks;
    std::vector<bool> explained(n, false);
    std::vector<std::uint32_t> to_follow;
    for (std::uint32_t b = 0; b < n; ++b) {
      bool held = false;
      for (std::uint32_t k = 1; k < s_.capacity().participants; ++k) {
        if ((Own::word(s_.block(b), k).load() & Own::bit(k)) == 0) continue;
        held = true;
        if (!lives(k)) say("block " + std::to_string(b) + " is held by " + std::to_string(k));
      }
      if (held) {
        explained[b] = true;
        to_follow.push_back(b);
      }
    }
    while (!to_follow.empty()) {
      const std::uint32_t b = to_follow.back();
      to_follow.pop_back();
      each_reference(b, [&](std::uint32_t target) {
        if (!explained[target]) to_follow.push_back(target);
        explained[target] = true;
      });
    }
    std::vector<std::uint32_t> at_home(s_.capacity().participants, 0);
    for (std::uint32_t b = 0; b < n; ++b) {
      const std::uint32_t home = s_.block(b).home.load();
      if (home > 1 && home <= at_home.size()) ++at_home[home - 1];
      const bool adopted = (s_.block(b).own[0].load() & 1) != 0;
      if (home > 1 && !lives(home - 1)) {
        say("block " + std::to_string(b) + " is at home with " + std::to_string(home - 1));
      }
      if ((home == refcount::kHomeOrphanage || adopted) && !explained[b]) {
        say("block " + std::to_string(b) + " is the orphanage's, and nobody has it");
      }
      if (home == refcount::kHomeFree && explained[b]) {
        say("block " + std::to_string(b) + " is held, and free");
      }
    }
    for (std::uint32_t k = 1; k < at_home.size(); ++k) {
      if (!lives(k)) continue;
      const char* name = s_.participants()[k].name;
      unsigned slot = 0;
      if (std::sscanf(name, "chaos%u", &slot) != 1 || slot >= kMostNodes) {
        say("participant " + std::to_string(k) + " is none of the nodes: " + name);
      } else if (at_home[k] > kBlocksOfPublisher * living_.pushers_of[slot] +
                                  kBlocksOfReader * living_.pullers_of[slot]) {
        say(std::to_string(at_home[k]) + " blocks are at home with " + name + ", which has " +
            std::to_string(living_.pushers_of[slot]) + " publishers and " +
            std::to_string(living_.pullers_of[slot]) + " readers");
      }
    }
  }

  template <class F>
  void each_reference(std::uint32_t b, F&& f) {
    std::uint64_t at = s_.arena(b).references;
    for (unsigned n = 0;
         n < 64 && at != 0 && at % 8 == 0 && at <= s_.size() - sizeof(detail::ReferenceList); ++n) {
      const auto* list = reinterpret_cast<const detail::ReferenceList*>(s_.base() + at);
      for (const auto& entry : list->entry) {
        if (entry.block < s_.capacity().blocks) f(entry.block);
      }
      at = list->next;
    }
  }

  void granules() {
    for (std::uint32_t i = 0; i < s_.granules().count(); ++i) {
      const std::uint32_t tag = s_.granules().tag(i);
      if (tag == 0) continue;
      const std::uint32_t owner = tag & ~segment::kRingTag;
      const bool used =
          (tag & segment::kRingTag) != 0
              ? owner < s_.capacity().channels &&
                    ring::writer_state(s_.channels()[owner].writer.load()) != ring::State::Free
              : owner - 1 < s_.capacity().blocks &&
                    s_.block(owner - 1).home.load() != refcount::kHomeFree;
      if (!used) say("granule " + std::to_string(i) + " has the tag of what is free");
    }
  }

  segment::Segment& s_;
  const Living& living_;
  std::vector<bool> lives_;
  std::string text_;
};

}  // namespace

std::string unexplained(segment::Segment& segment, const Living& living) {
  return Auditor(segment, living).look();
}

}  // namespace lot::chaos
