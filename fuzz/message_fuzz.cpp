// SPDX-License-Identifier: Apache-2.0

// Strings and vectors in messages, against those of the standard library: the same operations are
// done on both, by the same code. Messages are copied and moved into each other and into one in
// private memory, published, read, and run out of memory.
//
// Input: operations: kind and message, another message, then arguments (corpus/message/ has
// examples)

#if defined(__GNUC__) && !defined(__clang__)
// g++ 12 does not see, through a pointer that is a class, that libstdc++'s string assignment only
// uses the old capacity together with the old data.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif

#include <algorithm>
#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "lot/fuzz.hpp"

#include "support/directory.hpp"
#include "support/leaks.hpp"
#include "support/plant.hpp"

namespace {

using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;

struct Shared {
  using String = lot::ShmString;
  template <class T>
  using Vector = lot::ShmVector<T>;
};
struct Private {
  using String = std::string;
  template <class T>
  using Vector = std::vector<T>;
};

struct alignas(64) Wide {
  std::uint64_t number;
  friend bool operator==(const Wide& a, const Wide& b) { return a.number == b.number; }
};

template <class In>
struct Part {
  typename In::String name;
  typename In::template Vector<std::uint16_t> numbers;
  std::uint32_t mark = 5;
};

template <class In>
struct Document {
  typename In::String text;
  typename In::template Vector<std::uint32_t> numbers;
  typename In::template Vector<Wide> wides;
  typename In::template Vector<typename In::String> lines;
  typename In::template Vector<typename In::template Vector<std::uint8_t>> rows;
  typename In::template Vector<Part<In>> parts;
  std::array<typename In::String, 2> notes;
};

// ---- what is equal
// ----------------------------------------------------------------------------------

template <class T, class U>
bool same(const T& a, const U& b) {
  return a == b;
}
bool same(const lot::ShmString& a, const std::string& b) {
  return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin()) &&
         a.c_str()[a.size()] == '\0';
}
template <class T, class U>
bool same(const lot::ShmVector<T>& a, const std::vector<U>& b);
bool same(const Part<Shared>& a, const Part<Private>& b) {
  return same(a.name, b.name) && same(a.numbers, b.numbers) && a.mark == b.mark;
}
template <class T, class U>
bool same(const lot::ShmVector<T>& a, const std::vector<U>& b) {
  if (reinterpret_cast<std::uintptr_t>(a.data()) % alignof(T) != 0) return false;
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const T& one, const U& other) { return same(one, other); });
}
bool same(const Document<Shared>& a, const Document<Private>& b) {
  return same(a.text, b.text) && same(a.numbers, b.numbers) && same(a.wides, b.wides) &&
         same(a.lines, b.lines) && same(a.rows, b.rows) && same(a.parts, b.parts) &&
         same(a.notes[0], b.notes[0]) && same(a.notes[1], b.notes[1]);
}

// ---- the same, in private memory
// ----------------------------------------------------------------------

template <class T>
T private_copy(const T& plain) {
  return plain;
}
std::string private_copy(const lot::ShmString& s) { return {s.begin(), s.end()}; }
Part<Private> private_copy(const Part<Shared>& part);
template <class T>
auto private_copy(const lot::ShmVector<T>& v) {
  std::vector<decltype(private_copy(std::declval<const T&>()))> copy;
  for (const T& element : v) copy.push_back(private_copy(element));
  return copy;
}
Part<Private> private_copy(const Part<Shared>& part) {
  return {private_copy(part.name), private_copy(part.numbers), part.mark};
}
Document<Private> private_copy(const Document<Shared>& d) {
  return {private_copy(d.text),
          private_copy(d.numbers),
          private_copy(d.wides),
          private_copy(d.lines),
          private_copy(d.rows),
          private_copy(d.parts),
          {private_copy(d.notes[0]), private_copy(d.notes[1])}};
}

// ---- operations, alike for both
// -----------------------------------------------------------------------

/// How many elements: now and then so many that memory runs out.
template <class T>
std::size_t amount(Bytes& bytes) {
  const std::size_t n = bytes.byte();
  if (n < 200) return n % 20;
  if (!std::is_trivially_copyable_v<T>) return n;
  return n < 253 ? n * 16 : (n - 252) * 100000;
}

template <class T>
concept String = requires(T s) {
  s.c_str();
};
template <class T>
concept Vector = requires(T v) {
  v.emplace_back();
};

/// Makes an element of a vector anew.
template <std::integral Number>
void set(Number& number, Bytes& bytes) {
  number = static_cast<Number>(bytes.number<std::uint16_t>());
}
void set(Wide& wide, Bytes& bytes) { wide.number = bytes.byte(); }
void set(String auto& s, Bytes& bytes) { s = bytes.text(40); }
void set(Vector auto& v, Bytes& bytes) {
  v.resize(bytes.below(6), {});
  for (auto& element : v) set(element, bytes);
}
template <class In>
void set(Part<In>& part, Bytes& bytes) {
  set(part.name, bytes);
  set(part.numbers, bytes);
  part.mark = bytes.byte();
}

