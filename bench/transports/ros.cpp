// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <netinet/in.h>
#include <optional>
#include <poll.h>
#include <random>
#include <stdexcept>
#include <sys/socket.h>
#include <sys/wait.h>
#include <system_error>
#include <thread>
#include <tuple>
#include <unistd.h>
#include <utility>

#include <spawn.h>

#include "ros_ends.hpp"
#include "sockets.hpp"
#include "transport.hpp"
#include "tzc.hpp"

/// Nodes of stock ROS, with a rosmaster of their own, that publish and subscribe as any do: roscpp
/// over TCPROS and UDPROS and within one process, lot::ros, and TZC's protocol with its descriptors
/// in ROS messages.
///
/// roscpp reads sockets in a thread of its own, which sleeps whatever Stream::wait says: that is
/// about the thread that calls callbacks.
namespace ab {
namespace {

using namespace std::chrono_literals;
using ros_ends::Terms;
using ros_ends::Way;

constexpr auto kStarts = 60s;  ///< a master
constexpr auto kEnds = 5s;
constexpr int kReachesMs = 5000;

std::string uri_file(const Stream& stream) { return stream.directory + "/rosmaster"; }

bool copies(Way way) { return way == Way::Tcp || way == Way::TcpNoDelay || way == Way::Udp; }

// ---- the master ---------------------------------------------------------------------------------

sockaddr_in name_of(const std::string& host, int port) {
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_port = htons(static_cast<std::uint16_t>(port));
  if (inet_pton(AF_INET, host.c_str(), &name.sin_addr) != 1) {
    throw std::runtime_error(host + " is no address");
  }
  return name;
}
/// A port that nobody listens on, below those that the kernel gives to whoever asks for any: a node
/// could have it before the master.
int free_port(const std::string& host) {
  std::random_device random;
  for (;;) {
    const Descriptor fd(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0), "socket");
    const int port = std::uniform_int_distribution<int>(20000, 31999)(random);
    const sockaddr_in name = name_of(host, port);
    if (bind(fd.get(), reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0) return port;
    if (errno != EADDRINUSE) fail("bind");
  }
}
/// The address by which who listens there reaches this process. Nothing: nobody does.
std::optional<std::string> seen_by(const std::string& host, int port) {
  const Descriptor fd(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0), "socket");
  const sockaddr_in there = name_of(host, port);
  if (connect(fd.get(), reinterpret_cast<const sockaddr*>(&there), sizeof there) != 0) {
    if (errno != EINPROGRESS) return std::nullopt;
    pollfd ready{fd.get(), POLLOUT, 0};
    if (poll(&ready, 1, kReachesMs) != 1) return std::nullopt;
    int error = 0;
    socklen_t length = sizeof error;
    if (getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &length) != 0) fail("getsockopt");
    if (error != 0) return std::nullopt;
  }
  sockaddr_in here{};
  socklen_t length = sizeof here;
  if (getsockname(fd.get(), reinterpret_cast<sockaddr*>(&here), &length) != 0) fail("getsockname");
  char text[INET_ADDRSTRLEN];
  if (inet_ntop(AF_INET, &here.sin_addr, text, sizeof text) == nullptr) fail("inet_ntop");
  return text;
}

/// Where the master of an arm is: nodes in containers meet on the first publisher's network.
std::string host_of(const Stream& stream) {
  return stream.address.empty() ? "127.0.0.1" : stream.address[0][0];
}

/// The master of all streams that share a directory: the first of them starts it.
class Master final : public Service {
 public:
  explicit Master(const Stream& stream) {
    if (std::filesystem::exists(uri_file(stream))) return;
    const std::string host = host_of(stream);
    const int port = free_port(host);
    const std::string log = stream.directory + "/rosmaster.log";
    start(host, port, stream.directory, log);
    const auto until = std::chrono::steady_clock::now() + kStarts;
    while (!seen_by(host, port)) {
      if (std::chrono::steady_clock::now() < until && waitpid(pid_, nullptr, WNOHANG) == 0) {
        std::this_thread::sleep_for(10ms);
        continue;
      }
      stop();
      std::ifstream said(log);
      throw std::runtime_error("rosmaster did not start; it said: " +
                               std::string(std::istreambuf_iterator<char>(said), {}));
    }
    // Whole, or not there.
    std::ofstream(uri_file(stream) + ".new") << host << ' ' << port << '\n';
    std::filesystem::rename(uri_file(stream) + ".new", uri_file(stream));
  }
  ~Master() override { stop(); }
  int pid() const override { return pid_; }

