// SPDX-License-Identifier: Apache-2.0
#include "worker.hpp"

#include <array>
#include <chrono>
#include <cstddef>
#include <exception>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "lot/lot.hpp"

#include "chaos/random.hpp"
#include "tells.hpp"

namespace lot::replay {
namespace {

using namespace std::chrono_literals;
using chaos::Random;

/// A message of pieces: it travels in a block.
struct Frame {
  std::uint32_t channel = 0;
  std::uint32_t number = 0;
  ShmVector<std::uint64_t> words;
};
/// A small plain message: it travels in a slot, where the publisher lets it.
struct Letter {
  std::uint32_t channel;
  std::uint32_t number;
  std::uint64_t seal;
};

constexpr std::size_t kMostWords = 48;
constexpr std::size_t kKept = 3;
constexpr Duration kPatience = 100ms;  ///< of the virtual clock

std::uint64_t seal(std::uint32_t channel, std::uint32_t number) {
  return Random::mix(std::uint64_t{channel} << 32 | number);
}

void wrong(const std::string& what) {
  tell(Tell::Wrong, reinterpret_cast<std::uintptr_t>(what.data()), what.size());
}

void check(const Frame& frame, const char* when) {
  const std::uint64_t first = seal(frame.channel, frame.number);
  const std::size_t size = first % kMostWords;
  bool right = frame.words.size() == size;
  for (std::size_t i = 0; right && i < size; ++i) right = frame.words[i] == first + i;
  if (!right) wrong(std::string("a frame has the contents of no frame, ") + when);
}
void check(const Letter& letter, const char* when) {
  if (letter.seal != seal(letter.channel, letter.number))
    wrong(std::string("a letter has the contents of no letter, ") + when);
}
void fill(Frame& frame, std::uint32_t channel, std::uint32_t number) {
  frame.channel = channel;
  frame.number = number;
  const std::uint64_t first = seal(channel, number);
  frame.words.resize(first % kMostWords);
  for (std::size_t i = 0; i < frame.words.size(); ++i) frame.words[i] = first + i;
}
void fill(Letter& letter, std::uint32_t channel, std::uint32_t number) {
  letter = {channel, number, seal(channel, number)};
}

/// A publisher that counts what it publishes, from 1.
template <class T>
class Publisher {
 public:
  Publisher(ShmEngine& engine, const char* name, std::uint64_t topic, const PusherOptions& options)
      : channel_(static_cast<std::uint32_t>(tell(Tell::Advertise, topic, options.depth))),
        pusher_(engine.advertise<T>(name, options)) {}
  ~Publisher() { tell(Tell::Unadvertise, channel_); }
  Publisher(const Publisher&) = delete;
  Publisher& operator=(const Publisher&) = delete;

  void wait_for_reader() { (void)pusher_.wait_for_readers(1, 1s); }
  void push() {
    auto message = pusher_.try_loan();
    if (!message) return;
    fill(*message, channel_, number_);
    tell(Tell::Push, channel_, number_);
    const bool is_done = pusher_.push(std::move(message)) == Status::Ok;
    tell(Tell::Pushed, channel_, number_, is_done);
    number_ += is_done;
  }

 private:
  std::uint32_t channel_;
  std::uint32_t number_ = 1;
  ShmPusher<T> pusher_;
};

template <class T>
class Subscriber {
 public:
  Subscriber(ShmEngine& engine, const char* name, std::uint64_t topic, const PullerOptions& options)
      : reader_(static_cast<std::uint32_t>(tell(Tell::Subscribe, topic))),
        puller_(engine.subscribe<T>(name, options)) {
    tell(Tell::Subscribed, reader_);
  }
  ~Subscriber() { tell(Tell::Unsubscribe, reader_); }
  Subscriber(const Subscriber&) = delete;
  Subscriber& operator=(const Subscriber&) = delete;

  ShmSharedPtr<const T> pull(Duration most) {
    if (most != Duration()) tell(Tell::Wait, reader_);
    auto message = most == Duration() ? puller_.try_pull() : puller_.pull(most);
    if (message) {
      check(*message, "as it came");
      tell(Tell::Got, reader_, message->channel, message->number, puller_.missed_total());
    } else {
      tell(Tell::GotNone, reader_, puller_.missed_total());
    }
    return message;
  }
  /// A look in place. False: there was none.
  bool look() {
    auto borrow = puller_.try_borrow();
    if (!borrow) {
      tell(Tell::GotNone, reader_, puller_.missed_total());
      return false;
    }
    check(*borrow, "in a borrow");
    const std::uint32_t channel = borrow->channel, number = borrow->number;
    borrow.end();  // makes room: what is told has been done
    tell(Tell::Got, reader_, channel, number, puller_.missed_total());
    return true;
  }

 private:
  std::uint32_t reader_;
  ShmPuller<T> puller_;
};

EngineOptions options_of_segment(const Task& task) {
  EngineOptions options;
  options.segment = "replay";
  options.size_bytes = 12 << 20;
  options.name = "worker " + std::to_string(task.worker);
  options.processes = 7;
  options.blocks = 128;
  options.topics = 8;
  options.channels = 64;
  options.readers = 8;
  return options;
}

class Worker {
 public:
  explicit Worker(const Task& task)
      : task_(task),
        random_(Random::of(task.seed, task.worker, task.life)),
        lean_(Random::of(task.seed, 3).pick(3)),
        engine_(options_of_segment(task)),
        queue_(engine_.queue<Letter>("items", options_of_queue())),
        again_(engine_.advertise<Frame>("again", options_of(Policy::Overwrite, 2))) {
    open(frames_out_, "frames", kFrames, Policy::Overwrite);
    open(frames_in_, "frames", kFrames);
    if (writes_letters()) {
      open(letters_out_, "letters", kLetters, Policy::Block);
    } else {
      open(letters_in_, "letters", kLetters);
    }
  }

