// SPDX-License-Identifier: Apache-2.0

// Boost's containers (and std::deque) in messages.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp: a string's capacity behind a pointer that is a class.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <algorithm>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <random>
#include <set>
#include <string>
#include <sys/mman.h>
#include <type_traits>
#include <utility>
#include <vector>

#include <boost/container/string.hpp>
#include <boost/interprocess/containers/deque.hpp>
#include <boost/interprocess/containers/flat_map.hpp>
#include <boost/interprocess/containers/flat_set.hpp>
#include <boost/interprocess/containers/list.hpp>
#include <boost/interprocess/containers/map.hpp>
#include <boost/interprocess/containers/set.hpp>
#include <boost/interprocess/containers/slist.hpp>
#include <boost/interprocess/containers/stable_vector.hpp>
#include <boost/interprocess/containers/string.hpp>
#include <boost/interprocess/containers/vector.hpp>
#include <boost/unordered_map.hpp>
#include <boost/unordered_set.hpp>
#include <doctest/doctest.h>

#include "lot/boost_containers.hpp"
#include "lot/lot.hpp"

#include "support/processes.hpp"

namespace {

using namespace lot::testing;
namespace bi = boost::interprocess;

[[maybe_unused]] const std::string& prefix_taken = prefix();

template <class T>
using Allocator = lot::ShmAllocator<T>;
using BoostString = bi::basic_string<char, std::char_traits<char>, Allocator<char>>;
template <class T>
using BoostVector = bi::vector<T, Allocator<T>>;

// Boost.Interprocess's containers are the ones that lot/boost_containers.hpp names.
static_assert(std::is_same_v<lot::ShmDeque<int>, bi::deque<int, Allocator<int>>>);
static_assert(std::is_same_v<lot::ShmList<int>, bi::list<int, Allocator<int>>>);
static_assert(std::is_same_v<lot::ShmSlist<int>, bi::slist<int, Allocator<int>>>);
static_assert(std::is_same_v<lot::ShmStableVector<int>, bi::stable_vector<int, Allocator<int>>>);
static_assert(
    std::is_same_v<lot::ShmMap<int, long>,
                   bi::map<int, long, std::less<int>, Allocator<std::pair<const int, long>>>>);
static_assert(
    std::is_same_v<lot::ShmMultimap<int, long>,
                   bi::multimap<int, long, std::less<int>, Allocator<std::pair<const int, long>>>>);
static_assert(
    std::is_same_v<lot::ShmFlatMap<int, long>,
                   bi::flat_map<int, long, std::less<int>, Allocator<std::pair<int, long>>>>);
static_assert(std::is_same_v<lot::ShmSet<int>, bi::set<int, std::less<int>, Allocator<int>>>);
static_assert(
    std::is_same_v<lot::ShmFlatSet<int>, bi::flat_set<int, std::less<int>, Allocator<int>>>);

/// An order with a state, which then is part of the message.
struct Backwards {
  bool backwards = true;
  bool operator()(int a, int b) const { return backwards ? b < a : a < b; }
};

struct Part {
  std::uint32_t id;
  lot::ShmString name;
  lot::ShmList<lot::ShmString> notes;
};

/// One of each.
struct Zoo {
  std::uint64_t address;  ///< of this object, as its maker sees it
  BoostVector<int> vector;
  BoostVector<lot::ShmString> names;
  BoostString text;
  lot::ShmDeque<int> deque;
  lot::ShmDeque<lot::ShmString> lines;
  std::deque<int, Allocator<int>> std_deque;
  lot::ShmList<int> list;
  lot::ShmList<BoostString> texts;
  lot::ShmSlist<int> slist;
  lot::ShmStableVector<lot::ShmString> stable;
  lot::ShmSmallVector<int, 4> few;
  lot::ShmSmallVector<lot::ShmString, 4> many;
  boost::container::static_vector<int, 8> fixed;
  lot::ShmMap<int, lot::ShmString> map;
  lot::ShmMap<lot::ShmString, int> by_name;
  lot::ShmMultimap<int, int> multimap;
  lot::ShmSet<int> set;
  lot::ShmSet<int, Backwards> backwards;
  lot::ShmMultiset<int> multiset;
  lot::ShmFlatMap<int, lot::ShmString> flat_map;
  lot::ShmFlatMultimap<int, int> flat_multimap;
  lot::ShmFlatSet<int> flat_set;
  lot::ShmFlatMultiset<int> flat_multiset;
  boost::unordered_map<int, lot::ShmString, std::hash<int>, std::equal_to<int>,
                       Allocator<std::pair<const int, lot::ShmString>>>
      hashed;
  boost::unordered_set<lot::ShmString, std::hash<lot::ShmString>, std::equal_to<lot::ShmString>,
                       Allocator<lot::ShmString>>
      hashed_names;
  lot::ShmMap<int, lot::ShmVector<lot::ShmMap<int, lot::ShmString>>> nested;
  lot::ShmVector<Part> parts;
};
static_assert(lot::assert_message<Zoo>());

/// What the containers of a Zoo are filled with: numbers and long texts, from a seed.
struct Content {
  explicit Content(std::uint64_t seed) {
    std::mt19937_64 random(seed);
    const std::size_t count = random() % 300;
    for (std::size_t i = 0; i < count; ++i) {
      numbers.push_back(static_cast<int>(random() % 100));
      texts.push_back(std::string(random() % 60, static_cast<char>('a' + random() % 26)));
      table[numbers.back()] = texts.back();
    }
  }
  std::vector<int> numbers;
  std::vector<std::string> texts;
  std::map<int, std::string> table;
};

lot::ShmString shm(const std::string& text) { return lot::ShmString(text.c_str()); }

void fill(Zoo& zoo, const Content& content) {
  zoo.address = reinterpret_cast<std::uint64_t>(&zoo);
  zoo.slist.push_front(-1);
  zoo.deque.push_front(-1);
  auto behind = zoo.slist.begin();
  for (std::size_t i = 0; i < content.numbers.size(); ++i) {
    const int n = content.numbers[i];
    const char* text = content.texts[i].c_str();
    zoo.vector.push_back(n);
    zoo.names.emplace_back(text);
    zoo.text += text;
    zoo.deque.push_back(n);
    zoo.lines.push_front(shm(text));
    zoo.std_deque.push_back(n);
    zoo.list.insert(zoo.list.begin(), n);
    zoo.texts.push_back(BoostString(text));
    behind = zoo.slist.insert_after(behind, n);
    zoo.stable.insert(zoo.stable.begin(), shm(text));
    zoo.few.push_back(n);
    zoo.many.emplace_back(text);
    if (zoo.fixed.size() < zoo.fixed.capacity()) zoo.fixed.push_back(n);
    zoo.map[n] = text;
    zoo.by_name.emplace(text, n);
    zoo.multimap.emplace(n, n + 1);
    zoo.set.insert(n);
    zoo.backwards.insert(n);
    zoo.multiset.insert(n);
    zoo.flat_map[n] = text;
    zoo.flat_multimap.emplace(n, n + 1);
    zoo.flat_set.insert(n);
    zoo.flat_multiset.insert(n);
    zoo.hashed[n] = text;
    zoo.hashed_names.emplace(text);
    if (i % 50 == 0) {
      zoo.nested[n].resize(2);
      zoo.nested[n].back()[n] = text;
      zoo.parts.emplace_back();
      zoo.parts.back().id = static_cast<std::uint32_t>(i);
      zoo.parts.back().name = text;
      zoo.parts.back().notes.emplace_back(text);
    }
  }
  zoo.deque.pop_front();
  zoo.slist.pop_front();
  zoo.list.sort();
}

template <class A, class B>
bool same(const A& a, const B& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& x, const auto& y) {
    if constexpr (std::is_arithmetic_v<std::decay_t<decltype(x)>>) {
      return x == y;
    } else {
      return std::string_view(x.data(), x.size()) == std::string_view(y.data(), y.size());
    }
  });
}
template <class A, class B>
bool same_table(const A& a, const B& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& x, const auto& y) {
    return x.first == y.first && x.second == y.second.c_str();
  });
}

