// SPDX-License-Identifier: Apache-2.0

// ShmString and ShmVector have the interface of std::string and std::vector: the same program runs
// on both, on the heap and in a message, and writes the same record.

#if defined(__GNUC__) && !defined(__clang__)
// As in message_test.cpp: a string's capacity behind a pointer that is a class.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <algorithm>
#include <compare>
#include <concepts>
#include <cstdint>
#include <deque>
#include <functional>
#include <initializer_list>
#include <iomanip>
#include <iterator>
#include <list>
#include <random>
#include <ranges>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <unordered_set>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using namespace std::string_literals;
using lot::ShmString;
using lot::ShmVector;

[[maybe_unused]] const std::string& prefix_taken = prefix();

const char* const kLong = "a text that is much too long for the small string in place";

static_assert(std::contiguous_iterator<lot::detail::OffsetPtr<int>>);
static_assert(std::ranges::contiguous_range<ShmVector<int>>);
static_assert(std::ranges::contiguous_range<const ShmString>);

// ---- what a program sees
// -------------------------------------------------------------------------

/// A line for each thing that a program has seen.
class Record {
 public:
  template <class T>
  Record& operator()(const T& value) {
    if constexpr (std::is_same_v<T, bool>) {
      return line(value ? "true" : "false");
    } else if constexpr (std::is_same_v<T, char>) {
      return line(std::string(1, value));
    } else if constexpr (std::is_arithmetic_v<T>) {
      return line(std::to_string(value));
    } else if constexpr (std::is_convertible_v<T, std::partial_ordering>) {
      return line(value < 0 ? "less" : value > 0 ? "greater" : "equal");
    } else if constexpr (std::is_convertible_v<T, std::string_view>) {
      return line(std::string(std::string_view(value)));
    } else {  // a vector
      std::string all = std::to_string(value.size()) + ":";
      for (const auto& element : value) {
        Record inner;
        inner(element);
        all += " [" + inner.lines.front() + "]";
      }
      return line(all);
    }
  }
  /// The name of what f throws.
  template <class F>
  Record& thrown_by(F&& f) {
    try {
      f();
    } catch (const std::out_of_range&) {
      return line("out_of_range");
    } catch (const std::length_error&) {
      return line("length_error");
    }
    return line("nothing thrown");
  }

  std::vector<std::string> lines;

 private:
  Record& line(std::string text) {
    lines.push_back(std::move(text));
    return *this;
  }
};

/// Where the objects of a program are made. They stay where they are.
template <class T>
struct OnHeap {
  using type = T;
  template <class... Args>
  T& make(Args&&... args) {
    return objects.emplace_back(std::forward<Args>(args)...);
  }
  std::deque<T> objects;
};
template <class T>
struct Objects {
  ShmVector<T> objects;
};
template <class T>
struct InMessage {
  using type = T;
  explicit InMessage(Objects<T>& m) : message(m) { message.objects.reserve(500); }
  template <class... Args>
  T& make(Args&&... args) {
    REQUIRE(message.objects.size() < message.objects.capacity());
    return message.objects.emplace_back(std::forward<Args>(args)...);
  }
  Objects<T>& message;
};

/// The allocator of objects that are made in `place`.
template <class Place>
auto allocator_of(Place& place) {
  return place.make().get_allocator();
}

// ---- strings
// -------------------------------------------------------------------------------------

template <class Place>
void construct_strings(Place& place, Record& see) {
  using S = typename Place::type;
  const auto here = allocator_of(place);
  const S model(kLong);
  const std::string_view view = "a view";
  const std::initializer_list<char> list = {'l', 'i', 's', 't'};
  std::istringstream stream("from a stream");
  see(place.make());
  see(place.make(here));
  see(place.make(std::size_t{40}, 'n'))(place.make(std::size_t{3}, 'n', here));
  see(place.make(model, std::size_t{30}))(place.make(model, std::size_t{30}, here));
  see(place.make(model, std::size_t{2}, std::size_t{5}));
  see(place.make(model, std::size_t{2}, std::size_t{5}, here));
  see(place.make(kLong, std::size_t{20}))(place.make(kLong, std::size_t{20}, here));
  see(place.make(kLong))(place.make(kLong, here));
  see(place.make(view.begin(), view.end()))(place.make(view.begin(), view.end(), here));
  see(place.make(std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()));
  see(place.make(model))(place.make(model, here));
  see(place.make(S(model)))(place.make(S(model), here));
  see(place.make(list))(place.make(list, here));
  see(place.make(view))(place.make(view, here));
  see(place.make(view, std::size_t{2}, std::size_t{3}));
  see(place.make(view, std::size_t{2}, std::size_t{3}, here));
  see.thrown_by([&] { place.make(model, std::size_t{1000}); });
  see.thrown_by([&] { place.make(model.max_size() + 1, 'x'); });
}

