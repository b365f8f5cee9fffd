// SPDX-License-Identifier: Apache-2.0
#include <lot/fuzz.hpp>

struct Track {
  std::uint32_t id;
  lot::ShmString name;
  lot::ShmVector<float> points;
};

/// A message out of the fuzzer's bytes: the same for the same bytes.
void fill(Track& track, lot::fuzz::Bytes& bytes) {
  track.id = bytes.number<std::uint32_t>();
  track.name = bytes.text(40);
  track.points.resize(bytes.below(1000));
  for (float& point : track.points) point = bytes.byte();
}

/// All that is in it.
std::string print(const Track& track) {
  std::string text = std::to_string(track.id) + ":";
  text.append(track.name);
  for (const float point : track.points) text.append(" ").append(std::to_string(point));
  return text;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return lot::fuzz::queue<Track>(data, size, fill, print);
}
