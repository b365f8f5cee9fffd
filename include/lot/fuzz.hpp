// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <unistd.h>
#include <utility>
#include <vector>

#include "lot/lot.hpp"

/// Fuzzing a queue of your own message type (docs/fuzzing.md).
///
///     void fill(Track& track, lot::fuzz::Bytes& bytes);  // a message out of the fuzzer's bytes
///     std::string print(const Track& track);             // all that is in it
///
///     extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
///       return lot::fuzz::queue<Track>(data, size, fill, print);
///     }
///
/// The bytes say what publishers and subscribers do: loan, push, pull, borrow, keep, forward, come
/// and go. What comes out is compared with a model: each message as it was filled, in its
/// publisher's order, each once or counted as missed, and unchanged for as long as a subscriber
/// looks at it.
namespace lot::fuzz {

/// What a fuzzer has thought up, read from the front; behind the end there are zeros.
///
/// Threads: a value, of one thread.
/// Errors:  none: no member throws.
/// Memory:  two words; the bytes are the fuzzer's, and must be there as long as it.
/// Crash:   nothing of it is in a segment.
class Bytes {
 public:
  /// From the beginning.
  Bytes(const std::uint8_t* data, std::size_t size) noexcept : at_(data), left_(size) {}

  /// How many have not been read.
  std::size_t left() const noexcept { return left_; }
  /// The next one.
  std::uint8_t byte() noexcept {
    if (left_ == 0) return 0;
    --left_;
    return *at_++;
  }
  /// Any number of this type.
  template <class Number>
  Number number() noexcept {
    static_assert(std::is_integral_v<Number>, "lot: bytes make integers; convert them");
    std::uint64_t n = 0;
    for (std::size_t i = 0; i < sizeof(Number); ++i) n = n << 8 | byte();
    return static_cast<Number>(n);
  }
  /// One of 0, 1, ... n - 1.
  std::size_t below(std::size_t n) noexcept {
    const std::size_t any = n <= 256 ? byte() : number<std::uint64_t>();
    return n == 0 ? 0 : any % n;
  }
  /// At most `most` bytes, as they are.
  std::string_view text(std::size_t most) noexcept {
    const std::size_t length = std::min(below(most + 1), left_);
    const std::string_view view(reinterpret_cast<const char*>(at_), length);
    at_ += length;
    left_ -= length;
    return view;
  }

 private:
  const std::uint8_t* at_;
  std::size_t left_;
};

/// Aborts, and names what differs from the model: a fuzzer keeps the input. Throws nothing.
inline void require(bool same, const char* what) {
  if (same) return;
  std::fprintf(stderr, "lot: not as the model has it: %s\n", what);
  std::abort();
}

/// The segment that the messages lie in. All the messages of a run must fit into a quarter of it:
/// when memory is short, publishers overwrite early, which the model takes for a loss.
struct Options {
  std::uint64_t size_bytes = 64 << 20;  ///< of the segment
  std::string directory = "/dev/shm";   ///< where it is made; its name goes at once
};

namespace detail {

/// A segment that is gone from its directory as soon as it is open, so that no crash leaves one;
/// and two engines on it, each a participant of its own, as if in two processes.
class Place {
 public:
  explicit Place(const Options& options)
      : name_(own_name()), engines_{open(options, ""), open(options, "/.")} {
    ::unlink(engines_[0].path().c_str());
    ::unlink((engines_[0].path() + ".lock").c_str());
  }
  ShmEngine& engine(std::size_t side) noexcept { return engines_[side]; }

 private:
  /// The environment comes before what a program says: it must not lead to a segment in use.
  static std::string own_name() {
    const char* prefix = std::getenv("LOT_SEGMENT");
    std::string name = prefix != nullptr && *prefix != '\0' ? prefix : "lot_fuzz";
    for (const char* variable : {"LOT_SEGMENT", "LOT_DIR", "LOT_SIZE", "LOT_FAST_LANE"}) {
      ::unsetenv(variable);
    }
    return name + "_" + std::to_string(::getpid());
  }
  /// A directory that is spelt otherwise is another participant.
  ShmEngine open(const Options& options, const char* spelling) const {
    EngineOptions engine;
    engine.segment = name_;
    engine.directory = options.directory + spelling;
    engine.size_bytes = options.size_bytes;
    engine.processes = 3;
    engine.blocks = 2048;
    engine.topics = 4;
    engine.channels = 16;
    engine.readers = 8;
    return ShmEngine(engine);
  }

