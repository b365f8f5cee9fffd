// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <csignal>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <mutex>
#include <optional>
#include <poll.h>
#include <stdexcept>
#include <sys/file.h>
#include <sys/statvfs.h>
#include <sys/wait.h>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <utility>

#include <iceoryx_hoofs/log/logmanager.hpp>
#include <iceoryx_posh/internal/popo/ports/publisher_port_user.hpp>
#include <iceoryx_posh/popo/untyped_subscriber.hpp>
#include <iceoryx_posh/popo/wait_set.hpp>
#include <iceoryx_posh/runtime/posh_runtime.hpp>
#include <spawn.h>

#include "roudi.hpp"
#include "transport.hpp"
#include "warm.hpp"

/// iceoryx 2.0.3: loans in shared memory, lock-free queues, and a daemon, RouDi.
///
/// What is named: the nodes' sockets, /tmp/<Stream::name>-iox-<pid>; and the one set of files that
/// a machine's RouDi has (roudi.hpp).
///
/// Crash:  RouDi ends with the harness and removes its files. A harness that is killed leaves the
///         sockets of its nodes in /tmp. A killed subscriber's full queue blocks a lossless
///         publisher for ever.
namespace ab {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;

constexpr std::uint32_t kAlignment = 64;
constexpr std::uint64_t kManagementBytes = 80 << 20;

std::uint64_t queue_capacity(const Stream& stream) {
  return std::clamp<std::uint64_t>(std::uint64_t{stream.depth} * stream.publishers, 1,
                                   iox::MAX_SUBSCRIBER_QUEUE_CAPACITY);
}

// ---- RouDi --------------------------------------------------------------------------------------

using Pools = std::map<std::uint64_t, std::uint64_t>;  // bytes of a chunk: how many

void add_pool(Pools& pools, const Stream& stream) {
  const std::uint64_t bytes = (stream.size + kAlignment - 1) / kAlignment * kAlignment + kAlignment;
  // What waits, what subscribers hold, and the last one, the next one and some between of each
  // publisher.
  pools[bytes] += queue_capacity(stream) * (stream.lossless ? 1 : 2) + 2 * stream.subscribers +
                  8 * stream.publishers;
}

std::uint64_t bytes_of(const Pools& pools) {
  std::uint64_t bytes = kManagementBytes;
  for (const auto& [size, count] : pools) bytes += (size + kAlignment) * count;
  return bytes;
}

std::string said(const std::string& log) {
  std::ifstream file(log);
  return {std::istreambuf_iterator<char>(file), {}};
}

bool somebody_has_the_lock() {
  const int fd = open(kRoudiLock, O_RDONLY | O_CLOEXEC);
  if (fd < 0) return errno != ENOENT;
  const bool is_free = flock(fd, LOCK_SH | LOCK_NB) == 0;
  close(fd);
  return !is_free;
}

void remove_sockets(const std::string& stream) {
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator("/tmp", ignored)) {
    if (entry.path().filename().string().rfind(stream + "-iox-", 0) == 0)
      fs::remove(entry.path(), ignored);
  }
}

bool has_nodes(const std::string& stream) {
  std::error_code ignored;
  const fs::directory_iterator files("/tmp", ignored);
  return std::any_of(begin(files), end(files), [&](const fs::directory_entry& entry) {
    return entry.path().filename().string().rfind(stream + "-iox-", 0) == 0;
  });
}

/// The daemon of all streams of this process. It cannot be given more memory while it runs, so each
/// further stream starts it anew, which is possible as long as no node has joined.
class Daemon {
 public:
  ~Daemon() {
    if (owner_ == getpid()) stop();  // not in a fork
  }

  void add(const Stream& stream) {
    const std::lock_guard lock(mutex_);
    for (const Stream& other : streams_) {
      if (has_nodes(other.name))
        throw std::runtime_error(
            "iceoryx: a RouDi has one set of memory pools: all streams must be served before the "
            "first node joins");
    }
    streams_.push_back(stream);
    stop();
    try {
      start();
    } catch (...) {
      streams_.pop_back();
      if (!streams_.empty()) start();  // the others go on
      throw;
    }
  }

  void remove(const std::string& name) {
    const std::lock_guard lock(mutex_);
    streams_.erase(std::find_if(streams_.begin(), streams_.end(),
                                [&](const Stream& s) { return s.name == name; }));
    if (streams_.empty()) stop();
    remove_sockets(name);
  }

  /// 0: it does not run.
  pid_t pid() {
    const std::lock_guard lock(mutex_);
    return pid_;
  }

 private:
  void start() {
    Pools pools;
    for (const Stream& stream : streams_) add_pool(pools, stream);
    std::vector<std::string> words{LOT_AB_ROUDI, std::to_string(getpid())};
    for (const auto& [size, count] : pools)
      words.push_back(std::to_string(size) + ":" + std::to_string(count));
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);

