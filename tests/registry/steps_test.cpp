// SPDX-License-Identifier: Apache-2.0

// The registry's steps one by one, as tables: what each changes in the segment, and what it leaves.

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/compliance.hpp"
#include "lot/error.hpp"

#include "description/by_hand.hpp"
#include "description/wire.hpp"
#include "registry/known_type.hpp"
#include "registry/registry.hpp"
#include "support/error_of.hpp"
#include "support/local_segment.hpp"
#include "support/raw.hpp"

namespace {

using namespace lot::testing;
using lot::Kind;
using lot::Policy;
using lot::QueueEngine;
using lot::detail::MessageType;
using lot::registry::ChannelName;
using lot::registry::KnownType;
using lot::registry::Registry;
using lot::registry::RingOptions;
using lot::registry::Role;
using lot::ring::State;
using lot::segment::kFinished;
using lot::segment::kTaken;
using lot::test::raw;
using Names = std::vector<std::string>;
using Rings = std::vector<ChannelName>;

constexpr std::uint32_t kBits = lot::segment::Atomics::kBitsPerWord;
constexpr std::uint32_t kParticipants = 200, kTopics = 4, kChannels = 4, kReaders = 8;

MessageType type(const char* name, std::uint64_t size = 8, std::uint64_t align = 8,
                 std::uint64_t hash = 0) {
  MessageType made{};
  made.size = size;
  made.align = align;
  made.hash = hash;
  made.name = name;
  return made;
}

/// A segment, and its registry with the lock taken. All participants are there.
struct Fixture {
  Fixture() {
    for (std::uint32_t k = 1; k < kParticipants; ++k) live(k, true);
  }
  void live(std::uint32_t k, bool does) { raw(segment.participants()[k].state) = does; }
  void set(const ChannelName& name, State state) {
    raw(segment.channels()[name.channel].writer) =
        lot::ring::make_writer(name.generation, state, 1);
  }
  bool user(std::uint32_t topic, std::uint32_t k) {
    return (segment.topics()[topic].users[k / kBits].load() >> k % kBits & 1) != 0;
  }
  bool observer(std::uint32_t topic, std::uint32_t k) {
    return (segment.topics()[topic].observers[k / kBits].load() >> k % kBits & 1) != 0;
  }
  /// The participants of each cell that awaits one.
  std::vector<std::uint32_t> awaited(std::uint32_t channel) {
    std::vector<std::uint32_t> found;
    const lot::segment::Ring ring = segment.ring(channel);
    for (std::uint32_t c = 0; c < ring.readers; ++c) {
      if (ring.who[c].load() != 0) found.push_back(ring.who[c].load() - 1);
    }
    return found;
  }

  LocalSegment local{{8 << 20, kParticipants, 16, kTopics, kChannels, kReaders}};
  lot::segment::Segment& segment = local.segment();
  Registry& registry = local.registry();
  Registry::Lock lock{registry};
};

lot::Description number(std::uint64_t size, const std::string& field) {
  lot::Description all;
  all.types = {by_hand::structure("s", size, {by_hand::field(field, 1, 0)}),
               by_hand::type(Kind::UInt, 4)};
  return all;
}

}  // namespace

TEST_SUITE_BEGIN("registry");

TEST_CASE_FIXTURE(Fixture, "each participant has a bit of its own, as a user and as an observer") {
  const MessageType apple = type("apple");
  const std::vector<std::uint32_t> some{
      1, 2, kBits - 1, kBits, kBits + 1, 2 * kBits - 1, 2 * kBits, 2 * kBits + 1, 199};
  REQUIRE(registry.enter("/t", apple, 1) == 0);
  for (const std::uint32_t k : some) {
    CHECK(registry.enter("/t", apple, k) == 0);
    CHECK(registry.enter("/t", apple, k, Role::Observer) == 0);
  }
  const auto are = [&](auto&& is, std::uint32_t without) {
    std::vector<std::uint32_t> found;
    std::vector<std::uint32_t> expected;
    for (std::uint32_t k = 0; k < kParticipants; ++k) {
      if (is(k)) found.push_back(k);
    }
    for (const std::uint32_t k : some) {
      if (k != without) expected.push_back(k);
    }
    return found == expected;
  };
  const auto users = [&](std::uint32_t k) { return user(0, k); };
  const auto observers = [&](std::uint32_t k) { return observer(0, k); };
  CHECK(are(users, 0));
  CHECK(are(observers, 0));
  for (const std::uint32_t k : some) {
    CAPTURE(k);
    registry.leave(0, k);
    CHECK(are(users, k));
    CHECK(are(observers, 0));
    registry.enter("/t", apple, k);
    registry.leave(0, k, Role::Observer);
    CHECK(are(users, 0));
    CHECK(are(observers, k));
    registry.enter("/t", apple, k, Role::Observer);
    registry.forget(k);
    CHECK(are(users, k));
    CHECK(are(observers, k));
    registry.forget(k);  // it has nothing more
    registry.enter("/t", apple, k);
    registry.enter("/t", apple, k, Role::Observer);
  }
}