  std::string name_;
  ShmEngine engines_[2];
};

/// What is sent: a message, and the number that the model knows it by.
template <class T>
struct Letter {
  std::uint64_t number;
  T content;
};

template <class T, class Fill, class Print>
class Queue {
 public:
  Queue(Place& place, Bytes bytes, Fill& fill, Print& print)
      : place_(place), bytes_(bytes), fill_(fill), print_(print) {}

  void run() {
    while (bytes_.left() != 0) {
      step();
      check();
    }
  }

 private:
  using Mail = Letter<T>;
  static constexpr std::size_t kTopics = 2;
  static constexpr std::size_t kMost = 4;  ///< publishers, subscribers, weak pointers
  static constexpr std::size_t kMostPointers = 8;
  static constexpr std::uint64_t kEverything = ~std::uint64_t{0};
  /// As PusherOptions::fast_lane says.
  static constexpr bool fits_into_slot =
      std::is_trivially_copyable_v<Mail> && sizeof(Mail) <= 240 && alignof(Mail) <= 16;

  /// A message, and the object in shared memory that carries it: pointers to one object count each
  /// other. 0: there is none, the message travels in its slot.
  struct Sent {
    std::uint64_t number;
    std::uint64_t object;
  };
  struct Channel {
    std::size_t topic;
    std::uint32_t depth;
    bool blocking;
    bool in_slots;  ///< what is kept of it is a copy
    bool open = true;
    std::vector<Sent> log{};
    std::uint64_t oldest() const { return log.size() - std::min<std::size_t>(log.size(), depth); }
  };
  struct Publisher {
    std::size_t channel;
    std::size_t side;
    ShmPusher<Mail> pusher;
  };
  struct Source {
    std::size_t channel;
    std::uint64_t next;  ///< place in the log of the message that is read next
  };
  struct Subscriber {
    std::size_t topic;
    std::size_t side;
    ShmPuller<Mail> puller;
    ShmBorrow<Mail> borrow{};
    Source* borrowed = nullptr;    ///< where the borrow is from
    std::uint64_t skipped = 0;     ///< missed, and not told yet
    std::deque<Source> sources{};  ///< its elements stay: `borrowed` points to one
  };
  template <class Pointer>
  struct Known {
    Sent what;
    std::size_t side;
    Pointer pointer;
  };

  void step() {
    switch (bytes_.byte() % 16) {
      case 0:
      case 1:
        if (auto* p = pick(publishers_)) push(*p);
        break;
      case 2:
      case 3:
        if (auto* s = pick(subscribers_)) pull(**s);
        break;
      case 4:
        if (auto* s = pick(subscribers_)) borrow(**s);
        break;
      case 5:
        if (auto* s = pick(subscribers_)) end_borrow(**s);
        break;
      case 6:
        if (auto* s = pick(subscribers_)) keep(**s);
        break;
      case 7:
        if (auto* p = pick(pointers_)) pointers_.erase(pointers_.begin() + (p - pointers_.data()));
        break;
      case 8:
        if (auto* p = pick(pointers_)) remember(p->what, p->side, p->pointer);
        break;
      case 9:
        forward();
        break;
      case 10:
        if (auto* p = pick(pointers_)) {
          if (weak_.size() == kMost) weak_.erase(weak_.begin());
          weak_.push_back({p->what, p->side, ShmWeakPtr<const Mail>(p->pointer)});
        }
        break;
      case 11:
        if (auto* w = pick(weak_)) lock(*w);
        break;
      case 12:
        advertise();
        break;
      case 13:
        subscribe();
        break;
      case 14:
        if (auto* p = pick(publishers_)) close(*p);
        break;
      case 15:
        if (auto* s = pick(subscribers_))
          subscribers_.erase(subscribers_.begin() + (s - subscribers_.data()));
        break;
    }
  }

  /// One of them, or null when there are none.
  template <class Of>
  Of* pick(std::vector<Of>& all) {
    const std::size_t i = bytes_.below(all.size());
    return all.empty() ? nullptr : &all[i];
  }

