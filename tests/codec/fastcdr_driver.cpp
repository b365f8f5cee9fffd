// SPDX-License-Identifier: Apache-2.0

// Encodes messages by Fast CDR, from lists of their values, and compares the bytes with files.
// independent.py puts the types in that fastddsgen has made, and how each gets its values.

#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <type_traits>
#include <vector>

#include <fastcdr/Cdr.h>

// TYPES

namespace {

using Values = std::ifstream;

std::uint64_t next(Values& values) {
  std::string line;
  std::getline(values, line);
  return line[0] == '-' ? static_cast<std::uint64_t>(std::stoll(line)) : std::stoull(line);
}

// DECLARED

template <class T, class = std::enable_if_t<std::is_arithmetic_v<T>>>
void get(Values& values, T& number) {
  const std::uint64_t bits = next(values);
  if constexpr (std::is_floating_point_v<T>) {
    std::memcpy(&number, &bits, sizeof number);
  } else {
    number = static_cast<T>(bits);
  }
}
[[maybe_unused]] void get(Values& values, std::string& text) {
  text.resize(next(values));
  for (char& c : text) c = static_cast<char>(next(values));
}
[[maybe_unused]] void get(Values& values, std::vector<bool>& bools) {
  bools.resize(next(values));
  for (std::size_t i = 0; i < bools.size(); ++i) bools[i] = next(values) != 0;
}
template <class T>
void get(Values& values, std::vector<T>& items);
template <class T, std::size_t N>
void get(Values& values, std::array<T, N>& items) {
  for (T& item : items) get(values, item);
}
template <class T>
void get(Values& values, std::vector<T>& items) {
  items.resize(next(values));
  for (T& item : items) get(values, item);
}

// BODIES

/// Whether Fast CDR makes the same bytes of the same values.
template <class T>
bool compare(unsigned number) {
  const std::string name = std::to_string(number);
  std::ifstream values(name + ".values");
  T message;
  get(values, message);
  std::ifstream file(name + ".cdr", std::ios::binary);
  const std::string ours{std::istreambuf_iterator<char>(file), {}};
  std::string theirs(ours.size() + 4096, '\0');  // it leaves what lies between numbers as it is
  eprosima::fastcdr::FastBuffer buffer(theirs.data(), theirs.size());
  eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::LITTLE_ENDIANNESS,
                             eprosima::fastcdr::Cdr::DDS_CDR);
  cdr.serialize_encapsulation();
  message.serialize(cdr);
  theirs.resize(cdr.getSerializedDataLength());
  if (theirs == ours) return true;
  std::printf("type %u: %zu bytes of ours, %zu of Fast CDR's\n", number, ours.size(),
              theirs.size());
  return false;
}

}  // namespace

int main() {
  bool good = true;
  // CALLS
  return good ? 0 : 1;
}
