// SPDX-License-Identifier: Apache-2.0

// The table of descriptions: shared, freed, full, damaged, left by the dead.

#include "registry/type_table.hpp"

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <map>
#include <memory>
#include <random>
#include <span>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/error.hpp"

#include "description/wire.hpp"
#include "registry/registry.hpp"
#include "support/local_segment.hpp"
#include "support/raw.hpp"
#include "support/seed.hpp"

namespace {

using namespace lot::testing;
using lot::Description;
using lot::detail::MessageType;
using lot::registry::Registry;
using lot::registry::Role;
using lot::registry::TypeTable;
using lot::segment::description_bytes;
using lot::segment::description_offset;

constexpr std::uint32_t kTopics = 400;

/// A type that says what it is made of. All have one name and size.
struct Made : MessageType {
  lot::detail::Described known;
};

/// `fields` numbers, called `names` and a number; "": nameless. `odd`: one of them is another kind.
/// Only the first `named` ones have names.
Made made(std::size_t fields, const std::string& names, std::size_t odd = ~std::size_t{0},
          std::size_t named = ~std::size_t{0}) {
  Description all;
  all.types.resize(3);
  all.types[0].kind = lot::Kind::Struct;
  all.types[0].size = 4096;
  all.types[1].kind = lot::Kind::UInt;
  all.types[2].kind = lot::Kind::Float;
  all.types[1].size = all.types[2].size = 4;
  for (std::size_t i = 0; i < fields; ++i) {
    Description::Field field;
    if (!names.empty() && i < named) field.name = names + std::to_string(i);
    field.type = i == odd ? 2 : 1;
    field.offset = 4 * i;
    all.types[0].fields.push_back(field);
  }
  Made type{};
  type.size = 4096;
  type.align = 8;
  type.name = "made";
  type.known = lot::detail::make_described(all);
  type.described = [](const MessageType& self) -> const lot::detail::Described& {
    return static_cast<const Made&>(self).known;
  };
  return type;
}

/// A segment, and what tests ask of it. One process plays all participants.
class Table {
 public:
  lot::segment::TopicEntry& entry(std::uint32_t topic) { return local_.segment().topics()[topic]; }
  std::uint64_t word(std::uint32_t topic) { return entry(topic).description.load(); }
  void set_word(std::uint32_t topic, std::uint64_t word) {
    lot::test::raw(entry(topic).description) = word;
  }
  std::uint32_t enter(const std::string& name, const MessageType& type, std::uint32_t who = 1,
                      Role role = Role::User) {
    const Registry::Lock lock(registry());
    return registry().enter(name, type, who, role);
  }
  /// The errno that a process gets; 0: it is let in.
  int refusal(const std::string& name, const MessageType& type) {
    try {
      leave(enter(name, type, 3), 3);
    } catch (const lot::Error& e) {
      return e.error_number();
    }
    return 0;
  }
  void leave(std::uint32_t topic, std::uint32_t who = 1, Role role = Role::User) {
    const Registry::Lock lock(registry());
    registry().leave(topic, who, role);
  }
  /// The bytes of a topic's description, as a process sees it that has no type. "": it has none.
  /// The text of an errno: it is damaged.
  std::string seen(const std::string& name) {
    const Registry::Lock lock(registry());
    const auto found = registry().type_of(name);
    if (found == nullptr) return "no topic";
    try {
      const auto bytes = found->type().described(found->type()).bytes;
      if (bytes.empty()) return found->description().root().kind == lot::Kind::Opaque ? "" : "?";
      return lot::description::encode(found->description());
    } catch (const lot::Error& e) {
      return e.error_number() == EBADMSG ? "damaged" : e.what();
    }
  }
  /// What a process knows by the topic that has no type.
  lot::detail::Described known(const std::string& name) {
    const Registry::Lock lock(registry());
    const auto found = registry().type_of(name);
    return found->type().described(found->type());
  }
  std::uint64_t place(const std::string& bytes, const std::vector<std::uint64_t>& words) {
    return TypeTable(local_.segment()).place(bytes, words);
  }
  std::span<std::uint64_t> pieces() { return local_.segment().descriptions(); }
  Registry& registry() { return local_.registry(); }

 private:
  LocalSegment local_{{16 << 20, 4, 16, kTopics, 4, 2}};
};

bool overlap(std::uint64_t a, std::uint64_t b) {
  const auto end = [](std::uint64_t word) {
    return description_offset(word) + description_bytes(word);
  };
  return description_offset(a) < end(b) && description_offset(b) < end(a);
}

/// About 6000 bytes.
Made large(const std::string& names) { return made(300, std::string(8, 'x') + names); }

}  // namespace

