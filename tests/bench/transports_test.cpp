// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <memory>
#include <sys/mman.h>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "support/processes.hpp"
#include "support/seed.hpp"
#include "transport.hpp"

/// Every transport, without the harness: real processes, every byte looked at.
/// LOT_AB_TRANSPORT=NAME in the environment: that one only.
namespace {

using namespace ab;
using namespace lot::testing;

constexpr unsigned kMessages = 60;  // of each publisher: more than a pool, less than time allows
constexpr auto kPatience = 20s;     // of who waits for others
constexpr std::uint64_t kLast = std::uint64_t{1} << 63;

/// How far the subscribers of a stream are, in memory that all its nodes share. Who may lose a
/// message may lose all of a burst: its publishers go on until each subscriber has something. And
/// who goes takes with it what it has not sent yet: the others stay until each subscriber has the
/// last ones.
class Progress {
 public:
  struct Counts {
    std::atomic<unsigned> begun;  // subscribers
    std::atomic<unsigned> ended;
  };

  Progress()
      : counts_(static_cast<Counts*>(mmap(nullptr, sizeof(Counts), PROT_READ | PROT_WRITE,
                                          MAP_SHARED | MAP_ANONYMOUS, -1, 0))) {
    must(counts_ != MAP_FAILED, "mmap");
  }
  ~Progress() { munmap(counts_, sizeof(Counts)); }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  Counts* operator->() const { return counts_; }