TEST_CASE_FIXTURE(Fixture, "a dead participant is forgotten at each topic, and no other one is") {
  const MessageType apple = type("apple");
  for (const char* name : {"/a", "/b", "/c", "/d"}) {
    for (const std::uint32_t k : {3U, 67U}) {
      const std::uint32_t topic = registry.enter(name, apple, k);
      registry.enter(name, apple, k, Role::Observer);
      registry.add_puller(topic, k);
      registry.add_puller(topic, k);
    }
  }
  registry.unsubscribe(67);
  for (std::uint32_t t = 0; t < kTopics; ++t) {
    CHECK(registry.has_pullers(t, 3));
    CHECK_FALSE(registry.has_pullers(t, 67));
    CHECK(segment.topics()[t].pullers[3].load() == 2);
    CHECK(user(t, 67));
  }
  registry.forget(67);
  for (std::uint32_t t = 0; t < kTopics; ++t) {
    CHECK(user(t, 3));
    CHECK(observer(t, 3));
    CHECK_FALSE(user(t, 67));
    CHECK_FALSE(observer(t, 67));
    registry.remove_puller(t, 3);
    CHECK(registry.has_pullers(t, 3));
    registry.remove_puller(t, 3);
    CHECK_FALSE(registry.has_pullers(t, 3));
  }
}

TEST_CASE_FIXTURE(Fixture, "a topic is told by its type's name, size, alignment and hash") {
  const std::string cut(lot::segment::kTypeNameBytes - 1, 'n');
  const std::string longer = cut + "x", other = cut.substr(1) + "xx", alike = cut + "yz";
  const MessageType first = type(longer.c_str(), 16, 8, 7);
  REQUIRE(registry.enter("/t", first, 1) == 0);
  const auto& entry = segment.topics()[0];
  CHECK(entry.type_size == 16);
  CHECK(entry.type_align == 8);
  CHECK(entry.type_hash == 7);
  CHECK(entry.type_layout == 0);
  CHECK(std::string(entry.name) == "/t");
  CHECK(std::string(entry.type_name) == cut);
  struct Row {
    MessageType type;
    bool is_same;
    bool is_hash;  ///< only the hash differs, and the text says so
  };
  for (const Row& row : {Row{first, true, false},                          //
                         Row{type(cut.c_str(), 16, 8, 7), true, false},    //
                         Row{type(alike.c_str(), 16, 8, 7), true, false},  //
                         Row{type(other.c_str(), 16, 8, 7), false, false},
                         Row{type(longer.c_str(), 24, 8, 7), false, false},
                         Row{type(longer.c_str(), 16, 16, 7), false, false},
                         Row{type(longer.c_str(), 16, 8, 6), false, true},
                         Row{type(other.c_str(), 16, 8, 6), false, false}}) {
    const std::string name = row.type.name;
    CAPTURE(name);
    const auto [error, text] = error_of([&] { registry.enter("/t", row.type, 2); });
    CHECK(error == (row.is_same ? 0 : EPROTOTYPE));
    CHECK(user(0, 2) == row.is_same);
    CHECK((text.find("TypeIdentity::hash() differs") != std::string::npos) == row.is_hash);
    registry.leave(0, 2);
  }
  const auto known = registry.type_of("/t");
  REQUIRE(known);
  CHECK(known->name() == cut);
  CHECK(known->type().name == known->name());
  CHECK(known->type().size == 16);
  CHECK(known->type().align == 8);
  CHECK(known->type().hash == 7);
  CHECK((known->type().described == nullptr));
  CHECK(known->description().root().kind == Kind::Opaque);
  CHECK(known->description().root().size == 16);
  CHECK(known->description().root().name == cut);
}

