// SPDX-License-Identifier: Apache-2.0
#include "statistics.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include <doctest/doctest.h>

namespace {

using namespace ab;
using doctest::Approx;

std::vector<double> some_values(std::mt19937_64& random, std::size_t count, unsigned kinds) {
  std::vector<double> values(count);
  for (double& value : values) value = static_cast<double>(1 + random() % kinds);
  return values;
}

std::vector<double> one_to(unsigned last) {
  std::vector<double> values;
  for (unsigned i = 1; i <= last; ++i) values.push_back(i);
  return values;
}

}  // namespace

TEST_SUITE("lot_ab statistics") {
  TEST_CASE("the quantiles of 1 to 100 are the numbers themselves") {
    std::vector<double> values = one_to(100);
    std::shuffle(values.begin(), values.end(), std::mt19937_64(1));
    const Summary summary = summarise(values);
    CHECK(summary.count == 100);
    CHECK(summary.min == 1);
    CHECK(summary.p1 == 1);
    CHECK(summary.p25 == 25);
    CHECK(summary.median == 50);
    CHECK(summary.p75 == 75);
    CHECK(summary.p99 == 99);
    CHECK(summary.max == 100);
    CHECK(summarise(std::vector<double>{}).count == 0);
    CHECK(summarise(std::vector<double>{7}).median == 7);
  }

  TEST_CASE("p99.9 is there from 20,000 values on") {
    CHECK_FALSE(summarise(one_to(19999)).p999);
    const auto p999 = summarise(one_to(20000)).p999;
    REQUIRE(p999);
    CHECK(*p999 == 19980);
  }

  TEST_CASE("a quantile is the smallest value that at least q of all do not exceed") {
    std::mt19937_64 random(2);
    for (int round = 0; round < 300; ++round) {
      std::vector<double> values = some_values(random, 1 + random() % 40, 12);
      std::sort(values.begin(), values.end());
      for (const double q : {0.0, 0.01, 0.25, 0.5, 0.75, 0.99, 1.0}) {
        const auto enough = [&](double value) {
          const auto not_above =
              std::upper_bound(values.begin(), values.end(), value) - values.begin();
          return static_cast<double>(not_above) + 1e-9 >= q * static_cast<double>(values.size());
        };
        CAPTURE(round);
        CAPTURE(q);
        CHECK(quantile(values, q) == *std::find_if(values.begin(), values.end(), enough));
      }
    }
  }

  TEST_CASE("a machine's slow phases cancel out of a ratio of neighbours") {
    // Each phase triples both arms; a is always exactly twice b.
    Blocks a;
    Blocks b;
    for (unsigned block = 0; block < 20; ++block) {
      const double phase = block % 3 == 0 ? 3 : 1;
      a.push_back(std::vector<double>(50, 20 * phase));
      b.push_back(std::vector<double>(50, 10 * phase));
    }
    const auto ratio = ratio_of_quantiles(a, b, 0.5);
    REQUIRE(ratio);
    CHECK(ratio->known);
    CHECK(ratio->ratio == Approx(2));
    CHECK(ratio->low == Approx(2));
    CHECK(ratio->high == Approx(2));
  }

  TEST_CASE("an interval is deterministic by its seed, and unknown of few blocks") {
    std::mt19937_64 random(3);
    Blocks a;
    Blocks b;
    for (int block = 0; block < 12; ++block) {
      a.push_back(some_values(random, 30, 1000));
      b.push_back(some_values(random, 30, 1000));
    }
    const auto one = ratio_of_quantiles(a, b, 0.5, 7);
    const auto again = ratio_of_quantiles(a, b, 0.5, 7);
    const auto other = ratio_of_quantiles(a, b, 0.5, 8);
    REQUIRE(one);
    CHECK(one->low == again->low);
    CHECK(one->high == again->high);
    CHECK((one->low != other->low || one->high != other->high));
    CHECK(one->low <= one->ratio);
    CHECK(one->ratio <= one->high);
    CHECK(one->low < one->high);
    a.resize(3);
    const auto few = ratio_of_quantiles(a, b, 0.5);
    REQUIRE(few);
    CHECK_FALSE(few->known);
    CHECK_FALSE(ratio_of_quantiles({}, b, 0.5));
    CHECK_FALSE(ratio_of_quantiles(b, Blocks(12, {0.0}), 0.5));
  }

  TEST_CASE("the interval is that of whole blocks drawn and sorted one draw after the other") {
    std::mt19937_64 random(8);
    for (const std::size_t size : {1u, 30u, 700u}) {
      Blocks a;
      Blocks b;
      for (int block = 0; block < 7; ++block) {
        a.push_back(some_values(random, size + random() % 5, 1000));
        b.push_back(some_values(random, size, 300));
      }
      for (const double q : {0.5, 0.99}) {
        std::mt19937_64 draws(9);
        std::vector<double> ratios;
        for (int i = 0; i < 1000; ++i) {
          std::vector<double> of_a;
          std::vector<double> of_b;
          for (std::size_t k = 0; k < a.size(); ++k) {
            const std::size_t drawn = draws() % a.size();
            of_a.insert(of_a.end(), a[drawn].begin(), a[drawn].end());
            of_b.insert(of_b.end(), b[drawn].begin(), b[drawn].end());
          }
          std::sort(of_a.begin(), of_a.end());
          std::sort(of_b.begin(), of_b.end());
          ratios.push_back(quantile(of_a, q) / quantile(of_b, q));
        }
        std::sort(ratios.begin(), ratios.end());
        const auto ratio = ratio_of_quantiles(a, b, q, 9);
        REQUIRE(ratio);
        CAPTURE(size);
        CAPTURE(q);
        CHECK(ratio->low == Approx(quantile(ratios, 0.025)));
        CHECK(ratio->high == Approx(quantile(ratios, 0.975)));
      }
    }
  }

  TEST_CASE("the interval holds the true ratio about as often as it says") {
    constexpr int kRounds = 200;
    std::mt19937_64 random(4);
    int held = 0;
    double width = 0;
    for (int round = 0; round < kRounds; ++round) {
      Blocks a;
      Blocks b;
      for (int block = 0; block < 20; ++block) {
        const double phase = std::exp(std::normal_distribution<double>(0, 0.3)(random));
        const auto values = [&](double median) {
          std::vector<double> result(40);
          for (double& value : result) {
            value = median * phase * std::exp(std::normal_distribution<double>(0, 0.2)(random));
          }
          return result;
        };
        a.push_back(values(30));
        b.push_back(values(20));
      }
      const auto ratio = ratio_of_quantiles(a, b, 0.5, static_cast<std::uint64_t>(round));
      REQUIRE(ratio);
      held += ratio->low <= 1.5 && 1.5 <= ratio->high;
      width += (ratio->high - ratio->low) / kRounds;
    }
    MESSAGE("held in " << held << " of " << kRounds << ", on average " << width << " wide");
    CHECK(held >= kRounds * 85 / 100);
    CHECK(width < 0.3);  // and says something: the phases alone are wider
  }

  TEST_CASE("a change between runs is told from a machine's drift") {
    // The machine got 1.5 times slower, the arm another 2 times.
    const auto blocks = [](double value) { return Blocks(10, std::vector<double>(20, value)); };
    const auto change = change_of_quantiles(blocks(20), blocks(10), blocks(60), blocks(15), 0.5);
    REQUIRE(change);
    CHECK(change->raw.ratio == Approx(3));
    CHECK(change->floor.ratio == Approx(1.5));
    CHECK(change->relative.ratio == Approx(2));
    CHECK(change->relative.known);
    CHECK(change->relative.low == Approx(2));
    CHECK(change->relative.high == Approx(2));
    CHECK_FALSE(change_of_quantiles(blocks(20), {}, blocks(60), blocks(15), 0.5));
  }

  TEST_CASE("the rank test counts pairs as a loop over all of them does") {
    std::mt19937_64 random(5);
    for (int round = 0; round < 200; ++round) {
      const auto a = some_values(random, 1 + random() % 30, 8);
      const auto b = some_values(random, 1 + random() % 30, 8);
      double u = 0;
      for (const double x : a) {
        for (const double y : b) u += x > y ? 1 : x == y ? 0.5 : 0;
      }
      const RankTest test = rank_test(a, b);
      CAPTURE(round);
      CHECK(test.u == Approx(u));
      const RankTest reverse = rank_test(b, a);
      CHECK(test.z == Approx(-reverse.z));
      CHECK(test.p_value == Approx(reverse.p_value));
    }
  }

  TEST_CASE("the rank test's p is that of a worked example with ties") {
    // U = 23.5 of 25; ties 2, 2: variance 25/12 x (11 - 12/90) = 22.6389; z = 10.5 / 4.75803.
    const RankTest test = rank_test({3, 5, 6, 7, 8}, {1, 2, 2, 3, 4});
    CHECK(test.u == Approx(23.5));
    CHECK(test.z == Approx(2.20680).epsilon(1e-4));
    CHECK(test.p_value == Approx(0.027328).epsilon(1e-3));
    CHECK(rank_test({1, 1, 1}, {1, 1}).p_value == 1);
    CHECK(rank_test({}, {1}).p_value == 1);
  }

  TEST_CASE("the rank test finds nothing in one distribution, about as often as it says") {
    std::mt19937_64 random(6);
    int found = 0;
    for (int round = 0; round < 400; ++round) {
      found += rank_test(some_values(random, 60, 500), some_values(random, 60, 500)).p_value < 0.05;
    }
    MESSAGE("found something in " << found << " of 400");
    CHECK(found > 4);
    CHECK(found < 40);
  }

  TEST_CASE("blocks are ranked by their medians: as many values, however many messages") {
    // The middle ones are all that counts; 8 of one against 8 of the other, all of a above.
    Blocks a;
    Blocks b;
    for (unsigned block = 0; block < 8; ++block) {
      a.push_back({0, 100.0 + block, 1e6});
      b.push_back({0, 10.0 + block, 1e6});
    }
    std::vector<double> of_a;
    std::vector<double> of_b;
    for (unsigned block = 0; block < 8; ++block) {
      of_a.push_back(100.0 + block);
      of_b.push_back(10.0 + block);
    }
    const auto p = p_of_block_medians(a, b);
    REQUIRE(p);
    CHECK(*p == Approx(rank_test(of_a, of_b).p_value));
    a.resize(3);
    CHECK_FALSE(p_of_block_medians(a, b));
    a.resize(8);  // empty blocks are none
    CHECK_FALSE(p_of_block_medians(a, b));
    CHECK_FALSE(p_of_block_medians({}, b));
  }

  TEST_CASE("slow phases of blocks are no difference, however many messages they held for") {
    // Both arms have one distribution of blocks; within a block all messages are alike.
    std::mt19937_64 random(7);
    int found = 0;
    for (int round = 0; round < 200; ++round) {
      Blocks a;
      Blocks b;
      for (int block = 0; block < 10; ++block) {
        a.push_back(std::vector<double>(100, static_cast<double>(1 + random() % 1000)));
        b.push_back(std::vector<double>(100, static_cast<double>(1 + random() % 1000)));
      }
      found += p_of_block_medians(a, b).value_or(0) < 0.05;
    }
    MESSAGE("found something in " << found << " of 200");
    CHECK(found < 30);
  }
}
