// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include <boost/circular_buffer.hpp>
#include <boost/date_time/posix_time/posix_time_types.hpp>
#include <boost/interprocess/containers/vector.hpp>
#include <boost/interprocess/managed_mapped_file.hpp>
#include <boost/interprocess/managed_shared_memory.hpp>
#include <boost/interprocess/smart_ptr/shared_ptr.hpp>
#include <boost/interprocess/sync/interprocess_condition.hpp>
#include <boost/interprocess/sync/interprocess_mutex.hpp>
#include <boost/interprocess/sync/scoped_lock.hpp>

#include "transport.hpp"

/// The stack of 2021, as the paper describes it, written anew over Boost.Interprocess.
///
/// One managed segment for all; for each publisher and subscriber a named circular queue of shared
/// pointers, under an interprocess_mutex and an interprocess_condition; an engine thread that puts
/// messages, queue after queue; and a puller, here the harness's own thread in receive().
/// lot2021-direct does without the engine thread, and so without a hand-over: a better rival.
///
/// Where a subscriber has several publishers its queues share the mutex and the condition, so that
/// one thread can wait for all of them.
///
/// Crash: a node that is killed while it holds a mutex leaves it locked for ever, and what it held
/// stays allocated; the segment is all that stays, and it bears the stream's name.
namespace ab {
namespace {

using namespace std::chrono_literals;
namespace bip = boost::interprocess;

// Boost 1.74 has pthread's mutex and condition here, in their process-shared form. Where it has
// not, it emulates them by spinning, which would be no rival.
#if !defined(BOOST_INTERPROCESS_POSIX_PROCESS_SHARED) || \
    defined(BOOST_INTERPROCESS_FORCE_GENERIC_EMULATION)
#error "Boost.Interprocess emulates mutexes and conditions here"
#endif

constexpr std::size_t kLine = 64;
constexpr std::size_t kPage = 4096;
constexpr auto kLimit = 100ms;  // of one wait of the puller
constexpr unsigned kWarm = 8;   // messages made once before the first, where there is no pool

using Manager = bip::managed_shared_memory::segment_manager;
template <class T>
using Allocator = bip::allocator<T, Manager>;

/// Its pixels are zeros when it is made.
class Message {
 public:
  Message(std::size_t size, Manager* manager) : pixels_(size + kLine, manager) {}
  std::byte* data() {  // the same line in every process: segments begin at pages
    const auto at = reinterpret_cast<std::uintptr_t>(pixels_.data());
    return reinterpret_cast<std::byte*>(pixels_.data()) + (kLine - at % kLine) % kLine;
  }

 private:
  bip::vector<unsigned char, Allocator<unsigned char>> pixels_;
};
using Pointer = bip::managed_shared_ptr<Message, bip::managed_shared_memory>::type;

/// What waits for one subscriber of one publisher. Under the Inbox's mutex.
struct Queue {
  Queue(std::size_t depth, Manager* manager) : messages(depth, Allocator<Pointer>(manager)) {}
  boost::circular_buffer<Pointer, Allocator<Pointer>> messages;
  /// Written by the publisher under the mutex; read at any time, for figures.
  std::atomic<std::uint64_t> overwritten{0};
};

/// A subscriber, as publishers see it.
struct Inbox {
  bip::interprocess_mutex mutex;
  bip::interprocess_condition condition;
  /// Set by the subscriber (release) while it has its queues; else nothing is put.
  std::atomic<bool> joined{false};
};

/// Where a publisher's messages lie, once it has touched them; a subscriber then touches them too.
struct Extent {
  std::atomic<std::uint64_t> begin{0};  ///< offset in the segment
  std::atomic<std::uint64_t> end{0};    ///< stored last (release); 0: not yet
};

std::string name_of(const Stream& stream) { return stream.name + "-lot2021"; }

/// The segment: Boost's own place for it, /dev/shm; or the directory that containers share.
class Segment {
 public:
  explicit Segment(const Stream& stream) {
    if (stream.isolated) {
      file_.emplace(bip::open_or_create, (stream.directory + "/" + name_of(stream)).c_str(),
                    bytes_of(stream));
    } else {
      memory_.emplace(bip::open_or_create, name_of(stream).c_str(), bytes_of(stream));
    }
  }
  Manager* manager() {
    return file_ ? file_->get_segment_manager() : memory_->get_segment_manager();
  }
  std::byte* base() {
    return static_cast<std::byte*>(file_ ? file_->get_address() : memory_->get_address());
  }

