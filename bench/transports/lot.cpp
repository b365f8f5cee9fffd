// SPDX-License-Identifier: Apache-2.0
#include "lot/lot.hpp"

#include <algorithm>
#include <array>
#include <optional>
#include <type_traits>
#include <utility>

#include "transport.hpp"

/// LOT itself: both engines, and both ways to read.
namespace ab {
namespace {

using namespace std::chrono_literals;

/// Small messages are one plain object, as users would declare them; large ones grow a vector.
template <std::size_t N>
struct Plain {
  std::array<std::byte, N> bytes;
};
struct Frame {
  lot::ShmVector<std::byte> bytes;
};
constexpr std::size_t kLargestInSlot = 128;
constexpr std::size_t kLargestPlain = 4096;
/// Messages come back to the publisher in batches of so many, or of so many bytes.
constexpr std::size_t kBatch = 32;
constexpr std::size_t kBatchedBytes = 256 << 10;

/// Calls f with the message type of this size.
template <class F>
auto with_message_of(std::size_t size, F&& f) {
  if (size <= kLargestInSlot) return f(std::type_identity<Plain<kLargestInSlot>>());
  if (size <= 512) return f(std::type_identity<Plain<512>>());
  if (size <= kLargestPlain) return f(std::type_identity<Plain<kLargestPlain>>());
  return f(std::type_identity<Frame>());
}

enum class Read { Keep, Borrow };
/// How LOT carries a message.
struct Way {
  lot::QueueEngine queue = lot::QueueEngine::Ring;
  Read read = Read::Keep;
  bool in_slots = false;
};

/// Messages that one publisher has in memory: in the queue, at hand, and on their way home.
std::size_t prepared(const Stream& stream) {
  const std::size_t batch = std::min(kBatch, kBatchedBytes / std::max<std::size_t>(stream.size, 1));
  return stream.depth + 4 + 3 * batch;
}

lot::EngineOptions engine_options(const Stream& stream) {
  lot::EngineOptions options;
  options.segment = stream.name;
  options.directory = stream.directory;
  // What waits in the queues, what subscribers hold, and batches of blocks that are on their way
  // home.
  const std::size_t messages = prepared(stream) * stream.publishers + stream.subscribers + 160;
  options.size_bytes = (64 << 20) + 2 * stream.publishers * messages * 512 +
                       messages * ((stream.size + 4095) / 4096 * 4096 + 4096);
  return options;
}

template <class T>
class LotSender final : public Sender {
 public:
  LotSender(const Stream& stream, const Way& way)
      : size_(stream.size), engine_(engine_options(stream)), pusher_(advertise(stream, way)) {
    // First touch belongs to the start, not to the figures.
    pusher_.reserve(prepared(stream), stream.size);
  }

  bool wait_for_subscribers(unsigned subscribers, std::chrono::nanoseconds patience) override {
    return pusher_.wait_for_readers(subscribers, patience);
  }
  std::byte* loan() override {
    if (!message_) {
      message_ = pusher_.loan();
      if constexpr (std::is_same_v<T, Frame>) message_->bytes.resize(size_);
    }
    return message_->bytes.data();
  }
  bool push() override {
    if (pusher_.push(std::move(message_)) == lot::Status::Ok) return true;
    message_.reset();
    return false;
  }

 private:
  lot::ShmPusher<T> advertise(const Stream& stream, const Way& way) {
    lot::PusherOptions options;
    options.policy = stream.lossless ? lot::Policy::Block : lot::Policy::Overwrite;
    options.depth = stream.depth;
    options.block_for = 30s;
    options.engine = way.queue;
    options.fast_lane = way.in_slots;
    return engine_.advertise<T>("/ab", options);
  }

  std::size_t size_;
  lot::ShmEngine engine_;
  lot::ShmPusher<T> pusher_;
  lot::ShmUniquePtr<T> message_;
};

template <class T>
class LotReceiver final : public Receiver {
 public:
  LotReceiver(const Stream& stream, Read read)
      : read_(read),
        size_(stream.size),
        engine_(engine_options(stream)),
        puller_(subscribe(stream)) {}

  bool receive(const Handler& handler, std::chrono::nanoseconds patience) override {
    if (read_ == Read::Borrow) {
      const auto message = patience < 0ns ? puller_.borrow() : puller_.borrow(patience);
      if (message) handler({message->bytes.data(), size_});
      return static_cast<bool>(message);
    }
    const auto message = patience < 0ns ? puller_.pull() : puller_.pull(patience);
    if (message) handler({message->bytes.data(), size_});
    return static_cast<bool>(message);
  }
  std::uint64_t missed() const override { return puller_.missed_total(); }

 private:
  lot::ShmPuller<T> subscribe(const Stream& stream) {
    lot::PullerOptions options;
    options.wait = stream.wait == Wait::Spin   ? lot::Wait::Spin
                   : stream.wait == Wait::Park ? lot::Wait::Park
                                               : lot::Wait::Adaptive;
    return engine_.subscribe<T>("/ab", options);
  }

  Read read_;
  std::size_t size_;
  lot::ShmEngine engine_;
  lot::ShmPuller<T> puller_;
};

Transport lot_transport(std::string name, std::string about, const Way& way) {
  Transport t;
  t.name = std::move(name);
  t.about = std::move(about);
  t.refuses = [way](const Stream& stream) {
    return std::string(way.in_slots && stream.size > kLargestInSlot ? "only up to 128 B" : "");
  };
  t.sender = [way](const Stream& stream, unsigned) {
    return with_message_of(stream.size, [&](auto type) -> std::unique_ptr<Sender> {
      return std::make_unique<LotSender<typename decltype(type)::type>>(stream, way);
    });
  };
  t.receiver = [way](const Stream& stream, unsigned) {
    return with_message_of(stream.size, [&](auto type) -> std::unique_ptr<Receiver> {
      return std::make_unique<LotReceiver<typename decltype(type)::type>>(stream, way.read);
    });
  };
  return t;
}

}  // namespace

std::vector<Transport> lot_transports() {
  return {
      lot_transport("ring", "LOT: lock-free ring, each message kept by a smart pointer", {}),
      lot_transport("ring-borrow", "LOT: lock-free ring, each message borrowed for the callback",
                    {.read = Read::Borrow}),
      lot_transport("slots", "LOT: as ring, and the message travels in its slot",
                    {.in_slots = true}),
      lot_transport("slots-borrow", "LOT: as ring-borrow, and the message travels in its slot",
                    {.read = Read::Borrow, .in_slots = true}),
      lot_transport("mutex", "LOT: the queue under a robust mutex",
                    {.queue = lot::QueueEngine::Mutex}),
  };
}

}  // namespace ab
