// SPDX-License-Identifier: Apache-2.0
#include "statistics.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <random>
#include <utility>

namespace ab {
namespace {

constexpr std::size_t kFewestForP999 = 20000;
constexpr unsigned kDraws = 1000;

std::vector<double> flat(const Blocks& blocks) {
  std::vector<double> values;
  for (const auto& block : blocks) values.insert(values.end(), block.begin(), block.end());
  return values;
}

/// Finds the same quantile in many draws of an arm's blocks, each without sorting again.
class Drawable {
 public:
  explicit Drawable(const Blocks& blocks) : sizes_(blocks.size()) {
    for (std::size_t b = 0; b < blocks.size(); ++b) {
      sizes_[b] = blocks[b].size();
      for (const double value : blocks[b]) values_.push_back({value, b});
    }
    std::sort(values_.begin(), values_.end());
    step_ = std::max<std::size_t>(256, blocks.size());
    std::vector<std::size_t> before(blocks.size());
    for (std::size_t i = 0; i < values_.size(); ++i) {
      if (i % step_ == 0) marks_.push_back(before);
      ++before[values_[i].second];
    }
  }
  std::size_t blocks() const { return sizes_.size(); }
  bool empty() const { return values_.empty(); }
  double quantile(double q) const { return quantile(q, std::vector<unsigned>(blocks(), 1)); }
  /// Of the values that come `times[block]` times each.
  double quantile(double q, std::span<const unsigned> times) const {
    std::size_t all = 0;
    for (std::size_t b = 0; b < blocks(); ++b) all += times[b] * sizes_[b];
    if (all == 0) return 0;  // only empty blocks were drawn
    const auto rank = rank_of(q, all);
    const auto drawn_before = [&](const std::vector<std::size_t>& mark) {
      return std::inner_product(mark.begin(), mark.end(), times.begin(), std::size_t{0});
    };
    // The last mark that the value does not lie before; the first one has nothing before it.
    const auto mark = std::prev(std::partition_point(
        marks_.begin(), marks_.end(), [&](const auto& one) { return drawn_before(one) <= rank; }));
    std::size_t seen = drawn_before(*mark);
    for (auto i = static_cast<std::size_t>(mark - marks_.begin()) * step_; i < values_.size();
         ++i) {
      seen += times[values_[i].second];
      if (seen > rank) return values_[i].first;
    }
    return values_.back().first;
  }
  static std::size_t rank_of(double q, std::size_t count) {
    // What rounding adds to q * count must not become a whole value.
    const double at = std::ceil(q * static_cast<double>(count) - 1e-9);
    return at < 1 ? 0 : std::min(count, static_cast<std::size_t>(at)) - 1;
  }

 private:
  std::vector<std::pair<double, std::size_t>> values_;
  std::vector<std::size_t> sizes_;
  // Of each step_-th value: how many of each block lie before it.
  std::vector<std::vector<std::size_t>> marks_;
  std::size_t step_ = 0;
};

/// Draws whole blocks with replacement, the same ones for all arms of a run.
class Draw {
 public:
  explicit Draw(std::uint64_t seed) : random_(seed) {}
  const std::vector<unsigned>& next(std::size_t blocks) {
    times_.assign(blocks, 0);
    // Not std::uniform_int_distribution: it differs between standard libraries.
    for (std::size_t i = 0; i < blocks; ++i) ++times_[random_() % blocks];
    return times_;
  }

