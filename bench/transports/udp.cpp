// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <atomic>
#include <cstring>
#include <netinet/udp.h>
#include <thread>

#include "sockets.hpp"

/// UDP: a message goes as datagrams of one size, and is put together again, or lost.
///
/// A subscriber connects to each publisher by TCP, as in ROS, and says its UDP port there; no data
/// goes that way. Each datagram has a head that says which part of which message it is. What comes
/// in order, and it mostly does, is received where it belongs; the first part of a newer message
/// ends an older one that is not whole, and the older one counts as missed.
///
/// Datagrams of 1500 bytes (with IP and UDP heads) are cut and put together by the kernel in runs
/// of up to 64 KiB (UDP_SEGMENT, UDP_GRO: Linux 5.0): a call for each of them takes seven times as
/// long at 16 MiB. Datagrams of 65507 bytes are one call each.
///
/// Nothing says that a subscriber is behind: what its socket has no room for is lost. So the socket
/// asks for 64 MiB: as root it gets them, otherwise what net.core.rmem_max allows (212992 bytes
/// unless set; for 16 MiB messages `sysctl net.core.rmem_max=67108864`, on the host also for
/// containers). A publisher knows how much it is, and sends what is larger than a part of that in
/// bursts, with pauses in which a reader can follow.
namespace ab {
namespace {

constexpr std::size_t kPart = 24;  ///< bytes of a Part
struct Part {
  std::uint32_t stream;  ///< whose datagram it is: strangers' are ignored
  std::uint32_t publisher;
  std::uint64_t number;
  std::uint32_t index;
  std::uint32_t bytes;
};
static_assert(sizeof(Part) == kPart);

struct Hello {
  std::uint32_t stream;
  std::uint32_t port;
  std::uint64_t room;  ///< bytes that may wait in the socket
};

/// How messages of a stream are cut.
struct Cut {
  Cut(const Stream& stream, std::size_t datagram)
      : body(datagram - kPart),
        parts((stream.size + body - 1) / body),
        run(parts == 1 ? 1 : 65507 / datagram) {}
  std::size_t body;   ///< bytes of the message in each, but the last
  std::size_t parts;  ///< of a message
  std::size_t run;    ///< datagrams of one call
};

std::uint32_t tag_of(const Stream& stream) {  // FNV-1a
  std::uint32_t tag = 2166136261U;
  for (const char c : stream.name) tag = (tag ^ static_cast<unsigned char>(c)) * 16777619U;
  return tag;
}

class UdpSender final : public Sender {
 public:
  UdpSender(const Stream& stream, const std::string& kind, std::size_t datagram, unsigned publisher)
      : size_(stream.size),
        publishers_(stream.publishers),
        cut_(stream, datagram),
        head_{tag_of(stream), publisher, 0, 0, 0},
        message_(stream.size),
        heads_(cut_.run),
        pieces_(2 * cut_.run),
        listener_(listen_tcp(path_of(stream, kind, publisher))) {}

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = Clock::now() + patience;
    for (;;) {
      accept_all();
      if (links_.size() >= subscribers) return true;
      if (Clock::now() >= until) return false;
      pollfd one{listener_.get(), POLLIN, 0};
      poll(&one, 1, 10);
    }
  }
  std::byte* loan() override { return message_.get(); }
  bool push() override {
    std::size_t sent = 0;
    for (std::size_t part = 0; part < cut_.parts; part += cut_.run) {
      const std::size_t bytes = prepare(part);
      for (std::size_t n = 0; n < links_.size();) n += send_to(n, bytes) ? 1 : 0;
      sent += bytes;
      if (sent >= burst_ && part + cut_.run < cut_.parts) {
        std::this_thread::sleep_for(kPause);
        sent = 0;
      }
    }
    ++head_.number;
    accept_all();  // who comes late
    return true;
  }
  std::uint64_t copied() const override { return copied_; }

