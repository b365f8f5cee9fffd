// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "mcap/reader.hpp"
#include "mcap/writer.hpp"
#include "support/scratch.hpp"

/// What the tests of recordings share: messages that follow from a number.
namespace lot::testing {

inline mcap::View view(std::string_view text) { return std::as_bytes(std::span(text)); }

/// Bytes of a given number, half of them alike, that follow from `seed`.
inline std::string payload(std::uint64_t seed, std::size_t size) {
  std::string bytes(size, static_cast<char>('a' + seed % 26));
  std::uint64_t state = seed * 2654435761u + 1;
  for (std::size_t i = 0; i < size; ++i) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    if ((i >> 6) % 2 == 0) bytes[i] = static_cast<char>(state >> 56);
  }
  return bytes;
}

inline void put(mcap::Writer& writer, const mcap::MessageHead& head, std::string_view bytes) {
  const mcap::View piece = view(bytes);
  writer.write(head, std::span(&piece, 1));
}

/// A message in one line.
inline std::string line(const mcap::Message& message) {
  const mcap::MessageHead& h = message.head;
  return std::to_string(h.channel) + " " + std::to_string(h.sequence) + " " +
         std::to_string(h.log_time) + " " + std::to_string(h.publish_time) + " " +
         text(message.payload);
}

/// All that a Stream, or the messages of a Reader, still gives.
template <class Source>
std::vector<std::string> lines(Source&& source) {
  std::vector<std::string> all;
  while (const auto message = source.next()) all.push_back(line(*message));
  return all;
}

}  // namespace lot::testing
