// SPDX-License-Identifier: Apache-2.0

// The gate, the place of a process in a segment, and the reaper, without wardens, pools or
// pointers. Two lock files in one process are two processes to the kernel's locks.

#include "transport/membership.hpp"

#include <cerrno>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include <doctest/doctest.h>

#include "lot/detail/core.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"

#include "registry/registry.hpp"
#include "support/processes.hpp"
#include "transport/gate.hpp"
#include "transport/participant.hpp"
#include "transport/pool.hpp"
#include "transport/reaper.hpp"
#include "transport/world.hpp"

namespace {

using namespace lot::testing;
using lot::transport::IfAbsent;
using lot::transport::Membership;
using lot::transport::Reaper;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Place {
  lot::EngineOptions options = fresh(16 << 20);
  std::string path = lot::segment::path_of(options.directory, options.segment);
  lot::segment::Trust trust = lot::segment::Trust::of(options);

  Place() = default;
  Place(const Place&) = delete;
  Place& operator=(const Place&) = delete;
  ~Place() {
    lot::segment::Segment::remove(path, trust);
    std::filesystem::remove(path + ".lock");
  }
};

/// A member that has gone through the gate, and what it needs to reap others.
struct Member {
  explicit Member(const Place& place, const char* name, IfAbsent if_absent = IfAbsent::Make) {
    lot::transport::pass_gate(
        place.options, place.path, place.trust, if_absent, [&](const auto& file) {
          membership.emplace(place.options, place.trust, file);
          registry.emplace(membership->segment(), membership->presence());
          world.emplace(membership->segment(), *registry);
          holder.segment = &membership->segment();
          reaper.emplace(*membership, *world, holder);
          membership->take_index(name, [&](auto until) { return reaper->repair_index(until); });
        });
  }

  std::optional<Membership> membership;
  std::optional<lot::registry::Registry> registry;
  std::optional<lot::transport::World> world;
  lot::transport::Holder holder;
  std::optional<Reaper> reaper;
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("members that pass the gate get indexes of their own, and see each other's names") {
  const Watchdog watchdog(60);
  const Place place;
  const Member first(place, "first");
  Member second(place, "second");
  CHECK(first.membership->index() != second.membership->index());
  CHECK(second.world->name_of(first.membership->index()) == "first");
  CHECK(!second.reaper->reap_dead());
  CHECK_NOTHROW(second.membership->check_usable());
}

TEST_CASE("a member reaps another one that has gone without a word, and not itself") {
  const Watchdog watchdog(60);
  const Place place;
  Member stays(place, "stays");
  std::uint32_t gone = 0;
  {
    const Member goes(place, "goes");
    gone = goes.membership->index();
    CHECK(!stays.reaper->reap_if_dead(gone));
  }
  CHECK(!stays.reaper->reap_if_dead(stays.membership->index()));
  CHECK(stays.world->participant_state(gone).load() == 1);
  CHECK(stays.reaper->reap_dead());
  CHECK(stays.world->participant_state(gone).load() == 0);
}

TEST_CASE("a member that leaves last removes the files, and one that is not last leaves them") {
  const Watchdog watchdog(60);
  const Place place;
  Member first(place, "first");
  Member second(place, "second");
  for (Member* member : {&first, &second}) {
    auto& file = member->membership->lock_file();
    REQUIRE(file.enter_gate(lot::transport::kGatePatience));
    CHECK(member->reaper->reap_own(true) == Reaper::Own::Reaped);
    member->membership->presence().end();
    member->membership->remove_files_if_last();
    file.unlock(member->membership->index());
    file.leave_gate();
    CHECK(std::filesystem::exists(place.path) == (member == &first));
  }
}

TEST_CASE("a member that was expelled or forked is inert, and says why") {
  const Watchdog watchdog(60);
  const Place place;
  Member expelled(place, "expelled");
  Member forked(place, "forked");
  expelled.membership->expel();
  REQUIRE(forked.membership->presence().name() != 0);
  forked.membership->abandon();
  CHECK(forked.membership->presence().name() == 0);  // it has no lock of its parent
  CHECK_THROWS_WITH_AS(expelled.membership->check_usable(), doctest::Contains("taken for dead"),
                       lot::Error);
  CHECK_THROWS_WITH_AS(forked.membership->check_usable(), doctest::Contains("fork()"), lot::Error);
}

TEST_CASE("a visitor passes the gate to a segment that is there, and makes none") {
  const Watchdog watchdog(60);
  const Place place;
  CHECK_THROWS_AS(Member(place, "visitor", IfAbsent::Throw), lot::Error);
  CHECK(!std::filesystem::exists(place.path));
  CHECK(!std::filesystem::exists(place.path + ".lock"));
  const Member maker(place, "maker");
  CHECK_NOTHROW(Member(place, "visitor", IfAbsent::Throw));
}

TEST_CASE("a joiner whose admission fails leaves no segment behind that it has made") {
  const Watchdog watchdog(60);
  const Place place;
  const auto fail = [](const auto&) { throw lot::Error(ENOMEM, "joiner", "fails", "try again"); };
  CHECK_THROWS_AS(
      lot::transport::pass_gate(place.options, place.path, place.trust, IfAbsent::Make, fail),
      lot::Error);
  CHECK(!std::filesystem::exists(place.path));
}

TEST_CASE("a ring is closed once it is another one's, or has another generation") {
  const Watchdog watchdog(60);
  const Place place;
  Member member(place, "member");
  constexpr lot::detail::MessageType kNumber{8, 8, 1, "number", nullptr, true, nullptr};
  lot::registry::ChannelName ring{};
  {
    const lot::registry::Registry::Lock lock(*member.registry);
    const std::uint32_t self = member.membership->index();
    const std::uint32_t topic = member.registry->enter("/numbers", kNumber, self);
    ring = member.registry->open(topic, self, {4, 3}).value();
  }
  CHECK(!member.reaper->ring_closed(ring));
  CHECK(member.reaper->ring_closed({ring.channel, ring.generation - 1}));
  member.reaper->end_ring(ring);
  CHECK(member.reaper->give_up_rings());
  CHECK(member.reaper->ring_closed(ring));
}

TEST_CASE("a process that has joined gets another name") {
  const Watchdog watchdog(60);
  const auto joined = lot::transport::Participant::join(fresh(16 << 20));
  lot::detail::rename(*joined, "another");
  CHECK(joined->world().name_of(joined->membership().index()) == "another");
}
