// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>

namespace lot::testing {

/// What a run chooses by chance follows from this: LOT_TEST_SEED, or a new one. It is printed.
inline std::uint64_t seed() {
  static const std::uint64_t value = [] {
    const char* given = std::getenv("LOT_TEST_SEED");
    const std::uint64_t s =
        given != nullptr ? std::strtoull(given, nullptr, 10) : std::random_device{}();
    std::printf("seed: LOT_TEST_SEED=%llu\n", static_cast<unsigned long long>(s));
    return s;
  }();
  return value;
}

/// One of each `shares` things that are counted from 0: another share with each seed.
class Share {
 public:
  explicit Share(unsigned shares) : shares_(shares) {}
  bool has(std::uint64_t number) const {
    return shares_ == 1 || number % shares_ == seed() % shares_;
  }

 private:
  unsigned shares_;
};

}  // namespace lot::testing