/// Changes a string. `strong` says whether it must be unchanged when memory runs out.
void change(String auto& s, Bytes& bytes, bool& strong) {
  const unsigned operation = bytes.byte() % 14;
  const std::size_t at = bytes.below(s.size() + 1);
  const auto letter = static_cast<char>('a' + bytes.below(26));
  strong = true;
  switch (operation) {
    case 0:
      return s.push_back(letter);
    case 1:
      s.append(bytes.text(100));
      return;
    case 2:
      s.append(amount<char>(bytes), letter);
      return;
    case 3:
      s.insert(at, amount<char>(bytes), letter);
      return;
    case 4:
      s.erase(at, bytes.below(40));
      return;
    case 5:
      s.replace(at, bytes.below(40), bytes.text(60));
      return;
    case 6:
      return s.resize(amount<char>(bytes), letter);
    case 7:
      return s.reserve(amount<char>(bytes));
    case 8:
      return s.shrink_to_fit();
    case 9:
      return s.clear();
    case 10:
      s += s;
      return;
    case 11:
      s.insert(at, s, 0, bytes.below(40));
      return;
    case 12:
      s.assign(s, at, bytes.below(40));
      return;
    default:
      if (!s.empty()) s.pop_back();
  }
}

template <Vector V>
void change(V& v, Bytes& bytes, bool& strong) {
  const unsigned operation = bytes.byte() % 16;
  const auto at = static_cast<std::ptrdiff_t>(bytes.below(v.size() + 1));
  const auto to =
      at + static_cast<std::ptrdiff_t>(bytes.below(v.size() + 1 - static_cast<std::size_t>(at)));
  typename V::value_type element{};
  set(element, bytes);
  strong = operation < 5;
  switch (operation) {
    case 0:
      return v.push_back(element);
    case 1:
      return v.push_back(std::move(element));
    case 2:
      if (!v.empty()) v.push_back(v.front());
      return;
    case 3:
      return v.reserve(amount<typename V::value_type>(bytes));
    case 4:
      return v.shrink_to_fit();
    case 5:
      return v.resize(amount<typename V::value_type>(bytes), element);
    case 6:
      v.insert(v.begin() + at, element);
      return;
    case 7:
      v.insert(v.begin() + at, amount<typename V::value_type>(bytes), element);
      return;
    case 8:
      if (!v.empty()) v.insert(v.begin() + at, v.back());
      return;
    case 9:
      v.erase(v.begin() + at, v.begin() + to);
      return;
    case 10:
      return v.assign(amount<typename V::value_type>(bytes), element);
    case 11:
      v = {element, element};
      return;
    case 12:
      v = V(v.begin() + at, v.begin() + to);
      return;
    case 13:
      v.clear();
      return;
    case 14:
      if (!v.empty()) std::rotate(v.begin(), v.begin() + at, v.end());
      return;
    default:
      if (!v.empty()) v.pop_back();
  }
}

/// Changes an element of a vector, or the vector itself when it has none.
void change_inside(Vector auto& v, Bytes& bytes, bool& strong) {
  const std::size_t which = bytes.byte();
  if (v.empty()) {
    change(v, bytes, strong);
  } else {
    change(v[which % v.size()], bytes, strong);
  }
}

/// From another member, of this message or of another one.
template <class T>
void take(T& to, T& from, Bytes& bytes) {
  if (bytes.below(2) == 0) {
    to = from;
  } else {
    to = std::move(from);
    if (&to != &from) from.clear();  // what it holds then is nobody's business
  }
}

