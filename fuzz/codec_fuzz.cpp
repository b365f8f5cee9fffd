// SPDX-License-Identifier: Apache-2.0

// The codec: any bytes become a message or an error, of types of this file and of any description.
// What a message has become is encoded, decoded and compared; then bytes of the message change, as
// another process could do it, and it is encoded once more.
//
// Input: which type; how many changes, and place and value of each; of a described type the most
// bytes that its description may have, 2, how many it has, and these; then the bytes of CDR
// (corpus/codec/ has examples)

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lot/describe.hpp"
#include "lot/fuzz.hpp"

#include "codec/carried.hpp"
#include "codec/decode.hpp"
#include "codec/encode.hpp"
#include "codec/random_types.hpp"
#include "codec/schema.hpp"
#include "description/wire.hpp"
#include "support/plant.hpp"

namespace {

using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;
using lot::testing::Cloud;
using lot::testing::Flags;
using lot::testing::Heap;
using lot::testing::Plain;

enum class Mode : std::int16_t { Idle };
struct Part {
  lot::ShmString name;
  bool is_there;
  std::array<lot::ShmString, 2> notes;
};
struct Nested {
  struct Empty {
  } empty;
  Flags flags;
  std::uint16_t grid[2][3];
  lot::ShmVector<lot::ShmVector<std::uint8_t>> rows;
  lot::ShmVector<Part> parts;
  lot::ShmVector<Empty> empties;
  std::chrono::milliseconds span;
  Mode mode;
};

constexpr std::size_t kHeap = 1 << 20;

/// One input.
class Fuzz {
 public:
  explicit Fuzz(Bytes bytes) : bytes_(bytes) {}

  void run() {
    static const std::array kTypes{&lot::describe<Plain>(), &lot::describe<Cloud>(),
                                   &lot::describe<Nested>()};
    const std::size_t which = bytes_.below(kTypes.size() + 1);
    changes_.resize(bytes_.below(8));
    for (auto& [place, value] : changes_) {
      place = bytes_.number<std::uint16_t>();
      value = bytes_.byte();
    }
    if (which < kTypes.size()) return with(*kTypes[which], true);
    const std::string text(bytes_.text(bytes_.number<std::uint16_t>()));
    const std::optional<lot::Description> described = lot::description::decode(text);
    if (described && described->root().size <= kHeap / 4) with(*described, false);
  }

 private:
  /// `is_ours`: a compiler has laid the type out.
  void with(const lot::Description& type, bool is_ours) {
    try {
      const lot::codec::Program program(type);
      require(!lot::codec::schema_of(type).idl.empty(), "a type that is compiled has a schema");
      turn(program, type, is_ours);
    } catch (const lot::Error&) {
      // it says what is wrong, and all that may be
    } catch (const lot::OutOfMemory&) {
      require(!is_ours, "the memory that a message takes");
    }
  }

  void turn(const lot::codec::Program& program, const lot::Description& type, bool is_ours) {
    std::string input(bytes_.left(), '\0');
    for (char& c : input) c = static_cast<char>(bytes_.byte());
    input.shrink_to_fit();  // AddressSanitizer sees its end
    heap().clear();
    const lot::MutableValue message = heap().make(type);
    const std::size_t before = heap().used();
    try {
      lot::codec::decode(program, lot::testing::bytes_of(input), message);
    } catch (const lot::Error&) {
      require(!is_ours || taken(before) <= most(input), "the memory that a refused message takes");
      return;
    }
    if (is_ours) {
      require(taken(before) <= most(input), "the memory that a message takes");
      compare(program, type, message);
    }
    damage(program, message);
  }

  static Heap& heap() {
    static auto* const heap = new Heap(kHeap);
    return *heap;
  }
  static std::size_t taken(std::size_t before) {
    return heap().used() - before + (planted("huge_allocation") ? kHeap : 0);
  }
  /// A Part takes 136 bytes, and 13 of CDR at least; each piece may begin up to 63 bytes later.
  static std::size_t most(const std::string& input) { return 64 * input.size() + 4096; }

  static void compare(const lot::codec::Program& program, const lot::Description& type,
                      const lot::MutableValue& message) {
    std::string bytes = encoded(program, message);
    const std::string good = bytes;
    if (planted("changed_byte")) bytes.back() = static_cast<char>(bytes.back() ^ 1);
    if (planted("lost_byte")) bytes.pop_back();
    const lot::MutableValue other = heap().make(type);
    try {
      lot::codec::decode(program, lot::testing::bytes_of(bytes), other);
    } catch (const lot::Error&) {
      require(false, "what is encoded can be decoded");
    }
    require(lot::testing::list_of_values(other) == lot::testing::list_of_values(message),
            "the values of a message");
    require(encoded(program, other) == good, "the bytes of a message");
  }

  static std::string encoded(const lot::codec::Program& program, const lot::Value& message) {
    lot::codec::Encoded parts(16, kHeap);
    encode(program, message, parts);
    lot::codec::Encoded whole(lot::codec::Encoded::kCopyAll, kHeap);
    encode(program, message, whole);
    const std::string bytes = lot::testing::joined(parts.pieces());
    require(bytes == lot::testing::joined(whole.pieces()), "pieces are all the bytes");
    require(bytes.size() == parts.size(), "the size of a message");
    return bytes;
  }

  /// Any error will do, and any bytes.
  void damage(const lot::codec::Program& program, const lot::MutableValue& message) {
    auto* const begin = static_cast<unsigned char*>(const_cast<void*>(message.value().address()));
    for (const auto& [place, value] : changes_) begin[place % heap().used()] = value;
    lot::codec::Encoded bytes(16, kHeap);
    encode(program, message, bytes);
  }

  Bytes bytes_;
  std::vector<std::pair<std::uint16_t, std::uint8_t>> changes_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Fuzz(Bytes(data, size)).run();
  return 0;
}