  template <class T, class... Arguments>
  T& named(const std::string& name, Arguments&&... arguments) {
    return *manager()->find_or_construct<T>(name.c_str())(std::forward<Arguments>(arguments)...);
  }
  Inbox& inbox(unsigned subscriber) { return named<Inbox>("inbox-" + std::to_string(subscriber)); }
  Queue& queue(const Stream& stream, unsigned publisher, unsigned subscriber) {
    return named<Queue>("queue-" + std::to_string(publisher) + "-" + std::to_string(subscriber),
                        stream.depth, manager());
  }
  Extent& extent(unsigned publisher) {
    return named<Extent>("extent-" + std::to_string(publisher));
  }

 private:
  /// Room for what can be alive at once: it is taken from the system when it is first touched.
  static std::size_t bytes_of(const Stream& stream) {
    const std::size_t alive = 2 * std::size_t{stream.depth} + stream.subscribers + kWarm;
    const std::size_t message = stream.size + kLine + sizeof(Message) + 256;
    const std::size_t queues = stream.subscribers * (stream.depth * sizeof(Pointer) + 512);
    return (1 << 20) + stream.publishers * ((stream.pool + alive) * message * 9 / 8 + queues);
  }

  std::optional<bip::managed_shared_memory> memory_;
  std::optional<bip::managed_mapped_file> file_;
};

/// Takes the segment away when the nodes have gone.
class Removal final : public Service {
 public:
  explicit Removal(std::string name) : name_(std::move(name)) {}
  ~Removal() override { bip::shared_memory_object::remove(name_.c_str()); }

 private:
  std::string name_;
};

enum class Puts { Engine, Caller };

class Sender2021 final : public Sender {
 public:
  Sender2021(const Stream& stream, unsigned publisher, Puts who)
      : stream_(stream), who_puts_(who), segment_(stream) {
    for (unsigned s = 0; s < stream.subscribers; ++s) {
      readers_.push_back({&segment_.inbox(s), &segment_.queue(stream, publisher, s)});
    }
    warm(segment_.extent(publisher));
    if (who_puts_ == Puts::Engine) engine_ = std::thread([this] { run(); });
  }
  ~Sender2021() override {
    {
      const std::lock_guard lock(mutex_);
      ended_ = true;
    }
    changed_.notify_all();
    if (engine_.joinable()) engine_.join();
  }

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    const auto until = std::chrono::steady_clock::now() + patience;
    const auto joined = [this] {
      return std::count_if(readers_.begin(), readers_.end(), [](const Reader& r) {
        return r.inbox->joined.load(std::memory_order_acquire);
      });
    };
    while (joined() < static_cast<std::ptrdiff_t>(subscribers)) {
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
    if (who_puts_ == Puts::Caller) {
      put(message_);
    } else {
      std::unique_lock lock(mutex_);
      // The engine waits for nobody: what is waited for here is a core for it.
      room_.wait(lock, [this] { return handed_.size() < stream_.depth; });
      handed_.push_back(message_);
      lock.unlock();
      changed_.notify_one();
    }
    message_.reset();
    return true;
  }

 private:
  struct Reader {
    Inbox* inbox;
    Queue* queue;
  };

  Pointer make() {
    Manager* const manager = segment_.manager();
    return bip::make_managed_shared_ptr(
        manager->construct<Message>(bip::anonymous_instance)(stream_.size, manager), *manager);
  }
  /// One of the pool that nobody else has; a new one where there is no pool, or it is all in use.
  Pointer next() {
    for (std::size_t i = 0; i < pool_.size(); ++i) {
      Pointer& message = pool_[turn_++ % pool_.size()];
      if (message.use_count() != 1) continue;
      std::atomic_thread_fence(std::memory_order_acquire);  // readers have done
      return message;
    }
    return make();
  }
  void warm(Extent& extent) {
    std::uint64_t begin = UINT64_MAX;
    std::uint64_t end = 0;
    for (unsigned i = 0; i < (stream_.pool != 0 ? stream_.pool : kWarm); ++i) {
      pool_.push_back(make());
      const auto at = static_cast<std::uint64_t>(pool_.back()->data() - segment_.base());
      begin = std::min(begin, at);
      end = std::max(end, at + stream_.size);
    }
    if (stream_.pool == 0) pool_.clear();
    extent.begin.store(begin, std::memory_order_relaxed);
    extent.end.store(end, std::memory_order_release);
  }

