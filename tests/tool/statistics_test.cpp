// SPDX-License-Identifier: Apache-2.0

// What `lot hz`, `lot bw` and `lot delay` make of messages, from moments that the test makes up.

#include "tool/statistics.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <random>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "tool/flow.hpp"
#include "tool/text.hpp"

namespace {

using namespace lot::tool;
using namespace std::chrono_literals;
using Time = Flow::Time;
using Span = Flow::Span;

/// The moment that is so far behind the begin, which lies as far behind the epoch as a machine
/// runs.
Time at(Span since) { return Time(30 * 24h + since); }

Moments moments_of(const std::vector<double>& numbers) {
  Moments moments;
  for (const double x : numbers) moments.add(x);
  return moments;
}

/// What long double makes of the same, in two passes.
double deviation_of(const std::vector<double>& numbers) {
  long double sum = 0;
  for (const double x : numbers) sum += x;
  const long double mean = sum / static_cast<long double>(numbers.size());
  long double squares = 0;
  for (const double x : numbers) squares += (x - mean) * (x - mean);
  return static_cast<double>(std::sqrt(squares / static_cast<long double>(numbers.size())));
}

/// A publisher and what looks at it, by a clock that the test moves.
class Player {
 public:
  explicit Player(Span window = 5s) : flow(window, at(0s)) {}

  /// Messages of this rate, for so long; the first one a period from now.
  void play(double hz, Span length) {
    const auto period = Span(std::llround(1e9 / hz));
    for (const Time end = now + length; now + period <= end;) message(period);
  }
  void message(Span after, std::uint64_t n = 1) {
    const Time before = now;
    now += after;
    flow.see(publisher, now, now, n, n - 1,
             n == 1 && has_last ? std::optional((now - before).count()) : std::nullopt);
    has_last = true;
  }

  Flow flow;
  Time now = at(0s);
  std::uint64_t publisher = 1;
  bool has_last = false;
};

}  // namespace

TEST_SUITE_BEGIN("statistics");

TEST_CASE("moments of a few numbers, and of parts that become one") {
  const auto text = [](const Moments& m) {
    const auto whole = [](double x) { return std::to_string(std::llround(x * 100)); };
    return std::to_string(m.count()) + ": " + whole(m.mean()) + " +- " + whole(m.deviation()) +
           ", " + whole(m.least()) + ".." + whole(m.most());
  };
  CHECK(text(moments_of({3})) == "1: 300 +- 0, 300..300");
  CHECK(text(moments_of({2, 4, 4, 4, 5, 5, 7, 9})) == "8: 500 +- 200, 200..900");
  CHECK(text(moments_of({-3, -1})) == "2: -200 +- 100, -300..-100");
  const auto merged = [&](Moments to, const Moments& from) {
    to.merge(from);
    return text(to);
  };
  CHECK(merged(moments_of({1, 2, 3}), moments_of({10})) == "4: 400 +- 354, 100..1000");
  CHECK(merged(moments_of({10}), moments_of({1, 2, 3})) == "4: 400 +- 354, 100..1000");
  CHECK(merged(moments_of({5, 7}), moments_of({})) == "2: 600 +- 100, 500..700");
  CHECK(merged(moments_of({}), moments_of({5, 7})) == "2: 600 +- 100, 500..700");
  CHECK(std::isnan(moments_of({}).deviation()));
}

TEST_CASE("a bucket is a whole number below 64, and then 1/32 as wide as its numbers are large") {
  const std::pair<std::int64_t, double> kMiddles[] = {{0, 0},
                                                      {1, 1},
                                                      {31, 31},
                                                      {32, 32},
                                                      {63, 63},
                                                      {64, 64.5},
                                                      {65, 64.5},
                                                      {66, 66.5},
                                                      {127, 126.5},
                                                      {128, 129.5},
                                                      {131, 129.5},
                                                      {132, 133.5},
                                                      {1000, 999.5},
                                                      {1023, 1015.5},
                                                      {1024, 1039.5},
                                                      {-1, -1},
                                                      {-64, -64},
                                                      {-65, -65.5},
                                                      {-67, -67.5},
                                                      {-129, -130.5},
                                                      {1 << 20, 0x1p20 + 0x1p14 - 0.5},
                                                      {INT64_MAX, 0x1p63 - 0x1p56},
                                                      {INT64_MIN, -0x1p63 + 0x1p56}};
  for (const auto& [number, middle] : kMiddles) {
    CAPTURE(number);
    Ranks ranks;
    ranks.add(number);
    CHECK(ranks.at(1) == middle);
    CHECK(ranks.at(0.001) == middle);
  }
}

