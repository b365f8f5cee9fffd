// SPDX-License-Identifier: Apache-2.0

// The words that a Builder writes, one by one, by descriptions that no compiler makes.

#include <array>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <limits>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/mutable_value.hpp"

#include "by_hand.hpp"
#include "support/error_of.hpp"

namespace {

using namespace by_hand;
using lot::testing::error_of;
using lot::testing::names;

constexpr std::uint64_t kFill = 0xa5a5a5a5a5a5a5a5;
constexpr const char* kText = "does not lie in the segment";

/// A message at word 16 of some words, whose containers take memory from word 64 on.
struct Words {
  explicit Words(Description of) : all(std::move(of)) { words.fill(kFill); }

  lot::MutableValue root() {
    return {all, &words[16], words.data(), words.data() + words.size(),
            lot::detail::MessageMemory{this, take, give_back}};
  }
  static constexpr std::size_t kMost = 3000;
  static void* take(void* self, std::size_t bytes, std::size_t align) {
    auto& mine = *static_cast<Words*>(self);
    mine.taken.emplace_back(bytes, align);
    if (bytes > kMost) throw std::bad_alloc();
    void* const at = &mine.words.at(mine.next);
    mine.next += (bytes + 7) / 8;
    return at;
  }
  static void give_back(void* self, void* piece, std::size_t bytes) noexcept {
    auto& mine = *static_cast<Words*>(self);
    mine.given.emplace_back(static_cast<std::uint64_t*>(piece) - mine.words.data(), bytes);
  }
  /// Where the pointer at that word leads, in bytes from the begin of the words.
  std::int64_t leads(std::size_t word) const {
    return static_cast<std::int64_t>(word * 8 + words[word]);
  }
  bool leads_to_arena(std::size_t word) const {
    return reinterpret_cast<std::uintptr_t>(&words[word]) + words[word] ==
           reinterpret_cast<std::uintptr_t>(this);
  }