  void run() {
    std::unique_lock lock(mutex_);
    for (;;) {
      changed_.wait(lock, [this] { return ended_ || !handed_.empty(); });
      if (handed_.empty()) return;
      const Pointer message = std::move(handed_.front());
      handed_.pop_front();
      const bool was_full = handed_.size() + 1 == stream_.depth;
      lock.unlock();
      if (was_full) room_.notify_one();
      put(message);
      lock.lock();
    }
  }
  void put(const Pointer& message) {
    for (const Reader& reader : readers_) {
      if (!reader.inbox->joined.load(std::memory_order_acquire)) continue;
      Pointer oldest;  // dies after the lock is given back
      {
        const bip::scoped_lock lock(reader.inbox->mutex);
        auto& messages = reader.queue->messages;
        if (messages.full()) {
          oldest.swap(messages.front());
          messages.pop_front();
          reader.queue->overwritten.fetch_add(1, std::memory_order_relaxed);
        }
        messages.push_back(message);
      }
      reader.inbox->condition.notify_all();
    }
  }

  const Stream stream_;
  const Puts who_puts_;
  Segment segment_;
  std::vector<Reader> readers_;
  std::vector<Pointer> pool_;
  std::size_t turn_ = 0;
  Pointer message_;  ///< on loan

  // The hand-over to the engine thread.
  std::mutex mutex_;
  std::condition_variable changed_;
  std::condition_variable room_;
  std::deque<Pointer> handed_;
  bool ended_ = false;
  std::thread engine_;
};

class Receiver2021 final : public Receiver {
 public:
  Receiver2021(const Stream& stream, unsigned subscriber)
      : stream_(stream), segment_(stream), inbox_(segment_.inbox(subscriber)) {
    for (unsigned p = 0; p < stream.publishers; ++p) {
      queues_.push_back(&segment_.queue(stream, p, subscriber));
      cold_.push_back(&segment_.extent(p));
    }
    touch();
    inbox_.joined.store(true, std::memory_order_release);
  }
  ~Receiver2021() override { inbox_.joined.store(false, std::memory_order_relaxed); }

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    const auto begin = std::chrono::steady_clock::now();
    if (!cold_.empty()) touch();
    bip::scoped_lock lock(inbox_.mutex);
    for (;;) {
      for (std::size_t n = 0; n < queues_.size(); ++n) {
        auto& messages = queues_[turn_++ % queues_.size()]->messages;
        if (messages.empty()) continue;
        Pointer message;
        message.swap(messages.front());
        messages.pop_front();
        lock.unlock();
        handler({message->data(), stream_.size});
        return true;
      }
      std::chrono::nanoseconds limit = kLimit;
      if (patience >= 0ns) {
        limit = std::min(limit, begin + patience - std::chrono::steady_clock::now());
        if (limit <= 0ns) return false;
      }
      inbox_.condition.timed_wait(
          lock, boost::posix_time::microsec_clock::universal_time() +
                    boost::posix_time::microseconds(std::max<std::int64_t>(limit / 1us, 1)));
    }
  }
  std::uint64_t missed() const override {
    std::uint64_t sum = 0;
    for (const Queue* queue : queues_) sum += queue->overwritten.load(std::memory_order_relaxed);
    return sum;
  }

 private:
  /// Maps what publishers have prepared, before the first message does.
  void touch() {
    std::erase_if(cold_, [this](const Extent* extent) {
      const std::uint64_t end = extent->end.load(std::memory_order_acquire);
      const std::byte* const base = segment_.base();
      for (std::uint64_t at = extent->begin.load(std::memory_order_relaxed); at < end;
           at += kPage) {
        static_cast<void>(*static_cast<const volatile std::byte*>(base + at));
      }
      return end != 0;
    });
  }

  const Stream stream_;
  Segment segment_;
  Inbox& inbox_;
  std::vector<Queue*> queues_;
  std::vector<Extent*> cold_;
  std::size_t turn_ = 0;
};

Transport transport_of(std::string name, std::string about, Puts who) {
  Transport t;
  t.name = std::move(name);
  t.about = std::move(about);
  t.waits = false;
  t.refuses = [](const Stream& stream) -> std::string {
    if (stream.wait == Wait::Spin) return "sleeps on a condition; set --wait park or adaptive";
    return "";
  };
  t.serve = [](const Stream& stream) { return std::make_unique<Removal>(name_of(stream)); };
  t.sender = [who](const Stream& stream, unsigned publisher) {
    return std::make_unique<Sender2021>(stream, publisher, who);
  };
  t.receiver = [](const Stream& stream, unsigned subscriber) {
    return std::make_unique<Receiver2021>(stream, subscriber);
  };
  return t;
}

}  // namespace

std::vector<Transport> lot2021_transports() {
  return {
      transport_of("lot2021",
                   "the stack of 2021: Boost.Interprocess 1.74, shared pointers in queues under "
                   "mutex and condition",
                   Puts::Engine),
      transport_of("lot2021-direct", "the same without its engine thread: push() puts",
                   Puts::Caller),
  };
}

}  // namespace ab