 private:
  void start(const std::string& host, int port, const std::string& directory,
             const std::string& log) {
    std::vector<std::string> words{LOT_AB_ROSMASTER,     "--core", "-p",
                                   std::to_string(port), "-w",     "3"};
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    std::vector<std::string> settings{"ROS_HOME=" + directory, "ROS_IP=" + host};
    std::vector<char*> environment;
    for (std::string& setting : settings) environment.push_back(setting.data());
    for (char** e = environ; *e != nullptr; ++e) {
      if (std::strncmp(*e, "ROS_", 4) != 0) environment.push_back(*e);
    }
    environment.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, log.c_str(),
                                     O_WRONLY | O_CREAT | O_TRUNC, 0600);
    posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    const int error = posix_spawn(&pid_, LOT_AB_ROSMASTER, &actions, nullptr, arguments.data(),
                                  environment.data());
    posix_spawn_file_actions_destroy(&actions);
    if (error != 0) {
      pid_ = 0;
      throw std::system_error(error, std::generic_category(), LOT_AB_ROSMASTER);
    }
  }
  void stop() {
    if (pid_ <= 0) return;
    kill(pid_, SIGINT);
    const auto until = std::chrono::steady_clock::now() + kEnds;
    pid_t ended = 0;
    while ((ended = waitpid(pid_, nullptr, WNOHANG)) == 0 &&
           std::chrono::steady_clock::now() < until) {
      std::this_thread::sleep_for(5ms);
    }
    if (ended == 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    pid_ = 0;
  }

  pid_t pid_ = 0;
};

/// Containers have one of their own, which their first publisher starts.
std::unique_ptr<Master> own_master(const Stream& stream, unsigned publisher) {
  const bool is_first = publisher == 0 && stream.name.ends_with("_0");
  return stream.isolated && is_first ? std::make_unique<Master>(stream) : nullptr;
}

// ---- ends
// -----------------------------------------------------------------------------------------

/// Messages that a publisher of LOT's has in memory: in its ring, at hand, and on their way home.
unsigned prepared(const Stream& stream) { return std::max(stream.depth, 16U) + 8; }

/// A name that ROS takes.
std::string ros_name(std::string name) {
  for (char& c : name) {
    if (c == '-') c = '_';
  }
  return "n" + name;
}

/// Of a topic and a node together. xmlrpcpp spoils a header of UDPROS whose size is a multiple of
/// 54 (its base64EncodedSize() forgets a line's end: ros_comm, pull request 2160, never merged),
/// and then nothing comes: so that size must not depend on what a stream is called.
constexpr std::size_t kNames = 128;

/// {the master's URI, this node's address}, when there is a master.
std::pair<std::string, std::string> meet(const Stream& stream) {
  const auto until = std::chrono::steady_clock::now() + kStarts;
  while (!std::filesystem::exists(uri_file(stream))) {
    if (std::chrono::steady_clock::now() > until) throw std::runtime_error("no rosmaster came");
    std::this_thread::sleep_for(10ms);
  }
  std::string host;
  int port = 0;
  std::ifstream(uri_file(stream)) >> host >> port;
  const auto address = seen_by(host, port);
  if (!address) {
    throw std::runtime_error("no way leads to the rosmaster at " + host +
                             ": containers of several topics do not meet; set --place host");
  }
  return {"http://" + host + ":" + std::to_string(port) + "/", *address};
}

Terms terms_of(const Stream& stream, Way way, char role, unsigned index) {
  Terms terms;
  terms.way = way;
  terms.waiting = stream.wait == Wait::Spin       ? ros_ends::Waiting::Spin
                  : stream.wait == Wait::Adaptive ? ros_ends::Waiting::Adaptive
                                                  : ros_ends::Waiting::Park;
  std::tie(terms.master, terms.address) = meet(stream);
  terms.topic = "/" + ros_name(stream.name);
  terms.node = ros_name(stream.name) + "_" + role + std::to_string(index);
  terms.node.resize(std::max(terms.node.size(), kNames - std::min(kNames, terms.topic.size())),
                    '_');
  terms.directory = stream.directory;
  terms.segment = stream.name;
  terms.size = stream.size;
  terms.depth = stream.depth;
  terms.pool = stream.pool;
  terms.prepared = prepared(stream);
  terms.one_by_one = stream.one_by_one;
  // And what subscribers hold, or keep until they are told that it is theirs; in ping-pong the
  // other way, too, since a process has one segment.
  const std::uint64_t messages =
      std::uint64_t{prepared(stream)} * stream.publishers + stream.subscribers * (stream.depth + 4);
  terms.segment_bytes = (64 << 20) + 2 * messages * (stream.size + 8192);
  return terms;
}

