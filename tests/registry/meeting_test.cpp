// SPDX-License-Identifier: Apache-2.0

// Who may meet on a topic (docs/descriptions.md). All types here have the same name, size and
// alignment: what they are made of tells them apart, or nothing does.

#include "meeting.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/error.hpp"

#include "support/processes.hpp"

using namespace lot::testing;
using meeting::End;
using meeting::Sample;
using meeting::sample;
using meeting::Target;

namespace {

enum class Id : std::uint32_t {};
struct Point {
  float x, y;
};
struct OtherTarget {
  float value;
};

struct alignas(64) Base {
  std::uint32_t id;
  float x, y;
};
struct alignas(64) Swapped {
  std::uint32_t id;
  float y, x;
};
struct alignas(64) Renamed {
  std::uint32_t id;
  float x, z;
};
struct alignas(64) Retyped {
  std::uint32_t id;
  float x;
  std::int32_t y;
};
struct alignas(64) OtherSign {
  std::int32_t id;
  float x, y;
};
struct alignas(64) Bytes {
  std::uint8_t id[4];
  float x, y;
};
struct alignas(64) Enumerated {
  Id id;
  float x, y;
};
struct alignas(64) Nested {
  std::uint32_t id;
  Point at;
};
struct alignas(64) TwoOf {
  std::uint32_t id;
  float at[2];
};
struct alignas(64) ThreeOf {
  std::uint32_t id;
  float at[3];
};
struct alignas(64) Bits {
  std::uint32_t low : 16;
  std::uint32_t high : 16;
  float x, y;
};
struct alignas(64) OtherBits {
  std::uint32_t low : 12;
  std::uint32_t high : 20;
  float x, y;
};
/// Of the bit-fields no program knows the names, of the rest each does.
struct Low {
  std::uint32_t low : 16;
  std::uint32_t high : 16;
};
struct OtherPoint {
  float x, z;
};
struct alignas(64) BesideBits {
  Low low;
  float x, y;
  Point at;
};
struct alignas(64) SwappedBesideBits {
  Low low;
  float y, x;
  Point at;
};
struct alignas(64) RenamedBesideBits {
  Low low;
  float x, y;
  OtherPoint at;
};
struct __attribute__((packed)) Tight {
  std::uint8_t kind;
  std::uint32_t value;
};
struct alignas(64) BesideTight {
  Tight tight;
  float x, y;
};
struct alignas(64) SwappedBesideTight {
  Tight tight;
  float y, x;
};
struct alignas(64) Gap {
  std::uint32_t id;
  alignas(8) float x;
  float y;
};
struct alignas(64) Flag {
  bool on;
};
struct alignas(64) Byte {
  std::uint8_t on;
};
struct alignas(64) Span {
  std::chrono::duration<std::int64_t, std::nano> t;
};
struct alignas(64) Ticks {
  std::int64_t t;
};
struct alignas(64) OtherPeriod {
  std::chrono::duration<std::int64_t, std::micro> t;
};
struct alignas(64) Moment {
  std::chrono::time_point<std::chrono::system_clock, std::chrono::nanoseconds> t;
};
struct alignas(64) OtherClock {
  std::chrono::time_point<std::chrono::steady_clock, std::chrono::nanoseconds> t;
};
struct alignas(64) Text {
  lot::ShmString text;
};
struct alignas(64) Chars {
  lot::ShmVector<char> text;
};
struct alignas(64) OtherElement {
  lot::ShmVector<std::uint8_t> text;
};
struct alignas(64) Refers {
  lot::ShmRef<const Target> target;
};
struct alignas(64) RefersElsewhere {
  lot::ShmRef<const OtherTarget> target;
};
struct alignas(64) Opaque {
  std::uint32_t id;
};
struct alignas(64) OpaqueToo {
  std::uint32_t id;
};
struct alignas(64) OtherHash {
  std::uint32_t id;
};
/// Opaque, in messages.
struct Part {
  std::uint32_t id;
};
struct PartToo {
  std::uint32_t id;
};
struct Nobodys {
  std::uint32_t id;
};
struct alignas(64) HasPart {
  Part part;
};
struct alignas(64) HasPartToo {
  PartToo part;
};
struct alignas(64) HasNobodys {
  Nobodys part;
};

}  // namespace

