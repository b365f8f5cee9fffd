// SPDX-License-Identifier: Apache-2.0

// A publisher that says to each reader which messages are for it, in one thread; what threads do to
// it is in tests/proof/model/chosen_model.cpp, what lot::ros does with it in tests/lot_ros.

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/detail/core.hpp"
#include "lot/lot.hpp"

#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using namespace std::chrono_literals;

struct Letter {
  std::uint64_t number;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// One process of the segment: its own directory's spelling makes it a participant of its own.
struct Member {
  Member(lot::EngineOptions options, const std::string& name, const std::string& spelling)
      : participant([&] {
          options.name = name;
          options.directory += spelling;
          return lot::detail::join(options);
        }()) {}
  std::shared_ptr<lot::transport::Participant> participant;
};

struct Fixture {
  lot::EngineOptions options = fresh();
  Member writer{options, "writer", ""};
  Member reader{options, "reader", "/."};
  const lot::detail::MessageType& type = lot::detail::message_type<Letter>();
  std::unique_ptr<lot::detail::PusherCore> pusher = lot::detail::make_pusher(
      writer.participant, "/t", type, {lot::Policy::Overwrite, 8}, lot::detail::Delivery::ToAll);

  std::unique_ptr<lot::detail::PullerCore> puller(Member& of) const {
    return lot::detail::make_puller(of.participant, "/t", type, {lot::Wait::Park, ~0ULL},
                                    lot::detail::Delivery::ToAll);
  }
  void push(std::uint64_t number) const {
    auto letter = lot::detail::build<Letter>(pusher->loan(type, true));
    letter->number = number;
    const lot::ShmSharedPtr<const Letter> shared(std::move(letter));
    REQUIRE(pusher->push_shared(lot::detail::PointerAccess::cell(shared), shared.get(), 0ns) ==
            lot::Status::Ok);
  }
};

struct Got {
  std::uint64_t number;
  lot::detail::Origin origin;
  std::optional<bool> ours;
};
std::optional<Got> pull(lot::detail::PullerCore& puller) {
  lot::detail::Borrowed borrowed;
  if (puller.borrow(borrowed, false, {}, false) != lot::Status::Ok) return std::nullopt;
  const auto origin = puller.origin();
  const Got got{static_cast<const Letter*>(borrowed.root)->number, origin, puller.is_ours(origin)};
  puller.done();
  return got;
}
/// The numbers of what has come and is for this reader.
std::vector<std::uint64_t> ours(lot::detail::PullerCore& puller) {
  std::vector<std::uint64_t> numbers;
  while (const auto got = pull(puller)) {
    if (got->ours.value_or(false)) numbers.push_back(got->number);
  }
  return numbers;
}
using Numbers = std::vector<std::uint64_t>;

}  // namespace

TEST_SUITE_BEGIN("lockfree_ring");

TEST_CASE("only what was said to be for a reader is its own") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  f.push(0);
  const auto served = f.pusher->serve("reader", 0);
  REQUIRE(served);
  f.push(1);
  f.push(2);
  f.pusher->stop(*served, 0);
  f.push(3);
  CHECK(ours(*puller) == Numbers{1, 2});
  CHECK_FALSE(puller->has_last_ones("writer"));
  CHECK(puller->taken_back("writer") == 0);
}

TEST_CASE("nothing is said to readers without a cell, of another name, or that decline") {
  Fixture f;
  CHECK_FALSE(f.pusher->serve("reader", 0));
  const auto puller = f.puller(f.reader);
  CHECK(puller->size() == 0);  // it has looked for rings
  CHECK_FALSE(f.pusher->serve("somebody", 0));
  auto served = f.pusher->serve("reader", 0);
  REQUIRE(served);
  CHECK(f.pusher->wants(*served));
  CHECK_FALSE(f.pusher->is_content(*served));
  puller->content();
  CHECK(f.pusher->is_content(*served));
  f.pusher->ask(*served);
  CHECK_FALSE(f.pusher->is_content(*served));
  puller->content();
  puller->decline();
  CHECK_FALSE(f.pusher->wants(*served));
  f.pusher->stop(*served, 0);
  CHECK_FALSE(f.pusher->serve("reader", 0));
}

TEST_CASE("a reader that is asked to join anew is served when it has, by that answer alone") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK(puller->size() == 0);  // it has looked for rings
  CHECK(f.pusher->is_read_by("reader"));
  CHECK_FALSE(f.pusher->is_read_by("somebody"));
  f.push(0);
  f.push(1);
  CHECK_FALSE(f.pusher->serve("reader", 1, 7));
  CHECK(puller->rejoin("somebody", 7).empty());
  CHECK_FALSE(f.pusher->serve("reader", 1, 7));
  CHECK(puller->rejoin("writer", 6).size() == 1);
  CHECK_FALSE(f.pusher->serve("reader", 1, 7));
  CHECK(puller->rejoin("writer", 7).size() == 1);
  const auto served = f.pusher->serve("reader", 1, 7);
  REQUIRE(served);
  f.push(2);
  CHECK(ours(*puller) == Numbers{1, 2});
  // Who is served has not been asked.
  CHECK(puller->rejoin("writer", 8).empty());
  f.pusher->stop(*served, 0);
  CHECK(puller->rejoin("writer", 8).size() == 1);
  CHECK(ours(*puller).empty());
  CHECK(f.pusher->serve("reader", 0, 8));
}

