// SPDX-License-Identifier: Apache-2.0

// Who is alive, as the kernel's locks say it.

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <fcntl.h>
#include <string>
#include <sys/prctl.h>
#include <sys/ptrace.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "liveness/lock_holder.hpp"
#include "support/error_of.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::liveness::LockFile;
using lot::liveness::LockHolder;
using lot::liveness::LockProbe;

struct Number {
  std::uint64_t value;
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

}  // namespace

TEST_SUITE_BEGIN("liveness");

TEST_CASE("a joiner at the gate waits for as long as the gate changes hands") {
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  LockFile others(path);
  REQUIRE(others.try_lock(LockFile::kGate));
  std::atomic<bool> is_in{false};
  std::thread waiter([&] {
    LockFile own(path);
    CHECK(own.enter_gate(2s));
    is_in = true;
    own.leave_gate();
  });
  for (std::uint32_t n = 0; n < 60; ++n) {  // one comes after the other, for three seconds
    others.try_lock(LockFile::kFirstTurn + n);
    std::this_thread::sleep_for(50ms);
    others.unlock(LockFile::kFirstTurn + n);
  }
  CHECK(!is_in);
  others.leave_gate();
  waiter.join();
  CHECK(is_in);
  unlink(path.c_str());
}

TEST_CASE("a joiner at the gate has patience with a process at work there, step by step") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  LockFile own(path);
  REQUIRE(own.enter_gate(2s));
  Child waiter([&] {
    LockFile file(path);
    must(file.enter_gate(1s), "the gate");
    file.leave_gate();
  });
  for (int step = 0; step < 200; ++step) {
    std::this_thread::sleep_for(10ms);
    own.take_turn();
  }
  own.leave_gate();
  CHECK(waiter.wait() == 0);
  unlink(path.c_str());
}

TEST_CASE("the time in which a joiner was stopped does not count as waiting at the gate") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  LockFile own(path);
  REQUIRE(own.enter_gate(2s));
  Steps begun;
  Child waiter([&] {
    LockFile file(path);
    begun.tell();
    must(file.enter_gate(1s), "the gate");
    file.leave_gate();
  });
  REQUIRE(begun.next() == '.');
  std::this_thread::sleep_for(50ms);  // most likely at the gate by now
  waiter.send(SIGSTOP);
  std::this_thread::sleep_for(1200ms);
  waiter.send(SIGCONT);
  std::this_thread::sleep_for(100ms);
  own.leave_gate();
  CHECK(waiter.wait() == 0);
  unlink(path.c_str());
}

TEST_CASE("the holder of a byte is found, and whether it is stopped") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  Steps locked;
  Child holder([&] {
    LockFile file(path);
    must(file.enter_gate(2s), "the gate");
    locked.tell();
    pause();
  });
  REQUIRE(locked.next() == '.');
  struct stat status {};
  REQUIRE(stat(path.c_str(), &status) == 0);
  const auto find = [&](std::uint32_t byte) { return LockHolder::find(path, status.st_ino, byte); };
  REQUIRE(find(LockFile::kGate));
  CHECK(find(LockFile::kGate)->pid == holder.pid());
  CHECK(!find(LockFile::kGate)->is_stopped);
  CHECK(!find(7));
  CHECK(!LockHolder::find(path, status.st_ino + 1, LockFile::kGate));
  holder.send(SIGSTOP);
  CHECK(eventually([&] { return find(LockFile::kGate)->is_stopped; }));
  LockFile file(path);
  const auto [error, text] = error_of([&] { file.enter_gate(60s); });  // the watchdog's time
  CHECK(error == EBUSY);
  CHECK_MESSAGE(names(text, ("process " + std::to_string(holder.pid()) + " (").c_str()), text);
  CHECK_MESSAGE(names(text, "kill -CONT"), text);
  holder.kill9();
  CHECK(file.enter_gate(2s));
  unlink(path.c_str());
}