TEST_SUITE_BEGIN("registry");

TEST_CASE("programs agree on the check of a description: it is FNV-1a") {
  Table table;
  CHECK(lot::segment::description_check(table.place("a", {})) == 0xe40c292c);
  CHECK(lot::segment::description_check(table.place("foobar", {})) == 0xbf9cf968);
}

TEST_CASE("topics whose descriptions have equal bytes share them") {
  Table table;
  const Made one = made(3, "a"), other = made(3, "b");
  const auto a = table.enter("/a", one), b = table.enter("/b", one), c = table.enter("/c", other);
  CHECK(table.word(a) != 0);
  CHECK(table.word(a) == table.word(b));
  CHECK_FALSE(overlap(table.word(a), table.word(c)));
  CHECK(table.seen("/a") == one.known.bytes);
  CHECK(table.seen("/c") == other.known.bytes);
  table.leave(a);  // the other one still has them
  const auto d = table.enter("/d", made(3, "d"));
  CHECK_FALSE(overlap(table.word(b), table.word(d)));
  CHECK(table.seen("/b") == one.known.bytes);
}

TEST_CASE("other bytes with an equal check are not shared") {
  Table table;
  std::map<std::uint32_t, std::string> known;  // by check
  for (int i = 100'000'000;; ++i) {
    const std::string bytes = std::to_string(i);
    const std::uint64_t word = table.place(bytes, {});
    const auto [other, is_new] = known.emplace(lot::segment::description_check(word), bytes);
    if (is_new) continue;
    const std::uint64_t first = table.place(other->second, {});
    CHECK(first == word);
    const std::uint64_t second = table.place(bytes, {first});
    CHECK_FALSE(overlap(first, second));
    CHECK(table.place(bytes, {first, second}) == second);
    break;
  }
}

TEST_CASE("room is free again when the last user and the last observer have left") {
  Table table;
  const auto a = table.enter("/a", large("a"));
  const auto at = description_offset(table.word(a));
  const auto observed = table.enter("/a", large("a"), 2, Role::Observer);
  REQUIRE(observed == a);
  table.leave(a);
  const auto b = table.enter("/b", large("b"));
  CHECK(description_offset(table.word(b)) != at);  // an observer still looks at it
  CHECK(table.seen("/a") == large("a").known.bytes);
  table.leave(a, 2, Role::Observer);
  CHECK(table.seen("/a") == "no topic");
  const auto c = table.enter("/c", large("c"));
  CHECK(description_offset(table.word(c)) == at);
}

TEST_CASE("a description goes into the first gap that is large enough") {
  Table table;
  const auto a = table.enter("/a", made(3, "a"));
  const auto b = table.enter("/b", large("b"));
  const auto c = table.enter("/c", made(3, "c"));
  const auto gap = description_offset(table.word(b));
  const auto small_gap = description_offset(table.word(a));
  table.leave(a);
  table.leave(b);
  const auto d = table.enter("/d", large("d"));
  CHECK(description_offset(table.word(d)) == small_gap);  // both gaps are one now
  table.leave(d);
  const auto e = table.enter("/e", made(3, "e"));
  CHECK(description_offset(table.word(e)) == small_gap);
  const auto f = table.enter("/f", large("f"));
  CHECK(description_offset(table.word(f)) == gap);
  CHECK_FALSE(overlap(table.word(f), table.word(c)));
}

TEST_CASE("a full table leaves topics without descriptions, and no process is refused") {
  Table table;
  std::vector<std::uint32_t> topics;
  std::vector<std::uint64_t> words;
  for (std::uint32_t i = 0; i < kTopics - 2; ++i) {
    topics.push_back(table.enter("/" + std::to_string(i), large(std::to_string(i) + "_")));
    if (table.word(topics.back()) != 0) words.push_back(table.word(topics.back()));
  }
  REQUIRE(words.size() > 100);
  REQUIRE(words.size() < topics.size());
  CHECK(table.word(topics.back()) == 0);
  for (std::size_t i = 1; i < words.size(); ++i) CHECK_FALSE(overlap(words[i - 1], words[i]));
  // The last one has no description; the type check has its hashes.
  const std::string last = "/" + std::to_string(kTopics - 3);
  const std::string names = std::to_string(kTopics - 3) + "_";
  CHECK(table.seen(last).empty());
  CHECK(table.refusal(last, large(names)) == 0);
  CHECK(table.refusal(last, made(300, "")) == 0);
  CHECK(table.refusal(last, large("other")) == EPROTOTYPE);
  CHECK(table.refusal(last, made(300, "", 5)) == EPROTOTYPE);
  CHECK(table.word(topics.back()) == 0);
  // When there is room, the next user brings the description.
  for (int i = 0; i < 3; ++i) table.leave(topics[static_cast<std::size_t>(i)]);
  CHECK(table.refusal(last, large(names)) == 0);
  CHECK(table.seen(last) == large(names).known.bytes);
}

