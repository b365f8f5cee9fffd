// SPDX-License-Identifier: Apache-2.0

// Words of a living segment are changed at random, beside processes that publish, subscribe, work,
// wait, and look from outside. They may end, with a lot::Error, be late and lose messages: the one
// that writes there may do all that. None may read or write outside of the segment.
//
// Left out are the words that say who owns a block, and payload: a forged owner lets a block be
// used again under its reader.

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "segment/segment.hpp"
#include "support/processes.hpp"
#include "support/seed.hpp"
#include "tool/command.hpp"

namespace {

using namespace lot::testing;
namespace segment = lot::segment;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Number {
  std::uint64_t value;
};
struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<std::uint8_t> data;
};

volatile unsigned sink;

// ---- those who work there -----------------------------------------------------------------------

template <class T>
void publish(lot::ShmEngine& engine, const char* topic, const lot::PusherOptions& how) {
  auto pusher = engine.advertise<T>(topic, how);
  for (int n = 0; n < 300; ++n) {
    auto message = pusher.loan();
    if constexpr (std::is_same_v<T, Frame>) {
      message->data.resize(static_cast<std::size_t>(1) << (n % 18));
      std::memset(message->data.data(), n, message->data.size());
    }
    (void)pusher.push(std::move(message), 5ms);  // Full as well: the segment is damaged
    sink = sink + static_cast<unsigned>(pusher.readers());
    if (n % 8 == 0) std::this_thread::sleep_for(100us);
  }
}

/// A slot may name any block, so what is in the message may be of another type: only the message
/// itself is read, which lies in the segment.
template <class T>
void look_at(const T* message) {
  unsigned char bytes[sizeof(T)];
  std::memcpy(bytes, message, sizeof(T));
  sink = sink + bytes[0];
}

template <class T>
void receive(lot::ShmEngine& engine, const char* topic) {
  auto puller = engine.subscribe<T>(topic);
  std::vector<lot::ShmSharedPtr<const T>> kept;
  for (int n = 0; n < 300; ++n) {
    if (auto message = puller.pull(2ms)) {
      look_at(message.get());
      if (kept.size() == 4) kept.erase(kept.begin());
      kept.push_back(std::move(message));
    }
    if (auto borrow = puller.try_borrow()) look_at(borrow.get());
    sink = sink + static_cast<unsigned>(puller.size() + puller.publishers());
  }
}

void wait_for_both(lot::ShmEngine& engine) {
  auto frames = engine.subscribe<Frame>("/frames");
  auto numbers = engine.subscribe<Number>("/numbers");
  lot::WaitSet set;
  int rounds = 0;
  set.add(frames, [&] {
    while (frames.try_pull()) {
    }
    ++rounds;
  });
  set.add(numbers, [&] {
    while (numbers.try_pull()) {
    }
    ++rounds;
  });
  set.add_timer(5ms, [&] {
    if (++rounds > 100) set.stop();
  });
  set.run();
}

/// More words than a set sleeps on: it has an ear. So have the descriptors.
void wait_for_many(lot::ShmEngine& engine) {
  std::vector<lot::ShmPuller<Number>> pullers;
  for (int n = 0; n < 12; ++n) pullers.push_back(engine.subscribe<Number>("/numbers"));
  lot::WaitSet set;
  int rounds = 0;
  for (auto& puller : pullers) {
    (void)puller.fd();
    set.add(puller, [&] {
      while (puller.try_pull()) {
      }
      ++rounds;
    });
  }
  set.add_timer(5ms, [&] {
    if (++rounds > 100) set.stop();
  });
  set.run();
}

const lot::QueueOptions kTasks = [] {
  lot::QueueOptions options;
  options.depth = 16;
  options.redeliver = true;
  return options;
}();

void put(lot::ShmEngine& engine) {
  auto queue = engine.queue<Number>("/tasks", kTasks);
  for (std::uint64_t n = 0; n < 300; ++n) (void)queue.put_for(Number{n}, 2ms);  // Full as well
}
void take(lot::ShmEngine& engine) {
  auto queue = engine.queue<Number>("/tasks", kTasks);
  for (int n = 0; n < 300; ++n) {
    if (auto task = queue.wait_and_take_for(2ms)) {
      sink = sink + static_cast<unsigned>(task->value);
      task.finish();
    }
  }
}

using Role = void (*)(lot::ShmEngine&);
constexpr Role kRoles[] = {
    [](lot::ShmEngine& e) {
      publish<Frame>(e, "/frames", {lot::Policy::Overwrite, 4});
    },
    [](lot::ShmEngine& e) {
      publish<Number>(e, "/numbers", {lot::Policy::Block, 8, 5ms, lot::QueueEngine::Mutex});
    },
    [](lot::ShmEngine& e) { receive<Frame>(e, "/frames"); },
    [](lot::ShmEngine& e) { receive<Number>(e, "/numbers"); },
    wait_for_both,
    wait_for_many,
    put,
    take,
};

/// Does it again and again, in one engine after the other, whatever is said of the segment.
[[noreturn]] void work(const lot::EngineOptions& options, Role role) {
  for (;;) {
    try {
      lot::ShmEngine engine(options);
      role(engine);
    } catch (const lot::Error&) {
    } catch (const lot::OutOfMemory&) {
    }
    std::this_thread::sleep_for(1ms);
  }
}

