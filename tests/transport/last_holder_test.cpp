// SPDX-License-Identifier: Apache-2.0

// When messages die whose last holder is another process, and who gets the memory then.

#include <atomic>
#include <csignal>
#include <cstddef>
#include <optional>
#include <thread>
#include <ucontext.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/block_words.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/raw.hpp"
#include "transport/participant.hpp"

namespace {

using namespace lot::testing;

struct Frame {
  int number = 0;
  lot::ShmVector<char> data;
};

int destroyed = 0;
struct Counted {
  int number = 0;
  ~Counted() { ++destroyed; }
};

lot::PusherOptions newest_only() {
  lot::PusherOptions options;
  options.depth = 1;
  return options;
}

#ifdef __x86_64__

/// Lets this thread run instruction by instruction, with a look after each.
class Stepping {
 public:
  using Look = void (*)();
  explicit Stepping(Look look) {
    look_ = look;
    struct sigaction action {};
    action.sa_sigaction = &stepped;
    action.sa_flags = SA_SIGINFO;
    sigaction(SIGTRAP, &action, &before_);
    raise(SIGTRAP);
  }
  ~Stepping() {
    look_ = nullptr;  // seen after this instruction
    sigaction(SIGTRAP, &before_, nullptr);
  }

 private:
  static void stepped(int, siginfo_t*, void* context) {
    auto& flags = static_cast<ucontext_t*>(context)->uc_mcontext.gregs[REG_EFL];
    constexpr greg_t kTrap = 0x100;
    const Look look = look_;
    flags = look != nullptr ? flags | kTrap : flags & ~kTrap;
    if (look != nullptr) look();
  }

  static inline std::atomic<Look> look_{nullptr};
  struct sigaction before_ {};
};

std::atomic<const lot::segment::BlockWords*> looked_at{nullptr};
std::atomic<const lot::transport::Pool*> pool_of_it{nullptr};
std::atomic<int> waits{0};
std::atomic<int> waits_unfound{0};

#endif

}  // namespace

template <>
struct lot::is_trusted_message<Counted> : std::true_type {};

TEST_SUITE_BEGIN("transport");

TEST_CASE("a message dies when its last holder, another process, goes") {
  const Watchdog watchdog(60);
  const auto options = fresh(256 << 20);
  Steps has, go, gone;
  bool dies = false;
  bool killed = false;
  SUBCASE("it drops its pointer") {}
  SUBCASE("it drops a weak pointer's lock") { dies = true; }
  SUBCASE("it is killed") { killed = true; }
  Child holder([&] {
    lot::ShmEngine engine(options);
    auto in = engine.subscribe<Frame>("frames");
    has.tell();
    auto message = in.pull(60s);
    if (dies) {
      const lot::ShmWeakPtr<const Frame> weak = message;
      message = weak.lock();
    }
    has.tell();
    go.next();
    if (killed) raise(SIGKILL);
    message.reset();
    gone.tell();
    go.next();
  });
  REQUIRE(has.next() == '.');
  lot::ShmEngine engine(options);
  auto out = engine.advertise<Frame>("frames", newest_only());
  REQUIRE(out.wait_for_readers(1, 60s));
  lot::ShmWeakPtr<Frame> weak;
  {
    const lot::ShmSharedPtr<Frame> message = out.loan();
    message->data.resize(60 << 20);
    weak = message;
    REQUIRE(out.push(message) == lot::Status::Ok);
  }
  REQUIRE(has.next() == '.');
  for (int i = 0; i < 3; ++i) REQUIRE(out.push(out.loan()) == lot::Status::Ok);
  CHECK(!weak.expired());
  go.tell();
  // The home does nothing more: no loan, no push.
  while (!weak.expired()) std::this_thread::sleep_for(1ms);
  CHECK(weak.lock() == nullptr);
  go.tell();
  holder.wait();
}

