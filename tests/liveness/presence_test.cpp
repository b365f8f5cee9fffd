// SPDX-License-Identifier: Apache-2.0

// Who is taken for dead, and who is not, where one of the two witnesses cannot speak.

#include "liveness/presence.hpp"

#include <cerrno>
#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <pthread.h>
#include <string>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "futex/futex.hpp"
#include "support/error_of.hpp"
#include "support/lock_owner.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "support/sandbox.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;
namespace seat = lot::liveness::seat;

struct Number {
  std::uint64_t value;
};

/// Of such ones the next is made ahead.
struct Large {
  std::uint8_t bytes[1 << 20];
};

[[maybe_unused]] const std::string& prefix_taken = prefix();

/// The seat of participant k, from outside.
class Seats {
 public:
  explicit Seats(const lot::ShmEngine& engine) : segment_(engine.path()) {}
  std::uint64_t of(std::uint32_t k) const { return segment_.witnesses()[k].seat.load(); }
  void set(std::uint32_t k, std::uint64_t value) {
    lot::test::raw(segment_.witnesses()[k].seat) = value;
  }
  bool is_there(std::uint32_t k) const { return segment_.participants()[k].state.load() != 0; }
  const lot::segment::Segment& segment() const { return segment_; }

 private:
  lot::segment::Segment segment_;
};

/// What closefrom() in an application does to our lock file.
void close_all_of(const std::string& path) {
  for (int fd = 3; fd < 256; ++fd) {
    std::error_code none;
    if (std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(fd), none) == path)
      close(fd);
  }
}

/// fork() without its handlers, as a library may do it: the child keeps all descriptors.
pid_t raw_fork() {
  return static_cast<pid_t>(syscall(SYS_clone, SIGCHLD, nullptr, nullptr, nullptr, nullptr));
}

bool has_thread(const std::string& name) {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string its;
    std::getline(std::ifstream(task.path() / "comm"), its);
    if (its == name) return true;
  }
  return false;
}

/// The threads that LOT has begun, by name, and whether a signal could come to them at first.
std::mutex begun_mutex;
std::map<std::string, bool> begun;

}  // namespace

extern "C" {
int __real_pthread_setname_np(pthread_t thread, const char* name);
/// What a thread of LOT does first.
int __wrap_pthread_setname_np(pthread_t thread, const char* name) {
  sigset_t blocked;
  pthread_sigmask(SIG_BLOCK, nullptr, &blocked);
  {
    const std::lock_guard guard(begun_mutex);
    begun[name] = sigismember(&blocked, SIGUSR1) == 0;
  }
  return __real_pthread_setname_np(thread, name);
}
}

TEST_SUITE_BEGIN("presence");

TEST_CASE("no signal of the application comes to a thread of the library, from its first step on") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  auto puller = engine.subscribe<Number>("/t");
  puller.fd();
  const auto listener = engine.listen<Number>("/t", [](const lot::ShmSharedPtr<const Number>&) {});
  auto pusher = engine.advertise<Large>("/large");
  const std::uint32_t word = 0;
  lot::transport::Participant::join(options)->rouser().rouse(&word);
  const std::map<std::string, bool> all{{"lot-witness", false}, {"lot-warden", false},
                                        {"lot-notify", false},  {"lot-listen", false},
                                        {"lot-ahead", false},   {"lot-rouser", false}};
  CHECK(eventually([&] {
    const std::lock_guard guard(begun_mutex);
    return begun == all;
  }));
}

TEST_CASE("an index has another incarnation each time it is taken") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  const lot::ShmEngine first(options);
  const Seats seats(first);
  for (std::uint32_t n = 1; n <= 5; ++n) {
    Child second([&] {
      lot::ShmEngine engine(options);
      must(seats.is_there(2) && seat::stands(seats.of(2)), "the index");
      must(seat::incarnation(seats.of(2)) == n, "its incarnation");
    });
    CHECK(second.wait() == 0);
    CHECK(seats.of(2) == seat::make(n, 0));
  }
}

TEST_CASE("where the kernel gives no notices a killed process is reaped all the same") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  const Seats seats(engine);
  Steps joined;
  Child victim([&] {
    must(refuse(SYS_set_robust_list, EPERM), "a filter");
    lot::ShmEngine mine(options);
    joined.tell();
    pause();
  });
  REQUIRE(joined.next() != 0);
  CHECK(seat::notice(seats.of(2)) == seat::kUnwitnessed);
  victim.kill9();
  CHECK(eventually([&] { return !seats.is_there(2); }, 30s));
}

TEST_CASE("where the kernel gives no notices, and the application closes the lock file, it lives") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  const Seats seats(engine);
  auto pusher = engine.advertise<Number>("/t");
  Steps joined;
  Child victim([&] {
    must(refuse(SYS_set_robust_list, EPERM), "a filter");
    lot::ShmEngine mine(options);
    auto puller = mine.subscribe<Number>("/t");
    close_all_of(mine.path() + ".lock");
    joined.tell();
    must(puller.pull(40s)->value == 7, "the message");
  });
  REQUIRE(joined.next() != 0);
  std::this_thread::sleep_for(lot::liveness::Presence::kConviction + 2s);
  CHECK(seats.is_there(2));
  CHECK(pusher.push(pusher.loan(std::uint64_t{7})) == lot::Status::Ok);
  CHECK(victim.wait() == 0);
}

