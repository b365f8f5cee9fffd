// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <arpa/inet.h>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <netinet/in.h>
#include <poll.h>
#include <span>
#include <stdexcept>
#include <string>
#include <sys/mman.h>
#include <sys/socket.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "transport.hpp"

/// What transports over sockets share: descriptors, memory, ports in files,
/// and how a reader waits.
namespace ab {

using namespace std::chrono_literals;

using Clock = std::chrono::steady_clock;

[[noreturn]] inline void fail(const std::string& what) {
  throw std::system_error(errno, std::generic_category(), what);
}

class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(int fd, const char* what) : fd_(fd) {
    if (fd < 0) fail(what);
  }
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  int get() const { return fd_; }
  int release() { return std::exchange(fd_, -1); }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

/// Memory of its own pages, there already: huge ones where the system gives some.
class Pages {
 public:
  explicit Pages(std::size_t size) : size_(size) {
    void* const at =
        mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (at == MAP_FAILED) fail("memory for a message");
    at_ = static_cast<std::byte*>(at);
    madvise(at, size, MADV_HUGEPAGE);
    madvise(at, size, MADV_POPULATE_WRITE);
  }
  ~Pages() { munmap(at_, size_); }
  Pages(const Pages&) = delete;
  Pages& operator=(const Pages&) = delete;
  std::byte* get() const { return at_; }

 private:
  std::size_t size_;
  std::byte* at_;
};

/// Where a publisher of this kind can be found: for sockets with names, the name.
inline std::string path_of(const Stream& stream, const std::string& kind, unsigned publisher) {
  return stream.directory + "/" + stream.name + "-" + kind + "-" + std::to_string(publisher);
}

inline void set(int fd, int level, int option, int value) {
  if (setsockopt(fd, level, option, &value, sizeof value) != 0) fail("setsockopt");
}

/// Listens for TCP on all addresses, on a port that the kernel chooses and that the file of this
/// path says: who reads it reads all of it, and finds somebody there.
inline Descriptor listen_tcp(const std::string& path) {
  Descriptor fd(socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), "socket");
  sockaddr_in name{};
  name.sin_family = AF_INET;
  socklen_t length = sizeof name;
  if (bind(fd.get(), reinterpret_cast<const sockaddr*>(&name), length) != 0) fail("bind");
  if (listen(fd.get(), SOMAXCONN) != 0) fail("listen");
  if (getsockname(fd.get(), reinterpret_cast<sockaddr*>(&name), &length) != 0) fail("getsockname");
  std::ofstream(path + ".new") << ntohs(name.sin_port) << '\n';
  std::filesystem::rename(path + ".new", path);
  return fd;
}

inline in_addr ipv4(const std::string& address) {
  in_addr number{};
  if (inet_pton(AF_INET, address.c_str(), &number) != 1) {
    throw std::runtime_error("no IPv4 address: " + address);
  }
  return number;
}

/// Connects to who listens there. Empty: nobody yet.
inline Descriptor connect_tcp(const std::string& path, in_addr address) {
  std::uint16_t port = 0;
  if (!(std::ifstream(path) >> port)) return {};
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_port = htons(port);
  name.sin_addr = address;
  Descriptor fd(socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), "socket");
  if (connect(fd.get(), reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0) return fd;
  if (errno != EINPROGRESS) return {};
  pollfd one{fd.get(), POLLOUT, 0};
  int error = 0;
  socklen_t length = sizeof error;
  if (poll(&one, 1, 200) != 1 || getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &length) != 0 ||
      error != 0) {
    return {};
  }
  return fd;
}

/// How long a call that reads from this socket sleeps. Said to the kernel only when it changes.
class SleepLimit {
 public:
  static bool can(std::chrono::nanoseconds patience) {  // zeros would mean for ever
    return patience.count() < 0 || patience >= 1us;
  }
  void set(int fd, std::chrono::nanoseconds patience) {
    if (patience == patience_) return;
    const auto us = patience.count() < 0
                        ? 0us
                        : std::chrono::duration_cast<std::chrono::microseconds>(patience);
    const timeval limit{static_cast<time_t>(us / 1s), static_cast<long>((us % 1s).count())};
    if (setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit) != 0) fail("setsockopt");
    patience_ = patience;
  }

 private:
  std::chrono::nanoseconds patience_{-1};
};

/// How a reader that has found nothing goes on, as Stream::wait says. Made for one receive().
class Patience {
 public:
  Patience(Wait wait, std::chrono::nanoseconds patience)
      : wait_(wait), patience_(patience), begin_(Clock::now()), progress_(begin_) {}

  /// Something came, though not a whole message: the next part is near.
  void progress() {
    if (wait_ == Wait::Adaptive) progress_ = Clock::now();
  }
  /// Returns when one of them may have input; false: patience is at its end.
  bool wait(std::span<pollfd> inputs) {
    if (wait_ == Wait::Spin) {
      return ++looks_ % 64 != 0 || patience_.count() < 0 || Clock::now() - begin_ < patience_;
    }
    const auto now = Clock::now();
    if (patience_.count() >= 0 && now - begin_ >= patience_) return false;
    if (wait_ == Wait::Adaptive && now - progress_ < kSpin) return true;
    const auto left = patience_ - (now - begin_);
    const timespec limit{static_cast<time_t>(left / 1s), static_cast<long>((left % 1s).count())};
    if (ppoll(inputs.data(), inputs.size(), patience_.count() < 0 ? nullptr : &limit, nullptr) <
            0 &&
        errno != EINTR) {
      fail("ppoll");
    }
    return true;
  }

 private:
  static constexpr auto kSpin = 50us;

  const Wait wait_;
  const std::chrono::nanoseconds patience_;
  const Clock::time_point begin_;
  Clock::time_point progress_;
  unsigned looks_ = 0;
};

}  // namespace ab
