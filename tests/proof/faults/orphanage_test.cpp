// SPDX-License-Identifier: Apache-2.0

// One at a time acts for the orphanage, also when locks are lost in the middle of a reap: else
// messages that a dead publisher left to its readers are freed under them.

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "lockfree_ring/words.hpp"
#include "robust_mutex/robust_mutex.hpp"
#include "support/in_blocks.hpp"
#include "support/janitor.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::transport::Participant;

struct Number {
  std::uint64_t value;
};

[[maybe_unused]] const bool has_janitor = start_janitor();

// Deep and many, so that a reap takes its time.
constexpr std::uint64_t kRings = 6;
constexpr std::uint64_t kMessages = 8000;
constexpr std::uint32_t kDepth = 8192;
constexpr int kRounds = 8;

std::string topic(std::uint64_t n) { return {'/', static_cast<char>('a' + n)}; }

bool is_orphan(const lot::segment::ChannelEntry& channel) {
  return lot::ring::writer_state(channel.writer.load()) == lot::ring::State::Orphan;
}

/// Messages in orphan rings that nobody holds: their memory may be used again at any time.
std::size_t unheld_messages(lot::segment::Segment& s) {
  std::size_t n = 0;
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    if (!is_orphan(s.channels()[c])) continue;
    const auto ring = s.ring(c);
    for (std::uint32_t i = 0; i < ring.depth; ++i) {
      const auto b = lot::ring::block(ring.slots[i].load());
      if (b == lot::ring::kNoBlock) continue;
      bool held = false;
      for (auto& word : s.block(static_cast<std::uint32_t>(b)).own) held |= word.load() != 0;
      n += !held;
    }
  }
  return n;
}

enum class Fault { LockFileRemoved, ClosedInAReap };

/// A publisher and its reader, and somebody who collects all the time what nobody needs. The
/// publisher is killed. Returns how many of its messages are then held by nobody.
std::size_t kill_a_publisher(Fault fault) {
  Ground options;
  options.size_bytes = 256 << 20;
  options.blocks = 60000;
  Steps ready, joined, published, read, collecting, enough;
  Child reader([&] {
    lot::ShmEngine engine(named(options, "reader"));
    std::vector<lot::ShmPuller<Number>> pullers;
    must(ready.next() == '.', "the publisher");
    for (std::uint64_t i = 0; i < kRings; ++i) {
      pullers.push_back(engine.subscribe<Number>(topic(i)));
    }
    joined.tell();
    must(read.next() == '.', "the order");
    for (auto& puller : pullers) {
      for (std::uint64_t n = 0; n < kMessages; ++n) {
        const auto look = puller.try_borrow();
        must(look && look->value == n && look.missed() == 0, "each message of the dead");
      }
    }
  });
  Child publisher([&] {
    lot::ShmEngine engine(named(options, "publisher"));
    std::vector<lot::ShmPusher<Number>> pushers;
    const auto how = in_blocks({Policy::Overwrite, kDepth, 1s});  // the orphanage holds blocks
    for (std::uint64_t i = 0; i < kRings; ++i) {
      pushers.push_back(engine.advertise<Number>(topic(i), how));
    }
    ready.tell();
    must(joined.next() == '.', "the reader");
    for (auto& pusher : pushers) {
      for (std::uint64_t n = 0; n < kMessages; ++n) must_go(pusher.push(pusher.loan(n)));
    }
    published.tell();
    pause();
  });
  REQUIRE(published.next() == '.');
  lot::segment::Segment s(file_of(options));
  if (fault == Fault::LockFileRemoved) std::filesystem::remove(file_of(options) + ".lock");
  Child collector([&] {
    const auto participant = Participant::join(named(options, "collector"));
    collecting.tell();
    while (enough.next(0ms) == '\0') participant->reaper().collect();
  });
  REQUIRE(collecting.next() == '.');
  Child careless;
  if (fault == Fault::ClosedInAReap) {
    careless = Child([&] {
      const int first = dup(2);
      const auto participant = Participant::join(named(options, "careless"));
      std::thread([&participant] {
        for (;;) participant->reaper().reap_dead();
      }).detach();
      collecting.tell();
      while (std::none_of(s.channels().begin(), s.channels().end(), is_orphan)) {
      }
      closefrom(first);
      pause();
    });
    REQUIRE(collecting.next() == '.');
  }
  publisher.kill9();
  CHECK(eventually([&] { return index_of(s, "publisher") == 0; }));
  std::this_thread::sleep_for(30ms);  // a collection that had begun before is over
  const std::size_t unheld = unheld_messages(s);
  if (unheld == 0) {
    read.tell();
    CHECK(reader.wait() == 0);
  }
  enough.tell();
  CHECK(collector.wait() == 0);
  return unheld;
}

/// It is a race: nothing may happen in any of the rounds.
void check_rounds(Fault fault) {
  for (int round = 0; round < kRounds; ++round) {
    CAPTURE(round);
    const std::size_t unheld = kill_a_publisher(fault);
    CHECK(unheld == 0);
    if (unheld != 0) break;
  }
}

}  // namespace

TEST_SUITE_BEGIN("orphanage");

TEST_CASE("the lock file removed: old and new processes do not act for the orphanage at once") {
  const Watchdog watchdog(60);
  check_rounds(Fault::LockFileRemoved);
}

TEST_CASE("no process acts for the orphanage without its byte, nor without its lock") {
  const Watchdog watchdog(60);
  for (const bool byte : {true, false}) {
    CAPTURE(byte);
    const Ground options;
    Neighbour neighbour(options);
    Steps joined;
    Child victim([&] {
      const lot::ShmEngine engine(named(options, "victim"));
      joined.tell();
      pause();
    });
    REQUIRE(joined.next() == '.');
    lot::segment::Segment s(file_of(options));
    lot::liveness::LockFile file(file_of(options) + ".lock");
    std::optional<lot::ShmEngine> bystander(named(options, "bystander"));  // in whose name we lock
    InOurName owner(s);
    lot::RobustMutex mutex(s.directory().orphanage.word, owner);
    if (byte) {
      CHECK(eventually([&] { return file.try_lock(lot::refcount::kOrphanage); }));
    } else {
      CHECK(mutex.lock_for(10s) == lot::RobustMutex::Outcome::Locked);
    }
    victim.kill9();
    CHECK(!eventually([&] { return index_of(s, "victim") == 0; }, 300ms));
    if (byte) {
      file.unlock(lot::refcount::kOrphanage);
    } else {
      mutex.unlock();
    }
    CHECK(eventually([&] { return index_of(s, "victim") == 0; }));
    CHECK(neighbour.leave() >= 0);
    bystander.reset();
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("closefrom() in the middle of a reap: no other process acts for the orphanage") {
  const Watchdog watchdog(60);
  check_rounds(Fault::ClosedInAReap);
}

TEST_CASE("a dead process's index is not refused because another one reaps just now") {
  const Watchdog watchdog(60);
  Ground options;
  options.processes = 1;
  Steps joined;
  Child dead([&] {
    lot::ShmEngine engine(named(options, "dead"));
    joined.tell();
    pause();
  });
  REQUIRE(joined.next() == '.');
  dead.kill9();
  lot::liveness::LockFile lock_file(file_of(options) + ".lock");
  REQUIRE(lock_file.try_lock(lot::refcount::kOrphanage));
  std::thread reaper([&] {
    std::this_thread::sleep_for(30ms);
    lock_file.unlock(lot::refcount::kOrphanage);
  });
  CHECK_NOTHROW(lot::ShmEngine(named(options, "next")));
  reaper.join();
}

TEST_SUITE_END();
