// SPDX-License-Identifier: Apache-2.0
#include "accounting.hpp"

#include <algorithm>
#include <cstring>

#include "support/lock_owner.hpp"
#include "support/topic_types.hpp"

namespace lot::kill {
namespace {

using Own = refcount::Ownership<segment::Atomics>;

class Books {
 public:
  Books(segment::Segment& segment, const std::vector<std::uint32_t>& living)
      : segment_(segment), living_(living) {}

  std::string check() {
    participants();
    blocks();
    channels();
    topics();
    ears();
    if (const std::string types = testing::wrong_types(segment_); !types.empty()) wrong(types);
    granules();
    registry_lock();
    return text_;
  }

 private:
  void wrong(const std::string& what) {
    if (text_.size() < 300) text_ += (text_.empty() ? "" : "; ") + what;
  }
  bool lives(std::uint32_t k) const {
    return std::find(living_.begin(), living_.end(), k) != living_.end();
  }

  void participants() {
    const auto entries = segment_.participants();
    for (std::uint32_t k = 1; k < entries.size(); ++k) {
      if ((entries[k].state.load() != 0) != lives(k)) {
        wrong("participant " + std::to_string(k) + (lives(k) ? " has no entry" : " has an entry"));
      }
      for (std::uint32_t other = 1; other < k && lives(k); ++other) {
        if (lives(other) && std::strcmp(entries[k].name, entries[other].name) == 0) {
          wrong("participants " + std::to_string(other) + " and " + std::to_string(k) +
                " have the same name");
        }
      }
    }
  }

  void blocks() {
    for (std::uint32_t b = 0; b < segment_.capacity().blocks; ++b) {
      auto& words = segment_.block(b);
      const std::uint32_t home = words.home.load();
      const std::string block = "block " + std::to_string(b);
      if (home > 1 && !lives(home - 1)) wrong(block + " is at home with the dead");
      bool held = false;
      for (std::uint32_t k = 0; k < segment_.capacity().participants; ++k) {
        if ((Own::word(words, k).load() & Own::bit(k)) == 0) continue;
        held = true;
        if (k != refcount::kOrphanage && !lives(k)) wrong(block + " is held by the dead");
      }
      if (home == refcount::kHomeFree && held) wrong(block + " is free and held");
      if (home == refcount::kHomeOrphanage && !held) wrong(block + " was not freed");
      if (home > 1 && !held) wrong(block + " is at home and not held");
    }
  }

  void channels() {
    const auto channels = segment_.channels();
    for (std::uint32_t c = 0; c < channels.size(); ++c) {
      const ring::Word w = channels[c].writer.load();
      const ring::State state = ring::writer_state(w);
      const std::string channel = "channel " + std::to_string(c);
      if (state == ring::State::Free) {
        if (channels[c].formed.load() != 0) wrong(channel + " is free and formed");
        continue;
      }
      if (state == ring::State::Init) wrong(channel + " was never finished");
      const std::uint32_t owner = ring::writer_owner(w);
      if (owner != refcount::kOrphanage && !lives(owner)) wrong(channel + " is the dead's");
      if (state == ring::State::Live && owner == refcount::kOrphanage)
        wrong(channel + " is nobody's");
      const segment::Ring ring = segment_.ring(c);
      if (const auto lock = segment_.queue_lock(c, outsider_); !lock.lock_if_possible()) {
        wrong(channel + " is locked");
      } else {
        lock.unlock();
      }
      slots(ring, channel);
      for (std::uint32_t i = 0; i < ring.readers; ++i) {
        const std::uint32_t who = ring.who[i].load();
        if (who != 0 && !lives(who - 1)) wrong(channel + " has a dead reader");
        const ring::Word position = ring.cells[i].position.load();
        if (who == 0 && position != ring::kIdle)
          wrong(channel + " has a position without a reader");
        // A living reader has looked since: it was told of the ring, or of its end.
        if (who != 0 && state == ring::State::Orphan && ring::is_awaited(position)) {
          wrong(channel + " has ended and awaits a reader");
        }
      }
      if (state == ring::State::Orphan && owner == refcount::kOrphanage && ring.deserted()) {
        wrong(channel + " is an orphan without readers");
      }
    }
  }

