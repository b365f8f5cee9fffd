// SPDX-License-Identifier: Apache-2.0
// Any sequence of ring operations against a model that is too simple to be wrong: a deque of the
// messages that are left, and for each reader the index of the message that it reads next. In half
// of the rings each message is taken by one reader; a reader then takes what it has done with. In
// half of them messages travel in the slots; a reader then copies what it has done with.
// Where a ring has room for one reader, under back-pressure, boost::lockfree::spsc_queue is asked
// as well.
//
// Input: depth - 1, and whether in slots | policy and readers | first sequence | operations, a byte
// each:
//     7     5 4      3 2         0
//    +-------+--------+-----------+
//    |  arg  | reader | operation |     corpus/ring/ has examples
//    +-------+--------+-----------+

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <iterator>
#include <memory>
#include <optional>
#include <vector>

#include <boost/lockfree/spsc_queue.hpp>

#include "lot/detail/atomics.hpp"

#include "lockfree_ring/ring.hpp"
#include "support/plant.hpp"

namespace {

using lot::detail::HardwareAtomics;
using lot::fuzz::planted;
using lot::ring::Copy;
using lot::ring::kInSlot;
using lot::ring::kNoBlock;
using lot::ring::kSequenceMask;
using lot::ring::kSleeper;
using lot::ring::Word;
using Ring = lot::ring::Ring<HardwareAtomics>;
using Cell = lot::ring::Cell<HardwareAtomics>;
using Writer = lot::ring::Writer<HardwareAtomics>;
using Reader = lot::ring::Reader<HardwareAtomics>;
using Slots = lot::ring::Slots<HardwareAtomics>;

/// Aborts, and names what differs from the model.
void require(bool same, const char* what) {
  if (same) return;
  std::fprintf(stderr, "ring and model differ: %s\n", what);
  std::abort();
}

enum Operation : unsigned { Publish, Poll, Borrow, Done, Join, Leave, Evict, Sleep };

/// Any block that a slot can name, different for messages that are near each other.
Word block_of(Word index) { return index * 40503 % kInSlot; }

constexpr std::size_t kStride = 64;
/// What a message says that lies in its slot.
using Letter = std::array<Word, 6>;
Letter letter_of(Word index) {
  Letter letter;
  for (std::size_t i = 0; i < letter.size(); ++i) letter[i] = index * 40503 + i;
  return letter;
}

constexpr Word kFirst[] = {0,
                           1,
                           4095,
                           kSequenceMask,
                           kSequenceMask - 1,
                           kSequenceMask - 6,
                           kSequenceMask - 40,
                           kSequenceMask >> 1,
                           (kSequenceMask >> 1) + 1,
                           (kSequenceMask >> 1) - 6};
constexpr std::uint64_t kHistory[] = {0, 1, 2, 3, 5, 9, 100, Reader::kFromTheStart};

class Fuzz {
 public:
  Fuzz(std::uint32_t depth, bool in_slots, bool blocking, bool taken, std::uint32_t readers,
       Word first)
      : slots_(in_slots ? (depth + 1) * kStride / sizeof(Word) : depth),
        cells_(readers),
        who_(readers),
        readers_(readers) {
    ring_.writer = &writer_word_;
    ring_.slots = in_slots ? Slots::with_messages(slots_.data(), kStride) : Slots(slots_.data());
    ring_.cells = cells_.data();
    ring_.who = who_.data();
    ring_.roster = &roster_;
    ring_.space = &space_;
    ring_.floor = &floor_;
    ring_.depth = depth;
    ring_.readers = readers;
    ring_.blocking = blocking;
    ring_.taken = taken;
    ring_.first = first;
    ring_.format();
    writer_word_.go_live(1, 1);
    writer_ = Writer(ring_);
  }

  void run(std::uint8_t byte) {
    const unsigned arg = byte >> 5;
    auto& reader = readers_[(byte >> 3 & 3) % readers_.size()];
    switch (static_cast<Operation>(byte & 7)) {
      case Publish:
        for (unsigned n = 0; n <= arg; ++n) publish();
        break;
      case Poll:
        for (unsigned n = 0; n <= arg; ++n) {
          if (reader) poll(*reader);
          if (reader && reader->borrowed) done(*reader);
        }
        break;
      case Borrow:
        if (reader) poll(*reader);
        break;
      case Done:
        if (reader && reader->borrowed) done(*reader);
        break;
      case Join:
        join(kHistory[arg]);
        break;
      case Leave:
        if (!reader) break;
        reader->real.leave();
        reader.reset();
        break;
      case Evict:
        evict();
        break;
      case Sleep:
        if (reader) sleep(*reader);
        break;
    }
    spoil();
    check();
  }

