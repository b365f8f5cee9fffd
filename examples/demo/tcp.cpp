// SPDX-License-Identifier: Apache-2.0
/// The plain copy that the ring is measured against: loopback, TCP_NODELAY, a length, a head, a
/// picture; one send for each consumer, and the whole frame read into a buffer.
#include <arpa/inet.h>
#include <cerrno>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <span>
#include <sys/socket.h>
#include <sys/uio.h>
#include <system_error>
#include <unistd.h>
#include <vector>

#include "camera.hpp"
#include "tally.hpp"

namespace demo {
namespace {

[[noreturn]] void fail(const char* what) {
  throw std::system_error(errno, std::generic_category(), what);
}

class Socket {
 public:
  explicit Socket(int fd) : fd_(fd) {
    if (fd == -1) fail("socket");
    const int on = 1;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
  }
  ~Socket() {
    if (fd_ != -1) close(fd_);
  }
  Socket(Socket&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Socket& operator=(Socket&&) = delete;

  int fd() const { return fd_; }

  void send(std::span<iovec> parts) const {
    while (!parts.empty()) {
      msghdr message{};
      message.msg_iov = parts.data();
      message.msg_iovlen = parts.size();
      const ssize_t n = sendmsg(fd_, &message, MSG_NOSIGNAL);
      if (n == -1) fail("send");
      auto left = static_cast<std::size_t>(n);
      while (!parts.empty() && left >= parts.front().iov_len) {
        left -= parts.front().iov_len;
        parts = parts.subspan(1);
      }
      if (!parts.empty()) {
        parts.front().iov_base = static_cast<char*>(parts.front().iov_base) + left;
        parts.front().iov_len -= left;
      }
    }
  }

  void receive(void* to, std::size_t bytes) const {
    for (std::size_t have = 0; have < bytes;) {
      const ssize_t n = recv(fd_, static_cast<char*>(to) + have, bytes - have, MSG_WAITALL);
      if (n == -1) fail("receive");
      if (n == 0) throw std::runtime_error("the camera has closed the connection");
      have += static_cast<std::size_t>(n);
    }
  }

 private:
  int fd_;
};

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

}  // namespace

int tcp_camera(const Settings& settings) {
  Control control(false);
  const Socket listener(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address = loopback(0);
  socklen_t size = sizeof(address);
  if (bind(listener.fd(), reinterpret_cast<sockaddr*>(&address), size) == -1 ||
      listen(listener.fd(), kConsumers) == -1 ||
      getsockname(listener.fd(), reinterpret_cast<sockaddr*>(&address), &size) == -1) {
    fail("listen");
  }
  say("ready", {{"port", ntohs(address.sin_port)}});
  std::vector<Socket> consumers;
  while (consumers.size() < kConsumers) {
    consumers.emplace_back(accept4(listener.fd(), nullptr, nullptr, SOCK_CLOEXEC));
  }
  std::vector<std::uint8_t> picture(settings.bytes, 1);  // touched: warm
  film(settings, control, [&](std::uint32_t number, bool last) {
    draw(picture.data(), picture.size(), number);
    std::uint64_t length = sizeof(Head) + picture.size();
    Head head = make_head(settings.run, number, last);
    head.stamp_ns = now_ns();
    for (const Socket& consumer : consumers) {
      iovec parts[] = {
          {&length, sizeof(length)}, {&head, sizeof(head)}, {picture.data(), picture.size()}};
      consumer.send(parts);
    }
  });
  return 0;
}

int tcp_consumer(const Settings& settings) {
  Control control(false);
  const Socket camera(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  const sockaddr_in address = loopback(settings.port);
  if (connect(camera.fd(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == -1) {
    fail("connect");
  }
  std::vector<std::uint8_t> picture(settings.bytes, 1);  // touched: warm
  say("ready");
  Tally tally(settings);
  for (Head head{}; head.last == 0;) {
    std::uint64_t length = 0;
    camera.receive(&length, sizeof(length));
    if (length != sizeof(head) + picture.size()) throw std::runtime_error("a frame of wrong size");
    camera.receive(&head, sizeof(head));
    camera.receive(picture.data(), picture.size());
    tally.note(head, picture.data(), picture.size());
  }
  tally.report(0);
  control.wait();
  return 0;
}

}  // namespace demo
