// SPDX-License-Identifier: Apache-2.0

// What <lot/fuzz.hpp> makes of some bytes: its model and the library agree.

#include <algorithm>
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

/// What a run has done: how often it wrote and looked at messages, and what it wrote.
class Trace {
 public:
  void wrote(std::uint64_t number) { hash_ = (hash_ ^ number) * 0x100000001b3; }
  void looked() { ++looks_; }
  std::string text() const { return std::to_string(looks_) + " " + std::to_string(hash_); }

 private:
  std::uint64_t looks_ = 0;
  std::uint64_t hash_ = 0xcbf29ce484222325;
};
/// Its fill() is given a message that was seen, if there is one.
struct Linked {
  std::uint32_t number;
};

/// Many bytes, the same wherever the test runs. What they do depends on nothing else: each topic
/// has one publisher, since of two the reader takes any first, and there is no weak pointer, since
/// a dead message goes at any time.
std::vector<Input> inputs() {
  constexpr unsigned kWeak = 10;
  std::mt19937_64 random(26);
  const auto byte = [&] { return static_cast<std::uint8_t>(random() >> 24); };
  std::vector<Input> all(100);
  for (Input& input : all) {
    input = {Advertise, byte(), 0, byte(), byte(), Advertise, byte(), 1, byte(), byte()};
    for (std::uint8_t n = 0; n < 4; ++n) input.insert(input.end(), {Subscribe, byte(), n, n});
    while (input.size() < 600) {
      const std::uint8_t next = byte();
      const unsigned step = next % 16;
      if (step != kWeak && step != Advertise && step != Close) input.push_back(next);
    }
    for (int n = 0; n < 20; ++n) input.push_back(0);  // whatever wants arguments has them
    input.insert(input.end(), {Close, 0, Pull, 0, Pull, 1, Pull, 2, Borrow, 3, 5, 3, Pull, 3});
  }
  return all;
}

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

TEST_CASE("bytes give numbers and texts, and zeros behind the end") {
  const Input input{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 'a', 'b', 'c', 'd', 'e'};
  lot::fuzz::Bytes bytes(input.data(), input.size());
  CHECK(bytes.left() == 15);
  CHECK(bytes.byte() == 1);
  CHECK(bytes.number<std::uint16_t>() == 0x0203);
  CHECK(bytes.number<std::int32_t>() == 0x04050607);
  CHECK(bytes.left() == 8);
  CHECK(bytes.below(5) == 3);    // 8
  CHECK(bytes.below(0) == 0);    // 9
  CHECK(bytes.text(3) == "ab");  // 10 % 4
  CHECK(bytes.left() == 3);
  CHECK(bytes.text(200) == "de");  // all that is left, not 'c'
  CHECK(bytes.left() == 0);
  CHECK(bytes.byte() == 0);
  CHECK(bytes.number<std::uint64_t>() == 0);
  CHECK(bytes.text(9).empty());
  const Input wide{0, 0, 0, 0, 0, 0, 1, 1, 255};
  lot::fuzz::Bytes of_wide(wide.data(), wide.size());
  CHECK(of_wide.below(257) == 0);  // eight bytes, for more than 256
  CHECK(of_wide.left() == 1);
  CHECK(of_wide.below(256) == 255);
}

// A corpus keeps its worth as long as its bytes mean the same.
TEST_CASE("the same bytes make the same run, whatever version of the library has it") {
  Trace small, linked;
  for (const Input& input : inputs()) {
    lot::fuzz::queue<Small>(
        input.data(), input.size(),
        [&](Small& message, lot::fuzz::Bytes& bytes) {
          message.number = bytes.byte();
          small.wrote(message.number);
        },
        [&](const Small& message) {
          small.looked();
          return std::to_string(message.number);
        });
    lot::fuzz::queue<Linked>(
        input.data(), input.size(),
        [&](Linked& message, lot::fuzz::Bytes& bytes, const auto& seen) {
          message.number = bytes.byte();
          linked.wrote(message.number + (seen ? 1000 : 0));
        },
        [&](const Linked& message) {
          linked.looked();
          return std::to_string(message.number);
        });
  }
  CHECK(small.text() == "146885 14998085386056947909");
  CHECK(linked.text() == "136102 9617430277744445561");
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
