// SPDX-License-Identifier: Apache-2.0
#include "slot_copy.hpp"

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string_view>
#include <thread>

#include "segment/segment.hpp"

namespace lot::chaos {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kWords = sizeof(Plain) / sizeof(ring::Word);

/// The slot of the oldest message, or nothing.
std::optional<std::uint32_t> oldest_slot(const segment::Ring& ring) {
  std::optional<std::uint32_t> oldest;
  ring::Word first = 0;
  for (std::uint32_t i = 0; i < ring.places(); ++i) {
    const ring::Word word = ring.slots[i].load();
    if (ring::block(word) != ring::kInSlot) continue;
    if (oldest && ring::distance(ring::sequence(word), first) >= 0) continue;
    oldest = i;
    first = ring::sequence(word);
  }
  return oldest;
}

}  // namespace

std::optional<Plain> copy_of_a_slot(const std::string& segment_path, const char* topic) {
  segment::Segment s(segment_path);
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    const auto& entry = s.channels()[c];
    if (ring::writer_state(entry.writer.load()) != ring::State::Live || entry.formed.load() == 0 ||
        std::string_view(s.topics()[entry.topic].name) != topic) {
      continue;
    }
    const segment::Ring ring = s.ring(c);
    if (!ring.in_slots() || ring.slots.stride() < sizeof(Plain)) continue;
    const auto i = oldest_slot(ring);
    if (!i) continue;
    const ring::Word sequence = ring::sequence(ring.slots[*i].load());
    Plain halves[2];
    for (Plain& half : halves) {
      ring.slots.read(*i, sequence, ring.places(), &half, kWords, nullptr);
      std::this_thread::sleep_for(5ms);
    }
    constexpr std::size_t kHalf = kWords / 2 * sizeof(ring::Word);
    std::memcpy(&halves[1], &halves[0], kHalf);
    return halves[1];
  }
  return std::nullopt;
}

}  // namespace lot::chaos