TEST_CASE_FIXTURE(Fixture, "a name leads to a topic with users, an observed or a free one") {
  const MessageType apple = type("apple"), pear = type("pear"), fig = type("fig");
  CHECK(registry.type_of("/t") == nullptr);
  CHECK(registry.names() == Names{});
  REQUIRE(registry.enter("/o", apple, 1) == 0);
  REQUIRE(registry.enter("/t", apple, 2, Role::Observer) == 1);
  CHECK(registry.names() == Names{"/o"});  // an observed one does not count
  CHECK(registry.type_of("/t")->name() == "apple");
  CHECK_FALSE(registry.is_superseded(1));
  CHECK(registry.enter("/t", pear, 3, Role::Observer) == 2);  // beside the other one
  CHECK(registry.enter("/t", apple, 4, Role::Observer) == 1);
  CHECK_FALSE(registry.is_superseded(1));
  CHECK(registry.enter("/t", pear, 5) == 2);
  CHECK(registry.names() == Names{"/o", "/t"});
  CHECK(registry.is_superseded(1));
  CHECK_FALSE(registry.is_superseded(2));
  CHECK(registry.type_of("/t")->name() == "pear");
  CHECK(error_of([&] { registry.enter("/t", apple, 6, Role::Observer); }).first == EPROTOTYPE);
  registry.leave(2, 5);
  CHECK_FALSE(registry.is_superseded(1));
  CHECK(registry.enter("/t", fig, 6) == 3);
  const auto [error, text] = error_of([&] { registry.enter("/n", apple, 7); });
  CHECK(error == ENOSPC);
  CHECK(text.find("all 4 topics are in use") != std::string::npos);
  registry.leave(0, 1);
  CHECK(registry.enter("/n", fig, 7) == 0);
  CHECK(std::string(segment.topics()[0].name) == "/n");
  CHECK(std::string(segment.topics()[0].type_name) == "fig");
}

TEST_CASE_FIXTURE(Fixture, "of a topic that has gone nothing is left in its entry") {
  const KnownType described("a long name of a type", 4, 9, number(12, "x"));
  REQUIRE(registry.enter("/a/long/name", described.type(), 1) == 0);
  const auto& entry = segment.topics()[0];
  const lot::detail::Described all = lot::detail::make_described(number(12, "x"));
  CHECK(entry.type_layout == all.layout);
  CHECK(entry.type_names.load() == all.names);
  CHECK(entry.description.load() != 0);
  const auto [mismatch, why] = error_of([&] { registry.enter("/a/long/name", type("t"), 2); });
  CHECK(mismatch == EPROTOTYPE);
  // Nothing more is said of two types of different names.
  CHECK_MESSAGE(why.find("this side wants t (8 bytes, alignment 8); build ") != std::string::npos,
                why);
  registry.leave(0, 1);
  REQUIRE(registry.enter("/b", type("b", 16, 8, 3), 1) == 0);
  const auto is_text = [](const auto& bytes, const std::string& text) {
    std::string all_bytes = text;
    all_bytes.resize(sizeof(bytes));
    return std::string(bytes, sizeof(bytes)) == all_bytes;
  };
  CHECK(is_text(entry.name, "/b"));
  CHECK(is_text(entry.type_name, "b"));
  CHECK(entry.type_layout == 0);
  CHECK(entry.type_names.load() == 0);
  CHECK(entry.description.load() == 0);
  for (const std::size_t length : {0U, 200U}) {
    const auto [error, text] =
        error_of([&] { registry.enter(std::string(length, 'n'), type("b"), 1); });
    CHECK(error == EINVAL);
    CHECK(text.find("use 1 to 199 bytes") != std::string::npos);
  }
  CHECK(registry.enter(std::string(199, 'n'), type("b"), 1) == 1);
}

