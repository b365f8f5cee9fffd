// SPDX-License-Identifier: Apache-2.0
#include "sockets.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <fcntl.h>
#include <mutex>
#include <netinet/tcp.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/un.h>
#include <thread>

/// Streams of bytes: TCP as ROS uses it, and Unix sockets as well as they go.
///
/// A message is a length of 4 bytes and a body. TCP: the publisher serialises, that is, it copies
/// the message into a buffer, and sends length and body by a call each. (With TCP_NODELAY the first
/// call says that more follows: a packet of 4 bytes costs a message of 128 bytes 4 us. With Nagle's
/// algorithm nothing is said: what that does is what one wants to see.) Unix: the buffer is where
/// the message was written in the first place, and one call sends both. Each subscriber has a
/// connection, and a copy of its own goes to the kernel. A subscriber reads into memory that it
/// keeps, and hands over from there: it does not deserialise.
///
/// push() writes itself, in the order in which subscribers came, as far as the sockets take it at
/// once; the rest, and what comes after it, is left to a thread of the publisher's, as in ROS, with
/// a queue of Stream::depth messages for each subscriber, whose oldest is dropped when it is full.
/// So nobody waits for that thread where nobody has to, and nobody behind a slow subscriber.
///
/// A publisher that was killed and started again is not found by subscribers of the former.
namespace ab {
namespace {

enum class Kind { Tcp, TcpNagle, Unix };
constexpr std::size_t kLength = 4;

const char* word(Kind kind) {
  return kind == Kind::Tcp ? "tcp" : kind == Kind::TcpNagle ? "tcp-nagle" : "uds";
}

/// A name for bind and connect, which take 107 letters: a longer one leads through a descriptor.
class UnixName {
 public:
  UnixName(const Stream& stream, const std::string& path) {
    std::string name = path;
    if (name.size() >= sizeof name_.sun_path) {
      directory_ = Descriptor(open(stream.directory.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC),
                              stream.directory.c_str());
      name = "/proc/self/fd/" + std::to_string(directory_.get()) +
             path.substr(stream.directory.size());
    }
    if (name.size() >= sizeof name_.sun_path) throw std::runtime_error(path + " is too long");
    name_.sun_family = AF_UNIX;
    std::memcpy(name_.sun_path, name.c_str(), name.size() + 1);
  }
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&name_); }
  socklen_t size() const { return sizeof name_; }

 private:
  Descriptor directory_;
  sockaddr_un name_{};
};

// ---- the publisher ------------------------------------------------------------------------------

Descriptor listen_at(const Stream& stream, Kind kind, unsigned publisher) {
  const std::string path = path_of(stream, word(kind), publisher);
  if (kind == Kind::Unix) {
    Descriptor fd(socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), "socket");
    const UnixName draft(stream, path + ".new");
    if (bind(fd.get(), draft.get(), draft.size()) != 0) fail("bind " + path);
    if (listen(fd.get(), SOMAXCONN) != 0) fail("listen");
    std::filesystem::rename(path + ".new", path);  // so that who finds it can connect
    return fd;
  }
  return listen_tcp(path);
}

/// A message on its way to some subscribers.
struct Buffer {
  explicit Buffer(std::size_t size) : pages(size) {}
  Pages pages;
  // Who still needs it. Released after the last read of it, acquired before it is written again.
  std::atomic<unsigned> users{0};
};

struct Link {
  enum class State {
    Idle,      ///< all is sent
    Pushing,   ///< push() writes
    Draining,  ///< the thread writes, and `waiting` may have more
    Gone,      ///< nobody is there any more
  };
  Descriptor fd;
  State state = State::Idle;    // under the lock; of its two writers one alone is named at a time
  std::deque<Buffer*> waiting;  // under the lock
  Buffer* current = nullptr;    // its writer's
  std::size_t sent = 0;         // its writer's: bytes of it, with the length
};

