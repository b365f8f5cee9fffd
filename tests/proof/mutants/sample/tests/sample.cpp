// SPDX-License-Identifier: Apache-2.0
// Catches the mutants of sample.hpp, but for those that are there to survive.
#include "sample.hpp"

int main() {
  using namespace sample;
  int wrong = 0;
  auto must = [&](bool holds) { wrong += !holds; };
  must(never(4) == 1);
  must(never(3) == 0);
  must(operand(1, 2) && !operand(0, 2) && !operand(1, 0));
  must(bound(4) == 16 && bound(0) == 0);
  must(extreme(4, 7) == 5 && extreme(4, 2) == 2);
  must(period(true) == 200ms && period(false) == 5ms);
  Log log;
  must(log.size == 0);
  steps(log);
  must(log.entries == std::vector<int>{1, 2});
  must(found({5, 6, 7}, 6) == 6 && !found({5, 6, 7}, 8));
  int four = 2;
  must(doubled(four) == 4);
  must(limited(5) == 5 && limited(9) == 7);
  must(negated(4) && !negated(5));
  must(fixed() == 3);
  in_vain(log);
  return wrong != 0;
}
