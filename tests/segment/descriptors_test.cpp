// SPDX-License-Identifier: Apache-2.0
#include "segment/descriptors.hpp"

#include <atomic>
#include <cerrno>
#include <csignal>
#include <fcntl.h>
#include <pthread.h>
#include <string>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/processes.hpp"

using namespace lot;
using namespace lot::testing;

namespace {

bool is_open(int fd) { return fcntl(fd, F_GETFD) != -1; }

ino_t file_at(int fd) {
  struct stat status {};
  return fstat(fd, &status) == 0 ? status.st_ino : 0;
}

/// Which of 0, 1 and 2 are open: bit n for n.
unsigned standard_ones() { return is_open(0) * 1U + is_open(1) * 2U + is_open(2) * 4U; }

/// A child without those of 0, 1 and 2 that `closed` names. What goes wrong, it says by the
/// standard error of its parent.
template <class Body>
Child child_without(unsigned closed, const Body& body) {
  return Child([=] {
    const int errors = fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, 100);
    for (int standard = 0; standard < 3; ++standard) {
      if ((closed >> standard & 1U) != 0) close(standard);
    }
    const unsigned before = standard_ones();
    try {
      body();
      must(standard_ones() == before, "0, 1 and 2 are open or closed as before");
    } catch (...) {
      dup2(errors, STDERR_FILENO);
      throw;
    }
  });
}

}  // namespace

TEST_CASE("a file is opened above the standard descriptors, whichever are closed") {
  const Watchdog watchdog(60);
  for (unsigned closed = 0; closed < 8; ++closed) {
    CAPTURE(closed);
    CHECK(child_without(closed, [] {
            const int fd = segment::open_file("/proc/self/exe", O_RDONLY);
            must(fd > 2, "the file is above 2");
            struct stat named {};
            must(stat("/proc/self/exe", &named) == 0 && file_at(fd) == named.st_ino,
                 "it is that file");
            must(fcntl(fd, F_GETFD) == FD_CLOEXEC, "exec closes it");
            errno = 0;
            must(segment::open_file("/nowhere", O_RDONLY) == -1 && errno == ENOENT,
                 "errno is open's");
          }).wait() == 0);
  }
}

TEST_CASE("errno is that of open(), though another thread closes standard descriptors meanwhile") {
  const Watchdog watchdog(60);
  CHECK(child_without(7, [] {
          const std::string fifo = "/tmp/" + unique_name();
          must(mkfifo(fifo.c_str(), 0600) == 0, "a FIFO, where open() waits for its other end");
          struct sigaction interrupts {};
          interrupts.sa_handler = [](int) {};
          sigaction(SIGUSR1, &interrupts, nullptr);  // no SA_RESTART: open() ends with EINTR
          std::atomic<int> error{0};
          std::thread opener([&] {
            const int fd = segment::open_file(fifo, O_RDONLY);
            error.store(fd == -1 ? errno : -1);
          });
          while (!is_open(2)) std::this_thread::yield();  // it comes last
          for (int standard = 0; standard < 3; ++standard) close(standard);
          while (error.load() == 0) {
            pthread_kill(opener.native_handle(), SIGUSR1);
            usleep(1000);
          }
          opener.join();
          unlink(fifo.c_str());
          must(error.load() == EINTR, "errno is open's");
        }).wait() == 0);
}

TEST_CASE("a descriptor that is no file moves above the standard ones") {
  const Watchdog watchdog(60);
  CHECK(child_without(7, [] {
          const int event = segment::above_standard(eventfd(0, EFD_CLOEXEC));
          must(event > 2 && eventfd_write(event, 1) == 0, "it is an eventfd above 2");
          must(segment::above_standard(event) == event, "it stays where it is");
          errno = EMFILE;
          must(segment::above_standard(-1) == -1 && errno == EMFILE, "none is none, and says why");
        }).wait() == 0);
}

TEST_CASE("a process without standard descriptors prints into nothing of LOT") {
  const Watchdog watchdog(60);
  const EngineOptions options = fresh();
  const Steps up;
  const Steps go_on;
  Child printer = child_without(7, [&] {
    const auto print = [] {
      for (const int fd : {STDOUT_FILENO, STDERR_FILENO}) {
        must(write(fd, "text", 4) == -1 && errno == EBADF, "what it prints goes nowhere");
      }
    };
    ShmEngine engine(options);
    print();
    auto pusher = engine.advertise<int>("t");
    auto puller = engine.subscribe<int>("u");
    must(puller.fd() > 2, "the descriptor of a puller is above 2");
    print();
    up.tell();
    must(go_on.next() != 0 && pusher.push(pusher.loan(7)) == Status::Ok, "it publishes");
    must(go_on.next() != 0, "it is told to end");
    print();
  });
  REQUIRE(up.next() != 0);
  ShmEngine engine(options);  // the lock file must be empty, and the segment's header whole
  auto puller = engine.subscribe<int>("t");
  go_on.tell();
  const auto message = puller.pull(20s);
  REQUIRE(message);
  CHECK(*message == 7);
  go_on.tell();
  CHECK(printer.wait() == 0);
}