/// True when it has so many subscribers within `patience`.
bool reaches(const ros_ends::Publisher& topic, unsigned subscribers,
             std::chrono::nanoseconds patience) {
  const auto until = std::chrono::steady_clock::now() + patience;
  while (topic.subscribers() < subscribers) {
    if (std::chrono::steady_clock::now() >= until) return false;
    std::this_thread::sleep_for(1ms);
  }
  return true;
}

class RosSender final : public Sender {
 public:
  RosSender(const Stream& stream, Way way, unsigned publisher)
      : stream_(stream),
        master_(own_master(stream, publisher)),
        topic_(advertise(terms_of(stream, way, 'p', publisher))) {}

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    return reaches(*topic_, subscribers, patience);
  }
  std::byte* loan() override { return topic_->loan(); }
  bool push() override {
    topic_->publish();
    return true;
  }
  /// Once when it is serialised, and once into each socket.
  std::uint64_t copied() const override {
    return topic_->serialised() * stream_.size * (1 + stream_.subscribers);
  }

 private:
  const Stream stream_;
  const std::unique_ptr<Master> master_;
  const std::unique_ptr<ros_ends::Publisher> topic_;
};

class RosReceiver final : public Receiver {
 public:
  RosReceiver(const Stream& stream, Way way, unsigned subscriber)
      : copies_(copies(way)), topic_(subscribe(terms_of(stream, way, 's', subscriber))) {}

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    return topic_->receive(
        [&](const std::byte* bytes, std::size_t size) {
          if (copies_) copied_ += 2 * size;  // out of the socket, and when it is deserialised
          handler({bytes, size});
        },
        patience);
  }
  std::uint64_t copied() const override { return copied_; }

 private:
  const bool copies_;
  const std::unique_ptr<ros_ends::Subscriber> topic_;
  std::uint64_t copied_ = 0;
};

/// TZC's notices in ROS messages.
Terms notices_of(const Stream& stream, char role, unsigned index) {
  Terms terms = terms_of(stream, Way::Tcp, role, index);
  terms.size = sizeof(tzc::Notice);
  terms.pool = 2;
  return terms;
}

class RosTzcSender final : public Sender {
 public:
  RosTzcSender(const Stream& stream, unsigned publisher)
      : size_(stream.size),
        publisher_(publisher),
        segment_(stream),
        spare_(stream.size),
        master_(own_master(stream, publisher)),
        topic_(advertise(notices_of(stream, 'p', publisher))) {}

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    return reaches(*topic_, subscribers, patience);
  }
  std::byte* loan() override {
    if (handle_ == tzc::kNone) handle_ = segment_.allocate();
    return handle_ == tzc::kNone ? spare_.get() : segment_.bytes(handle_);
  }
  bool push() override {
    if (handle_ == tzc::kNone) return false;
    const tzc::Notice notice{number_++, segment_.generation(handle_), size_, handle_, publisher_};
    std::memcpy(topic_->loan(), &notice, sizeof notice);
    topic_->publish();
    segment_.release(std::exchange(handle_, tzc::kNone));
    return true;
  }

 private:
  const std::size_t size_;
  const std::uint32_t publisher_;
  tzc::Segment segment_;
  const Pages spare_;  ///< where a message is filled for which there is no memory
  const std::unique_ptr<Master> master_;
  const std::unique_ptr<ros_ends::Publisher> topic_;
  std::uint32_t handle_ = tzc::kNone;  ///< on loan
  std::uint64_t number_ = 0;
};

