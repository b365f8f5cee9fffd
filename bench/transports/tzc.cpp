// SPDX-License-Identifier: Apache-2.0
#include "tzc.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdexcept>
#include <stop_token>
#include <sys/socket.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>

#include "sockets.hpp"
#include "transport.hpp"

/// TZC's protocol (tzc.hpp) as it stands alone: descriptors over TCP.
namespace ab {
namespace {

using tzc::kLine;
using tzc::kNone;
using tzc::Notice;
using tzc::Segment;

constexpr auto kSpinTime = 50us;  ///< of adaptive waiting: a little more than a wake-up costs
constexpr auto kLookAgain = 1ms;  ///< for publishers that are not there yet
constexpr unsigned kPollsPerClock = 16;

class TzcSender final : public Sender {
 public:
  TzcSender(const Stream& stream, unsigned publisher)
      : stream_(stream),
        publisher_(publisher),
        segment_(stream),
        spare_(stream.size + kLine),
        listener_(listen_tcp(path_of(stream, "tzc", publisher))) {}

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = std::chrono::steady_clock::now() + patience;
    for (;;) {
      const int fd = accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC);
      if (fd >= 0) {
        subscribers_.emplace_back(fd);
        set(fd, IPPROTO_TCP, TCP_NODELAY, 1);
        continue;
      }
      if (errno != EAGAIN && errno != EINTR && errno != ECONNABORTED) fail("accept");
      if (subscribers_.size() >= subscribers) return true;
      if (std::chrono::steady_clock::now() >= until) return false;
      std::this_thread::sleep_for(1ms);
    }
  }
  std::byte* loan() override {
    if (handle_ == kNone) handle_ = segment_.allocate();
    return handle_ == kNone ? spare() : segment_.bytes(handle_);
  }
  bool push() override {
    if (handle_ == kNone) return false;
    const std::uint64_t number = number_++;
    const Notice notice{number, segment_.generation(handle_), stream_.size, handle_, publisher_};
    std::erase_if(subscribers_, [&](const Descriptor& to) { return !send_to(to.get(), notice); });
    segment_.release(std::exchange(handle_, kNone));
    return true;
  }

 private:
  /// Where a message is filled for which there is no memory.
  std::byte* spare() {
    const auto at = reinterpret_cast<std::uintptr_t>(spare_.data());
    return spare_.data() + (kLine - at % kLine) % kLine;
  }
  /// One for whom there is no room in the socket is not waited for. False: the other end has gone.
  static bool send_to(int fd, const Notice& notice) {
    const auto* const bytes = reinterpret_cast<const std::byte*>(&notice);
    std::size_t sent = 0;
    do {
      const ssize_t n = send(fd, bytes + sent, sizeof notice - sent,
                             MSG_NOSIGNAL | (sent == 0 ? MSG_DONTWAIT : 0));
      if (n >= 0) {
        sent += static_cast<std::size_t>(n);
      } else if (errno == EAGAIN) {
        return true;
      } else if (errno != EINTR) {
        return false;
      }
    } while (sent < sizeof notice);
    return true;
  }

  const Stream stream_;
  const std::uint32_t publisher_;
  Segment segment_;
  std::vector<std::byte> spare_;
  Descriptor listener_;
  std::vector<Descriptor> subscribers_;
  std::uint32_t handle_ = kNone;  ///< on loan
  std::uint64_t number_ = 0;
};

/// A subscriber's end of a connection, and the notices that it has read and not yet handled.
struct Connection {
  Descriptor socket;
  std::array<std::byte, 64 * sizeof(Notice)> bytes;
  std::size_t begin = 0;
  std::size_t end = 0;
  std::uint64_t next = 0;  ///< number of the next notice

  bool read() {
    if (end - begin < sizeof(Notice)) {
      std::memmove(bytes.data(), bytes.data() + begin, end - begin);
      end -= std::exchange(begin, 0);
      const ssize_t n = recv(socket.get(), bytes.data() + end, bytes.size() - end, MSG_DONTWAIT);
      if (n > 0) end += static_cast<std::size_t>(n);
      if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) socket = Descriptor();
    }
    return end - begin >= sizeof(Notice);
  }
  Notice take() {
    Notice notice;
    std::memcpy(&notice, bytes.data() + begin, sizeof notice);
    begin += sizeof notice;
    return notice;
  }
};

