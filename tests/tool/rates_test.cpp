// SPDX-License-Identifier: Apache-2.0

// What `lot ls` and `lot top` say of a rate, from moments that the test makes up.

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "tool/pace.hpp"
#include "tool/tempo.hpp"
#include "tool/text.hpp"

namespace {

using namespace lot::tool;

/// {seconds, messages that have come since the moment before}
using Arrivals = std::vector<std::pair<double, std::uint64_t>>;

Rate seen_in(double seconds, const Arrivals& arrivals) {
  Tempo tempo(0);
  for (const auto& [at, n] : arrivals) tempo.see(at, n);
  return tempo.rate(seconds);
}

Arrivals even(double first, double period, double until) {
  Arrivals all;
  for (int n = 0; first + n * period < until; ++n) all.push_back({first + n * period, 1});
  return all;
}

void check(const Rate& seen, std::optional<double> per_second, std::optional<double> below,
           std::uint64_t messages, double seconds) {
  CHECK(seen.per_second == per_second);
  CHECK(seen.below == below);
  CHECK(seen.messages == messages);
  CHECK(seen.seconds == seconds);
}

}  // namespace

TEST_SUITE_BEGIN("rates");

TEST_CASE("lot ls tells the rate of an even publisher, wherever its first message falls") {
  for (const double rate : {0.1, 0.5, 1.0, 2.0, 5.0, 30.0, 1000.0}) {
    for (const double part : {0.01, 0.3, 0.7, 0.99}) {
      for (const double periods : {3.995, 4.5, 20.0}) {
        CAPTURE(rate);
        CAPTURE(part);
        CAPTURE(periods);
        const double seconds = periods / rate;
        const Rate seen = seen_in(seconds, even(part / rate, 1 / rate, seconds));
        REQUIRE(seen.per_second);
        CHECK(*seen.per_second == doctest::Approx(rate));
        CHECK(!seen.below);
      }
    }
  }
}

TEST_CASE("of fewer than three messages lot ls tells a bound that holds, and no rate") {
  for (const double rate : {0.1, 0.5, 1.0, 2.0, 3.0}) {
    for (const double part : {0.01, 0.5, 0.99}) {
      for (const double seconds : {0.001, 0.3, 0.6, 1.0}) {
        CAPTURE(rate);
        CAPTURE(part);
        CAPTURE(seconds);
        const auto arrivals = even(part / rate, 1 / rate, seconds);
        const Rate seen = seen_in(seconds, arrivals);
        CHECK(seen.messages == arrivals.size());
        CHECK(seen.seconds == seconds);
        if (arrivals.size() > 2) continue;
        CHECK(!seen.per_second);
        REQUIRE(seen.below);
        CHECK(*seen.below > rate);
      }
    }
  }
}

TEST_CASE("of a burst, a start and a halt lot ls tells no rate") {
  const Arrivals burst = {{0.500, 1}, {0.501, 1}, {0.502, 40}};
  CHECK(!seen_in(1, burst).per_second);
  CHECK(*seen_in(1, burst).below == doctest::Approx(43));
  CHECK(!seen_in(1, {{0.5, 42}}).per_second);
  CHECK(!seen_in(1.05, {{0.01, 5}, {1.01, 5}}).per_second);  // two bursts, five a second
  CHECK(!seen_in(1, even(0.6, 0.01, 1)).per_second);         // began meanwhile
  CHECK(!seen_in(1, even(0, 0.01, 0.4)).per_second);         // halted meanwhile
  Arrivals paused = even(0, 0.01, 0.3);
  for (const auto& arrival : even(0.7, 0.01, 1)) paused.push_back(arrival);
  CHECK(!seen_in(1, paused).per_second);
}

TEST_CASE("a halt is one wherever the clock begins") {
  Tempo tempo(100);
  for (const auto& [at, n] : even(100, 0.01, 100.4)) tempo.see(at, n);
  CHECK(!tempo.rate(101).per_second);
}

TEST_CASE("a fast publisher that is held up for a moment has a rate") {
  Arrivals arrivals = even(0, 0.001, 0.5);
  for (const auto& arrival : even(0.6, 0.001, 1)) arrivals.push_back(arrival);
  REQUIRE(seen_in(1, arrivals).per_second);
  CHECK(*seen_in(1, arrivals).per_second == doctest::Approx(900).epsilon(0.01));
}

TEST_CASE("many messages between two looks count, but those of the first look") {
  Arrivals arrivals;
  for (int n = 1; n <= 100; ++n) arrivals.push_back({n * 0.005, 5000});
  CHECK(*seen_in(0.5, arrivals).per_second == doctest::Approx(1e6));
}