template <class Place>
void assign_strings(Place& place, Record& see) {
  using S = typename Place::type;
  S& s = place.make();
  S& itself = s;
  S& other = place.make(kLong);
  const std::string_view view = "a view";
  see(s = other)(s = S("moved"))(s = "text")(s = 'c')(s = {'i', 'l'})(s = view);
  see(s = std::move(other));
  other = kLong;
  see(s.assign(3, 'n'))(s.assign(other))(s.assign(other, 5))(s.assign(other, 5, 7));
  see(s.assign(S("moved")))(s.assign(kLong, 9))(s.assign(kLong));
  see(s.assign(view.begin(), view.end()))(s.assign({'a', 'b'}))(s.assign(view));
  see(s.assign(view, 3))(s.assign(view, 1, 2));
  see.thrown_by([&] { s.assign(other, 1000, 1); });
  s = other;
  s = s.c_str() + 3;  // of itself
  see(s)(s = itself)(s.assign(s, 2, 20))(s.assign(s.data() + 4, 6));
}

template <class Place>
void reach_strings(Place& place, Record& see) {
  using S = typename Place::type;
  S& s = place.make(kLong);
  const S& c = s;
  see(s.at(3))(c.at(4))(s[5])(c[6])(c[c.size()])(s.front())(c.front())(s.back())(c.back());
  s.at(0) = 'A';
  s[1] = '-';
  s.front() = 'B';
  s.back() = '!';
  s.data()[3] = '3';
  see(s)(c.data()[3])(std::string_view(c.c_str()));
  see.thrown_by([&] { s.at(s.size()); }).thrown_by([&] { (void)c.at(1000); });
  const std::string_view view = s;
  see(view)(static_cast<std::string_view>(c));
  see(std::string(s.begin(), s.end()))(std::string(c.begin(), c.end()));
  see(std::string(s.rbegin(), s.rend()))(std::string(c.rbegin(), c.rend()));
  see(std::string(c.cbegin(), c.cend()))(std::string(c.crbegin(), c.crend()));
  see(std::string(std::string_view(s)))(std::span<char>(s).size());
  std::sort(s.begin(), s.end());
  see(s);
  std::ranges::reverse(s);
  see(s) (*std::ranges::max_element(c))(std::ranges::distance(c))(s.end() - s.begin());
  see (*(s.begin() + 3))(s.begin()[4]) (*(c.end() - 2))(s.begin() < s.end());
}

template <class Place>
void size_strings(Place& place, Record& see) {
  using S = typename Place::type;
  S& s = place.make();
  see(s.empty())(s.size())(s.length())(s.max_size() > 1000000);
  s.reserve(100);
  see(s.capacity() >= 100)(s.empty());
  s.resize(20);
  see(s)(s.size());
  s.resize(60, 'r');
  s.resize(50, 'x');
  see(s);
  s.shrink_to_fit();
  see(s)(s.capacity() >= s.size());
  s.resize(5);
  s.shrink_to_fit();
  see(s)(s.size());
  s.clear();
  see(s)(s.empty());
  see.thrown_by([&] { s.resize(s.max_size() + 1); }).thrown_by([&] {
    s.reserve(s.max_size() + 1);
  });
}

