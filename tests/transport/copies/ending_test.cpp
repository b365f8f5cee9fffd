// SPDX-License-Identifier: Apache-2.0

// What a process leaves that ends with everything alive: exit, exec, static objects.

#include <csignal>
#include <fcntl.h>
#include <random>
#include <string>
#include <sys/resource.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

struct Number {
  std::uint64_t value;
};

/// A process that has said that it waits for a signal. `said`: what reads its further words.
Child start_and_wait(const char* how, const lot::EngineOptions& options, int* said = nullptr) {
  int out[2];
  must(pipe2(out, O_CLOEXEC) == 0, "pipe");
  Child child([&] {
    dup2(out[1], STDOUT_FILENO);
    execl(LOT_ENDING, LOT_ENDING, how, options.directory.c_str(), options.segment.c_str(), nullptr);
    must(false, LOT_ENDING);
  });
  close(out[1]);
  char text[7] = {};
  must(read(out[0], text, 6) == 6 && std::string(text) == "ready.", "it is ready");
  if (said == nullptr) {
    close(out[0]);
  } else {
    *said = out[0];
  }
  return child;
}

Child start(const char* how, const lot::EngineOptions& options) {
  return Child([&] {
    execl(LOT_ENDING, LOT_ENDING, how, options.directory.c_str(), options.segment.c_str(), nullptr);
    must(false, LOT_ENDING);
  });
}

/// Nothing is left of the others in the engine's segment, and it works.
void check_works(lot::ShmEngine& engine) {
  lot::segment::Segment segment(engine.path());
  CHECK(eventually([&] { return Audit(segment).participants == 1; }));
  CHECK(eventually([&] { return Audit(segment).nothing(); }));
  auto pusher = engine.advertise<Number>("/u");
  auto puller = engine.subscribe<Number>("/u");
  must_go(pusher.push(pusher.loan(std::uint64_t{7})));
  const auto seen = puller.pull(10s);
  REQUIRE(seen);
  CHECK(seen->value == 7);
}

}  // namespace

TEST_SUITE_BEGIN("copies");

