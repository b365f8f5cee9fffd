// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <map>
#include <mutex>
#include <new>
#include <thread>
#include <utility>

#include "transport.hpp"

/// Threads of one process: a std::shared_ptr to the message goes through a queue for each
/// subscriber, under a mutex and a condition. As nodelets and intra-process publishing do it, and
/// nothing has a name outside the process.
namespace ab {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kLine = 64;
constexpr auto kSpinTime = 50us;  ///< of adaptive waiting: a little more than a wake-up costs
constexpr auto kBlockFor = 30s;   ///< a publisher waits so long for a slow subscriber
constexpr unsigned kPollsPerClock = 64;

class Message {
 public:
  explicit Message(std::size_t size)
      : bytes_(static_cast<std::byte*>(::operator new (size, std::align_val_t{kLine}))) {}
  ~Message() { ::operator delete (bytes_, std::align_val_t{kLine}); }
  Message(const Message&) = delete;
  Message& operator=(const Message&) = delete;
  std::byte* data() const { return bytes_; }

 private:
  std::byte* bytes_;  // not zeroed: it is filled next
};
using Pointer = std::shared_ptr<Message>;

/// A subscriber's queue.
struct Inbox {
  std::mutex mutex;
  std::condition_variable filled;
  std::condition_variable room;
  bool is_open = false;  ///< its subscriber is there; under the mutex
  std::deque<Pointer> messages;
  /// How many they are. Written under the mutex; whoever spins reads it without, and looks again
  /// under the mutex.
  std::atomic<std::size_t> count{0};
  std::uint64_t displaced = 0;  ///< by newer ones; under the mutex
};

struct Topic {
  explicit Topic(unsigned subscribers) : inboxes(subscribers) {}
  std::vector<Inbox> inboxes;
  std::atomic<unsigned> joined{0};  ///< subscribers that are there
};

/// The topic of this name, as long as one node has it.
std::shared_ptr<Topic> topic_of(const Stream& stream) {
  static std::mutex mutex;
  static std::map<std::string, std::weak_ptr<Topic>> topics;
  const std::lock_guard lock(mutex);
  std::erase_if(topics, [](const auto& entry) { return entry.second.expired(); });
  std::weak_ptr<Topic>& known = topics[stream.name];
  std::shared_ptr<Topic> topic = known.lock();
  if (!topic) known = topic = std::make_shared<Topic>(stream.subscribers);
  return topic;
}

class IntraSender final : public Sender {
 public:
  explicit IntraSender(const Stream& stream) : stream_(stream), topic_(topic_of(stream)) {
    for (unsigned i = 0; i < stream.pool; ++i) {
      pool_.push_back(std::make_shared<Message>(stream.size));
      std::memset(pool_.back()->data(), 0, stream.size);  // touched
    }
  }

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = std::chrono::steady_clock::now() + patience;
    while (topic_->joined.load(std::memory_order_acquire) < subscribers) {
      if (std::chrono::steady_clock::now() >= until) return false;
      std::this_thread::sleep_for(1ms);
    }
    return true;
  }
  std::byte* loan() override {
    if (!message_) message_ = next();
    return message_->data();
  }
  bool push() override {
    for (Inbox& inbox : topic_->inboxes) put(inbox);
    message_.reset();
    return true;
  }

 private:
  /// One of the pool that nobody else has; a new one where there is no pool, or it is all in use.
  Pointer next() {
    for (std::size_t i = 0; i < pool_.size(); ++i) {
      const Pointer& message = pool_[turn_++ % pool_.size()];
      if (message.use_count() != 1) continue;
      std::atomic_thread_fence(std::memory_order_acquire);  // readers have done
      return message;
    }
    return std::make_shared<Message>(stream_.size);
  }
  void put(Inbox& inbox) {
    Pointer oldest;  // dies after the lock is given back
    {
      std::unique_lock lock(inbox.mutex);
      const auto has_room = [&] { return !inbox.is_open || inbox.messages.size() < stream_.depth; };
      if (!has_room() && !(stream_.lossless && inbox.room.wait_for(lock, kBlockFor, has_room))) {
        oldest = std::move(inbox.messages.front());
        inbox.messages.pop_front();
        ++inbox.displaced;
      }
      if (!inbox.is_open) return;
      inbox.messages.push_back(message_);
      inbox.count.store(inbox.messages.size(), std::memory_order_release);
    }
    inbox.filled.notify_one();
  }

  const Stream stream_;
  const std::shared_ptr<Topic> topic_;
  std::vector<Pointer> pool_;
  std::size_t turn_ = 0;
  Pointer message_;  ///< on loan
};

class IntraReceiver final : public Receiver {
 public:
  IntraReceiver(const Stream& stream, unsigned subscriber)
      : stream_(stream), topic_(topic_of(stream)), inbox_(topic_->inboxes[subscriber]) {
    const std::lock_guard lock(inbox_.mutex);
    inbox_.is_open = true;
    topic_->joined.fetch_add(1, std::memory_order_release);
  }
  ~IntraReceiver() override {
    const std::lock_guard lock(inbox_.mutex);
    inbox_.is_open = false;
    inbox_.messages.clear();
    inbox_.room.notify_all();
    topic_->joined.fetch_sub(1, std::memory_order_relaxed);
  }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    const auto begin = std::chrono::steady_clock::now();
    if (stream_.wait != Wait::Park && !spin(begin, patience)) return false;
    Pointer message;
    {
      std::unique_lock lock(inbox_.mutex);
      const auto is_filled = [&] { return !inbox_.messages.empty(); };
      if (patience < 0ns) {
        inbox_.filled.wait(lock, is_filled);
      } else if (!inbox_.filled.wait_until(lock, begin + patience, is_filled)) {
        return false;
      }
      message = std::move(inbox_.messages.front());
      inbox_.messages.pop_front();
      inbox_.count.store(inbox_.messages.size(), std::memory_order_relaxed);
    }
    if (stream_.lossless) inbox_.room.notify_all();
    handler({message->data(), stream_.size});
    return true;
  }
  std::uint64_t missed() const override {
    const std::lock_guard lock(inbox_.mutex);
    return inbox_.displaced;
  }

 private:
  /// Polls until there is a message, or, when adaptive, it is time to sleep. False: none came.
  bool spin(std::chrono::steady_clock::time_point begin, std::chrono::nanoseconds patience) const {
    for (unsigned polls = 1; inbox_.count.load(std::memory_order_acquire) == 0; ++polls) {
      if (polls % kPollsPerClock != 0) continue;
      const auto waited = std::chrono::steady_clock::now() - begin;
      if (stream_.wait == Wait::Adaptive && waited >= kSpinTime) return true;
      if (patience >= 0ns && waited >= patience) return false;
    }
    return true;
  }

  const Stream stream_;
  const std::shared_ptr<Topic> topic_;
  Inbox& inbox_;
};

}  // namespace

std::vector<Transport> intra_transports() {
  Transport t;
  t.name = "intra";
  t.about = "threads of one process: std::shared_ptr in a queue under mutex and condition";
  t.threads = true;
  t.refuses = [](const Stream& stream) -> std::string {
    if (stream.isolated) return "its nodes are threads of one process; set --place host";
    return "";
  };
  t.sender = [](const Stream& stream, unsigned) { return std::make_unique<IntraSender>(stream); };
  t.receiver = [](const Stream& stream, unsigned subscriber) {
    return std::make_unique<IntraReceiver>(stream, subscriber);
  };
  return {std::move(t)};
}

}  // namespace ab
