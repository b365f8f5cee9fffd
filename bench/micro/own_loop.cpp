// SPDX-License-Identifier: Apache-2.0
// Compiled once for each set of options: OWN_LOOP is its name. WORD_BY_WORD: 1 if the compiler may
// not join the stores of the payload. What the headers make for its type is its own, since the type
// has no name outside.
#include "own_loop.hpp"

#include <optional>
#include <utility>

namespace bench {
namespace {

struct Numbers {
  std::uint64_t words[8];
};

class Loop final : public OwnLoop {
 public:
  Loop(lot::ShmEngine& engine, Companion& other, bool first, Use use)
      : use_(use),
        out_(engine.advertise<Numbers>(first ? "/own/ping" : "/own/pong")),
        in_(subscribe(engine, other, first)) {}

  void play(bool first, std::uint64_t trips) override {
    for (std::uint64_t n = 0; n < trips; ++n) {
      if (first) send(n);
      const std::uint64_t got = use_ == Use::Borrowed ? borrowed() : kept();
      expect(got == 8 * n, "a ball was lost");
      if (!first) send(n);
    }
  }

 private:
  static lot::ShmPuller<Numbers> subscribe(lot::ShmEngine& engine, Companion& other, bool first) {
    other.meet();  // both publish
    lot::PullerOptions spinning;
    spinning.wait = lot::Wait::Spin;
    auto in = engine.subscribe<Numbers>(first ? "/own/pong" : "/own/ping", spinning);
    other.meet();  // both listen
    return in;
  }
  void send(std::uint64_t n) {
    auto numbers = out_.loan();
    for (auto& word : numbers->words) {
      word = n;
      if constexpr (WORD_BY_WORD) asm volatile("" ::: "memory");
    }
    (void)out_.push(std::move(numbers));  // the oldest goes: never Full
  }
  std::uint64_t borrowed() {
    const auto numbers = in_.borrow(10s);
    expect(static_cast<bool>(numbers), "none came");
    return sum(*numbers);
  }
  std::uint64_t kept() {
    const auto numbers = in_.pull(10s);
    expect(numbers != nullptr, "none came");
    return sum(*numbers);
  }
  static std::uint64_t sum(const Numbers& numbers) {
    std::uint64_t sum = 0;
    for (const auto word : numbers.words) sum += word;
    return sum;
  }

  Use use_;
  lot::ShmPusher<Numbers> out_;
  lot::ShmPuller<Numbers> in_;
};

}  // namespace

std::unique_ptr<OwnLoop> OWN_LOOP(lot::ShmEngine& engine, Companion& other, bool first, Use use) {
  return std::make_unique<Loop>(engine, other, first, use);
}

}  // namespace bench
