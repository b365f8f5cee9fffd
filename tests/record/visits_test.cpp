// SPDX-License-Identifier: Apache-2.0

// When a recorder visits a topic by its timer, and when a push has to wake it.

#include "record/visits.hpp"

#include <chrono>
#include <cstdarg>
#include <cstdint>
#include <linux/futex.h>
#include <sys/syscall.h>
#include <thread>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "record/scene.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {
thread_local unsigned wakes = 0;  ///< system calls of this thread that wake
}  // namespace

extern "C" {
long __real_syscall(long number, ...);
long __wrap_syscall(long number, ...) {
  va_list list;
  va_start(list, number);
  long words[6];
  for (long& word : words) word = va_arg(list, long);
  va_end(list);
  if (number == SYS_futex && words[1] == FUTEX_WAKE) ++wakes;
  return __real_syscall(number, words[0], words[1], words[2], words[3], words[4], words[5]);
}
}

namespace lot::testing {
namespace {

using namespace std::chrono_literals;
using record::Visits;

constexpr std::uint32_t kDepth = 16;
constexpr unsigned kQuiet = 20;       // decisions
constexpr unsigned kWary = 600;       // decisions
constexpr std::uint64_t kFast = 100;  // an eighth of the queue in each of 50 visits

/// A span with so many messages, one at each look.
void pass(Visits& visits, std::uint64_t messages) {
  for (std::uint64_t i = 0; i < messages; ++i) visits.took(1, 0);
  visits.decide(kDepth);
}

TEST_SUITE_BEGIN("record");

TEST_CASE("a topic is visited from its first steady span on, and until it is quiet") {
  Visits visits;
  CHECK(!visits.by_timer());
  pass(visits, 0);
  CHECK(!visits.by_timer());
  pass(visits, 3);
  CHECK(visits.by_timer());
  for (unsigned i = 1; i < kQuiet; ++i) pass(visits, 0);
  CHECK(visits.by_timer());
  pass(visits, 1);  // a message: the quiet begins anew
  for (unsigned i = 1; i < kQuiet; ++i) pass(visits, 0);
  CHECK(visits.by_timer());
  pass(visits, 0);
  CHECK(!visits.by_timer());
  pass(visits, 0);
  CHECK(!visits.by_timer());
}

TEST_CASE("a topic that is too fast for its queue is listened to, as long as it is") {
  Visits visits;
  pass(visits, kFast + 1);
  CHECK(!visits.by_timer());
  pass(visits, kFast);
  CHECK(visits.by_timer());
  pass(visits, kFast + 1);
  CHECK(!visits.by_timer());
  pass(visits, kFast);
  CHECK(visits.by_timer());
  for (int i = 0; i < 8; ++i) visits.took(1, 0);
  visits.decide(1);  // a queue of one message has come
  CHECK(!visits.by_timer());
}

TEST_CASE("a burst that fills half of a queue between two visits: no visits for a minute") {
  for (const std::uint64_t missed : {std::uint64_t{0}, std::uint64_t{4}}) {
    CAPTURE(missed);
    Visits visits;
    visits.took(kDepth, missed);  // it listens yet: what one look takes says nothing
    visits.decide(kDepth);
    REQUIRE(visits.by_timer());
    visits.took(kDepth / 2 - missed, missed);
    visits.decide(kDepth);
    REQUIRE(visits.by_timer());
    visits.took(kDepth / 2 + 1 - missed, missed);
    visits.decide(kDepth);
    CHECK(!visits.by_timer());
    for (unsigned i = 1; i < kWary; ++i) {
      pass(visits, 3);
      REQUIRE(!visits.by_timer());
    }
    pass(visits, 3);
    CHECK(visits.by_timer());
  }
}

/// A publisher whose system calls are counted.
struct Steady {
  explicit Steady(Scene& scene) : notes(scene.engine.advertise<Note>("/notes", options())) {}
  static PusherOptions options() {
    PusherOptions options;
    options.depth = kDepth;
    return options;
  }
  /// Whether the push of one message has woken a process.
  bool wakes_by_one() {
    auto note = notes.loan();
    note->number = ++sent;
    const unsigned before = wakes;
    must_go(notes.push(std::move(note)));
    return wakes != before;
  }
  /// Whether so many pushes in succession, each some time after the other, wake or do not wake.
  bool eventually_all(bool wake, unsigned pushes) {
    unsigned in_succession = 0;
    return eventually(
        [&] {
          std::this_thread::sleep_for(10ms);  // slow enough for its queue
          in_succession = wakes_by_one() == wake ? in_succession + 1 : 0;
          return in_succession == pushes;
        },
        60s);
  }
  ShmPusher<Note> notes;
  std::uint64_t sent = 0;
};

TEST_CASE("a recorder of a steady topic costs its publisher no system call; all is recorded") {
  const Watchdog watchdog(200);
  Scene scene;
  Steady steady(scene);
  Recorder recorder(scene.what(), scene.where);
  CHECK(steady.eventually_all(false, 50));
  // A burst as large as the queue, between two visits: from then on pushes wake it again.
  CHECK(eventually(
      [&] {
        for (std::uint32_t i = 0; i < kDepth; ++i) steady.wakes_by_one();
        std::this_thread::sleep_for(150ms);
        return steady.wakes_by_one();
      },
      60s));
  CHECK(steady.eventually_all(true, 3));
  recorder.stop();
  const auto told = recorder.status();
  CHECK(topic_of(told, "/notes")->messages + topic_of(told, "/notes")->missed == steady.sent);
}

TEST_CASE("a quiet topic is listened to: its next message wakes the recorder") {
  const Watchdog watchdog(200);
  Scene scene;
  Steady steady(scene);
  Recorder recorder(scene.what(), scene.where);
  REQUIRE(steady.eventually_all(false, 50));
  CHECK(eventually(
      [&] {
        std::this_thread::sleep_for(2500ms);
        return steady.wakes_by_one();
      },
      60s));
  CHECK(eventually([&] { return recorded(recorder, "/notes") == steady.sent; }));
}

TEST_SUITE_END();

}  // namespace
}  // namespace lot::testing