/// The first thing that is not as it should be, or "".
std::string wrong(const Zoo& zoo, const Content& content) {
  std::vector<int> sorted = content.numbers;
  std::sort(sorted.begin(), sorted.end());
  const std::set<int> set(sorted.begin(), sorted.end());
  const std::vector<std::string> backwards(content.texts.rbegin(), content.texts.rend());
  std::string text;
  for (const auto& t : content.texts) text += t;
#define LOT_IS(what) \
  if (!(what)) return #what
  LOT_IS(same(zoo.vector, content.numbers));
  LOT_IS(same(zoo.names, content.texts));
  LOT_IS(zoo.text == text.c_str());
  LOT_IS(same(zoo.deque, content.numbers));
  LOT_IS(same(zoo.lines, backwards));
  LOT_IS(same(zoo.std_deque, content.numbers));
  LOT_IS(same(zoo.list, sorted));
  LOT_IS(same(zoo.texts, content.texts));
  LOT_IS(same(zoo.slist, content.numbers));
  LOT_IS(same(zoo.stable, backwards));
  LOT_IS(same(zoo.few, content.numbers));
  LOT_IS(same(zoo.many, content.texts));
  LOT_IS(zoo.fixed.size() == std::min<std::size_t>(content.numbers.size(), 8));
  LOT_IS(std::equal(zoo.fixed.begin(), zoo.fixed.end(), content.numbers.begin()));
  LOT_IS(same_table(zoo.map, content.table));
  LOT_IS(std::is_sorted(zoo.by_name.begin(), zoo.by_name.end()));
  LOT_IS(std::all_of(content.texts.begin(), content.texts.end(),
                     [&](const auto& t) { return zoo.by_name.count(shm(t)) == 1; }));
  LOT_IS(zoo.multimap.size() == sorted.size());
  LOT_IS(std::equal(zoo.multimap.begin(), zoo.multimap.end(), sorted.begin(),
                    [](const auto& x, int n) { return x.first == n && x.second == n + 1; }));
  LOT_IS(same(zoo.set, set));
  LOT_IS(std::equal(zoo.backwards.begin(), zoo.backwards.end(), set.rbegin(), set.rend()));
  LOT_IS(same(zoo.multiset, sorted));
  LOT_IS(same_table(zoo.flat_map, content.table));
  LOT_IS(zoo.flat_multimap.size() == sorted.size());
  LOT_IS(same(zoo.flat_set, set));
  LOT_IS(same(zoo.flat_multiset, sorted));
  LOT_IS(zoo.hashed.size() == content.table.size());
  LOT_IS(std::all_of(content.table.begin(), content.table.end(), [&](const auto& entry) {
    const auto found = zoo.hashed.find(entry.first);
    return found != zoo.hashed.end() && found->second == entry.second.c_str();
  }));
  LOT_IS(std::all_of(content.texts.begin(), content.texts.end(),
                     [&](const auto& t) { return zoo.hashed_names.count(shm(t)) == 1; }));
  LOT_IS(zoo.parts.size() == (content.texts.size() + 49) / 50);
  for (std::size_t i = 0; i < zoo.parts.size(); ++i) {
    const int n = content.numbers[50 * i];
    LOT_IS(zoo.parts[i].id == 50 * i);
    LOT_IS(zoo.parts[i].name == content.texts[50 * i].c_str());
    LOT_IS(zoo.parts[i].notes.front() == content.texts[50 * i].c_str());
    LOT_IS(zoo.nested.at(n).size() == 2);
    LOT_IS(zoo.nested.at(n).front().empty());
    LOT_IS(!zoo.nested.at(n).back().empty());
  }
#undef LOT_IS
  return "";
}