 private:
  // 16 MiB at 30 Hz on two busy cores, of 30 messages: with 4 MiB of rmem_max 27 to 30 arrive, as
  // against 10 to 18 without pauses; with 208 KiB 25 to 30, in 15 to 18 ms.
  static constexpr auto kPause = 50us;
  static constexpr std::size_t kLeastBurst = 96 << 10;  ///< or a large message takes a period

  /// The datagrams of one call, from this part on; returns their bytes.
  std::size_t prepare(std::size_t part) {
    std::size_t bytes = 0;
    used_ = 0;
    for (std::size_t n = 0; n < cut_.run && part + n < cut_.parts; ++n) {
      const std::size_t offset = (part + n) * cut_.body;
      const std::size_t size = std::min(cut_.body, size_ - offset);
      heads_[n] = head_;
      heads_[n].index = static_cast<std::uint32_t>(part + n);
      heads_[n].bytes = static_cast<std::uint32_t>(size);
      pieces_[used_++] = {&heads_[n], kPart};
      pieces_[used_++] = {message_.get() + offset, size};
      bytes += kPart + size;
    }
    return bytes;
  }
  /// False: nobody is there any more, and another one is n-th now.
  bool send_to(std::size_t n, std::size_t bytes) {
    msghdr header{};
    header.msg_iov = pieces_.data();
    header.msg_iovlen = used_;
    while (sendmsg(links_[n].get(), &header, MSG_NOSIGNAL) < 0) {
      if (errno == EINTR) continue;
      if (errno != ECONNREFUSED) return true;  // no room somewhere: lost, as UDP does
      links_.erase(links_.begin() + static_cast<std::ptrdiff_t>(n));
      return false;
    }
    copied_ += bytes;
    return true;
  }

  void accept_all() {
    for (;;) {
      sockaddr_in name{};
      socklen_t length = sizeof name;
      const Descriptor control(
          accept4(listener_.get(), reinterpret_cast<sockaddr*>(&name), &length, SOCK_CLOEXEC));
      if (!control) return;
      pollfd one{control.get(), POLLIN, 0};
      Hello hello{};
      if (poll(&one, 1, 2000) != 1 ||
          recv(control.get(), &hello, sizeof hello, MSG_DONTWAIT) != sizeof hello ||
          hello.stream != head_.stream) {
        continue;
      }
      name.sin_port = htons(static_cast<std::uint16_t>(hello.port));
      Descriptor fd(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0), "socket");
      if (connect(fd.get(), reinterpret_cast<const sockaddr*>(&name), sizeof name) != 0) continue;
      if (cut_.run > 1) {
        set(fd.get(), IPPROTO_UDP, UDP_SEGMENT, static_cast<int>(kPart + cut_.body));
      }
      links_.push_back(std::move(fd));
      // The kernel counts its own memory, more than the bytes; and others send there, too.
      burst_ = std::min(burst_, std::max<std::size_t>(kLeastBurst, hello.room / 12 / publishers_));
    }
  }

  const std::size_t size_;
  const unsigned publishers_;
  const Cut cut_;
  Part head_;  ///< what all parts of the next message have in common
  Pages message_;
  std::vector<Part> heads_;
  std::vector<iovec> pieces_;
  std::size_t used_ = 0;  ///< of pieces_
  Descriptor listener_;
  std::vector<Descriptor> links_;
  std::size_t burst_ = SIZE_MAX;  ///< bytes to one subscriber without a pause
  std::uint64_t copied_ = 0;
};

