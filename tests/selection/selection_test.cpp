// SPDX-License-Identifier: Apache-2.0

// A publisher that says to each reader which messages are for it, in one thread; what threads do to
// it is in tests/proof/model/selection_model.cpp, what lot::ros does with it in tests/lot_ros.

#include "lot/detail/selection.hpp"

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "registry/registry.hpp"
#include "selection/selector.hpp"
#include "support/local_segment.hpp"
#include "support/processes.hpp"
#include "transport/participant.hpp"

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
  std::unique_ptr<lot::detail::SelectingPusher> pusher = lot::detail::make_selecting_pusher(
      writer.participant, "/t", type, {lot::Policy::Overwrite, 8});

  std::unique_ptr<lot::detail::SelectingPuller> puller(Member& of) const {
    return lot::detail::make_selecting_puller(of.participant, "/t", type, {lot::Wait::Park, ~0ULL});
  }
  /// One that only looks on, and knows nothing of bounds: what a tool has.
  std::unique_ptr<lot::detail::PullerCore> observer(Member& of) const {
    lot::PullerOptions looks_on{lot::Wait::Park, ~0ULL};
    looks_on.observer = true;
    return lot::detail::make_puller(of.participant, "/t", type, looks_on,
                                    lot::detail::Delivery::ToAll);
  }
  void push(std::uint64_t number) const { push(pusher->core(), number); }
  void push(lot::detail::PusherCore& by, std::uint64_t number) const {
    auto letter = lot::detail::build<Letter>(by.loan(type, true));
    letter->number = number;
    const lot::ShmSharedPtr<const Letter> shared(std::move(letter));
    REQUIRE(by.push_shared(lot::detail::PointerAccess::control(shared), shared.get(), {0ns}) ==
            lot::Status::Ok);
  }
};

struct Got {
  std::uint64_t number;
  lot::detail::Origin origin;
  std::optional<bool> ours;
};
std::optional<Got> pull(lot::detail::SelectingPuller& puller) {
  lot::detail::Borrowed borrowed;
  if (puller.core().borrow(borrowed, lot::detail::Limit::now()) != lot::Status::Ok)
    return std::nullopt;
  const auto origin = puller.origin();
  const Got got{static_cast<const Letter*>(borrowed.root)->number, origin, puller.is_ours(origin)};
  puller.core().done();
  return got;
}
/// The numbers of what has come and is for this reader.
std::vector<std::uint64_t> ours(lot::detail::SelectingPuller& puller) {
  std::vector<std::uint64_t> numbers;
  while (const auto got = pull(puller)) {
    if (got->ours.value_or(false)) numbers.push_back(got->number);
  }
  return numbers;
}
using Numbers = std::vector<std::uint64_t>;
/// The numbers of all that has come.
Numbers all(lot::detail::PullerCore& puller) {
  Numbers numbers;
  lot::detail::Borrowed borrowed;
  while (puller.borrow(borrowed, lot::detail::Limit::now()) == lot::Status::Ok) {
    numbers.push_back(static_cast<const Letter*>(borrowed.root)->number);
    puller.done();
  }
  return numbers;
}

}  // namespace

TEST_SUITE_BEGIN("selection");

TEST_CASE("only what was said to be for a reader is its own") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  f.push(0);
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  f.push(1);
  f.push(2);
  f.pusher->deselect(*selected, 0);
  f.push(3);
  CHECK(ours(*puller) == Numbers{1, 2});
  CHECK_FALSE(puller->has_remaining("writer"));
  CHECK(puller->resent("writer") == 0);
}

