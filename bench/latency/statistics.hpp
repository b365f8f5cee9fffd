// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

/// What can be said of numbers that were measured, and how surely.
///
/// A quantile is a value that was measured: the smallest one that at least q of all values do not
/// exceed. Everything is in microseconds, and deterministic: where chance is needed, by a seed.
namespace ab {

/// `sorted` ascending and not empty; 0 <= q <= 1.
double quantile(std::span<const double> sorted, double q);

struct Summary {
  std::size_t count = 0;  ///< 0: the others mean nothing
  double min = 0, p1 = 0, p25 = 0, median = 0, p75 = 0, p99 = 0, max = 0;
  std::optional<double> p999;  ///< from 20,000 values on
};
Summary summarise(std::vector<double> values);

/// Values by the block that they were measured in, in the order in which the blocks were run. The
/// k-th block of one arm and the k-th of another one of the same cell are neighbours in time.
using Blocks = std::vector<std::vector<double>>;
Summary summarise(const Blocks&);

/// A ratio with its 95 % interval; `known` false: fewer than kFewestBlocks on one side.
struct Ratio {
  double ratio = 0;
  double low = 0;
  double high = 0;
  bool known = false;
};
inline constexpr std::size_t kFewestBlocks = 4;
inline constexpr std::uint64_t kSeed = 20210923;  ///< fixed: the same numbers, the same intervals

/// Quantile q of `a` over that of `b`. The interval is a bootstrap of whole blocks: neighbours (the
/// k-th of each) are drawn together, so that a slow phase of the machine that held for both cancels
/// out. Nothing if one side is empty or the quantile of b is 0.
std::optional<Ratio> ratio_of_quantiles(const Blocks& a, const Blocks& b, double q,
                                        std::uint64_t seed = kSeed);

/// The same of two runs, each with its floor: (b / a) and (b / floor of b) / (a / floor of a).
/// Neighbours are those within a run; the runs are drawn independently.
struct Change {
  Ratio raw;
  Ratio floor;     ///< of the floor's medians
  Ratio relative;  ///< the raw one over the floor's
};
std::optional<Change> change_of_quantiles(const Blocks& a, const Blocks& floor_a, const Blocks& b,
                                          const Blocks& floor_b, double q,
                                          std::uint64_t seed = kSeed);

/// Mann and Whitney's rank test, by the normal approximation with ties and a continuity correction.
/// Values must not depend on each other: not messages of one block.
struct RankTest {
  double u = 0;        ///< pairs in which a's value is greater; ties count a half
  double z = 0;        ///< positive: a is greater
  double p_value = 1;  ///< two-sided
};
RankTest rank_test(std::vector<double> a, std::vector<double> b);

/// The rank test's p of the medians of blocks. Nothing if one side has fewer than kFewestBlocks.
std::optional<double> p_of_block_medians(const Blocks& a, const Blocks& b);

}  // namespace ab