class UdpReceiver final : public Receiver {
 public:
  UdpReceiver(const Stream& stream, std::string kind, std::size_t datagram, unsigned subscriber)
      : stream_(stream),
        kind_(std::move(kind)),
        cut_(stream, datagram),
        tag_(tag_of(stream)),
        heads_(cut_.run),
        places_(cut_.run),
        pieces_(2 * cut_.run),
        aside_(cut_.run * cut_.body),
        fd_(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0), "socket") {
    for (unsigned p = 0; p < stream.publishers; ++p) {
      sources_.push_back(std::make_unique<Source>(cut_));
      addresses_.push_back(ipv4(stream.address.at(p).at(subscriber)));
    }
    sockaddr_in name{};
    name.sin_family = AF_INET;
    socklen_t length = sizeof name;
    if (bind(fd_.get(), reinterpret_cast<const sockaddr*>(&name), length) != 0) fail("bind");
    if (getsockname(fd_.get(), reinterpret_cast<sockaddr*>(&name), &length) != 0) {
      fail("getsockname");
    }
    const int wish = 64 << 20;
    if (setsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUFFORCE, &wish, sizeof wish) != 0) {
      set(fd_.get(), SOL_SOCKET, SO_RCVBUF, wish);
    }
    int room = 0;
    socklen_t of_room = sizeof room;
    if (getsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUF, &room, &of_room) != 0) fail("getsockopt");
    if (cut_.run > 1) set(fd_.get(), IPPROTO_UDP, UDP_GRO, 1);
    const Hello hello{tag_, ntohs(name.sin_port), static_cast<std::uint64_t>(room)};
    // A node's own publisher may come after this, and wait for others: so nobody waits here.
    thread_ = std::thread([this, hello] { join_all(hello); });
  }
  ~UdpReceiver() override {
    stop_.store(true, std::memory_order_relaxed);
    thread_.join();
  }
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    Patience waiting(stream_.wait, patience);
    pollfd input{fd_.get(), POLLIN, 0};
    const bool sleeps = stream_.wait == Wait::Park && SleepLimit::can(patience);
    if (sleeps) limit_.set(fd_.get(), patience);
    do {
      do {
        while (next_ < came_) {
          const Source* const whole = place(next_++);
          if (whole == nullptr) continue;
          handler({whole->pages.get(), stream_.size});
          return true;
        }
        waiting.progress();
      } while (fetch(sleeps ? 0 : MSG_DONTWAIT));
    } while (waiting.wait({&input, 1}));
    return false;
  }
  std::uint64_t missed() const override { return missed_; }
  std::uint64_t copied() const override { return copied_; }

 private:
  struct Source {
    explicit Source(const Cut& cut) : pages(cut.parts * cut.body), there(cut.parts) {}
    Pages pages;
    std::vector<bool> there;     ///< parts of the open message
    std::size_t count = 0;       ///< how many
    std::size_t next = 0;        ///< none from this one on is there
    std::uint64_t number = 0;    ///< of the open message
    bool open = false;           ///< one has begun and is not whole
    bool known = false;          ///< `expected` says something
    std::uint64_t expected = 0;  ///< the first message that is neither whole nor missed
  };

  /// Receives one run, each part to the place where it belongs if it is what most likely comes:
  /// the next of the publisher that was last heard.
  bool fetch(int how) {
    Source& source = *sources_[guess_];
    const std::size_t first = source.open ? source.next : 0;
    for (std::size_t n = 0; n < cut_.run; ++n) {
      places_[n] = first + n < cut_.parts ? source.pages.get() + (first + n) * cut_.body
                                          : aside_.get() + n * cut_.body;
      pieces_[2 * n] = {&heads_[n], kPart};
      pieces_[2 * n + 1] = {places_[n], cut_.body};
    }
    msghdr header{};
    header.msg_iov = pieces_.data();
    header.msg_iovlen = pieces_.size();
    const ssize_t got = recvmsg(fd_.get(), &header, how);
    next_ = came_ = 0;
    if (got < 0) return errno == EINTR;
    const auto bytes = static_cast<std::size_t>(got);
    const std::size_t each = kPart + cut_.body;
    copied_ += bytes;
    // All but the last are full, so each begins where a head was expected.
    came_ = bytes / each;
    if (bytes % each > kPart) ++came_;
    bool as_guessed = true;
    for (std::size_t n = 0; n < came_; ++n) {
      as_guessed = as_guessed && heads_[n].publisher == guess_ && heads_[n].index == first + n &&
                   heads_[n].number == (source.open ? source.number : heads_[0].number);
    }
    if (as_guessed) return true;
    for (std::size_t n = 0; n < came_; ++n) {  // out of the way of each other
      std::byte* const to = aside_.get() + n * cut_.body;
      if (places_[n] != to) std::memcpy(to, places_[n], cut_.body);
      places_[n] = to;
    }
    return true;
  }

  /// Puts one of the run where it belongs. Returns the source whose message is whole by that.
  const Source* place(std::size_t n) {
    const Part& part = heads_[n];
    if (part.stream != tag_ || part.publisher >= sources_.size() || part.index >= cut_.parts) {
      return nullptr;
    }
    const std::size_t offset = part.index * cut_.body;
    if (part.bytes != std::min(cut_.body, stream_.size - offset)) return nullptr;
    guess_ = part.publisher;
    Source& source = *sources_[part.publisher];
    if (source.known && part.number < source.expected) return nullptr;  // late
    if (!source.open || part.number > source.number) {
      if (source.known) missed_ += part.number - source.expected;
      source.known = source.open = true;
      source.number = source.expected = part.number;
      source.count = source.next = 0;
      source.there.assign(cut_.parts, false);
    }
    if (source.there[part.index]) return nullptr;
    std::byte* const to = source.pages.get() + offset;
    if (places_[n] != to) {
      std::memcpy(to, places_[n], part.bytes);
      copied_ += part.bytes;
    }
    source.there[part.index] = true;
    source.next = std::max<std::size_t>(source.next, part.index + 1);
    if (++source.count < cut_.parts) return nullptr;
    source.open = false;
    source.expected = source.number + 1;
    return &source;
  }

  void join_all(Hello hello) {
    std::vector<bool> done(stream_.publishers);
    for (unsigned joined = 0; !stop_.load(std::memory_order_relaxed);) {
      for (unsigned p = 0; p < stream_.publishers; ++p) {
        if (done[p]) continue;
        const Descriptor control = connect_tcp(path_of(stream_, kind_, p), addresses_[p]);
        if (!control || send(control.get(), &hello, sizeof hello, MSG_NOSIGNAL) != sizeof hello) {
          continue;
        }
        done[p] = true;
        ++joined;
      }
      if (joined == stream_.publishers) return;
      std::this_thread::sleep_for(1ms);
    }
  }

  const Stream stream_;
  const std::string kind_;
  const Cut cut_;
  const std::uint32_t tag_;
  std::vector<std::unique_ptr<Source>> sources_;
  std::vector<in_addr> addresses_;
  std::uint32_t guess_ = 0;         ///< the publisher that was last heard
  std::vector<Part> heads_;         ///< of the run that was fetched last
  std::vector<std::byte*> places_;  ///< where its bodies are
  std::vector<iovec> pieces_;
  std::size_t next_ = 0;  ///< of it, the first that place() has not seen
  std::size_t came_ = 0;  ///< its parts
  Pages aside_;
  std::uint64_t missed_ = 0;
  std::uint64_t copied_ = 0;
  Descriptor fd_;
  SleepLimit limit_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

Transport udp_transport(std::string name, std::string about, std::size_t datagram) {
  Transport t;
  t.name = std::move(name);
  t.about = std::move(about);
  t.is_network = true;
  t.may_lose = true;
  t.waits = false;
  t.copies = true;
  t.refuses = [](const Stream&) { return std::string(); };
  t.sender = [name = t.name, datagram](const Stream& stream, unsigned publisher) {
    return std::make_unique<UdpSender>(stream, name, datagram, publisher);
  };
  t.receiver = [name = t.name, datagram](const Stream& stream, unsigned subscriber) {
    return std::make_unique<UdpReceiver>(stream, name, datagram, subscriber);
  };
  return t;
}

}  // namespace

std::vector<Transport> udp_transports() {
  return {
      udp_transport("udp", "UDP, datagrams of 1500 bytes with their heads", 1500 - 28),
      udp_transport("udp-65507", "UDP, datagrams of 65507 bytes, the largest there are", 65507),
  };
}

}  // namespace ab