  void advertise() {
    const std::size_t side = bytes_.below(2);
    const std::size_t topic = bytes_.below(kTopics);
    PusherOptions options;
    const std::uint8_t byte = bytes_.byte();
    const unsigned how = byte % 8;
    options.fast_lane = byte >= 128;
    options.policy = how % 2 == 0 ? Policy::Overwrite : how < 4 ? Policy::Block : Policy::Refuse;
    options.engine = how / 2 % 2 == 0 ? QueueEngine::Ring : QueueEngine::Mutex;
    options.depth = static_cast<std::uint32_t>(1 + bytes_.below(8));
    if (publishers_.size() == kMost) return;
    publishers_.push_back({channels_.size(), side,
                           place_.engine(side).template advertise<Mail>(name(topic), options)});
    // All of it is for each that has subscribed, however late it looks.
    for (const auto& s : subscribers_) {
      if (s->topic == topic) s->sources.push_back({channels_.size(), 0});
    }
    channels_.push_back({topic, options.depth, options.policy != Policy::Overwrite,
                         options.fast_lane && fits_into_slot});
  }

  void close(Publisher& publisher) {
    channels_[publisher.channel].open = false;
    publishers_.erase(publishers_.begin() + (&publisher - publishers_.data()));
  }

  void subscribe() {
    constexpr std::uint64_t kHistory[] = {0, 1, 3, kEverything};
    const std::size_t side = bytes_.below(2);
    const std::size_t topic = bytes_.below(kTopics);
    PullerOptions options;
    options.history = kHistory[bytes_.below(4)];
    if (subscribers_.size() == kMost) return;
    subscribers_.push_back(std::unique_ptr<Subscriber>(new Subscriber{
        topic, side, place_.engine(side).template subscribe<Mail>(name(topic), options)}));
    meet(*subscribers_.back(), options.history);
  }

  /// A new subscriber finds the publishers that there are.
  void meet(Subscriber& subscriber, std::uint64_t history) {
    for (std::size_t c = 0; c < channels_.size(); ++c) {
      const Channel& channel = channels_[c];
      if (!channel.open || channel.topic != subscriber.topic) continue;
      const std::uint64_t published = channel.log.size();
      std::uint64_t back = channel.blocking ? channel.depth - 1 : channel.depth;
      if (!channel.blocking && history == kEverything) back = published;
      back = std::min({back, history, published});
      if (history == kEverything) subscriber.skipped += published - back;
      subscriber.sources.push_back({c, published - back});
    }
  }

  /// A message out of the fuzzer's bytes; in shared memory it must be what it is in private memory.
  ShmUniquePtr<Mail> write(Publisher& publisher) {
    ShmSharedPtr<const T> seen;
    if (const auto* p = wants_seen ? pick(pointers_) : nullptr) {
      if (p->side == publisher.side) seen = {p->pointer, &p->pointer->content};
    }
    Bytes again = bytes_;
    T mine{};
    fill(mine, bytes_, seen);
    ShmUniquePtr<Mail> mail = publisher.pusher.loan();
    mail->number = texts_.size();
    fill(mail->content, again, seen);
    texts_.push_back(print_(std::as_const(mine)));
    require(print_(std::as_const(mail->content)) == texts_.back(),
            "the message, when it is filled");
    return mail;
  }

  static constexpr bool wants_seen =
      std::is_invocable_v<Fill&, T&, Bytes&, const ShmSharedPtr<const T>&>;
  void fill(T& content, Bytes& bytes, const ShmSharedPtr<const T>& seen) {
    if constexpr (wants_seen) {
      fill_(content, bytes, seen);
    } else {
      fill_(content, bytes);
    }
  }

  void push(Publisher& publisher) {
    const std::uint8_t how = bytes_.byte();
    ShmUniquePtr<Mail> mail = write(publisher);
    const Sent sent{mail->number, ++objects_};
    if (how % 8 == 7) return;  // loaned, not pushed
    const bool full = is_full(publisher);
    Status status;
    if (how % 8 == 6) {
      const ShmSharedPtr<Mail> shared(std::move(mail));
      status = publisher.pusher.push(shared, std::chrono::nanoseconds(0));
    } else {
      status = publisher.pusher.try_push(std::move(mail));
      require(static_cast<bool>(mail) == full, "who has a message after a push");
    }
    pushed(publisher, sent, status, full);
  }

  void forward() {
    const auto* p = pick(pointers_);
    auto* publisher = pick(publishers_);
    if (p == nullptr || publisher == nullptr) return;
    if (is_elsewhere(p->what.number, publisher->channel)) return;
    const bool full = is_full(*publisher);
    const Status status = publisher->pusher.push(p->pointer, std::chrono::nanoseconds(0));
    pushed(*publisher, p->what, status, full);
  }

  void pushed(Publisher& publisher, Sent sent, Status status, bool full) {
    require(status == (full ? Status::Full : Status::Ok), "the status of a push");
    Channel& channel = channels_[publisher.channel];
    if (channel.in_slots) sent.object = 0;
    if (!full) channel.log.push_back(sent);
  }