TEST_CASE("the holder of each byte of a run is found, by a name of any bytes") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  Steps locked;
  Child holder([&] {
    prctl(PR_SET_NAME, "a) (b\x01 c");
    LockFile other(path + "2");  // a file with locks that is another one
    LockFile file(path);
    must(other.try_lock(9), "the other's lock");
    for (const std::uint32_t byte : {5U, 6U, 7U, 12U}) must(file.try_lock(byte), "the lock");
    locked.tell();
    pause();
  });
  REQUIRE(locked.next() == '.');
  struct stat status {};
  REQUIRE(stat(path.c_str(), &status) == 0);
  const LockProbe probe(path);
  for (std::uint32_t byte = 0; byte < 20; ++byte) {
    CAPTURE(byte);
    const bool is_held = (byte >= 5 && byte <= 7) || byte == 12;
    for (const auto& found : {LockHolder::find(path, status.st_ino, byte), probe.holder(byte)}) {
      REQUIRE(found.has_value() == is_held);
      if (!found) continue;
      CHECK(found->pid == holder.pid());
      CHECK(found->name == "a) (b? c");
      CHECK_FALSE(found->is_stopped);
    }
    CHECK(probe.is_held(byte) == is_held);
  }
  CHECK(probe.is_held(8, 5));
  CHECK_FALSE(probe.is_held(8, 4));
  CHECK_FALSE(LockHolder::find(path + "3", status.st_ino, 5));
  const LockHolder found = *probe.holder(5);
  const std::string pid = std::to_string(holder.pid());
  CHECK(found.describe() == "process " + pid + " (a) (b? c)");
  CHECK(found.advice() ==
        "continue it (kill -CONT " + pid + ") or kill it (kill -KILL " + pid + ")");
  holder.kill9();
  unlink(path.c_str());
  unlink((path + "2").c_str());
}

TEST_CASE("a process is being killed from the signal on, until it is collected") {
  const Watchdog watchdog(60);
  CHECK_FALSE(lot::liveness::is_being_killed(getpid()));
  CHECK_FALSE(lot::liveness::is_being_killed(0x7ffffff0));  // there is no such process
  int ends[2];
  REQUIRE(pipe(ends) == 0);
  const pid_t child = fork();
  REQUIRE(child != -1);
  if (child == 0) {
    char byte = 0;
    _exit(read(ends[0], &byte, 1) == 1 ? 0 : 1);
  }
  CHECK_FALSE(lot::liveness::is_being_killed(child));
  kill(child, SIGKILL);
  CHECK(lot::liveness::is_being_killed(child));  // pending, ending or a zombie
  siginfo_t info{};
  REQUIRE(waitid(P_PID, static_cast<id_t>(child), &info, WEXITED | WNOWAIT) == 0);
  CHECK(lot::liveness::is_being_killed(child));
  REQUIRE(waitpid(child, nullptr, 0) == child);
  CHECK_FALSE(lot::liveness::is_being_killed(child));
  close(ends[0]);
  close(ends[1]);
}

TEST_CASE("a process that has ended by itself has ended, too, until it is collected") {
  const Watchdog watchdog(60);
  const pid_t child = fork();
  REQUIRE(child != -1);
  if (child == 0) _exit(0);
  siginfo_t info{};
  REQUIRE(waitid(P_PID, static_cast<id_t>(child), &info, WEXITED | WNOWAIT) == 0);
  CHECK(lot::liveness::is_being_killed(child));
  REQUIRE(waitpid(child, nullptr, 0) == child);
}

TEST_CASE("a holder is one of the kernel's locks of open files, up to the end of all bytes") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  Steps locked;
  const auto lock = [](int fd, int how, off_t first, off_t count) {
    struct flock range {};
    range.l_type = F_WRLCK;
    range.l_whence = SEEK_SET;
    range.l_start = first;
    range.l_len = count;  // 0: all that follow
    must(fcntl(fd, how, &range) == 0, "the lock");
  };
  Child holder([&] {
    const int fd = open(path.c_str(), O_RDWR | O_CREAT, 0600);
    must(fd != -1, "the file");
    lock(fd, F_OFD_SETLK, 100, 0);
    lock(fd, F_SETLK, 7, 1);  // of the process
    // Where no process may be traced, it is only stopped.
    (void)ptrace(PTRACE_TRACEME, 0, nullptr, nullptr);
    locked.tell();
    raise(SIGSTOP);
    pause();
  });
  REQUIRE(locked.next() == '.');
  struct stat status {};
  REQUIRE(stat(path.c_str(), &status) == 0);
  for (const std::uint32_t byte : {0U, 7U, 99U, 100U, 101U, 319U, ~std::uint32_t{0}}) {
    CAPTURE(byte);
    const auto found = LockHolder::find(path, status.st_ino, byte);
    REQUIRE(found.has_value() == (byte >= 100));
    if (found) CHECK(found->pid == holder.pid());
  }
  // One that a debugger has stopped has stopped.
  CHECK(eventually([&] { return LockHolder::find(path, status.st_ino, 100)->is_stopped; }));
  holder.kill9();
  unlink(path.c_str());
}

