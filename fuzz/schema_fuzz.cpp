// SPDX-License-Identifier: Apache-2.0

// What a recording says of its types: any text as a .msg, and any metadata of a channel. It becomes
// an error or a type; messages of the type are decoded from any bytes and encoded again.
//
// Input: what it is; of a .msg how long it is (2 bytes) and its text; of metadata its five values,
// each with its length in front (2 bytes); then the bytes of CDR. (corpus/schema/ has examples)

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "lot/any_message.hpp"
#include "lot/error.hpp"
#include "lot/fuzz.hpp"

#include "codec/carried.hpp"
#include "codec/decode.hpp"
#include "codec/encode.hpp"
#include "codec/random_types.hpp"
#include "codec/schema.hpp"
#include "record/schema_text.hpp"
#include "record/types.hpp"
#include "support/plant.hpp"

namespace {

using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;
using lot::testing::Heap;

constexpr std::size_t kHeap = 1 << 20;

bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// The kinds of a type's fields, without their names.
std::string kinds(const std::string& fields) {
  std::string all;
  std::string word;
  for (const char c : fields) {
    if (is_letter(c) || is_digit(c)) {
      word += c;
      continue;
    }
    if (c != ':') all += word;
    word.clear();
    if (c == '}' && all.ends_with('{')) all += "uint8,";  // ROS 2 has no struct without fields
    if (c != ':') all += c;
  }
  return all + word;
}

void require_names(const lot::Description& description) {
  for (const auto& type : description.types) {
    for (const auto& field : type.fields) {
      bool is_name = !field.name.empty() && is_letter(field.name.front());
      for (const char c : field.name) is_name = is_name && (is_letter(c) || is_digit(c));
      require(is_name, "a field's name is one");
    }
  }
}

/// One input.
class Fuzz {
 public:
  explicit Fuzz(Bytes bytes) : bytes_(bytes) {}

  void run() {
    try {
      if (bytes_.below(2) == 0) {
        with_text();
      } else {
        with_pairs();
      }
    } catch (const lot::Error&) {
      // it says what is wrong, and all that may be
    } catch (const lot::OutOfMemory&) {
      // messages of the type are larger than the heap
    }
  }

 private:
  std::string text() {
    const std::size_t length = bytes_.number<std::uint16_t>();
    std::string all(std::min(length, bytes_.left()), '\0');
    for (char& c : all) c = static_cast<char>(bytes_.byte());
    return all;
  }

  void with_text() {
    const std::string schema = text();
    require(lot::record::are_alike(schema, schema), "a text is like itself");
    const lot::AnyType type = lot::record::type_of_schema("p/msg/T", schema);
    require_names(type.description());
    const std::string fields = lot::record::read_schema("p/msg/T", schema).fields;
    const lot::codec::Program program(type.description());
    compare(fields, lot::codec::schema_of(type.description()).msg);
    const lot::AnyType again = lot::record::type_of(lot::record::pairs_of(type));
    require(again && again.is_same(type), "a type comes back from its metadata");
    turn(program, type.description());
  }

  /// What is recorded again has a schema of the codec's.
  static void compare(const std::string& fields, const std::string& schema) {
    std::string other;
    try {
      other = lot::record::read_schema("p/msg/T", schema).fields;
    } catch (const lot::Error&) {
      return;  // with longer names it is too large
    }
    if (planted("lost_field")) other.erase(0, other.find(',') + 1);
    if (planted("other_field")) other += "uint8,";
    require(kinds(other) == kinds(fields), "the codec's schema has the same fields");
  }

  void with_pairs() {
    const std::string schema = text();
    lot::mcap::Pairs pairs;
    for (const char* key :
         {"lot.type", "lot.size", "lot.align", "lot.identity", "lot.description"}) {
      const std::string value = text();
      if (value != "-") pairs[key] = value;
    }
    const lot::AnyType type = lot::record::type_of(pairs);
    if (!type) return;
    const lot::mcap::Pairs told = lot::record::pairs_of(type);
    lot::mcap::Pairs again = lot::record::pairs_of(lot::record::type_of(told));
    if (planted("changed_metadata")) again["lot.identity"] += "0";
    require(told == again, "metadata of a type that metadata has made");
    (void)lot::record::is_like(type, schema);
    turn(lot::codec::Program(type.description()), type.description());
  }

  /// Any error will do.
  void turn(const lot::codec::Program& program, const lot::Description& type) {
    if (type.root().size > kHeap / 4) return;
    std::string input(bytes_.left(), '\0');
    for (char& c : input) c = static_cast<char>(bytes_.byte());
    input.shrink_to_fit();  // AddressSanitizer sees its end
    heap().clear();
    const lot::MutableValue message = heap().make(type);
    lot::codec::decode(program, lot::testing::bytes_of(input), message);
    lot::codec::Encoded bytes(16, kHeap);
    encode(program, message, bytes);
    const std::string good = lot::testing::joined(bytes.pieces());
    std::string again = good;
    if (planted("changed_byte")) again.back() = static_cast<char>(again.back() ^ 1);
    const lot::MutableValue other = heap().make(type);
    lot::codec::decode(program, lot::testing::bytes_of(again), other);
    encode(program, other, bytes);
    require(lot::testing::joined(bytes.pieces()) == good, "the bytes of a message");
    require(lot::to_string(other).size() < 64 * kHeap, "the text of a message");
  }

  static Heap& heap() {
    static auto* const heap = new Heap(kHeap);
    return *heap;
  }

  Bytes bytes_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Fuzz(Bytes(data, size)).run();
  return 0;
}