  bool is_full(const Publisher& publisher) const {
    const Channel& channel = channels_[publisher.channel];
    if (!channel.blocking) return false;
    for (const auto& subscriber : subscribers_) {
      if (subscriber->topic != channel.topic) continue;
      for (const Source& s : subscriber->sources) {
        if (s.channel == publisher.channel && channel.log.size() - s.next >= channel.depth) {
          return true;
        }
      }
    }
    return false;
  }

  /// True when another publisher of the topic has sent it: a reader could not tell whose it is.
  bool is_elsewhere(std::uint64_t number, std::size_t channel) const {
    for (std::size_t c = 0; c < channels_.size(); ++c) {
      const auto& log = channels_[c].log;
      const auto is_it = [number](const Sent& sent) { return sent.number == number; };
      if (c != channel && channels_[c].topic == channels_[channel].topic &&
          std::any_of(log.begin(), log.end(), is_it)) {
        return true;
      }
    }
    return false;
  }

  void pull(Subscriber& subscriber) {
    if (subscriber.borrowed != nullptr) return;
    const auto mail = look(subscriber, [&] { return subscriber.puller.try_pull(); });
    if (!mail) return;
    Source& source = found(subscriber, mail->number);
    remember(kept(at(source)), subscriber.side, mail);
    ++source.next;
  }

  const Sent& at(const Source& source) const { return channels_[source.channel].log[source.next]; }
  /// What a subscriber has that keeps this: of a message in its slot, a copy.
  Sent kept(Sent what) {
    if (what.object == 0) what.object = ++objects_;
    return what;
  }

  void borrow(Subscriber& subscriber) {
    if (subscriber.borrowed != nullptr) {
#ifdef __cpp_exceptions
      bool refused = false;
      try {
        (void)subscriber.puller.try_borrow();  // it throws
      } catch (const Error&) {
        refused = true;
      }
      require(refused, "a second borrow is refused");
#endif
      return;
    }
    subscriber.borrow = look(subscriber, [&] { return subscriber.puller.try_borrow(); });
    if (subscriber.borrow) subscriber.borrowed = &found(subscriber, subscriber.borrow->number);
  }

  void end_borrow(Subscriber& subscriber) {
    if (subscriber.borrowed == nullptr) return;
    subscriber.borrow.end();
    ++subscriber.borrowed->next;
    subscriber.borrowed = nullptr;
  }

  void keep(Subscriber& subscriber) {
    if (subscriber.borrowed == nullptr) return;
    remember(kept(at(*subscriber.borrowed)), subscriber.side, subscriber.borrow.keep());
  }

  /// Takes the next message by `take`; empty only when the model has nothing to read.
  template <class Take>
  auto look(Subscriber& subscriber, Take&& take) {
    // A background thread may have the registry's lock when a new publisher is to be found.
    for (unsigned n = 0; !knows_all(subscriber) && n < 1000; ++n) ::usleep(1000);
    auto taken = take();
    require(static_cast<bool>(taken) == has_mail(subscriber), "whether there is a message");
    if (!taken) {
      auto& sources = subscriber.sources;
      const auto gone = [this](const Source& s) { return !channels_[s.channel].open; };
      sources.erase(std::remove_if(sources.begin(), sources.end(), gone), sources.end());
      require(
          subscriber.puller.status() == (sources.empty() ? Status::PublisherGone : Status::Empty),
          "the status when there is no message");
    }
    return taken;
  }

  /// Looks for new publishers; true when none is left to be found.
  bool knows_all(Subscriber& subscriber) const {
    const auto& sources = subscriber.sources;
    const auto is_open = [this](const Source& s) { return channels_[s.channel].open; };
    return subscriber.puller.publishers() >=
           static_cast<std::size_t>(std::count_if(sources.begin(), sources.end(), is_open));
  }

  bool has_mail(const Subscriber& subscriber) const {
    return std::any_of(
        subscriber.sources.begin(), subscriber.sources.end(),
        [this](const Source& s) { return s.next < channels_[s.channel].log.size(); });
  }

  /// Whose message this is: the next one of some publisher, with the right number of missed ones.
  Source& found(Subscriber& subscriber, std::uint64_t number) {
    for (Source& s : subscriber.sources) {
      const Channel& channel = channels_[s.channel];
      const std::uint64_t next = std::max(s.next, channel.oldest());
      if (next == channel.log.size() || channel.log[next].number != number) continue;
      require(subscriber.puller.missed() == subscriber.skipped + (next - s.next),
              "how many were missed");
      subscriber.skipped = 0;
      s.next = next;
      return s;
    }
    require(false, "which message comes next");
    std::abort();
  }