TEST_CASE_FIXTURE(Fixture, "a topic whose items wait keeps its description, others lose theirs") {
  const KnownType x("s", 4, 9, number(12, "x")), y("s", 4, 9, number(12, "y"));
  const std::uint32_t topic = registry.enter("/a", x.type(), 1);
  const ChannelName name =
      *registry.open(topic, 1, {4, 2, Policy::Block, QueueEngine::Ring, kTaken});
  segment.ring(name.channel).slots[0] = lot::ring::make(4, 3);
  set(name, State::Orphan);
  registry.leave(topic, 1);
  const std::uint64_t kept = segment.topics()[topic].description.load();
  const std::uint32_t other = registry.enter("/b", y.type(), 1);
  const std::uint64_t behind = segment.topics()[other].description.load();
  CHECK(lot::segment::description_offset(behind) > lot::segment::description_offset(kept));
  set(name, State::Free);
  registry.leave(other, 1);
  const std::uint32_t last = registry.enter("/c", y.type(), 1);
  CHECK(lot::segment::description_offset(segment.topics()[last].description.load()) == 0);
}

TEST_CASE_FIXTURE(Fixture, "a ring is as it was asked for, and awaits each puller that is there") {
  const MessageType apple = type("apple");
  const std::uint32_t topic = registry.enter("/t", apple, 1);
  const std::uint32_t other = registry.enter("/other", apple, 1);
  REQUIRE(other == 1);
  std::memcpy(segment.participants()[1].name, "maker", 6);
  for (const std::uint32_t k : {5U, 70U, 70U, 199U}) registry.add_puller(topic, k);
  registry.add_puller(topic, 9);
  live(9, false);  // no process has that index
  registry.add_puller(other, 6);
  RingOptions options{5, 4, Policy::Block, QueueEngine::Mutex, kFinished};
  options.extra = lot::segment::kExtraBytes;
  options.stamps = true;
  const std::uint32_t version = segment.directory().version.load();
  const auto name = registry.open(topic, 1, options);
  REQUIRE(name);
  CHECK(*name == ChannelName{0, 1});
  CHECK(segment.directory().version.load() == version + 1);
  const auto& entry = segment.channels()[0];
  CHECK(entry.writer.load() == lot::ring::make_writer(1, State::Live, 1));
  CHECK(entry.topic == topic);
  CHECK(entry.depth == 5);
  CHECK(entry.readers == 4);
  CHECK(entry.policy == static_cast<std::uint32_t>(Policy::Block));
  CHECK(entry.engine == static_cast<std::uint32_t>(QueueEngine::Mutex));
  CHECK(entry.taken == kFinished);
  CHECK(entry.stride == 0);
  CHECK(entry.extra == lot::segment::kExtraBytes);
  CHECK(entry.first == 5);  // its depth
  CHECK(entry.granules == Registry::granules_of(options));
  CHECK(entry.formed.load() == 1);
  CHECK(segment.granules().tag(entry.granule) == lot::segment::kRingTag);
  CHECK(segment.granules().used() == entry.granules);
  const lot::segment::Ring ring = segment.ring(0);
  REQUIRE(ring.depth == 5);
  CHECK(std::string(lot::segment::Segment::head_of(ring).publisher) == "maker");
  CHECK(lot::segment::Segment::head_of(ring).stamps == 1);
  CHECK(awaited(0) == std::vector<std::uint32_t>{5, 70, 70, 199});

  options = {3, 4, Policy::Overwrite, QueueEngine::Ring};
  options.first = 77;
  options.stride = 64;
  const auto second = registry.open(other, 2, options);
  REQUIRE(second);
  CHECK(*second == ChannelName{1, 1});
  CHECK(segment.channels()[1].first == 77);
  CHECK(segment.channels()[1].stride == 64);
  CHECK(segment.channels()[1].taken == 0);
  CHECK(lot::segment::Segment::head_of(segment.ring(1)).stamps == 0);
  CHECK(awaited(1) == std::vector<std::uint32_t>{6});
  CHECK(segment.granules().tag(segment.channels()[1].granule) == (lot::segment::kRingTag | 1));

  options.readers = 3;
  const auto [error, text] = error_of([&] { (void)registry.open(topic, 2, options); });
  CHECK(error == EUSERS);
  CHECK(text.find("has 4 subscribers, and a publisher has 3 readers at most") != std::string::npos);
  CHECK(segment.channels()[2].writer.load() == 0);  // and nothing was taken
}