  void run() {
    if (task_.only_letters && letters_out_) letters_out_->wait_for_reader();
    for (unsigned n = 0; n < task_.operations; ++n) {
      tell(Tell::Operation);
      operate();
    }
    tell(Tell::Stage, Stage::Drain);
    // A look that does not wait may find a new publisher some milliseconds later only (try_pull()).
    while (frames_in_->pull(kPatience)) {
    }
    while (letters_in_ && letters_in_->pull(kPatience)) {
    }
    while (take(kPatience)) {
    }
    tell(Tell::Stage, Stage::Let_go);
    for (auto& message : kept_) let_go(message);
    frames_out_.reset();
    frames_in_.reset();
    letters_out_.reset();
    letters_in_.reset();
    again_.reset();
    queue_.reset();
    tell(Tell::Stage, Stage::Leave);
  }

 private:
  static QueueOptions options_of_queue() {
    QueueOptions options;
    options.depth = 3;
    return options;
  }
  static PusherOptions options_of(Policy policy, std::uint32_t depth) {
    PusherOptions options;
    options.policy = policy;
    options.depth = depth;
    options.block_for = 40ms;
    return options;
  }
  bool writes_letters() const { return task_.worker % 2 == 0; }

  template <class T>
  void open(std::optional<Publisher<T>>& out, const char* name, std::uint64_t topic,
            Policy policy) {
    out.reset();
    out.emplace(engine_, name, topic, options_of(policy, 1 + random_.pick(3)));
  }
  template <class T>
  void open(std::optional<Subscriber<T>>& in, const char* name, std::uint64_t topic) {
    in.reset();
    PullerOptions options;
    options.wait = random_.chance(50) ? Wait::Park : Wait::Adaptive;
    in.emplace(engine_, name, topic, options);
  }

  Duration some_time() { return random_.chance(30) ? Duration() : random_.between(1ms, 60ms); }

  /// Each run leans towards one kind of operations.
  void operate() {
    if (task_.only_letters) return pass_a_letter();
    const unsigned dice = random_.pick(100);
    if (random_.chance(60)) {
      if (lean_ == 0) return on_letters();
      if (lean_ == 1) return on_items();
    }
    if (dice < 30) {
      frames_out_->push();
    } else if (dice < 45) {
      keep(frames_in_->pull(some_time()));
    } else if (dice < 52) {
      frames_in_->look();
    } else if (dice < 72) {
      on_letters();
    } else if (dice < 92) {
      on_items();
    } else if (dice < 97) {
      publish_again();
    } else if (dice < 98) {
      open(frames_out_, "frames", kFrames, Policy::Overwrite);
    } else if (dice < 99) {
      open(frames_in_, "frames", kFrames);
    } else if (letters_out_) {
      open(letters_out_, "letters", kLetters, Policy::Block);
    }
  }
  /// Each push is pulled: the publisher waits for room, and the reader for a message.
  void pass_a_letter() {
    if (letters_out_) {
      letters_out_->push();
    } else {
      letters_in_->pull(60ms);
    }
  }
  void on_letters() {
    if (letters_out_) return letters_out_->push();
    if (random_.chance(50)) {
      letters_in_->look();
    } else {
      letters_in_->pull(some_time());
    }
  }
  void on_items() {
    if (random_.chance(45)) {
      take(some_time());
      return;
    }
    const auto number = static_cast<std::uint32_t>(items_ + 1);
    Letter letter;
    fill(letter, channel_of_items(), number);
    tell(Tell::Put, channel_of_items(), number);
    const bool is_done = queue_->put_for(letter, some_time()) == Status::Ok;
    tell(Tell::HasPut, channel_of_items(), number, is_done);
    items_ += is_done;
  }
  bool take(Duration most) {
    tell(Tell::Take, most != Duration());
    const auto item = queue_->wait_and_pop_for(most);
    if (!item) {
      tell(Tell::TookNone);
      return false;
    }
    check(*item, "as an item");
    tell(Tell::Took, item->channel, item->number);
    return true;
  }
  /// Each life puts items under a name of its own.
  std::uint32_t channel_of_items() const { return 1000 + task_.worker * 100 + task_.life; }

  void keep(ShmSharedPtr<const Frame> message) {
    auto& place = kept_[random_.pick(kKept)];
    let_go(place);
    place = std::move(message);
  }
  static void let_go(ShmSharedPtr<const Frame>& message) {
    if (message) check(*message, "after it was kept");
    message.reset();
  }
  void publish_again() {
    auto& message = kept_[random_.pick(kKept)];
    if (!message) return;
    check(*message, "before it is published again");
    (void)again_->push(message);
    const ShmSharedPtr<const Frame> copy = message;
    if (random_.chance(50)) let_go(message);
    check(*copy, "a copy of the pointer");
  }

  Task task_;
  Random random_;
  const unsigned lean_;
  ShmEngine engine_;
  std::optional<ShmQueue<Letter>> queue_;
  std::optional<ShmPusher<Frame>> again_;
  std::optional<Publisher<Frame>> frames_out_;
  std::optional<Subscriber<Frame>> frames_in_;
  std::optional<Publisher<Letter>> letters_out_;
  std::optional<Subscriber<Letter>> letters_in_;
  std::array<ShmSharedPtr<const Frame>, kKept> kept_;
  std::uint64_t items_ = 0;
};

}  // namespace

int work(const Task& task) {
  try {
    Worker(task).run();
  } catch (const std::exception& e) {
    wrong(std::string("an exception: ") + e.what());
    return 1;
  }
  return 0;
}

}  // namespace lot::replay