template <>
struct lot::is_trusted_message<Opaque> : std::true_type {};
template <>
struct lot::is_trusted_message<OpaqueToo> : std::true_type {};
template <>
struct lot::is_trusted_message<OtherHash> : std::true_type {};
template <>
struct lot::is_trusted_message<Part> : std::true_type {};
template <>
struct lot::is_trusted_message<PartToo> : std::true_type {};
template <>
struct lot::is_trusted_message<Nobodys> : std::true_type {};
template <>
struct lot::TypeIdentity<Part> {
  static const char* name() { return "part"; }
};
template <>
struct lot::TypeIdentity<PartToo> {
  static const char* name() { return "part"; }
};
LOT_SAMPLE(Base, 0);
LOT_SAMPLE(Swapped, 0);
LOT_SAMPLE(Renamed, 0);
LOT_SAMPLE(Retyped, 0);
LOT_SAMPLE(OtherSign, 0);
LOT_SAMPLE(Bytes, 0);
LOT_SAMPLE(Enumerated, 0);
LOT_SAMPLE(Nested, 0);
LOT_SAMPLE(TwoOf, 0);
LOT_SAMPLE(ThreeOf, 0);
LOT_SAMPLE(Bits, 0);
LOT_SAMPLE(OtherBits, 0);
LOT_SAMPLE(BesideBits, 0);
LOT_SAMPLE(SwappedBesideBits, 0);
LOT_SAMPLE(RenamedBesideBits, 0);
LOT_SAMPLE(BesideTight, 0);
LOT_SAMPLE(SwappedBesideTight, 0);
LOT_SAMPLE(Gap, 0);
LOT_SAMPLE(Flag, 0);
LOT_SAMPLE(Byte, 0);
LOT_SAMPLE(Span, 0);
LOT_SAMPLE(Ticks, 0);
LOT_SAMPLE(OtherPeriod, 0);
LOT_SAMPLE(Moment, 0);
LOT_SAMPLE(OtherClock, 0);
LOT_SAMPLE(Text, 0);
LOT_SAMPLE(Chars, 0);
LOT_SAMPLE(OtherElement, 0);
LOT_SAMPLE(Refers, 0);
LOT_SAMPLE(RefersElsewhere, 0);
LOT_SAMPLE(Opaque, 1);
LOT_SAMPLE(OpaqueToo, 1);
LOT_SAMPLE(OtherHash, 2);
LOT_SAMPLE(HasPart, 0);
LOT_SAMPLE(HasPartToo, 0);
LOT_SAMPLE(HasNobodys, 0);

namespace {

/// '+': they meet; '.': they are refused. A row has those above it, and itself.
struct Row {
  Sample sample;
  const char* meets;
};
const std::vector<Row>& table() {
  static const std::vector<Row> rows{
      {sample<Base>("base"), "+"},
      {meeting::nameless_in_17(), "++"},
      {meeting::named_in_17(), "+++"},
      {sample<Swapped>("swapped"), ".+.+"},
      {sample<Renamed>("renamed"), ".+..+"},
      {sample<Retyped>("retyped"), ".....+"},
      {sample<OtherSign>("other sign"), "......+"},
      {sample<Bytes>("bytes"), ".......+"},
      {sample<Enumerated>("enumerated"), "........+"},
      {sample<Nested>("nested"), ".........+"},
      {sample<TwoOf>("two of"), "..........+"},
      {sample<ThreeOf>("three of"), "...........+"},
      {sample<Bits>("bits"), "............+"},
      {sample<OtherBits>("other bits"), ".............+"},
      {sample<Gap>("gap"), "..............+"},
      {sample<Flag>("flag"), "...............+"},
      {sample<Byte>("byte"), "................+"},
      {sample<Span>("span"), ".................+"},
      {sample<Ticks>("ticks"), "..................+"},
      {sample<OtherPeriod>("other period"), "...................+"},
      {sample<Moment>("moment"), "....................+"},
      {sample<OtherClock>("other clock"), ".....................+"},
      {sample<Text>("text"), "......................+"},
      {sample<Chars>("chars"), ".......................+"},
      {sample<OtherElement>("other element"), "........................+"},
      {sample<Refers>("refers"), ".........................+"},
      {sample<RefersElsewhere>("refers elsewhere"), "..........................+"},
      {sample<Opaque>("opaque"), "...........................+"},
      {meeting::opaque_in_17(), "...........................++"},
      {sample<OpaqueToo>("opaque, too"), "...........................+++"},
      {sample<OtherHash>("other hash"), "..............................+"},
      {sample<HasPart>("has an opaque part"), "...............................+"},
      {sample<HasPartToo>("has an opaque part, too"), "...............................++"},
      {sample<HasNobodys>("has another opaque part"), ".................................+"},
      {sample<BesideBits>("beside bits"), "..................................+"},
      {sample<SwappedBesideBits>("swapped beside bits"), "...................................+"},
      {sample<RenamedBesideBits>("renamed beside bits"), "....................................+"},
      {meeting::beside_bits_in_17(), "..................................++++"},
      {meeting::partly_beside_bits_in_17(), "..................................+.+++"},
      {sample<BesideTight>("beside tight"), ".......................................+"},
      {sample<SwappedBesideTight>("swapped beside tight"),
       "........................................+"},
      {meeting::beside_tight_in_17(), ".......................................+.+"}};
  return rows;
}
bool may_meet(std::size_t a, std::size_t b) {
  return table().at(std::max(a, b)).meets[std::min(a, b)] == '+';
}

/// What the second end of a topic is told; empty: it was let in.
std::string refusal(const Sample& first, const Sample& second, lot::ShmEngine& engine,
                    bool publisher_first = true) {
  const auto one = (publisher_first ? first.advertise : first.subscribe)(engine, "/meeting");
  try {
    const auto other = (publisher_first ? second.subscribe : second.advertise)(engine, "/meeting");
    End* const publisher = publisher_first ? one.get() : other.get();
    End* const subscriber = publisher_first ? other.get() : one.get();
    const std::string said = publisher->go();
    CHECK(subscriber->go() == said);
  } catch (const lot::Error& e) {
    CHECK(e.error_number() == EPROTOTYPE);
    CHECK(std::string(e.what()).find("this side wants sample (64 bytes") != std::string::npos);
    return e.what();
  }
  return {};
}

}  // namespace

