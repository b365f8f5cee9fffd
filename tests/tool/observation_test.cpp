// SPDX-License-Identifier: Apache-2.0

// What is seen of a segment when one of its words is another one: what changes, and what is called
// damage.

#include "tool/observation.hpp"

#include <cstddef>
#include <cstring>
#include <fstream>
#include <set>
#include <sstream>
#include <string>
#include <sys/stat.h>

#include <doctest/doctest.h>

#include "robust_mutex/lock_word.hpp"
#include "scene.hpp"
#include "segment/layout.hpp"
#include "support/janitor.hpp"

namespace {

using namespace lot::testing;
using lot::segment::BlockWords;
using lot::segment::ChannelEntry;
using lot::segment::Directory;
using lot::segment::Geometry;
using lot::segment::ParticipantEntry;
using lot::segment::RingHead;
using lot::segment::TopicEntry;
namespace tool = lot::tool;

[[maybe_unused]] const bool has_janitor = start_janitor();

/// A line for each thing that is seen.
std::string text_of(const tool::Observation& seen) {
  std::ostringstream out;
  for (const auto& p : seen.processes) {
    out << "process " << seen.who(p.index) << (p.alive ? " lives, " : " is dead, ") << p.bytes
        << "\n";
  }
  for (const auto& t : seen.topics) {
    out << "topic " << t.index << " " << t.name << " " << t.type << " " << t.type_size
        << (t.used ? " used" : "") << " subscribers";
    for (const auto k : t.subscribers) out << " " << k;
    out << " observers";
    for (const auto k : t.observers) out << " " << k;
    out << "\n";
  }
  for (const auto& c : seen.channels) {
    out << "queue " << c.channel << (c.orphan ? " gone" : "") << " of " << c.publisher << " topic "
        << c.topic << " depth " << c.depth << " policy " << static_cast<int>(c.policy) << " engine "
        << static_cast<int>(c.engine) << (c.stamps ? " stamps" : "") << (c.taken ? " taken" : "")
        << (c.waits ? " waits" : "") << " next " << c.next << " of " << c.published << ":";
    for (const auto& q : c.queue) out << " " << q.sequence << "=" << q.block;
    for (const auto& r : c.readers) {
      out << "; " << r.process << " lag " << r.lag << " lost " << r.lost
          << (r.joining ? " joins" : "") << (r.observes ? " observes" : "")
          << (r.awaited ? " awaited" : "") << (r.holds_back ? " holds" : "");
    }
    out << "\n";
  }
  for (const auto& m : seen.messages) {
    out << "message " << m.block << " of " << m.home << " " << m.topic << " " << m.bytes;
    for (const auto& h : m.holders) out << ", " << h.process << " " << to_string(h.how);
    out << "\n";
  }
  out << "memory " << seen.memory.used << " of " << seen.memory.total << " held back "
      << seen.held_back << " messages " << seen.blocks.used << " of " << seen.blocks.total
      << (seen.persists ? " persists" : "") << "\n";
  for (const auto& what : seen.damage) out << "damaged: " << what << "\n";
  return out.str();
}

/// The segment of a Scene as bytes, to be changed and looked at.
class Picture {
 public:
  Picture() {
    const Scene scene;
    bytes_ = bytes_of(scene.options.directory + "/" + scene.options.segment);
    std::memcpy(&capacity, bytes_.data() + offsetof(lot::segment::Header, capacity),
                sizeof(capacity));
    places = Geometry::of(capacity);
    std::ofstream(path_, std::ios::binary) << bytes_;
    must(chmod(path_.c_str(), 0600) == 0, "a file of ours");
    before_ = seen();
  }
  const std::string& text() const { return before_; }
  /// The lines that another word at this place changes.
  template <class Word>
  std::string with(std::uint64_t at, Word word) const {
    write(at, &word, sizeof(word));
    std::istringstream before(before_), after(seen());
    write(at, bytes_.data() + at, sizeof(word));
    std::set<std::string> known;
    for (std::string line; std::getline(before, line);) known.insert(line);
    std::string changed = "\n";
    for (std::string line; std::getline(after, line);) {
      if (!known.contains(line)) changed += line + "\n";
    }
    return changed;
  }
  template <class Word>
  Word at(std::uint64_t place) const {
    Word word;
    std::memcpy(&word, bytes_.data() + place, sizeof(word));
    return word;
  }
  std::uint64_t channel(std::uint32_t c, std::size_t member) const {
    return places.channels + c * sizeof(ChannelEntry) + member;
  }
  /// Of a queue's memory.
  std::uint64_t ring(std::uint32_t c, std::size_t member) const {
    return places.data +
           std::uint64_t{at<std::uint32_t>(channel(c, offsetof(ChannelEntry, granule)))} *
               lot::segment::kGranule +
           member;
  }
  std::uint64_t block(std::uint32_t b, std::size_t member) const {
    return places.blocks + b * sizeof(BlockWords) + member;
  }

