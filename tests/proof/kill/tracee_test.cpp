// SPDX-License-Identifier: Apache-2.0
// What the harness does with a process that ends where no operation would.
#include "tracee.hpp"

#include <csignal>
#include <initializer_list>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include <doctest/doctest.h>

#include "support/processes.hpp"

namespace {

using namespace lot::testing;
using lot::kill::Tracee;

/// A process of three threads. Its first one says that it is there, and raises the signal when it
/// is let go.
class Process {
 public:
  explicit Process(int number)
      : child_([this, number] {
          for (std::thread* thread : {&first_, &second_}) {
            *thread = std::thread([] {
              for (;;) pause();
            });
          }
          there_.tell('t');
          must(go_.next() == 'g', "it was let go");
          signal(number, SIG_DFL);
          raise(number);
        }) {
    CHECK(there_.next() == 't');
  }
  pid_t pid() const { return child_.pid(); }
  void let_go() const { go_.tell('g'); }

 private:
  Steps there_, go_;
  std::thread first_, second_;  // the child's
  Child child_;
};

TEST_CASE("a process of several threads that a signal ends, at a step of the first one") {
  for (const int number : {SIGSEGV, SIGTERM, SIGKILL}) {
    CAPTURE(number);
    Process process(number);
    Tracee tracee(process.pid());
    process.let_go();
    Tracee::Event event;
    do {
      event = tracee.step(1000, 0).event;
    } while (event == Tracee::Event::Stepped || event == Tracee::Event::Asleep);
    CHECK(event == Tracee::Event::Ended);
  }
}

TEST_CASE("a process of several threads that is killed is let go") {
  Process process(SIGTERM);
  Tracee tracee(process.pid());
  kill(process.pid(), SIGKILL);
  tracee.detach();
  process.let_go();  // the pipe is there; the process is not
}

}  // namespace
