// SPDX-License-Identifier: Apache-2.0

// When types are the same to pointers, how they are called, and how a message that is being built
// counts what it refers to.

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/core.hpp"
#include "lot/detail/type_name.hpp"
#include "lot/lot.hpp"

#include "description/by_hand.hpp"
#include "segment/layout.hpp"
#include "support/error_of.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::Kind;
using lot::detail::MessageType;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Leaf {
  std::uint64_t value;
};
constexpr std::size_t kRefs = 40;  ///< more than one list of references has room for
struct Tree {
  lot::ShmRef<Leaf> refs[kRefs];
};

struct Made : MessageType {
  lot::detail::Described known;
};

Made plain(const std::string& name, std::uint64_t size = 8, std::uint64_t align = 8,
           std::uint64_t hash = 0) {
  Made type{};
  type.size = size;
  type.align = align;
  type.hash = hash;
  type.name = name.c_str();
  return type;
}

/// With a field of each name; "": without one. `kind`: of the fields.
Made described(const std::vector<std::string>& names, Kind kind = Kind::UInt) {
  static const std::string name = "made";
  lot::Description all;
  std::vector<by_hand::Field> fields;
  for (std::size_t i = 0; i < names.size(); ++i) {
    fields.push_back(by_hand::field(names[i], 1, 4 * i));
  }
  all.types = {by_hand::structure("made", 8, fields), by_hand::type(kind, 4)};
  Made type = plain(name);
  type.known = lot::detail::make_described(all);
  type.described = [](const MessageType& self) -> const lot::detail::Described& {
    return static_cast<const Made&>(self).known;
  };
  return type;
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("when two types are the same to pointers") {
  const std::string a = "a", b = "b", made = "made", cut(lot::segment::kTypeNameBytes - 1, 'n');
  const std::string longer = cut + "x", longest = cut + "yz", shorter = cut.substr(1),
                    other = shorter + "x", other_end = shorter + "y";
  struct Row {
    Made first, second;
    bool is_same;
  };
  const std::vector<Row> rows{
      {plain(a), plain(a), true},
      {plain(a), plain(b), false},
      {plain(a), plain(a, 16), false},
      {plain(a), plain(a, 8, 4), false},
      {plain(a), plain(a, 8, 8, 1), false},
      {plain(cut), plain(longer), true},
      {plain(longest), plain(longer), true},
      {plain(cut), plain(shorter), false},
      {plain(other), plain(other_end), false},  // the last byte that counts
      {plain(made), described({"x", "y"}), false},
      {described({"x", "y"}), described({"x", "y"}), true},
      {described({"x", "y"}), described({"x", "z"}), false},
      {described({"x", "y"}), described({"y", "x"}), false},
      {described({"x", "y"}), described({"x", "y"}, Kind::Float), false},
      {described({"x", "y"}), described({"x"}), false},
      // Of a type without names, or without some, those that both have must be the same.
      {described({"x", "y"}), described({"", ""}), true},
      {described({"", ""}), described({"", ""}), true},
      {described({"x", "y"}), described({"x", ""}), true},
      {described({"x", "y"}), described({"", "y"}), true},
      {described({"x", ""}), described({"", "y"}), true},
      {described({"x", "y"}), described({"z", ""}), false},
      {described({"x", ""}), described({"z", ""}), false},
  };
  for (std::size_t i = 0; i < rows.size(); ++i) {
    CAPTURE(i);
    CHECK(lot::detail::is_same(rows[i].first, rows[i].second) == rows[i].is_same);
    CHECK(lot::detail::is_same(rows[i].second, rows[i].first) == rows[i].is_same);
  }
}

TEST_CASE("the name of a type is what stands between the brackets of its bearer") {
  using lot::detail::demangle;
  using lot::detail::demangle_argument;
  CHECK(demangle("i") == "int");
  CHECK(demangle("no mangled name") == "no mangled name");
  CHECK(demangle_argument("A<B>::bearer") == "B");
  CHECK(demangle_argument("A<B<C> >::bearer") == "B<C>");
  CHECK(demangle_argument("A<B<C>::bearer>::bearer") == "B<C>::bearer");
  CHECK(demangle_argument("A<B>") == "A<B>");
  CHECK(demangle_argument("name") == "name");
}

TEST_CASE("a message keeps what it refers to until its last reference to it goes") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto leaves = engine.advertise<Leaf>("/leaves");
  auto trees = engine.advertise<Tree>("/trees");
  lot::ShmUniquePtr<Tree> tree = trees.loan();
  for (int round = 0; round < 3; ++round) {  // then in lists that are there
    std::vector<lot::ShmWeakPtr<Leaf>> watches;
    for (std::size_t i = 0; i < kRefs; i += 2) {
      lot::ShmSharedPtr<Leaf> leaf = leaves.loan(std::uint64_t{i});
      watches.emplace_back(leaf);
      tree->refs[i] = leaf;
      tree->refs[i + 1] = leaf;
    }
    const auto living = [&] {
      std::vector<std::size_t> found;
      for (std::size_t n = 0; n < watches.size(); ++n) {
        if (!watches[n].expired()) found.push_back(2 * n);
      }
      return found;
    };
    std::vector<std::size_t> expected;
    for (std::size_t i = 0; i < kRefs; i += 2) expected.push_back(i);
    CHECK(living() == expected);
    for (std::size_t i = 0; i < kRefs; i += 2) {
      CHECK(tree->refs[i]->value == i);
      tree->refs[i].reset();
      CHECK(living() == expected);
    }
    // From the middle to both ends.
    for (std::size_t n = 0; n < kRefs / 2; ++n) {
      const std::size_t at = n % 2 == 0 ? kRefs / 2 + n : kRefs / 2 - n - 1;
      const std::size_t i = at / 2 * 2;
      tree->refs[i + 1].reset();
      std::erase(expected, i);
      CHECK(living() == expected);
    }
  }
}

TEST_CASE("a message refers to nothing of another segment, and to nothing new once published") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh()), elsewhere(fresh());
  auto leaves = engine.advertise<Leaf>("/leaves");
  auto others = elsewhere.advertise<Leaf>("/leaves");
  auto trees = engine.advertise<Tree>("/trees");
  const lot::ShmSharedPtr<Leaf> leaf = leaves.loan(std::uint64_t{1});
  const lot::ShmSharedPtr<Leaf> far = others.loan(std::uint64_t{2});
  lot::ShmSharedPtr<Tree> tree = trees.loan();
  const auto refusal = [&](const auto& target) {
    return error_of([&] { tree->refs[0] = target; });
  };
  CHECK(refusal(far).first == EINVAL);
  CHECK(names(refusal(far).second, "one in another segment"));
  CHECK(refusal(leaf).first == 0);
  must_go(trees.push(tree));
  const auto [error, text] = error_of([&] { tree->refs[1] = leaf; });
  CHECK(error == EPERM);
  CHECK(names(text, "a message that was published can not refer to others"));
}

TEST_SUITE_END();
