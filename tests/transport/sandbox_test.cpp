// SPDX-License-Identifier: Apache-2.0

// System calls that sandboxes refuse: everything works without them.

#include "support/sandbox.hpp"

#include <cerrno>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "segment/segment.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"

namespace {

using namespace lot::testing;

struct Frame {
  std::uint64_t number = 0;
  lot::ShmVector<std::uint8_t> data;
};

struct Call {
  const char* name;
  std::uint32_t number;
};
constexpr Call kCalls[] = {{"set_robust_list", SYS_set_robust_list},
                           {"futex_waitv", kFutexWaitv},
                           {"membarrier", SYS_membarrier},
                           {"madvise", SYS_madvise},
                           {"fallocate", SYS_fallocate},
                           {"mlock", SYS_mlock},
                           {"sched_setaffinity", SYS_sched_setaffinity}};

constexpr std::uint64_t kFrames = 20;

/// A camera, or a viewer that keeps some of its frames.
void publish(lot::ShmEngine& engine) {
  auto pusher = engine.advertise<Frame>("/t", {lot::Policy::Block, 4, 30s});
  while (pusher.readers() == 0) std::this_thread::sleep_for(1ms);
  for (std::uint64_t n = 0; n < kFrames; ++n) {
    auto frame = pusher.loan();
    frame->number = n;
    frame->data.resize(1 << 20);
    std::memset(frame->data.data(), static_cast<int>(n), frame->data.size());
    must(pusher.push(std::move(frame)) == lot::Status::Ok, "a frame is published");
  }
}
void receive(lot::ShmEngine& engine) {
  auto puller = engine.subscribe<Frame>("/t");
  for (std::uint64_t n = 0; n < kFrames; ++n) {
    const auto frame = puller.pull(30s);
    must(frame && frame->number == n, "the frame");
    must(frame->data.back() == static_cast<std::uint8_t>(n), "its bytes");
    std::thread([kept = frame] { must(kept->data.size() == 1 << 20, "in another thread"); }).join();
  }
}

}  // namespace

TEST_SUITE_BEGIN("sandbox");

TEST_CASE("what a sandbox refuses is done in another way") {
  const Watchdog watchdog(120);
  for (const Call& call : kCalls) {
    for (const int error : {EPERM, ENOSYS}) {
      CAPTURE(call.name);
      CAPTURE(error);
      const auto options = fresh();
      Child camera([&] {
        must(refuse(call.number, error), "a filter");
        lot::ShmEngine engine(options);
        publish(engine);
      });
      Child viewer([&] {
        must(refuse(call.number, error), "a filter");
        lot::ShmEngine engine(options);
        receive(engine);
      });
      CHECK(viewer.wait() == 0);
      CHECK(camera.wait() == 0);
    }
  }
}

TEST_CASE("a viewer that is killed in a sandbox holds no camera up") {
  const Watchdog watchdog(120);
  for (const Call& call : kCalls) {
    CAPTURE(call.name);
    const auto options = fresh();
    lot::ShmEngine engine(options);
    Steps joined;
    Child viewer([&] {
      must(refuse(call.number, EPERM), "a filter");
      lot::ShmEngine mine(options);
      auto puller = mine.subscribe<Frame>("/t");
      joined.tell();
      pause();
    });
    REQUIRE(joined.next() != 0);
    auto pusher = engine.advertise<Frame>("/t", {lot::Policy::Block, 2, 30s});
    for (int n = 0; n < 2; ++n) CHECK(pusher.push(pusher.loan()) == lot::Status::Ok);
    viewer.kill9();
    CHECK(pusher.push(pusher.loan()) == lot::Status::Ok);
  }
}

TEST_CASE("without madvise and fallocate a message throws, and the error names them") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  Child child([&] {
    must(refuse(SYS_madvise, EPERM) && refuse(SYS_fallocate, EPERM), "a filter");
    lot::ShmEngine engine(options);
    const auto [error, text] = error_of([&] {
      auto pusher = engine.advertise<Frame>("/t");
      pusher.loan()->data.resize(1 << 20);
    });
    must(error == 0 && names(text, "the system gives no memory") &&
             names(text, "madvise or fallocate"),
         text.c_str());
  });
  CHECK(child.wait() == 0);
  CHECK(files_of(options) == 0);
}

TEST_CASE("without madvise no memory comes from another segment that lies at the path by now") {
  const Watchdog watchdog(60);
  const auto options = fresh();
  auto others = fresh();
  others.persist = true;
  Child child([&] {
    must(refuse(SYS_madvise, EPERM), "a filter");
    lot::ShmEngine engine(options);
    auto pusher = engine.advertise<Frame>("/t");
    { const lot::ShmEngine other(others); }
    const std::string path = others.directory + "/" + others.segment;
    must(rename(path.c_str(), engine.path().c_str()) == 0, "another file at the path");
    const auto [error, text] = error_of([&] { pusher.loan()->data.resize(1 << 20); });
    unlink((path + ".lock").c_str());
    unlink(engine.path().c_str());
    must(error == 0 && names(text, "the system gives no memory"), text.c_str());
  });
  CHECK(child.wait() == 0);
  CHECK(files_of(others) == 0);
}

TEST_CASE("a sandbox that ends the witness thread alone is an error that names it, and no hang") {
  const Watchdog watchdog(60);
  for (const int call : {SYS_prctl, SYS_set_robust_list, SYS_gettid}) {
    CAPTURE(call);
    const auto options = fresh();
    Child child([&] {
      must(answer(static_cast<std::uint32_t>(call), SECCOMP_RET_KILL_THREAD), "a filter");
      for (int attempt = 0; attempt < 2; ++attempt) {
        const auto [error, text] = error_of([&] { const lot::ShmEngine engine(options); });
        must(error == EPERM && names(text, "the witness thread (lot-witness)") &&
                 names(text, "SECCOMP_RET_KILL_THREAD"),
             text.c_str());
      }
    });
    CHECK(child.wait() == 0);
    CHECK(files_of(options) == 0);
  }
}

TEST_SUITE_END();