    int answer[2];
    if (pipe2(answer, O_CLOEXEC) != 0)
      throw std::system_error(errno, std::generic_category(), "pipe");
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, answer[1], kRoudiReadyFd);
    // It tells how it gets on: read when it does not.
    const std::string log = streams_.back().directory + "/" + streams_.back().name + "-roudi";
    posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, log.c_str(),
                                     O_WRONLY | O_CREAT | O_TRUNC, 0600);
    posix_spawn_file_actions_adddup2(&actions, STDOUT_FILENO, STDERR_FILENO);
    const int error =
        posix_spawn(&pid_, LOT_AB_ROUDI, &actions, nullptr, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    close(answer[1]);
    char byte = 0;
    pollfd readable{answer[0], POLLIN, 0};
    const bool answers =
        error == 0 && poll(&readable, 1, 60'000) == 1 && read(answer[0], &byte, 1) == 1;
    close(answer[0]);
    if (error != 0) {
      pid_ = 0;
      throw std::system_error(error, std::generic_category(), LOT_AB_ROUDI);
    }
    if (!answers) {
      stop();
      throw std::runtime_error(
          "iceoryx: RouDi did not start; does another one run, or is there "
          "too little room in /dev/shm? It said: " +
          said(log));
    }
  }

  void stop() {
    if (pid_ <= 0) return;
    kill(pid_, SIGTERM);
    int status = 0;
    const auto until = std::chrono::steady_clock::now() + 10s;
    pid_t ended = 0;
    while ((ended = waitpid(pid_, &status, WNOHANG)) == 0 &&
           std::chrono::steady_clock::now() < until)
      std::this_thread::sleep_for(5ms);
    if (ended == 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, &status, 0);
    }
    pid_ = 0;
    // Unless it was refused the machine's lock, what is there is its own.
    if (WIFEXITED(status) || somebody_has_the_lock()) return;
    std::error_code ignored;
    for (const std::string& file : roudi_files()) fs::remove(file, ignored);
  }

  std::mutex mutex_;
  std::vector<Stream> streams_;
  pid_t pid_ = 0;
  pid_t owner_ = getpid();
};

Daemon& daemon() {
  static Daemon one;
  return one;
}

class RouDi final : public Service {
 public:
  explicit RouDi(const Stream& stream) : name_(stream.name) { daemon().add(stream); }
  ~RouDi() override { daemon().remove(name_); }
  int pid() const override { return daemon().pid(); }

 private:
  std::string name_;
};

std::string refuses(const Stream& stream) {
  if (stream.isolated)
    return "its nodes and its daemon meet under fixed names in /tmp and /dev/shm; set --place host";
  Pools pools;
  add_pool(pools, stream);
  if (bytes_of(pools) > std::uint64_t{UINT32_MAX} * 64 || stream.size > UINT32_MAX / 2)
    return "its chunks are smaller than 2 GiB";
  if (daemon().pid() > 0) return "";
  if (somebody_has_the_lock())
    return "another RouDi runs on this machine (" + std::string(kRoudiLock) +
           " is locked), and there can be one only: end it, or wait for the other lot_ab";
  struct statvfs disk {};
  const std::uint64_t need = bytes_of(pools);
  if (statvfs("/dev/shm", &disk) == 0 && std::uint64_t{disk.f_bavail} * disk.f_frsize < need)
    return "needs " + std::to_string(need >> 20) + " MiB in /dev/shm; set a smaller size or depth";
  return "";
}

// ---- nodes --------------------------------------------------------------------------------------

/// A process joins once, whatever it has ends of. The daemon forgets it with the machine's lock.
void join(const Stream& stream) {
  static const bool joined = [&] {
    if (!fs::exists(kRoudiSocket)) throw std::runtime_error("iceoryx: no RouDi runs");
    iox::log::LogManager::GetLogManager().SetDefaultLogLevel(
        iox::log::LogLevel::kError, iox::log::LogLevelOutput::kHideLogLevel);
    const std::string name = stream.name + "-iox-" + std::to_string(getpid());
    iox::runtime::PoshRuntime::initRuntime(iox::RuntimeName_t(iox::cxx::TruncateToCapacity, name));
    return true;
  }();
  (void)joined;
}

void warm_segments() {
  warm(kRoudiManagement);
  warm(roudi_segment());
}

iox::capro::ServiceDescription topic_of(const Stream& stream) {
  return {"lot_ab", iox::capro::IdString_t(iox::cxx::TruncateToCapacity, stream.name), "message"};
}