TEST_CASE("a process may end in any way with everything alive") {
  const Watchdog watchdog(120);
  const struct {
    const char* how;
    int status;
  } ends[] = {{"statics, pointers last", 0},
              {"statics, handles last", 0},
              {"return", 0},
              {"exit", 0},
              {"_exit", 0},
              {"quick_exit", 0},
              {"abort", 128 + SIGABRT},
              {"exit in a thread", 0},
              {"exit while threads publish", 0},
              {"publish in a static destructor", 0},
              {"start another program", 0}};
  for (const auto& end : ends) {
    CAPTURE(end.how);
    const auto options = fresh();
    {
      lot::ShmEngine engine(options);
      CHECK(start(end.how, options).wait() == end.status);
      check_works(engine);
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("static objects leave the segment, whichever goes last, and remove it") {
  const Watchdog watchdog(60);
  for (const char* how : {"statics, pointers last", "statics, handles last"}) {
    CAPTURE(how);
    const auto options = fresh();
    CHECK(start(how, options).wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("end_cleanly_on_signals: a signal ends a segment's last process, and leaves no file") {
  const Watchdog watchdog(120);
  const struct {
    const char* how;
    int signal;
  } ends[] = {{"signals", SIGINT},
              {"signals", SIGTERM},
              {"signals", SIGHUP},
              {"signals while threads publish", SIGTERM},
              {"signals, with a child", SIGTERM},
              {"signals, and main() returns", SIGTERM},
              {"signals, ignored", SIGTERM}};
  for (const auto& end : ends) {
    CAPTURE(end.how);
    CAPTURE(end.signal);
    const auto options = fresh();
    Child child = start_and_wait(end.how, options);
    CHECK(files_of(options) == 2);
    child.send(end.signal);
    CHECK(child.wait() == 128 + end.signal);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("end_cleanly_on_signals beside a process that was killed just now leaves no file") {
  const Watchdog watchdog(120);
  for (int round = 0; round < 10; ++round) {
    CAPTURE(round);
    const auto options = fresh();
    // Its end takes some time: the kernel frees this memory before it unlocks the byte. Not more
    // than the other waits for, also beside busy loops, where it may have that priority.
    Steps joined;
    Child killed([&] {
      (void)setpriority(PRIO_PROCESS, 0, -20);
      const lot::ShmEngine engine(options);
      const std::vector<char> memory(round % 2 == 0 ? std::size_t{64} << 20 : 1, 1);
      must(memory.back() == 1, "its memory");
      joined.tell();
      pause();
    });
    REQUIRE(joined.next() != 0);
    Child ends = start_and_wait("signals", options);
    killed.send(SIGKILL);
    ends.send(SIGTERM);
    CHECK(ends.wait() == 128 + SIGTERM);
    CHECK(killed.wait() == 128 + SIGKILL);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("end_cleanly_on_signals leaves files to other processes, and with persist") {
  const Watchdog watchdog(120);
  for (const int signal : {SIGINT, SIGTERM}) {
    const auto options = fresh();
    {
      lot::ShmEngine engine(options);
      Child child = start_and_wait("signals while threads publish", options);
      child.send(signal);
      CHECK(child.wait() == 128 + signal);
      check_works(engine);
    }
    CHECK(files_of(options) == 0);
  }
  for (const int signal : {SIGTERM, SIGKILL}) {
    CAPTURE(signal);
    const auto options = fresh(0);  // the size that the others have
    Child child = start_and_wait("signals, persist", options);
    Child visitor = start_and_wait("signals", options);
    child.send(signal);
    CHECK(child.wait() == 128 + signal);
    visitor.send(SIGTERM);  // it asked for nothing
    CHECK(visitor.wait() == 128 + SIGTERM);
    CHECK(files_of(options) == 2);
    { const lot::ShmEngine engine(options); }
    CHECK(files_of(options) == 2);
    remove_files_of(options);
  }
}

TEST_CASE("a signal that is sent several times leaves no file either, nor without descriptors") {
  const Watchdog watchdog(120);
  for (const char* how : {"signals", "signals while threads publish"}) {
    const auto options = fresh();
    Child child = start_and_wait(how, options);
    for (int n = 0; n < 5; ++n) child.send(n % 2 == 0 ? SIGTERM : SIGHUP);
    CHECK(child.wait() > 128);
    CHECK(files_of(options) == 0);
  }
  const auto options = fresh();
  Child child = start_and_wait("signals after closefrom", options);
  child.send(SIGTERM);
  CHECK(child.wait() == 128 + SIGTERM);
  // Without its lock file it may leave the files; the next one removes them.
  { const lot::ShmEngine engine(options); }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a signal that comes late, while another process is in the gate, leaves no file either") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Child child = start_and_wait("signals", options);
  lot::liveness::LockFile gate(options.directory + "/" + options.segment + ".lock");
  REQUIRE(gate.enter_gate(5s));
  child.send(SIGINT);
  std::this_thread::sleep_for(700ms);
  child.send(SIGTERM);
  std::this_thread::sleep_for(50ms);
  gate.leave_gate();
  CHECK(child.wait() == 128 + SIGINT);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a process that a signal ends forks no child, which would find locks that never open") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  int said = -1;
  Child child = start_and_wait("signals, and it forks meanwhile", options, &said);
  child.send(SIGTERM);
  CHECK(child.wait() == 128 + SIGTERM);
  char text[16] = {};
  CHECK(read(said, text, 1) == 1);  // the end of the line before
  CHECK(read(said, text, sizeof(text) - 1) == 0);
  CHECK(std::string(text) == "\n");
  close(said);
}

TEST_CASE("two processes that signals end at once leave no file") {
  const Watchdog watchdog(120);
  for (int round = 0; round < 20; ++round) {
    const auto options = fresh();
    const char* how = round % 2 == 0 ? "signals" : "signals while a thread closes rings";
    CAPTURE(how);
    Child one = start_and_wait(how, options);
    Child two = start_and_wait(how, options);
    one.send(SIGINT);
    two.send(SIGINT);
    CHECK(one.wait() == 128 + SIGINT);
    CHECK(two.wait() == 128 + SIGINT);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("a process that is killed while a signal ends it leaves what the next one repairs") {
  const Watchdog watchdog(120);
  std::mt19937_64 random(seed());
  for (int round = 0; round < 40; ++round) {
    const auto options = fresh();
    Child child = start_and_wait("signals while threads publish", options);
    child.send(SIGTERM);
    usleep(static_cast<useconds_t>(random() % 4000));
    child.kill9();
    {
      lot::ShmEngine engine(options);
      check_works(engine);
      // The next process with the index of one that has said that it ends is not taken for ending.
      Child other = start_and_wait("signals", options);
      CHECK(files_of(options) == 2);
      other.kill9();
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("exec is death: what the process had is free while the new program runs") {
  const Watchdog watchdog(120);
  for (const char* how : {"exec", "exec in a thread", "exec while threads publish"}) {
    CAPTURE(how);
    const auto options = fresh();
    {
      lot::ShmEngine engine(options);
      int out[2];
      REQUIRE(pipe(out) == 0);
      Child child([&] {
        dup2(out[1], STDOUT_FILENO);
        execl(LOT_ENDING, LOT_ENDING, how, options.directory.c_str(), options.segment.c_str(),
              nullptr);
      });
      close(out[1]);
      char text[7] = {};
      CHECK(read(out[0], text, 6) == 6);
      close(out[0]);
      CHECK(std::string(text) == "asleep");
      check_works(engine);
      int status = 0;
      CHECK(!child.ended(status));
    }
    CHECK(files_of(options) == 0);
  }
}

TEST_SUITE_END();