template <class Place>
void change_strings(Place& place, Record& see) {
  using S = typename Place::type;
  S& s = place.make("0123456789");
  S& other = place.make(kLong);
  const std::string_view view = "a view";
  see(s.insert(2, 3, 'n'))(s.insert(1, "text"))(s.insert(4, kLong, 5))(s.insert(3, other));
  see(s.insert(6, other, 4, 9))(s.insert(7, other, 50))(*s.insert(s.cbegin() + 3, 'c'));
  see (*s.insert(s.cbegin(), 4, 'f'))(*s.insert(s.cbegin() + 2, view.begin(), view.end()));
  see (*s.insert(s.cend(), {'i', 'l'}))(s.insert(5, view))(s.insert(5, view, 2, 3))(s);
  see(s.insert(3, s))(s.insert(2, s.c_str() + 5, 10));  // of itself
  see.thrown_by([&] { s.insert(1000, "x"); });
  see(s.erase(100))(s.erase(3, 4)) (*s.erase(s.cbegin() + 1))(*s.erase(s.cbegin(), s.cbegin() + 9));
  see(s)(s.erase()).thrown_by([&] { s.erase(1); });
  for (char c = 'a'; c < 'z'; ++c) s.push_back(c);
  s.pop_back();
  see(s)(s.append(3, 'n'))(s.append(other))(s.append(other, 3, 5))(s.append(other, 50));
  see(s.append(kLong, 7))(s.append("text"))(s.append(view.begin(), view.end()));
  see(s.append({'i', 'l'}))(s.append(view))(s.append(view, 2, 3))(s.append(s))(
      s.append(s.data(), 9));
  s.resize(10);
  see(s += other)(s += "text")(s += 'c')(s += {'i', 'l'})(s += view);
  see(s.replace(1, 2, other))(s.replace(s.cbegin(), s.cbegin() + 2, other));
  see(s.replace(1, 50, other, 4, 6))(s.replace(3, 1, other, 50));
  see(s.replace(s.cbegin() + 2, s.cbegin() + 4, view.begin(), view.end()));
  see(s.replace(1, 0, kLong, 4))(s.replace(s.cbegin(), s.cbegin(), kLong, 3));
  see(s.replace(2, 3, "text"))(s.replace(s.cbegin(), s.cend() - 20, "text"));
  see(s.replace(2, 3, 4, 'n'))(s.replace(s.cbegin() + 1, s.cbegin() + 6, 4, 'n'));
  see(s.replace(s.cbegin(), s.cbegin() + 1, {'i', 'l'}))(s.replace(0, 2, view));
  see(s.replace(s.cbegin(), s.cbegin() + 2, view))(s.replace(1, 2, view, 3, 2));
  see(s.replace(1, 2, view, 3))(s.replace(0, 3, s, 5, 6))(s.replace(2, 2, s.c_str() + 1, 5));
  see(s.replace(s.cbegin(), s.cbegin() + 3, s.cbegin() + 5, s.cend()));
  see.thrown_by([&] { s.replace(1000, 1, "x"); });
  char buffer[8] = {};
  see(s.copy(buffer, 7))(std::string_view(buffer))(s.copy(buffer, 3, 2))(std::string_view(buffer));
  see.thrown_by([&] { (void)s.copy(buffer, 1, 1000); });
  s.swap(other);
  see(s)(other);
  std::swap(s, other);
  swap(s, other);
  S& small = place.make("small");
  small.swap(s);
  see(s)(other)(small)(std::erase(small, 't'))(
      std::erase_if(small, [](char c) { return c < 'f'; }));
  see(small);
}

template <class Place>
void ask_strings(Place& place, Record& see) {
  using S = typename Place::type;
  const S& s = place.make("abcabcabc abc");
  const S& t = place.make("abc");
  const std::string_view view = "cab";
  see(s.find(t))(s.find(t, 1))(s.find("ca", 1, 1))(s.find("ca"))(s.find('c', 3))(s.find(view));
  see(s.rfind(t))(s.rfind(t, 5))(s.rfind("ca", 9, 1))(s.rfind("ca"))(s.rfind('c', 3))(
      s.rfind(view));
  see(s.find_first_of(t, 1))(s.find_first_of("xc", 1, 2))(s.find_first_of("xc"));
  see(s.find_first_of('c'))(s.find_first_of(view));
  see(s.find_last_of(t, 8))(s.find_last_of("xc", 5, 2))(s.find_last_of("xc"));
  see(s.find_last_of('c'))(s.find_last_of(view));
  see(s.find_first_not_of(t))(s.find_first_not_of("ab", 1, 2))(s.find_first_not_of("ab"));
  see(s.find_first_not_of('a'))(s.find_first_not_of(view));
  see(s.find_last_not_of(t))(s.find_last_not_of("bc", 5, 2))(s.find_last_not_of("bc"));
  see(s.find_last_not_of('c'))(s.find_last_not_of(view))(s.find("none") == S::npos);
  see(s.compare(t))(s.compare(3, 3, t))(s.compare(3, 4, s, 0, 4))(s.compare("abd") < 0);
  see(s.compare(1, 2, "bc"))(s.compare(1, 2, "bcd", 2))(s.compare(view) < 0)(s.compare(2, 3, view));
  see(s.compare(2, 2, view, 0, 2)).thrown_by([&] { (void)s.compare(1000, 1, t); });
  see(s.starts_with(view))(s.starts_with('a'))(s.starts_with("abc"));
  see(s.ends_with(view))(s.ends_with('c'))(s.ends_with(" abc"));
  see(s.substr(3))(s.substr(2, 4))(s.substr()).thrown_by([&] { (void)s.substr(1000); });
  see(s == t)(s != t)(s < t)(s <= t)(s > t)(s >= t)(s <=> t);
  see(t == "abc")(t != "abc")(t < "abd")(t <= "abc")(t > "abc")(t >= "abc")(t <=> "abd");
  see("abc" == t)("abb" != t)("abd" < t)("abc" <= t)("abc" > t)("abc" >= t)("abb" <=> t);
  see(t == std::string_view(t))(std::hash<S>()(t) == std::hash<std::string_view>()("abc"));
  see(std::hash<S>()(s) == std::hash<S>()(S(s)));
  std::unordered_set<S> set;
  set.insert(t);
  see(set.count(S("abc")))(set.count(s));
}