TEST_CASE("what was evicted is not among the last messages that the ring has") {
  LocalSegment local({6 << 20, 4, 64, 2, 3, 3});
  std::uint32_t channel = 0;
  {
    const lot::registry::Registry::Lock lock(local.registry());
    const std::uint32_t topic =
        local.registry().enter("/t", lot::detail::message_type<Letter>(), 2);
    channel = local.registry().open(topic, 2, {4, 3}).value().channel;
  }
  using lot::segment::Atomics;
  lot::ring::Writer<Atomics> writer(local.segment().ring(channel));
  const lot::selection::Selector<Atomics> selector(writer);
  CHECK(selector.has_last(0));
  CHECK_FALSE(selector.has_last(1));
  for (lot::ring::Word block = 0; block < 3; ++block) writer.publish(block);
  CHECK(selector.has_last(3));
  CHECK_FALSE(selector.has_last(4));
  CHECK(writer.evict_oldest() == 0);
  CHECK(selector.has_last(2));
  CHECK_FALSE(selector.has_last(3));
}

TEST_CASE("nothing is said to readers without a cell, of another name, or that decline") {
  Fixture f;
  CHECK_FALSE(f.pusher->select("reader", 0));
  const auto puller = f.puller(f.reader);
  CHECK(puller->core().size() == 0);  // it has looked for rings
  CHECK_FALSE(f.pusher->select("somebody", 0));
  auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  CHECK(f.pusher->wants(*selected));
  CHECK_FALSE(f.pusher->has_confirmed(*selected));
  puller->confirm();
  CHECK(f.pusher->has_confirmed(*selected));
  f.pusher->ask(*selected);
  CHECK_FALSE(f.pusher->has_confirmed(*selected));
  puller->confirm();
  puller->decline();
  CHECK_FALSE(f.pusher->wants(*selected));
  f.pusher->deselect(*selected, 0);
  CHECK_FALSE(f.pusher->select("reader", 0));
}

TEST_CASE("a reader that is asked to join anew is selected when it has, by that answer alone") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK(puller->core().size() == 0);  // it has looked for rings
  CHECK(f.pusher->is_read_by("reader"));
  CHECK_FALSE(f.pusher->is_read_by("somebody"));
  f.push(0);
  f.push(1);
  CHECK_FALSE(f.pusher->select("reader", 1, 7));
  CHECK(puller->join_anew("somebody", 7).empty());
  CHECK_FALSE(f.pusher->select("reader", 1, 7));
  CHECK(puller->join_anew("writer", 6).size() == 1);
  CHECK_FALSE(f.pusher->select("reader", 1, 7));
  CHECK(puller->join_anew("writer", 7).size() == 1);
  const auto selected = f.pusher->select("reader", 1, 7);
  REQUIRE(selected);
  f.push(2);
  CHECK(ours(*puller) == Numbers{1, 2});
  // Who is selected has not been asked.
  CHECK(puller->join_anew("writer", 8).empty());
  f.pusher->deselect(*selected, 0);
  CHECK(puller->join_anew("writer", 8).size() == 1);
  CHECK(ours(*puller).empty());
  CHECK(f.pusher->select("reader", 0, 8));
}

TEST_CASE("a reader that does not decline any more is selected again") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK(puller->core().size() == 0);
  puller->decline();
  CHECK_FALSE(f.pusher->is_read_by("reader"));
  CHECK_FALSE(f.pusher->select("reader", 0));
  puller->confirm();
  CHECK(f.pusher->is_read_by("reader"));
  CHECK(f.pusher->select("reader", 0));
}

TEST_CASE("what a reader has said of itself goes with its last puller") {
  Fixture f;
  {
    const auto first = f.puller(f.reader);
    const auto second = f.puller(f.reader);
    first->decline();
  }
  const auto puller = f.puller(f.reader);
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  CHECK(f.pusher->wants(*selected));
  CHECK_FALSE(f.pusher->has_confirmed(*selected));
}

TEST_CASE("a new puller takes back what its process has replied") {
  Fixture f;
  const auto first = f.puller(f.reader);
  CHECK(first->core().size() == 0);
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  first->confirm();
  CHECK(f.pusher->has_confirmed(*selected));
  const auto second = f.puller(f.reader);
  CHECK_FALSE(f.pusher->has_confirmed(*selected));
  first->decline();
  CHECK_FALSE(f.pusher->expects("reader"));
  const auto third = f.puller(f.reader);
  CHECK(f.pusher->expects("reader"));
}