 private:
  std::mt19937_64 random_;
  std::vector<unsigned> times_;
};

struct Drawn {  // ratios of all draws; those that are none are beyond every bound
  std::vector<double> ratios;
  void add(double above, double below) {
    if (below > 0) ratios.push_back(above / below);
  }
  Ratio interval(double ratio) {
    const std::size_t unbounded = kDraws - ratios.size();
    Ratio result{ratio, ratio, ratio, unbounded < kDraws / 40};  // else a bound is unknown
    if (!result.known) return result;
    std::sort(ratios.begin(), ratios.end());
    result.low = quantile(ratios, 0.025);
    result.high = quantile(ratios, 0.975);
    return result;
  }
};

Blocks first(const Blocks& blocks, std::size_t count) {
  return {blocks.begin(), blocks.begin() + static_cast<std::ptrdiff_t>(count)};
}

}  // namespace

double quantile(std::span<const double> sorted, double q) {
  return sorted[Drawable::rank_of(q, sorted.size())];
}

Summary summarise(std::vector<double> values) {
  Summary result;
  result.count = values.size();
  if (values.empty()) return result;
  std::sort(values.begin(), values.end());
  result.min = values.front();
  result.p1 = quantile(values, 0.01);
  result.p25 = quantile(values, 0.25);
  result.median = quantile(values, 0.5);
  result.p75 = quantile(values, 0.75);
  result.p99 = quantile(values, 0.99);
  result.max = values.back();
  if (values.size() >= kFewestForP999) result.p999 = quantile(values, 0.999);
  return result;
}

Summary summarise(const Blocks& blocks) { return summarise(flat(blocks)); }

std::optional<Ratio> ratio_of_quantiles(const Blocks& a, const Blocks& b, double q,
                                        std::uint64_t seed) {
  const Drawable above(a);
  const Drawable below(b);
  if (above.empty() || below.empty() || below.quantile(q) <= 0) return std::nullopt;
  const double ratio = above.quantile(q) / below.quantile(q);
  const std::size_t pairs = std::min(a.size(), b.size());
  if (pairs < kFewestBlocks) return Ratio{ratio, ratio, ratio, false};
  const Drawable paired_above(first(a, pairs));
  const Drawable paired_below(first(b, pairs));
  Draw draw(seed);
  Drawn drawn;
  for (unsigned i = 0; i < kDraws; ++i) {
    const auto& times = draw.next(pairs);
    drawn.add(paired_above.quantile(q, times), paired_below.quantile(q, times));
  }
  return drawn.interval(ratio);
}

std::optional<Change> change_of_quantiles(const Blocks& a, const Blocks& floor_a, const Blocks& b,
                                          const Blocks& floor_b, double q, std::uint64_t seed) {
  const Drawable all[] = {Drawable(a), Drawable(floor_a), Drawable(b), Drawable(floor_b)};
  for (const Drawable& one : all) {
    if (one.empty() || one.quantile(0.5) <= 0 || one.quantile(q) <= 0) return std::nullopt;
  }
  const double raw = all[2].quantile(q) / all[0].quantile(q);
  const double floor = all[3].quantile(0.5) / all[1].quantile(0.5);
  Change change{{raw, raw, raw, false},
                {floor, floor, floor, false},
                {raw / floor, raw / floor, raw / floor, false}};
  const std::size_t pairs_a = std::min(a.size(), floor_a.size());
  const std::size_t pairs_b = std::min(b.size(), floor_b.size());
  if (std::min(pairs_a, pairs_b) < kFewestBlocks) return change;
  const Drawable paired[] = {Drawable(first(a, pairs_a)), Drawable(first(floor_a, pairs_a)),
                             Drawable(first(b, pairs_b)), Drawable(first(floor_b, pairs_b))};
  Draw draw(seed);
  Drawn raws;
  Drawn floors;
  Drawn relatives;
  for (unsigned i = 0; i < kDraws; ++i) {
    const auto& times_a = draw.next(pairs_a);
    const double value_a = paired[0].quantile(q, times_a);
    const double below_a = paired[1].quantile(0.5, times_a);
    const auto& times_b = draw.next(pairs_b);
    const double value_b = paired[2].quantile(q, times_b);
    const double below_b = paired[3].quantile(0.5, times_b);
    raws.add(value_b, value_a);
    floors.add(below_b, below_a);
    relatives.add(value_b * below_a, value_a * below_b);
  }
  change.raw = raws.interval(raw);
  change.floor = floors.interval(floor);
  change.relative = relatives.interval(raw / floor);
  return change;
}

RankTest rank_test(std::vector<double> a, std::vector<double> b) {
  if (a.empty() || b.empty()) return {};
  std::sort(a.begin(), a.end());
  std::sort(b.begin(), b.end());
  const auto n = static_cast<double>(a.size());
  const auto m = static_cast<double>(b.size());
  double u = 0;
  double ties = 0;  // sum of t^3 - t over groups of equal values
  for (std::size_t i = 0, j = 0; i < a.size() || j < b.size();) {
    const double value = j == b.size() || (i < a.size() && a[i] <= b[j]) ? a[i] : b[j];
    const std::size_t below = j;
    std::size_t of_a = 0;
    std::size_t of_b = 0;
    while (i < a.size() && a[i] <= value) ++i, ++of_a;
    while (j < b.size() && b[j] <= value) ++j, ++of_b;
    u += static_cast<double>(of_a) * (static_cast<double>(below) + static_cast<double>(of_b) / 2);
    const auto t = static_cast<double>(of_a + of_b);
    ties += t * t * t - t;
  }
  RankTest result;
  result.u = u;
  const double off = u - n * m / 2;
  const double variance = n * m / 12 * ((n + m + 1) - ties / ((n + m) * (n + m - 1)));
  if (variance <= 0) return result;  // all values are equal
  const double corrected = std::max(0.0, std::abs(off) - 0.5);
  result.z = std::copysign(corrected / std::sqrt(variance), off);
  result.p_value = std::erfc(std::abs(result.z) / std::sqrt(2.0));
  return result;
}

std::optional<double> p_of_block_medians(const Blocks& a, const Blocks& b) {
  const auto medians = [](const Blocks& blocks) {
    std::vector<double> values;
    for (std::vector<double> block : blocks) {
      if (block.empty()) continue;
      std::sort(block.begin(), block.end());
      values.push_back(quantile(block, 0.5));
    }
    return values;
  };
  std::vector<double> of_a = medians(a);
  std::vector<double> of_b = medians(b);
  if (std::min(of_a.size(), of_b.size()) < kFewestBlocks) return std::nullopt;
  return rank_test(std::move(of_a), std::move(of_b)).p_value;
}

}  // namespace ab
