// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <iterator>
#include <list>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "lot/boost_containers.hpp"
#include "lot/lot.hpp"

#include "run.hpp"

/// Messages with each kind of container, the same with std's containers, and the random operations
/// that are done on both by the same code.
namespace lot::outside {

struct Shm {
  using String = ShmString;
  template <class T>
  using Vector = ShmVector<T>;
  template <class T>
  using List = ShmList<T>;
  template <class T>
  using Slist = ShmSlist<T>;
  template <class T>
  using Deque = ShmDeque<T>;
  template <class T>
  using Stable = ShmStableVector<T>;
  template <class T>
  using Small = ShmSmallVector<T, 8>;
  template <class K, class T>
  using Map = ShmMap<K, T>;
  template <class K, class T>
  using Multimap = ShmMultimap<K, T>;
  template <class K, class T>
  using Flat = ShmFlatMap<K, T>;
  template <class K>
  using Set = ShmSet<K>;
};
/// A list that is linked forwards only has no push_back().
template <class T>
struct StdSlist : std::list<T> {
  using std::list<T>::list;
  void push_back(const T&) = delete;
};
struct Std {
  using String = std::string;
  template <class T>
  using Vector = std::vector<T>;
  template <class T>
  using List = std::list<T>;
  template <class T>
  using Slist = StdSlist<T>;
  template <class T>
  using Deque = std::deque<T>;
  template <class T>
  using Stable = std::deque<T>;
  template <class T>
  using Small = std::deque<T>;
  template <class K, class T>
  using Map = std::map<K, T>;
  template <class K, class T>
  using Multimap = std::multimap<K, T>;
  template <class K, class T>
  using Flat = std::map<K, T>;
  template <class K>
  using Set = std::set<K>;
};

struct alignas(64) Wide {
  std::uint64_t number;
  friend bool operator==(const Wide& a, const Wide& b) { return a.number == b.number; }
  friend bool operator<(const Wide& a, const Wide& b) { return a.number < b.number; }
};

/// Fits into the small payload of its block, with a little memory left there.
template <class In>
struct Note {
  typename In::String text;
  typename In::template Vector<std::uint16_t> numbers;
  typename In::template List<std::uint32_t> list;

  auto parts() { return std::tie(text, numbers, list); }
  auto parts() const { return std::tie(text, numbers, list); }
};

/// Its pieces can all be told one by one.
template <class In>
struct Document {
  typename In::String text;
  typename In::String title;
  typename In::template Vector<std::uint32_t> numbers;
  typename In::template Vector<Wide> wides;
  typename In::template Vector<typename In::String> lines;
  typename In::template Vector<typename In::template Vector<std::uint8_t>> rows;
  typename In::template List<std::uint64_t> list;
  typename In::template Map<std::uint32_t, typename In::String> names;
  typename In::template Flat<std::uint16_t, std::uint64_t> flat;
  typename In::template Small<std::uint32_t> few;
  typename In::template Set<std::uint16_t> set;

  auto parts() {
    return std::tie(text, title, numbers, wides, lines, rows, list, names, flat, few, set);
  }
  auto parts() const {
    return std::tie(text, title, numbers, wides, lines, rows, list, names, flat, few, set);
  }
};

/// Containers that keep memory of which their users see nothing.
template <class In>
struct Heap {
  typename In::template Deque<std::uint32_t> deque;
  typename In::template Deque<typename In::String> queue;
  typename In::template Stable<std::uint64_t> stable;
  typename In::template Slist<std::uint32_t> slist;
  typename In::template Multimap<std::uint8_t, std::uint32_t> multimap;
  typename In::template Vector<typename In::template List<std::uint16_t>> lists;