  /// The publisher goes; everybody reads what is left. What is to be taken waits for who comes.
  void end() {
    writer_word_.end(1, 1);
    ring_.clear_sleepers();
    marked_ = false;
    bool full = true;
    if (!ring_.taken && std::any_of(readers_.begin(), readers_.end(), [](auto& r) { return !r; })) {
      require(!Reader::join(ring_, 1, 1, 0, full) && !full, "nobody joins an orphan");
    }
    read_to_the_end();
    if (ring_.taken) {
      join(Reader::kFromTheStart);
      read_to_the_end();
    }
    require(ring_.deserted(), "deserted");
  }

 private:
  void read_to_the_end() {
    for (auto& reader : readers_) {
      if (!reader) continue;
      do {
        require(reader->real.ended() == (reader->next == published_), "ended");
        poll(*reader);
        if (!reader->borrowed) break;
        done(*reader);
      } while (true);
      require(reader->real.ended(), "ended after the last");
      reader->real.leave();
      reader.reset();
    }
  }

  struct Model {
    Reader real;
    Word next;                     ///< index of the message that it reads next
    std::optional<Word> borrowed;  ///< block between poll and done
    Word asked;                    ///< next, when done() last asked whether the sender waits
  };

  Word oldest() const { return published_ - kept_.size(); }

  /// True if nobody still needs the message that the next publish overwrites.
  bool room() const {
    if (!ring_.blocking) return true;
    if (ring_.taken) return kept_.size() < ring_.depth || !kept_.front();
    return std::all_of(readers_.begin(), readers_.end(),
                       [this](auto& r) { return !r || published_ - r->next < ring_.depth; });
  }

  void publish() {
    require(writer_.room() == room(), "room");
    const bool read = oracle_ && readers_[0];
    require(!read || (oracle_->write_available() != 0) == room(), "room, as boost has it");
    if (!room()) {
      require(writer_.mark_waiting() == space_ && space_ % 2 == 1, "mark_waiting");
      waiting_ = true;
      return;
    }
    Word replaced = kNoBlock;
    if (kept_.size() == ring_.depth) {
      replaced = kept_.front().value_or(kNoBlock);
      kept_.pop_front();
    }
    if (ring_.taken && !ring_.in_slots()) {
      replaced = held_.size() == ring_.depth ? held_.front().value_or(kNoBlock) : kNoBlock;
      if (held_.size() == ring_.depth) held_.pop_front();
      held_.emplace_back(block_of(published_));
    }
    const Letter letter = letter_of(published_);
    const auto result = ring_.in_slots() ? writer_.publish(letter.data(), letter.size(), nullptr)
                                         : writer_.publish(block_of(published_));
    require(result.replaced == (ring_.in_slots() ? kNoBlock : replaced), "replaced");
    require(result.wake == marked_, "wake");
    require(result.slot == &ring_.slots[published_ % ring_.places()], "slot");
    marked_ = false;
    if (read) oracle_->push(block_of(published_));
    kept_.emplace_back(block_of(published_++));
  }

  /// Each message that was taken is given up once, and none before that.
  void give_up() {
    writer_.each_taken([this](Word block) {
      const auto held = std::find(held_.begin(), held_.end(), std::optional<Word>(block));
      require(held != held_.end(), "a message is given up that the ring does not hold");
      require(!kept_[static_cast<std::size_t>(held - held_.begin())], "who gives up a message");
      held->reset();
    });
    std::vector<Word> expected;
    for (const auto& block : held_) {
      if (block) expected.push_back(*block);
    }
    std::vector<Word> put;
    writer_.each_put([&](Word block) { put.push_back(block); });
    std::sort(put.begin(), put.end());
    std::sort(expected.begin(), expected.end());
    require(put == expected, "what the ring holds");
    const bool all = std::none_of(kept_.begin(), kept_.end(), [](auto& m) { return bool(m); });
    require(!all || put.empty(), "what was taken is given up");
  }

  void evict() {
    if (ring_.in_slots()) return empty();
    if (ring_.blocking) {
      if (ring_.taken) {
        give_up();
      } else {
        take_back();
      }
      return;
    }
    // Of messages that are taken, one may be out already: then only its hold is left to give up.
    auto& held = ring_.taken ? held_ : kept_;
    const auto oldest = std::find_if(held.begin(), held.end(), [](auto& m) { return bool(m); });
    const Word expected = oldest == held.end() ? kNoBlock : **oldest;
    const std::vector<Word> before(slots_.begin(), slots_.end());
    require(writer_.evict_oldest() == expected, "evict_oldest");
    if (oldest == held.end()) return;
    if (planted("undone_eviction") && ring_.taken) {
      std::copy(before.begin(), before.end(), slots_.begin());
    }
    kept_[static_cast<std::size_t>(oldest - held.begin())].reset();
    oldest->reset();
  }