TEST_CASE("what is no lock file is opened without waiting, and is named") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  REQUIRE(mkfifo(path.c_str(), 0600) == 0);
  CHECK(!LockProbe(path).is_lock_file());  // does not wait for a writer
  unlink(path.c_str());
  REQUIRE(mkdir(path.c_str(), 0700) == 0);
  CHECK(!LockProbe(path).is_lock_file());
  CHECK(!LockProbe(path).is_held(0, 320));
  CHECK(!LockProbe(path).holder(0));
  rmdir(path.c_str());
  { const LockFile file(path); }
  REQUIRE(truncate(path.c_str(), 7) == 0);
  const auto [error, text] = error_of([&] { const LockFile file(path); });
  CHECK(error == EINVAL);
  CHECK_MESSAGE(names(text, "it is a file of 7 bytes, no lock file"), text);
  unlink(path.c_str());
}

TEST_CASE("a lock is seen by others, and goes with the process that holds it") {
  const Watchdog watchdog(60);
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  Steps locked;
  Child holder([&] {
    LockFile file(path);
    must(file.try_lock(7), "the lock");
    must(!file.held_by_other(7), "one's own lock is not another's");
    locked.tell();
    pause();
  });
  REQUIRE(locked.next() == '.');
  {
    LockFile file(path);
    CHECK(file.held_by_other(7));
    CHECK(file.held_by_other(0, 320));
    CHECK(!file.held_by_other(6));
    CHECK(!file.held_by_other(8, 100));
    CHECK(!file.try_lock(7));
    CHECK(file.try_lock(8));
    holder.kill9();
    CHECK(!file.held_by_other(7));
    CHECK(file.try_lock(7));
    file.unlock(7);
    file.unlock(8);
    CHECK(file.enter_gate(1s));
    LockFile second(path);
    CHECK_THROWS_AS(second.enter_gate(20ms), lot::Error);
    unlink(path.c_str());
    file.leave_gate();
    CHECK(!second.enter_gate(1s));  // it was removed: open it again
  }
}

TEST_CASE("a probe follows no link, and takes no other file for a lock file") {
  const std::string path = "/dev/shm/" + unique_name() + ".lock";
  const std::string link = path + "_link";
  CHECK(!LockProbe(path).is_lock_file());
  {
    LockFile file(path);
    CHECK(LockProbe(path).is_lock_file());
    REQUIRE(symlink(path.c_str(), link.c_str()) == 0);
    CHECK(!LockProbe(link).is_lock_file());
    unlink(link.c_str());
    REQUIRE(truncate(path.c_str(), 1) == 0);
    CHECK(!LockProbe(path).is_lock_file());
  }
  unlink(path.c_str());
}

TEST_CASE("closefrom() in a living process: it is not reaped, goes on, and gets its lock back") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps ready, close_now, closed, done;
  const int last_of_mine = dup(2);  // the child's descriptors that come after it are LOT's
  Child careless([&] {
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Number>("/t", {lot::Policy::Overwrite, 64, 1s});
    ready.tell();
    must(close_now.next() == '.', "the order");
    closefrom(last_of_mine + 1);
    closed.tell();
    for (std::uint64_t n = 0; n < 400; ++n) {
      must_go(pusher.push(pusher.loan(n)));
      usleep(3000);
    }
    must(done.next() == '.', "the end");
  });
  close(last_of_mine);
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Number>("/t");
    close_now.tell();
    REQUIRE(closed.next() == '.');
    std::uint64_t next = 0;
    while (next < 400) {
      auto seen = puller.pull(20s);
      REQUIRE(seen);
      REQUIRE(seen->value == next);
      next = seen->value + 1;
    }
    CHECK(puller.missed_total() == 0);
    lot::segment::Segment s(engine.path());
    CHECK(Audit(s).participants == 2);
    LockFile file(engine.path() + ".lock");
    std::uint32_t held = 0;
    CHECK(eventually([&] {
      held = 0;
      for (std::uint32_t k = 1; k < 320; ++k) held += file.held_by_other(k);
      return held == 2;
    }));
    done.tell();
    CHECK(careless.wait() == 0);
    CHECK(eventually([&] { return Audit(s).participants == 1; }));
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a process that leaves right after closefrom() leaves no file") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Child careless([&] {
    const lot::ShmEngine engine(options);
    closefrom(3);
  });
  CHECK(careless.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_SUITE_END();