TEST_CASE_FIXTURE(Fixture, "where a ring has no memory its channel is free again, and one newer") {
  const std::uint32_t topic = registry.enter("/t", type("apple"), 1);
  const std::uint32_t all = segment.granules().count();
  REQUIRE(segment.granules().claim(all, 1) == 0);
  const std::uint32_t version = segment.directory().version.load();
  CHECK_FALSE(registry.open(topic, 1, {5, 4}));
  CHECK(segment.channels()[0].writer.load() == lot::ring::make_writer(1, State::Free, 0));
  CHECK(segment.channels()[0].formed.load() == 0);
  CHECK(segment.directory().version.load() == version);
  segment.granules().release(0, all);
  CHECK(registry.open(topic, 1, {5, 4}) == ChannelName{0, 2});
  for (std::uint32_t c = 1; c < kChannels; ++c) {
    CHECK(registry.open(topic, 1, {5, 4}) == ChannelName{c, 1});
  }
  const std::uint32_t used = segment.granules().used();
  const auto [error, text] = error_of([&] { (void)registry.open(topic, 1, {5, 4}); });
  CHECK(error == ENOSPC);
  CHECK(text.find("all 4 channels are in use") != std::string::npos);
  CHECK(segment.granules().used() == used);
  registry.recycle(2);
  CHECK(segment.channels()[2].formed.load() == 0);
  CHECK(segment.channels()[1].formed.load() == 1);
  CHECK(segment.granules().used() == used - segment.channels()[2].granules);
  CHECK(segment.granules().tag(segment.channels()[3].granule) == (lot::segment::kRingTag | 3));
}

TEST_CASE_FIXTURE(Fixture, "the rings of a topic are those that are live or have ended") {
  const std::uint32_t a = registry.enter("/a", type("apple"), 1);
  const std::uint32_t b = registry.enter("/b", type("apple"), 1);
  const ChannelName first = *registry.open(a, 1, {4, 2}), second = *registry.open(b, 1, {4, 2});
  const ChannelName third = *registry.open(a, 1, {4, 2, Policy::Block, QueueEngine::Ring, kTaken});
  CHECK(registry.rings(a) == Rings{first, third});
  CHECK(registry.rings(b) == Rings{second});
  struct Row {
    State state;
    bool is_listed;
    bool is_open;
  };
  for (const Row& row : {Row{State::Free, false, false}, Row{State::Init, false, false},
                         Row{State::Live, true, true}, Row{State::Orphan, true, false}}) {
    CAPTURE(static_cast<int>(row.state));
    for (const ChannelName& name : {first, third}) {
      set(name, row.state);
      CHECK(registry.is_open(name) == row.is_open);
      CHECK_FALSE(registry.is_open({name.channel, name.generation + 1}));
    }
    CHECK(registry.rings(a) == (row.is_listed ? Rings{first, third} : Rings{}));
    CHECK(registry.rings(b) == Rings{second});
  }
  // One item waits in the third, whose publisher has gone. It would in the first, were it a queue.
  for (const ChannelName& name : {first, third}) {
    segment.ring(name.channel).slots[0] = lot::ring::make(4, 3);
    CHECK(registry.is_open(name) == (name == third));
  }
}

TEST_CASE_FIXTURE(Fixture, "a topic whose items wait stays without users, and has its type") {
  const MessageType apple = type("apple");
  const std::uint32_t topic = registry.enter("/a", apple, 1);
  const ChannelName name =
      *registry.open(topic, 1, {4, 2, Policy::Block, QueueEngine::Ring, kTaken});
  segment.ring(name.channel).slots[0] = lot::ring::make(4, 3);
  set(name, State::Orphan);
  registry.leave(topic, 1);
  CHECK(registry.names() == Names{});
  REQUIRE(registry.type_of("/a") != nullptr);
  CHECK(registry.enter("/b", type("pear"), 2) == 1);
  CHECK(error_of([&] { registry.enter("/a", type("pear"), 2); }).first == EPROTOTYPE);
  segment.channels()[name.channel].taken = 0;  // messages for all readers are no items
  CHECK(registry.type_of("/a") == nullptr);
  segment.channels()[name.channel].taken = kTaken;
  set(name, State::Live);  // its publisher would be a user
  CHECK(registry.type_of("/a") == nullptr);
  set(name, State::Orphan);
  segment.ring(name.channel).slots[0] = lot::ring::make(4, lot::ring::kNoBlock);
  CHECK(registry.type_of("/a") == nullptr);  // the item was taken
  segment.ring(name.channel).slots[0] = lot::ring::make(4, 3);
  CHECK(registry.type_of("/a") != nullptr);
  segment.channels()[name.channel].topic = kTopics;  // a wild write
  CHECK(registry.type_of("/a") == nullptr);
}