  lot::segment::Capacity capacity;
  Geometry places{};

 private:
  std::string seen() const {
    tool::Window window(path_, {});
    return text_of(observe(window));
  }
  void write(std::uint64_t at, const void* bytes, std::size_t size) const {
    std::fstream file(path_, std::ios::binary | std::ios::in | std::ios::out);
    file.seekp(static_cast<std::streamoff>(at));
    file.write(static_cast<const char*>(bytes), static_cast<std::streamsize>(size));
  }

  Room room_;
  std::string path_ = room_.path() + "/s";
  std::string bytes_;
  std::string before_;
};

constexpr std::size_t kWho = sizeof(RingHead);
constexpr std::size_t kSlots = kWho + 64;
constexpr std::size_t kCells = kSlots + 64;

}  // namespace

TEST_SUITE_BEGIN("observation");

TEST_CASE("all that there is in a segment is seen") {
  const Picture picture;
  CHECK("\n" + picture.text() == R"(
process 1 publisher lives, 50688
process 2 reader lives, 0
topic 0 /letters lot::testing::Letter 24 used subscribers 2 observers
topic 1 /parcels lot::testing::Parcel 6024 used subscribers 2 observers
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 1
queue 1 of 1 topic 1 depth 4 policy 1 engine 1 waits next 9 of 5: 5=71 6=72 7=73 8=74; 2 lag 4 lost 0 holds
message 64 of 1 /letters 256, 2 keeps
message 65 of 1 /letters 256, 2 borrows
message 66 of 1 /letters 256, 1 queues
message 67 of 1 /letters 256, 1 queues
message 68 of 1 /letters 256, 1 queues
message 69 of 1 /letters 256, 1 queues
message 70 of 1 /parcels 8192, 2 keeps
message 71 of 1 /parcels 8192, 1 queues
message 72 of 1 /parcels 8192, 1 queues
message 73 of 1 /parcels 8192, 1 queues
message 74 of 1 /parcels 8192, 1 queues
message 75 of 1 /parcels 8192, 1 spare
memory 57344 of 11137024 held back 8192 messages 12 of 512
)");
}

