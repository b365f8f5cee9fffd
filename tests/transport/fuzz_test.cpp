// SPDX-License-Identifier: Apache-2.0

// What <lot/fuzz.hpp> makes of some bytes: its model and the library agree.

#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include <lot/fuzz.hpp>

#include "support/seed.hpp"

namespace {

struct Small {
  std::uint32_t number;
};
struct Text {
  std::uint32_t number;
  lot::ShmString text;
};
using Input = std::vector<std::uint8_t>;

int run_small(const Input& input) {
  return lot::fuzz::queue<Small>(
      input.data(), input.size(),
      [](Small& message, lot::fuzz::Bytes& bytes) {
        message.number = bytes.number<std::uint32_t>();
      },
      [](const Small& message) { return std::to_string(message.number); });
}
int run_text(const Input& input) {
  return lot::fuzz::queue<Text>(
      input.data(), input.size(),
      [](Text& message, lot::fuzz::Bytes& bytes) {
        message.number = bytes.number<std::uint32_t>();
        message.text = bytes.text(60);
      },
      [](const Text& message) { return std::to_string(message.number) + message.text.c_str(); });
}
/// How often a message was looked at.
unsigned looks = 0;
int run_counted(const Input& input) {
  looks = 0;
  return lot::fuzz::queue<Small>(
      input.data(), input.size(), [](Small& message, lot::fuzz::Bytes&) { message.number = 1; },
      [](const Small& message) {
        ++looks;
        return std::to_string(message.number);
      });
}

/// The steps of lot::fuzz, by their numbers.
enum Step : std::uint8_t { Push = 0, Pull = 2, Borrow = 4, Advertise = 12, Subscribe = 13, Close };

}  // namespace

TEST_CASE("bytes by chance never find the library other than the model") {
  const std::uint64_t seed = lot::testing::seed();
  CAPTURE(seed);
  std::mt19937_64 random(seed);
  for (int i = 0; i < 100; ++i) {
    Input input(random() % 600);
    for (std::uint8_t& byte : input) byte = static_cast<std::uint8_t>(random());
    CHECK(run_small(input) == 0);
    CHECK(run_text(input) == 0);
  }
}

TEST_CASE("a publisher that refuses is full, beside one of another topic") {
  Input input;
  for (const std::uint8_t topic : {std::uint8_t{0}, std::uint8_t{1}}) {
    input.insert(input.end(), {Subscribe, 0, topic, 0});
    input.insert(input.end(), {Advertise, 1, topic, 5, 1});  // Policy::Refuse, two messages
  }
  for (int i = 0; i < 4; ++i) input.insert(input.end(), {Push, 0, 0, 1, 2, 3, 4});
  for (int i = 0; i < 4; ++i) input.insert(input.end(), {Pull, 0, Pull, 1});
  CHECK(run_small(input) == 0);
}

TEST_CASE("a reader whose publisher has closed is told so when it has read all") {
  Input input{Subscribe, 0, 0, 0, Advertise, 1, 0, 0, 3};
  input.insert(input.end(), {Push, 0, 0, 1, 2, 3, 4, Close, 0, Pull, 0, Pull, 0});
  input.insert(input.end(), {Borrow, 0, Pull, 0});
  CHECK(run_small(input) == 0);
}

TEST_CASE("a message that is loaned and not pushed comes to no subscriber") {
  const Input both{Subscribe, 0, 0, 0, Advertise, 1, 0, 0, 3};
  for (const std::uint8_t how : {std::uint8_t{0}, std::uint8_t{7}}) {
    Input input = both;
    input.insert(input.end(), {Push, 0, how, Pull, 0});
    CHECK(run_counted(input) == 0);
    // Twice when it is filled, and once when it has come.
    CHECK(looks == (how == 7 ? 2 : 3));
  }
}

TEST_CASE("a segment of lot::fuzz has 2048 messages at most") {
  lot::fuzz::detail::Place place(lot::fuzz::Options{});
  auto pusher = place.engine(0).advertise<Small>("/a");
  std::vector<lot::ShmUniquePtr<Small>> all;
  while (all.size() <= 2048) {
    try {
      all.push_back(pusher.loan());
    } catch (const lot::OutOfMemory&) {
      break;
    }
  }
  CHECK(all.size() > 1024);
  CHECK(all.size() <= 2048);
}
