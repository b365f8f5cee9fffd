// SPDX-License-Identifier: Apache-2.0

// Processes whose monotonic clocks disagree: containers have time namespaces.

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <fstream>
#include <sched.h>
#include <string>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/janitor.hpp"
#include "support/must_go.hpp"
#include "support/neighbour.hpp"

namespace {

using namespace lot::testing;
using lot::Policy;
using lot::Status;
using lot::Wait;

struct Number {
  std::uint64_t value;
};

[[maybe_unused]] const bool has_janitor = start_janitor();

/// Moves this process, which must have one thread, to a time namespace whose monotonic clock is
/// `seconds` ahead. Returns why it cannot, or "".
std::string enter_time_namespace(long seconds) {
  const auto reason = [](const char* what) { return std::string(what) + ": " + strerror(errno); };
  const uid_t uid = getuid();
  const gid_t gid = getgid();
  if (unshare(CLONE_NEWTIME) == -1) {
    if (errno != EPERM) return reason("unshare(CLONE_NEWTIME)");
    if (unshare(CLONE_NEWUSER | CLONE_NEWTIME) == -1) return reason("unshare(CLONE_NEWUSER)");
    std::ofstream("/proc/self/setgroups") << "deny";
    std::ofstream("/proc/self/uid_map") << uid << ' ' << uid << " 1";
    std::ofstream("/proc/self/gid_map") << gid << ' ' << gid << " 1";
  }
  std::ofstream offsets("/proc/self/timens_offsets");
  if (!(offsets << "monotonic " << seconds << " 0" << std::flush)) return reason("timens_offsets");
  const int children = open("/proc/self/ns/time_for_children", O_RDONLY | O_CLOEXEC);
  if (children == -1) return reason("time_for_children");
  const int result = setns(children, CLONE_NEWTIME);
  const std::string why = result == -1 ? reason("setns") : "";
  close(children);
  return why;
}

long long monotonic_seconds() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec;
}

/// The monotonic clock can be set back as far as the machine's uptime only.
long offset(bool ahead) { return ahead ? 100'000'000 : -(static_cast<long>(monotonic_seconds())); }

/// Why there are no time namespaces here, or "".
const std::string& lacking() {
  static const std::string why = [] {
    std::string text;
    int ends[2];
    if (pipe(ends) != 0) return std::string("pipe");
    Child probe([&] {
      const std::string reason = enter_time_namespace(1000);
      (void)!write(ends[1], reason.data(), reason.size());
    });
    probe.wait();
    close(ends[1]);
    char buffer[200];
    const ssize_t n = read(ends[0], buffer, sizeof(buffer));
    close(ends[0]);
    return std::string(buffer, n > 0 ? static_cast<std::size_t>(n) : 0);
  }();
  return why;
}

/// Says that a case can not be run here.
bool skipped() {
  if (lacking().empty()) return false;
  MESSAGE(lacking());
  std::printf("skipped: no time namespaces here\n");
  return true;
}

/// A process in a time namespace.
template <class F>
Child displaced(bool ahead, F&& f) {
  return Child([&] {
    const long long before = monotonic_seconds();
    const long by = offset(ahead);
    must(enter_time_namespace(by).empty(), "a time namespace");
    const long long now = monotonic_seconds() - by;
    must(now >= before && now < before + 1000, "its clock is another one");
    f();
  });
}

}  // namespace

TEST_SUITE_BEGIN("time namespaces");

TEST_CASE("messages cross between monotonic clocks that are years apart, each way of waiting") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  for (const bool ahead : {true, false}) {
    for (const auto wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
      CAPTURE(ahead);
      CAPTURE(static_cast<int>(wait));
      const Ground options;
      Steps ready;
      Child echo = displaced(ahead, [&] {
        lot::ShmEngine engine(options);
        auto in = engine.subscribe<Number>("/to", {wait, 0});
        auto out = engine.advertise<Number>("/from", {Policy::Block, 4, 30s});
        ready.tell();
        for (std::uint64_t n = 0; n < 200; ++n) {
          const auto seen = in.pull(30s);
          must(seen && seen->value == n, "each number");
          must(out.push(seen) == Status::Ok, "back");
        }
      });
      REQUIRE(ready.next() == '.');
      lot::ShmEngine engine(options);
      auto out = engine.advertise<Number>("/to", {Policy::Block, 4, 30s});
      auto in = engine.subscribe<Number>("/from", {wait, 0});
      REQUIRE(out.wait_for_readers(1, 30s));
      for (std::uint64_t n = 0; n < 200; ++n) {
        REQUIRE(out.push(out.loan(n)) == Status::Ok);
        const auto seen = in.pull(30s);
        REQUIRE(seen);
        CHECK(seen->value == n);
        if (n % 50 == 0) usleep(2000);  // both sleep
      }
      CHECK(echo.wait() == 0);
    }
  }
}