TEST_CASE("a part of numbers does not exceed the rank that is asked for") {
  const auto ranks_of = [](std::initializer_list<std::int64_t> numbers) {
    Ranks ranks;
    for (const std::int64_t x : numbers) ranks.add(x);
    return ranks;
  };
  const auto text = [](const Ranks& ranks) {
    std::string all = std::to_string(ranks.count()) + ":";
    for (const double q : {0.01, 0.25, 0.26, 0.5, 0.75, 0.76, 1.0}) {
      all += " " + std::to_string(std::lround(ranks.at(q)));
    }
    return all;
  };
  CHECK(text(ranks_of({4, 1, 3, 2})) == "4: 1 1 2 2 3 4 4");
  CHECK(text(ranks_of({7, -5, 0, -3})) == "4: -5 -5 -3 -3 0 7 7");
  CHECK(text(ranks_of({-1, -2, -3, -4})) == "4: -4 -4 -3 -3 -2 -1 -1");
  CHECK(text(ranks_of({5, 5, 5, 9})) == "4: 5 5 5 5 5 9 9");
  CHECK(ranks_of({}).at(0.5) == 0);
  for (const bool is_larger : {false, true}) {
    Ranks a = ranks_of({-1, 4});
    Ranks b = ranks_of({-30, 50});
    (is_larger ? b : a).merge(is_larger ? a : b);
    CHECK(text(is_larger ? b : a) == "4: -30 -30 -1 -1 4 50 50");
  }
}

TEST_CASE("a rank is never outside of all numbers") {
  const auto figures_of = [](std::initializer_list<std::int64_t> numbers) {
    Figures figures;
    for (const std::int64_t x : numbers) figures.add(x);
    return figures;
  };
  CHECK(figures_of({}).empty());
  CHECK(!figures_of({0}).empty());
  CHECK(figures_of({64}).at(0.5) == 64);
  CHECK(figures_of({65}).at(0.5) == 65);
  CHECK(figures_of({64, 65}).at(1) == 64.5);
  Figures both = figures_of({1, 2});
  both.merge(figures_of({1000}));
  CHECK(both.at(0.5) == 2);
  CHECK(both.at(1) == 999.5);
  CHECK(both.moments.count() == 3);
}

TEST_CASE("a window has a part for each 1/16 of it, and drops one that is too old as a whole") {
  struct Part {
    std::uint64_t n = 0;
    std::uint64_t weight() const { return n; }
    void merge(const Part& other) { n += other.n; }
  };
  Panes<Part> panes(16s, 2);
  const auto push = [&](Span when) {
    ++panes.at(at(when)).n;
    return panes.size();
  };
  CHECK(push(0s) == 1);
  CHECK(push(999ms) == 1);
  CHECK(push(1s) == 2);
  CHECK(push(2s) == 3);
  CHECK(push(2500ms) == 3);
  CHECK(panes.whole(at(17s - 1ns)).n == 5);
  CHECK(panes.whole(at(17s)).n == 3);  // the first part has gone
  CHECK(panes.size() == 2);
  CHECK(panes.whole(at(18s)).n == 2);
  CHECK(panes.whole(at(1h)).n == 2);  // two stay, however old they are
  CHECK(push(1h) == 2);
  CHECK(push(1h + 1s) == 3);
  CHECK(panes.whole(at(1h + 1s)).n == 2);  // the last two are enough by now
  CHECK(panes.size() == 2);
  panes.clear();
  CHECK(panes.size() == 0);
  CHECK(panes.whole(at(2h)).n == 0);
  Panes<Part> least(8ns, 0);
  for (const Span when : {0ns, 1ns, 2ns}) ++least.at(at(when)).n;
  CHECK(least.size() == 3);
  CHECK(least.whole(at(9ns)).n == 2);
  CHECK(least.whole(at(1h)).n == 0);
}

TEST_CASE("the deviation is right where it is small beside the mean") {
  std::mt19937_64 random(7);
  for (const double mean : {1.0, 1e3, 1e6, 1e10, 1e13}) {  // up to hours, in nanoseconds
    std::normal_distribution<double> noise(mean, 10);
    std::vector<double> numbers;
    for (int n = 0; n < 10000; ++n) numbers.push_back(noise(random));
    const Moments moments = moments_of(numbers);
    CAPTURE(mean);
    CHECK(moments.deviation() == doctest::Approx(deviation_of(numbers)).epsilon(1e-4));
    CHECK(moments.least() == *std::min_element(numbers.begin(), numbers.end()));
    CHECK(moments.most() == *std::max_element(numbers.begin(), numbers.end()));
  }
  CHECK(moments_of({4711}).deviation() == 0);
  CHECK(moments_of({2, 4, 4, 4, 5, 5, 7, 9}).deviation() == doctest::Approx(2));
  CHECK(moments_of({2, 4, 4, 4, 5, 5, 7, 9}).mean() == doctest::Approx(5));
}

