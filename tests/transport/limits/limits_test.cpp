// SPDX-License-Identifier: Apache-2.0

// Every limit that is set when a segment or a queue is made: messages are exchanged when it is
// reached, and one step beyond is an error that names the setting.

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "message.hpp"
#include "support/error_of.hpp"
#include "support/in_blocks.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Bytes {
  lot::ShmVector<std::uint8_t> data;
};

/// A message with this number comes through.
bool passes(lot::ShmPusher<Numbered>& pusher, lot::ShmPuller<Numbered>& puller,
            std::uint64_t number) {
  auto message = pusher.loan();
  message->number = number;
  if (pusher.push(std::move(message)) != lot::Status::Ok) return false;
  const auto seen = puller.pull(10s);
  return seen && seen->number == number;
}

}  // namespace

TEST_SUITE_BEGIN("limits");

TEST_CASE("a number that no segment can have is refused by its name") {
  const Watchdog watchdog(60);
  using Options = lot::EngineOptions;
  const struct {
    std::uint32_t Options::*option;
    const char* name;
    std::uint32_t most;
  } settings[] = {{&Options::processes, "EngineOptions::processes", 319},
                  {&Options::blocks, "EngineOptions::blocks", (1U << 19) - 2},
                  {&Options::topics, "EngineOptions::topics", 1U << 20},
                  {&Options::channels, "EngineOptions::channels", 1U << 20},
                  {&Options::readers, "EngineOptions::readers", 1U << 16}};
  for (const auto& setting : settings) {
    CAPTURE(setting.name);
    for (const std::uint32_t value : {0U, setting.most + 1}) {
      auto options = fresh();
      options.*setting.option = value;
      const auto [error, text] = error_of([&] { lot::ShmEngine engine(options); });
      CHECK(error == EINVAL);
      CHECK(names(text, setting.name));
      CHECK(names(text, std::to_string(setting.most).c_str()));
      CHECK(files_of(options) == 0);
    }
    auto options = fresh(std::uint64_t{2} << 30);
    options.*setting.option = setting.most;
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Numbered>("/t");
    auto puller = engine.subscribe<Numbered>("/t");
    CHECK(passes(pusher, puller, 1));
  }
}

TEST_CASE("1000 topics, and as many as there are") {
  const Watchdog watchdog(60);
  auto options = fresh(256 << 20);
  options.topics = 1000;
  lot::ShmEngine engine(options);
  std::vector<lot::ShmPusher<Numbered>> pushers;
  Steps ready, pushed;
  for (int n = 0; n < 1000; ++n) {
    pushers.push_back(engine.advertise<Numbered>("/topic/" + std::to_string(n)));
  }
  Child reader([&] {
    lot::ShmEngine mine(options);
    std::vector<lot::ShmPuller<Numbered>> pullers;
    for (int n = 0; n < 1000; ++n) {
      pullers.push_back(mine.subscribe<Numbered>("/topic/" + std::to_string(n)));
    }
    ready.tell();
    must(pushed.next() == '.', "messages");
    for (std::uint64_t n = 0; n < 1000; ++n) {
      const auto seen = pullers[n].try_pull();
      must(seen && seen->number == n, "the message of its topic");
      must(!pullers[n].try_pull(), "no other");
    }
  });
  REQUIRE(ready.next() == '.');
  for (std::uint64_t n = 0; n < 1000; ++n) {
    auto message = pushers[n].loan();
    message->number = n;
    CHECK(pushers[n].push(std::move(message)) == lot::Status::Ok);
  }
  pushed.tell();
  CHECK(reader.wait() == 0);
  for (int publish = 0; publish < 2; ++publish) {
    const auto [error, text] = error_of([&] {
      if (publish == 1) {
        (void)engine.advertise<Numbered>("/one/more");  // it throws
      } else {
        (void)engine.subscribe<Numbered>("/one/more");  // it throws
      }
    });
    CHECK(error == ENOSPC);
    CHECK(names(text, "EngineOptions::topics"));
  }
  pushers.pop_back();
  auto pusher = engine.advertise<Numbered>("/one/more");
  auto puller = engine.subscribe<Numbered>("/one/more");
  CHECK(passes(pusher, puller, 1));
}

TEST_CASE("64 publishers and 250 readers of one topic in one process, and one more of each") {
  const Watchdog watchdog(60);
  auto options = fresh(256 << 20);
  options.channels = 64;
  options.readers = 250;
  lot::ShmEngine engine(options);
  std::vector<lot::ShmPusher<Numbered>> pushers;
  std::vector<lot::ShmPuller<Numbered>> pullers;
  for (int n = 0; n < 64; ++n) {
    pushers.push_back(engine.advertise<Numbered>("/t", {lot::Policy::Block, 4, 10s}));
  }
  for (int n = 0; n < 250; ++n) pullers.push_back(engine.subscribe<Numbered>("/t"));
  for (std::uint64_t p = 0; p < 64; ++p) {
    auto message = pushers[p].loan();
    message->publisher = p;
    CHECK(pushers[p].push(std::move(message)) == lot::Status::Ok);
    CHECK(pushers[p].readers() == 250);
  }
  for (auto& puller : pullers) {
    std::map<std::uint64_t, int> from;
    for (int n = 0; n < 64; ++n) {
      const auto seen = puller.try_pull();
      REQUIRE(seen);
      ++from[seen->publisher];
    }
    CHECK(from.size() == 64);
    CHECK(!puller.try_pull());
  }
  {
    const auto [error, text] = error_of([&] { return engine.advertise<Numbered>("/t"); });
    CHECK(error == ENOSPC);
    CHECK(names(text, "EngineOptions::channels"));
  }
  {
    const auto [error, text] = error_of([&] { return engine.subscribe<Numbered>("/t"); });
    CHECK(error == EUSERS);
    CHECK(names(text, "EngineOptions::readers"));
  }
  pushers.pop_back();
  pullers.pop_back();
  for (auto& puller : pullers) CHECK(!puller.try_pull());  // leaves the ring that has ended
  pushers.push_back(engine.advertise<Numbered>("/t"));
  pullers.push_back(engine.subscribe<Numbered>("/t"));
  CHECK(passes(pushers.back(), pullers.back(), 2));
}