template <class Place>
void join_and_stream_strings(Place& place, Record& see) {
  using S = typename Place::type;
  const S& s = place.make("left ");
  const S& t = place.make(kLong);
  see(s + t)(s + "right")(s + 'r')("l" + t)('l' + t);
  see(S(s) + S(t))(S(s) + t)(s + S(t))(S(s) + "right")("l" + S(t))(S(s) + 'r')('l' + S(t));
  std::ostringstream out;
  out << s << '[' << std::setw(10) << std::left << std::setfill('.') << place.make("w") << ']' << t;
  see(out.str());
  std::istringstream in("word another\nthe rest of the line that is a long one\nlast;end");
  S& read = place.make();
  in >> read;
  see(read);
  in >> std::setw(3) >> read;
  see(read);
  std::getline(in, read);
  see(read);
  std::getline(in, read);
  see(read);
  std::getline(in, read, ';');
  see(read);
  std::getline(std::move(in), read);
  see(read)(in.eof());
}

template <class Place>
Record string_program(Place&& place) {
  Record record;
  construct_strings(place, record);
  assign_strings(place, record);
  reach_strings(place, record);
  size_strings(place, record);
  change_strings(place, record);
  ask_strings(place, record);
  join_and_stream_strings(place, record);
  return record;
}

// ---- vectors
// -------------------------------------------------------------------------------------

/// A value of a program's element type that says n.
template <class T>
T value_of(int n) {
  if constexpr (std::is_arithmetic_v<T>) {
    return static_cast<T>(n);
  } else if constexpr (std::is_constructible_v<T, const char*>) {
    T text(n % 2 == 0 ? kLong : "short ");
    text += std::to_string(n).c_str();
    return text;
  } else {
    return T(static_cast<std::size_t>(n % 5), value_of<typename T::value_type>(n));
  }
}

template <class Place>
void construct_vectors(Place& place, Record& see) {
  using V = typename Place::type;
  using T = typename V::value_type;
  const auto here = allocator_of(place);
  const T one = value_of<T>(1);
  const std::initializer_list<T> list = {value_of<T>(3), value_of<T>(4), value_of<T>(5)};
  const V model(list);
  std::istringstream stream("7 8 9");
  see(place.make())(place.make(here));
  for (V* v : {&place.make(std::size_t{4}), &place.make(std::size_t{4}, here)}) {
    see(v->size());
    v->assign(v->size(), one);  // trivial elements are not zeroed
  }
  see(place.make(std::size_t{4}, one))(place.make(std::size_t{4}, one, here));
  see(place.make(list.begin(), list.end()))(place.make(list.begin(), list.end(), here));
  if constexpr (std::is_arithmetic_v<T>) {
    see(place.make(std::istream_iterator<T>(stream), std::istream_iterator<T>()));
  }
  see(place.make(model))(place.make(model, here))(place.make(V(model)))(place.make(V(model), here));
  see(place.make(list))(place.make(list, here));
  see.thrown_by([&] { place.make(model.max_size() + 1, one); });
}