TEST_CASE("a reply of a process that has no puller any more means nothing") {
  Fixture f;
  std::optional<lot::detail::SelectedReader> selected;
  {
    const auto puller = f.puller(f.reader);
    selected = f.pusher->select("reader", 0);
    REQUIRE(selected);
    puller->confirm();
    CHECK(f.pusher->has_confirmed(*selected));
  }
  CHECK_FALSE(f.pusher->has_confirmed(*selected));
  CHECK_FALSE(f.pusher->wants(*selected));
  CHECK_FALSE(f.pusher->expects("reader"));
}

TEST_CASE("a publisher that does not select its readers says nothing to them") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  const auto plain =
      lot::detail::make_pusher(f.writer.participant, "/t", f.type, {lot::Policy::Overwrite, 8},
                               lot::detail::Delivery::ToAll);
  f.push(*plain, 0);
  const auto got = pull(*puller);
  REQUIRE(got);
  CHECK_FALSE(got->ours.has_value());
  CHECK(puller->rings_of("writer").size() == 2);
  CHECK_FALSE(puller->has_remaining("writer"));
  CHECK(puller->resent("writer") == 0);
  CHECK(puller->join_anew("writer", 7).size() == 1);
}

TEST_CASE("two readers of one name are not told apart, so neither is selected") {
  Fixture f;
  const auto first = f.puller(f.reader);
  Member twin(f.options, "reader", "/./.");
  {
    const auto second = f.puller(twin);
    CHECK_FALSE(f.pusher->select("reader", 0));
  }
  CHECK(f.pusher->select("reader", 0));  // a cell in this ring counts, not the name alone
}

TEST_CASE("the last message is for a late reader, if that is said, though it has been read") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK_FALSE(f.pusher->select("reader", 1));  // there is no last one
  f.push(0);
  f.push(1);
  const auto first = pull(*puller);
  const auto last = pull(*puller);
  REQUIRE((first && last));
  CHECK_FALSE(last->ours.has_value());  // it may be said yet
  REQUIRE(f.pusher->select("reader", 1));
  CHECK(puller->is_ours(first->origin) == std::optional(false));
  CHECK(puller->is_ours(last->origin) == std::optional(true));
}

TEST_CASE("an expected reader that comes late gets what was kept for it, once it is said so") {
  Fixture f;
  CHECK_FALSE(f.pusher->expects("reader"));
  const auto puller = f.puller(f.reader);
  CHECK(f.pusher->expects("reader"));  // it has said that it reads the topic, before it has a cell
  CHECK_FALSE(f.pusher->expects("somebody"));
  CHECK_FALSE(f.pusher->select("reader", 3));  // there are not so many
  for (std::uint64_t n = 0; n < 5; ++n) f.push(n);
  std::vector<Got> kept;
  while (const auto got = pull(*puller)) kept.push_back(*got);
  REQUIRE(kept.size() == 5);
  CHECK_FALSE(f.pusher->select("reader", 9));  // the ring has eight places
  REQUIRE(f.pusher->select("reader", 3));
  f.push(5);
  for (const Got& got : kept) {
    CHECK(puller->is_ours(got.origin) == std::optional(got.number >= 2));
  }
  CHECK(ours(*puller) == Numbers{5});
  puller->decline();
  CHECK_FALSE(f.pusher->expects("reader"));
}

