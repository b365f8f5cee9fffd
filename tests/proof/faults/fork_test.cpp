// SPDX-License-Identifier: Apache-2.0

// Children that were forked, spawned or executed, and outlive their parents.

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <optional>
#include <poll.h>
#include <string>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>
#include <spawn.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "slow_open.hpp"
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

/// True when the use is refused because the object was inherited.
template <class Use>
bool is_inert(Use&& use) {
  try {
    use();
  } catch (const lot::Error& e) {
    return e.error_number() == ECHILD && std::string(e.what()).find("fork") != std::string::npos;
  }
  return false;
}

const int the_test = static_cast<int>(syscall(SYS_pidfd_open, getpid(), 0));

/// Waits for a step in a process that outlives its parent; ends it when the test has ended.
void await(const Steps& step) {
  pollfd test{the_test, POLLIN, 0};
  while (step.next(100ms) == '\0') {
    if (poll(&test, 1, 0) != 0) _exit(1);
  }
}

/// Starts /bin/sleep in one of the ways that there are to start a program. Returns its pid.
pid_t with_fork_and_exec() {
  const pid_t pid = fork();
  if (pid == 0) {
    execl("/bin/sleep", "sleep", "10", nullptr);
    _exit(127);
  }
  return pid;
}
pid_t with_vfork_and_exec() {
  const pid_t pid = vfork();  // NOLINT: it is what is tested
  if (pid == 0) {
    execl("/bin/sleep", "sleep", "10", nullptr);
    _exit(127);
  }
  return pid;
}
pid_t with_posix_spawn() {
  char name[] = "sleep";
  char time[] = "10";
  char* arguments[] = {name, time, nullptr};
  pid_t pid = -1;
  must(posix_spawn(&pid, "/bin/sleep", nullptr, nullptr, arguments, environ) == 0, "posix_spawn");
  return pid;
}

bool lives(pid_t pid) { return kill(pid, 0) == 0; }

/// A process's descriptor of the segment's lock file, or -1.
int lock_descriptor(pid_t pid, const lot::EngineOptions& options) {
  std::error_code gone;
  const auto descriptors = "/proc/" + std::to_string(pid) + "/fd";
  for (const auto& entry : std::filesystem::directory_iterator(descriptors, gone)) {
    if (std::filesystem::read_symlink(entry, gone) == file_of(options) + ".lock") {
      return std::stoi(entry.path().filename());
    }
  }
  return -1;
}
bool has_lock_file(pid_t pid, const lot::EngineOptions& options) {
  return lock_descriptor(pid, options) != -1;
}

}  // namespace

TEST_SUITE_BEGIN("fork");

TEST_CASE("a program started by fork, vfork or posix_spawn lives on; the killed node is reaped") {
  const Watchdog watchdog(60);
  prctl(PR_SET_CHILD_SUBREAPER, 1);
  for (const auto start : {&with_fork_and_exec, &with_vfork_and_exec, &with_posix_spawn}) {
    const Ground options;
    Neighbour neighbour(options);
    Steps started, killed;
    pid_t program = -1;
    int channel[2];
    REQUIRE(pipe(channel) == 0);
    Child node([&] {
      lot::ShmEngine engine(named(options, "node"));
      auto pusher = engine.advertise<Number>("/t");
      const auto loan = pusher.loan();
      const pid_t pid = start();
      must(write(channel[1], &pid, sizeof(pid)) == sizeof(pid), "its pid");
      pause();
    });
    REQUIRE(read(channel[0], &program, sizeof(program)) == sizeof(program));
    close(channel[0]);
    close(channel[1]);
    CHECK(eventually([&] { return !has_lock_file(program, options); }));
    node.kill9();
    lot::segment::Segment s(file_of(options));
    CHECK(eventually([&] { return index_of(s, "node") == 0 && Audit(s).nothing(); }));
    CHECK(lives(program));
    kill(program, SIGKILL);
    CHECK(waitpid(program, nullptr, 0) == program);
    CHECK(neighbour.leave() >= 0);
    CHECK(files_of(options) == 0);
  }
  prctl(PR_SET_CHILD_SUBREAPER, 0);
}