TEST_SUITE_BEGIN("registry");

TEST_CASE("a table says who may meet, and two descriptions say the same") {
  for (std::size_t i = 0; i < table().size(); ++i) {
    REQUIRE(std::string(table()[i].meets).size() == i + 1);
    for (std::size_t k = 0; k < table().size(); ++k) {
      CAPTURE(table()[i].sample.what);
      CAPTURE(table()[k].sample.what);
      CHECK(lot::detail::is_same(table()[i].sample.type, table()[k].sample.type) == may_meet(i, k));
    }
  }
}

TEST_CASE("types that may meet on a topic exchange messages there, others are refused") {
  const Watchdog watchdog(100);
  lot::ShmEngine engine(fresh());
  for (std::size_t i = 0; i < table().size(); ++i) {
    for (std::size_t k = 0; k < table().size(); ++k) {
      CAPTURE(table()[i].sample.what);
      CAPTURE(table()[k].sample.what);
      const std::string publisher_first =
          refusal(table()[i].sample, table()[k].sample, engine, true);
      CHECK(publisher_first.empty() == may_meet(i, k));
      // What either has been told depends on which comes second, not on which end it is.
      CHECK(refusal(table()[i].sample, table()[k].sample, engine, false) == publisher_first);
    }
  }
}

TEST_CASE("a refused process is told which field differs first, and what each side has") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  const Sample base = sample<Base>("base");
  const struct {
    Sample first, second;
    const char* text;
  } told[] = {
      {base, sample<Swapped>(""),
       "field 2: the topic has x, float32 at byte 4; this side has y, float32 at byte 4"},
      {base, sample<Renamed>(""),
       "field 3: the topic has y, float32 at byte 8; this side has z, float32 at byte 8"},
      {base, sample<Retyped>(""), "y: the topic has float32; this side has int32"},
      {base, sample<OtherSign>(""), "id: the topic has uint32; this side has int32"},
      {base, sample<Bytes>(""), "id: the topic has uint32; this side has array of 4 uint8"},
      {sample<Enumerated>(""), base,
       "id: the topic has enum (anonymous namespace)::Id of uint32; this side has uint32"},
      {base, sample<Gap>(""),
       "field 2: the topic has x, float32 at byte 4; this side has x, float32 at byte 8"},
      {base, sample<Nested>(""),
       "field 2: the topic has x, float32 at byte 4; this side has at, struct (anonymous "
       "namespace)::Point at byte 4"},
      {sample<TwoOf>(""), sample<ThreeOf>(""),
       "at: the topic has array of 2 float32; this side has array of 3 float32"},
      {sample<Bits>(""), sample<OtherBits>(""),
       "field 1: the topic has uint32 of 16 bits at byte 0, bit 0; this side has uint32 of 12 bits "
       "at byte 0, bit 0"},
      {sample<BesideBits>(""), sample<SwappedBesideBits>(""),
       "field 2: the topic has x, float32 at byte 4; this side has y, float32 at byte 4"},
      {sample<BesideTight>(""), sample<SwappedBesideTight>(""),
       "field 2: the topic has x, float32 at byte 8; this side has y, float32 at byte 8"},
      {sample<Flag>(""), sample<Byte>(""), "on: the topic has bool; this side has uint8"},
      {sample<Span>(""), sample<Ticks>(""),
       "t: the topic has duration of int64 in 1/1000000000 s; this side has int64"},
      {sample<Span>(""), sample<OtherPeriod>(""),
       "t: the topic has duration of int64 in 1/1000000000 s; this side has duration of int64 in "
       "1/1000000 s"},
      {sample<Moment>(""), sample<OtherClock>(""),
       "t: the topic has time of system_clock, duration of int64 in 1/1000000000 s; this side has "
       "time of steady_clock"},
      {sample<Text>(""), sample<Chars>(""), "text: the topic has string of lib"},
      {sample<Chars>(""), sample<OtherElement>(""),
       "text[]: the topic has char; this side has uint8"},
      {sample<Refers>(""), sample<RefersElsewhere>(""),
       "target.value: the topic has uint32; this side has float32"},
      {sample<Opaque>(""), sample<OtherHash>(""),
       "their TypeIdentity::hash() differs, or the standard library that they are built with"},
      {sample<HasPart>(""), sample<HasNobodys>(""),
       "part: the topic has part, 4 bytes; this side has (anonymous namespace)::Nobodys, 4 bytes"},
  };
  for (const auto& pair : told) {
    const std::string text = refusal(pair.first, pair.second, engine);
    CAPTURE(text);
    CHECK(text.find(std::string("; ") + pair.text) != std::string::npos);
  }
}