TEST_CASE("lot top tells the rate of a topic of 0.1 Hz and of one of 1 MHz") {
  constexpr double kLook = 0.01;
  for (const double rate : {0.1, 0.3, 1.0, 10.0, 30.0, 1000.0, 1e6}) {
    for (const double seconds : {35 / rate, 40 / rate + 7}) {
      CAPTURE(rate);
      CAPTURE(seconds);
      Pace pace(0);
      std::uint64_t before = 0;
      double at = 0;
      for (int n = 1; n * kLook < seconds; ++n) {  // it sees counts, at the moments of its looks
        at = n * kLook;
        const auto now = static_cast<std::uint64_t>(at * rate);
        pace.see(at, now - before);
        before = now;
      }
      const Rate seen = pace.rate(at);
      if (before < 3 || at < 0.2) continue;
      REQUIRE(seen.per_second);
      CHECK(*seen.per_second == doctest::Approx(rate).epsilon(0.02));
    }
  }
}

TEST_CASE("lot top tells a new rate within seconds, none of a publisher that has halted") {
  Pace pace(0);
  for (const auto& [at, n] : even(0.1, 0.1, 20)) pace.see(at, n);
  CHECK(*pace.rate(20).per_second == doctest::Approx(10));
  for (const auto& [at, n] : even(20, 0.01, 26)) pace.see(at, n);
  CHECK(*pace.rate(26).per_second == doctest::Approx(100));
  CHECK(pace.rate(26.5).per_second);
  pace.see(36, 0);
  const Rate halted = pace.rate(36);
  CHECK(!halted.per_second);
  CHECK(*halted.below == doctest::Approx(0.1).epsilon(0.01));
  for (const auto& [at, n] : even(60, 1, 64.5)) pace.see(at, n);  // goes on, slower
  CHECK(*pace.rate(64.5).per_second == doctest::Approx(1));
}

TEST_CASE("lot top that was stopped for a while tells the rate of all that came") {
  for (const double rate : {1.0, 30.0, 1e5}) {
    CAPTURE(rate);
    Pace pace(0);
    std::uint64_t before = 0;
    const auto look = [&](double at) {
      const auto now = static_cast<std::uint64_t>(at * rate);
      pace.see(at, now - before);
      before = now;
      return pace.rate(at);
    };
    for (int n = 1; n <= 1000; ++n) look(n * 0.01);
    for (int n = 4000; n < 4400; ++n) {
      const Rate seen = look(n * 0.01);
      REQUIRE(seen.per_second);
      CHECK(*seen.per_second == doctest::Approx(rate).epsilon(0.1));
    }
  }
}

TEST_CASE("of a publisher that was stopped and catches up lot top tells no bound that is absurd") {
  constexpr double kHertz = 10;
  for (const std::uint64_t piled_up : {1U, 64U, 10000U}) {
    CAPTURE(piled_up);
    Pace pace(0);
    for (int n = 1; n <= 500; ++n) pace.see(n * 0.01, n % 10 == 0 ? 1 : 0);
    for (int n = 501; n < 2000; ++n) pace.see(n * 0.01, 0);
    CHECK(*pace.rate(19.99).below == doctest::Approx(1 / 14.99));
    for (int n = 2000; n < 2200; ++n) {
      const double at = n * 0.01;
      pace.see(at, n == 2000 ? piled_up : n % 10 == 0 ? 1 : 0);
      const Rate seen = pace.rate(at);
      if (seen.per_second) CHECK(*seen.per_second == doctest::Approx(kHertz).epsilon(0.01));
      if (seen.below) CHECK(*seen.below > kHertz);
      if (seen.below) CHECK(*seen.below < 2 * kHertz);
    }
    CHECK(pace.rate(21.99).per_second);
  }
}

TEST_CASE("of bursts lot top tells the mean, once it has seen some seconds of them") {
  Pace pace(0);
  for (int n = 0; n < 10; ++n) {
    pace.see(n + 0.01, 5);
    if (n == 1) CHECK(!pace.rate(n + 0.5).per_second);
  }
  REQUIRE(pace.rate(9.5).per_second);
  CHECK(*pace.rate(9.5).per_second == doctest::Approx(5));
  CHECK(!pace.rate(9.5).below);
  Pace just(0);  // half of the time that it keeps, and not evenly
  for (const double at : {0.5, 0.75, 3.0}) just.see(at, 2);
  REQUIRE(just.rate(3).per_second);
  CHECK(*just.rate(3).per_second == doctest::Approx(4 / Pace::kSpan * 2));
  CHECK(!just.rate(3).below);
}