class SocketSender final : public Sender {
 public:
  SocketSender(const Stream& stream, Kind kind, unsigned publisher)
      : stream_(stream),
        kind_(kind),
        length_(static_cast<std::uint32_t>(stream.size)),
        message_(kind == Kind::Unix ? 1 : stream.size),
        epoll_(epoll_create1(EPOLL_CLOEXEC), "epoll_create1"),
        stop_(eventfd(0, EFD_CLOEXEC), "eventfd"),
        listener_(listen_at(stream, kind, publisher)) {
    for (unsigned n = 0; n < kWarm; ++n) buffers_.push_back(std::make_unique<Buffer>(stream.size));
    watch(EPOLL_CTL_ADD, stop_.get(), EPOLLIN, &stop_);
    watch(EPOLL_CTL_ADD, listener_.get(), EPOLLIN, &listener_);
    thread_ = std::thread([this] { serve(); });
  }
  ~SocketSender() override {
    {
      std::unique_lock lock(mutex_);
      changed_.wait_for(lock, 1s, [this] {  // who is slow still gets the last ones
        return std::all_of(links_.begin(), links_.end(), [](const auto& link) {
          return link->state == Link::State::Idle || link->state == Link::State::Gone;
        });
      });
    }
    eventfd_write(stop_.get(), 1);
    thread_.join();
  }
  SocketSender(const SocketSender&) = delete;
  SocketSender& operator=(const SocketSender&) = delete;

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, patience, [&] {
      return subscribers <= std::count_if(links_.begin(), links_.end(), [](const auto& link) {
               return link->state != Link::State::Gone;
             });
    });
  }

  std::byte* loan() override {
    if (kind_ != Kind::Unix) return message_.get();
    if (loaned_ == nullptr) loaned_ = unused();
    return loaned_->pages.get();
  }

  bool push() override {
    Buffer* message = std::exchange(loaned_, nullptr);
    if (kind_ != Kind::Unix) {  // serialises
      message = unused();
      std::memcpy(message->pages.get(), message_.get(), stream_.size);
      copied_.fetch_add(stream_.size, std::memory_order_relaxed);
    }
    bool all = true;
    std::unique_lock lock(mutex_);
    for (std::size_t n = 0; n < links_.size(); ++n) {
      Link& link = *links_[n];
      if (link.state == Link::State::Idle) {
        link.state = Link::State::Pushing;
        begin(link, message);
        lock.unlock();
        const Written written = write(link);
        lock.lock();
        if (written == Written::Broken) link.state = Link::State::Gone;
        if (written != Written::Part || link.state == Link::State::Gone) end(link);
        if (link.state == Link::State::Gone) continue;
        link.state = written == Written::Whole ? Link::State::Idle : Link::State::Draining;
        if (written == Written::Part) watch(EPOLL_CTL_MOD, link.fd.get(), kRoom, &link);
      } else if (link.state == Link::State::Draining) {
        all = enqueue(link, message, lock) && all;
      }
    }
    message->users.fetch_sub(1, std::memory_order_release);
    return all;
  }
  std::uint64_t copied() const override { return copied_.load(std::memory_order_relaxed); }

 private:
  enum class Written { Whole, Part, Broken };
  static constexpr unsigned kWarm = 4;  ///< more are made when a subscriber falls behind
  /// What was copied into the kernel is best read while it is in the caches: 16 MiB take at least
  /// a tenth less than with what the system gives (TCP: what grows to net.ipv4.tcp_wmem, 4 MiB;
  /// Unix: 208 KiB); buffers of 1 MiB and 4 MiB take longer than that. 1 MiB takes as long with
  /// each.
  static constexpr int kSendBuffer = 256 << 10;
  static constexpr std::uint32_t kQuiet = EPOLLRDHUP;
  static constexpr std::uint32_t kRoom = EPOLLRDHUP | EPOLLOUT;

  void watch(int what, int fd, std::uint32_t events, void* whose) {
    epoll_event event{};
    event.events = events;
    event.data.ptr = whose;
    if (epoll_ctl(epoll_.get(), what, fd, &event) != 0) fail("epoll_ctl");
  }

  /// A buffer with one user, the caller.
  Buffer* unused() {
    for (std::size_t n = 0; n < buffers_.size(); ++n) {
      Buffer& buffer = *buffers_[(turn_ + n) % buffers_.size()];
      if (buffer.users.load(std::memory_order_acquire) != 0) continue;
      turn_ += n;
      buffer.users.store(1, std::memory_order_relaxed);
      return &buffer;
    }
    buffers_.push_back(std::make_unique<Buffer>(stream_.size));
    buffers_.back()->users.store(1, std::memory_order_relaxed);
    return buffers_.back().get();
  }

  static void begin(Link& link, Buffer* message) {
    message->users.fetch_add(1, std::memory_order_relaxed);
    link.current = message;
    link.sent = 0;
  }
  static void end(Link& link) {
    std::exchange(link.current, nullptr)->users.fetch_sub(1, std::memory_order_release);
  }

  /// As much of the link's message as the socket takes now.
  Written write(Link& link) {
    std::byte* const body = link.current->pages.get();
    const std::size_t whole = kLength + stream_.size;
    while (link.sent < whole) {
      ssize_t n = 0;
      if (link.sent >= kLength) {
        n = send(link.fd.get(), body + (link.sent - kLength), whole - link.sent, kHow);
      } else if (kind_ != Kind::Unix) {
        n = send(link.fd.get(), length_at(link.sent), kLength - link.sent,
                 kHow | (kind_ == Kind::Tcp ? MSG_MORE : 0));
      } else {
        std::array<iovec, 2> parts{iovec{length_at(link.sent), kLength - link.sent},
                                   iovec{body, stream_.size}};
        msghdr header{};
        header.msg_iov = parts.data();
        header.msg_iovlen = parts.size();
        n = sendmsg(link.fd.get(), &header, kHow);
      }
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return errno == EAGAIN ? Written::Part : Written::Broken;
      link.sent += static_cast<std::size_t>(n);
      copied_.fetch_add(static_cast<std::size_t>(n), std::memory_order_relaxed);
    }
    return Written::Whole;
  }
  static constexpr int kHow = MSG_NOSIGNAL | MSG_DONTWAIT;
  char* length_at(std::size_t offset) { return reinterpret_cast<char*>(&length_) + offset; }

  bool enqueue(Link& link, Buffer* message, std::unique_lock<std::mutex>& lock) {
    const auto may = [&] {
      return link.waiting.size() < stream_.depth || link.state == Link::State::Gone;
    };
    if (stream_.lossless && !may() && !changed_.wait_for(lock, 30s, may)) return false;
    if (link.state == Link::State::Gone) return true;
    if (!may()) {
      link.waiting.front()->users.fetch_sub(1, std::memory_order_release);
      link.waiting.pop_front();
    }
    message->users.fetch_add(1, std::memory_order_relaxed);
    link.waiting.push_back(message);
    if (link.state != Link::State::Draining) {  // it became idle while this waited
      link.state = Link::State::Draining;
      watch(EPOLL_CTL_MOD, link.fd.get(), kRoom, &link);
    }
    return true;
  }

  // -- the thread

  void serve() {
    for (;;) {
      std::array<epoll_event, 16> events;
      const int n = epoll_wait(epoll_.get(), events.data(), static_cast<int>(events.size()), -1);
      for (int i = 0; i < n; ++i) {
        const epoll_event& event = events[static_cast<std::size_t>(i)];
        if (event.data.ptr == &stop_) return;
        if (event.data.ptr == &listener_) {
          accept_one();
          continue;
        }
        Link& link = *static_cast<Link*>(event.data.ptr);
        if ((event.events & (EPOLLRDHUP | EPOLLHUP | EPOLLERR)) != 0) {
          forget(link);
        } else {
          drain(link);
        }
      }
    }
  }
  void accept_one() {
    Descriptor fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (!fd) return;  // went again
    if (kind_ == Kind::Tcp) set(fd.get(), IPPROTO_TCP, TCP_NODELAY, 1);
    set(fd.get(), SOL_SOCKET, SO_SNDBUF, kSendBuffer);
    const std::lock_guard lock(mutex_);
    Link& link = *links_.emplace_back(std::make_unique<Link>());
    link.fd = std::move(fd);
    watch(EPOLL_CTL_ADD, link.fd.get(), kQuiet, &link);
    changed_.notify_all();
  }
  void drain(Link& link) {
    for (;;) {
      if (link.current == nullptr) {
        const std::lock_guard lock(mutex_);
        if (link.waiting.empty()) {
          link.state = Link::State::Idle;
          watch(EPOLL_CTL_MOD, link.fd.get(), kQuiet, &link);
        } else {
          begin_next(link);
        }
        changed_.notify_all();
        if (link.state == Link::State::Idle) return;
      }
      const Written written = write(link);
      if (written == Written::Part) return;
      if (written == Written::Broken) return forget(link);
      end(link);
    }
  }
  static void begin_next(Link& link) {
    link.current = link.waiting.front();  // whose user it stays
    link.sent = 0;
    link.waiting.pop_front();
  }
  void forget(Link& link) {
    const std::lock_guard lock(mutex_);
    epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, link.fd.get(), nullptr);
    if (link.state == Link::State::Draining && link.current != nullptr) end(link);
    for (Buffer* buffer : link.waiting) buffer->users.fetch_sub(1, std::memory_order_release);
    link.waiting.clear();
    link.state = Link::State::Gone;
    changed_.notify_all();
  }

  const Stream stream_;
  const Kind kind_;
  std::uint32_t length_;
  Pages message_;  ///< TCP: what is not serialised yet
  Buffer* loaned_ = nullptr;
  std::vector<std::unique_ptr<Buffer>> buffers_;
  std::size_t turn_ = 0;
  std::atomic<std::uint64_t> copied_{0};  // relaxed: a count that its readers may see late

  Descriptor epoll_;
  Descriptor stop_;
  Descriptor listener_;
  std::mutex mutex_;
  std::condition_variable changed_;           ///< links, their states, their queues
  std::vector<std::unique_ptr<Link>> links_;  // under the lock; what it points at stays
  std::thread thread_;
};