TEST_CASE("moments of parts are those of the whole") {
  std::mt19937_64 random(11);
  std::lognormal_distribution<double> numbers_of(10, 2);
  Moments whole;
  Moments merged;
  merged.merge(Moments());
  for (int part = 0; part < 20; ++part) {
    Moments one;
    for (int n = 0; n < part * part; ++n) {
      const double x = numbers_of(random) - 5e4;
      whole.add(x);
      one.add(x);
    }
    merged.merge(one);
  }
  CHECK(merged.count() == whole.count());
  CHECK(merged.mean() == doctest::Approx(whole.mean()).epsilon(1e-12));
  CHECK(merged.deviation() == doctest::Approx(whole.deviation()).epsilon(1e-9));
  CHECK(merged.least() == whole.least());
  CHECK(merged.most() == whole.most());
}

TEST_CASE("a rank is within 1/64 of the number that it names, on both sides of zero") {
  std::mt19937_64 random(13);
  for (const double width : {3.0, 50.0, 1e4, 1e9, 1e17}) {
    std::uniform_real_distribution<double> numbers_of(-width / 4, width);
    std::vector<std::int64_t> numbers;
    Ranks ranks;
    Ranks other;
    for (int n = 0; n < 5000; ++n) {
      numbers.push_back(static_cast<std::int64_t>(numbers_of(random)));
      (n % 3 == 0 ? ranks : other).add(numbers.back());
    }
    ranks.merge(other);
    std::sort(numbers.begin(), numbers.end());
    for (const double q : {0.0001, 0.01, 0.2, 0.5, 0.9, 0.99, 1.0}) {
      const auto i = static_cast<std::size_t>(std::max(1.0, std::ceil(q * 5000))) - 1;
      CAPTURE(width);
      CAPTURE(q);
      const auto truth = static_cast<double>(numbers[i]);
      CHECK(std::abs(ranks.at(q) - truth) <= std::abs(truth) / 64);
    }
  }
  Figures figures;
  figures.add(INT64_MAX);
  figures.add(INT64_MIN);
  CHECK(figures.at(1.0) == doctest::Approx(0x1p63).epsilon(1.0 / 64));
  CHECK(figures.at(0.5) == doctest::Approx(-0x1p63).epsilon(1.0 / 64));
}

TEST_CASE("the rate of an even publisher is right from 0.1 Hz to 1 MHz, wherever one looks") {
  for (const double hz : {0.1, 0.3, 1.0, 29.97, 1000.0, 44100.0, 1e6}) {
    Player player;
    player.play(hz, hz < 1 ? 100s : 7s);
    for (const double part : {0.0, 0.3, 0.9}) {
      CAPTURE(hz);
      CAPTURE(part);
      const FlowTold told = player.flow.now(player.now + Span(std::llround(part * 1e9 / hz)));
      REQUIRE(told.rate);
      CHECK(*told.rate == doctest::Approx(hz).epsilon(1e-4));
      CHECK(!told.is_silent);
      CHECK(told.messages >= 5);
      CHECK(static_cast<double>(told.messages) <= std::max(6 * hz, 7.0));  // the last seconds only
      CHECK(told.figures.moments.mean() == doctest::Approx(1e9 / hz).epsilon(1e-3));
      CHECK(told.figures.moments.deviation() <= 1);
    }
  }
}

TEST_CASE("what was missed counts in the rate, and in no interval") {
  std::mt19937_64 random(17);
  Player player;
  std::uint64_t missed = 0;
  for (int n = 0; n < 3000; ++n) {
    const std::uint64_t step = random() % 4 == 0 ? 1 + random() % 100 : 1;
    player.message(step * 1ms, step);
    missed += step - 1;
  }
  const FlowTold told = player.flow.now(player.now);
  REQUIRE(told.rate);
  CHECK(*told.rate == doctest::Approx(1000));
  CHECK(told.figures.moments.least() == 1e6);
  CHECK(told.figures.moments.most() == 1e6);
  const FlowTold all = player.flow.all(player.now);
  CHECK(all.messages == 3000);
  CHECK(all.missed == missed);
  CHECK(*all.rate == doctest::Approx(1000));
}

