// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <netinet/in.h>
#include <optional>
#include <poll.h>
#include <span>
#include <string>
#include <sys/mman.h>
#include <sys/socket.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "transport.hpp"

/// What transports over sockets share: descriptors, memory, ports in files, and how a reader waits.
namespace ab {

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

/// Says on which port this publisher is; whoever reads it reads all of it.
inline void write_port(const std::string& path, int fd) {
  sockaddr_in name{};
  socklen_t length = sizeof name;
  if (getsockname(fd, reinterpret_cast<sockaddr*>(&name), &length) != 0) fail("getsockname");
  const std::string draft = path + ".new";
  std::ofstream(draft) << ntohs(name.sin_port) << '\n';
  std::filesystem::rename(draft, path);
}
inline std::optional<std::uint16_t> read_port(const std::string& path) {
  std::uint16_t port = 0;
  if (std::ifstream(path) >> port) return port;
  return std::nullopt;
}

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
    const timespec limit{static_cast<time_t>(left / std::chrono::seconds(1)),
                         static_cast<long>((left % std::chrono::seconds(1)).count())};
    if (ppoll(inputs.data(), inputs.size(), patience_.count() < 0 ? nullptr : &limit, nullptr) <
            0 &&
        errno != EINTR) {
      fail("ppoll");
    }
    return true;
  }

 private:
  static constexpr auto kSpin = std::chrono::microseconds(50);

  const Wait wait_;
  const std::chrono::nanoseconds patience_;
  const Clock::time_point begin_;
  Clock::time_point progress_;
  unsigned looks_ = 0;
};

}  // namespace ab