TEST_CASE("a word of a process, a lock or a topic that cannot be is damage") {
  const Picture p;
  const auto process = [&](std::uint32_t k, std::size_t member) {
    return p.places.participants + k * sizeof(ParticipantEntry) + member;
  };
  CHECK(p.with(process(1, 0), 0U) == R"(
queue 1 of 1 topic 1 depth 4 policy 1 engine 1 next 9 of 5: 5=71 6=72 7=73 8=74; 2 lag 4 lost 0 holds
)");
  CHECK(p.with(process(1, 0), 7U) == R"(
damaged: process 1: its state is 7
)");
  CHECK(p.with(process(3, 0), 1U) == R"(
process 3 is dead, 0
)");
  CHECK(p.with(process(1, offsetof(ParticipantEntry, name)), '\0') == R"(
process 1 lives, 50688
)");
  const std::uint32_t most = p.capacity.participants;
  for (const std::size_t lock : {offsetof(Directory, lock), offsetof(Directory, orphanage)}) {
    CHECK(p.with(p.places.directory + lock, lot::lock::make_name(most - 1, 0)) == "\n");
    CHECK(p.with(p.places.directory + lock, lot::lock::make_name(most, 0)) ==
          std::string("\ndamaged: the lock of the ") +
              (lock == offsetof(Directory, lock) ? "registry" : "orphanage") +
              ": its holder can not be\n");
  }
  CHECK(p.with(p.places.directory + offsetof(Directory, persists), 1U) == R"(
memory 57344 of 11137024 held back 8192 messages 12 of 512 persists
)");
  const std::uint64_t users = p.places.topics;
  const std::uint64_t observers = users + offsetof(TopicEntry, observers);
  CHECK(p.with(users, std::uint64_t{2}) == R"(
topic 0 /letters lot::testing::Letter 24 used subscribers observers
)");
  CHECK(p.with(users, std::uint64_t{7}) == R"(
damaged: topic 0: a user 0 can not be
)");
  CHECK(p.with(users, std::uint64_t{6} | std::uint64_t{1} << most) == R"(
damaged: topic 0: a user 8 can not be
)");
  CHECK(p.with(users, std::uint64_t{6} | std::uint64_t{1} << (most - 1)) == R"(
)");
  CHECK(p.with(users + 8, std::uint64_t{1}) == R"(
damaged: topic 0: a user 63 can not be
)");
  CHECK(p.with(users, std::uint64_t{0}) == R"(
)");
  CHECK(p.with(observers, std::uint64_t{4}) == R"(
topic 0 /letters lot::testing::Letter 24 used subscribers 2 observers 2
)");
  CHECK(p.with(observers, std::uint64_t{1}) == R"(
damaged: topic 0: an observer 0 can not be
)");
  CHECK(p.with(users + offsetof(TopicEntry, pullers) + 2, std::uint16_t{1}) == R"(
topic 0 /letters lot::testing::Letter 24 used subscribers 1 2 observers
)");
  CHECK(p.with(users + offsetof(TopicEntry, name), '\0') == R"(
topic 0  lot::testing::Letter 24 used subscribers 2 observers
message 64 of 1  256, 2 keeps
message 65 of 1  256, 2 borrows
message 66 of 1  256, 1 queues
message 67 of 1  256, 1 queues
message 68 of 1  256, 1 queues
message 69 of 1  256, 1 queues
)");
}

TEST_CASE("a word of a queue that cannot be is damage, and one that can be is believed") {
  const Picture p;
  const auto writer = p.at<std::uint64_t>(p.channel(0, 0));
  const auto with_state = [&](std::uint64_t state) {
    return p.with(p.channel(0, 0), (writer & ~(std::uint64_t{0xff} << 24)) | state << 24);
  };
  CHECK(with_state(0) == R"(
message 65 of 1 /letters 256, 1 spare
message 66 of 1 /letters 256, 1 spare
message 67 of 1 /letters 256, 1 spare
message 68 of 1 /letters 256, 1 spare
message 69 of 1 /letters 256, 1 spare
)");
  CHECK(with_state(1) == R"(
message 65 of 1 /letters 256, 1 spare
message 66 of 1 /letters 256, 1 spare
message 67 of 1 /letters 256, 1 spare
message 68 of 1 /letters 256, 1 spare
message 69 of 1 /letters 256, 1 spare
)");
  CHECK(with_state(3) == R"(
queue 0 gone of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 1
)");
  CHECK(with_state(4) == R"(
message 65 of 1 /letters 256, 1 spare
message 66 of 1 /letters 256, 1 spare
message 67 of 1 /letters 256, 1 spare
message 68 of 1 /letters 256, 1 spare
message 69 of 1 /letters 256, 1 spare
damaged: queue 0: its state is 4
)");
  const auto with_owner = [&](std::uint64_t owner) {
    return p.with(p.channel(0, 0), (writer & ~std::uint64_t{0xffffff}) | owner);
  };
  CHECK(with_owner(p.capacity.participants - 1) == R"(
queue 0 of 7 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 1
message 66 of 1 /letters 256, 7 queues
message 67 of 1 /letters 256, 7 queues
message 68 of 1 /letters 256, 7 queues
message 69 of 1 /letters 256, 7 queues
)");
  CHECK(with_owner(p.capacity.participants) == R"(
message 65 of 1 /letters 256, 1 spare
message 66 of 1 /letters 256, 1 spare
message 67 of 1 /letters 256, 1 spare
message 68 of 1 /letters 256, 1 spare
message 69 of 1 /letters 256, 1 spare
damaged: queue 0: its publisher can not be
)");
  CHECK(p.with(p.channel(0, offsetof(ChannelEntry, topic)), p.capacity.topics - 1) == R"(
queue 0 of 1 topic 5 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 1
)");
  CHECK(p.with(p.channel(0, offsetof(ChannelEntry, topic)), p.capacity.topics) == R"(
message 65 of 1 /letters 256, 1 spare
message 66 of 1 /letters 256, 1 spare
message 67 of 1 /letters 256, 1 spare
message 68 of 1 /letters 256, 1 spare
message 69 of 1 /letters 256, 1 spare
damaged: queue 0: its topic can not be
)");
  CHECK(p.with(p.channel(0, offsetof(ChannelEntry, depth)), 0U) == R"(
message 65 of 1 /letters 256, 1 spare
message 66 of 1 /letters 256, 1 spare
message 67 of 1 /letters 256, 1 spare
message 68 of 1 /letters 256, 1 spare
message 69 of 1 /letters 256, 1 spare
damaged: queue 0: its numbers make no sense
)");
  CHECK(p.with(p.channel(0, offsetof(ChannelEntry, policy)), 1U) == R"(
queue 0 of 1 topic 0 depth 4 policy 1 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 0 holds
)");
  CHECK(p.with(p.channel(1, offsetof(ChannelEntry, policy)), 0U) == R"(
queue 1 of 1 topic 1 depth 4 policy 0 engine 1 next 9 of 5: 5=71 6=72 7=73 8=74; 2 lag 4 lost 0
)");
  CHECK(p.with(p.channel(0, offsetof(ChannelEntry, engine)), 1U) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 1 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 1
)");
  CHECK(p.with(p.ring(0, offsetof(RingHead, stamps)), 1U) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 stamps next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 5 lost 1
)");
  CHECK(p.with(p.ring(0, offsetof(RingHead, space)), 1U) == R"(
)");
  CHECK(p.with(p.ring(1, offsetof(RingHead, space)), 0U) == R"(
queue 1 of 1 topic 1 depth 4 policy 1 engine 1 next 9 of 5: 5=71 6=72 7=73 8=74; 2 lag 4 lost 0 holds
)");
  CHECK(p.with(p.ring(0, kWho), p.capacity.participants) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 7 lag 5 lost 1
message 65 of 1 /letters 256, 7 borrows
)");
  CHECK(p.with(p.ring(0, kWho), p.capacity.participants + 1) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69
message 65 of 1 /letters 256, 1 spare
damaged: queue 0: a reader of it can not be
)");
  CHECK(p.with(p.ring(0, kWho), 0U) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69
message 65 of 1 /letters 256, 1 spare
)");
}