TEST_CASE("what lot tells of a queue, at each bound of Tempo") {
  Tempo tempo(8);
  tempo.see(8.5, 2);
  tempo.see(9, 1);
  check(tempo.rate(9.5), {}, 4 / 1.5, 3, 1.5);  // one has followed
  tempo.see(9.5, 1);
  tempo.see(9.75, 0);  // which finds nothing, and says nothing
  check(tempo.rate(10), 2., {}, 4, 2);
  check(tempo.rate(11), 2., {}, 4, 3);  // silent for three periods
  check(tempo.rate(11.0625), {}, 5 / 3.0625, 4, 3.0625);

  Tempo fast(0);
  for (int n = 0; n <= 64; ++n) fast.see(n / 8., 1);
  check(fast.rate(10), 8., {}, 65, 10);  // silent for a fifth of the time
  check(fast.rate(10.25), {}, 66 / 10.25, 65, 10.25);

  Tempo at_once(1);
  at_once.see(1, 3);
  check(at_once.rate(1), {}, {}, 3, 0);
  at_once.see(1, 2);
  check(at_once.rate(2), {}, 6., 5, 1);
  CHECK(!at_once.mean());
}

TEST_CASE("what lot top tells of a queue, at each bound of Pace") {
  const auto pace_of = [](const std::vector<double>& arrivals) {
    Pace pace(0);
    for (const double at : arrivals) pace.see(at, 1);
    return pace;
  };
  const Pace five_seconds = pace_of({1, 2, 3, 4, 6});
  check(five_seconds.rate(6), 4 / 5., {}, 5, 6);
  check(pace_of({1, 2, 3, 4, 6, 7}).rate(7), 4 / 5., {}, 5, 6);  // since the first one
  check(pace_of({10, 20, 30, 40}).rate(40), 0.1, {}, 4, 40);
  check(pace_of({10, 20, 30, 40, 50}).rate(50), 0.1, {}, 4, 40);

  const Pace rhythm = pace_of({1, 2, 3});
  check(rhythm.rate(6), 1., {}, 3, 6);  // three times as long as its pauses
  check(rhythm.rate(6.5), {}, 1 / 3.5, 0, 3.5);
  check(pace_of({1, 2}).rate(9), {}, 3 / 9., 2, 9);  // too few for a rhythm
  const Pace quick = pace_of({0.125, 0.25, 0.375, 0.5});
  CHECK(quick.rate(1.5).messages == 4);
  check(quick.rate(1.75), {}, 1 / 1.25, 0, 1.25);
  CHECK(pace_of({1, 5, 5.5, 6}).rate(12).messages == 4);  // the longest pause is the first

  Pace halted = rhythm;
  halted.see(20, 0);
  halted.see(20.5, 5);  // may have piled up: counts as one
  halted.see(21, 1);
  halted.see(21.5, 1);
  check(halted.rate(22), 2., {}, 3, 1.5);

  check(pace_of({0.5, 0.75, 3.5}).rate(3.5), 2 / 3., {}, 3, 3.5);  // uneven, for 3 s
  check(pace_of({101.5, 101.75, 103.75}).rate(103.75), {}, 4 / 103.75, 3, 103.75);
  check(pace_of({0.5, 3.5}).rate(3.5), {}, 3 / 3.5, 2, 3.5);  // two have no mean
  check(pace_of({0.25}).rate(0.25), {}, {}, 1, 0.25);
  check(pace_of({0.25}).rate(0.3), {}, 2 / 0.3, 1, 0.3);
  check(pace_of({0.25}).rate(0.5), {}, 4., 1, 0.5);
}

TEST_CASE("where lot has not looked, nothing is known") {
  const Rate none = seen_in(0, {});
  CHECK(!none.per_second);
  CHECK(!none.below);
}

TEST_CASE("a rate is text, and a bound is never less than the number") {
  CHECK(rate_text(0.1) == "0.10/s");
  CHECK(rate_text(0.949) == "0.95/s");
  CHECK(rate_text(1) == "1.0/s");
  CHECK(rate_text(29.97) == "30.0/s");
  CHECK(rate_text(1500) == "1.5k/s");
  CHECK(below_text(1) == "< 1/s");
  CHECK(below_text(0.997) == "< 1/s");
  CHECK(below_text(1.004) == "< 1.1/s");
  CHECK(below_text(0.1) == "< 0.1/s");
  CHECK(below_text(0.02) == "< 0.1/s");
  CHECK(below_text(999.97) == "< 1000/s");
  CHECK(below_text(1001) == "< 1.1k/s");
  CHECK(below_text(2e6) == "< 2M/s");
}

TEST_SUITE_END();
