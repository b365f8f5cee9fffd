// SPDX-License-Identifier: Apache-2.0

// Processes that are stopped (SIGSTOP) for longer than all their deadlines, and continued.

#include <atomic>
#include <csignal>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "registry/registry.hpp"
#include "support/janitor.hpp"
#include "support/lock_owner.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"
#include "support/seed.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;
using lot::Wait;

struct Number {
  std::uint64_t value;
};
struct Frame {
  std::uint64_t number;
  lot::ShmVector<std::uint64_t> data;
};

[[maybe_unused]] const bool has_janitor = start_janitor();

/// Long enough to be stopped in, on a machine that has much else to do.
constexpr auto kDeadline = 3s;

/// What the EBUSY of it says; nothing when there was none. Other errors pass.
template <class F>
std::string refusal(F&& use) {
  try {
    use();
  } catch (const lot::Error& e) {
    if (e.error_number() != EBUSY) throw;
    return e.what();
  }
  return {};
}

bool names_it(const std::string& text, const Child& stopped) {
  return text.find("process " + std::to_string(stopped.pid()) + " (") != std::string::npos &&
         text.find("is stopped") != std::string::npos;
}

/// Stops a process, and waits until it stands.
void stop(const Child& child) {
  child.send(SIGSTOP);
  int status = 0;
  REQUIRE(waitpid(child.pid(), &status, WUNTRACED) == child.pid());
  REQUIRE(WIFSTOPPED(status));
}

thread_local int looks_at_the_clock = 0;            ///< until this thread is held up
thread_local std::function<void()> meanwhile = {};  ///< what happens then, in an hour

}  // namespace

// The linker (--wrap) sends the callers of steady_clock::now() to the second of these.
std::chrono::steady_clock::time_point true_time() asm(
    "__real__ZNSt6chrono3_V212steady_clock3nowEv");
std::chrono::steady_clock::time_point time_held_up() asm(
    "__wrap__ZNSt6chrono3_V212steady_clock3nowEv");
std::chrono::steady_clock::time_point time_held_up() {
  if (looks_at_the_clock == 0 || --looks_at_the_clock != 0) return true_time();
  meanwhile();
  return true_time() + std::chrono::hours(1);
}

TEST_SUITE_BEGIN("stopped");

TEST_CASE("a reader that is held up between its last look and the clock gets what came meanwhile") {
  const Watchdog watchdog(60);
  const Ground options;
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Number>("/t");
  for (const auto wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
    for (int look = 1; look <= 4; ++look) {
      CAPTURE(static_cast<int>(wait));
      CAPTURE(look);
      auto puller = engine.subscribe<Number>("/t", {wait, 0});
      meanwhile = [&] { must_go(pusher.push(pusher.loan(std::uint64_t{7}))); };
      looks_at_the_clock = look;
      const auto seen = puller.pull(100ms);
      if (looks_at_the_clock == 0) CHECK((seen && seen->value == 7));
      looks_at_the_clock = 0;
    }
  }
}