/// Whether a container allocates in a message.
template <class C>
bool inside(const C& container) {
  return container.get_allocator().arena() != nullptr;
}

/// Whether everything in the zoo is on the side that it should be on.
bool all_are(bool in_message, const Zoo& zoo) {
  bool good = true;
  const auto look = [&](const auto& container) { good &= inside(container) == in_message; };
  const auto look_all = [&](const auto& container) {
    look(container);
    for (const auto& element : container) look(element);
  };
  const auto look_table = [&](const auto& container) {
    look(container);
    for (const auto& entry : container) look(entry.second);
  };
  look(zoo.vector), look_all(zoo.names), look(zoo.text), look(zoo.deque), look_all(zoo.lines);
  look(zoo.std_deque), look(zoo.list), look_all(zoo.texts), look(zoo.slist), look_all(zoo.stable);
  look(zoo.few), look_all(zoo.many), look_table(zoo.map), look(zoo.by_name), look(zoo.multimap);
  look(zoo.set), look(zoo.backwards), look(zoo.multiset), look_table(zoo.flat_map);
  look(zoo.flat_multimap), look(zoo.flat_set), look(zoo.flat_multiset), look_table(zoo.hashed);
  look_all(zoo.hashed_names), look_table(zoo.nested);
  for (const auto& entry : zoo.by_name) look(entry.first);
  for (const auto& entry : zoo.nested) {
    for (const auto& table : entry.second) look_table(table);
  }
  for (const auto& part : zoo.parts) look(part.name), look_all(part.notes);
  return good;
}

}  // namespace

