// SPDX-License-Identifier: Apache-2.0

// The whole text of an error about memory, from words that the test writes: who made and keeps
// what, how much is free, and what helps.

#include "transport/fill.hpp"

#include <cerrno>
#include <cstdint>
#include <memory>
#include <string>
#include <sys/statvfs.h>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "segment/segment.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
using lot::segment::kGranule;
using lot::test::raw;
using lot::transport::HardwareOwnership;
using lot::transport::Participant;
using lot::transport::Shortfall;

constexpr std::uint32_t kInMiB = (1U << 20) / kGranule;

struct Number {
  std::uint64_t value = 0;
};

std::string mib(std::uint32_t granules) { return std::to_string(granules / kInMiB) + " MiB"; }

lot::EngineOptions named(const char* name, std::size_t size) {
  auto options = fresh(size);
  options.name = name;
  options.blocks = 40;
  return options;
}

/// A segment of a few blocks. One process has joined, as "node"; what stands in the words of blocks
/// and granules the test writes.
struct Scene {
  const Watchdog watchdog{60};
  const lot::EngineOptions options = named("node", 8 << 20);
  lot::ShmEngine engine{options};
  const lot::ShmPuller<Number> subscribed = engine.subscribe<Number>("/camera");
  const std::shared_ptr<Participant> node = Participant::join(options);
  lot::segment::Segment& segment = node->segment();
  const std::uint32_t self = node->index();
  const std::uint32_t count = segment.granules().count();
  const std::string of_node = "node (pid " + std::to_string(getpid()) + ")";
  const std::string path = "lot: " + segment.path() + ": ";

  struct Piece {
    std::uint32_t first, granules;
  };
  std::vector<Piece> pieces;
  std::vector<std::uint32_t> made;

  Scene() { REQUIRE(segment.granules().used() == 0); }
  ~Scene() {
    for (const Piece& piece : pieces) segment.granules().release(piece.first, piece.granules);
    for (const std::uint32_t b : made) {
      auto& words = segment.block(b);
      for (auto& own : words.own) raw(own).store(0);
      raw(words.home_points).store(0);
      raw(words.home).store(lot::refcount::kHomeFree);
      segment.arena(b).topic = 0;
      lot::segment::set_reserved(segment.arena(b), false);
    }
  }
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  void take(std::uint32_t first, std::uint32_t granules, std::uint32_t tag) {
    REQUIRE(segment.granules().extend(first, granules, tag));
    pieces.push_back({first, granules});
  }
  /// Block b of `maker` has these granules.
  void make(std::uint32_t b, std::uint32_t maker, std::uint32_t first, std::uint32_t granules,
            const char* topic = nullptr) {
    if (granules != 0) take(first, granules, b + 1);
    raw(segment.block(b).home).store(maker + 1);
    segment.arena(b).topic = topic == nullptr ? 0 : lot::segment::topic_key(topic);
    made.push_back(b);
  }
  /// Participant k has the block.
  void keep(std::uint32_t b, std::uint32_t k) {
    raw(HardwareOwnership::word(segment.block(b), k)).fetch_or(HardwareOwnership::bit(k));
  }
  /// The maker has the block by a pointer.
  void point(std::uint32_t b) { raw(segment.block(b).home_points).store(1); }

  std::string shortage(std::uint64_t granules, std::size_t bytes, int error = 0) {
    return lot::transport::describe_shortage(node->memory(), {0, granules, error}, bytes);
  }
  std::string blocks() { return lot::transport::describe_block_shortage(node->memory()); }
  std::string used(std::uint32_t granules, std::uint32_t largest) const {
    return mib(granules) + " of " + mib(count) + " are in use, the largest free piece has " +
           mib(largest);
  }
};

}  // namespace

TEST_SUITE_BEGIN("transport");

TEST_CASE_FIXTURE(Scene, "of an empty segment the error tells the size, and names no process") {
  CHECK(shortage(count + 1, 12345) ==
        path + "no room for 12345 bytes: 0 KiB of " + mib(count) +
            " are in use, the largest free piece has " + mib(count) +
            "; the whole segment is too small for it: raise LOT_SIZE");
  CHECK(shortage(count, 12345) == path + "no room for 12345 bytes: 0 KiB of " + mib(count) +
                                      " are in use, the largest free piece has " + mib(count) +
                                      "; raise LOT_SIZE");
  CHECK(blocks() == path +
                        "no room for a message: 0 of 40 blocks are in use"
                        "; make the segment with a larger EngineOptions::blocks");
}