  /// Where messages travel in their slots no slot names a block, and each says `begin` of its own
  /// message, or of the next one that comes there.
  void slots(const segment::Ring& ring, const std::string& channel) {
    if (!ring.in_slots()) return;
    for (std::uint32_t i = 0; i < ring.places(); ++i) {
      const ring::Word word = ring.slots[i].load();
      const ring::Word b = ring::block(word);
      if (b == ring::kNoBlock) continue;
      if (b != ring::kInSlot) wrong(channel + " has a block in a slot for messages");
      const auto copy =
          ring.slots.read(i, ring::sequence(word), ring.places(), nullptr, 0, nullptr);
      if (!ring.taken && copy == ring::Copy::Damaged) wrong(channel + " has a damaged slot");
    }
  }

  void topics() {
    for (auto& topic : segment_.topics()) {
      for (std::uint32_t k = 0; k < segment_.capacity().participants; ++k) {
        if (has(topic.users, k) && !lives(k)) wrong("a topic is used by the dead");
        if (has(topic.observers, k) && !lives(k)) wrong("a topic is observed by the dead");
        if (topic.pullers[k].load() != 0 && !lives(k)) wrong("a topic counts pullers of the dead");
      }
    }
  }

  void ears() {
    std::vector<std::uint32_t> owners(ring::kEars, 0);
    for (std::uint32_t e = 0; e < ring::kEars; ++e) {
      const std::uint32_t owner = segment_.ear(e).words->owner.load(std::memory_order_relaxed);
      owners[e] = e < segment::kFirstFreeEar ? e + 1 : owner;
      if (owner != 0 && !lives(owner - 1)) wrong("ear " + std::to_string(e) + " is the dead's");
    }
    for (std::uint32_t c = 0; c < segment_.capacity().channels; ++c) {
      segment_.listeners()[c].each([&](std::uint32_t e) {
        if (owners[e] == 0 || !lives(owners[e] - 1)) {
          wrong("channel " + std::to_string(c) + " has a dead listener");
        }
      });
    }
  }

  /// `bits`: users or observers of a topic.
  static bool has(const auto& bits, std::uint32_t k) {
    return (bits[k / segment::Atomics::kBitsPerWord].load() & Own::bit(k)) != 0;
  }

  void granules() {
    const auto& granules = segment_.granules();
    for (std::uint32_t g = 0; g < granules.count(); ++g) {
      const std::uint32_t tag = granules.tag(g);
      if (tag == 0) continue;
      if ((tag & segment::kRingTag) != 0) {
        const std::uint32_t c = tag & ~segment::kRingTag;
        if (c >= segment_.capacity().channels ||
            ring::writer_state(segment_.channels()[c].writer.load()) == ring::State::Free) {
          wrong("granule " + std::to_string(g) + " belongs to no ring");
        }
      } else if (tag > segment_.capacity().blocks ||
                 segment_.block(tag - 1).home.load() == refcount::kHomeFree) {
        wrong("granule " + std::to_string(g) + " belongs to no message");
      }
    }
  }

  void registry_lock() {
    const std::uint32_t word = segment_.directory().lock.word.load();
    if (word != 0) wrong("the registry is locked by " + std::to_string(lock::participant(word)));
  }

  segment::Segment& segment_;
  const std::vector<std::uint32_t>& living_;
  testing::Outsider outsider_{[this](std::uint32_t k) { return !lives(k); }};
  std::string text_;
};

}  // namespace

std::string unaccounted(segment::Segment& segment, const std::vector<std::uint32_t>& living) {
  return Books(segment, living).check();
}

}  // namespace lot::kill