/// One operation on a document, perhaps with another one.
template <class In>
void operate(Document<In>& d, Document<In>& other, Bytes& bytes, bool& strong) {
  strong = false;
  switch (bytes.byte() % 20) {
    case 0:
    case 1:
      return change(d.text, bytes, strong);
    case 2:
    case 3:
      return change(d.numbers, bytes, strong);
    case 4:
      return change(d.wides, bytes, strong);
    case 5:
      return change(d.lines, bytes, strong);
    case 6:
      return change(d.rows, bytes, strong);
    case 7:
      return change(d.parts, bytes, strong);
    case 8:
      return change_inside(d.lines, bytes, strong);
    case 9:
      return change_inside(d.rows, bytes, strong);
    case 10: {
      if (d.parts.empty()) return;
      bool each = false;  // of two changes the first stays when the second runs out of memory
      change(d.parts.back().name, bytes, each);
      change(d.parts.front().numbers, bytes, each);
      return;
    }
    case 11:
      return change(d.notes[bytes.below(2)], bytes, strong);
    case 12:
      return take(d.text, bytes.below(2) == 0 ? other.text : d.notes[1], bytes);
    case 13:
      return take(d.numbers, other.numbers, bytes);
    case 14:
      return take(d.lines, other.lines, bytes);
    case 15:
      return take(d.rows, other.rows, bytes);
    case 16:
      return take(d.parts, other.parts, bytes);
    case 17:
      if (d.lines.size() > 1) d.lines.front().swap(d.lines.back());
      if (d.rows.size() > 1) d.rows.front().swap(d.rows.back());
      return;
    case 18:
      if (!d.lines.empty() && !other.parts.empty())
        take(d.lines.back(), other.parts.front().name, bytes);
      return;
    default:
      if (&d != &other) d = other;
  }
}

// ---- messages
// -------------------------------------------------------------------------------------------

/// A message, or a document in private memory that has the same type, and its model.
struct Pair {
  lot::ShmUniquePtr<Document<Shared>> message{};
  Document<Shared> in_private_memory{};
  Document<Private> model{};
  Document<Shared>& real() { return message ? *message : in_private_memory; }
};

class Fuzz {
 public:
  Fuzz(lot::ShmEngine& engine, lot::transport::Participant& participant, Bytes bytes)
      : participant_(participant),
        bytes_(bytes),
        pusher_(engine.advertise<Document<Shared>>("/documents")),
        puller_(engine.subscribe<Document<Shared>>("/documents")) {
    for (std::size_t i = 0; i + 1 < pairs_.size(); ++i) renew(pairs_[i]);
  }

  void run() {
    while (bytes_.left() != 0) {
      const unsigned operation = bytes_.byte();
      Pair& pair = pairs_[operation % 4];
      switch (operation / 4 % 16) {
        case 14:
          if (pair.message) renew(pair);
          break;
        case 15:
          if (pair.message) publish(pair);
          break;
        default:
          change_both(pair, pairs_[operation / 4 % 4]);
      }
      spoil(pair);
      for (Pair& p : pairs_) require(same(p.real(), p.model), "a message, after an operation");
    }
  }

 private:
  void renew(Pair& pair) {
    pair = Pair();
    pair.message = pusher_.try_loan();
  }

  void publish(Pair& pair) {
    require(pusher_.push(std::move(pair.message)) == lot::Status::Ok, "a push");
    const auto seen = puller_.try_pull();
    require(seen && same(*seen, pair.model), "a message, when it is read");
    const Document<Shared> copy = *seen;  // an ordinary private one
    require(same(copy, pair.model), "a copy of a message");
    renew(pair);
  }

  void change_both(Pair& pair, Pair& other) {
    Bytes again = bytes_;
    bool strong = false;
    try {
      operate(pair.real(), other.real(), bytes_, strong);
    } catch (const lot::OutOfMemory&) {
      if (strong) return;  // run() sees whether it is as it was
      pair.model = private_copy(pair.real());
      other.model = private_copy(other.real());
      return;
    }
    operate(pair.model, other.model, again, strong);
    require(bytes_.left() == again.left(), "which bytes were read");
  }

  /// Makes one of the mistakes that must be found.
  void spoil(Pair& pair) {
    auto& d = pair.real();
    if (++steps_ % 8 != 0 || d.text.size() + d.numbers.size() == 0) return;
    if (planted("changed_letter") && !d.text.empty()) ++d.text[0];
    if (planted("changed_number") && !d.numbers.empty()) ++d.numbers[0];
    if (planted("lost_line") && !d.lines.empty()) d.lines.pop_back();
    if (planted("leaked_granule")) participant_.segment().claim_run(1, 1);
  }

  lot::transport::Participant& participant_;
  Bytes bytes_;
  unsigned steps_ = 0;
  lot::ShmPusher<Document<Shared>> pusher_;
  lot::ShmPuller<Document<Shared>> puller_;
  std::array<Pair, 4> pairs_;  ///< the last one stays in private memory
};

/// A segment with little memory.
lot::EngineOptions options() {
  static const auto* const directory = new lot::fuzz::Directory;
  lot::EngineOptions options;
  options.directory = directory->path();
  options.size_bytes = 6 << 20;
  options.processes = 2;
  options.blocks = 64;
  options.topics = 1;
  options.channels = 4;
  options.readers = 2;
  return options;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static auto* const engine = new lot::ShmEngine(options());
  static auto* const participant = new auto(lot::detail::join(options()));
  Fuzz(*engine, **participant, Bytes(data, size)).run();
  lot::fuzz::require_nothing_left(std::array{participant->get()});
  return 0;
}