template <class Place>
void assign_vectors(Place& place, Record& see) {
  using V = typename Place::type;
  using T = typename V::value_type;
  const std::initializer_list<T> list = {value_of<T>(3), value_of<T>(4), value_of<T>(5)};
  const std::list<T> nodes(list);
  V& v = place.make();
  V& itself = v;
  V& other = place.make(list);
  see(v = other)(v = V(7, value_of<T>(7)))(v = list)(v = std::move(other));
  other = {value_of<T>(9)};
  see(v = other)(v = itself);
  v.assign(20, value_of<T>(2));
  see(v);
  v.assign(nodes.begin(), nodes.end());
  see(v);
  v.assign({value_of<T>(8)});
  see(v);
  v.assign(list);
  see(v);
}

template <class Place>
void reach_vectors(Place& place, Record& see) {
  using V = typename Place::type;
  using T = typename V::value_type;
  V& v = place.make();
  for (int n = 0; n < 30; ++n) v.push_back(value_of<T>(n));
  const V& c = v;
  see(v.at(3))(c.at(4))(v[5])(c[6])(v.front())(c.front())(v.back())(c.back()) (*v.data())(
      c.data()[7]);
  v.at(1) = value_of<T>(100);
  v[2] = value_of<T>(101);
  v.front() = value_of<T>(102);
  v.back() = value_of<T>(103);
  v.data()[3] = value_of<T>(104);
  see(v).thrown_by([&] { v.at(30); }).thrown_by([&] { (void)c.at(30); });
  see(std::vector<T>(v.begin(), v.end()))(std::vector<T>(c.begin(), c.end()));
  see(std::vector<T>(v.rbegin(), v.rend()))(std::vector<T>(c.rbegin(), c.rend()));
  see(std::vector<T>(c.cbegin(), c.cend()))(std::vector<T>(c.crbegin(), c.crend()));
  see(std::span<T>(v).size())(std::span<const T>(c)[4])(std::ranges::distance(c));
  std::sort(v.begin(), v.end());
  see(v);
  std::rotate(v.begin(), v.begin() + 7, v.end());
  see(v);
  std::ranges::sort(v, std::greater<>());
  see(v)(v.end() - v.begin()) (*(v.begin() + 3))(v.begin()[4]) (*(c.end() - 2))(v.begin() <
                                                                                v.end());
}

template <class Place>
void size_vectors(Place& place, Record& see) {
  using V = typename Place::type;
  using T = typename V::value_type;
  V& v = place.make();
  see(v.empty())(v.size())(v.max_size() > 1000000);
  v.reserve(100);
  see(v.capacity() >= 100)(v.empty());
  v.resize(5);  // trivial elements are not zeroed
  v.assign(v.size(), value_of<T>(6));
  v.resize(60, value_of<T>(8));
  v.resize(50, value_of<T>(9));
  see(v);
  v.shrink_to_fit();
  see(v)(v.capacity() == v.size());
  v.resize(5);
  v.shrink_to_fit();
  see(v)(v.capacity() == v.size());
  v.clear();
  see(v)(v.empty());
  v.shrink_to_fit();
  see(v.capacity());
  see.thrown_by([&] { v.resize(v.max_size() + 1); }).thrown_by([&] {
    v.reserve(v.max_size() + 1);
  });
}

template <class Place>
void change_vectors(Place& place, Record& see) {
  using V = typename Place::type;
  using T = typename V::value_type;
  const std::initializer_list<T> list = {value_of<T>(3), value_of<T>(4), value_of<T>(5)};
  const std::list<T> nodes(list);
  const T one = value_of<T>(1);
  V& v = place.make();
  v.push_back(one);
  v.push_back(value_of<T>(2));
  see(v.emplace_back(value_of<T>(6)))(v.emplace_back(one));
  (void)v.emplace_back();
  v.back() = one;
  see (*v.insert(v.cbegin() + 1, one))(*v.insert(v.cbegin(), value_of<T>(7)));
  see (*v.insert(v.cbegin() + 2, 3, value_of<T>(9)))(v.insert(v.cend(), 0, one) == v.end());
  see (*v.insert(v.cbegin() + 3, nodes.begin(), nodes.end())) (*v.insert(v.cend(), list))(v);
  see (*v.emplace(v.cbegin() + 4, value_of<T>(11))) (*v.emplace(v.cend(), one))(v);
  see (*v.insert(v.cbegin(), v.back()))(*v.insert(v.cbegin(), 2, v[5]));  // of itself
  v.push_back(v.front());
  v.emplace_back(v[3]);
  see(v) (*v.erase(v.cbegin() + 2))(*v.erase(v.cbegin(), v.cbegin() + 3));
  see(v.erase(v.cend(), v.cend()) == v.end())(v);
  v.pop_back();
  see(v)(std::erase(v, one))(v);
  see(std::erase_if(v, [&](const T& x) { return x == value_of<T>(3); }))(v);
  V& other = place.make(list);
  v.swap(other);
  see(v)(other);
  std::swap(v, other);
  see(v)(other);
  swap(v, other);
  see(v)(other);
}