  /// The pointer is a copy: it may be one of those that move here.
  void remember(Sent what, std::size_t side, ShmSharedPtr<const Mail> pointer) {
    if (pointers_.size() == kMostPointers) pointers_.erase(pointers_.begin());
    pointers_.push_back({what, side, std::move(pointer)});
  }

  void lock(const Known<ShmWeakPtr<const Mail>>& weak) {
    const auto pointer = weak.pointer.lock();
    require(pointer || !is_alive(weak.what.object), "a weak pointer to a message that lives");
    require(static_cast<bool>(pointer) == !weak.pointer.expired(), "whether a message has expired");
    if (pointer) remember(weak.what, weak.side, pointer);
  }

  /// True when a holder of the model must still find the object.
  bool is_alive(std::uint64_t object) const {
    for (const auto& p : pointers_) {
      if (p.what.object == object) return true;
    }
    for (const auto& s : subscribers_) {
      if (s->borrowed != nullptr && at(*s->borrowed).object == object) return true;
    }
    for (const Channel& c : channels_) {
      const auto waiting = c.log.begin() + static_cast<std::ptrdiff_t>(c.oldest());
      const auto is_it = [object](const Sent& sent) { return sent.object == object; };
      if (c.open && std::any_of(waiting, c.log.end(), is_it)) return true;
    }
    return false;
  }

  /// What must hold between steps.
  void check() {
    for (const auto& p : pointers_) {
      same(*p.pointer, p.what.number, "a message that is kept");
      const auto uses = [&](std::size_t side) {
        return std::count_if(pointers_.begin(), pointers_.end(), [&](const auto& other) {
          return other.what.object == p.what.object && other.side == side;
        });
      };
      const long here = static_cast<long>(uses(p.side));
      const long least = here + (uses(1 - p.side) != 0 ? 1 : 0);
      const long count = p.pointer.use_count();  // the other side may also forward it
      require(count == least || count == here + 1, "use_count()");
    }
    for (const auto& s : subscribers_) {
      if (s->borrowed != nullptr) {
        same(*s->borrow, at(*s->borrowed).number, "a message that is borrowed");
      }
    }
    for (auto& p : publishers_) {
      const auto joined =
          std::count_if(subscribers_.begin(), subscribers_.end(), [&](const auto& s) {
            return std::any_of(s->sources.begin(), s->sources.end(),
                               [&](const Source& source) { return source.channel == p.channel; });
          });
      require(p.pusher.readers() == static_cast<std::size_t>(joined), "readers()");
    }
  }

  void same(const Mail& mail, std::uint64_t number, const char* what) {
    require(mail.number == number && print_(mail.content) == texts_[number], what);
  }

  static std::string_view name(std::size_t topic) { return topic == 0 ? "/a" : "/b"; }

  Place& place_;
  Bytes bytes_;
  Fill& fill_;
  Print& print_;
  std::vector<std::string> texts_;  ///< by number: what each message says
  std::uint64_t objects_ = 0;       ///< so many were there
  std::vector<Channel> channels_;
  std::vector<Publisher> publishers_;
  std::vector<std::unique_ptr<Subscriber>> subscribers_;
  std::vector<Known<ShmSharedPtr<const Mail>>> pointers_;
  std::vector<Known<ShmWeakPtr<const Mail>>> weak_;
};

}  // namespace detail

/// Drives publishers and subscribers of T by the fuzzer's bytes; aborts when something is not as it
/// should be. `fill` sets every member of a message from bytes, the same for the same bytes;
/// `print` says all that is in it. The options count at the first call. Returns 0.
///
/// Threads: one at a time.
/// Errors:  what ShmEngine, `fill` and `print` throw; lot::OutOfMemory when the messages do not
///          fit.
/// Memory:  a segment of Options::size_bytes, until the process ends.
/// Crash:   the segment has no name, and goes with the process.
template <class T, class Fill, class Print>
int queue(const std::uint8_t* data, std::size_t size, Fill&& fill, Print&& print,
          const Options& options = Options()) {
  // Made once, and never destroyed: a segment for each input would take most of the time.
  static detail::Place* const place = new detail::Place(options);
  detail::Queue<T, Fill, Print>(*place, Bytes(data, size), fill, print).run();
  return 0;
}

}  // namespace lot::fuzz
