// SPDX-License-Identifier: Apache-2.0

// An application closes descriptors that are not its own, and uses their numbers for its own files.

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <functional>
#include <list>
#include <optional>
#include <string>
#include <sys/mman.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "liveness/lock_file.hpp"
#include "lock_spy.hpp"
#include "lockfree_ring/words.hpp"
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

/// A file of the application. It has no name, so that nothing can be left of it.
class OwnFile {
 public:
  OwnFile() : number_(memfd_create("own", MFD_CLOEXEC)) {
    must(pwrite(number_, "mine", 4, 0) == 4 && fstat(number_, &before_) == 0, "an own file");
  }
  ~OwnFile() { close(number_); }
  OwnFile(const OwnFile&) = delete;
  OwnFile& operator=(const OwnFile&) = delete;

  int number() const { return number_; }
  bool untouched() const {
    struct stat now {};
    char text[5] = {};
    return fstat(number_, &now) == 0 && now.st_ino == before_.st_ino && now.st_size == 4 &&
           now.st_mode == before_.st_mode && pread(number_, text, 4, 0) == 4 &&
           std::string(text) == "mine";
  }

 private:
  int number_;
  struct stat before_ {};
};

/// Own files that use up the free numbers until they have the wanted one.
class OwnFiles {
 public:
  void take(int wanted) {
    for (int n = 0; n < 100; ++n) {
      if (files_.emplace_back().number() == wanted) return;
    }
    must(false, "the number was free");
  }
  bool untouched() const {
    for (const OwnFile& f : files_) {
      if (!f.untouched()) return false;
    }
    return stray_locks() == 0;
  }

 private:
  std::list<OwnFile> files_;
};

/// Our descriptor of the segment's lock file, or -1.
int lock_descriptor(const lot::EngineOptions& options) {
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code gone;
    if (std::filesystem::read_symlink(entry, gone) == file_of(options) + ".lock") {
      return std::stoi(entry.path().filename());
    }
  }
  return -1;
}

/// The descriptors that are open now are the test's; those that come later are closed.
int first_of_others() {
  const int last = dup(2);
  close(last);
  return last;
}

constexpr std::uint64_t kLast = 300;

/// A process that closes its descriptors in the middle of something, seen from inside.
struct Careless {
  lot::ShmEngine& engine;
  /// Closes everything, opens own files, and lets the neighbours look for a while.
  std::function<void()> close_all;
  lot::ShmPuller<Number> in = engine.subscribe<Number>("/in", {Wait::Park, 1});

  void read_to_the_end(std::uint64_t next) {
    while (next <= kLast) {
      const auto seen = in.pull();
      must(seen->value == next++ && in.missed() == 0, "each number of /in");
    }
  }
};

struct Reader {
  explicit Reader(Wait w) : wait(w) {}
  void operator()(Careless& self) const {
    self.in = self.engine.subscribe<Number>("/in", {wait, 1});
    must(self.in.pull()->value == 0, "what was there");
    std::atomic<pid_t> thread{0};
    std::thread reader([&] {
      thread = gettid();
      self.read_to_the_end(1);
    });
    must(eventually([&] { return thread != 0 && asleep(getpid(), thread); }), "it sleeps");
    self.close_all();
    reader.join();
  }
  Wait wait;
};

void borrows(Careless& self) {
  const auto look = self.in.borrow();
  const auto* bytes = look.get();
  self.close_all();
  auto other = self.engine.subscribe<Number>("/in", {Wait::Park, 1});  // all may have been sent
  while (other.pull()->value < kLast) {
  }
  must(look.get() == bytes && look->value == 0, "the borrowed message is as it was");
  const auto kept = look.keep();
  must(kept->value == 0 && kept.use_count() == 1, "it can still be kept");
}

void keeps(Careless& self) {
  const auto kept = self.in.pull();
  const lot::ShmWeakPtr<const Number> weak = kept;
  self.close_all();
  self.read_to_the_end(1);
  must(kept->value == 0 && weak.lock() == kept, "the kept message is as it was");
}

void waits_for_room(Careless& self) {
  auto out = self.engine.advertise<Number>("/out", {Policy::Block, 2, 60s});
  std::atomic<pid_t> thread{0};
  must(out.wait_for_readers(1, 10s), "the reader of /out");
  std::thread publisher([&] {
    thread = gettid();
    for (std::uint64_t n = 0; n <= kLast; ++n) {
      must(out.push(out.loan(n)) == Status::Ok, "a push");
    }
  });
  must(eventually([&] { return thread != 0 && asleep(getpid(), thread); }), "it sleeps");
  self.close_all();
  publisher.join();
}