TEST_CASE("slots and places of readers say who is behind, who holds back, who joins") {
  const Picture p;
  const std::uint64_t slot = p.ring(0, kSlots);
  const auto word = p.at<std::uint64_t>(slot);
  const std::uint64_t mask = (std::uint64_t{1} << lot::ring::kBlockBits) - 1;
  CHECK(p.with(slot, (word & ~mask) | (p.capacity.blocks - 1)) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=511 9=69; 2 lag 5 lost 1
message 68 of 1 /letters 256, 1 spare
)");
  CHECK(p.with(slot, (word & ~mask) | p.capacity.blocks) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 9=69; 2 lag 5 lost 1
message 68 of 1 /letters 256, 1 spare
damaged: queue 0: a slot of it names a message that can not be
)");
  CHECK(p.with(slot, (word & ~mask) | lot::ring::kInSlot) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 9=69; 2 lag 5 lost 1
message 68 of 1 /letters 256, 1 spare
damaged: queue 0: a slot of it names a message that can not be
)");
  CHECK(p.with(slot, (word & ~mask) | lot::ring::kNoBlock) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 9=69; 2 lag 5 lost 1
message 68 of 1 /letters 256, 1 spare
)");
  for (const std::uint32_t c : {0U, 1U}) {
    CAPTURE(c);
    const std::uint64_t cell = p.ring(c, kCells);
    const auto position = p.at<std::uint64_t>(cell);
    const auto at_sequence = [&](std::int64_t by) {
      const std::uint64_t one = std::uint64_t{1} << lot::ring::kSequenceShift;
      return p.with(cell, position + static_cast<std::uint64_t>(by) * one);
    };
    if (c == 0) {
      CHECK(at_sequence(-1) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 6 lost 2
)");
      CHECK(at_sequence(1) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 4 lost 0
)");
      CHECK(at_sequence(5) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 0 lost 0
)");
      CHECK(at_sequence(6) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 0 lost 0
)");
      CHECK(p.with(cell, (position & ~mask) | p.capacity.blocks) == R"(
message 65 of 1 /letters 256, 1 spare
damaged: queue 0: a reader of it borrows a message that can not be
)");
      CHECK(p.with(cell, (position & ~mask) | (p.capacity.blocks - 1)) == R"(
message 65 of 1 /letters 256, 1 spare
)");
      CHECK(p.with(cell, (position & ~mask) | lot::ring::kNoBlock) == R"(
message 65 of 1 /letters 256, 1 spare
)");
      CHECK(p.with(cell, lot::ring::kIdle) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 0 lost 0 joins
message 65 of 1 /letters 256, 1 spare
)");
      CHECK(p.with(cell, lot::ring::kObserverJoins) == R"(
queue 0 of 1 topic 0 depth 4 policy 0 engine 0 next 10 of 6: 6=66 7=67 8=68 9=69; 2 lag 0 lost 0 joins observes
message 65 of 1 /letters 256, 1 spare
)");
    } else {
      CHECK(at_sequence(-1) == R"(
queue 1 of 1 topic 1 depth 4 policy 1 engine 1 waits next 9 of 5: 5=71 6=72 7=73 8=74; 2 lag 5 lost 0 holds
)");
      CHECK(at_sequence(1) == R"(
queue 1 of 1 topic 1 depth 4 policy 1 engine 1 next 9 of 5: 5=71 6=72 7=73 8=74; 2 lag 3 lost 0
)");
    }
  }
}