class TzcReceiver final : public Receiver {
 public:
  TzcReceiver(const Stream& stream, unsigned subscriber)
      : stream_(stream),
        subscriber_(subscriber),
        segment_(stream),
        connections_(stream.publishers),
        found_(stream.publishers),
        to_find_(stream.publishers) {
    for (auto& fd : found_) fd.store(-1, std::memory_order_relaxed);
    // Beside the node's own thread: two nodes may each wait for the other's subscription.
    finder_ = std::jthread([this](const std::stop_token& stop) { find_publishers(stop); });
  }
  ~TzcReceiver() override {
    finder_.request_stop();
    finder_.join();
    adopt();
  }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    const auto begin = std::chrono::steady_clock::now();
    for (unsigned polls = 1;; ++polls) {
      if (to_find_ != 0) adopt();
      for (std::size_t n = 0; n < connections_.size(); ++n) {
        if (take(connections_[turn_++ % connections_.size()], handler)) return true;
      }
      if (stream_.wait != Wait::Park && polls % kPollsPerClock != 0) continue;
      const auto waited = std::chrono::steady_clock::now() - begin;
      if (patience >= 0ns && waited >= patience) return false;
      if (stream_.wait == Wait::Spin || (stream_.wait == Wait::Adaptive && waited < kSpinTime)) {
        continue;
      }
      sleep(patience < 0ns ? 1s : patience - waited);
    }
  }
  std::uint64_t missed() const override { return missed_; }

 private:
  /// False: no notice was there. Calls the handler unless the message has gone.
  bool take(Connection& from, const Handler& handler) {
    while (from.socket && from.read()) {
      const Notice notice = from.take();
      if (notice.handle >= segment_.size() || notice.length != stream_.size) {
        throw std::runtime_error("tzc: what came is no notice of this stream");
      }
      missed_ += notice.number - from.next;
      from.next = notice.number + 1;
      if (!segment_.acquire(notice.handle, notice.generation)) {
        ++missed_;
        continue;
      }
      handler({segment_.bytes(notice.handle), notice.length});
      segment_.release(notice.handle);
      return true;
    }
    return false;
  }
  void sleep(std::chrono::nanoseconds most) {
    if (to_find_ != 0) most = std::min<std::chrono::nanoseconds>(most, kLookAgain);
    polled_.clear();
    for (const Connection& c : connections_) {
      if (c.socket) polled_.push_back({c.socket.get(), POLLIN, 0});
    }
    const timespec limit{static_cast<time_t>(most / 1s), static_cast<long>((most % 1s).count())};
    ppoll(polled_.data(), polled_.size(), &limit, nullptr);
  }
  /// Takes over what the finder has found.
  void adopt() {
    for (std::size_t p = 0; p < found_.size(); ++p) {
      const int fd = found_[p].exchange(-1, std::memory_order_acquire);
      if (fd < 0) continue;
      connections_[p].socket = Descriptor(fd);
      --to_find_;
    }
  }
  void find_publishers(const std::stop_token& stop) {
    for (unsigned p = 0; p < stream_.publishers; ++p) {
      while (!stop.stop_requested() && !connect_to(p)) std::this_thread::sleep_for(kLookAgain);
    }
  }
  bool connect_to(unsigned publisher) {
    Descriptor fd = connect_tcp(path_of(stream_, "tzc", publisher),
                                ipv4(stream_.address[publisher][subscriber_]));
    if (!fd) return false;
    found_[publisher].store(fd.release(), std::memory_order_release);
    return true;
  }

  const Stream stream_;
  const unsigned subscriber_;
  Segment segment_;
  std::vector<Connection> connections_;
  std::vector<pollfd> polled_;
  std::size_t turn_ = 0;
  std::uint64_t missed_ = 0;
  /// Sockets on their way from the finder (release) to receive() (acquire); -1: none.
  std::vector<std::atomic<int>> found_;
  std::size_t to_find_;
  std::jthread finder_;
};

}  // namespace

std::vector<Transport> tzc_transports() {
  Transport t;
  t.name = "tzc";
  t.about = "TZC's protocol: bytes in shared memory, descriptors over TCP";
  t.waits = false;
  t.is_network = true;
  t.refuses = [](const Stream&) { return std::string(); };
  t.sender = [](const Stream& stream, unsigned publisher) {
    return std::make_unique<TzcSender>(stream, publisher);
  };
  t.receiver = [](const Stream& stream, unsigned subscriber) {
    return std::make_unique<TzcReceiver>(stream, subscriber);
  };
  return {std::move(t)};
}

}  // namespace ab
