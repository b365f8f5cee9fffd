// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>

#include "lot/detail/arena.hpp"

#include "segment/layout.hpp"

namespace lot::transport {

constexpr std::uint64_t granules_in(std::uint64_t bytes) {
  return bytes / segment::kGranule + (bytes % segment::kGranule != 0);
}

/// The granules of an extent for a piece of that size. Sizes that differ little get the same
/// number, so that the next message fits. Beyond rounding up to granules, it is at most 1/16 more.
constexpr std::uint64_t fit(std::uint64_t bytes) {
  constexpr std::uint64_t kSmallRun = 16;
  const std::uint64_t granules = granules_in(bytes);
  if (granules < kSmallRun) return granules;
  const std::uint64_t step = std::bit_floor(granules) / 16;
  return (granules + step - 1) & ~(step - 1);
}

/// The extents of a message: their kinds and sizes. Shared extents come last, and within a kind the
/// large ones come first.
class Pieces {
 public:
  struct Piece {
    std::uint32_t granules;
    std::uint16_t kind;  ///< 0 or Arena::kShared
  };

  /// The extents of a message that is one piece.
  static Pieces one(std::uint64_t bytes) {
    Pieces p;
    p.add({static_cast<std::uint32_t>(fit(bytes)), 0});
    return p;
  }
  /// The extents of a message that is being built: those in which something lives, and the newest.
  static Pieces of(const detail::Build& build, unsigned newest) {
    Pieces p;
    for (unsigned i = 0; i < build.extents; ++i) {
      const detail::Build::Extent& e = build.extent[i];
      if ((e.living != 0 || i == newest) && !e.is_reserved()) p.add({e.granules, e.kind});
    }
    return p;
  }

  const Piece* begin() const noexcept { return pieces_.data(); }
  const Piece* end() const noexcept { return pieces_.data() + count_; }
  std::uint64_t granules() const noexcept {
    std::uint64_t sum = 0;
    for (const Piece& piece : *this) sum += piece.granules;
    return sum;
  }

 private:
  void add(Piece piece) {
    const auto is_before = [](const Piece& a, const Piece& b) {
      return a.kind != b.kind ? a.kind < b.kind : a.granules > b.granules;
    };
    Piece* const last = pieces_.data() + count_++;
    Piece* const at = std::upper_bound(pieces_.data(), last, piece, is_before);
    std::move_backward(at, last, last + 1);
    *at = piece;
  }

  std::array<Piece, detail::Build::kMaxExtents> pieces_{};
  unsigned count_ = 0;
};

}  // namespace lot::transport