  auto parts() { return std::tie(deque, queue, stable, slist, multimap, lists); }
  auto parts() const { return std::tie(deque, queue, stable, slist, multimap, lists); }
};

// ---- what is equal, and the same in private memory

template <class T>
concept Document_ = requires(T d) {
  d.parts();
};
template <class T>
concept Pair = requires(T p) {
  p.first;
  p.second;
};
template <class T>
concept Range = requires(T c) {
  c.begin();
  c.end();
};
template <class T>
concept Text = Range<T> && requires(T s) {
  s.c_str();
};
template <class T>
concept Keyed = requires {
  typename T::key_type;
};

template <class A, class B>
bool same(const A& a, const B& b) {
  if constexpr (Document_<A>) {
    return [&]<std::size_t... I>(std::index_sequence<I...>) {
      return (same(std::get<I>(a.parts()), std::get<I>(b.parts())) && ...);
    }
    (std::make_index_sequence<std::tuple_size_v<decltype(a.parts())>>{});
  } else if constexpr (Pair<A>) {
    return same(a.first, b.first) && same(a.second, b.second);
  } else if constexpr (Range<A>) {
    if constexpr (Text<A>) {
      if (a.c_str()[a.size()] != '\0') return false;
    }
    return a.size() == b.size() &&
           std::equal(a.begin(), a.end(), b.begin(), b.end(),
                      [](const auto& x, const auto& y) { return same(x, y); });
  } else {
    return a == b;
  }
}

template <class To, class From>
To as(const From& from) {
  if constexpr (Document_<To>) {
    return [&]<std::size_t... I>(std::index_sequence<I...>) {
      To to;
      ((std::get<I>(to.parts()) =
            as<std::remove_cvref_t<decltype(std::get<I>(to.parts()))>>(std::get<I>(from.parts()))),
       ...);
      return to;
    }
    (std::make_index_sequence<std::tuple_size_v<decltype(from.parts())>>{});
  } else if constexpr (Pair<To>) {
    return To{as<std::remove_const_t<typename To::first_type>>(from.first),
              as<typename To::second_type>(from.second)};
  } else if constexpr (Range<To>) {
    To to;
    for (const auto& element : from) to.insert(to.end(), as<typename To::value_type>(element));
    return to;
  } else {
    return from;
  }
}

// ---- operations, alike for both: each returns what a program can see of it

template <class T>
T any(Random& random) {
  if constexpr (std::is_same_v<T, Wide>) {
    return Wide{random.below(100)};
  } else if constexpr (std::is_arithmetic_v<T>) {
    return static_cast<T>(random.next());
  } else if constexpr (Text<T>) {
    const std::size_t size = random.below(40);
    return T(size, static_cast<char>('a' + random.below(26)));
  } else {
    T made;
    for (std::uint64_t n = random.below(12); n != 0; --n) {
      made.insert(made.end(), any<typename T::value_type>(random));
    }
    return made;
  }
}

/// How many elements: mostly a few, of plain types now and then as many as take memory of their
/// own.
template <class T>
std::size_t amount(Random& random) {
  const std::size_t n = random.below(256);
  if (n < 180) return n % 16;
  if (!std::is_trivially_copyable_v<T>) return n % 64;
  return n < 250 ? n * 4 : (n - 249) * (70'000 / sizeof(T));
}

template <class C>
auto place(C& c, std::size_t n) {
  return std::next(c.begin(), static_cast<std::ptrdiff_t>(n));
}

/// What strings, vectors, deques and lists have alike.
template <class C>
std::uint64_t change_sequence(C& c, C& other, Random& random) {
  using T = typename C::value_type;
  const std::size_t from = random.below(c.size() + 1);
  const std::size_t to = from + random.below(c.size() - from + 1);
  const std::size_t part = random.below(other.size() + 1);
  const std::size_t count = amount<T>(random);
  const T value = any<T>(random);
  switch (random.below(14)) {
    case 0:
    case 1:
      c.push_back(value);
      return c.size();
    case 2:
      if (!c.empty()) c.pop_back();
      return c.size();
    case 3: {
      const auto it = c.insert(place(c, from), value);
      return static_cast<std::uint64_t>(std::distance(c.begin(), it));
    }
    case 4:
      // Where nothing is inserted or erased, Boost 1.74's deque moves an element onto itself.
      if (count != 0) c.insert(place(c, from), count, value);
      return c.size();
    case 5:
      if (&c != &other && part != 0) c.insert(place(c, from), other.begin(), place(other, part));
      return c.size();
    case 6:
      if (from < c.size()) c.erase(place(c, from));
      return c.size();
    case 7:
      if (from != to) c.erase(place(c, from), place(c, to));
      return c.size();
    case 8:
      c.assign(count, value);
      return c.size();
    case 9:
      if (&c != &other) c.assign(place(other, part), other.end());
      return c.size();
    case 10:
      c.resize(count, value);
      return c.size();
    case 11:
      for (std::size_t n = 0; n < count % 600; ++n) c.push_back(value);
      return c.size();
    case 12:
      std::reverse(c.begin(), c.end());
      return c.empty() ? 0 : 1;
    default:
      c.clear();
      return 0;
  }
}

/// What they do with their memory: nothing of it can be seen.
template <class C>
void change_memory(C& c, Random& random) {
  const std::size_t count = amount<typename C::value_type>(random);
  const bool grows = random.below(2) == 0;
  if (grows) {
    if constexpr (requires { c.reserve(count); }) c.reserve(count);
  } else {
    if constexpr (requires { c.shrink_to_fit(); }) c.shrink_to_fit();
  }
}

/// Where the standard says what comes of an insertion of its own elements.
template <class C>
inline constexpr bool kTakesItself = Text<C>;
template <class T, class A>
inline constexpr bool kTakesItself<std::vector<T, A>> = true;

/// With itself.
template <class C>
void change_with_itself(C& c, Random& random) {
  const std::size_t at = random.below(c.size() + 1);
  const std::size_t count = random.below(40);
  if constexpr (Text<C>) {
    switch (random.below(3)) {
      case 0:
        c.append(c, at, count);
        return;
      case 1:
        c.insert(at, c, c.size() / 3, count);
        return;
      default:
        c.replace(at, count, c, c.size() / 2, count);
    }
  } else if (!c.empty()) {
    c.insert(place(c, at), c[c.size() / 2]);
  }
}

template <class C>
std::uint64_t change_list(C& c, Random& random) {
  const std::size_t at = random.below(c.size() + 1);
  switch (random.below(5)) {
    case 0:
      c.sort();
      return c.empty() ? 0 : 1;
    case 1:
      c.unique();
      return c.size();
    case 2:
      if (at < c.size()) c.splice(c.begin(), c, place(c, at));
      return at;
    case 3:
      c.remove(c.empty() ? 0 : c.front());
      return c.size();
    default:
      c.push_front(any<typename C::value_type>(random));
      return c.size();
  }
}

/// A list that is linked forwards only.
template <class C>
std::uint64_t change_slist(C& c, Random& random) {
  const std::size_t count = amount<typename C::value_type>(random) % 500;
  switch (random.below(6)) {
    case 0:
      c.sort();
      return c.size();
    case 1:
      c.reverse();
      return c.size();
    case 2:
      if (!c.empty()) c.pop_front();
      return c.size();
    case 3:
      c.assign(count, any<typename C::value_type>(random));
      return count;
    case 4:
      c.clear();
      return 0;
    default:
      c.push_front(any<typename C::value_type>(random));
      return c.size();
  }
}

/// Maps and sets. Of a key that is there several times, the newest is the last one.
template <class C>
std::uint64_t change_keyed(C& c, Random& random) {
  using Key = typename C::key_type;
  const auto key = static_cast<Key>(random.below(200));
  const auto make = [&] {
    if constexpr (requires { typename C::mapped_type; }) {
      return typename C::value_type(key, any<typename C::mapped_type>(random));
    } else {
      return key;
    }
  };
  switch (random.below(10)) {
    case 0:
    case 1:
    case 2:
      for (unsigned n = 0; n < 3; ++n) c.insert(make());
      return c.size();
    case 3:
      return c.erase(key);
    case 4:
      return static_cast<std::uint64_t>(std::distance(c.begin(), c.lower_bound(key)));
    case 5:
      return c.count(key);
    case 6:
      if (!c.empty()) c.erase(c.begin());
      return c.size();
    case 7:
      if constexpr (requires { c[key]; }) c[key] = any<typename C::mapped_type>(random);
      return c.size();
    case 8:
      c.erase(c.lower_bound(key), c.end());
      return c.size();
    default:
      if (key < 20) c.clear();
      return c.size();
  }
}

template <class C>
std::uint64_t change(C& c, C& other, Random& random);

/// From another container of its kind, perhaps of another message.
template <class C>
std::uint64_t take(C& to, C& from, Random& random) {
  switch (random.below(4)) {
    case 0:
      to = from;
      return to.size();
    case 1:
      if (&to == &from) return 0;
      to = std::move(from);
      from.clear();  // what is left in it the standard does not say
      return to.size();
    case 2: {
      C copy(from);  // outside of messages
      copy.swap(copy);
      return same(copy, from) ? 1 : 0;
    }
    default:
      return (to < from ? 1U : 0U) | (to == from ? 2U : 0U);
  }
}

/// `same_memory`: both containers lie in one message, or in none.
template <class C>
std::uint64_t operate(C& c, C& other, bool same_memory, Random& random) {
  const std::uint64_t dice = random.below(12);
  if (dice == 0) return take(c, other, random);
  if (dice == 1 && same_memory) {
    c.swap(other);
    return c.size();
  }
  return change(c, other, random);
}

template <class C>
std::uint64_t change(C& c, C& other, Random& random) {
  const std::uint64_t dice = random.below(8);
  if constexpr (Keyed<C>) {
    if (dice == 0) change_memory(c, random);
    return change_keyed(c, random);
  } else if constexpr (!requires { c.push_back(c.front()); }) {
    return change_slist(c, random);
  } else {
    constexpr bool is_list = requires { c.splice(c.begin(), c); };
    if constexpr (Range<typename C::value_type> && !Text<C>) {
      if (dice < 3 && !c.empty()) {  // a container in it
        auto& inner = *place(c, random.below(c.size()));
        auto& inner_other = *place(c, random.below(c.size()));
        return change(inner, inner_other, random);
      }
    }
    if (dice == 3) {
      change_memory(c, random);
      return 0;
    }
    if constexpr (is_list) {
      if (dice < 6) return change_list(c, random);
    } else if constexpr (kTakesItself<C>) {
      if (dice == 4 && c.size() < 2000) {
        change_with_itself(c, random);
        return c.size();
      }
    }
    return change_sequence(c, other, random);
  }
}

/// After an allocation that failed. Boost 1.74's stable vector may then have more spare nodes than
/// its index has room for, and an assertion of its next call ends the program: it is emptied.
template <class D>
void mend_after_failure(D& document) {
  const auto mend = []<class C>(C& c) {
    if constexpr (std::is_same_v<C, ShmStableVector<typename C::value_type>>) {
      C(c.get_allocator()).swap(c);
    }
  };
  std::apply([&](auto&... parts) { (mend(parts), ...); }, document.parts());
}

constexpr std::uint64_t kMostParts = 32;

/// Changes one container of a document, perhaps with the same one of another document.
template <class D>
std::uint64_t change_part(D& document, D& other, bool same_memory, Random& random) {
  constexpr std::size_t parts = std::tuple_size_v<decltype(document.parts())>;
  const std::size_t chosen = random.below(parts);
  std::uint64_t seen = 0;
  [&]<std::size_t... I>(std::index_sequence<I...>) {
    const auto change_if = [&]<std::size_t N>(std::integral_constant<std::size_t, N>) {
      if (N != chosen) return;
      auto& c = std::get<N>(document.parts());
      seen = operate(c, std::get<N>(other.parts()), same_memory, random);
      if (c.size() > 5000 && random.below(4) == 0) c.clear();
    };
    (change_if(std::integral_constant<std::size_t, I>{}), ...);
  }
  (std::make_index_sequence<parts>{});
  return seen * kMostParts + chosen;
}

}  // namespace lot::outside