TEST_CASE("a child made by raw clone keeps its parent alive in others' eyes until it ends") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps cloned, life;
  Child node([&] {
    lot::ShmEngine engine(named(options, "node"));
    if (syscall(SYS_clone, SIGCHLD, nullptr, nullptr, nullptr, nullptr) == 0) {
      await(life);
      _exit(0);
    }
    cloned.tell();
    pause();
  });
  REQUIRE(cloned.next() == '.');
  node.kill9();
  lot::segment::Segment s(file_of(options));
  CHECK(!eventually([&] { return index_of(s, "node") == 0; }, 400ms));
  life.tell();
  CHECK(eventually([&] { return index_of(s, "node") == 0; }));
  CHECK(neighbour.leave() >= 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("the child of a killed parent goes on with an engine of its own") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps joined, parent_killed, received, life;
  std::optional<lot::ShmEngine> ours(options);
  std::optional<lot::ShmPusher<Number>> numbers =
      ours->advertise<Number>("/t", {Policy::Overwrite, 128, 1s});
  Child parent([&] {
    lot::ShmEngine engine(named(options, "parent"));
    auto pusher = engine.advertise<Number>("/parent");
    auto puller = engine.subscribe<Number>("/t");
    const auto kept = engine.make<Number>();
    if (fork() == 0) {
      const bool inherited = has_lock_file(getpid(), options);
      lot::ShmEngine own(named(options, "child"));
      auto reader = own.subscribe<Number>("/t", {Wait::Park, 0});
      joined.tell(inherited ? '!' : '.');
      await(parent_killed);
      for (std::uint64_t n = 0; n < 100; ++n) must(reader.pull(10s)->value == n, "each number");
      must(is_inert([&] { return pusher.loan(); }) && is_inert([&] { return puller.try_pull(); }),
           "inert");
      received.tell();
      await(life);
      _exit(0);
    }
    pause();
  });
  REQUIRE(joined.next() == '.');
  lot::segment::Segment s(file_of(options));
  CHECK(numbers->readers() == 2);
  CHECK(taken(s).size() == 4);
  parent.kill9();
  CHECK(eventually([&] { return index_of(s, "parent") == 0 && numbers->readers() == 1; }));
  CHECK(index_of(s, "child") != 0);
  parent_killed.tell();
  for (std::uint64_t n = 0; n < 100; ++n) must_go(numbers->push(numbers->loan(n)));
  CHECK(received.next() == '.');
  CHECK(index_of(s, "child") != 0);
  life.tell();
  CHECK(eventually([&] { return index_of(s, "child") == 0; }));
  numbers.reset();
  ours.reset();
  CHECK(neighbour.leave() >= 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a parent that leaves takes nothing from its forked child, and the other way round") {
  const Watchdog watchdog(60);
  const Ground options;
  Steps forked, left, life;
  Child parent([&] {
    auto engine = std::make_unique<lot::ShmEngine>(named(options, "parent"));
    const pid_t child = fork();
    if (child == 0) {
      must(left.next() == '.', "its parent has left");
      must(files_of(options) == 0, "the parent has removed the files");
      {
        lot::ShmEngine own(named(options, "child"));
        must(files_of(options) == 2, "a segment of its own");
        engine.reset();
        must(files_of(options) == 2, "what it has inherited removes nothing");
      }
      must(files_of(options) == 0, "its own does");
      _exit(0);
    }
    engine.reset();
    left.tell();
    int status = 0;
    must(waitpid(child, &status, 0) == child && status == 0, "the child");
  });
  CHECK(parent.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("forks while other threads publish and pull: the streams go on, each child's own works") {
  const Watchdog watchdog(90);
  const Ground options;
  Neighbour neighbour(options);
  Child parent([&] {
    lot::ShmEngine engine(named(options, "parent"));
    auto pusher = engine.advertise<Number>("/t", {Policy::Block, 16, 30s});
    auto puller = engine.subscribe<Number>("/t");
    auto latest = engine.advertise<Number>("/latest", {Policy::Overwrite, 4, 1s});
    std::atomic<bool> enough{false};
    std::atomic<std::uint64_t> received{0};
    std::thread publisher([&] {
      for (std::uint64_t n = 0; !enough; ++n) {
        must(pusher.push(pusher.loan(n)) == Status::Ok, "a push");
        must_go(latest.push(latest.loan(n)));
      }
      must(pusher.push(pusher.loan(~std::uint64_t{0})) == Status::Ok, "the last push");
    });
    std::thread reader([&] {
      for (std::uint64_t next = 0;; ++next) {
        const auto look = puller.borrow();
        if (look->value == ~std::uint64_t{0}) return;
        must(look->value == next, "each number, in order");
        received = next;
      }
    });
    std::thread forker([&] {  // a thread that forks while the two are at work
      for (int n = 0; n < 30; ++n) {
        const std::uint64_t before = received;
        Child child([&] {
          must(is_inert([&] { return pusher.loan(); }), "pusher");
          must(is_inert([&] { return puller.try_pull(); }), "puller");
          must(is_inert([&] { return engine.make<Number>(); }), "engine");
          lot::ShmEngine own(named(options, "child"));
          auto mine = own.subscribe<Number>("/latest", {Wait::Park, 1});
          const auto seen = mine.pull(10s);
          must(seen && seen->value + 1 >= before, "its own engine works");
        });
        must(child.wait() == 0, "a child");
      }
    });
    forker.join();
    enough = true;
    publisher.join();
    reader.join();
    must(puller.missed_total() == 0, "nothing was missed");
  });
  CHECK(parent.wait() == 0);
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a child that forks again: the grandchild inherits nothing that works, twice") {
  const Watchdog watchdog(60);
  const Ground options;
  Child parent([&] {
    lot::ShmEngine engine(named(options, "parent"));
    auto pusher = engine.advertise<Number>("/t");
    must_go(pusher.push(pusher.loan(std::uint64_t{1})));
    lot::segment::Segment s(engine.path());
    const std::string alone = Audit(s).text();
    Child child([&] {
      lot::ShmEngine own(named(options, "child"));
      auto reader = own.subscribe<Number>("/t", {Wait::Park, 1});
      auto borrowed = reader.borrow(10s);
      must(borrowed && borrowed->value == 1, "the child's engine works");
      const std::string both = Audit(s).text();
      Child grandchild([&] {
        must(is_inert([&] { return pusher.loan(); }), "the grandparent's");
        must(is_inert([&] { return reader.try_pull(); }), "the parent's");
        must(is_inert([&] { return own.make<Number>(); }), "the parent's engine");
        borrowed.end();
        lot::ShmEngine third(named(options, "grandchild"));
        auto again = third.subscribe<Number>("/t", {Wait::Park, 1});
        must(again.pull(10s)->value == 1, "the grandchild's engine works");
        must(index_of(s, "parent") != 0 && index_of(s, "child") != 0, "three are there");
      });
      must(grandchild.wait() == 0, "the grandchild");
      must(eventually([&] { return Audit(s).text() == both; }), "it has left nothing");
      must(borrowed->value == 1, "the child's borrow is as it was");
    });
    must(child.wait() == 0, "the child");
    must(eventually([&] { return Audit(s).text() == alone; }), "nothing was left");
    must(pusher.push(pusher.loan(std::uint64_t{2})) == Status::Ok, "the parent goes on");
  });
  CHECK(parent.wait() == 0);
  CHECK(files_of(options) == 0);
}

namespace {

/// What an application may well have as statics.
struct Statics {
  lot::ShmEngine engine;
  lot::ShmPusher<Number> pusher = engine.advertise<Number>("/t", {Policy::Overwrite, 4, 1s});
  lot::ShmPuller<Number> puller = engine.subscribe<Number>("/t");
  lot::ShmUniquePtr<Number> loaned = pusher.loan(std::uint64_t{1});
  lot::ShmSharedPtr<const Number> kept;
  lot::ShmWeakPtr<const Number> weak;
  lot::ShmBorrow<Number> borrowed;

  explicit Statics(const lot::EngineOptions& options) : engine(options) {
    must_go(pusher.push(pusher.loan(std::uint64_t{2})));
    must_go(pusher.push(pusher.loan(std::uint64_t{3})));
    kept = puller.pull(10s);
    weak = kept;
    borrowed = puller.borrow(10s);
  }
};
Statics& statics(const lot::EngineOptions& options) {
  static Statics all(options);
  return all;
}

}  // namespace

TEST_CASE("exit() in a forked child destroys statics, touches nothing; in the parent it leaves") {
  const Watchdog watchdog(60);
  const Ground options;
  Child parent([&] {
    Statics& mine = statics(options);
    lot::segment::Segment s(mine.engine.path());
    const std::string before = Audit(s).text();
    const pid_t child = fork();
    if (child == 0) std::exit(0);
    int status = 0;
    must(waitpid(child, &status, 0) == child && status == 0, "the child has ended by exit()");
    must(Audit(s).text() == before, "it has touched nothing");
    must(files_of(options) == 2, "and removed nothing");
    must(mine.kept->value == 2 && mine.weak.lock() == mine.kept, "the kept message");
    must(mine.borrowed->value == 3, "the borrowed message");
    must(mine.pusher.push(std::move(mine.loaned)) == Status::Ok, "the loaned message");
    mine.borrowed.end();
    must(mine.puller.pull(10s)->value == 1, "the parent goes on");
    std::exit(0);
  });
  CHECK(parent.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a child forked while another thread is joining waits for it, and holds no lock") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps join, forking, life;
  Child parent([&] {
    must(join.next() == '.', "the order");
    std::thread joiner([&] {
      const lot::ShmEngine engine(named(options, "parent"));
      pause();
    });
    std::this_thread::sleep_for(50ms);  // it waits for the gate
    forking.tell();
    const pid_t child = fork();
    if (child == 0) {
      const bool inherited = has_lock_file(getpid(), options);
      const lot::ShmEngine own(named(options, "child"));
      forking.tell(inherited ? '!' : '.');
      await(life);
      _exit(0);
    }
    joiner.join();
  });
  lot::liveness::LockFile gate(file_of(options) + ".lock");
  REQUIRE(gate.enter_gate(5s));
  join.tell();
  REQUIRE(forking.next() == '.');
  std::this_thread::sleep_for(50ms);
  gate.leave_gate();
  REQUIRE(forking.next() == '.');
  lot::segment::Segment s(file_of(options));
  CHECK(index_of(s, "parent") != 0);
  parent.kill9();
  CHECK(eventually([&] { return index_of(s, "parent") == 0; }));
  CHECK(index_of(s, "child") != 0);
  life.tell();
  CHECK(eventually([&] { return index_of(s, "child") == 0; }));
  CHECK(neighbour.leave() >= 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a child forked while a closed lock file is opened again holds no lock") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps forked, life;
  Child parent([&] {
    const lot::ShmEngine engine(named(options, "parent"));
    const int lock = lock_descriptor(getpid(), options);
    must(lock != -1, "the lock file is open");
    open_lock_files_slowly();
    must(dup2(0, lock) == lock, "dup2");  // so that it gets another number
    while (!is_opening_slowly()) {
    }
    if (fork() == 0) {
      forked.tell(has_lock_file(getpid(), options) ? 'y' : 'n');
      await(life);
      _exit(0);
    }
    pause();
  });
  CHECK(forked.next() == 'n');
  parent.kill9();
  lot::segment::Segment s(file_of(options));
  CHECK(eventually([&] { return index_of(s, "parent") == 0; }));
  life.tell();
  CHECK(neighbour.leave() >= 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a child forked while a thread is leaving holds no lock, and the parent is reaped") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps joined, leave, forked, life;
  Child parent([&] {
    auto engine = std::make_unique<lot::ShmEngine>(named(options, "parent"));
    joined.tell();
    must(leave.next() == '.', "the order");
    std::thread leaver([&] { engine.reset(); });
    std::this_thread::sleep_for(50ms);  // it waits for the gate
    if (fork() == 0) {
      forked.tell(has_lock_file(getpid(), options) ? 'y' : 'n');
      await(life);
      _exit(0);
    }
    leaver.join();
  });
  REQUIRE(joined.next() == '.');
  lot::segment::Segment s(file_of(options));
  lot::liveness::LockFile gate(file_of(options) + ".lock");
  REQUIRE(gate.enter_gate(5s));
  leave.tell();
  CHECK(forked.next() == 'n');
  parent.kill9();
  gate.leave_gate();
  CHECK(eventually([&] { return index_of(s, "parent") == 0; }));
  life.tell();
  CHECK(eventually([&] { return index_of(s, "parent") == 0; }));
  CHECK(neighbour.leave() >= 0);
  CHECK(files_of(options) == 0);
}

TEST_SUITE_END();
