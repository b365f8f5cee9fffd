// SPDX-License-Identifier: Apache-2.0

// What the error of a full segment says: what would have fitted, which process and topic hold the
// most, and what helps.

#include <cstdint>
#include <fstream>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "segment/segment.hpp"
#include "support/error_of.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/small_disk.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr std::size_t kMiB = std::size_t{1} << 20;
constexpr std::size_t kSegment = 64 * kMiB;

struct Frame {
  lot::ShmVector<unsigned char> data;
};
struct Note {
  std::uint64_t number = 0;
};

lot::EngineOptions named(const char* name, std::size_t size = kSegment) {
  auto options = fresh(size);
  options.name = name;
  return options;
}

void push(lot::ShmPusher<Frame>& pusher, std::size_t bytes = kMiB) {
  auto frame = pusher.loan();
  frame->data.resize(bytes);
  must(pusher.push(std::move(frame)) == lot::Status::Ok, "pushed");
}

/// Why a message cannot have so many bytes.
std::string refusal(lot::ShmPusher<Frame>& pusher, std::size_t bytes) {
  return error_of([&] {
           auto frame = pusher.loan();
           frame->data.resize(bytes);
         })
      .second;
}

/// Why there is no block for one more.
std::string refusal_of_blocks(lot::ShmPusher<Note>& pusher,
                              std::vector<lot::ShmUniquePtr<Note>>& loans) {
  std::string text;
  do {
    text = error_of([&] { loans.push_back(pusher.loan()); }).second;
  } while (text == "no error");
  return text;
}

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE("what OutOfMemory says would have fitted does fit") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(named("node"));
  auto front = engine.advertise<Frame>("/front");
  for (int n = 0; n < 100; ++n) push(front);
  auto rear = engine.advertise<Frame>("/rear");
  const std::string text = refusal(rear, 50 * kMiB);
  CAPTURE(text);
  std::smatch found;
  REQUIRE(std::regex_search(text, found, std::regex("(\\d+) MiB would have fitted")));
  const auto fits = static_cast<std::size_t>(std::stoul(found[1]));
  // Two messages and a block made ahead stay. Wherever they lie, they leave four pieces at most.
  CHECK(fits >= 12);
  CHECK(names(text, " MiB are of /front, made by node (pid "));
  CHECK(names(text, "raise LOT_SIZE"));
  CHECK(!names(text, "depth"));
  CHECK(refusal(rear, fits * kMiB) == "no error");
}

TEST_CASE("OutOfMemory for more than the segment advises a larger one, and nothing else") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(named("node"));
  auto pusher = engine.advertise<Frame>("/frames");
  for (int n = 0; n < 10; ++n) push(pusher);
  const std::string text = refusal(pusher, 2 * kSegment);
  CAPTURE(text);
  CHECK(names(text, "the whole segment is too small for it: raise LOT_SIZE"));
  CHECK(names(text, "of /frames, made by node"));
  CHECK(!names(text, " or "));
  CHECK(!names(text, "would have fitted"));
}

TEST_CASE("OutOfMemory of a full segment advises what helps against what has most of it") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(named("node"));
  auto pusher = engine.advertise<Frame>("/late");
  SUBCASE("reserved") {
    auto owner = engine.advertise<Frame>("/owner");
    owner.reserve(40, kMiB);
    const std::string text = refusal(pusher, 40 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "or reserve() less"));
    CHECK(names(text, "of /owner, made by node"));
  }
  SUBCASE("loaned") {
    auto owner = engine.advertise<Frame>("/owner");
    auto loan = owner.loan();
    loan->data.resize(40 * kMiB);
    const std::string text = refusal(pusher, 40 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "or push or drop what is loaned"));
    CHECK(names(text, "40 MiB are of /owner"));
  }
  SUBCASE("unread") {
    auto owner = engine.advertise<Frame>("/owner", {lot::Policy::Refuse});
    auto reader = engine.subscribe<Frame>("/owner");
    for (int n = 0; n < 40; ++n) push(owner);
    const std::string text = refusal(pusher, 40 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "or takes from queues without loss be faster"));
    CHECK(names(text, "a smaller depth"));
  }
  SUBCASE("items that nobody has taken") {
    auto jobs = engine.queue<lot::ShmUniquePtr<Frame>>("/jobs");
    for (int n = 0; n < 40; ++n) {
      auto job = jobs.make();
      job->data.resize(kMiB);
      must_go(jobs.put(std::move(job)));
    }
    const std::string text = refusal(pusher, 40 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "40 MiB are of /jobs"));
    CHECK(names(text, "or takes from queues without loss be faster"));
    CHECK(names(text, "a smaller depth"));
  }
  SUBCASE("kept") {
    auto owner = engine.advertise<Frame>("/owner");
    lot::PullerOptions greedy;
    greedy.max_held_bytes = lot::PullerOptions::kNoQuota;
    auto reader = engine.subscribe<Frame>("/owner", greedy);
    std::vector<lot::ShmSharedPtr<const Frame>> kept;
    for (int n = 0; n < 40; ++n) {
      push(owner);
      kept.push_back(reader.pull(10s));
    }
    const std::string text = refusal(pusher, 40 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "node (pid "));
    CHECK(names(text, "keeps 40 MiB"));
    CHECK(names(text, "let that one keep fewer messages"));
  }
  SUBCASE("the newest two of others") {
    auto owner = engine.advertise<Frame>("/owner");
    for (int n = 0; n < 2; ++n) push(owner, 20 * kMiB);
    const std::string text = refusal(pusher, 40 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "the newest two messages of each stay"));
  }
}