class RosTzcReceiver final : public Receiver {
 public:
  RosTzcReceiver(const Stream& stream, unsigned subscriber)
      : size_(stream.size),
        segment_(stream),
        next_(stream.publishers),
        topic_(subscribe(notices_of(stream, 's', subscriber))) {}

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    bool came = false;
    const auto read = [&](const std::byte* bytes, std::size_t size) {
      tzc::Notice notice{};
      if (size == sizeof notice) std::memcpy(&notice, bytes, sizeof notice);
      if (notice.length != size_ || notice.handle >= segment_.size() ||
          notice.publisher >= next_.size()) {
        throw std::runtime_error("ros-tzc: what came is no notice of this stream");
      }
      missed_ += notice.number - next_[notice.publisher];
      next_[notice.publisher] = notice.number + 1;
      if (!segment_.acquire(notice.handle, notice.generation)) {
        ++missed_;
        return;
      }
      handler({segment_.bytes(notice.handle), size_});
      segment_.release(notice.handle);
      came = true;
    };
    const auto begin = std::chrono::steady_clock::now();
    for (;;) {
      const auto left = patience - (std::chrono::steady_clock::now() - begin);
      if (!topic_->receive(read, patience < 0ns ? patience : std::max(left, left.zero()))) {
        return false;
      }
      if (came) return true;
    }
  }
  std::uint64_t missed() const override { return missed_; }

 private:
  const std::size_t size_;
  tzc::Segment segment_;
  std::vector<std::uint64_t> next_;  ///< of each publisher
  std::uint64_t missed_ = 0;
  const std::unique_ptr<ros_ends::Subscriber> topic_;
};

Transport base(std::string name, std::string about) {
  Transport t;
  t.name = std::move(name);
  t.about = std::move(about);
  t.waits = false;
  t.is_network = true;
  t.refuses = [](const Stream&) { return std::string(); };
  t.serve = [](const Stream& stream) -> std::unique_ptr<Service> {
    if (stream.isolated) return std::make_unique<Service>();  // see own_master()
    return std::make_unique<Master>(stream);
  };
  return t;
}

/// A datagram of 1500 bytes takes up to a page of the buffer that it waits in.
constexpr std::size_t kBufferPerByte = 4;

/// Bytes that wait in a socket which nobody has set, and roscpp sets none of UDPROS.
std::size_t receive_buffer() {
  std::size_t bytes = 0;
  std::ifstream("/proc/sys/net/core/rmem_default") >> bytes;
  return bytes;
}

Transport ros_transport(std::string name, std::string about, Way way) {
  Transport t = base(std::move(name), std::move(about));
  t.threads = way == Way::Intra;
  t.copies = copies(way);
  t.may_lose = way == Way::Udp;
  if (way == Way::Udp) t.arrives = receive_buffer() / kBufferPerByte;
  t.sender = [way](const Stream& stream, unsigned publisher) {
    return std::make_unique<RosSender>(stream, way, publisher);
  };
  t.receiver = [way](const Stream& stream, unsigned subscriber) {
    return std::make_unique<RosReceiver>(stream, way, subscriber);
  };
  return t;
}

}  // namespace

std::vector<Transport> ros_transports() {
  std::vector<Transport> all{
      ros_transport("ros-lot", "roscpp with lot::ros: frames in the lock-free ring", Way::Lot),
      ros_transport("ros-lot-immediate", "the same, callbacks called by LOT's thread",
                    Way::LotImmediate),
      ros_transport("ros-lot-mutex", "roscpp with lot::ros: the queue under a robust mutex",
                    Way::LotMutex),
      ros_transport("ros-tcp", "roscpp: TCPROS", Way::Tcp),
      ros_transport("ros-tcp-nodelay", "the same with TransportHints().tcpNoDelay()",
                    Way::TcpNoDelay),
      ros_transport("ros-udp", "roscpp: UDPROS, datagrams of 1500 bytes", Way::Udp),
      ros_transport("ros-intra", "roscpp: pointers within one process", Way::Intra)};
  Transport tzc =
      base("ros-tzc", "TZC's protocol: bytes in shared memory, descriptors over TCPROS");
  tzc.sender = [](const Stream& stream, unsigned publisher) {
    return std::make_unique<RosTzcSender>(stream, publisher);
  };
  tzc.receiver = [](const Stream& stream, unsigned subscriber) {
    return std::make_unique<RosTzcReceiver>(stream, subscriber);
  };
  all.push_back(std::move(tzc));
  Transport pace = ros_transport(
      "floor-ros", "what nodes of ROS cost that are connected, and send nothing", Way::Pace);
  pace.is_floor = true;
  pace.delivers = false;
  all.push_back(std::move(pace));
  return all;
}

}  // namespace ab