TEST_CASE("a queue of 65536 messages holds them all, and no queue is deeper") {
  const Watchdog watchdog(60);
  constexpr std::uint32_t kDeepest = 65536;
  auto options = fresh(256 << 20);
  options.blocks = kDeepest + 1000;
  lot::ShmEngine engine(options);
  for (const std::uint32_t depth : {0U, kDeepest + 1, ~0U}) {
    const auto [error, text] = error_of([&] {
      return engine.advertise<Numbered>("/t", {lot::Policy::Overwrite, depth, 1s});
    });
    CHECK(error == EINVAL);
    CHECK(names(text, "PusherOptions::depth"));
    CHECK(names(text, "65536"));
  }
  auto pusher = engine.advertise<Numbered>("/t", {lot::Policy::Block, kDeepest, 0s});
  auto puller = engine.subscribe<Numbered>("/t");
  for (std::uint64_t n = 0; n < kDeepest; ++n) {
    auto message = pusher.loan();
    message->number = n;
    REQUIRE(pusher.push(std::move(message)) == lot::Status::Ok);
  }
  auto one_more = pusher.loan();
  one_more->number = kDeepest;
  CHECK(pusher.try_push(std::move(one_more)) == lot::Status::Full);
  REQUIRE(one_more);
  for (std::uint64_t n = 0; n < kDeepest; ++n) {
    const auto seen = puller.try_borrow();
    REQUIRE(seen);
    REQUIRE(seen->number == n);
  }
  CHECK(pusher.try_push(std::move(one_more)) == lot::Status::Ok);
  CHECK(puller.try_pull()->number == kDeepest);
  CHECK(puller.missed_total() == 0);
}

TEST_CASE("when all blocks are taken, the error names them") {
  const Watchdog watchdog(60);
  auto options = fresh();
  options.blocks = 100;
  lot::ShmEngine engine(options);
  {
    const auto [error, text] = error_of([&] {
      return engine.advertise<Numbered>("/t", in_blocks({lot::Policy::Block, 100, 0s}));
    });
    CHECK(error == EINVAL);
    CHECK(names(text, "PusherOptions::depth"));
    CHECK(names(text, "EngineOptions::blocks"));
  }
  auto pusher = engine.advertise<Numbered>("/t", in_blocks({lot::Policy::Block, 99, 0s}));
  auto puller = engine.subscribe<Numbered>("/t");
  for (std::uint64_t n = 0; n < 1000; ++n) REQUIRE(passes(pusher, puller, n));
  auto other = engine.advertise<Numbered>("/u");
  std::vector<lot::ShmUniquePtr<Numbered>> in_hand;
  const std::string text = error_of([&] {
                             for (;;) in_hand.push_back(other.loan());
                           }).second;
  CHECK(in_hand.size() == 98);  // all that was read, but for the newest two
  CHECK(names(text, "EngineOptions::blocks"));
  CHECK(!other.try_loan());
  in_hand.clear();
  auto reader = engine.subscribe<Numbered>("/u");
  CHECK(passes(other, reader, 1));
}

TEST_CASE("when the segment is full, the error names LOT_SIZE; a message as large as fits passes") {
  const Watchdog watchdog(60);
  const auto options = fresh(64 << 20);
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Bytes>("/t", {lot::Policy::Overwrite, 2, 1s});
  auto puller = engine.subscribe<Bytes>("/t");
  for (int round = 0; round < 3; ++round) {
    auto message = pusher.loan();
    const auto [error, text] = error_of([&] { message->data.resize(std::size_t{64} << 20); });
    CHECK(names(text, "LOT_SIZE"));
    message->data.resize(16 << 20);
    message->data.back() = 7;
    CHECK(pusher.push(std::move(message)) == lot::Status::Ok);
    CHECK(puller.try_pull()->data.back() == 7);
  }
  const lot::PusherOptions how{lot::Policy::Overwrite, 65536, 1s};
  std::vector<lot::ShmPusher<Numbered>> deep;
  const std::string text = error_of([&] {
                             for (;;) {
                               deep.push_back(engine.advertise<Numbered>("/deep", in_blocks(how)));
                             }
                           }).second;
  CHECK(deep.size() > 10);
  CHECK(names(text, "LOT_SIZE"));
  CHECK(names(text, "depth"));
  deep.pop_back();
  deep.push_back(engine.advertise<Numbered>("/deep", in_blocks(how)));
}

TEST_CASE("a size that is too small for the tables is refused, and the error names LOT_SIZE") {
  const Watchdog watchdog(60);
  const auto options = fresh(1 << 20);
  const auto [error, text] = error_of([&] { lot::ShmEngine engine(options); });
  CHECK(error == EINVAL);
  CHECK(names(text, "LOT_SIZE"));
  CHECK(files_of(options) == 0);
}

TEST_SUITE_END();