TEST_CASE("OutOfMemory where all blocks are in use names the processes that have them") {
  const Watchdog watchdog(60);
  auto options = named("node");
  options.blocks = 64;
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Note>("/late");
  std::vector<lot::ShmUniquePtr<Note>> loans;
  SUBCASE("loaned") {
    const std::string text = refusal_of_blocks(pusher, loans);
    CAPTURE(text);
    CHECK(names(text, "64 of 64 blocks are in use"));
    CHECK(names(text, "64 blocks are of /late, made by node (pid "));
    CHECK(names(text, "EngineOptions::blocks, or push or drop what is loaned"));
    CHECK(!names(text, "LOT_SIZE"));
    CHECK(!names(text, "depth"));
  }
  SUBCASE("kept by another") {
    auto owner = engine.advertise<Note>("/owner");
    lot::PullerOptions greedy;
    greedy.max_held_bytes = lot::PullerOptions::kNoQuota;
    auto reader = engine.subscribe<Note>("/owner", greedy);
    std::vector<lot::ShmSharedPtr<const Note>> kept;
    for (int n = 0; n < 50; ++n) {
      must_go(owner.push(owner.loan()));
      kept.push_back(reader.pull(10s));
    }
    const std::string text = refusal_of_blocks(pusher, loans);
    CAPTURE(text);
    CHECK(names(text, "keeps 50 blocks"));
    CHECK(names(text, "blocks are of /owner"));
    CHECK(names(text, "let that one keep fewer messages"));
  }
}

TEST_CASE("each message of a publisher that has left goes for a need of blocks") {
  const Watchdog watchdog(60);
  auto options = named("node");
  options.blocks = 64;
  lot::ShmEngine engine(options);
  const auto reader = engine.subscribe<Note>("/left");
  lot::PusherOptions how;
  how.fast_lane = false;
  how.depth = 3;
  auto pusher = engine.advertise<Note>("/late", how);
  Child leaver([&] {
    lot::ShmEngine theirs(options);
    lot::PusherOptions all = how;
    all.depth = options.blocks;
    auto left = theirs.advertise<Note>("/left", all);
    std::vector<lot::ShmUniquePtr<Note>> loans;
    (void)refusal_of_blocks(left, loans);
    for (auto& loan : loans) must(left.push(std::move(loan)) == lot::Status::Ok, "pushed");
  });
  CHECK(leaver.wait() == 0);
  const lot::segment::Segment view(engine.path());
  const auto& home = view.block(0).home;  // where a word says nothing, it says block 0
  REQUIRE(home.load() == lot::refcount::kHomeOrphanage);
  std::vector<lot::ShmUniquePtr<Note>> loans;
  (void)refusal_of_blocks(pusher, loans);
  CHECK(loans.size() == options.blocks);
  CHECK(home.load() != lot::refcount::kHomeOrphanage);
}

TEST_CASE("OutOfMemory of a full file system says what is free there, and advises another one") {
  const Watchdog watchdog(60);
  const SmallDisk disk("size=40m");
  if (disk.path.empty()) {
    MESSAGE("no tmpfs can be mounted here");
    return;
  }
  auto options = named("node", 32 * kMiB);
  options.directory = disk.path;
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/frames");
    push(pusher);
    std::ofstream other(disk.path + "/other");
    const std::string zeros(kMiB, '\0');
    while (other.write(zeros.data(), static_cast<std::streamsize>(zeros.size())).flush()) {
    }
    const std::string text = refusal(pusher, 18 * kMiB);
    CAPTURE(text);
    CHECK(names(text, "the file system is full"));
    CHECK(names(text, ("are free in " + disk.path).c_str()));
    CHECK(names(text, "would have fitted"));
    CHECK(names(text, "LOT_DIR"));
    CHECK(!names(text, "LOT_SIZE"));
  }
  std::remove((disk.path + "/other").c_str());
}

TEST_CASE("OutOfMemory names a process that has the memory and does not answer") {
  const Watchdog watchdog(60);
  const auto options = named("the sleeper");
  Steps ready, end;
  Child other([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/frames");
    for (int n = 0; n < 100; ++n) push(pusher);
    ready.tell();
    end.next(60s);
  });
  REQUIRE(ready.next() == '.');
  other.send(SIGSTOP);
  int status = 0;
  REQUIRE(waitpid(other.pid(), &status, WUNTRACED) == other.pid());
  {
    lot::ShmEngine engine(options);
    const std::string text = error_of([&] {
                               auto pusher = engine.advertise<Frame>("/late");
                               for (int n = 0; n < 40; ++n) push(pusher, 20 * kMiB);
                             }).second;
    CAPTURE(text);
    CHECK(names(text, "of /frames, made by the sleeper (pid "));
    CHECK(names(text, "which does not answer"));
  }
  other.send(SIGCONT);
  end.tell();
  CHECK(other.wait() == 0);
}

TEST_CASE("OutOfMemory names a process that builds a message and does not answer") {
  const Watchdog watchdog(60);
  const auto options = named("the builder");
  Steps ready, end;
  Child other([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/built");
    auto frame = pusher.loan();
    frame->data.resize(20 * kMiB);
    ready.tell();
    end.next(60s);
  });
  REQUIRE(ready.next() == '.');
  other.send(SIGSTOP);
  int status = 0;
  REQUIRE(waitpid(other.pid(), &status, WUNTRACED) == other.pid());
  {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/late");
    const std::string text = refusal(pusher, 40 * kMiB);  // nothing may go for it
    CAPTURE(text);
    CHECK(names(text, "of /built, made by the builder (pid "));
    CHECK(names(text, "which does not answer"));
  }
  other.send(SIGCONT);
  end.tell();
  CHECK(other.wait() == 0);
}

TEST_SUITE_END();
