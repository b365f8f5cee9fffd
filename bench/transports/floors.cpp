// SPDX-License-Identifier: Apache-2.0
#include <atomic>
#include <climits>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <linux/futex.h>
#include <sched.h>
#include <stdexcept>
#include <string>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include "transport.hpp"

/// What nobody can beat: a cache line from core to core; the same with a futex; and pacing alone.
///
/// A publisher fills as large a message as the others, in memory of its own, and hands over one
/// line of it, the head: what a subscriber gets to see is these bytes alone.
namespace ab {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kLine = 64;
constexpr std::size_t kHead = 56;
constexpr std::uint64_t kSlots = 64;
constexpr unsigned kMostSubscribers = 64;
constexpr unsigned kMostPublishers = 64;

struct alignas(2 * kLine) Slot {  // of its own also for a prefetcher of neighbours
  std::atomic<std::uint64_t> sequence{0};
  std::atomic<std::uint64_t> words[kHead / 8];
};
struct alignas(2 * kLine) Word {
  std::atomic<std::uint64_t> value{0};
};
struct Lane {  // of a publisher
  Word heads[kMostSubscribers];
  Slot slots[kSlots];
};
struct Page {  // zeros are its first state
  alignas(2 * kLine) std::atomic<std::uint32_t> changes;
  alignas(2 * kLine) std::atomic<std::uint32_t> subscribers;
  alignas(2 * kLine) std::atomic<std::uint32_t> asleep;
  Lane lanes[kMostPublishers];
};

class Mapping {
 public:
  explicit Mapping(const std::string& path) {
    const int fd = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0) throw std::system_error(errno, std::generic_category(), path);
    if (ftruncate(fd, sizeof(Page)) != 0 ||
        (page_ = mmap(nullptr, sizeof(Page), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd,
                      0)) == MAP_FAILED) {
      const int error = errno;
      close(fd);
      throw std::system_error(error, std::generic_category(), path);
    }
    close(fd);
  }
  ~Mapping() { munmap(page_, sizeof(Page)); }
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  Page* operator->() const { return static_cast<Page*>(page_); }

 private:
  void* page_ = nullptr;
};

std::string path_of(const Stream& stream) {
  return stream.directory + "/" + stream.name + "-floor";
}

long futex(std::atomic<std::uint32_t>& word, int op, std::uint32_t value, const timespec* limit) {
  return syscall(SYS_futex, &word, op, value, limit, nullptr, 0);
}

/// Where a floor's messages are filled: as many and of the same kind of memory as a queue's, so
/// that filling costs the same.
class Buffers {
 public:
  explicit Buffers(const Stream& stream)
      : each_((stream.size + kPage - 1) / kPage * kPage),
        count_(stream.filled ? stream.depth + 1 : 1) {
    at_ = mmap(nullptr, each_ * count_, PROT_READ | PROT_WRITE,
               MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE, -1, 0);
    if (at_ == MAP_FAILED) throw std::system_error(errno, std::generic_category(), "mmap");
  }
  ~Buffers() { munmap(at_, each_ * count_); }
  Buffers(const Buffers&) = delete;
  Buffers& operator=(const Buffers&) = delete;
  std::byte* get() const { return static_cast<std::byte*>(at_) + next_ * each_; }
  void turn() { next_ = (next_ + 1) % count_; }

 private:
  static constexpr std::size_t kPage = 4096;
  void* at_ = nullptr;
  std::size_t each_;
  std::size_t count_;
  std::size_t next_ = 0;
};

class FloorSender final : public Sender {
 public:
  FloorSender(const Stream& stream, unsigned publisher, bool sleeps)
      : stream_(stream),
        sleeps_(sleeps),
        page_(path_of(stream)),
        lane_(page_->lanes[publisher]),
        messages_(stream) {}

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = std::chrono::steady_clock::now() + patience;
    while (page_->subscribers.load(std::memory_order_acquire) < subscribers) {
      if (std::chrono::steady_clock::now() >= until) return false;
      std::this_thread::sleep_for(1ms);
    }
    return true;
  }
  std::byte* loan() override { return messages_.get(); }
  bool push() override {
    if (stream_.lossless) wait_for_room();
    Slot& slot = lane_.slots[next_ % kSlots];
    slot.sequence.store(0, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
    std::uint64_t words[kHead / 8];
    std::memcpy(words, messages_.get(), kHead);
    messages_.turn();
    for (std::size_t i = 0; i < kHead / 8; ++i) {
      slot.words[i].store(words[i], std::memory_order_relaxed);
    }
    slot.sequence.store(++next_, std::memory_order_release);
    if (sleeps_) {
      // Sequentially consistent, here and there: either we see the sleeper, or it sees the change.
      page_->changes.fetch_add(1);
      if (page_->asleep.load() != 0) futex(page_->changes, FUTEX_WAKE, INT_MAX, nullptr);
    }
    return true;
  }

 private:
  void wait_for_room() {
    if (next_ < known_ + kSlots) return;
    for (unsigned s = 0; s < stream_.subscribers; ++s) {
      while (lane_.heads[s].value.load(std::memory_order_acquire) + kSlots <= next_) {
        if (sleeps_) sched_yield();
      }
    }
    known_ = next_;
    for (unsigned s = 0; s < stream_.subscribers; ++s) {
      known_ = std::min(known_, lane_.heads[s].value.load(std::memory_order_acquire));
    }
  }

  const Stream stream_;
  const bool sleeps_;
  Mapping page_;
  Lane& lane_;
  Buffers messages_;
  std::uint64_t next_ = 0;   ///< messages so far
  std::uint64_t known_ = 0;  ///< what every subscriber has read
};