TEST_CASE("the dead are found although the one that the kernel wakes is stopped") {
  const Watchdog watchdog(120);
  const Ground options;
  Steps joined, done;
  Child stopped = member(options, "stopped", joined, done);
  REQUIRE(joined.next() == '.');
  Child living = member(options, "living", joined, done);
  REQUIRE(joined.next() == '.');
  for (int death = 0; death < 3; ++death) {
    CAPTURE(death);
    Child dying = member(options, "dying", joined, done);
    REQUIRE(joined.next() == '.');
    lot::segment::Segment s(file_of(options));
    usleep(1200000);  // both watch it by now
    stop(stopped);
    dying.kill9();
    CHECK(eventually([&] { return index_of(s, "dying") == 0; }));
    stopped.send(SIGCONT);
  }
  for (int i = 0; i < 2; ++i) done.tell();
  CHECK(stopped.wait() == 0);
  CHECK(living.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a reader that is stopped past its deadline gets the message that came, or Timeout") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps ready, all_stopped, done, all_done;
  Child writer([&] {
    lot::ShmEngine engine(named(options, "writer"));
    auto pusher = engine.advertise<Number>("/message");
    auto silent = engine.advertise<Number>("/silence");
    ready.tell();
    must(all_stopped.next() == '.', "the readers are stopped");
    for (std::uint64_t n = 0; n < 3; ++n) must_go(pusher.push(pusher.loan(n)));
    must(all_done.next() == '.', "the readers have ended");  // they would hear of its end
  });
  REQUIRE(ready.next() == '.');
  std::vector<Child> readers;
  for (const bool message : {true, false}) {
    for (const auto wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
      readers.emplace_back([&, message, wait] {
        lot::ShmEngine engine(named(options, "reader"));
        auto puller = engine.subscribe<Number>(message ? "/message" : "/silence", {wait, 0});
        ready.tell();
        const auto seen = puller.pull(kDeadline);
        must(bool(seen) == message, "the message, or none");
        must(puller.status() == (message ? Status::Ok : Status::Timeout), "the status");
        must(!message || seen->value == 0, "the oldest of them");
        must(done.next() == '.', "the end");
      });
      REQUIRE(ready.next() == '.');
      stop(readers.back());
    }
  }
  lot::segment::Segment s(file_of(options));
  const auto before = taken(s);
  CHECK(before.size() == readers.size() + 2);
  all_stopped.tell();
  std::this_thread::sleep_for(kDeadline + 100ms);
  CHECK(taken(s) == before);
  for (const auto& r : readers) r.send(SIGCONT);
  for (std::size_t i = 0; i < readers.size(); ++i) done.tell();
  for (auto& r : readers) CHECK(r.wait() == 0);
  all_done.tell();
  CHECK(writer.wait() == 0);
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a publisher that is stopped past its deadline says Full, or Ok when there is room") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps joined, pushing, done;
  Steps with_room, without_room;
  std::vector<Child> writers;
  for (const bool room : {true, false}) {
    writers.emplace_back([&, room] {
      lot::ShmEngine engine(named(options, "writer"));
      auto pusher =
          engine.advertise<Number>(room ? "/room" : "/full", {Policy::Block, 2, kDeadline});
      joined.tell();
      must(pusher.wait_for_readers(1, 10s), "the reader");
      for (std::uint64_t n = 0; n < 2; ++n) must_go(pusher.push(pusher.loan(n)));
      auto third = pusher.loan(std::uint64_t{2});
      pushing.tell();
      const Status status = pusher.push(std::move(third));
      must(status == (room ? Status::Ok : Status::Full), "the status");
      must(bool(third) != room, "what was not pushed stays with the caller");
      (room ? with_room : without_room).tell();
      must(done.next() == '.', "the end");
    });
    REQUIRE(joined.next() == '.');
  }
  {
    lot::ShmEngine engine(options);
    auto room = engine.subscribe<Number>("/room");
    auto full = engine.subscribe<Number>("/full");
    for (std::size_t i = 0; i < writers.size(); ++i) REQUIRE(pushing.next() == '.');
    usleep(20000);
    for (const auto& w : writers) stop(w);
    lot::segment::Segment s(engine.path());
    const auto before = taken(s);
    CHECK(before.size() == 4);
    CHECK(room.pull(1s)->value == 0);
    std::this_thread::sleep_for(kDeadline + 100ms);
    CHECK(taken(s) == before);
    for (const auto& w : writers) w.send(SIGCONT);
    CHECK(with_room.next() == '.');
    CHECK(without_room.next() == '.');
    for (const std::uint64_t n : {1U, 2U}) CHECK(room.pull(1s)->value == n);
    for (const std::uint64_t n : {0U, 1U}) CHECK(full.pull(1s)->value == n);
    CHECK(full.try_pull() == nullptr);
    for (std::size_t i = 0; i < writers.size(); ++i) done.tell();
    for (auto& w : writers) CHECK(w.wait() == 0);
  }
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a stopped reader that borrows: Policy::Block waits, Overwrite goes on, the bytes stay") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  {
    lot::ShmEngine engine(options);
    auto block = engine.advertise<Number>("/block", {Policy::Block, 2, 100ms});
    auto overwrite = engine.advertise<Number>("/overwrite", {Policy::Overwrite, 2, 100ms});
    Steps borrowing, done;
    Child reader([&] {
      lot::ShmEngine own(named(options, "reader"));
      auto blocked = own.subscribe<Number>("/block");
      auto overwritten = own.subscribe<Number>("/overwrite");
      borrowing.tell();
      auto one = blocked.borrow(10s);
      auto two = overwritten.borrow(10s);
      borrowing.tell();
      must(done.next() == '.', "the order");
      must(one && one->value == 0 && two && two->value == 0, "the bytes are as they were");
      one.end();
      two.end();
      must(blocked.pull(10s)->value == 1 && blocked.missed() == 0, "the next");
      must(overwritten.pull(10s)->value == 99 && overwritten.missed() == 98, "what was missed");
      borrowing.tell();
      must(done.next() == '.', "the end");
    });
    REQUIRE(borrowing.next() == '.');
    must_go(block.push(block.loan(std::uint64_t{0})));
    must_go(overwrite.push(overwrite.loan(std::uint64_t{0})));
    REQUIRE(borrowing.next() == '.');
    stop(reader);
    lot::segment::Segment s(engine.path());
    CHECK(block.push(block.loan(std::uint64_t{1})) == Status::Ok);
    CHECK(block.push(block.loan(std::uint64_t{2})) == Status::Full);
    for (std::uint64_t n = 1; n <= 100; ++n) {
      CHECK(overwrite.push(overwrite.loan(n)) == Status::Ok);
    }
    CHECK(index_of(s, "reader") != 0);
    reader.send(SIGCONT);
    done.tell();
    CHECK(borrowing.next() == '.');
    CHECK(block.push(block.loan(std::uint64_t{2})) == Status::Ok);
    done.tell();
    CHECK(reader.wait() == 0);
  }
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

/// A process that keeps the registry's lock until it is told.
void keep_registry(const lot::EngineOptions& where, Steps& inside, Steps& done) {
  lot::ShmEngine engine(where);
  lot::segment::Segment s(engine.path());
  InOurName name(s);
  lot::registry::Registry registry(s, name);
  const lot::registry::Registry::Lock lock(registry);
  inside.tell();
  must(done.next() == '.', "continued");
}

TEST_CASE("a process stopped inside a lock of slow paths: others get errors that say so, no hang") {
  const Watchdog watchdog(60);
  const Ground registry_kept, gate_kept;
  Steps inside, done;
  // One keeps the registry of the first segment, one the gate of the second.
  Child in_registry([&] { keep_registry(registry_kept, inside, done); });
  REQUIRE(inside.next() == '.');
  stop(in_registry);
  Child waits_for_registry([&] {
    lot::ShmEngine engine(registry_kept);
    const std::string text = refusal([&] { return engine.advertise<Number>("/t"); });
    must(names_it(text, in_registry), text.c_str());
    inside.tell();
    must(done.next() == '.', "continued");
    (void)engine.advertise<Number>("/t");  // it does not throw
  });

  Steps joined, leave;
  Child leaves([&] {
    const lot::ShmEngine engine(named(gate_kept, "leaves"));
    joined.tell();
    must(leave.next() == '.', "the order");
  });
  REQUIRE(joined.next() == '.');
  Steps in_gate;
  Child keeps_gate([&] {
    lot::liveness::LockFile file(file_of(gate_kept) + ".lock");
    must(file.enter_gate(5s), "the gate");
    in_gate.tell();
    pause();
  });
  REQUIRE(in_gate.next() == '.');
  stop(keeps_gate);
  leave.tell();
  const std::string refused = refusal([&] { const lot::ShmEngine engine(gate_kept); });
  CHECK_MESSAGE(names_it(refused, keeps_gate), refused);
  CHECK(leaves.wait() == 0);
  lot::segment::Segment s(file_of(gate_kept));
  CHECK(index_of(s, "leaves") == 0);  // it has given up everything but the files
  CHECK(files_of(gate_kept) == 2);
  keeps_gate.kill9();
  { const lot::ShmEngine engine(gate_kept); }  // the next one takes them along
  CHECK(files_of(gate_kept) == 0);

  CHECK(inside.next() == '.');
  in_registry.send(SIGCONT);
  for (int i = 0; i < 2; ++i) done.tell();
  CHECK(in_registry.wait() == 0);
  CHECK(waits_for_registry.wait() == 0);
  CHECK(files_of(registry_kept) == 0);
}

TEST_CASE("a subscriber that goes while a stopped process keeps the registry leaves its topic") {
  const Watchdog watchdog(60);
  const Ground options;
  Steps inside, done;
  lot::ShmEngine engine(options);
  std::optional puller(engine.subscribe<Number>("/left"));
  Child keeps([&] { keep_registry(options, inside, done); });
  REQUIRE(inside.next() == '.');
  stop(keeps);
  puller.reset();
  keeps.send(SIGCONT);
  done.tell();
  CHECK(keeps.wait() == 0);
  CHECK(eventually([&] { return !engine.type_of("/left"); }));
}

TEST_CASE("a process is stopped while it joins or leaves: others get in, or hear which one it is") {
  const Watchdog watchdog(120);
  std::mt19937_64 random(seed());
  int refused = 0;
  for (int round = 0; round < 20; ++round) {
    const Ground options;
    Steps begun;
    Child comes_and_goes([&] {
      begun.tell();
      for (;;) {
        try {
          const lot::ShmEngine engine(options);
        } catch (const lot::Error&) {
        }
      }
    });
    REQUIRE(begun.next() == '.');
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 12000));
    stop(comes_and_goes);
    const std::string text = refusal([&] { const lot::ShmEngine engine(options); });
    CHECK_MESSAGE((text.empty() || names_it(text, comes_and_goes)), text);
    refused += !text.empty();
    comes_and_goes.kill9();
    { const lot::ShmEngine engine(options); }  // takes along what was left
    CHECK(files_of(options) == 0);
  }
  MESSAGE(refused << " of 20 heard which one was stopped, the others got in");
}

