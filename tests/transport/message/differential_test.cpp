// SPDX-License-Identifier: Apache-2.0

// Random operations on ShmString and ShmVector, and the same ones on std::string and std::vector.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp: a string's capacity behind a pointer that is a class.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <list>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/boost_containers.hpp"
#include "lot/lot.hpp"

#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::ShmString;
using lot::ShmVector;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::size_t kContainers = 4;
constexpr std::size_t kLongest = 3000;

/// The same things with Shm's containers and with std's.
struct Shm {
  ShmString text[kContainers];
  ShmVector<std::int64_t> numbers[kContainers];
  ShmVector<ShmString> names[kContainers];
  ShmVector<ShmVector<std::uint16_t>> rows[kContainers];
};
struct Std {
  std::string text[kContainers];
  std::vector<std::int64_t> numbers[kContainers];
  std::vector<std::string> names[kContainers];
  std::vector<std::vector<std::uint16_t>> rows[kContainers];
};

bool same(std::string_view a, std::string_view b) { return a == b; }
template <class T>
bool same(const T& a, const T& b) {
  return a == b;
}
template <class A, class B>
bool same(const ShmVector<A>& a, const std::vector<B>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const auto& x, const auto& y) { return same(x, y); });
}
bool same(const Shm& a, const Std& b) {
  bool good = true;
  for (std::size_t i = 0; i < kContainers; ++i) {
    good = good && same(a.text[i], b.text[i]) && same(a.numbers[i], b.numbers[i]) &&
           same(a.names[i], b.names[i]) && same(a.rows[i], b.rows[i]);
  }
  return good;
}

using Random = std::mt19937_64;

std::size_t below(Random& random, std::size_t n) { return random() % n; }

template <class T>
T any(Random& random) {
  if constexpr (std::is_arithmetic_v<T>) {
    return static_cast<T>(random());
  } else if constexpr (std::is_constructible_v<T, const char*>) {
    const std::size_t size = below(random, 40);  // in order: arguments have none
    return T(size, static_cast<char>('a' + below(random, 26)));
  } else {
    const std::size_t size = below(random, 20);
    return T(size, any<typename T::value_type>(random));
  }
}

/// One operation that strings and vectors have alike on c, which may use d, another of its kind.
template <class C>
void alike(C& c, C& d, Random& random) {
  const auto value = any<typename C::value_type>(random);
  const std::size_t count = below(random, 50);
  const std::size_t from = below(random, c.size() + 1);
  const std::size_t to = from + below(random, c.size() - from + 1);
  const auto at = [&c](std::size_t i) { return c.cbegin() + static_cast<std::ptrdiff_t>(i); };
  const std::size_t half = d.size() / 2;
  const auto middle = d.begin() + static_cast<std::ptrdiff_t>(half);
  switch (below(random, 20)) {
    case 0:
    case 1:
    case 2:
      c.push_back(value);
      break;
    case 3:
      if (!c.empty()) c.pop_back();
      break;
    case 4:
      c.insert(at(from), value);
      break;
    case 5:
      c.insert(at(from), count, value);
      break;
    case 6:
      c.insert(at(from), d.begin(), middle);
      break;
    case 7:
      c.insert(at(from), {value, value});
      break;
    case 8:
      if (from < c.size()) c.erase(at(from));
      break;
    case 9:
      c.erase(at(from), at(to));
      break;
    case 10:
      c.assign(count, value);
      break;
    case 11:
      c.assign(middle, d.end());
      break;
    case 12:
      c.resize(count * 4, value);
      break;
    case 13:
      c.reserve(count * 8);
      break;
    case 14:
      c.shrink_to_fit();
      break;
    case 15:
      c = d;
      break;
    case 16:
      c = std::move(d);
      d.clear();
      break;
    case 17:
      c.swap(d);
      break;
    case 18:
      if (count == 0) c.clear();
      break;
    default:
      if (!c.empty()) c.insert(at(from), c[c.size() / 2]);  // of itself
      break;
  }
}

/// One that only strings have.
template <class S>
void of_strings(S& s, S& t, Random& random) {
  const std::size_t from = below(random, s.size() + 1);
  const std::size_t count = below(random, 30);
  switch (below(random, 6)) {
    case 0:
      s.append(t, t.size() / 3, count);
      break;
    case 1:
      s.replace(from, count, t);
      break;
    case 2:
      s.replace(from, count, s, s.size() / 2, count);  // of itself
      break;
    case 3:
      s.insert(from, s, s.size() / 3, count);
      break;
    case 4:
      s.replace(from, count, s.c_str() + s.size() / 2);
      break;
    default:
      s = s.substr(from, 200) + t.substr(0, count);
      break;
  }
}

