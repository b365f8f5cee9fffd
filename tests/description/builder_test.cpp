// SPDX-License-Identifier: Apache-2.0

// The words that a Builder writes, one by one, by descriptions that no compiler makes.

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
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
  static void* take(void* self, std::size_t bytes, std::size_t align) {
    auto& mine = *static_cast<Words*>(self);
    mine.taken.emplace_back(bytes, align);
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

}  // namespace