TEST_CASE("a topic whose first process knows no names gets them, and a description with names") {
  Table table;
  const Made nameless = made(3, ""), named = made(3, "n");
  REQUIRE(nameless.known.names == 0);
  const auto a = table.enter("/a", nameless);
  const std::uint64_t before = table.word(a);
  CHECK(table.entry(a).type_names.load() == 0);
  CHECK(table.seen("/a") == nameless.known.bytes);
  REQUIRE(table.enter("/a", named, 2) == a);
  CHECK(table.word(a) != before);
  CHECK(table.entry(a).type_names.load() == named.known.names);
  CHECK(table.seen("/a") == named.known.bytes);
  CHECK(table.refusal("/a", nameless) == 0);
  CHECK(table.seen("/a") == named.known.bytes);
  CHECK(table.refusal("/a", made(3, "m")) == EPROTOTYPE);
  // The bytes of the nameless one are free.
  const auto b = table.enter("/b", made(3, ""));
  CHECK(description_offset(table.word(b)) == description_offset(before));
}

TEST_CASE("where the table is full, a topic that gets names keeps the description that it has") {
  Table table;
  const auto numbered = [](std::size_t number) { return large(std::to_string(1000 + number)); };
  const Made nameless = made(300, ""), named = numbered(0), other = numbered(1);
  const Made partly = made(300, std::string(8, 'x') + "1000", ~std::size_t{0}, 299);
  REQUIRE(partly.known.names == 0);
  const auto a = table.enter("/a", nameless);
  const std::uint64_t before = table.word(a);
  for (std::size_t i = 2; table.word(table.enter("/" + std::to_string(i), numbered(i))) != 0;) ++i;
  REQUIRE(table.enter("/a", named, 2) == a);
  CHECK(table.word(a) == before);
  CHECK(table.seen("/a") == nameless.known.bytes);
  CHECK(table.entry(a).type_names.load() == named.known.names);
  // A process that knows some of the names does not take the hash of all away.
  CHECK(table.refusal("/a", partly) == 0);
  CHECK(table.entry(a).type_names.load() == named.known.names);
  CHECK(table.refusal("/a", other) == EPROTOTYPE);
}

TEST_CASE("damaged bytes are damaged for tools, and typed ends go on") {
  Table table;
  const Made type = made(5, "a");
  const auto a = table.enter("/a", type);
  auto* const bytes =
      reinterpret_cast<unsigned char*>(table.pieces().data()) + description_offset(table.word(a));
  for (std::size_t i = 0; i < type.known.bytes.size(); ++i) {
    CAPTURE(i);
    bytes[i] ^= 0x10;
    CHECK(table.seen("/a") == "damaged");
    CHECK(table.refusal("/a", type) == 0);
    CHECK(table.refusal("/a", made(5, "b")) == EPROTOTYPE);
    CHECK(table.refusal("/a", made(5, "a", 2)) == EPROTOTYPE);
    bytes[i] ^= 0x10;
  }
  CHECK(table.seen("/a") == type.known.bytes);
  // What is no description, but has its own check.
  table.set_word(a, table.place("no description", {}));
  CHECK(table.seen("/a") == "damaged");
  CHECK(table.refusal("/a", type) == 0);
}

TEST_CASE("damaged words are no harm: they lead to nothing, and no description lies on another") {
  Table table;
  const std::uint64_t from = seed();
  CAPTURE(from);
  std::mt19937_64 random(from);
  const Made type = made(5, "a"), other = made(5, "b");
  const auto a = table.enter("/a", type), b = table.enter("/b", other);
  const std::uint64_t good = table.word(a);
  std::vector<std::uint64_t> words{
      1,
      ~std::uint64_t{0},
      good + 1,
      good & 0xffffffff,
      (good & ~(std::uint64_t{0xffff} << 48)) | std::uint64_t{16383} << 48,
      good | std::uint64_t{0xffff} << 48,
      good | std::uint64_t{0xffff} << 32,
      table.word(b) + (std::uint64_t{1} << 32)};
  for (int i = 0; i < 1000; ++i) {
    // Half of them within the table, across others.
    words.push_back(i % 2 == 0
                        ? random()
                        : lot::segment::make_description(random() % 16, 1 + random() % 600,
                                                         static_cast<std::uint32_t>(random())));
  }
  std::uint32_t next = 0;
  for (const std::uint64_t word : words) {
    CAPTURE(word);
    table.set_word(a, word);
    CHECK(table.seen("/a") == "damaged");
    CHECK(table.refusal("/a", type) == 0);
    CHECK(table.refusal("/a", other) == EPROTOTYPE);
    const auto c = table.enter("/c", made(7, "c" + std::to_string(next++)));
    CHECK(table.word(c) != 0);
    CHECK_FALSE(overlap(table.word(c), table.word(b)));
    CHECK(table.seen("/b") == other.known.bytes);
    table.leave(c);
  }
}