TEST_CASE("a message dies with its last holder though its publisher does nothing more") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps has, go;
  bool borrows = false;
  std::size_t bytes = 100;
  lot::PusherOptions sending = newest_only();
  SUBCASE("small: it waits for others like it") {}
  SUBCASE("large, and borrowed when it left the queue") {
    borrows = true;
    bytes = 1 << 20;
  }
  SUBCASE("of a queue without loss") { sending.policy = lot::Policy::Block; }
  Child holder([&] {
    lot::ShmEngine engine(options);
    auto in = engine.subscribe<Frame>("frames");
    has.tell();
    lot::ShmSharedPtr<const Frame> message;
    if (borrows) {
      auto look = in.borrow(60s);
      has.tell();
      go.next();
      message = look.keep();
    } else {
      message = in.pull(60s);
      has.tell();
      go.next();
    }
    message.reset();
    has.tell();
    go.next();
  });
  REQUIRE(has.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto out = engine.advertise<Frame>("frames", sending);
    REQUIRE(out.wait_for_readers(1, 60s));
    {  // blocks to spare: its loans look at nothing
      std::vector<lot::ShmUniquePtr<Frame>> spare;
      for (int i = 0; i < 40; ++i) spare.push_back(out.loan());
    }
    lot::ShmWeakPtr<Frame> weak;
    {
      const lot::ShmSharedPtr<Frame> message = out.loan();
      message->data.resize(bytes);
      weak = message;
      REQUIRE(out.push(message) == lot::Status::Ok);
    }
    REQUIRE(has.next() == '.');
    auto next = out.loan();
    next->data.resize(bytes);
    REQUIRE(out.push(std::move(next)) == lot::Status::Ok);
    CHECK(!weak.expired());
    go.tell();
    REQUIRE(has.next() == '.');
    while (!weak.expired()) std::this_thread::sleep_for(1ms);  // else the watchdog
  }
  go.tell();
  CHECK(holder.wait() == 0);
}

TEST_CASE("memory that lies idle in one process is had by another one that is short of it") {
  const Watchdog watchdog(60);
  const auto options = fresh(64 << 20);
  Steps ready, done;
  Child idle([&] {
    lot::ShmEngine engine(options);
    for (int i = 0; i < 2; ++i) {
      std::vector<lot::ShmUniquePtr<Frame>> some;
      for (int n = 0; n < 5; ++n) {
        some.push_back(engine.make<Frame>());
        some.back()->data.resize(8 << 20);
      }
    }
    ready.tell();  // its pool has 40 MiB that wait for the next loan
    done.next();
  });
  REQUIRE(ready.next() == '.');
  {
    lot::ShmEngine engine(options);
    std::vector<lot::ShmUniquePtr<Frame>> some;
    for (int n = 0; n < 5; ++n) {
      some.push_back(engine.make<Frame>());
      CHECK_NOTHROW(some.back()->data.resize(8 << 20));
    }
  }
  done.tell();
  CHECK(idle.wait() == 0);
}

TEST_CASE("a stopped process is not waited for when memory is short") {
  const Watchdog watchdog(60);
  const auto options = fresh(64 << 20);
  Steps ready, done;
  Child stopped([&] {
    lot::ShmEngine engine(options);
    ready.tell();
    done.next();
  });
  REQUIRE(ready.next() == '.');
  REQUIRE(kill(stopped.pid(), SIGSTOP) == 0);
  {
    lot::ShmEngine engine(options);
    auto message = engine.make<Frame>();
    CHECK_THROWS_AS(message->data.resize(100 << 20), lot::OutOfMemory);
  }
  REQUIRE(kill(stopped.pid(), SIGCONT) == 0);
  done.tell();
  CHECK(stopped.wait() == 0);
}