TEST_CASE("while one thread waits for the gate of a segment, another grows messages in its own") {
  const Watchdog watchdog(60);
  const Ground ours, stuck;
  Steps in_gate, result, done;
  Child keeps_gate([&] {
    lot::liveness::LockFile file(file_of(stuck) + ".lock");
    must(file.enter_gate(5s), "the gate");
    in_gate.tell();
    must(done.next() == '.', "the end");
    file.leave_gate();
  });
  REQUIRE(in_gate.next() == '.');
  stop(keeps_gate);
  Child node([&] {
    lot::ShmEngine engine(ours);
    auto pusher = engine.advertise<Frame>("/t");
    bool overlapped = false;
    for (int attempt = 0; attempt < 3 && !overlapped;
         ++attempt) {  // a slow machine may be too slow
      std::atomic<bool> waits{true};
      std::thread joiner([&] {
        try {
          const lot::ShmEngine other(stuck);
        } catch (const lot::Error&) {
        }
        waits = false;
      });
      std::this_thread::sleep_for(50ms);
      auto frame = pusher.loan();
      frame->data.resize(1 << 17);
      must(pusher.push(std::move(frame)) == Status::Ok, "a push");
      overlapped = waits;
      if (overlapped) result.tell();
      joiner.join();
    }
    must(overlapped, "a message grew while the other thread waited");
  });
  CHECK(result.next(40s) == '.');
  keeps_gate.send(SIGCONT);
  done.tell();
  CHECK(keeps_gate.wait() == 0);
  CHECK(node.wait() == 0);
  CHECK(files_of(ours) + files_of(stuck) == 0);
}

TEST_SUITE_END();