TEST_CASE("what is known of two publishers, and of one that has gone, is each its own") {
  Fixture f;
  Member second(f.options, "second", "/./.");
  auto other = lot::detail::make_selecting_pusher(second.participant, "/t", f.type,
                                                  {lot::Policy::Overwrite, 4});
  const auto puller = f.puller(f.reader);
  CHECK(puller->core().size() == 0);
  const auto of_writer = f.pusher->select("reader", 0);
  const auto of_other = other->select("reader", 0);
  REQUIRE((of_writer && of_other));
  f.push(0);
  const auto first = pull(*puller);
  f.push(other->core(), 10);
  f.push(other->core(), 11);
  const auto tenth = pull(*puller);
  const auto eleventh = pull(*puller);
  REQUIRE((first && tenth && eleventh));
  REQUIRE(eleventh->number == 11);
  CHECK(puller->publisher(first->origin) == "writer");
  CHECK(puller->publisher(tenth->origin) == "second");
  CHECK(puller->depth(first->origin) == 8);
  CHECK(puller->depth(tenth->origin) == 4);
  const auto rings = puller->rings_of("second");
  REQUIRE(rings.size() == 1);
  CHECK(rings[0].channel == tenth->origin.channel);
  CHECK(rings[0].generation == tenth->origin.generation);
  CHECK(rings[0].sequence == 0);
  CHECK(puller->rings_of("reader").empty());

  f.push(other->core(), 12);
  other->deselect(*of_other, 2);  // 11 and 12 go another way as well
  other.reset();
  CHECK(ours(*puller).empty());  // 12, and then the ring has ended
  CHECK_FALSE(puller->has_publisher("second"));
  CHECK(puller->publisher(tenth->origin) == "second");
  CHECK(puller->depth(tenth->origin) == 0);
  CHECK(puller->is_ours(tenth->origin) == std::optional(true));
  CHECK(puller->resent("writer") == 0);
  CHECK(puller->resent("second") == 1);
  CHECK(puller->resent("second") == 0);

  CHECK(puller->publisher(first->origin) == "writer");
  CHECK(puller->is_ours(first->origin) == std::optional(true));
  lot::detail::Origin nobody = first->origin;
  ++nobody.generation;
  CHECK(puller->publisher(nobody).empty());
  CHECK(puller->depth(nobody) == 0);
  CHECK(puller->is_ours(nobody) == std::optional(false));
}

TEST_CASE("of rings that have ended a reader knows the last 64") {
  Fixture f;
  Member second(f.options, "second", "/./.");
  const auto puller = f.puller(f.reader);
  std::vector<lot::detail::Origin> origins;
  for (std::uint64_t n = 0; n < 65; ++n) {
    auto other = lot::detail::make_selecting_pusher(second.participant, "/t", f.type,
                                                    {lot::Policy::Overwrite, 1});
    CHECK(puller->core().size() == 0);
    REQUIRE(other->select("reader", 0));
    f.push(other->core(), n);
    other.reset();
    const auto got = pull(*puller);
    REQUIRE(got);
    origins.push_back(got->origin);
    CHECK_FALSE(pull(*puller));
  }
  CHECK(puller->publisher(origins[0]).empty());
  CHECK(puller->is_ours(origins[0]) == std::optional(false));
  for (std::size_t n = 1; n < origins.size(); ++n) {
    CAPTURE(n);
    CHECK(puller->publisher(origins[n]) == "second");
    CHECK(puller->is_ours(origins[n]) == std::optional(true));
  }
}

TEST_CASE("a publisher is there until its ring is read") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  CHECK(puller->core().size() == 0);
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
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  for (std::uint64_t n = 0; n < 3; ++n) f.push(n);
  CHECK(ours(*puller) == Numbers{0, 1, 2});
  f.push(3);
  f.pusher->deselect(*selected, 3);  // 1, 2 and 3 go another way as well
  CHECK(ours(*puller).empty());
  CHECK(puller->resent("writer") == 2);
  CHECK(puller->resent("writer") == 0);
}