TEST_CASE_FIXTURE(Fixture, "a puller that leaves gives up the cells that await it, one a ring") {
  const std::uint32_t topic = registry.enter("/t", type("apple"), 1);
  const std::uint32_t other = registry.enter("/other", type("apple"), 1);
  for (const std::uint32_t k : {5U, 5U, 6U}) registry.add_puller(topic, k);
  registry.add_puller(other, 5);
  const ChannelName first = *registry.open(topic, 1, {4, 4}),
                    known = *registry.open(topic, 1, {4, 4});
  const ChannelName away = *registry.open(other, 1, {4, 4}),
                    ended = *registry.open(topic, 1, {4, 4});
  set(ended, State::Orphan);
  using Cells = std::vector<std::uint32_t>;
  registry.remove({topic, Role::Observer, {}}, 5);
  CHECK(segment.topics()[topic].pullers[5].load() == 2);
  CHECK(awaited(first.channel) == Cells{5, 5, 6});
  registry.remove({topic, Role::User, {known}}, 5);
  CHECK(segment.topics()[topic].pullers[5].load() == 1);
  CHECK(segment.topics()[topic].pullers[6].load() == 1);
  CHECK(awaited(first.channel) == Cells{5, 6});
  CHECK(awaited(known.channel) == Cells{5, 5, 6});
  CHECK(awaited(away.channel) == Cells{5});
  CHECK(awaited(ended.channel) == Cells{5, 6});
  // It knows a ring of an earlier generation of that channel, which is another one.
  registry.remove({topic, Role::User, {{known.channel, known.generation + 1}}}, 6);
  CHECK(awaited(known.channel) == Cells{5, 5});
  CHECK(segment.topics()[topic].pullers[6].load() == 0);
}

TEST_CASE("how many granules a ring takes") {
  struct Row {
    RingOptions options;
    std::uint32_t granules;
  };
  const std::vector<Row> rows{
      {{1, 1}, 1},
      {{64, 8}, 1},
      {{1024, 8}, 3},
      {{472, 1}, 1},
      {{473, 1}, 2},
      {{66008, 1}, 129},
      {{66016, 1}, 130},
      {{1024, 256}, 7},
      {{65536, 1}, 129},
      {{1024, 256, Policy::Block, QueueEngine::Ring, kTaken}, 7},
      {{1024, 256, Policy::Block, QueueEngine::Ring, kFinished}, 9},
      {{1024, 256, Policy::Block, QueueEngine::Ring, kFinished, 0, lot::segment::kExtraBytes}, 10},
      // In slots of 64 bytes, with one to spare where a message may be overwritten or read by all.
      {{59, 1, Policy::Overwrite, QueueEngine::Ring, 0, 0, 0, false, 64}, 2},
      {{59, 1, Policy::Block, QueueEngine::Ring, 0, 0, 0, false, 64}, 2},
      {{59, 1, Policy::Overwrite, QueueEngine::Ring, kTaken, 0, 0, false, 64}, 2},
      {{59, 1, Policy::Block, QueueEngine::Ring, kTaken, 0, 0, false, 64}, 1},
      {{60, 1, Policy::Block, QueueEngine::Ring, kTaken, 0, 0, false, 64}, 2},
  };
  for (const Row& row : rows) {
    CAPTURE(row.options.depth);
    CAPTURE(row.options.readers);
    CHECK(Registry::granules_of(row.options) == row.granules);
  }
}