TEST_CASE("the first process that knows names gives them, processes with others are refused") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  const Sample nameless = meeting::nameless_in_17();
  const auto first = nameless.advertise(engine, "/meeting");
  {
    // So far the topic has no names.
    lot::ShmEngine other(fresh());
    const auto same = nameless.advertise(other, "/meeting");
    const auto renamed = sample<Renamed>("").subscribe(other, "/meeting");
    CHECK_THROWS_AS(sample<Base>("").subscribe(other, "/meeting"), lot::Error);
  }
  auto named = sample<Base>("").subscribe(engine, "/meeting");
  CHECK_THROWS_AS(sample<Renamed>("").subscribe(engine, "/meeting"), lot::Error);
  CHECK_THROWS_AS(sample<Swapped>("").advertise(engine, "/meeting"), lot::Error);
  const auto more = nameless.subscribe(engine, "/meeting");
  const auto also_named = meeting::named_in_17().subscribe(engine, "/meeting");
  const std::string said = first->go();
  for (End* subscriber : {named.get(), more.get(), also_named.get()}) {
    CHECK(subscriber->go() == said);
  }
  named.reset();  // the topic keeps the names, as long as it has users
  CHECK_THROWS_AS(sample<Renamed>("").subscribe(engine, "/meeting"), lot::Error);
}

TEST_CASE("a process that knows more names gives them, also where no process knows all") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  const auto first = meeting::beside_bits_in_17().advertise(engine, "/meeting");
  {
    // So far the topic has no names.
    lot::ShmEngine other(fresh());
    const auto same = meeting::beside_bits_in_17().advertise(other, "/meeting");
    const auto swapped = sample<SwappedBesideBits>("").subscribe(other, "/meeting");
    CHECK_THROWS_AS(sample<BesideBits>("").subscribe(other, "/meeting"), lot::Error);
    CHECK_THROWS_AS(meeting::partly_beside_bits_in_17().subscribe(other, "/meeting"), lot::Error);
  }
  auto partly = meeting::partly_beside_bits_in_17().subscribe(engine, "/meeting");
  CHECK_THROWS_AS(sample<SwappedBesideBits>("").subscribe(engine, "/meeting"), lot::Error);
  const auto named = sample<BesideBits>("").subscribe(engine, "/meeting");
  CHECK_THROWS_AS(sample<RenamedBesideBits>("").subscribe(engine, "/meeting"), lot::Error);
  const auto nameless = meeting::beside_bits_in_17().subscribe(engine, "/meeting");
  const std::string said = first->go();
  for (End* subscriber : {partly.get(), named.get(), nameless.get()}) {
    CHECK(subscriber->go() == said);
  }
  partly.reset();
  CHECK_THROWS_AS(sample<RenamedBesideBits>("").subscribe(engine, "/meeting"), lot::Error);
}

TEST_CASE("a topic has the names of all its processes, of which each knows others") {
  const Watchdog watchdog(60);
  for (const bool inner_first : {false, true}) {
    CAPTURE(inner_first);
    lot::ShmEngine engine(fresh());
    const Sample outer = meeting::partly_beside_bits_in_17();
    const Sample inner = meeting::inner_beside_bits_in_17();
    const auto first = (inner_first ? inner : outer).advertise(engine, "/meeting");
    const auto second = (inner_first ? outer : inner).subscribe(engine, "/meeting");
    CHECK_THROWS_AS(sample<RenamedBesideBits>("").subscribe(engine, "/meeting"), lot::Error);
    CHECK_THROWS_AS(sample<SwappedBesideBits>("").subscribe(engine, "/meeting"), lot::Error);
    const auto both = sample<BesideBits>("").subscribe(engine, "/meeting");
    const std::string said = first->go();
    CHECK(second->go() == said);
    CHECK(both->go() == said);
  }
}

TEST_SUITE_END();
