// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include <lot/lot.hpp>

namespace demo {

using Clock = std::chrono::steady_clock;  // one clock for all processes of a machine

/// What goes before the picture, the same through the ring and through TCP.
struct Head {
  std::uint32_t run;      ///< which life of the camera
  std::uint32_t number;   ///< from 0, without gaps
  std::uint64_t last;     ///< 1: no more will come in this run
  std::int64_t stamp_ns;  ///< right before the push, or before the first send
};

struct Frame {
  Head head;
  lot::ShmVector<std::uint8_t> data;
};

inline std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
      .count();
}

inline Head make_head(std::uint32_t run, std::uint32_t number, bool last) {
  return {run, number, last ? 1U : 0U, 0};
}

/// The picture: every byte says which frame it belongs to.
inline void draw(std::uint8_t* picture, std::size_t bytes, std::uint32_t number) {
  std::memset(picture, static_cast<int>(number & 0xff), bytes);
}

/// Looks at 256 places that are spread over the picture.
inline bool looks_right(const std::uint8_t* picture, std::size_t bytes, std::uint32_t number) {
  const std::size_t step = bytes / 256 + 1;
  std::uint64_t sum = 0;
  std::uint64_t places = 0;
  for (std::size_t i = 0; i < bytes; i += step, ++places) sum += picture[i];
  return bytes != 0 && sum == places * (number & 0xff) && picture[bytes - 1] == (number & 0xff);
}

/// The hash that `ffmpeg -f framehash -hash adler32` prints.
inline std::uint32_t adler32(const std::uint8_t* bytes, std::size_t n) {
  constexpr std::uint32_t kModulus = 65521;
  constexpr std::size_t kBeforeOverflow = 5552;
  std::uint32_t a = 1;
  std::uint32_t b = 0;
  while (n > 0) {
    const std::size_t run = n < kBeforeOverflow ? n : kBeforeOverflow;
    for (std::size_t i = 0; i < run; ++i) b += a += bytes[i];
    a %= kModulus;
    b %= kModulus;
    bytes += run;
    n -= run;
  }
  return b << 16 | a;
}

}  // namespace demo