TEST_CASE("a word that leads out of the table is damaged, also where its check is right") {
  Table table;
  const Made type = made(5, "a");
  const auto a = table.enter("/a", type);
  const auto pieces = table.pieces();
  std::memcpy(pieces.data() + pieces.size(), type.known.bytes.data(), type.known.bytes.size());
  table.set_word(a, lot::segment::make_description(
                        pieces.size_bytes() / lot::segment::kDescriptionPiece,
                        type.known.bytes.size(), lot::segment::description_check(table.word(a))));
  CHECK(table.seen("/a") == "damaged");
}

TEST_CASE("a word that says too many bytes takes no room") {
  Table table;
  const auto a = table.enter("/a", made(5, "a"));
  table.set_word(a, lot::segment::make_description(0, lot::description::kMostBytes + 1, 1));
  const auto b = table.enter("/b", made(5, "b"));
  CHECK(description_offset(table.word(b)) == 0);
}

TEST_CASE("a description that is too large for the table's limit is left out") {
  Table table;
  const Made type = made(1000, std::string(20, 'x'));
  CHECK(type.known.bytes.empty());
  const auto a = table.enter("/a", type);
  CHECK(table.word(a) == 0);
  CHECK(table.seen("/a").empty());
  CHECK(table.refusal("/a", type) == 0);
  CHECK(table.refusal("/a", made(1000, std::string(20, 'y'))) == EPROTOTYPE);
}

// What docs/descriptions.md says that a kill leaves, step by step.

TEST_CASE("killed after the bytes: they are free") {
  Table table;
  const auto a = table.enter("/a", made(3, "a"));
  const std::vector<std::uint64_t> words{table.word(a)};
  const std::uint64_t lost = table.place(large("lost").known.bytes, words);
  const auto b = table.enter("/b", large("b"));
  CHECK(description_offset(table.word(b)) == description_offset(lost));
  CHECK(table.seen("/a") == made(3, "a").known.bytes);
  CHECK(table.seen("/b") == large("b").known.bytes);
}

TEST_CASE("killed before the names' hash: the names count, and the next process brings the hash") {
  Table table;
  const Made nameless = made(3, ""), killed = made(3, "k"), other = made(3, "n");
  const auto a = table.enter("/a", nameless);
  table.set_word(a, table.place(killed.known.bytes, {table.word(a)}));
  CHECK(table.seen("/a") == killed.known.bytes);
  CHECK(table.known("/a").names == killed.known.names);
  CHECK(table.known("/a").has_names);
  CHECK(table.refusal("/a", nameless) == 0);
  CHECK(table.refusal("/a", other) == EPROTOTYPE);
  CHECK(table.entry(a).type_names.load() == 0);
  CHECK(table.refusal("/a", killed) == 0);
  CHECK(table.seen("/a") == killed.known.bytes);
  CHECK(table.entry(a).type_names.load() == killed.known.names);
  CHECK(table.refusal("/a", other) == EPROTOTYPE);
}

TEST_CASE("killed before the user's bit: there is no topic, and its bytes are free") {
  Table table;
  const auto a = table.enter("/a", large("a"));
  const auto at = description_offset(table.word(a));
  lot::test::raw(table.entry(a).users[0]) = 0;
  CHECK(table.seen("/a") == "no topic");
  const auto b = table.enter("/b", large("b"));
  CHECK(description_offset(table.word(b)) == at);
  table.enter("/a", made(3, "other"));
  CHECK(table.seen("/a") == made(3, "other").known.bytes);
  CHECK(table.seen("/b") == large("b").known.bytes);
}

TEST_CASE("killed after the user's bit: the reaper takes it back, and the bytes are free") {
  Table table;
  const auto a = table.enter("/a", large("a"), 2);
  const auto at = description_offset(table.word(a));
  CHECK(table.seen("/a") == large("a").known.bytes);
  table.registry().forget(2);
  CHECK(table.seen("/a") == "no topic");
  const auto b = table.enter("/b", large("b"));
  CHECK(description_offset(table.word(b)) == at);
}

TEST_SUITE_END();