TEST_SUITE_BEGIN("message");

TEST_CASE("Boost's containers in a message are read by a process that maps it elsewhere") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  const std::uint64_t first = seed();
  Steps ready;
  Child reader([&] {
    // Takes the place where the segment would lie at the maker's address.
    void* place =
        mmap(nullptr, 1 << 30, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    must(place != MAP_FAILED, "a place");
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Zoo>("/zoo");
    ready.tell();
    for (std::uint64_t n = 0; n < 50; ++n) {
      auto seen = puller.pull(20s);
      must(bool(seen), "a zoo");
      must(seen->address != reinterpret_cast<std::uint64_t>(seen.get()), "another address");
      const Content content(first + n);
      must(wrong(*seen, content).empty(), wrong(*seen, content).c_str());
      must(all_are(true, *seen), "all in the message");
      const Zoo mine = *seen;
      seen.reset();
      must(wrong(mine, content).empty(), wrong(mine, content).c_str());
      must(all_are(false, mine), "the copy is private");
    }
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Zoo>("/zoo", {lot::Policy::Block, 3, 30s});
    REQUIRE(pusher.wait_for_readers(1, 10s));
    for (std::uint64_t n = 0; n < 50; ++n) {
      auto zoo = pusher.loan();
      fill(*zoo, Content(first + n));
      REQUIRE(pusher.push(std::move(zoo)) == lot::Status::Ok);
    }
    CHECK(reader.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("Boost's containers of different messages copy where others would steal") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Zoo>("/zoo");
  const Content content(seed());
  Zoo heap;
  fill(heap, content);
  CHECK(all_are(false, heap));
  auto first = pusher.loan();
  *first = heap;
  CHECK(wrong(*first, content) == "");
  CHECK(all_are(true, *first));
  auto second = pusher.loan();
  *second = std::move(*first);
  first.reset();
  auto third = pusher.loan(*second);
  CHECK(wrong(*second, content) == "");
  CHECK(all_are(true, *second));
  second.reset();
  CHECK(wrong(*third, content) == "");
  CHECK(all_are(true, *third));
  Zoo back;
  back = std::move(*third);
  third.reset();
  CHECK(wrong(back, content) == "");
  CHECK(all_are(false, back));
  auto fourth = pusher.loan();
  *fourth = std::move(heap);
  CHECK(wrong(*fourth, content) == "");
  CHECK(all_are(true, *fourth));
}

TEST_CASE("messages of Boost's containers give all their memory back") {
  const Watchdog watchdog(60);
  const auto options = fresh(32 << 20);
  lot::ShmEngine engine(options);
  lot::segment::Segment s(engine.path());
  {
    auto pusher = engine.advertise<Zoo>("/zoo", {lot::Policy::Overwrite, 2, 1s});
    auto puller = engine.subscribe<Zoo>("/zoo");
    const std::uint64_t first = seed();
    for (std::uint64_t n = 0; n < 300; ++n) {
      auto zoo = pusher.loan();
      fill(*zoo, Content(first + n));
      REQUIRE(pusher.push(std::move(zoo)) == lot::Status::Ok);
      auto seen = puller.try_pull();
      REQUIRE(seen);
      if (n % 50 == 0) CHECK(wrong(*seen, Content(first + n)) == "");
    }
  }
  CHECK(eventually([&] { return Audit(s).nothing(); }));
}

TEST_SUITE_END();