class IceoryxSender final : public Sender {
 public:
  explicit IceoryxSender(const Stream& stream)
      : size_(static_cast<std::uint32_t>(stream.size)), data_(advertise(stream)), port_(data_) {
    warm_segments();
  }
  ~IceoryxSender() override {
    if (loaned_ != nullptr) port_.releaseChunk(loaned_);
    port_.destroy();
  }

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = std::chrono::steady_clock::now() + patience;
    while (queues() < subscribers) {
      if (std::chrono::steady_clock::now() >= until) return false;
      std::this_thread::sleep_for(1ms);
    }
    return true;
  }
  std::byte* loan() override {
    if (loaned_ == nullptr) {
      auto chunk = port_.tryAllocateChunk(size_, kAlignment);
      if (chunk.has_error()) throw std::runtime_error("iceoryx: no chunk is free");
      loaned_ = chunk.value();
    }
    return static_cast<std::byte*>(loaned_->userPayload());
  }
  bool push() override {
    port_.sendChunk(std::exchange(loaned_, nullptr));
    return true;
  }

 private:
  static iox::popo::PublisherPortData* advertise(const Stream& stream) {
    join(stream);
    iox::popo::PublisherOptions options;
    options.subscriberTooSlowPolicy = stream.lossless
                                          ? iox::popo::ConsumerTooSlowPolicy::WAIT_FOR_CONSUMER
                                          : iox::popo::ConsumerTooSlowPolicy::DISCARD_OLDEST_DATA;
    return iox::runtime::PoshRuntime::getInstance().getMiddlewarePublisher(topic_of(stream),
                                                                           options);
  }
  std::size_t queues() const {
    const std::lock_guard lock(data_->m_chunkSenderData);
    return data_->m_chunkSenderData.m_queues.size();
  }

  std::uint32_t size_;
  // What UntypedPublisher is made of. It says whether anybody has subscribed; this, how many.
  iox::popo::PublisherPortData* data_;
  iox::popo::PublisherPortUser port_;
  iox::mepoo::ChunkHeader* loaned_ = nullptr;
};

class IceoryxReceiver final : public Receiver {
 public:
  explicit IceoryxReceiver(const Stream& stream) : size_(stream.size), wait_(wait_of(stream)) {
    join(stream);
    iox::popo::SubscriberOptions options;
    options.queueCapacity = queue_capacity(stream);
    options.queueFullPolicy = stream.lossless ? iox::popo::QueueFullPolicy::BLOCK_PRODUCER
                                              : iox::popo::QueueFullPolicy::DISCARD_OLDEST_DATA;
    // A publisher has a system call fewer to do for who polls.
    if (wait_ != Wait::Spin) wait_set_.emplace();
    subscriber_.emplace(topic_of(stream), options);
    if (wait_set_ &&
        wait_set_->attachEvent(*subscriber_, iox::popo::SubscriberEvent::DATA_RECEIVED).has_error())
      throw std::runtime_error("iceoryx: the WaitSet takes no subscriber");
    warm_segments();
  }
  ~IceoryxReceiver() override {
    if (wait_set_) wait_set_->detachEvent(*subscriber_, iox::popo::SubscriberEvent::DATA_RECEIVED);
  }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    if (take(handler)) return true;
    const auto start = std::chrono::steady_clock::now();
    for (;;) {
      if (wait_ != Wait::Park) {
        for (unsigned n = 0; n < kPollsPerClock; ++n) {
          if (take(handler)) return true;
        }
      }
      const auto waited = std::chrono::steady_clock::now() - start;
      if (patience >= 0ns && waited >= patience) return false;
      if (wait_ == Wait::Spin || (wait_ == Wait::Adaptive && waited < kSpinTime)) continue;
      if (patience < 0ns) {
        wait_set_->wait();
      } else {
        wait_set_->timedWait(iox::units::Duration(patience - waited));
      }
      if (take(handler)) return true;
    }
  }
  std::uint64_t missed() const override { return missed_; }

 private:
  static constexpr unsigned kPollsPerClock = 16;
  /// A little more than what a wake-up across cores costs.
  static constexpr auto kSpinTime = 50us;

  static Wait wait_of(const Stream& stream) {
    // Not our own affinity: who is pinned to a core each has the more reason to spin.
    if (stream.wait == Wait::Adaptive && sysconf(_SC_NPROCESSORS_ONLN) == 1) return Wait::Park;
    return stream.wait;
  }

  bool take(const Handler& handler) {
    auto chunk = subscriber_->take();
    if (chunk.has_error()) return false;
    const void* const bytes = chunk.value();
    handler({static_cast<const std::byte*>(bytes), size_});
    const auto* const header = iox::mepoo::ChunkHeader::fromUserPayload(bytes);
    // A publisher numbers its chunks: what is left out was discarded.
    std::uint64_t& next =
        next_.try_emplace(static_cast<std::uint64_t>(header->originId()), header->sequenceNumber())
            .first->second;
    missed_ += header->sequenceNumber() - next;
    next = header->sequenceNumber() + 1;
    subscriber_->release(bytes);
    return true;
  }

  std::size_t size_;
  Wait wait_;
  std::optional<iox::popo::WaitSet<1>> wait_set_;
  std::optional<iox::popo::UntypedSubscriber> subscriber_;
  std::map<std::uint64_t, std::uint64_t> next_;  // publisher: number
  std::uint64_t missed_ = 0;
};

}  // namespace

std::vector<Transport> iceoryx_transports() {
  Transport t;
  t.name = "iceoryx";
  t.about = "iceoryx 2.0.3: loans through shared memory, with its daemon; polling or WaitSet";
  t.refuses = refuses;
  t.serve = [](const Stream& stream) { return std::make_unique<RouDi>(stream); };
  t.sender = [](const Stream& stream, unsigned) { return std::make_unique<IceoryxSender>(stream); };
  t.receiver = [](const Stream& stream, unsigned) {
    return std::make_unique<IceoryxReceiver>(stream);
  };
  return {std::move(t)};
}

}  // namespace ab