void publishes(Careless& self) {
  auto out = self.engine.advertise<Number>("/out", {Policy::Block, 64, 60s});
  must(out.wait_for_readers(1, 10s), "the reader of /out");
  std::atomic<bool> enough{false};
  std::thread publisher([&] {
    std::uint64_t n = 0;
    while (!enough) must(out.push(out.loan(n++)) == Status::Ok, "a push");
    must(out.push(out.loan(~std::uint64_t{0})) == Status::Ok, "the last push");
  });
  self.close_all();
  enough = true;
  publisher.join();
}

struct State {
  const char* name;
  void (*run)(Careless&);
  bool reads_out_at_once;
};

}  // namespace

TEST_SUITE_BEGIN("descriptors");

TEST_CASE("closefrom() in any state: no neighbour reaps it, it goes on, joins topics and leaves") {
  const Watchdog watchdog(100);
  const State states[] = {
      {"asleep in pull, parked", [](Careless& c) { Reader{Wait::Park}(c); }, false},
      {"asleep in pull, adaptive", [](Careless& c) { Reader{Wait::Adaptive}(c); }, false},
      {"holding a borrow", borrows, false},
      {"holding kept pointers", keeps, false},
      {"asleep for room", waits_for_room, false},
      {"publishing", publishes, true}};
  for (const State& state : states) {
    CAPTURE(state.name);
    const Ground options;
    Neighbour neighbour(options);
    Steps ready, closed, looked, done;
    const int first = first_of_others();
    Child careless([&] {
      lot::ShmEngine engine(named(options, "careless"));
      OwnFiles own;
      Careless self{engine, [&] {
                      const int lock = lock_descriptor(options);
                      must(lock >= first, "the lock file is open");
                      closefrom(first);
                      own.take(lock);
                      closed.tell();
                      must(looked.next() == '.', "the neighbours have looked");
                    }};
      ready.tell();
      state.run(self);
      auto news = engine.advertise<Number>("/new");
      must_go(news.push(news.loan(kLast)));
      must(done.next() == '.', "the end");
      must(own.untouched(), "what is the application's was not touched");
    });
    REQUIRE(ready.next() == '.');
    {
      lot::ShmEngine engine(options);
      auto in = engine.advertise<Number>("/in", {Policy::Overwrite, 1024, 1s});
      auto out = engine.subscribe<Number>("/out");
      auto news = engine.subscribe<Number>("/new");
      lot::segment::Segment s(engine.path());
      const std::uint32_t index = index_of(s, "careless");
      REQUIRE(index != 0);
      must_go(in.push(in.loan(std::uint64_t{0})));
      std::uint64_t next = 0;
      bool may_read = state.reads_out_at_once;
      const auto read_out = [&] {
        if (!may_read) {
          out.publishers();  // it joins, and reads nothing
          return;
        }
        while (auto seen = out.try_pull()) {
          if (seen->value == ~std::uint64_t{0}) return;
          REQUIRE(seen->value == next++);
        }
      };
      CHECK(eventually([&] {
        read_out();
        return closed.next(0ms) == '.';
      }));
      eventually(  // the wardens look each second, the neighbour all the time
          [&] {
            read_out();
            return false;
          },
          1250ms);
      may_read = true;
      CHECK(s.participants()[index].state.load() == 1);
      looked.tell();
      for (std::uint64_t n = 1; n <= kLast; ++n) {
        must_go(in.push(in.loan(n)));
        read_out();
        if (n % 8 == 0) usleep(100);
      }
      lot::ShmSharedPtr<const Number> last;
      CHECK(eventually([&] {
        read_out();
        return bool(last = news.try_pull());
      }));
      CHECK((last && last->value == kLast));
      CHECK((state.run != &waits_for_room || next == kLast + 1));
      CHECK(out.missed_total() == 0);
      CHECK(s.participants()[index].state.load() == 1);
      lot::liveness::LockFile file(engine.path() + ".lock");
      CHECK(eventually([&] { return file.held_by_other(index); }));  // it has its lock again
      done.tell();
      CHECK(careless.wait() == 0);
      CHECK(eventually([&] { return s.participants()[index].state.load() == 0; }));
    }
    CHECK(neighbour.leave() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("dup2() over the lock file's descriptor leaves what it was made to name alone") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Child careless([&] {
    OwnFile own;
    lot::ShmEngine engine(named(options, "careless"));
    auto pusher = engine.advertise<Number>("/t");
    auto puller = engine.subscribe<Number>("/t");
    const int number = lock_descriptor(options);
    must(dup2(own.number(), number) == number, "dup2");
    std::this_thread::sleep_for(350ms);
    lot::segment::Segment s(engine.path());
    must(index_of(s, "careless") != 0, "not reaped");
    must_go(pusher.push(pusher.loan(std::uint64_t{7})));
    must(puller.pull(10s)->value == 7, "it goes on");
    must(eventually([&] { return lock_descriptor(options) != -1; }), "it is open again");
    must(lock_descriptor(options) != number, "the library has opened another one");
    must(own.untouched() && stray_locks() == 0, "the file behind it was not touched");
    struct stat through {};
    must(fstat(number, &through) == 0 && through.st_size == 4, "nor was the number closed");
  });
  CHECK(careless.wait() == 0);
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("two neighbours that close everything at the same moment both live") {
  const Watchdog watchdog(60);
  const Ground options;
  Neighbour neighbour(options);
  Steps ready, go, done;
  const int first = first_of_others();
  std::vector<Child> careless;
  for (const std::uint64_t me : {0U, 1U}) {
    careless.emplace_back([&, me] {
      lot::ShmEngine engine(named(options, me == 0 ? "one" : "two"));
      auto pusher = engine.advertise<Number>("/" + std::to_string(me));
      ready.tell();
      must(go.next() == '.', "both are there");
      auto puller = engine.subscribe<Number>("/" + std::to_string(1 - me));
      must(pusher.wait_for_readers(1, 10s), "both listen");
      for (std::uint64_t round = 0; round < 5; ++round) {
        closefrom(first);
        OwnFiles own;
        own.take(first);
        for (std::uint64_t n = 0; n < 50; ++n) {
          must_go(pusher.push(pusher.loan(round * 50 + n)));
          const auto seen = puller.pull(10s);
          must(seen && seen->value == round * 50 + n, "each message of the other");
        }
        must(own.untouched(), "what is the application's was not touched");
      }
      ready.tell();
      must(done.next() == '.', "the end");
    });
  }
  for (int i = 0; i < 2; ++i) REQUIRE(ready.next() == '.');
  lot::segment::Segment s(file_of(options));
  const auto before = taken(s);
  CHECK(before.size() == 3);
  for (int i = 0; i < 2; ++i) go.tell();
  for (int i = 0; i < 2; ++i) REQUIRE(ready.next() == '.');
  CHECK(taken(s) == before);
  for (int i = 0; i < 2; ++i) done.tell();
  for (auto& c : careless) CHECK(c.wait() == 0);
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a stopped process that has lost its lock keeps its index, its segment and its files") {
  const Watchdog watchdog(60);
  const Ground options;
  Steps ready, closed, done;
  const int first = first_of_others();
  Child careless([&] {
    lot::ShmEngine engine(named(options, "careless"));
    auto pusher = engine.advertise<Number>("/t");
    ready.tell();
    must(done.next() == '.', "the order");
    closefrom(first);
    closed.tell();
    raise(SIGSTOP);
    must_go(pusher.push(pusher.loan(std::uint64_t{7})));
    must(done.next() == '.', "the end");
  });
  REQUIRE(ready.next() == '.');
  lot::segment::Segment s(file_of(options));
  const std::uint32_t index = index_of(s, "careless");
  done.tell();
  REQUIRE(closed.next() == '.');
  int status = 0;
  REQUIRE(waitpid(careless.pid(), &status, WUNTRACED) == careless.pid());
  REQUIRE(WIFSTOPPED(status));
  for (int round = 0; round < 2; ++round) {  // the second one finds what the first one left
    Child passing([&] {
      lot::ShmEngine engine(named(options, "passing"));
      must(index_of(s, "passing") != index && index_of(s, "passing") != 0, "another index");
      std::this_thread::sleep_for(150ms);  // its warden has looked when it joined
    });
    CHECK(passing.wait() == 0);
    CHECK(files_of(options) == 2);
    CHECK(s.participants()[index].state.load() == 1);
  }
  {
    lot::ShmEngine engine(options);
    auto puller = engine.subscribe<Number>("/t");
    careless.send(SIGCONT);
    CHECK(puller.pull(20s)->value == 7);
    done.tell();
    CHECK(careless.wait() == 0);
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("a process in two segments: each lock file comes back, whichever gets which number") {
  const Watchdog watchdog(60);
  const Ground one, two;
  Neighbour next_to_one(one), next_to_two(two);
  Child careless([&] {
    lot::ShmEngine a(one), b(two);
    auto pusher = a.advertise<Number>("/t");
    auto puller = b.subscribe<Number>("/t");
    const int lowest = std::min(lock_descriptor(one), lock_descriptor(two));
    for (int round = 0; round < 10; ++round) {
      closefrom(lowest);
      // Whoever looks first gets the number that the other one had.
      must(eventually([&] { return lock_descriptor(one) != -1 && lock_descriptor(two) != -1; }),
           "both are open again");
    }
    lot::liveness::LockFile file_one(file_of(one) + ".lock");
    lot::liveness::LockFile file_two(file_of(two) + ".lock");
    const auto held = [](lot::liveness::LockFile& file) {
      int n = 0;
      for (std::uint32_t k = 1; k < lot::segment::kMaxParticipants; ++k) n += file.held_by_other(k);
      return n;
    };
    must(eventually([&] { return held(file_one) == 2 && held(file_two) == 2; }), "both locks");
    must(stray_locks() == 0, "nothing else was locked");
    must_go(pusher.push(pusher.loan(std::uint64_t{1})));
    must(puller.try_pull() == nullptr, "the segments have nothing to do with each other");
  });
  CHECK(careless.wait() == 0);
  CHECK(next_to_one.leave() == 0);
  CHECK(next_to_two.leave() == 0);
  CHECK(files_of(one) + files_of(two) == 0);
}

TEST_CASE("a process that is twice in a segment: one of the two may get the other's number") {
  const Watchdog watchdog(60);
  const Ground options;
  lot::EngineOptions detour = options;
  detour.directory += "/.";  // the same files by another name: a participant of its own
  Neighbour neighbour(options);
  Child careless([&] {
    lot::ShmEngine first(named(options, "first"));
    lot::segment::Segment s(first.path());
    const int number = lock_descriptor(options);
    close(number);
    lot::ShmEngine second(named(detour, "second"));
    must(lock_descriptor(options) == number, "the second one has the first one's number");
    must(index_of(s, "first") != 0 && index_of(s, "second") != 0, "two participants");
    auto pusher = first.advertise<Number>("/t");
    auto puller = second.subscribe<Number>("/t");
    for (std::uint64_t n = 0; n < 350; ++n) {
      must_go(pusher.push(pusher.loan(n)));
      must(puller.pull(10s)->value == n, "messages cross");
      usleep(1000);
    }
    must(index_of(s, "first") != 0 && index_of(s, "second") != 0, "nobody was reaped");
  });
  CHECK(careless.wait() == 0);
  CHECK(neighbour.leave() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("a process that has closed its descriptors and is killed then is reaped") {
  const Watchdog watchdog(60);
  for (const bool at_once : {true, false}) {
    CAPTURE(at_once);
    const Ground options;
    Neighbour neighbour(options);
    Steps closed;
    const int first = first_of_others();
    Child careless([&] {
      lot::ShmEngine engine(named(options, "careless"));
      auto pusher = engine.advertise<Number>("/t");
      const auto loan = pusher.loan();
      closefrom(first);
      if (!at_once) std::this_thread::sleep_for(300ms);  // until it has its lock again
      closed.tell();
      pause();
    });
    REQUIRE(closed.next() == '.');
    careless.kill9();
    CHECK(leak_in(file_of(options)) == "");
    lot::segment::Segment s(file_of(options));
    CHECK(eventually([&] { return taken(s).size() == 1; }));
    CHECK(neighbour.leave() >= 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_CASE("without lock file and descriptor, a process leaves other processes' files alone") {
  const Watchdog watchdog(60);
  const Ground options;
  Child careless([&] {
    OwnFiles own;
    {
      lot::ShmEngine engine(options);
      const int lock = lock_descriptor(options);
      std::filesystem::remove(file_of(options) + ".lock");
      close(lock);
      own.take(lock);
    }
    must(own.untouched(), "what has the number now was not touched");
  });
  CHECK(careless.wait() == 0);
  std::filesystem::remove(file_of(options));
  CHECK(files_of(options) == 0);
}

TEST_CASE("descriptors closed while a process joins: an error that says so, or it goes on") {
  const Watchdog watchdog(120);
  for (const bool stale : {false, true}) {  // another segment is there, which nobody uses
    CAPTURE(stale);
    bool goes_on = false;
    for (int n = 1; n <= 14; ++n) {  // at its n-th lock or unlock
      CAPTURE(n);
      const Ground options;
      if (stale) {
        lot::EngineOptions larger = options;
        larger.size_bytes *= 2;
        larger.persist = true;
        const lot::ShmEngine before(larger);
      }
      Child joining([&] {
        close_at_lock(n);
        try {
          lot::ShmEngine engine(options);
          auto pusher = engine.advertise<Number>("/t");
          auto puller = engine.subscribe<Number>("/t");
          must_go(pusher.push(pusher.loan(std::uint64_t{7})));
          must(puller.pull(10s)->value == 7, "it goes on");
        } catch (const lot::Error& e) {
          must(e.error_number() == EBADF, e.what());
          _exit(1);
        }
      });
      const int status = joining.wait();
      CHECK(status <= 1);
      // Without the gate or without its byte it is refused; it goes on once it has its byte.
      if (n == 1) CHECK(status == 1);
      if (goes_on) CHECK(status == 0);
      goes_on = status == 0;
      { const lot::ShmEngine next(options); }
      CHECK(files_of(options) == 0);
    }
    CHECK(goes_on);
  }
}

TEST_CASE("closefrom() in the middle of a reap: what has the number then is not unlocked") {
  const Watchdog watchdog(60);
  const Ground options;
  Steps joined, dead, done;
  Child careless([&] {
    OwnFiles own;
    std::optional<lot::ShmEngine> engine(named(options, "careless"));
    lot::segment::Segment s(engine->path());
    const int lock = lock_descriptor(options);
    joined.tell();
    must(dead.next() == '.', "the publisher is there");
    const auto is_orphan = [](auto& channel) {
      return lot::ring::writer_state(channel.writer.load()) == lot::ring::State::Orphan;
    };
    while (std::none_of(s.channels().begin(), s.channels().end(), is_orphan)) {
    }
    close(lock);
    own.take(lock);
    must(eventually([&] { return index_of(s, "publisher") == 0; }), "it is reaped");
    engine.reset();
    must(own.untouched(), "what is the application's was not touched");
  });
  REQUIRE(joined.next() == '.');
  Child publisher([&] {
    lot::ShmEngine engine(named(options, "publisher"));
    std::list<lot::ShmPusher<Number>> pushers;  // so deep that the reap takes its time
    for (int i = 0; i < 8; ++i) {
      pushers.push_back(engine.advertise<Number>("/t", {Policy::Overwrite, 65536, 1s}));
    }
    joined.tell();
    pause();
  });
  REQUIRE(joined.next() == '.');
  dead.tell();
  publisher.kill9();
  CHECK(careless.wait() == 0);
  CHECK(files_of(options) == 0);
}

// What the cases above rely on can fail.

TEST_CASE("a neighbour reaps the dead, and the spy sees a lock on a file that is not LOT's") {
  const Watchdog watchdog(60);
  const Ground options;
  {
    Neighbour neighbour(options);
    lot::segment::Segment s(file_of(options));
    for (int n = 0; n < 20;
         ++n) {  // its warden may be faster with some of them, and does not count
      CAPTURE(n);
      Steps ready;
      Child victim([&] {
        const lot::ShmEngine engine(named(options, "victim"));
        ready.tell();
        pause();
      });
      REQUIRE(ready.next() == '.');
      REQUIRE(index_of(s, "victim") != 0);
      victim.kill9();
      CHECK(eventually([&] { return index_of(s, "victim") == 0; }));
    }
    CHECK(neighbour.leave() >= 1);
  }
  CHECK(files_of(options) == 0);

  Child locker([&] {
    const OwnFile own;
    lot::liveness::LockFile file(file_of(options) + ".lock");
    must(file.try_lock(1) && stray_locks() == 0, "a lock file of LOT");
    struct flock all {};
    all.l_type = F_WRLCK;
    must(fcntl(own.number(), F_OFD_SETLK, &all) == 0 && stray_locks() == 1, "another file");
    unlink((file_of(options) + ".lock").c_str());
  });
  CHECK(locker.wait() == 0);
}

TEST_SUITE_END();