TEST_CASE("a rate that changes is the new one after a window, and the extremes with it") {
  Player player(2s);
  player.play(100, 10s);
  player.play(20, 3s);
  const FlowTold told = player.flow.now(player.now);
  CHECK(*told.rate == doctest::Approx(20));
  CHECK(told.figures.moments.least() == 50e6);
  const FlowTold all = player.flow.all(player.now);
  CHECK(*all.rate == doctest::Approx(1060 / 13.0).epsilon(0.001));
  CHECK(all.figures.moments.least() == 10e6);
}

TEST_CASE("two messages have a rate, one has none; a flow that halts has none any more") {
  Player player;
  CHECK(player.flow.now(at(500ms)).silence == 500ms);
  CHECK(player.flow.now(at(500ms)).is_silent);
  CHECK(player.flow.all(at(500ms)).is_silent);
  player.message(3s);
  FlowTold told = player.flow.now(player.now + 900ms);
  CHECK(!told.rate);
  CHECK(!told.is_silent);
  CHECK(told.messages == 1);
  CHECK(player.flow.now(player.now + 1100ms).is_silent);
  player.message(10s);  // 0.1 Hz
  told = player.flow.now(player.now + 9s);
  REQUIRE(told.rate);
  CHECK(*told.rate == doctest::Approx(0.1));
  CHECK(!told.is_silent);
  CHECK(!player.flow.now(player.now + 29s).is_silent);
  told = player.flow.now(player.now + 31s);
  CHECK(told.is_silent);
  CHECK(!told.rate);
  CHECK(told.messages == 0);
  CHECK(told.silence == 31s);
  CHECK(player.flow.all(player.now + 31s).messages == 2);
}

TEST_CASE("a flow that goes on after it has halted begins anew") {
  Player player;
  player.play(50, 10s);
  const Time last = player.now;
  CHECK(!player.flow.now(last + 900ms).is_silent);
  CHECK(player.flow.now(last + 1100ms).is_silent);
  player.now += 20s;
  player.has_last = false;
  player.play(200, 1s);
  const FlowTold told = player.flow.now(player.now);
  CHECK(*told.rate == doctest::Approx(200));
  CHECK(told.messages == 200);
  CHECK(*player.flow.all(player.now).rate == doctest::Approx(699 / 30.98).epsilon(0.01));
}

TEST_CASE("a publisher that takes the place of another one does not double the rate") {
  Player player;
  player.play(100, 5s);
  for (player.publisher = 2; player.publisher < 6; ++player.publisher) {
    player.has_last = false;  // its first message has no interval
    player.message(300ms);
    player.play(100, 400ms);
    player.flow.keep({player.publisher});
    const FlowTold told = player.flow.now(player.now);
    const auto periods = static_cast<double>(player.publisher - 1);
    CHECK(*told.rate == doctest::Approx(100 - 6 * periods).epsilon(0.04));
    const double in_all = 5 + 0.7 * periods;
    CHECK(*player.flow.all(player.now).rate ==
          doctest::Approx(100 * (5 + 0.4 * periods) / in_all).epsilon(0.02));
  }
}

TEST_CASE("the rate of several publishers is the sum of theirs, wherever each one begins") {
  std::mt19937_64 random(23);
  for (const int publishers : {1, 2, 10, 40}) {
    for (const double together : {0.0, 0.1, 1.0}) {  // the part of a period in which all push
      for (const Span length : {2500ms, 5500ms, 30500ms}) {
        CAPTURE(publishers);
        CAPTURE(together);
        CAPTURE(length.count());
        Flow flow(5s, at(0s));
        std::vector<std::pair<Time, std::uint64_t>> all;
        double sum = 0;
        for (std::uint64_t p = 0; p < static_cast<std::uint64_t>(publishers); ++p) {
          const double hz = p % 2 == 0 ? 1 : 2;
          sum += hz;
          const auto first = Span(static_cast<std::int64_t>(
              together * 1e9 / hz * static_cast<double>(random() % 1000) / 1000));
          for (Span t = first; t < length; t += Span(std::llround(1e9 / hz))) {
            all.emplace_back(at(t), p);
          }
        }
        std::sort(all.begin(), all.end());
        for (const auto& [t, p] : all) flow.see(p, t, t, 1, 0, std::nullopt);
        // Where not all publishers have begun, a little is missing.
        const double least = length < 5s && together == 1 ? 0.85 : 0.97;
        for (const FlowTold& told : {flow.now(at(length)), flow.all(at(length))}) {
          REQUIRE(told.rate);
          CHECK(*told.rate <= 1.0001 * sum);
          CHECK(*told.rate >= least * sum);
        }
      }
    }
  }
}