TEST_CASE("a known type is what its topic, its program or its description says") {
  lot::segment::TopicEntry topic{};
  topic.type_size = 12;
  topic.type_align = 4;
  topic.type_hash = 9;
  lot::Description described = number(12, "x");
  const std::string bytes = lot::description::encode(described);
  const lot::detail::Described all = lot::detail::make_described(described);
  {
    const KnownType plain("p", topic, std::nullopt);  // no description, and damaged bytes
    CHECK((plain.type().described == nullptr));
    CHECK(error_of([&] { (void)plain.description(); }).first == EBADMSG);
    const KnownType opaque("p", topic, std::string());
    CHECK(opaque.description().root().size == 12);
    CHECK_FALSE(plain.is_equal(opaque));
  }
  topic.type_layout = all.layout;
  raw(topic.type_names) = all.names + 1;
  const KnownType of_topic("s", topic, bytes);
  CHECK(of_topic.name() == "s");
  CHECK(of_topic.type().size == 12);
  CHECK(of_topic.type().align == 4);
  CHECK(of_topic.type().hash == 9);
  REQUIRE((of_topic.type().described != nullptr));
  const auto& known = of_topic.type().described(of_topic.type());
  CHECK(known.layout == all.layout);
  CHECK(known.names == all.names + 1);  // as the topic says
  CHECK(known.has_names);
  CHECK(known.bytes == bytes);
  // Damaged, or without a description: nothing else tells the two apart.
  CHECK_FALSE(KnownType("s", topic, std::nullopt).is_equal(KnownType("s", topic, std::string())));
  CHECK(KnownType("s", topic, std::nullopt).is_equal(KnownType("s", topic, std::nullopt)));
  for (const auto& bad : {std::optional<std::string>(), std::optional<std::string>("nonsense")}) {
    const KnownType damaged("s", topic, bad);
    CHECK(error_of([&] { (void)damaged.description(); }).first == EBADMSG);
    CHECK(damaged.type().described(damaged.type()).names == all.names + 1);
  }
  raw(topic.type_names) = 0;  // killed before the hash
  const KnownType finished("s", topic, bytes);
  CHECK(finished.type().described(finished.type()).names == all.names);
  topic.type_size = 16;  // the description says 12
  const KnownType wrong("s", topic, bytes);
  CHECK(error_of([&] { (void)wrong.description(); }).first == EBADMSG);
  CHECK(wrong.type().described(wrong.type()).names == 0);
  CHECK_FALSE(wrong.type().described(wrong.type()).has_names);
  topic.type_size = 12;
  topic.type_align = lot::detail::kMaxAlignment;
  CHECK(KnownType("s", topic, bytes).type().align == lot::detail::kMaxAlignment);
  for (const std::uint64_t align : {0U, 3U, 8192U}) {
    topic.type_align = align;
    const auto [error, text] = error_of([&] { const KnownType none("s", topic, bytes); });
    CHECK(error == EBADMSG);
    CHECK(text.find("its alignment is " + std::to_string(align)) != std::string::npos);
  }

  const KnownType made("s", 4, 9, described);
  CHECK(made.is_equal(finished));
  CHECK(made.type().size == 12);
  CHECK(made.type().described(made.type()).bytes == bytes);
  CHECK_FALSE(made.is_equal(of_topic));  // another hash of the names
  CHECK_FALSE(made.is_equal(wrong));
  CHECK_FALSE(made.is_equal(KnownType("t", 4, 9, described)));
  CHECK_FALSE(made.is_equal(KnownType("s", 2, 9, described)));
  CHECK_FALSE(made.is_equal(KnownType("s", 4, 8, described)));
  CHECK_FALSE(made.is_equal(KnownType("s", 4, 9, number(12, "y"))));
  CHECK_FALSE(made.is_equal(KnownType("s", 4, 9, number(16, "x"))));

  // Of a program: with what it says of itself, or nothing.
  const KnownType copy(made.type(), described);
  CHECK(copy.is_equal(made));
  MessageType silent = type("s", 12, 4, 9);
  const KnownType quiet(silent, described);
  CHECK((quiet.type().described == nullptr));
  CHECK(quiet.type().size == 12);
  CHECK(quiet.type().align == 4);
  CHECK(quiet.type().hash == 9);
  CHECK_FALSE(quiet.is_equal(made));

  // A queue of such items, each for one reader.
  const KnownType queue("q", made);
  CHECK(queue.name() == "q");
  CHECK(queue.type().hash == ~std::uint64_t{9});
  CHECK(queue.type().element == &made.type());
  CHECK(queue.type().size == 12);
  CHECK(queue.type().align == 4);
  CHECK(queue.type().described(queue.type()).bytes == bytes);
  const KnownType of_none("q", KnownType("s", 4, 0, described));
  CHECK(of_none.type().hash == 0);
  const KnownType of_quiet("q", quiet);
  CHECK((of_quiet.type().described == nullptr));
}

TEST_SUITE_END();
