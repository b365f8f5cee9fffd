// SPDX-License-Identifier: Apache-2.0
#include "node.hpp"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <exception>
#include <fstream>
#include <new>
#include <string_view>

#include "canary.hpp"
#include "jobs.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

volatile std::sig_atomic_t leave_requested = 0;

namespace {

/// The supervisor has blocked SIGTERM: one that came before this is still pending, though a
/// process that is the first of its PID namespace would have ignored it.
void listen_for_the_end() {
  struct sigaction action {};
  action.sa_handler = [](int) { leave_requested = 1; };
  sigaction(SIGTERM, &action, nullptr);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
}

void plant_in_segment(Life& life) {
  const std::string path = life.epoch.engine.directory + "/" + life.epoch.engine.segment;
  if (life.has(life.epoch.rests ? Plant::Leak : Plant::LeakAtEnd)) {
    segment::Segment s(path);
    const std::uint32_t nobody = s.capacity().participants - 1;
    using Own = refcount::Ownership<segment::Atomics>;
    test::raw(Own::word(s.block(s.capacity().blocks - 1), nobody)).fetch_or(Own::bit(nobody));
  } else if (life.has(Plant::Keep)) {
    segment::Segment s(path);
    const std::uint32_t nobody = s.capacity().participants - 1;
    for (auto& topic : s.topics()) {
      if (topic.users[0].load() == 0 || topic.name != std::string_view("/shape")) continue;
      using Own = refcount::Ownership<segment::Atomics>;
      test::raw(topic.users[nobody / segment::Atomics::kBitsPerWord]).fetch_or(Own::bit(nobody));
    }
  } else if (life.has(Plant::Spoil)) {
    segment::Segment s(path);
    for (auto& topic : s.topics()) {
      const std::uint64_t word = topic.description.load();
      if (topic.users[0].load() == 0 || word == 0) continue;
      s.descriptions()[segment::description_offset(word) / sizeof(std::uint64_t)] ^= 1;
      break;
    }
  } else if (life.has(Plant::File)) {
    std::ofstream(path + ".stray") << "left";
  }
}

/// Does all jobs by turns until it is told to leave.
void work(Life& life, Jobs& jobs) {
  const bool stays = life.slot == 1 && life.has(Plant::Stay);
  for (unsigned round = 0; !life.stopping() || stays; ++round) {
    const Stage stage = life.stage();
    const std::uint32_t checkpoint = life.board.checkpoint.load();
    bool settled = true;
    life.doing(Doing::Running);
    for (auto& job : jobs) {
      if (stage == Stage::Run || stage == Stage::Awake) job->turn();
      if (stage == Stage::Quiet) job->quiet();
      if (stage == Stage::Settle) settled &= job->settle();
    }
    if (settled) {
      life.me.reached.store(step_of(checkpoint, stage), std::memory_order_release);
      if (stage == Stage::Settle) std::this_thread::sleep_for(2ms);
    }
    if (life.slot != 1 || round != 20) continue;
    if (life.has(Plant::Wedge)) {
      for (;;) pause();
    }
    if (life.has(Plant::Crash)) std::abort();
  }
}

/// Items that are for one wait when all others have ended: this one takes them. What keeps it from
/// that stays, and is found as a leak.
void take_what_waits(Board& board, const Settings& settings, const Epoch& epoch, ShmEngine& engine,
                     segment::Segment& s) {
  Life life(board, settings, epoch, kMostNodes);
  Jobs jobs;
  for (std::uint32_t t = kFirstTaken; t < kFirstShape; ++t) {
    jobs.push_back(make_inlet(life, engine, t));
  }
  const auto no_rings = [&] {
    bool settled = true;
    for (auto& job : jobs) settled &= job->settle();
    return settled && testing::Audit(s).channels == 0;
  };
  testing::eventually(no_rings, settings.patience / 2);
}

}  // namespace

void open_engine(Life& life, std::optional<ShmEngine>& engine) {
  life.doing(Doing::Opening);
  EngineOptions options = life.epoch.engine;
  options.name = "chaos" + std::to_string(life.slot);
  engine.emplace(options);
  life.count(Count::Opened);
}

int run_node(Board& board, const Settings& settings, const Epoch& epoch, unsigned slot) {
  Life life(board, settings, epoch, slot);
  life.doing(Doing::Starting);
  listen_for_the_end();
  try {
    std::optional<ShmEngine> engine;
    open_engine(life, engine);
    if (slot == 0) plant_in_segment(life);
    Jobs jobs = make_jobs(life, engine);
    work(life, jobs);
    life.doing(Doing::Leaving);
    if (life.random.chance(50)) engine.reset();
    std::shuffle(jobs.begin(), jobs.end(), std::mt19937_64(life.random.next()));
    jobs.clear();
    life.doing(Doing::Leaving);
    engine.reset();
  } catch (const std::bad_alloc& e) {
    life.no_memory(e.what());
    return kNoRoom;
  } catch (const Error& e) {
    if (e.error_number() == EBUSY && has_stalled(board)) return kStalled;
    life.fail(Finding::Crashed, e.what());
  } catch (const std::exception& e) {
    life.fail(Finding::Crashed, e.what());
  }
  return kLeft;
}

int run_last(Board& board, const Settings& settings, const Epoch& epoch) {
  try {
    EngineOptions options = epoch.engine;
    options.name = "last";
    ShmEngine engine(options);
    board.last_came.store(1);
    while (board.last_alone.load() == 0) std::this_thread::sleep_for(1ms);
    segment::Segment s(engine.path());
    take_what_waits(board, settings, epoch, engine, s);
    const auto clean = [&s] {
      const testing::Audit audit(s);
      return audit.nothing() && audit.participants == 1;
    };
    if (!testing::eventually(clean, settings.patience)) {
      board.report(Finding::Leaked, kMostNodes, "after all had ended: " + testing::Audit(s).text());
    }
  } catch (const std::exception& e) {
    board.report(Finding::Crashed, kMostNodes, std::string("the last one: ") + e.what());
    return kFaulty;
  }
  return kLeft;
}

}  // namespace lot::chaos