TEST_CASE_FIXTURE(Scene, "amounts are in KiB below one MiB, and the longest free run counts") {
  make(3, self, 10, kInMiB - 1);
  const std::uint32_t next = 10 + kInMiB - 1;
  take(next + 20, 1, 4);
  CHECK(shortage(count, 1) == path + "no room for 1 bytes: " + mib(kInMiB) + " of " + mib(count) +
                                  " are in use, the largest free piece has " +
                                  mib(count - next - 21) + "; " + mib(kInMiB) +
                                  " are made without a topic by " + of_node +
                                  "; raise LOT_SIZE, or push or drop what is loaned");
  take(next + 21, count - next - 21, lot::segment::kRingTag);
  CHECK(shortage(count, 1) ==
        path + "no room for 1 bytes: " + mib(count - 30) + " of " + mib(count) +
            " are in use, the largest free piece has 80 KiB; " + mib(kInMiB) +
            " are made without a topic by " + of_node +
            "; raise LOT_SIZE, or have fewer publishers, or a smaller depth: their queues have "
            "most of it");
}

TEST_CASE_FIXTURE(Scene, "the error names who made most, and of which topic") {
  make(0, self, 0, 10, "/camera");
  make(1, self, 10, 20, "/camera");
  make(2, self, 30, 29);
  const std::string begin = path + "no room for 7 bytes: 236 KiB of " + mib(count) +
                            " are in use, the largest free piece has " + mib(count - 59) + "; ";
  const std::string end = "; raise LOT_SIZE, or push or drop what is loaned";
  CHECK(shortage(count, 7) == begin + "120 KiB are of /camera, made by " + of_node + end);
  make(3, self, 59, 2);
  CHECK(shortage(count, 7).find("; 124 KiB are made without a topic by " + of_node + "; raise") !=
        std::string::npos);
  make(4, self, 61, 40, "/gone");
  CHECK(shortage(count, 7).find("; 160 KiB are of a topic that has gone, made by " + of_node) !=
        std::string::npos);
  make(5, lot::refcount::kOrphanage, 101, 41, "/camera");
  CHECK(
      shortage(count, 7).find("; 164 KiB are of /camera, made by a process that has gone; raise") !=
      std::string::npos);
  make(6, segment.capacity().participants - 1, 142, 43, "/camera");
  CHECK(shortage(count, 7).find("; 172 KiB are of /camera, made by  (pid 0)") != std::string::npos);
  make(7, segment.capacity().participants, 185, 45, "/camera");
  CHECK(shortage(count, 7).find("; 180 KiB are of /camera, made by a process that has gone") !=
        std::string::npos);
}

TEST_CASE_FIXTURE(Scene, "the error names who keeps most, and a maker keeps what it points to") {
  const std::uint32_t other = self + 1;
  make(0, self, 0, 10, "/camera");
  keep(0, self);
  const std::string loaned = "; 40 KiB are of /camera, made by " + of_node +
                             "; raise LOT_SIZE, or push or drop what is loaned";
  const std::string begin = path + "no room for 7 bytes: 40 KiB of " + mib(count) +
                            " are in use, the largest free piece has " + mib(count - 10);
  CHECK(shortage(count, 7) == begin + loaned);
  point(0);
  const std::string advice =
      "; raise LOT_SIZE, or let that one keep fewer messages (PullerOptions::max_held_bytes)";
  CHECK(shortage(count, 7) == begin + "; 40 KiB are of /camera, made by " + of_node + "; " +
                                  of_node + " keeps 40 KiB" + advice);
  make(1, other, 10, 11, "/camera");
  keep(1, other);
  CHECK(shortage(count, 7).find("; " + of_node + " keeps 40 KiB; ") != std::string::npos);
  keep(1, self);
  CHECK(shortage(count, 7).find("; " + of_node + " keeps 84 KiB; ") != std::string::npos);
  keep(0, segment.capacity().participants - 1);
  make(2, self, 21, 12, "/camera");
  keep(2, segment.capacity().participants - 1);
  CHECK(shortage(count, 7).find(";  (pid 0) keeps 88 KiB; ") != std::string::npos);
}