TEST_CASE("a reader that does not decline any more is served again") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK(puller->size() == 0);
  puller->decline();
  CHECK_FALSE(f.pusher->is_read_by("reader"));
  CHECK_FALSE(f.pusher->serve("reader", 0));
  puller->content();
  CHECK(f.pusher->is_read_by("reader"));
  CHECK(f.pusher->serve("reader", 0));
}

TEST_CASE("what a reader has said of itself goes with its last puller") {
  Fixture f;
  {
    const auto first = f.puller(f.reader);
    const auto second = f.puller(f.reader);
    first->decline();
  }
  const auto puller = f.puller(f.reader);
  const auto served = f.pusher->serve("reader", 0);
  REQUIRE(served);
  CHECK(f.pusher->wants(*served));
  CHECK_FALSE(f.pusher->is_content(*served));
}

TEST_CASE("two readers of one name are not told apart, so neither is served") {
  Fixture f;
  const auto first = f.puller(f.reader);
  Member twin(f.options, "reader", "/./.");
  {
    const auto second = f.puller(twin);
    CHECK_FALSE(f.pusher->serve("reader", 0));
  }
  CHECK(f.pusher->serve("reader", 0));  // a cell in this ring counts, not the name alone
}

TEST_CASE("the last message is for a late reader, if that is said, though it has been read") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK_FALSE(f.pusher->serve("reader", 1));  // there is no last one
  f.push(0);
  f.push(1);
  const auto first = pull(*puller);
  const auto last = pull(*puller);
  REQUIRE((first && last));
  CHECK_FALSE(last->ours.has_value());  // it may be said yet
  REQUIRE(f.pusher->serve("reader", 1));
  CHECK(puller->is_ours(first->origin) == std::optional(false));
  CHECK(puller->is_ours(last->origin) == std::optional(true));
}

TEST_CASE("an expected reader that comes late gets what was kept for it, once it is said so") {
  Fixture f;
  CHECK_FALSE(f.pusher->expects("reader"));
  const auto puller = f.puller(f.reader);
  CHECK(f.pusher->expects("reader"));  // it has said that it reads the topic, before it has a cell
  CHECK_FALSE(f.pusher->expects("somebody"));
  CHECK_FALSE(f.pusher->serve("reader", 3));  // there are not so many
  for (std::uint64_t n = 0; n < 5; ++n) f.push(n);
  std::vector<Got> kept;
  while (const auto got = pull(*puller)) kept.push_back(*got);
  REQUIRE(kept.size() == 5);
  CHECK_FALSE(f.pusher->serve("reader", 9));  // the ring has eight places
  REQUIRE(f.pusher->serve("reader", 3));
  f.push(5);
  for (const Got& got : kept) {
    CHECK(puller->is_ours(got.origin) == std::optional(got.number >= 2));
  }
  CHECK(ours(*puller) == Numbers{5});
  puller->decline();
  CHECK_FALSE(f.pusher->expects("reader"));
}

TEST_CASE("a publisher is there until its ring is read") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK(puller->size() == 0);
  CHECK(puller->has_publisher("writer"));
  CHECK_FALSE(puller->has_publisher("reader"));
  f.push(0);
  f.pusher.reset();
  CHECK(puller->has_publisher("writer"));
  while (pull(*puller)) {
  }
  CHECK_FALSE(puller->has_publisher("writer"));
}

TEST_CASE("what is taken back is counted once, and what is not read yet is not its own") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  const auto served = f.pusher->serve("reader", 0);
  REQUIRE(served);
  for (std::uint64_t n = 0; n < 3; ++n) f.push(n);
  CHECK(ours(*puller) == Numbers{0, 1, 2});
  f.push(3);
  f.pusher->stop(*served, 3);  // 1, 2 and 3 go another way as well
  CHECK(ours(*puller).empty());
  CHECK(puller->taken_back("writer") == 2);
  CHECK(puller->taken_back("writer") == 0);
}

TEST_CASE("a reader that has not read all its own is not served again, and the rest is known") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  const auto served = f.pusher->serve("reader", 0);
  REQUIRE(served);
  f.push(0);
  f.push(1);
  f.pusher->stop(*served, 0);
  CHECK(puller->size() == 2);
  CHECK(puller->has_last_ones("writer"));
  CHECK_FALSE(puller->has_last_ones("somebody"));
  CHECK_FALSE(f.pusher->serve("reader", 0));
  CHECK(ours(*puller) == Numbers{0, 1});
  CHECK_FALSE(puller->has_last_ones("writer"));
  f.push(2);
  REQUIRE(f.pusher->serve("reader", 0));
  f.push(3);
  CHECK(ours(*puller) == Numbers{3});
}

TEST_CASE("a reader that takes the cell of another one is told nothing that was for that one") {
  Fixture f;
  std::optional<lot::detail::Served> served;
  {
    const auto puller = f.puller(f.reader);
    served = f.pusher->serve("reader", 0);
    REQUIRE(served);
  }
  const auto next = f.puller(f.reader);
  CHECK_FALSE(f.pusher->wants(*served));
  f.pusher->stop(*served, 0);
  f.push(0);
  const auto got = pull(*next);
  REQUIRE(got);
  CHECK_FALSE(got->ours.has_value());
  CHECK(next->publisher(got->origin) == "writer");
}

TEST_SUITE_END();