  /// A lossless ring empties the slots that all have read. Later joiners begin behind them.
  void empty() {
    if (!ring_.blocking || ring_.taken) return;
    Word expected = 0;
    for (Word m = oldest(); m < published_; ++m) {
      if (std::any_of(readers_.begin(), readers_.end(),
                      [m](auto& r) { return r && r->next <= m; })) {
        break;
      }
      auto& kept = kept_[m - oldest()];
      expected += kept.has_value();
      if (kept) closed_off_ = m + 1;
      kept.reset();
    }
    writer_.take_back(0, [&expected](Word block) {
      require(block == kInSlot && expected-- != 0, "what is taken back");
    });
    require(expected == 0, "all that was read is taken back");
  }

  /// A lossless ring gives up what all have read. Who joins later begins behind it.
  void take_back() {
    Word expected = kNoBlock;
    for (Word m = oldest(); m < published_ && expected == kNoBlock; ++m) {
      if (std::any_of(readers_.begin(), readers_.end(),
                      [m](auto& r) { return r && r->next <= m; })) {
        break;
      }
      auto& kept = kept_[m - oldest()];
      if (!kept) continue;
      expected = *kept;
      kept.reset();
      closed_off_ = m + 1;
    }
    require(writer_.evict_oldest() == expected, "evict_oldest");
  }

  void poll(Model& reader) {
    const Word before = reader.next;
    reader.next = std::max(reader.next, oldest());
    while (reader.next < published_ && !kept_[reader.next - oldest()]) ++reader.next;
    reader.borrowed.reset();
    if (reader.next < published_) reader.borrowed = kept_[reader.next - oldest()];

    std::uint64_t missed = 7;  // it adds
    Word found = reader.real.poll(missed);
    // A slot has its message until the next one is in there, though it has begun to go.
    while (found == kInSlot && copied(reader, missed) == Copy::Overwritten) {
      found = reader.real.poll(missed);
    }
    require(found == name_of(reader.borrowed), "poll");
    if (oracle_) {
      const bool any = oracle_->read_available() != 0;
      require((any ? oracle_->front() : kNoBlock) == reader.borrowed.value_or(kNoBlock),
              "poll, as boost has it");
    }
    require(missed == 7 + (ring_.taken ? 0 : reader.next - before), "missed");
    if (!reader.borrowed) ring_bell(reader.real.sender_waits());
  }

  /// What a reader is told of a message that is there, or of none.
  Word name_of(const std::optional<Word>& block) const {
    return block && ring_.in_slots() ? kInSlot : block.value_or(kNoBlock);
  }

  /// Copies the message that the reader stands at out of its slot. If it has gone, the reader is
  /// behind it.
  Copy copied(Model& reader, std::uint64_t& missed) {
    const Word at = lot::ring::advance(reader.real.cursor(), Word{0} - ring_.first);
    const bool is_there = at == reader.next && reader.next >= oldest();
    Letter letter{};
    const Copy copied = reader.real.copy(letter.data(), letter.size(), nullptr, missed);
    if (planted("torn_letter") && ++copies_ % 8 == 0) letter[5] ^= 1;
    require(copied == (is_there || ring_.taken ? Copy::Whole : Copy::Overwritten), "copy");
    require(!is_there || letter == letter_of(reader.next), "what a copy says");
    return copied;
  }

  void done(Model& reader) {
    std::uint64_t missed = 7;  // it adds
    if (ring_.in_slots() && copied(reader, missed) == Copy::Overwritten) {
      require(missed == 8, "missed by a copy");
      reader.borrowed.reset();
      ++reader.next;
      return;
    }
    if (ring_.taken) {
      const bool lapped = reader.next < oldest();
      const bool there = !lapped && kept_[reader.next - oldest()].has_value();
      require(reader.real.take() == there, "who takes a message");
      if (there) kept_[reader.next - oldest()].reset();
    }
    reader.borrowed.reset();
    ++reader.next;
    if (oracle_) oracle_->pop();
    const bool enough = reader.next - reader.asked >= ring_.depth / Reader::kBellsPerLap;
    if (enough) reader.asked = reader.next;
    ring_bell(reader.real.done(), enough);
  }

  void ring_bell(bool told, bool enough = true) {
    require(told == (ring_.blocking && waiting_ && enough), "the sender waits");
    if (!told) return;
    require(Reader::ring_bell(space_) && !Reader::ring_bell(space_), "ring_bell");
    waiting_ = false;
  }