template <class C>
void step(C (&all)[kContainers], Random& random) {
  C& c = all[below(random, kContainers)];
  C& d = all[below(random, kContainers)];
  if (&c == &d) return;
  alike(c, d, random);
  if (c.size() > kLongest) c.resize(10);
}

template <class Things>
void step(Things& things, Random& random) {
  switch (below(random, 5)) {
    case 0:
      step(things.text, random);
      break;
    case 1: {
      auto& s = things.text[below(random, kContainers)];
      auto& t = things.text[below(random, kContainers)];
      of_strings(s, t, random);
      if (s.size() > kLongest) s.resize(10);
      break;
    }
    case 2:
      step(things.numbers, random);
      break;
    case 3:
      step(things.names, random);
      break;
    default:
      step(things.rows, random);
      break;
  }
}

template <class Things>
void run(Things& things, std::uint64_t seed, unsigned steps) {
  Random random(seed);
  for (unsigned n = 0; n < steps; ++n) step(things, random);
}

/// Both, step by step; the first step after which they differ, or `steps`.
unsigned run_both(Shm& shm, Std& std, std::uint64_t seed, unsigned steps) {
  Random for_shm(seed);
  Random for_std(seed);
  for (unsigned n = 0; n < steps; ++n) {
    step(shm, for_shm);
    step(std, for_std);
    if (n % 16 == 0 && !same(shm, std)) return n;
  }
  return same(shm, std) ? steps : steps - 1;
}

/// Containers that give their newest memory back, of sizes that fill a run of memory to its end:
/// the one of another container begins there.
struct ShmStacks {
  ShmVector<unsigned char> bytes[6];
  lot::ShmDeque<std::uint64_t> queue[2];
  lot::ShmList<std::array<std::uint64_t, 6>> nodes[2];  // of 64 bytes with their links
};
struct StdStacks {
  std::vector<unsigned char> bytes[6];
  std::deque<std::uint64_t> queue[2];
  std::list<std::array<std::uint64_t, 6>> nodes[2];
};

bool same(const ShmStacks& a, const StdStacks& b) {
  const auto equal = [](const auto& x, const auto& y) {
    return std::equal(x.begin(), x.end(), y.begin(), y.end());
  };
  bool good = true;
  for (std::size_t i = 0; i < 6; ++i) good = good && equal(a.bytes[i], b.bytes[i]);
  for (std::size_t i = 0; i < 2; ++i) {
    good = good && equal(a.queue[i], b.queue[i]) && equal(a.nodes[i], b.nodes[i]);
  }
  return good;
}

std::size_t some_size(Random& random) {
  constexpr std::size_t kPage = 4096;
  switch (below(random, 3)) {
    case 0:
      return kPage << below(random, 4);
    case 1:
      return kPage * (1 + below(random, 6));
    default:
      return below(random, 6 * kPage);
  }
}

/// Pushes and pops a number of elements.
template <class C, class Make>
void change(C& c, Random& random, Make make) {
  for (std::size_t n = below(random, 2000); n > 0; --n) c.push_back(make(random()));
  for (std::size_t n = below(random, 2000); n > 0 && !c.empty(); --n) c.pop_back();
}

template <class Stacks>
void stack(Stacks& stacks, Random& random) {
  const std::size_t kind = below(random, 8);
  if (kind < 6) {
    auto& bytes = stacks.bytes[below(random, 6)];
    const std::size_t size = some_size(random);
    const auto value = static_cast<unsigned char>(random());
    switch (below(random, 6)) {
      case 0:
        bytes.assign(size, value);
        break;
      case 1:
        bytes.resize(size, value);
        break;
      case 2:
        bytes.clear();
        bytes.shrink_to_fit();
        break;
      case 3:
        bytes.resize(std::min(bytes.size(), size));
        bytes.shrink_to_fit();
        break;
      case 4:
        bytes.reserve(size);
        break;
      default:
        for (std::size_t n = 0; n < size / 16; ++n) bytes.push_back(value);
        break;
    }
  } else if (kind == 6) {
    change(stacks.queue[below(random, 2)], random, [](std::uint64_t n) { return n; });
  } else {
    change(stacks.nodes[below(random, 2)], random, [](std::uint64_t n) {
      return std::array<std::uint64_t, 6>{n, n + 1, n + 2, n + 3, n + 4, n + 5};
    });
  }
}