TEST_CASE_FIXTURE(Scene, "what takes most decides what the error advises") {
  const auto advice = [&] {
    const std::string text = shortage(count, 7);
    return text.substr(text.find("; raise LOT_SIZE") + 2);
  };
  CHECK(advice() == "raise LOT_SIZE");
  make(0, self, 0, 10);
  CHECK(advice() == "raise LOT_SIZE, or push or drop what is loaned");
  make(1, self, 10, 11);
  lot::segment::set_reserved(segment.arena(1), true);
  CHECK(advice() == "raise LOT_SIZE, or reserve() less");
  make(2, self, 21, 12);
  point(2);
  keep(2, self);
  lot::segment::set_reserved(segment.arena(2), true);  // it is kept all the same
  CHECK(advice() ==
        "raise LOT_SIZE, or let that one keep fewer messages (PullerOptions::max_held_bytes)");
  take(40, 13, 41);  // more blocks than there are
  CHECK(advice() ==
        "raise LOT_SIZE, or have fewer publishers, or a smaller depth: their queues have most of "
        "it");
  make(39, self, 60, 14);  // the last one
  CHECK(advice() == "raise LOT_SIZE, or push or drop what is loaned");
}

TEST_CASE_FIXTURE(Scene, "of blocks the error counts each once, whatever memory it has") {
  const std::uint32_t other = self + 1;
  make(0, self, 0, 100, "/camera");
  make(1, self, 0, 0, "/camera");
  make(39, self, 0, 0);
  const std::string begin = path + "no room for a message: 3 of 40 blocks are in use; ";
  const std::string end = "; make the segment with a larger EngineOptions::blocks";
  CHECK(blocks() == begin + "2 blocks are of /camera, made by " + of_node + end +
                        ", or push or drop what is loaned");
  keep(0, other);
  keep(1, other);
  CHECK(blocks() == begin + "2 blocks are of /camera, made by " + of_node +
                        ";  (pid 0) keeps 2 blocks" + end +
                        ", or let that one keep fewer messages (PullerOptions::max_held_bytes)");
  take(100, 50, 30);  // of a block that is free
  CHECK(blocks().find("3 of 40 blocks") != std::string::npos);
}

TEST_CASE_FIXTURE(Scene, "of a full file system the error tells what is free there") {
  make(0, self, 0, 10, "/camera");
  const std::string directory = segment.path().substr(0, segment.path().rfind('/'));
  const std::string text = shortage(count, 7, ENOSPC);
  const std::string begin = path + "no room for 7 bytes: 40 KiB of " + mib(count) +
                            " are in use, the largest free piece has " + mib(count - 10);
  CAPTURE(text);
  // What is free there changes while other tests run.
  const std::string refused = ", and the system gives no memory: ";
  REQUIRE(text.starts_with(begin + refused));
  const std::string rest = text.substr((begin + refused).size());
  const std::string free = rest.substr(0, rest.find(' '));
  struct statvfs room {};
  REQUIRE(statvfs(directory.c_str(), &room) == 0);
  const double there = static_cast<double>(room.f_bavail) * static_cast<double>(room.f_frsize);
  CHECK(std::stod(free) * (1 << 20) > there / 2);
  CHECK(std::stod(free) * (1 << 20) < there * 2);
  CHECK(rest == free + " MiB are free in " + directory +
                    "; with messages that may go 0 KiB would have fitted; 40 KiB are of /camera, "
                    "made by " +
                    of_node +
                    "; try again; where it stays so, have the sandbox let madvise or fallocate "
                    "through, or look for a quota");
  CHECK(shortage(count + 1, 7, ENOSPC)
            .ends_with("made by " + of_node +
                       "; the whole segment is too small for it: raise LOT_SIZE"));
}

TEST_CASE_FIXTURE(Scene, "of a queue without room the error names its topic and its bytes") {
  for (std::uint32_t t = 0; t < segment.capacity().topics; ++t) {
    if (segment.topics()[t].name != std::string("/camera")) continue;
    CHECK(lot::transport::describe_ring_shortage(node->memory(), {0, count + 1, 0}, t) ==
          path + "no room for the queue of /camera, " +
              std::to_string(std::uint64_t{count + 1} * kGranule) +
              " bytes, fewer with a smaller depth: 0 KiB of " + mib(count) +
              " are in use, the largest free piece has " + mib(count) +
              "; the whole segment is too small for it: raise LOT_SIZE");
    return;
  }
  FAIL("the topic is not there");
}

TEST_SUITE_END();