TEST_CASE("publishers that send one message each have a rate together") {
  Flow flow(5s, at(0s));
  for (std::uint64_t n = 0; n < 200; ++n) {
    const Time time = at(static_cast<std::int64_t>(n) * 100ms);
    flow.see(n, time, time, 1, 0, std::nullopt);
    if (n % 10 == 9) flow.keep({n});
  }
  CHECK(*flow.now(at(20s)).rate == doctest::Approx(10).epsilon(0.03));
  CHECK(*flow.all(at(20s)).rate == doctest::Approx(10));
}

TEST_CASE("times of several publishers that do not follow each other are one flow") {
  Flow flow(5s, at(0s));
  for (int n = 0; n < 2000; ++n) {  // each is seen a little late, the second one before the first
    flow.see(1, at(n * 10ms + 3ms), at(n * 10ms + 4ms), 1, 0, std::nullopt);
    flow.see(2, at(n * 10ms), at(n * 10ms + 4ms), 1, 0, std::nullopt);
  }
  CHECK(*flow.now(at(20s)).rate == doctest::Approx(200).epsilon(0.01));
  CHECK(*flow.all(at(20s)).rate == doctest::Approx(200).epsilon(0.01));
  flow.forget();
  flow.see(1, at(21s), at(21s), 1, 0, std::nullopt);
  flow.see(1, at(20s), at(21s), 1, 0, std::nullopt);  // led back: no time has passed
  CHECK(!flow.now(at(21s)).rate);
  CHECK(flow.now(at(21s)).messages == 2);
}

TEST_CASE("a window has a bounded number of parts, at any rate and after any pause") {
  struct Part {
    std::uint64_t n = 0;
    std::uint64_t weight() const { return n; }
    void merge(const Part& other) { n += other.n; }
  };
  constexpr Span kWindow = 5s;
  std::mt19937_64 random(19);
  for (const double hz : {0.1, 1.0, 30.0, 1e4}) {
    Panes<Part> panes(kWindow, 5);
    Time now = at(0s);
    std::vector<Time> all;
    for (int n = 0; n < 5000; ++n) {
      now += Span(std::llround(2e9 / hz * static_cast<double>(random() % 1000) / 1000));
      ++panes.at(now).n;
      all.push_back(now);
      CHECK(panes.size() <= 18 + 5);
      if (n % 100 != 99) continue;
      const auto in = [&](Span length) {
        return static_cast<std::uint64_t>(
            std::count_if(all.begin(), all.end(), [&](Time t) { return now - t < length; }));
      };
      const std::uint64_t kept = panes.whole(now).n;
      CHECK(kept >= std::max<std::uint64_t>(in(kWindow), 5));
      // A part goes when all of it is too old.
      CHECK(kept <= std::max(in(kWindow + kWindow / 16), 5 + in(kWindow / 16)));
    }
    CHECK(panes.whole(now + 1h).n >= 5);
  }
}

TEST_CASE("texts of rates and times have as many digits as they promise") {
  CHECK(precise_rate_text(0.1) == "0.1000/s");
  CHECK(precise_rate_text(29.97) == "29.97/s");
  CHECK(precise_rate_text(999.94) == "999.9/s");
  CHECK(precise_rate_text(999.96) == "1.000k/s");
  CHECK(precise_rate_text(1e6) == "1.000M/s");
  CHECK(precise_rate_text(1.2345678e7) == "12.35M/s");
  CHECK(span_text(0) == "0 ns");
  CHECK(span_text(999e-9) == "999 ns");
  CHECK(span_text(1e-6) == "1.00 us");
  CHECK(span_text(32.149e-3) == "32.1 ms");
  CHECK(span_text(-0.25) == "-250 ms");
  CHECK(span_text(10) == "10.0 s");
  CHECK(span_text(86400) == "86400 s");
}

TEST_CASE("an age is told in the unit that has few digits, and never as more than it is") {
  CHECK(age_text(119.9) == "119 s");
  CHECK(age_text(120) == "2 min");
  CHECK(age_text(7199) == "119 min");
  CHECK(age_text(7200) == "2 h");
  CHECK(age_text(48 * 3600 - 1) == "47 h");
  CHECK(age_text(48 * 3600) == "2 days");
}

TEST_SUITE_END();