TEST_CASE("owners and tags of memory say which process has a message, or that none can") {
  const Picture p;
  const auto home = [&](std::uint32_t b) { return p.block(b, offsetof(BlockWords, home)); };
  CHECK(p.with(home(64), 0U) == R"(
process 1 publisher lives, 50432
memory 57344 of 11137024 held back 8192 messages 11 of 512
)");
  CHECK(p.with(home(64), 1U) == R"(
process 1 publisher lives, 50432
message 64 of 0 /letters 256, 1 keeps, 2 keeps
)");
  CHECK(p.with(home(64), p.capacity.participants) == R"(
process 1 publisher lives, 50432
message 64 of 7 /letters 256, 1 keeps, 2 keeps
)");
  CHECK(p.with(home(64), p.capacity.participants + 1) == R"(
process 1 publisher lives, 50432
damaged: message 64: who made it can not be
)");
  CHECK(p.with(home(0), 2U) == R"(
process 1 publisher lives, 50944
message 0 of 1  256, 1 spare
memory 57344 of 11137024 held back 8192 messages 13 of 512
)");
  const std::uint64_t own = p.block(64, offsetof(BlockWords, own));
  CHECK(p.with(own, std::uint64_t{0}) == R"(
message 64 of 1 /letters 256, 1 spare
)");
  CHECK(p.with(own, std::uint64_t{1}) == R"(
message 64 of 1 /letters 256, 1 spare
)");
  CHECK(p.with(own, std::uint64_t{2}) == R"(
message 64 of 1 /letters 256, 1 spare
)");
  CHECK(p.with(own, std::uint64_t{6}) == R"(
)");
  CHECK(p.with(own, std::uint64_t{8}) == R"(
message 64 of 1 /letters 256, 1 spare
)");
  CHECK(p.with(own, std::uint64_t{1} << p.capacity.participants) == R"(
message 64 of 1 /letters 256, 1 spare
damaged: message 64: a holder 8 can not be
)");
  CHECK(p.with(p.block(64, offsetof(BlockWords, home_points)), 1U) == R"(
message 64 of 1 /letters 256, 1 keeps, 2 keeps
)");
  const std::uint64_t last = p.places.tags + (p.places.granules - 1) * sizeof(std::uint32_t);
  for (const std::uint32_t tag : {65U, p.capacity.blocks, p.capacity.blocks + 1,
                                  lot::segment::kRingTag | (p.capacity.channels - 1),
                                  lot::segment::kRingTag | p.capacity.channels}) {
    CAPTURE(tag);
    const std::string changed = p.with(last, tag);
    const bool is_strange =
        tag == p.capacity.blocks + 1 || tag == (lot::segment::kRingTag | p.capacity.channels);
    CHECK((changed.find("damaged: 1 pieces of memory belong to what can not be") !=
           std::string::npos) == is_strange);
    CHECK(changed.find("memory 61440 of") != std::string::npos);
    CHECK((changed.find("message 64 of 1 /letters 4096") != std::string::npos) == (tag == 65));
  }
}

TEST_SUITE_END();