[[noreturn]] void look_from_outside(const lot::EngineOptions& options) {
  for (;;) {
    for (const char* command : {"ls", "who", "doctor", "clean"}) {
      const Ran ran = run_lot({command, "--dir", options.directory, "--segment", options.segment});
      must(ran.exit < 128, (std::string("lot ") + command + ": " + ran.err).c_str());
    }
  }
}

// ---- the one that scribbles ---------------------------------------------------------------------

class Scribbler {
 public:
  Scribbler(const lot::EngineOptions& options, std::mt19937_64& random)
      : segment_(options.directory + "/" + options.segment),
        geometry_(segment::Geometry::of(segment_.capacity())),
        random_(random) {}

  void change() {
    const std::uint64_t at = place() / 4 * 4;
    auto& word = *reinterpret_cast<std::atomic<std::uint32_t>*>(segment_.base() + at);
    word.store(value_for(word.load()));
  }

 private:
  std::uint64_t below(std::uint64_t n) { return random_() % n; }

  /// A place in a table's first entries, where something is, or in a ring.
  std::uint64_t place() {
    using namespace lot::segment;
    const Capacity& c = segment_.capacity();
    const auto entry = [&](std::uint64_t table, std::uint64_t count, std::uint64_t size) {
      return table + below(std::min<std::uint64_t>(count, 16)) * size + below(size);
    };
    switch (below(17)) {
      case 0:
        return below(sizeof(Header));
      case 1:
        return entry(geometry_.participants, c.participants, sizeof(ParticipantEntry));
      case 2:
        return entry(geometry_.witnesses, c.participants, sizeof(Witness));
      case 3:
        return entry(geometry_.directory, 1, sizeof(Directory));
      case 4:
        return entry(geometry_.topics, std::min(c.topics, 3U), sizeof(TopicEntry));
      case 5:
        return entry(geometry_.channels, std::min(c.channels, 6U), sizeof(ChannelEntry));
      case 6:
        return geometry_.tags + below(geometry_.granules * sizeof(Tag));
      case 7:
        return geometry_.units + below(segment_.units() * sizeof(Tag));
      case 8:
        return entry(geometry_.sightings, c.participants, sizeof(Sightings));
      case 9:
        return entry(geometry_.replies, std::min(c.topics, 3U), sizeof(Replies));
      case 12:
        return entry(geometry_.listeners, std::min(c.channels, 6U), sizeof(Listeners));
      case 13:
        return geometry_.ears + below(lot::ring::kEars * sizeof(EarWords));
      case 14:
        return geometry_.news + below(lot::ring::kEars * news_bytes(c.channels));
      case 10:
      case 11:
        return entry(geometry_.arenas, c.blocks, sizeof(lot::detail::Arena));
      default: {
        const ChannelEntry& channel = segment_.channels()[below(6)];
        const std::uint64_t granule = channel.granule % geometry_.granules;
        const std::uint64_t granules =
            std::min<std::uint64_t>(1 + channel.granules % 4, geometry_.granules - granule);
        return segment_.granule_offset(static_cast<std::uint32_t>(granule)) +
               below(std::min<std::uint64_t>(granules * kGranule, 2048));
      }
    }
  }

  std::uint32_t value_for(std::uint32_t before) {
    switch (below(7)) {
      case 0:
        return 0;
      case 1:
        return ~std::uint32_t{0};
      case 2:
        return before ^ (1U << below(32));
      case 3:
        return before + 1;
      case 4:
        return static_cast<std::uint32_t>(below(1024));
      case 5:
        return static_cast<std::uint32_t>(segment_.granules().count() - below(4));
      default:
        return static_cast<std::uint32_t>(random_());
    }
  }

  segment::Segment segment_;
  const segment::Geometry geometry_;
  std::mt19937_64& random_;
};

}  // namespace

TEST_SUITE_BEGIN("scribble");

TEST_CASE("changed words of the tables lead no process outside of the segment") {
  const Watchdog watchdog(600);
  constexpr int kChanges = 10'000;
  constexpr int kOfOneSegment = 200;
  std::mt19937_64 random(seed());
  int crashed = 0;
  for (int round = 0; round < kChanges / kOfOneSegment; ++round) {
    auto options = fresh(16 << 20);
    options.blocks = 128;
    const std::string path = options.directory + "/" + options.segment;
    std::vector<Child> others;
    for (const Role role : kRoles) others.emplace_back([&] { work(options, role); });
    others.emplace_back([&] { look_from_outside(options); });
    REQUIRE(eventually([&] { return access(path.c_str(), F_OK) == 0; }));
    std::this_thread::sleep_for(30ms);
    std::optional<Scribbler> scribbler;
    REQUIRE(eventually([&] {
      try {
        scribbler.emplace(options, random);
      } catch (const lot::Error& e) {  // the last role has left, and none has come yet
        must(e.error_number() == ENOENT, e.what());
      }
      return scribbler.has_value();
    }));
    for (int n = 0; n < kOfOneSegment; ++n) {
      scribbler->change();
      if (n % 4 == 0) std::this_thread::sleep_for(1ms);
    }
    scribbler.reset();
    std::this_thread::sleep_for(20ms);
    for (std::size_t i = 0; i < others.size(); ++i) {
      int status = 0;
      if (!others[i].ended(status)) {
        others[i].kill9();
        continue;
      }
      ++crashed;
      std::printf("round %d: role %zu ended with %d\n", round, i, status);
    }
    unlink(path.c_str());
    for (const char* other : {".lock", ".new"}) unlink((path + other).c_str());
  }
  CHECK(crashed == 0);
}

TEST_SUITE_END();