  void join(std::uint64_t history) {
    const auto seat =
        std::find_if(readers_.begin(), readers_.end(), [](auto& reader) { return !reader; });
    bool full = false;
    auto real = Reader::join(ring_, 1, 1, history, full);
    require(full == (seat == readers_.end()) && full == !real, "join");
    if (!real) return;
    Word back = ring_.guarded() ? ring_.most() : ring_.depth - 1;
    if (!ring_.blocking && !ring_.taken && history == Reader::kFromTheStart) back = published_;
    back = std::min({back, Word{history}, published_});
    if (!ring_.guarded()) back = std::min(back, published_ - closed_off_);
    require(real->cell() == static_cast<std::size_t>(seat - readers_.begin()), "cell");
    *seat = Model{*real, published_ - back, std::nullopt, published_ - back};
    if (ring_.guarded() || readers_.size() != 1) return;
    oracle_ = std::make_unique<boost::lockfree::spsc_queue<Word>>(ring_.depth);
    for (Word m = published_ - back; m < published_; ++m) oracle_->push(block_of(m));
  }

  void sleep(Model& reader) {
    const auto mark = reader.real.mark_sleeping();
    require(mark.has_value() == (reader.next == published_), "mark_sleeping");
    if (!mark) return;
    require(*mark == reader.real.slot() && (*mark & kSleeper) != 0, "mark");
    marked_ = true;
  }

  /// Makes one of the mistakes that must be found.
  void spoil() {
    if (++steps_ % 8 != 0) return;
    if (planted("lost_message") && ring_.in_slots()) {
      const Letter letter = letter_of(0);
      writer_.publish(letter.data(), letter.size(), nullptr);
    } else if (planted("lost_message")) {
      writer_.publish(0);
    }
    if (planted("changed_slot")) ring_.slots[0] ^= 1;
    if (planted("forgotten_sleeper")) ring_.slots[published_ % ring_.places()] &= ~kSleeper;
    for (auto& reader : readers_) {
      if (planted("moved_reader") && reader) reader->real.done();
    }
  }

  /// What must hold between operations, whoever asks.
  void check() {
    std::vector<Word> expected;
    std::vector<Word> hazards;
    std::vector<std::uint32_t> late;
    std::vector<std::uint32_t> laggards;
    for (std::uint32_t i = 0; i < readers_.size(); ++i) {
      if (!readers_[i]) continue;
      const Model& reader = *readers_[i];
      require(reader.real.cursor() == lot::ring::advance(ring_.first, reader.next), "cursor");
      require(reader.real.ready() == (reader.next < published_), "ready");
      require(!reader.real.ended(), "ended while the publisher lives");
      std::optional<Word> next;
      if (reader.next < published_ && reader.next >= oldest()) {
        next = kept_[reader.next - oldest()];
      }
      const bool is_going = ring_.in_slots() && !ring_.blocking && !ring_.taken &&
                            published_ - reader.next == ring_.places();
      require(reader.real.peek(0) == (is_going ? kInSlot : name_of(next)), "peek");
      if (reader.borrowed && ring_.guarded() && !ring_.in_slots()) {
        expected.push_back(*reader.borrowed);
      }
      if (!ring_.guarded() && published_ - reader.next >= ring_.depth) late.push_back(i);
    }
    writer_.hazards([&](Word block) { hazards.push_back(block); });
    require(hazards == expected, "hazards");
    if (ring_.taken && steps_ % 2 == 0) give_up();
    if (!ring_.blocking) return;  // under overwrite a lapped reader's place is known only to itself
    writer_.laggards([&](std::uint32_t cell) { laggards.push_back(cell); });
    require(laggards == late, "laggards");
  }

  lot::ring::WriterWord<lot::detail::HardwareAtomics> writer_word_;
  std::vector<std::atomic<Word>> slots_;
  std::vector<Cell> cells_;
  std::vector<std::atomic<std::uint32_t>> who_;
  std::atomic<std::uint32_t> roster_{0};
  std::atomic<Word> floor_{0};
  std::atomic<std::uint32_t> space_{0};
  Ring ring_;
  Writer writer_;

  /// What the one reader has not read; none while there may be several.
  std::unique_ptr<boost::lockfree::spsc_queue<Word>> oracle_;
  Word closed_off_ = 0;                   ///< joiners of a lossless ring begin here at the earliest
  std::deque<std::optional<Word>> kept_;  ///< the newest messages, oldest first; empty: evicted
  /// By place in kept_: the blocks whose hold is the ring's, if messages are taken.
  std::deque<std::optional<Word>> held_;
  std::vector<std::optional<Model>> readers_;
  Word published_ = 0;
  bool marked_ = false;   ///< somebody sleeps on the slot of the next message
  bool waiting_ = false;  ///< the sender sleeps for room
  unsigned steps_ = 0;
  unsigned copies_ = 0;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 3) return 0;
  Fuzz fuzz(1 + data[0] % 9, data[0] >= 128, (data[1] & 1) != 0, data[1] >= 128,
            1 + (data[1] >> 1) % 3U, kFirst[data[2] % std::size(kFirst)]);
  for (std::size_t i = 3; i < size; ++i) fuzz.run(data[i]);
  fuzz.end();
  return 0;
}