TEST_CASE("a message that was kept by others and pushed again dies with its last pointer") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Steps has, go;
  Child holder([&] {
    lot::ShmEngine engine(options);
    auto in = engine.subscribe<Counted>("counted");
    has.tell();
    auto message = in.pull(60s);
    has.tell();
    go.next();
    message.reset();
    has.tell();
    go.next();
  });
  REQUIRE(has.next() == '.');
  {
    lot::ShmEngine engine(options);
    auto out = engine.advertise<Counted>("counted", newest_only());
    REQUIRE(out.wait_for_readers(1, 60s));
    {  // a pool with blocks to spare: its next loans look at nothing
      std::vector<lot::ShmUniquePtr<Counted>> spare;
      for (int i = 0; i < 400; ++i) spare.push_back(out.loan());
    }
    lot::ShmSharedPtr<Counted> message = out.loan();
    const lot::ShmWeakPtr<Counted> weak = message;
    REQUIRE(out.push(message) == lot::Status::Ok);
    REQUIRE(has.next() == '.');
    REQUIRE(out.push(out.loan()) == lot::Status::Ok);
    message.reset();
    for (int i = 0; i < 1000; ++i) REQUIRE(out.push(out.loan()) == lot::Status::Ok);
    message = weak.lock();  // the block is among those that others hold
    REQUIRE(message != nullptr);
    REQUIRE(out.push(message) == lot::Status::Ok);
    message.reset();
    go.tell();
    REQUIRE(has.next() == '.');
    for (int i = 0; i < 200; ++i) REQUIRE(out.push(out.loan()) == lot::Status::Ok);
    // From here on messages that no other process ever sees.
    for (int round = 0; round < 3; ++round) {
      std::vector<lot::ShmSharedPtr<Counted>> messages;
      for (int i = 0; i < 200; ++i) messages.push_back(out.loan());
      for (auto& m : messages) {
        const lot::ShmWeakPtr<Counted> last = m;
        const int before = destroyed;
        m.reset();
        REQUIRE(last.expired());
        REQUIRE(destroyed == before + 1);
      }
    }
  }
  go.tell();
  CHECK(holder.wait() == 0);
}

#ifdef __x86_64__

TEST_CASE("a home says that it waits for a holder when its warden can find the block") {
  const Watchdog watchdog(60);
  lot::ShmEngine engine(fresh());
  auto out = engine.advertise<Frame>("frames", newest_only());
  const auto loan = [&] {
    auto frame = out.loan();
    frame->data.resize(1 << 20);  // so large that no publish leaves it to the next
    return frame;
  };
  auto frame = loan();
  auto& p = *lot::transport::Participant::at(frame.get());
  const auto at = p.segment().offset_of(frame.get()) - p.segment().offset_of(p.segment().small(0));
  const auto b = static_cast<std::uint32_t>(at / lot::segment::kSmallBytes);
  lot::ShmSharedPtr<Frame> shared = std::move(frame);
  const lot::ShmWeakPtr<Frame> weak = shared;
  REQUIRE(out.push(shared) == lot::Status::Ok);
  shared.reset();
  // What another process does that keeps it.
  auto& words = p.segment().block(b);
  const std::uint32_t other = p.world().participants() - 1;
  auto& own = lot::test::raw(lot::transport::HardwareOwnership::word(words, other));
  own.fetch_or(lot::transport::HardwareOwnership::bit(other));
  lot::test::raw(words.life).fetch_add(lot::refcount::kVersion);

  looked_at = &words;
  pool_of_it = &p.holder().pool_of(b);
  frame = loan();
  {
    const Stepping stepping([] {
      if (!lot::test::home_waits(*looked_at.load())) return;
      ++waits;
      if (pool_of_it.load()->kept() == 0) ++waits_unfound;
    });
    must_go(out.push(std::move(frame)));
  }
  CHECK(waits > 0);
  CHECK(waits_unfound == 0);
  CHECK(!weak.expired());
  own.fetch_and(~lot::transport::HardwareOwnership::bit(other));
  p.holder().tell_home(b);
  while (!weak.expired()) std::this_thread::sleep_for(1ms);
}

#endif

TEST_SUITE_END();