class FloorReceiver final : public Receiver {
 public:
  FloorReceiver(const Stream& stream, unsigned subscriber, bool sleeps)
      : publishers_(stream.publishers),
        me_(subscriber),
        sleeps_(sleeps),
        page_(path_of(stream)),
        next_(stream.publishers, 0) {
    page_->subscribers.fetch_add(1, std::memory_order_release);
  }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    const auto begin = std::chrono::steady_clock::now();
    for (unsigned looks = 0;; ++looks) {
      const std::uint32_t seen = page_->changes.load(std::memory_order_acquire);
      for (unsigned n = 0; n < publishers_; ++n) {
        if (take(turn_++ % publishers_, handler)) return true;
      }
      if (!sleeps_ && looks % 256 != 255) continue;  // looks at the clock now and then
      if (patience >= 0ns && std::chrono::steady_clock::now() - begin >= patience) return false;
      if (!sleeps_) continue;
      const auto ns = patience < 0ns ? 1s : patience;
      const timespec limit{static_cast<time_t>(ns / 1s), static_cast<long>((ns % 1s).count())};
      page_->asleep.fetch_add(1);
      if (page_->changes.load() == seen) futex(page_->changes, FUTEX_WAIT, seen, &limit);
      page_->asleep.fetch_sub(1);
    }
  }
  std::uint64_t missed() const override { return missed_; }

 private:
  bool take(unsigned publisher, const Handler& handler) {
    Lane& lane = page_->lanes[publisher];
    std::uint64_t& next = next_[publisher];
    Slot& slot = lane.slots[next % kSlots];
    const std::uint64_t sequence = slot.sequence.load(std::memory_order_acquire);
    if (sequence <= next) return false;  // also while it is written
    std::uint64_t words[kHead / 8];
    for (std::size_t i = 0; i < kHead / 8; ++i) {
      words[i] = slot.words[i].load(std::memory_order_relaxed);
    }
    std::atomic_thread_fence(std::memory_order_acquire);
    if (slot.sequence.load(std::memory_order_relaxed) != sequence) return false;
    missed_ += sequence - 1 - next;
    next = sequence;
    lane.heads[me_].value.store(next, std::memory_order_release);
    handler({reinterpret_cast<const std::byte*>(words), kHead});
    return true;
  }

  const unsigned publishers_;
  const unsigned me_;
  const bool sleeps_;
  Mapping page_;
  std::vector<std::uint64_t> next_;
  unsigned turn_ = 0;
  std::uint64_t missed_ = 0;
};

/// Fills, and sends nothing.
class PaceSender final : public Sender {
 public:
  explicit PaceSender(const Stream& stream) : messages_(stream) {}
  bool wait_for_subscribers(unsigned, std::chrono::nanoseconds) override { return true; }
  std::byte* loan() override { return messages_.get(); }
  bool push() override {
    messages_.turn();
    return true;
  }

 private:
  Buffers messages_;
};

class PaceReceiver final : public Receiver {
 public:
  bool receive(const Handler&, std::chrono::nanoseconds patience) override {
    std::this_thread::sleep_for(patience < 0ns ? 1s : patience);
    return false;
  }
};

Transport floor(std::string name, std::string about, bool sleeps) {
  Transport t;
  t.name = std::move(name);
  t.about = std::move(about);
  t.is_floor = true;
  t.refuses = [](const Stream& stream) -> std::string {
    if (stream.publishers > kMostPublishers || stream.subscribers > kMostSubscribers) {
      return "knows 64 publishers and 64 subscribers at most";
    }
    return "";
  };
  t.sender = [sleeps](const Stream& s, unsigned publisher) {
    return std::make_unique<FloorSender>(s, publisher, sleeps);
  };
  t.receiver = [sleeps](const Stream& s, unsigned subscriber) {
    return std::make_unique<FloorReceiver>(s, subscriber, sleeps);
  };
  return t;
}

}  // namespace

std::vector<Transport> floor_transports() {
  Transport pace;
  pace.name = "floor-pace";
  pace.about = "pacing and filling alone: nothing is sent";
  pace.is_floor = true;
  pace.delivers = false;
  pace.refuses = [](const Stream&) { return std::string(); };
  pace.sender = [](const Stream& s, unsigned) { return std::make_unique<PaceSender>(s); };
  pace.receiver = [](const Stream&, unsigned) { return std::make_unique<PaceReceiver>(); };
  return {floor("floor-spin", "a cache line, both ends spinning", false),
          floor("floor-futex", "a cache line and a futex, both ends asleep", true),
          std::move(pace)};
}

}  // namespace ab