// ---- the subscriber -----------------------------------------------------------------------------

/// Empty: not there yet.
Descriptor connect_unix(const Stream& stream, const std::string& path) {
  const UnixName name(stream, path);
  Descriptor fd(socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), "socket");
  return connect(fd.get(), name.get(), name.size()) == 0 ? std::move(fd) : Descriptor();
}

class SocketReceiver final : public Receiver {
 public:
  SocketReceiver(const Stream& stream, Kind kind, unsigned subscriber)
      : stream_(stream),
        tcp_(kind != Kind::Unix),
        whole_(kLength + stream.size),
        room_(std::max<std::size_t>(1, kAtOnce / whole_) * whole_),
        missing_(stream.publishers),
        came_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK), "eventfd") {
    for (unsigned p = 0; p < stream.publishers; ++p) {
      if (kind != Kind::Unix) addresses_.push_back(ipv4(stream.address.at(p).at(subscriber)));
      sources_.push_back(std::make_unique<Source>(room_));
      inputs_.push_back({-1, POLLIN, 0});
    }
    inputs_.push_back({came_.get(), POLLIN, 0});
    // A node's own publisher may come after this, and wait for others: so nobody waits here.
    thread_ = std::thread([this, kind] { connect_all(kind); });
  }
  ~SocketReceiver() override {
    stop_.store(true, std::memory_order_relaxed);
    thread_.join();
    if (missing_ != 0) adopt();  // and closes
  }
  SocketReceiver(const SocketReceiver&) = delete;
  SocketReceiver& operator=(const SocketReceiver&) = delete;

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    Patience waiting(stream_.wait, patience);
    do {
      if (missing_ != 0) adopt();
      const int how = may_sleep_in_recv(patience) ? 0 : MSG_DONTWAIT;
      for (unsigned n = 0; n < stream_.publishers; ++n) {
        if (take((turn_ + n) % stream_.publishers, handler, waiting, how)) return true;
      }
    } while (waiting.wait(inputs_));
    return false;
  }
  std::uint64_t copied() const override { return copied_; }

 private:
  struct Source {
    explicit Source(std::size_t room) : pages(kLine + room) {}
    /// Where the first length goes: its body is aligned then.
    std::byte* memory() const { return pages.get() + kLine - kLength; }
    // Released by the thread that connected it, acquired by who reads from it.
    std::atomic<int> connected{-1};
    Descriptor fd;
    std::size_t got = 0;   ///< bytes in its memory
    std::size_t done = 0;  ///< of them, what has been handed over
    int enough = 1;        ///< bytes that wake who sleeps
    Pages pages;
  };

  bool take(unsigned publisher, const Handler& handler, Patience& waiting, int how) {
    Source& source = *sources_[publisher];
    if (!source.fd) return false;
    while (source.got - source.done < whole_) {
      if (tcp_ && stream_.wait != Wait::Spin) ask_for_enough(source);
      const ssize_t n =
          recv(source.fd.get(), source.memory() + source.got, room_ - source.got, how);
      if (n < 0 && errno == EINTR) continue;
      if (n < 0 && errno == EAGAIN) return false;
      if (n <= 0) {  // gone; what it has not finished is never handed over
        source.fd = Descriptor();
        inputs_[publisher].fd = -1;
        return false;
      }
      source.got += static_cast<std::size_t>(n);
      copied_ += static_cast<std::size_t>(n);
      waiting.progress();
    }
    const std::byte* const message = source.memory() + source.done;
    std::uint32_t length = 0;
    std::memcpy(&length, message, kLength);
    if (length != stream_.size) throw std::runtime_error("a message of another size");
    source.done += whole_;
    if (source.done == source.got) source.done = source.got = 0;
    turn_ = publisher + 1;
    handler({message + kLength, stream_.size});
    return true;
  }

  /// Nobody is woken for a length alone, nor for each packet of a large message: only when the rest
  /// is there, or as much as is worth a wake-up. (Unix sockets have no such choice.)
  void ask_for_enough(Source& source) {
    const int enough = static_cast<int>(std::min(whole_ - (source.got - source.done), kEnough));
    if (enough == source.enough) return;
    set(source.fd.get(), SOL_SOCKET, SO_RCVLOWAT, enough);
    source.enough = enough;
  }

  /// Who has one connection need not ask which one has something: it sleeps in its only call.
  bool may_sleep_in_recv(std::chrono::nanoseconds patience) {
    if (stream_.wait != Wait::Park || stream_.publishers != 1 || missing_ != 0 ||
        !sources_[0]->fd || !SleepLimit::can(patience)) {
      return false;
    }
    limit_.set(sources_[0]->fd.get(), patience);
    return true;
  }

  void adopt() {
    eventfd_t some = 0;
    eventfd_read(came_.get(), &some);  // before looking: what comes after it rings again
    for (unsigned p = 0; p < stream_.publishers; ++p) {
      const int fd = sources_[p]->connected.exchange(-1, std::memory_order_acquire);
      if (fd < 0) continue;
      sources_[p]->fd = Descriptor(fd);
      inputs_[p].fd = fd;
      if (--missing_ == 0) inputs_.pop_back();  // came_
    }
  }

  void connect_all(Kind kind) {
    std::vector<bool> done(stream_.publishers);
    for (unsigned connected = 0; !stop_.load(std::memory_order_relaxed);) {
      for (unsigned p = 0; p < stream_.publishers; ++p) {
        if (done[p]) continue;
        const std::string path = path_of(stream_, word(kind), p);
        Descriptor fd =
            kind == Kind::Unix ? connect_unix(stream_, path) : connect_tcp(path, addresses_[p]);
        if (!fd) continue;
        if (kind == Kind::Tcp) set(fd.get(), IPPROTO_TCP, TCP_NODELAY, 1);
        sources_[p]->connected.store(fd.release(), std::memory_order_release);
        eventfd_write(came_.get(), 1);
        done[p] = true;
        ++connected;
      }
      if (connected == stream_.publishers) return;
      std::this_thread::sleep_for(1ms);
    }
  }

  static constexpr std::size_t kEnough = 128 << 10;
  static constexpr std::size_t kAtOnce = 64 << 10;  ///< small messages are fetched together
  static constexpr std::size_t kLine = 64;

  const Stream stream_;
  const bool tcp_;
  const std::size_t whole_;         ///< bytes of a message with its length
  const std::size_t room_;          ///< bytes of some of them
  std::vector<in_addr> addresses_;  ///< of the publishers
  std::vector<std::unique_ptr<Source>> sources_;
  std::vector<pollfd> inputs_;  ///< of the sources, and came_ while some are missing
  unsigned missing_;            ///< publishers that are not connected yet
  SleepLimit limit_;
  unsigned turn_ = 0;
  std::uint64_t copied_ = 0;
  Descriptor came_;  ///< a connection is there to be adopted
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

Transport socket_transport(std::string about, Kind kind) {
  Transport t;
  t.name = word(kind);
  t.about = std::move(about);
  t.is_network = kind != Kind::Unix;
  t.copies = true;
  t.refuses = [](const Stream&) { return std::string(); };
  t.sender = [kind](const Stream& stream, unsigned publisher) {
    return std::make_unique<SocketSender>(stream, kind, publisher);
  };
  t.receiver = [kind](const Stream& stream, unsigned subscriber) {
    return std::make_unique<SocketReceiver>(stream, kind, subscriber);
  };
  return t;
}

}  // namespace

std::vector<Transport> socket_transports() {
  return {
      socket_transport("TCP as ROS uses it: serialised, length and body, TCP_NODELAY", Kind::Tcp),
      socket_transport("the same without TCP_NODELAY", Kind::TcpNagle),
      socket_transport("Unix stream sockets, sent from where the message was written", Kind::Unix),
  };
}

}  // namespace ab
