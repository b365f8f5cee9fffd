// SPDX-License-Identifier: Apache-2.0

// The public interface, by lot/fuzz.hpp: two participants, publishers of each policy, borrow, keep,
// forward, weak pointers; with a plain small message, a plain large one, and one that has memory of
// its own and refers to others. After each run nothing may be left in the segment.
//
// Input: type | operations as in lot/fuzz.hpp; corpus/queue/ has examples

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <set>
#include <string>
#include <utility>

#include "lot/fuzz.hpp"

#include "support/leaks.hpp"
#include "support/plant.hpp"
#include "support/raw.hpp"

namespace {

using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::transport::Participant;

struct Small {
  std::uint64_t a;
  std::uint32_t b;
};
struct Large {
  std::array<std::uint8_t, 9000> bytes;
};
struct Document {
  lot::ShmString title;
  lot::ShmVector<lot::ShmString> lines;
  lot::ShmVector<std::uint32_t> numbers;
  lot::ShmRef<const Document> earlier;
};

/// Whose segments the messages of this run lie in.
std::set<Participant*> participants;

/// Does one of the mistakes that the model must find, in the message that was filled before this
/// one.
void spoil(const void* message) {
  static unsigned filled = 0;
  static const void* before = nullptr;
  Participant* p = Participant::at(message);
  if (p == nullptr) return;
  participants.insert(p);
  if (++filled % 4 == 0 && before != nullptr) {
    if (planted("changed_message")) {
      auto* bytes = const_cast<unsigned char*>(static_cast<const unsigned char*>(before));
      bytes[0] = static_cast<unsigned char>(bytes[0] ^ 1);
    }
    for (std::uint32_t c = 0; c < p->world().channels(); ++c) {
      const lot::segment::Ring ring = p->world().ring(c);
      for (std::uint32_t i = 0; i < ring.depth; ++i) {
        if (planted("lost_message")) ring.slots[i].fetch_or(lot::ring::kNoBlock);
      }
    }
    for (auto& block : p->segment().blocks()) {
      if (planted("lost_hold")) lot::test::raw(block.own[0]) = 0;
      if (planted("leaked_hold") && block.home.load() != 0) lot::test::raw(block.own[4]) = 1;
    }
  }
  before = message;
}

void fill(Small& small, Bytes& bytes) {
  spoil(&small);
  small.a = bytes.number<std::uint16_t>();
  small.b = bytes.byte();
}
std::string print(const Small& small) {
  return std::to_string(small.a) + " " + std::to_string(small.b);
}

void fill(Large& large, Bytes& bytes) {
  spoil(&large);
  large.bytes.fill(bytes.byte());
  large.bytes[bytes.below(9000)] = bytes.byte();
}
std::string print(const Large& large) {
  return std::string(large.bytes.begin(), large.bytes.end());
}

void fill(Document& document, Bytes& bytes, const lot::ShmSharedPtr<const Document>& seen) {
  spoil(&document);
  document.title = bytes.text(60);
  document.lines.resize(bytes.below(5));
  for (auto& line : document.lines) line = bytes.text(30);
  const bool many = bytes.byte() == 0xff;
  document.numbers.resize(bytes.below(many ? 20000 : 100));
  std::fill(document.numbers.begin(), document.numbers.end(), bytes.byte());
  // A chain of references would keep every message of the run.
  if (seen && !seen->earlier) document.earlier = seen;
}
std::string print(const Document& document) {
  std::string text(document.title);
  for (const auto& line : document.lines) text.append("|").append(line);
  for (const auto& number : document.numbers) text += static_cast<char>(number);
  text += std::to_string(document.numbers.size());
  if (!document.earlier) return text;
  return text + "<" + print(*document.earlier.lock()) + ">";
}

template <class T, class... Seen>
void run(const std::uint8_t* data, std::size_t size) {
  void (*const fill_it)(T&, Bytes&, Seen...) = &fill;
  std::string (*const print_it)(const T&) = &print;
  lot::fuzz::queue<T>(data, size, fill_it, print_it);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  participants.clear();
  switch (data[0] % 3) {
    case 0:
      run<Small>(data + 1, size - 1);
      break;
    case 1:
      run<Large>(data + 1, size - 1);
      break;
    case 2:
      run<Document, const lot::ShmSharedPtr<const Document>&>(data + 1, size - 1);
      break;
  }
  if (!participants.empty()) lot::fuzz::require_nothing_left(participants);
  return 0;
}
