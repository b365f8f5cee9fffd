// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <cstring>
#include <exception>
#include <memory>
#include <poll.h>
#include <string>
#include <sys/socket.h>
#include <type_traits>
#include <unistd.h>
#include <utility>

#include "run.hpp"
#include "support/processes.hpp"

/// Processes in lockstep: a conductor tells one of them what to do, and waits for its answer.
namespace lot::outside {

/// One end of a line between the conductor and a process.
class Line {
 public:
  explicit Line(int fd) : fd_(fd) {}
  Line(Line&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Line& operator=(Line&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Line() {
    if (fd_ >= 0) close(fd_);
  }

  template <class T>
  bool send(const T& words) const {
    static_assert(std::is_trivially_copyable_v<T>);
    return ::send(fd_, &words, sizeof(T), MSG_NOSIGNAL) == static_cast<ssize_t>(sizeof(T));
  }
  /// The other end finds that this one has gone, whatever processes have copies of it.
  void end() const { shutdown(fd_, SHUT_RDWR); }
  /// False: none came in time, or the other end has gone.
  template <class T>
  bool receive(T& words, int most_ms) const {
    static_assert(std::is_trivially_copyable_v<T>);
    pollfd p{fd_, POLLIN, 0};
    int result;
    do {
      result = poll(&p, 1, most_ms);
    } while (result == -1 && errno == EINTR);
    return result == 1 &&
           recv(fd_, &words, sizeof(T), MSG_WAITALL) == static_cast<ssize_t>(sizeof(T));
  }

 private:
  int fd_;
};

/// What each answer begins with.
struct Said {
  char wrong[200] = {};  ///< why it could not do it, or ""
};

/// A process that does commands, one after the other. Answer has a member `said`, a Said.
template <class Command, class Answer>
class Puppet {
 public:
  static constexpr int kPatience = 40'000;  // ms: for a process that stands still, no deadline

  /// In the new process make() gives an object, whose act(command, answer) is called.
  template <class Make>
  explicit Puppet(Make&& make) {
    int ends[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
      throw std::runtime_error("socketpair");
    }
    line_ = Line(ends[0]);
    child_ = testing::Child([&] {
      close(ends[0]);
      live(Line(ends[1]), make);
    });
    close(ends[1]);
  }

  Answer act(const Command& command) {
    Answer answer;
    begin(command);
    end(answer);
    return answer;
  }
  /// The two halves of it: in between the process is at work.
  void begin(const Command& command) { require(line_.send(command), "a process has gone"); }
  void end(Answer& answer) {
    require(line_.receive(answer, kPatience), "a process does not answer");
    require(answer.said.wrong[0] == '\0', std::string("a process: ") + answer.said.wrong);
  }
  void kill9() { child_.kill9(); }
  /// It leaves when its line has gone. Its exit status.
  int leave() {
    line_.end();
    return child_.wait();
  }

 private:
  template <class Make>
  static void live(Line line, Make& make) {
    auto actor = make();
    Command command;
    for (;;) {
      alarm(60);
      if (!line.receive(command, -1)) return;
      Answer answer{};
      try {
        actor->act(command, answer);
      } catch (const std::exception& e) {
        std::strncpy(answer.said.wrong, e.what(), sizeof(answer.said.wrong) - 1);
      }
      if (!line.send(answer)) return;
    }
  }

  Line line_{-1};
  testing::Child child_;
};

}  // namespace lot::outside