TEST_CASE("a reader that has not read all its own is not selected again, and the rest is known") {
  Fixture f;
  const auto puller = f.puller(f.reader);
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  f.push(0);
  f.push(1);
  f.pusher->deselect(*selected, 0);
  CHECK(puller->core().size() == 2);
  CHECK(puller->has_remaining("writer"));
  CHECK_FALSE(puller->has_remaining("somebody"));
  CHECK_FALSE(f.pusher->select("reader", 0));
  CHECK(ours(*puller) == Numbers{0, 1});
  CHECK_FALSE(puller->has_remaining("writer"));
  f.push(2);
  REQUIRE(f.pusher->select("reader", 0));
  f.push(3);
  CHECK(ours(*puller) == Numbers{3});
}

TEST_CASE("a reader that takes the cell of another one is told nothing that was for that one") {
  Fixture f;
  std::optional<lot::detail::SelectedReader> selected;
  {
    const auto puller = f.puller(f.reader);
    selected = f.pusher->select("reader", 0);
    REQUIRE(selected);
  }
  const auto next = f.puller(f.reader);
  CHECK_FALSE(f.pusher->wants(*selected));
  f.pusher->deselect(*selected, 0);
  f.push(0);
  const auto got = pull(*next);
  REQUIRE(got);
  CHECK_FALSE(got->ours.has_value());
  CHECK(next->publisher(got->origin) == "writer");
}

TEST_CASE("an observer of a reader's process gets each message once, and is not selected") {
  Fixture f;
  const auto before = f.observer(f.reader);  // its cell stands before the reader's
  CHECK_FALSE(f.pusher->is_read_by("reader"));
  CHECK_FALSE(f.pusher->expects("reader"));
  CHECK_FALSE(f.pusher->select("reader", 0));
  const auto puller = f.puller(f.reader);
  const auto behind = f.observer(f.reader);
  f.push(0);
  CHECK(f.pusher->is_read_by("reader"));
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  CHECK(f.pusher->wants(*selected));
  f.push(1);
  f.push(2);
  f.pusher->deselect(*selected, 0);
  f.push(3);
  CHECK(ours(*puller) == Numbers{1, 2});
  for (lot::detail::PullerCore* observer : {before.get(), behind.get()}) {
    CHECK(all(*observer) == Numbers{0, 1, 2, 3});
  }
}

TEST_CASE("a process that has the name of a reader's and observes does not hide that reader") {
  Fixture f;
  Member twin(f.options, "reader", "/./.");
  const auto observer = f.observer(twin);
  const auto puller = f.puller(f.reader);
  REQUIRE(f.pusher->select("reader", 0));
  f.push(0);
  CHECK(ours(*puller) == Numbers{0});
  CHECK(all(*observer) == Numbers{0});
}

TEST_CASE("an observer is not selected in the place of a reader that has no cell") {
  Fixture f;
  const auto observer = f.observer(f.reader);
  const std::uint32_t index = f.reader.participant->index();
  lot::registry::Registry& registry = f.reader.participant->registry();
  const lot::registry::Registry::Lock lock(registry);
  const std::uint32_t topic = registry.enter("/t", f.type, index, lot::registry::Role::User);
  registry.add_puller(topic, index);  // as a reader does before it joins
  CHECK(f.pusher->expects("reader"));
  CHECK_FALSE(f.pusher->is_read_by("reader"));
  CHECK_FALSE(f.pusher->select("reader", 0));
  registry.remove_puller(topic, index);
  registry.leave(topic, index, lot::registry::Role::User);
}

TEST_CASE("an observer that takes the cell of a reader is not taken for it") {
  Fixture f;
  auto puller = f.puller(f.reader);
  const auto selected = f.pusher->select("reader", 0);
  REQUIRE(selected);
  const auto other = f.puller(f.reader);  // the process goes on to read the topic
  CHECK(f.pusher->wants(*selected));
  puller.reset();
  const auto observer = f.observer(f.reader);
  CHECK_FALSE(f.pusher->wants(*selected));
}

TEST_SUITE_END();