  Description all;
  std::array<std::uint64_t, 512> words;
  std::size_t next = 64;
  std::vector<std::pair<std::size_t, std::size_t>> taken;
  std::vector<std::pair<std::ptrdiff_t, std::size_t>> given;
};

Description of(std::vector<Type> types) {
  Description all;
  all.types = std::move(types);
  return all;
}
Description string_of(const char* library, std::uint64_t size) {
  return of({type(Kind::String, size, library)});
}
Description vector_of(const char* library) {
  return of({type(Kind::Vector, 32, library, 1), type(Kind::UInt, 8)});
}

TEST_CASE("each container is made of exactly these words, and no byte beside it changes") {
  Words std_string(string_of("libstdc++", 40));
  std_string.root().construct();
  CHECK(std_string.leads_to_arena(16));
  CHECK(std_string.leads(17) == 19 * 8);
  for (const std::size_t zero : {18U, 19U, 20U}) CHECK(std_string.words[zero] == 0);
  CHECK(std_string.words[15] == kFill);
  CHECK(std_string.words[21] == kFill);
  Words boost_string(string_of("libc++", 32));
  boost_string.root().construct();
  CHECK(boost_string.leads_to_arena(16));
  CHECK(boost_string.words[17] == 1);
  CHECK(boost_string.words[18] == 0);
  CHECK(boost_string.words[20] == kFill);
  Words reference(of({type(Kind::Reference, 32, "", 1), type(Kind::UInt, 8)}));
  reference.root().construct();
  CHECK(reference.leads_to_arena(16));
  CHECK(reference.words[17] == 1);
  CHECK(reference.words[15] == kFill);
}

TEST_CASE("containers of another size or library, or that share bytes, are not made") {
  for (const auto& [library, size] : {std::pair("libstdc++", 32), std::pair("libstdc++", 48),
                                      std::pair("libc++", 40), std::pair("other", 40)}) {
    Words words(string_of(library, static_cast<std::uint64_t>(size)));
    const auto [error, text] = error_of([&] { words.root().construct(); });
    CHECK(error == EINVAL);
    CHECK(names(text, (std::string("it is a string of another library: ") + library).c_str()));
  }
  for (const Kind kind : {Kind::Vector, Kind::Reference}) {
    Words words(of({type(kind, 40, "libstdc++", 1), type(Kind::UInt, 8)}));
    const auto [error, text] = error_of([&] { words.root().construct(); });
    CHECK(error == EBADMSG);
    CHECK(names(text, "its description is of another size"));
  }
  const auto makes = [](std::uint64_t a, std::uint64_t b, std::uint64_t size) {
    Words words(of({structure("S", size, {field("a", 1, a), field("b", 1, b)}),
                    type(Kind::String, 40, "libstdc++")}));
    const auto [error, text] = error_of([&] { words.root().construct(); });
    if (error != 0) CHECK(names(text, "its description has fields that share bytes"));
    return error;
  };
  CHECK(makes(0, 40, 80) == 0);
  CHECK(makes(40, 0, 80) == 0);
  CHECK(makes(0, 32, 80) == EBADMSG);
  CHECK(makes(32, 0, 80) == EBADMSG);
  CHECK(makes(0, 48, 80) == EBADMSG);
  CHECK(makes(0, 40, 32) == EBADMSG);
}

TEST_CASE("a long text whose memory does not lie in the segment is damaged, to the byte") {
  Words words(string_of("libstdc++", 40));
  const lot::MutableValue root = words.root();
  root.construct();
  root.set(std::string(16, 'x'));
  CHECK(words.taken == decltype(words.taken){{17, 1}});
  CHECK(words.leads(17) == 64 * 8);
  CHECK(words.words[19] == 16);
  const std::uint64_t most = (512 - 64) * 8;
  for (const std::uint64_t bad : {most, most + 1, ~std::uint64_t{0}}) {
    words.words[19] = bad;
    const auto [error, text] = error_of([&] { root.set("y"); });
    CHECK(error == EBADMSG);
    CHECK(names(text, kText));
  }
  words.words[19] = most - 1;
  root.set("y");
  CHECK(words.words[18] == 1);
  words.words[19] = 16;
  root.set(std::string(17, 'z'));
  CHECK(words.given == decltype(words.given){{64, 17}});
  Words boost(string_of("libc++", 32));
  boost.root().construct();
  boost.root().set(std::string(23, 'x'));
  CHECK(boost.words[18] == 24);
  for (const std::uint64_t bad : {std::uint64_t{0}, most + 1}) {
    boost.words[18] = bad;
    CHECK(error_of([&] { boost.root().set("y"); }).first == EBADMSG);
  }
  boost.words[18] = 24;
  boost.root().set(std::string(24, 'z'));
  CHECK(boost.given == decltype(boost.given){{64, 24}});
}

TEST_CASE("a vector grows when it has no room, and never beyond what memory can be") {
  for (const char* const library : {"libstdc++", "libc++"}) {
    Words words(vector_of(library));
    const lot::MutableValue root = words.root();
    root.construct();
    root.resize(0);
    CHECK(words.taken.empty());
    root.resize(3);
    CHECK(words.taken == decltype(words.taken){{24, 8}});
    root.resize(2);
    root.resize(3);
    CHECK(words.taken.size() == 1);
    root.resize(4);
    CHECK(words.taken.size() == 2);
    CHECK(words.given == decltype(words.given){{64, 24}});
    for (const std::uint64_t many : {std::uint64_t{1} << 60, std::uint64_t{1} << 61}) {
      const auto [error, text] = error_of([&] { root.resize(many); });
      CHECK(error == ERANGE);
      CHECK(names(text, ("it cannot have " + std::to_string(many) + " elements").c_str()));
    }
    CHECK(root.size() == 4);
  }
}

using Pieces = decltype(Words::given);

/// A string of each library, a vector of numbers and a reference: 17 words.
Description of_elements() {
  return of(
      {type(Kind::Vector, 32, "libstdc++", 1),
       structure("S", 136,
                 {field("a", 2, 0), field("b", 3, 40), field("v", 4, 72), field("r", 5, 104)}),
       type(Kind::String, 40, "libstdc++"), type(Kind::String, 32, "libc++"),
       type(Kind::Vector, 32, "libc++", 6), type(Kind::Reference, 32, "", 6), type(Kind::UInt, 8)});
}

TEST_CASE("what an element has goes back with it, each piece with its bytes, in order") {
  Words words(of_elements());
  const lot::MutableValue root = words.root();
  root.construct();
  root.resize(3);  // 51 words from 64 on
  root[0]["a"].set(std::string(20, 'a'));
  root[0]["b"].set(std::string(30, 'b'));
  root[0]["v"].resize(2);
  root[1]["a"].set(std::string(15, 'a'));
  root[1]["b"].set(std::string(22, 'b'));
  root[2]["v"].resize(1);
  root[2]["b"].set(std::string(23, 'b'));
  CHECK(words.taken == decltype(words.taken){{408, 8}, {21, 1}, {31, 1}, {16, 8}, {8, 8}, {24, 1}});
  CHECK(words.given.empty());
  root.resize(2);
  CHECK(words.given == Pieces{{125, 24}, {124, 8}});
  words.given.clear();
  root.resize(0);
  CHECK(words.given == Pieces{{115, 21}, {118, 31}, {122, 16}});
  CHECK(words.leads(17) == 64 * 8);
  CHECK(words.leads(18) == 64 * 8);
  CHECK(words.leads(19) == (64 + 51) * 8);
  words.given.clear();
  root.resize(3);  // it has the room
  CHECK(words.taken.size() == 6);
  CHECK(words.given.empty());
  for (std::size_t i = 64; i < 115; i += 17) {
    CAPTURE(i);
    for (const std::size_t arena : {0U, 5U, 12U, 13U}) CHECK(words.leads_to_arena(i + arena));
    CHECK(words.leads(i + 1) == static_cast<std::int64_t>(i + 3) * 8);
    for (const std::size_t zero : {2U, 3U, 4U, 7U, 8U, 15U, 16U}) {
      CHECK(words.words[i + zero] == 0);
    }
    for (const std::size_t one : {6U, 9U, 10U, 11U, 14U}) CHECK(words.words[i + one] == 1);
  }
}

TEST_CASE("elements that move take their texts, elements and targets with them") {
  Words words(of_elements());
  const lot::MutableValue root = words.root();
  root.construct();
  root.resize(2);  // words 64 to 97
  root[0]["a"].set(std::string(20, 'a'));
  root[0]["b"].set(std::string(30, 'b'));
  root[0]["v"].resize(3);
  root[0]["v"].resize(2);
  words.words[64 + 14] = (200 - 64 - 14) * 8;  // the reference leads to word 200
  root[1]["a"].set("123456789012345");
  root[1]["b"].set("abcdefghijklmnopqrstuv");
  CHECK(words.next == 108);
  words.words[108 + 3 * 17] = kFill;
  root.resize(3);
  CHECK(words.given == Pieces{{64, 272}});
  CHECK(words.next == 108 + 51);
  CHECK(words.words[108 + 51] == kFill);
  for (std::size_t i = 108; i < 159; i += 17) {
    CAPTURE(i);
    for (const std::size_t arena : {0U, 5U, 12U, 13U}) CHECK(words.leads_to_arena(i + arena));
  }
  CHECK(words.leads(109) == 98 * 8);
  CHECK(words.words[110] == 20);
  CHECK(words.words[111] == 20);
  CHECK(words.words[114] == 60);
  CHECK(words.words[115] == 31);
  CHECK(words.leads(116) == 101 * 8);
  CHECK(words.leads(117) == 105 * 8);
  CHECK(words.leads(118) == 107 * 8);
  CHECK(words.leads(119) == 108 * 8);
  CHECK(words.leads(122) == 200 * 8);
  CHECK(words.leads(126) == 128 * 8);  // a short text lies in its string
  const lot::Value first = root[0];
  CHECK(first["a"].as<std::string>() == std::string(20, 'a'));
  CHECK(first["b"].as<std::string>() == std::string(30, 'b'));
  CHECK(first["v"].size() == 2);
  const lot::Value second = root[1];
  CHECK(second["a"].as<std::string>() == "123456789012345");
  CHECK(second["b"].as<std::string>() == "abcdefghijklmnopqrstuv");
  CHECK(second["v"].size() == 0);
  CHECK(second["r"].is_null());
  CHECK(words.words[125 + 14] == 1);
}

TEST_CASE("vectors in vectors go back with all that they hold, or not at all") {
  const auto all = [](Type last) {
    return of({type(Kind::Vector, 32, "libstdc++", 1), type(Kind::Vector, 32, "libstdc++", 2),
               std::move(last), type(Kind::UInt, 8)});
  };
  Words texts(all(type(Kind::String, 40, "libstdc++")));
  texts.root().construct();
  texts.root().resize(2);     // words 64 to 71
  texts.root()[1].resize(3);  // 72 to 86
  texts.root()[1][0].set(std::string(16, 'x'));
  texts.root()[1][2].set(std::string(17, 'y'));
  texts.root().resize(1);
  CHECK(texts.given == Pieces{{87, 17}, {90, 18}, {72, 120}});
  texts.given.clear();
  texts.root()[0].resize(2);
  texts.root()[0].resize(0);
  CHECK(texts.given.empty());
  texts.root().resize(0);
  CHECK(texts.given == Pieces{{93, 80}});

  Words references(all(type(Kind::Reference, 32, "", 3)));
  const lot::MutableValue root = references.root();
  root.construct();
  root.resize(2);
  root[0].resize(1);                          // word 72
  root[1].resize(2);                          // word 76
  references.words[76 + 1] = (300 - 77) * 8;  // its first one leads to word 300
  for (const std::size_t size : {0U, 1U}) {
    const auto [error, text] = error_of([&] { root.resize(size); });
    CHECK(error == EINVAL);
    CHECK(text == "lot: [1][0]: a reference cannot be let go here (Invalid argument)");
    CHECK(root.size() == 2);
    CHECK(references.given.empty());
  }
  references.words[76 + 1] = 1;
  references.words[80 + 1] = (300 - 81) * 8;  // the second one
  CHECK(error_of([&] { root.resize(0); }).second ==
        "lot: [1][1]: a reference cannot be let go here (Invalid argument)");
  references.words[80 + 1] = 1;
  references.words[64 + 3] = (71 - 67) * 8;  // the memory of the first ends too early
  CHECK(error_of([&] { root.resize(0); }).first == EBADMSG);
  CHECK(references.given.empty());
  references.words[64 + 3] = (76 - 67) * 8;
  root.resize(0);
  CHECK(references.given == Pieces{{72, 32}, {76, 64}});
}

TEST_CASE("a vector whose memory ends before its elements, or has no begin, is damaged") {
  Words words(vector_of("libstdc++"));
  const lot::MutableValue root = words.root();
  root.construct();
  const auto set = [&](std::size_t begin, std::size_t end, std::size_t memory) {
    const std::size_t to[] = {begin, end, memory};
    for (std::size_t i = 0; i < 3; ++i) {
      words.words[17 + i] = to[i] == 0 ? 1 : (to[i] - 17 - i) * 8;
    }
  };
  const struct {
    std::size_t begin, end, memory;
    bool is_good;
  } cases[] = {{0, 0, 0, true},       {0, 0, 100, false},    {100, 100, 0, false},
               {100, 100, 100, true}, {100, 100, 99, false}, {100, 102, 101, false},
               {100, 102, 102, true}, {100, 102, 103, true}};
  for (const auto& [begin, end, memory, is_good] : cases) {
    CAPTURE(begin);
    CAPTURE(end);
    CAPTURE(memory);
    for (const std::size_t size : {0U, 1U, 3U}) {
      set(begin, end, memory);
      words.next = 200;
      const auto [error, text] = error_of([&] { root.resize(size); });
      CHECK(error == (is_good ? 0 : EBADMSG));
      if (!is_good) CHECK(names(text, "lot: message: its memory ends before it begins"));
      if (is_good) CHECK(root.size() == size);
    }
  }
}

TEST_CASE("new elements are zeros, and no byte behind them changes") {
  Words words(vector_of("libc++"));
  const lot::MutableValue root = words.root();
  root.construct();
  root.resize(4);
  for (std::size_t i = 64; i < 68; ++i) CHECK(words.words[i] == 0);
  CHECK(words.words[68] == kFill);
  root.resize(1);
  for (std::size_t i = 64; i < 68; ++i) words.words[i] = i;
  root.resize(1);
  root.resize(3);
  CHECK(words.words[64] == 64);
  CHECK(words.words[65] == 0);
  CHECK(words.words[66] == 0);
  CHECK(words.words[67] == 67);
  CHECK(words.words[68] == kFill);
  CHECK(words.taken.size() == 1);
}

TEST_CASE("memory for elements is aligned as their size says, to a page at most") {
  const std::pair<std::uint64_t, std::uint64_t> sizes[] = {
      {1, 1}, {12, 4}, {48, 16}, {4095, 1}, {4096, 4096}, {8192, 4096}, {12288, 4096}};
  for (const auto& [size, align] : sizes) {
    CAPTURE(size);
    Words words(of({type(Kind::Vector, 32, "libstdc++", 1), structure("S", size, {})}));
    words.root().construct();
    try {
      words.root().resize(1);
    } catch (const std::bad_alloc&) {
      CHECK(size > Words::kMost);
      CHECK(words.words[17] == 1);
    }
    CHECK(words.taken == decltype(words.taken){{size, align}});
  }
  // As many bytes as there can be.
  Words words(of({type(Kind::Vector, 32, "libstdc++", 1), type(Kind::UInt, 1)}));
  words.root().construct();
  constexpr std::uint64_t kMost = ~std::uint64_t{0} / 2;
  CHECK_THROWS_AS(words.root().resize(kMost), std::bad_alloc);
  CHECK(words.taken == decltype(words.taken){{kMost, 1}});
  CHECK(error_of([&] { words.root().resize(kMost + 1); }).second ==
        "lot: message: it cannot have 9223372036854775808 elements (Numerical result out of "
        "range)");
  CHECK(words.taken.size() == 1);
}

TEST_CASE("what no program can make without its type is neither made nor added, but stays") {
  const std::string why =
      " cannot be made here: only its own programs know how it, or a part of it, begins (Invalid "
      "argument)";
  Words deep(of({type(Kind::Array, 8, "", 1, 1), type(Kind::Array, 8, "", 2, 1),
                 type(Kind::Array, 8, "", 3, 1), type(Kind::Array, 8, "", 4, 1),
                 type(Kind::Array, 8, "", 5, 1), type(Kind::Array, 8, "", 6, 1),
                 type(Kind::Array, 8, "", 7, 1), type(Kind::Opaque, 8, "Secret")}));
  CHECK(error_of([&] { deep.root().construct(); }).second ==
        "lot: message: a Secret[1][1][1][1][1][1][1]" + why);
  CHECK(deep.words[16] == kFill);
  // Opaque fields may share bytes: no word of theirs is written.
  const Type opaque = type(Kind::Opaque, 8, "Secret");
  Words shared(of({structure("S", 8, {field("a", 1, 0), field("b", 1, 0)}),
                   structure("P", 8, {field("c", 2, 0)}), opaque}));
  CHECK(error_of([&] { shared.root().construct(); }).second == "lot: message: a S" + why);
  Words direct(of({structure("S", 8, {field("a", 1, 0), field("b", 1, 0)}), opaque}));
  CHECK(error_of([&] { direct.root().construct(); }).second == "lot: message: a S" + why);

  Words list(of({type(Kind::Vector, 32, "libstdc++", 1), opaque}));
  const lot::MutableValue root = list.root();
  root.construct();
  list.words[17] = (100 - 17) * 8;
  list.words[18] = (102 - 18) * 8;
  list.words[19] = (103 - 19) * 8;
  root.resize(2);
  CHECK(error_of([&] { root.resize(3); }).second == "lot: message: a Secret" + why);
  CHECK(error_of([&] { root.resize(4); }).second == "lot: message: a Secret" + why);
  CHECK(root.size() == 2);
  root.resize(1);
  CHECK(root.size() == 1);
  CHECK(list.words[100] == kFill);
  CHECK(list.taken.empty());
}

TEST_CASE("plain values are made of zeros, whatever bytes their fields share") {
  Words number(of({type(Kind::UInt, 8)}));
  number.root().construct();
  CHECK(number.words[16] == 0);
  CHECK(number.words[17] == kFill);
  Words array(of({type(Kind::Array, 16, "", 1, 2), type(Kind::UInt, 8)}));
  array.root().construct();
  CHECK(array.words[17] == 0);
  CHECK(array.words[18] == kFill);
  Words shared(of({structure("S", 8, {field("a", 1, 0), field("b", 1, 0)}),
                   structure("P", 8, {field("c", 2, 0)}), type(Kind::UInt, 8)}));
  shared.root().construct();
  CHECK(shared.words[16] == 0);
  CHECK(shared.words[17] == kFill);
  Words within(of({structure("S", 8, {field("s", 0, 0)})}));
  within.root().construct();
  CHECK(within.words[16] == 0);
  Words whole(of({structure("S", 40, {field("a", 1, 0)}), type(Kind::String, 40, "libstdc++")}));
  whole.root().construct();
  CHECK(whole.leads(17) == 19 * 8);
}

TEST_CASE("a vector of strings of another library stays as it was") {
  Words words(of({type(Kind::Vector, 32, "libstdc++", 1), type(Kind::String, 40, "other")}));
  words.root().construct();
  CHECK(error_of([&] { words.root().resize(1); }).second ==
        "lot: [0]: it is a string of another library: other (Invalid argument)");
  CHECK(words.root().size() == 0);
  for (const std::size_t word : {17U, 18U, 19U}) CHECK(words.words[word] == 1);
}

TEST_CASE("a text lies in its string as long as it fits, and then in as many bytes as it needs") {
  Words words(string_of("libstdc++", 40));
  const lot::MutableValue root = words.root();
  root.construct();
  for (const std::size_t size : {0U, 1U, 15U, 7U}) {
    root.set(std::string(size, 'x'));
    CHECK(words.taken.empty());
    CHECK(words.leads(17) == 19 * 8);
    CHECK(words.words[18] == size);
    CHECK(root.value().as<std::string>() == std::string(size, 'x'));
    CHECK(reinterpret_cast<const char*>(&words.words[19])[size] == '\0');
  }
  root.set(std::string(16, 'y'));
  CHECK(words.words[18] == 16);
  CHECK(words.words[19] == 16);
  CHECK(words.words[66] == (kFill & ~std::uint64_t{0xff}));  // a zero behind the text
  root.set(std::string(16, 'z'));
  root.set(std::string(3, 'w'));
  CHECK(words.words[18] == 3);
  CHECK(words.words[19] == 16);
  CHECK(reinterpret_cast<const char*>(&words.words[64])[3] == '\0');
  CHECK(words.taken == decltype(words.taken){{17, 1}});
  CHECK(words.given.empty());

  Words boost(string_of("libc++", 32));
  boost.root().construct();
  for (const std::size_t size : {0U, 1U, 21U, 22U, 7U}) {
    boost.root().set(std::string(size, 'x'));
    CHECK(boost.taken.empty());
    CHECK((boost.words[17] & 0xff) == (size << 1 | 1));
    CHECK(boost.root().value().as<std::string>() == std::string(size, 'x'));
    CHECK(reinterpret_cast<const char*>(&boost.words[17])[1 + size] == '\0');
  }
  boost.root().set(std::string(23, 'y'));
  CHECK(boost.words[17] == 46);
  CHECK(boost.words[18] == 24);
  CHECK(boost.leads(19) == 64 * 8);
  CHECK((boost.words[66] >> 56) == 0);
  boost.root().set(std::string(23, 'z'));
  boost.root().set(std::string(3, 'w'));
  CHECK(boost.words[17] == 6);
  CHECK(boost.words[18] == 24);
  CHECK(reinterpret_cast<const char*>(&boost.words[64])[3] == '\0');
  CHECK(boost.taken == decltype(boost.taken){{24, 1}});
  CHECK(boost.given.empty());
}

// ---- what a MutableValue looks at before it writes

TEST_CASE("bytes become elements only if each bool in them is 0 or 1") {
  // A bool before and behind others, in an array, in a struct; and one of a bit, which any byte is.
  Words words(of({type(Kind::Vector, 32, "libstdc++", 1),
                  structure("S", 8,
                            {field("a", 2, 0), field("b", 3, 1), field("c", 4, 2), field("d", 5, 4),
                             field("e", 2, 6, 1, 1), field("f", 3, 7)}),
                  type(Kind::Bool, 1), type(Kind::UInt, 1), type(Kind::Array, 2, "", 2, 2),
                  structure("T", 2, {field("g", 3, 0), field("h", 2, 1)})}));
  const lot::MutableValue root = words.root();
  root.construct();
  const auto assign = [&](const std::string& bytes, std::size_t size) {
    return error_of([&] {
             root.assign({reinterpret_cast<const std::byte*>(bytes.data()), size});
           })
        .second;
  };
  const std::string good("\1\377\1\1\377\1\377\377", 8);
  const std::string zeros("\0\377\0\0\377\0\377\377", 8);
  // What lies behind the bytes is not looked at.
  CHECK(assign(zeros + good + "\2", 16) == "no error");
  CHECK(root.size() == 2);
  CHECK(std::memcmp(&words.words[64], (zeros + good).data(), 16) == 0);
  CHECK(words.words[66] == kFill);
  for (const std::size_t element : {0U, 1U, 2U}) {
    for (std::size_t at = 0; at < 8; ++at) {
      CAPTURE(element);
      CAPTURE(at);
      std::string bytes = good + zeros + good;
      bytes[8 * element + at] = '\2';
      const bool is_bool = at == 0 || at == 2 || at == 3 || at == 5;
      const std::string why = "lot: message: element " + std::to_string(element) +
                              " would have a bool in it that is neither 0 nor 1 (Numerical result "
                              "out of range)";
      const std::size_t before = root.size();
      CHECK(assign(bytes, 24) == (is_bool ? why : "no error"));
      CHECK(root.size() == (is_bool ? before : 3));
    }
  }
  CHECK(assign(good, 7) ==
        "lot: message: 7 bytes are no whole number of its elements (Numerical result out of "
        "range)");
  CHECK(assign("", 0) == "no error");
  CHECK(root.size() == 0);
}

TEST_CASE("a bool beside other numbers is looked at, whichever of them comes first") {
  for (const bool is_first : {true, false}) {
    Words words(
        of({type(Kind::Array, 4, "", 1, 2), structure("S", 2, {field("a", 2, 0), field("b", 3, 1)}),
            type(is_first ? Kind::Bool : Kind::UInt, 1),
            type(is_first ? Kind::UInt : Kind::Bool, 1)}));
    const std::byte good[] = {std::byte{1}, std::byte{1}, std::byte{0}, std::byte{0}};
    words.root().assign({good, 4});
    CHECK((words.words[16] & 0xffffffff) == 0x101);
    for (std::size_t at = 0; at < 4; ++at) {
      std::byte bytes[] = {std::byte{0}, std::byte{0}, std::byte{0}, std::byte{0}};
      bytes[at] = std::byte{2};
      CHECK(error_of([&] {
              words.root().assign({bytes, 4});
            }).first == ((at % 2 == 0) == is_first ? ERANGE : 0));
    }
    CHECK(error_of([&] {
            words.root().assign({good, 2});
          }).second == "lot: message: it has 2 elements, always (Invalid argument)");
  }
}

TEST_CASE("a description that says of a byte too often what it is, is not followed to its end") {
  const auto assign = [](std::size_t fields, std::size_t bytes, Kind kind) {
    std::vector<Field> all;
    for (std::size_t i = 0; i < fields; ++i) all.push_back(field("", 2, 0));
    Words words(of({type(Kind::Vector, 32, "libstdc++", 1), structure("S", 1, std::move(all)),
                    type(kind, 1)}));
    words.root().construct();
    const std::string zeros(bytes, '\0');
    return error_of([&] {
             words.root().assign({reinterpret_cast<const std::byte*>(zeros.data()), bytes});
           })
        .second;
  };
  const std::string why =
      "lot: message: its description has fields that share bytes (Bad message); end the process "
      "that writes into the segment where it should not";
  CHECK(assign(127, 1, Kind::Bool) == "no error");
  CHECK(assign(128, 1, Kind::Bool) == why);
  CHECK(assign(95, 2, Kind::Bool) == "no error");
  CHECK(assign(96, 2, Kind::Bool) == why);
  CHECK(assign(300, 1, Kind::UInt) == "no error");
}

TEST_CASE("one byte is an element, and bytes of plain types need not be looked at") {
  Words words(of({type(Kind::Vector, 32, "libc++", 1), type(Kind::Char, 1)}));
  words.root().construct();
  words.root().assign({reinterpret_cast<const std::byte*>("q"), 1});
  CHECK(words.words[64] == ((kFill & ~std::uint64_t{0xff}) | 'q'));
  CHECK(words.root().size() == 1);
  Words opaque(of({type(Kind::Vector, 32, "libc++", 1), type(Kind::Opaque, 1, "O")}));
  opaque.root().construct();
  CHECK(error_of([&] { opaque.root().assign({}); }).second ==
        "lot: message: the elements of a vector of O are not just bytes (Invalid argument)");
}

TEST_CASE("numbers are written in the sizes that a machine has") {
  for (const std::uint64_t size : {3U, 5U, 7U, 9U}) {
    for (const Kind kind : {Kind::Int, Kind::UInt}) {
      Words words(of({type(kind, size)}));
      CHECK(error_of([&] { words.root().set(1); }).second ==
            "lot: message: an integer of " + std::to_string(size) +
                " bytes is not written (Invalid argument)");
      CHECK(words.words[16] == kFill);
    }
  }
  for (const std::uint64_t size : {2U, 12U, 17U}) {
    Words words(of({type(Kind::Float, size)}));
    CHECK(error_of([&] { words.root().set(1.0); }).second ==
          "lot: message: a float of " + std::to_string(size) +
              " bytes is not written (Invalid argument)");
    CHECK(words.words[16] == kFill);
  }
}

TEST_CASE("a char has the machine's sign, and a bool is no number but 0 and 1") {
  Words letter(of({type(Kind::Char, 1)}));
  constexpr int kLeast = std::numeric_limits<char>::min();
  constexpr int kMost = std::numeric_limits<char>::max();
  letter.root().set(kLeast);
  CHECK((letter.words[16] & 0xff) == static_cast<unsigned char>(kLeast));
  letter.root().set(kMost);
  CHECK((letter.words[16] & 0xff) == static_cast<unsigned char>(kMost));
  for (const int bad : {kLeast - 1, kMost + 1}) {
    CHECK(error_of([&] { letter.root().set(bad); }).second ==
          "lot: message: " + std::to_string(bad) +
              " does not fit a char (Numerical result out of range)");
  }
  Words yes(of({type(Kind::Bool, 1)}));
  yes.root().set(1);
  CHECK((yes.words[16] & 0xff) == 1);
  yes.root().set(0);
  CHECK((yes.words[16] & 0xff) == 0);
  const std::string why = " does not fit a bool (Numerical result out of range)";
  CHECK(error_of([&] { yes.root().set(2); }).second == "lot: message: 2" + why);
  CHECK(error_of([&] { yes.root().set(-1); }).second == "lot: message: -1" + why);
  CHECK(error_of([&] { yes.root().set(1.0); }).second == "lot: message: 1" + why);
  CHECK((yes.words[16] & 0xff) == 0);
}

TEST_CASE("bits are written between their neighbours, of each number that fits and no other") {
  const struct {
    Kind kind;
    std::uint32_t bits;
    std::uint32_t bit;
    std::int64_t least;
    std::uint64_t most;
  } cases[] = {
      {Kind::Int, 1, 3, -1, 0},          {Kind::Int, 5, 2, -16, 15},
      {Kind::Int, 13, 7, -4096, 4095},   {Kind::Int, 64, 0, INT64_MIN, INT64_MAX},
      {Kind::UInt, 1, 7, 0, 1},          {Kind::UInt, 9, 7, 0, 511},
      {Kind::UInt, 63, 1, 0, INT64_MAX}, {Kind::UInt, 64, 0, 0, UINT64_MAX},
  };
  for (const auto& [kind, bits, bit, least, most] : cases) {
    CAPTURE(bits);
    CAPTURE(bit);
    for (const std::uint64_t fill : {std::uint64_t{0}, ~std::uint64_t{0}}) {
      Words words(of({structure("S", 16, {field("f", 1, 0, bits, bit)}), type(kind, 8)}));
      words.words[16] = fill;
      const lot::MutableValue root = words.root()["f"];
      const std::uint64_t mask = (bits == 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1)
                                 << bit;
      root.set(most);
      CHECK(words.words[16] == ((fill & ~mask) | (most << bit)));
      root.set(least);
      CHECK(words.words[16] ==
            ((fill & ~mask) | ((static_cast<std::uint64_t>(least) << bit) & mask)));
      root.set(0);
      CHECK(words.words[16] == (fill & ~mask));
      if (most != UINT64_MAX) CHECK(error_of([&] { root.set(most + 1); }).first == ERANGE);
      if (least != INT64_MIN) CHECK(error_of([&] { root.set(least - 1); }).first == ERANGE);
      CHECK(words.words[16] == (fill & ~mask));
      CHECK(words.words[17] == kFill);
    }
  }
}

TEST_CASE("only a duration with a period is set to a time") {
  Words words(of({duration(8, 1, 1, 1000), type(Kind::Int, 8)}));
  words.root().set(std::chrono::seconds(3));
  CHECK(words.words[16] == 3000);
  const std::string why = ", and no duration (Invalid argument)";
  for (const auto& [numerator, denominator] :
       {std::pair(0, 1), std::pair(-1, 1), std::pair(1, 0), std::pair(1, -1)}) {
    words.all.types[0] = duration(8, 1, numerator, denominator);
    CHECK(error_of([&] { words.root().set(std::chrono::seconds(4)); }).second ==
          "lot: message: it is a duration" + why);
  }
  words.all.types[0] = type(Kind::Int, 8);
  words.all.types[0].numerator = words.all.types[0].denominator = 1;
  CHECK(error_of([&] { words.root().set(std::chrono::seconds(4)); }).second ==
        "lot: message: it is a int64" + why);
  CHECK(words.words[16] == 3000);
}

TEST_CASE("a text is set in a string or in chars, and no byte behind them changes") {
  Words words(of({type(Kind::Array, 12, "", 1, 12), type(Kind::Char, 1)}));
  const lot::MutableValue root = words.root();
  root.set("0123456789ab");
  CHECK(std::memcmp(&words.words[16], "0123456789ab\xa5\xa5\xa5\xa5", 16) == 0);
  root.set("0123456");
  CHECK(std::memcmp(&words.words[16], "0123456\0\0\0\0\0\xa5\xa5\xa5\xa5", 16) == 0);
  CHECK(error_of([&] { root.set("0123456789abc"); }).second ==
        "lot: message: 13 bytes of text do not fit a char[12] (Numerical result out of range)");
  words.all.types[1] = type(Kind::UInt, 1);
  CHECK(error_of([&] { root.set("x"); }).second ==
        "lot: message: it is a uint8[12], and no string (Invalid argument)");
  words.all.types[0] = type(Kind::Char, 1);
  CHECK(error_of([&] { root.set("x"); }).second ==
        "lot: message: it is a char, and no string (Invalid argument)");
  words.all.types = {type(Kind::Vector, 32, "libstdc++", 1), type(Kind::Char, 1)};
  root.construct();
  CHECK(error_of([&] { root.set("x"); }).second ==
        "lot: message: it is a vector of char, and no string (Invalid argument)");
  CHECK(root.size() == 0);
}

}  // namespace