 private:
  Counts* counts_;
};

struct Head {
  std::uint64_t number;  // with kLast
  std::uint32_t publisher;
  std::uint32_t size;
};

std::byte pattern(const Head& head, std::size_t i) {
  return static_cast<std::byte>(head.number * 31 + head.publisher * 7 + i / 64);
}

void fill(std::byte* at, const Head& head) {
  std::memcpy(at, &head, sizeof head);
  for (std::size_t i = sizeof head; i < head.size; i += 64) at[i] = pattern(head, i);
  at[head.size - 1] = pattern(head, head.size - 1);
}
bool is_whole(std::span<const std::byte> message, const Head& head) {
  for (std::size_t i = sizeof head; i < head.size; i += 64) {
    if (message[i] != pattern(head, i)) return false;
  }
  return message[head.size - 1] == pattern(head, head.size - 1);
}

void publish(const Transport& transport, const Stream& stream, unsigned publisher,
             const Progress& progress) {
  const auto sender = transport.sender(stream, publisher);
  must(sender->wait_for_subscribers(stream.subscribers, kPatience), "all subscribers have come");
  const auto until = std::chrono::steady_clock::now() + kPatience;
  bool last = false;
  for (std::uint64_t n = 0; !last; ++n) {
    last = n + 1 >= kMessages && (!transport.may_lose || progress->begun == stream.subscribers ||
                                  std::chrono::steady_clock::now() > until);
    fill(sender->loan(),
         {n | (last ? kLast : 0), publisher, static_cast<std::uint32_t>(stream.size)});
    must(sender->push(), "a message was published");
    // Losses of who cannot wait for readers are few, and the last one arrives.
    if (!stream.lossless) std::this_thread::sleep_for(n + 2 >= kMessages ? 100ms : 1ms);
  }
  eventually([&] { return progress->ended == stream.subscribers; },
             transport.may_lose ? 300ms : kPatience);
}

void subscribe(const Transport& transport, const Stream& stream, unsigned subscriber,
               const Progress& progress) {
  const auto receiver = transport.receiver(stream, subscriber);
  std::vector<std::uint64_t> next(stream.publishers, 0);
  std::uint64_t received = 0;
  unsigned ended = 0;
  const auto until = std::chrono::steady_clock::now() + 40s;
  while (ended < stream.publishers && std::chrono::steady_clock::now() < until) {
    receiver->receive(
        [&](std::span<const std::byte> message) {
          Head head{};
          must(message.size() >= sizeof head, "a message has a head");
          std::memcpy(&head, message.data(), sizeof head);
          must(head.publisher < stream.publishers, "it is of a publisher");
          must(head.size == stream.size, "it says its size");
          const std::uint64_t number = head.number & ~kLast;
          must(number >= next[head.publisher], "in order, and once");
          next[head.publisher] = number + 1;
          if (received++ == 0) ++progress->begun;
          if ((head.number & kLast) != 0) ++ended;
          if (transport.is_floor) return;  // a line is all that comes
          must(message.size() == stream.size, "it has its size");
          must(is_whole(message, head), "it is whole");
        },
        100ms);
  }
  if (received == 0 && stream.size > transport.arrives) return;  // outrun, each time
  must(received != 0, "something came");
  if (ended < stream.publishers && !transport.waits && transport.may_lose) return;  // lost the last
  must(ended == stream.publishers, "the last one of each came");
  ++progress->ended;
  if (stream.lossless && transport.waits) {
    must(received == std::uint64_t{kMessages} * stream.publishers, "none is lost");
  }
}

void run(const Transport& transport, Stream stream) {
  const std::string directory = "/dev/shm/" + unique_name();
  std::filesystem::create_directory(directory);
  stream.name = std::filesystem::path(directory).filename();
  stream.directory = directory;
  stream.address.assign(stream.publishers,
                        std::vector<std::string>(stream.subscribers, "127.0.0.1"));
  CAPTURE(transport.name);
  CAPTURE(stream.size);
  std::string refused = transport.refuses(stream);
  const Progress progress;
  std::unique_ptr<Service> service;
  if (refused.empty() && transport.serve) {
    try {
      service = transport.serve(stream);
    } catch (const std::exception&) {
      refused = transport.refuses(stream);  // somebody else's daemon came just before ours
      if (refused.empty()) throw;
    }
  }
  if (!refused.empty()) {
    MESSAGE(transport.name << ": " << refused);
  } else if (transport.threads) {
    Child process([&] {  // of their own: ROS begins once in a process
      std::vector<std::thread> nodes;
      for (unsigned s = 0; s < stream.subscribers; ++s)
        nodes.emplace_back([&, s] { subscribe(transport, stream, s, progress); });
      for (unsigned p = 0; p < stream.publishers; ++p)
        nodes.emplace_back([&, p] { publish(transport, stream, p, progress); });
      for (std::thread& node : nodes) node.join();
    });
    CHECK(process.wait() == 0);
  } else {
    std::vector<std::unique_ptr<Child>> nodes;
    for (unsigned s = 0; s < stream.subscribers; ++s)
      nodes.push_back(
          std::make_unique<Child>([&, s] { subscribe(transport, stream, s, progress); }));
    for (unsigned p = 0; p < stream.publishers; ++p)
      nodes.push_back(std::make_unique<Child>([&, p] { publish(transport, stream, p, progress); }));
    for (auto& node : nodes) CHECK(node->wait() == 0);
  }
  service.reset();
  std::filesystem::remove_all(directory);
  for (const auto& entry : std::filesystem::directory_iterator("/dev/shm")) {
    const std::string name = entry.path().filename();
    CHECK_MESSAGE(name.find(stream.name) == std::string::npos, "left behind: " << name);
    if (name.find(stream.name) != std::string::npos) std::filesystem::remove_all(entry.path());
  }
}

/// How many pairs of a transport and a stream there are for each one that is run.
unsigned shares() {
  constexpr unsigned kMost = 4;
  const char* said = std::getenv("LOT_TEST_ONE_IN");
  const unsigned one_in =
      said != nullptr ? static_cast<unsigned>(std::strtoul(said, nullptr, 10)) : 1;
  return std::clamp(one_in, 1U, kMost);
}

/// LOT_AB_TRANSPORT: that one only. LOT_TEST_ONE_IN: a share of the pairs with what f() does,
/// another one with each seed.
template <class F>
void each_transport(F&& f) {
  static std::uint64_t pair = 0;
  const lot::testing::Share share(shares());
  const char* only = std::getenv("LOT_AB_TRANSPORT");
  for (const Transport& transport : transports()) {
    if (!transport.delivers || (only != nullptr && transport.name != only)) continue;
    if (only == nullptr && !share.has(pair++)) continue;
    f(transport);
  }
}

}  // namespace

TEST_CASE("every transport delivers whole messages in order, at every size") {
  const Watchdog watchdog{600};
  for (const std::size_t size : {std::size_t{128}, std::size_t{5000}, std::size_t{1} << 20}) {
    each_transport([size](const Transport& t) {
      Stream stream;
      stream.size = size;
      stream.subscribers = 2;
      run(t, stream);
      if (t.arrives >= stream.size) return;
      stream.size = std::max<std::size_t>(t.arrives, 128);  // its own largest
      run(t, stream);
    });
  }
}

TEST_CASE("every transport serves several publishers, and every way to wait") {
  const Watchdog watchdog{600};
  for (const Wait wait : {Wait::Spin, Wait::Adaptive, Wait::Park}) {
    each_transport([wait](const Transport& t) {
      Stream stream;
      stream.size = 4096;
      stream.publishers = 3;
      stream.wait = wait;
      run(t, stream);
    });
  }
}

TEST_CASE("a transport that can wait for slow subscribers loses nothing") {
  const Watchdog watchdog{600};
  for (const unsigned pool : {0U, 8U}) {
    each_transport([pool](const Transport& t) {
      Stream stream;
      stream.size = 64 << 10;
      stream.pool = pool;
      stream.depth = 8;
      stream.lossless = true;
      run(t, stream);
    });
  }
}