TEST_CASE("the lock of a dead process is taken over, though a child of it has its byte") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  lot::ShmEngine engine(options);
  const Seats seats(engine);
  Steps locked;
  Child victim([&] {
    lot::ShmEngine mine(options);
    RegistryLock registry(seats.segment());
    must(registry.lock(), "the registry");
    if (raw_fork() == 0) {
      alarm(8);
      pause();
    }
    locked.tell();
    pause();
  });
  REQUIRE(locked.next() != 0);
  victim.kill9();
  auto puller = engine.subscribe<Number>("/t");  // throws where it cannot get the lock
  CHECK(seats.is_there(2));                      // it is not reaped: the byte says that it lives
  CHECK(!seat::stands(seats.of(2)));
  CHECK(eventually([&] { return !seats.is_there(2); }, 30s));  // the child has ended
}

TEST_CASE("a waiter takes a process for gone at once if it was judged, and never while it stands") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  const lot::ShmEngine engine(options);
  Seats seats(engine);
  Steps joined;
  Child other([&] {
    const lot::ShmEngine mine(options);
    joined.tell();
    pause();
  });
  REQUIRE(joined.next() != 0);
  other.send(SIGSTOP);  // so that it does not correct its notice
  const lot::liveness::LockFile lock_file(engine.path() + ".lock");
  lot::liveness::Presence presence(seats.segment(), lock_file);
  const std::uint32_t incarnation = seat::incarnation(seats.of(2));
  const std::uint32_t name = lot::lock::make_name(2, incarnation);
  const auto until = lot::futex::Clock::now() + lot::liveness::Presence::kConviction + 200ms;
  while (lot::futex::Clock::now() < until) {
    REQUIRE_FALSE(presence.is_gone(name));
    std::this_thread::sleep_for(50ms);
  }
  CHECK(presence.is_gone(lot::lock::make_name(2, incarnation + 1)));
  seats.set(2, seat::make(incarnation, seat::kJudged));
  CHECK(presence.is_gone(name));
  other.kill9();
}

TEST_CASE("a process that was taken for dead does nothing more, says so, and may join anew") {
  const Watchdog watchdog(60);
  bool is_judged = false;  // else another one has its index
  SUBCASE("another one has its index") {}
  SUBCASE("it was judged, and nobody has the index yet") { is_judged = true; }
  const auto options = fresh();
  lot::ShmEngine engine(options);
  Seats seats(engine);
  Steps joined, leave;
  Child victim([&] {
    lot::ShmEngine mine(options);
    auto pusher = mine.advertise<Number>("/t");
    joined.tell();
    must(eventually(
             [&] {
               try {
                 (void)pusher.loan();  // until it throws
               } catch (const lot::Error& e) {
                 return e.error_number() == ESTALE;
               }
               return false;
             },
             20s),
         "an error that says so");
    lot::ShmEngine again(options);
    auto another = again.advertise<Number>("/t");
    must(another.push(another.loan(std::uint64_t{1})) == lot::Status::Ok, "a message");
    joined.tell();
    must(leave.next() == '.', "the order");
  });
  REQUIRE(joined.next() != 0);
  const std::uint32_t incarnation = seat::incarnation(seats.of(2));
  const std::uint64_t others =
      is_judged ? seat::make(incarnation, seat::kJudged) : seat::make(incarnation + 1, seat::kDied);
  const std::uint64_t before = seats.of(2);
  seats.set(2, others);
  REQUIRE(joined.next() != 0);
  CHECK(seats.of(2) != seat::make(incarnation, seat::notice(before)));
  leave.tell();
  CHECK(victim.wait() == 0);
  CHECK(!seat::stands(seats.of(2)));
  CHECK(eventually([&] { return !seats.is_there(2); }));  // all that it had is reaped
}

TEST_CASE("a process taken for dead leaves errands and locks to the next one of its index") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  const lot::ShmEngine engine(options);
  Seats seats(engine);
  Steps joined, leave;
  Child victim([&] {
    const auto mine = lot::detail::join(options);
    joined.tell();
    must(eventually([&] { return mine->inert(); }), "it knows");
    // Inert comes first, its name goes a moment later.
    must(eventually([&] {
           return error_of([&] {
                    const lot::registry::Registry::Lock lock(mine->registry());
                  }).first == ESTALE;
         }),
         "no lock in the old name");
    must(!mine->registry().try_lock(), "nor another way");
    must(eventually([] { return !has_thread("lot-witness"); }), "the kernel's list has gone");
    joined.tell();
    must(leave.next() == '.', "the order");
  });
  REQUIRE(joined.next() != 0);
  usleep(50000);  // its warden sleeps
  auto& errands = seats.segment().witnesses()[2].errands;
  const std::uint64_t next = seat::make(seat::incarnation(seats.of(2)) + 1, 1 | seat::kSleepers);
  seats.set(2, next);
  CHECK(errands.bring(lot::segment::errand::kTrim));
  lot::futex::wake_all(errands.word());
  CHECK(joined.next() != 0);
  CHECK((errands.waiting() & lot::segment::errand::kTrim) != 0);
  CHECK(seats.of(2) == next);
  leave.tell();
  CHECK(victim.wait() == 0);
  CHECK(seats.of(2) == next);
  seats.set(2, next | seat::kDied);
  CHECK(eventually([&] { return !seats.is_there(2); }));
}

TEST_SUITE_END();