template <class Place>
void compare_vectors(Place& place, Record& see) {
  using V = typename Place::type;
  using T = typename V::value_type;
  const std::initializer_list<T> list = {value_of<T>(3), value_of<T>(4), value_of<T>(5)};
  const std::initializer_list<T> more = {value_of<T>(3), value_of<T>(4), value_of<T>(6)};
  for (const auto& left : {list, more}) {
    const V& a = place.make(left);
    const V& b = place.make(more);
    see(a == b)(a != b)(a < b)(a <= b)(a > b)(a >= b)(a <=> b);
  }
}

template <class Place>
Record vector_program(Place&& place) {
  Record record;
  construct_vectors(place, record);
  assign_vectors(place, record);
  reach_vectors(place, record);
  size_vectors(place, record);
  change_vectors(place, record);
  compare_vectors(place, record);
  return record;
}

// ---- the programs on both
// ------------------------------------------------------------------------

/// Whether this container and all in it allocate in a message.
template <class C>
bool all_inside(const C& container) {
  bool inside = container.get_allocator().arena() != nullptr;
  if constexpr (!std::is_arithmetic_v<typename C::value_type>) {
    for (const auto& element : container) inside = inside && all_inside(element);
  }
  return inside;
}

void check_same(const Record& expected, const Record& seen) {
  REQUIRE(expected.lines.size() == seen.lines.size());
  for (std::size_t i = 0; i < expected.lines.size(); ++i) {
    CAPTURE(i);
    REQUIRE(expected.lines[i] == seen.lines[i]);
  }
}

/// What every object of a program shows at its end.
template <class Container>
Record final_state(const Container& objects) {
  Record record;
  for (const auto& object : objects) record(object);
  return record;
}

/// The program on Std, on Shm on the heap, and on Shm in a message that another process then reads.
template <class Std, class Shm, class Program>
void run_on_all(Program&& program) {
  const Watchdog watchdog(60);
  OnHeap<Std> on_std;
  const Record expected = program(on_std);
  CHECK(expected.lines.size() > 60);
  {
    OnHeap<Shm> on_heap;
    check_same(expected, program(on_heap));
    check_same(final_state(on_std.objects), final_state(on_heap.objects));
    for (const auto& object : on_heap.objects) CHECK(object.get_allocator().arena() == nullptr);
  }
  const auto options = fresh();
  Steps ready;
  Child reader([&] {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Objects<Shm>>("/t");
    ready.tell();
    const auto seen = puller.pull(20s);
    must(bool(seen), "the message");
    must(final_state(seen->objects).lines == final_state(on_std.objects).lines, "its objects");
    const Objects<Shm> mine = *seen;
    must(final_state(mine.objects).lines == final_state(on_std.objects).lines, "their copies");
  });
  REQUIRE(ready.next() == '.');
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Objects<Shm>>("/t");
  REQUIRE(pusher.wait_for_readers(1, 20s));
  auto message = pusher.loan();
  check_same(expected, program(InMessage<Shm>(*message)));
  check_same(final_state(on_std.objects), final_state(message->objects));
  CHECK(all_inside(message->objects));
  must_go(pusher.push(std::move(message)));
  CHECK(reader.wait() == 0);
}

}  // namespace

TEST_SUITE_BEGIN("message");

TEST_CASE("ShmString has every member of std::string, on the heap and in a message") {
  run_on_all<std::string, ShmString>([](auto&& place) { return string_program(place); });
}

TEST_CASE("ShmVector has every member of std::vector, on the heap and in a message") {
  const auto program = [](auto&& place) { return vector_program(place); };
  run_on_all<std::vector<int>, ShmVector<int>>(program);
  run_on_all<std::vector<double>, ShmVector<double>>(program);
  run_on_all<std::vector<std::string>, ShmVector<ShmString>>(program);
  run_on_all<std::vector<std::vector<int>>, ShmVector<ShmVector<int>>>(program);
}

TEST_SUITE_END();