TEST_CASE("deadlines are measured on one's own clock, on one word and on many") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  for (const bool ahead : {true, false}) {
    CAPTURE(ahead);
    const Ground options;
    Child waiting = displaced(ahead, [&] {
      using Clock = std::chrono::steady_clock;
      lot::ShmEngine engine(options);
      auto none = engine.subscribe<Number>("/none", {Wait::Park, 0});
      auto first = engine.advertise<Number>("/two", {Policy::Block, 2, 1s});
      auto second = engine.advertise<Number>("/two");
      auto two = engine.subscribe<Number>("/two", {Wait::Park, 0});
      for (auto* puller : {&none, &two}) {
        const Status end = puller == &none ? Status::PublisherGone : Status::Timeout;
        const auto start = Clock::now();
        must(!puller->pull(120ms) && puller->status() == end, "its end");
        must(Clock::now() - start >= 120ms, "not before its time");
      }
      for (int n = 0; n < 2; ++n) must_go(first.push(first.loan()));
      const auto start = Clock::now();
      must(first.push(first.loan(), 120ms) == Status::Full, "Full");
      must(Clock::now() - start >= 120ms, "not before its time");
      must(!first.wait_for_readers(2, 20ms), "readers that do not come");
    });
    CHECK(waiting.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a sleeper on another clock is woken, and is reaped when it is killed, both ways") {
  const Watchdog watchdog(60);
  if (skipped()) return;
  for (const bool ahead : {true, false}) {
    for (const bool victim_is_displaced : {true, false}) {
      CAPTURE(ahead);
      CAPTURE(victim_is_displaced);
      const Ground options;
      Steps asleep_now, room, killed, done;
      const auto sleeper = [&] {
        lot::ShmEngine engine(named(options, "victim"));
        auto puller = engine.subscribe<Number>("/t", {Wait::Park, 0});
        asleep_now.tell('0');
        const auto seen = puller.borrow();  // no deadline: it must be woken
        must(seen->value == 0, "the first");
        asleep_now.tell();
        pause();
      };
      const auto sender = [&] {
        lot::ShmEngine engine(named(options, "sender"));
        auto pusher = engine.advertise<Number>("/t", {Policy::Block, 2, 30s});
        must(asleep_now.next() == '0', "the reader");
        must(pusher.wait_for_readers(1, 10s), "the reader");
        usleep(20000);
        must_go(pusher.push(pusher.loan(std::uint64_t{0})));
        must(asleep_now.next() == '.', "it was woken");
        must_go(pusher.push(pusher.loan(std::uint64_t{1})));
        room.tell();
        // Full: goes on when the reader is killed and has been reaped.
        must(pusher.push(pusher.loan(std::uint64_t{2})) == Status::Ok, "room after its death");
        killed.tell();
        must(done.next() == '.', "the end");
      };
      Child second = victim_is_displaced ? Child(sender) : displaced(ahead, sender);
      Child first = victim_is_displaced ? displaced(ahead, sleeper) : Child(sleeper);
      REQUIRE(room.next() == '.');
      usleep(20000);
      first.kill9();
      CHECK(killed.next() == '.');
      {
        lot::segment::Segment segment(file_of(options));
        CHECK(eventually([&] { return index_of(segment, "victim") == 0; }));
        CHECK(index_of(segment, "sender") != 0);
      }
      done.tell();
      CHECK(second.wait() == 0);
      CHECK(files_of(options) == 0);
    }
  }
}

TEST_SUITE_END();