constexpr unsigned kRounds = 200;
constexpr unsigned kSteps = 600;

}  // namespace

TEST_SUITE_BEGIN("message");

TEST_CASE("random operations leave the same in Shm's containers as in std's, on the heap") {
  const Watchdog watchdog(100);
  const std::uint64_t first = seed();
  for (std::uint64_t round = 0; round < kRounds; ++round) {
    CAPTURE(first + round);
    Shm shm;
    Std std;
    REQUIRE(run_both(shm, std, first + round, kSteps) == kSteps);
  }
}

TEST_CASE("random operations leave the same in a message, for the process that reads it too") {
  const Watchdog watchdog(100);
  const std::uint64_t first = seed();
  const auto options = fresh();
  Steps ready;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Shm>("/t");
    ready.tell();
    for (std::uint64_t round = 0; round < kRounds; ++round) {
      const auto seen = puller.pull(50s);
      must(bool(seen), "the message");
      Std std;
      run(std, first + round, kSteps);
      must(same(*seen, std), "what it has");
    }
  });
  REQUIRE(ready.next() == '.');
  lot::ShmEngine engine(options);
  lot::segment::Segment segment(engine.path());
  {
    auto pusher = engine.advertise<Shm>("/t", {lot::Policy::Block, 4, 50s});
    REQUIRE(pusher.wait_for_readers(1, 20s));
    for (std::uint64_t round = 0; round < kRounds; ++round) {
      CAPTURE(first + round);
      auto message = pusher.loan();
      Std std;
      REQUIRE(run_both(*message, std, first + round, kSteps) == kSteps);
      REQUIRE(pusher.push(std::move(message)) == lot::Status::Ok);
    }
    CHECK(reader.wait() == 0);
  }
  CHECK(eventually([&] { return Audit(segment).nothing(); }));
}

TEST_CASE("what a container gives back is given to no other while something is in use there") {
  const Watchdog watchdog(100);
  const std::uint64_t first = seed();
  for (std::uint64_t segments = 0; segments < 8; ++segments) {
    lot::ShmEngine engine(fresh());  // fresh: what is claimed one after the other lies side by side
    for (std::uint64_t round = 0; round < 25; ++round) {
      const std::uint64_t seed = first + segments * 25 + round;
      CAPTURE(seed);
      auto message = engine.make<ShmStacks>();
      StdStacks std;
      Random for_shm(seed);
      Random for_std(seed);
      for (unsigned n = 0; n < 60; ++n) {
        CAPTURE(n);
        stack(*message, for_shm);
        stack(std, for_std);
        REQUIRE(same(*message, std));
      }
    }
  }
}

TEST_CASE("a piece of no bytes lies in the memory that it is counted in") {
  lot::ShmEngine engine(fresh());
  auto message = engine.make<ShmStacks>();
  auto& [full, behind, next, a, b, c] = message->bytes;
  full.resize(4 * 4096);  // the whole of its run of memory, and the next begins behind it
  auto allocator = full.get_allocator();
  const auto piece = allocator.allocate(0);
  behind.assign(4 * 4096, 'b');
  allocator.deallocate(piece, 0);
  next.assign(4 * 4096, 'n');
  CHECK(std::count(behind.begin(), behind.end(), 'b') == 4 * 4096);
  CHECK(a.size() + b.size() + c.size() == 0);
}

TEST_CASE("two buffers that are given back leave those that follow whole") {
  lot::ShmEngine engine(fresh());
  auto message = engine.make<ShmStacks>();
  auto& [left, right, packed, index, tail, none] = message->bytes;
  left.resize(4 * 4096);  // the whole of its run of memory, and the next begins behind it
  right.resize(4 * 4096);
  right.clear();
  right.shrink_to_fit();
  left.clear();
  left.shrink_to_fit();
  packed.assign(5000, 'p');
  index.assign(20000, 'i');
  tail.assign(9000, 't');
  CHECK(std::count(packed.begin(), packed.end(), 'p') == 5000);
  CHECK(std::count(index.begin(), index.end(), 'i') == 20000);
  CHECK(std::count(tail.begin(), tail.end(), 't') == 9000);
  CHECK(none.empty());
}

TEST_SUITE_END();
