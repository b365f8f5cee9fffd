// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lot/lot.hpp"

#include "lockstep.hpp"
#include "transport/participant.hpp"

/// A process with pointers of each kind, which does one command after the other.
namespace lot::outside {

/// A message that refers to others. All but a large body lies in its block's small payload.
struct Leaf {
  std::uint64_t serial;
  ShmVector<std::uint32_t> body;
  std::array<ShmRef<const Leaf>, 2> refs;
};
/// Small and plain: with PusherOptions::fast_lane it travels in slots.
struct Plain {
  std::uint64_t serial;
  std::uint64_t words[3];
};
inline constexpr unsigned kKinds = 2;  ///< 0: Leaf, 1: Plain

inline constexpr unsigned kUnique = 3, kShared = 5, kParts = 2, kWeak = 3;
/// A cell that is not there: what would go there is dropped.
inline constexpr unsigned kDrop = 99;

enum class Do : std::uint8_t {
  Advertise,  ///< n: bit 0 fast lane, bit 1 the mutex engine, from bit 8: depth
  Close,      ///< the pusher
  Subscribe,  ///
  Unsubscribe,
  Look,        ///< for new publishers
  Loan,        ///< unique a: serial, n numbers in its body
  Regrow,      ///< unique a gets a body of n numbers
  Refer,       ///< reference b of unique a: to shared n
  Unrefer,     ///< reference b of unique a: to nothing
  Share,       ///< unique a becomes shared b
  Copy,        ///< shared a to shared b
  Alias,       ///< part b: a part of shared a
  Follow,      ///< shared n: what reference b of shared a refers to
  Weaken,      ///< weak b: looks after shared a
  Lock,        ///< shared b: weak a, locked
  DropUnique,  ///< a, as the next three
  DropShared,
  DropPart,
  DropWeak,
  PushUnique,  ///< a
  PushShared,  ///< a
  PushTwins,   ///< shared a of the process's other copy of the library
  Pull,        ///< to shared a
  Settle,      ///< what the warden does when it finds the time
  Report       ///< all cells
};

struct PointerCommand {
  Do what;
  std::uint8_t kind;
  std::uint8_t a, b;
  std::uint32_t n;
  std::uint64_t serial;
  bool by_twin;  ///< the process's second copy of the library does it
};

/// What a cell has.
struct Cell {
  std::uint64_t serial = 0;  ///< 0: nothing. Of a weak one: 1 if it has not expired
  std::int64_t uses = 0;
  bool alone = false;
};
struct Cells {
  Cell unique[kUnique], shared[kShared], part[kParts], weak[kWeak];
};
struct PointerAnswer {
  Said said;
  Status status = Status::Ok;
  std::uint64_t serial = 0;    ///< of the message that was pulled or locked; 0: none
  std::uint64_t sequence = 0;  ///< of its publisher's messages
  std::uint64_t missed = 0;    ///< by the puller, in all
  std::uint32_t index = 0;     ///< the participant's
  char publisher[48] = {};     ///< its process
  Cells cells[kKinds];
};

/// Mistakes of a process; the last two are of the library, which the linker leads elsewhere.
inline const std::vector<Mistake> kPointerMistakes{
    {"count", "use_count() counts a weak pointer"},
    {"leak", "a message that is published again is never let go"},
    {"keep", "a weak pointer keeps its message"},
    {"alias", "a pointer to a part does not keep the message"},
    {"deaf", "a weak pointer to a living message can not be locked"},
    {"bytes", "a message takes a page more than it should"},
    {"unheld", "a reference does not hold what it refers to"},
    {"unlet", "a reference that goes does not let go"},
};
inline std::string pointer_plant;
/// One in `several` times in each life of a process.
inline bool makes(std::string_view mistake, unsigned several = 2) {
  static unsigned chances = 0;
  return pointer_plant == mistake && ++chances % several == 0;
}

template <class M>
class Holder {
 public:
  explicit Holder(const char* topic) : topic_(topic) {}

  void act(ShmEngine& engine, const PointerCommand& c, PointerAnswer& answer) {
    switch (c.what) {
      case Do::Advertise:
        return advertise(engine, c.n);
      case Do::Close:
        return pusher_.reset();
      case Do::Subscribe:
        return subscribe(engine);
      case Do::Unsubscribe:
        return puller_.reset();
      case Do::Look:
        if (puller_) (void)puller_->publishers();
        return;
      case Do::Loan:
        unique_[c.a] = pusher_ ? pusher_->loan() : engine.make<M>();
        unique_[c.a]->serial = c.serial;
        return regrow(c.a, c.n);
      case Do::Regrow:
        return regrow(c.a, c.n);
      case Do::PushUnique:
        answer.status = pusher_->push(std::move(unique_[c.a]));
        return;
      case Do::PushShared:
        return push(shared_[c.a], answer);
      case Do::Pull:
        return pull(c.a, answer);
      case Do::Report:
        return report(answer.cells[c.kind]);
      default:
        return point(c, answer);
    }
  }
  void push_of(const Holder& twin, const PointerCommand& c, PointerAnswer& answer) {
    push(twin.shared_[c.a], answer);
  }

 private:
  static constexpr bool kRefers = std::is_same_v<M, Leaf>;

  void advertise(ShmEngine& engine, std::uint32_t how) {
    PusherOptions options;
    options.fast_lane = (how & 1) != 0;
    options.engine = (how & 2) != 0 ? QueueEngine::Mutex : QueueEngine::Ring;
    options.depth = how >> 8;
    pusher_.emplace(engine.advertise<M>(topic_, options));
  }
  void subscribe(ShmEngine& engine) {
    PullerOptions options;
    options.max_held_bytes = PullerOptions::kNoQuota;
    puller_.emplace(engine.subscribe<M>(topic_, options));
  }

  void push(const ShmSharedPtr<const M>& message, PointerAnswer& answer) {
    if (makes("leak")) leaked_.push_back(message);
    answer.status = pusher_->push(message);
  }

  void regrow(unsigned cell, std::uint32_t numbers) {
    if constexpr (kRefers) {
      auto& body = unique_[cell]->body;
      body.clear();
      body.shrink_to_fit();
      body.resize(makes("bytes") && numbers > 1000 ? numbers + 30'000 : numbers);
      for (std::uint32_t& number : body) number = static_cast<std::uint32_t>(unique_[cell]->serial);
    }
  }

  void pull(unsigned to, PointerAnswer& answer) {
    ShmSharedPtr<const M> seen = puller_->try_pull();
    answer.status = puller_->status();
    answer.missed = puller_->missed_total();
    if (!seen) return;
    const Envelope envelope = puller_->envelope();
    answer.serial = seen->serial;
    answer.sequence = envelope.sequence;
    envelope.publisher.copy(answer.publisher, sizeof(answer.publisher) - 1);
    if (to != kDrop) shared_[to] = std::move(seen);
  }

  /// Whatever needs neither pusher nor puller.
  void point(const PointerCommand& c, PointerAnswer& answer) {
    switch (c.what) {
      case Do::Share:
        shared_[c.b] = ShmSharedPtr<M>(std::move(unique_[c.a]));
        return;
      case Do::Copy:
        shared_[c.b] = shared_[c.a];
        return;
      case Do::Alias:
        part_[c.b] =
            makes("alias", 1)
                ? ShmSharedPtr<const std::uint64_t>(ShmSharedPtr<const M>(), &shared_[c.a]->serial)
                : ShmSharedPtr<const std::uint64_t>(shared_[c.a], &shared_[c.a]->serial);
        return;
      case Do::Weaken:
        weak_[c.b] = shared_[c.a];
        if (makes("keep")) leaked_.push_back(shared_[c.a]);
        return;
      case Do::Lock:
        if (auto locked = weak_[c.a].lock(); locked && !makes("deaf", 2)) {
          answer.serial = locked->serial;
          shared_[c.b] = std::move(locked);
        }
        return;
      case Do::DropUnique:
        return unique_[c.a].reset();
      case Do::DropShared:
        return shared_[c.a].reset();
      case Do::DropPart:
        return part_[c.a].reset();
      case Do::DropWeak:
        return weak_[c.a].reset();
      default:
        if constexpr (kRefers) refer(c);
    }
  }

  void refer(const PointerCommand& c) {
    if (c.what == Do::Refer) unique_[c.a]->refs[c.b] = shared_[c.n];
    if (c.what == Do::Unrefer) unique_[c.a]->refs[c.b].reset();
    if (c.what == Do::Follow) shared_[c.n] = shared_[c.a]->refs[c.b].lock();
  }

  static void check(const M& message) {
    if constexpr (kRefers) {
      for (const std::uint32_t number : message.body) {
        require(number == static_cast<std::uint32_t>(message.serial), "a body is another one's");
      }
    }
  }

  void report(Cells& cells) {
    for (unsigned i = 0; i < kUnique; ++i) {
      if (unique_[i]) cells.unique[i] = {unique_[i]->serial, 0, true};
    }
    for (unsigned i = 0; i < kShared; ++i) {
      if (!shared_[i]) continue;
      check(*shared_[i]);
      cells.shared[i] = {shared_[i]->serial, shared_[i].use_count(), shared_[i].unique()};
      for (const auto& weak : weak_) {
        if (pointer_plant == "count" && !weak.owner_before(shared_[i]) &&
            !shared_[i].owner_before(weak)) {
          ++cells.shared[i].uses;
        }
      }
    }
    for (unsigned i = 0; i < kParts; ++i) {
      if (part_[i]) cells.part[i] = {*part_[i], part_[i].use_count(), part_[i].unique()};
    }
    for (unsigned i = 0; i < kWeak; ++i) {
      cells.weak[i] = {weak_[i].expired() ? 0U : 1U, weak_[i].use_count(), false};
    }
  }

  const char* topic_;
  std::optional<ShmPusher<M>> pusher_;
  std::optional<ShmPuller<M>> puller_;
  std::array<ShmUniquePtr<M>, kUnique> unique_;
  std::array<ShmSharedPtr<const M>, kShared> shared_;
  std::array<ShmSharedPtr<const std::uint64_t>, kParts> part_;
  std::array<ShmWeakPtr<const M>, kWeak> weak_;
  std::vector<ShmSharedPtr<const M>> leaked_;
};

/// A copy of the library: it is a participant of its own.
class PointerCopy {
 public:
  explicit PointerCopy(const EngineOptions& options)
      : engine_(options), participant_(detail::join(options)) {}

  void act(const PointerCommand& c, PointerCopy* twin, PointerAnswer& answer) {
    answer.index = participant_->index();
    if (c.what == Do::Settle) return settle();
    if (c.kind == 0) {
      act(leaves_, &PointerCopy::leaves_, c, twin, answer);
    } else {
      act(plains_, &PointerCopy::plains_, c, twin, answer);
    }
  }

 private:
  template <class M>
  void act(Holder<M>& holder, Holder<M> PointerCopy::*of, const PointerCommand& c,
           PointerCopy* twin, PointerAnswer& answer) {
    if (c.what == Do::PushTwins) return holder.push_of(twin->*of, c, answer);
    holder.act(engine_, c, answer);
  }

  /// All that may be left to be done later is done now: memory that lies idle, messages that have
  /// died, processes too.
  void settle() {
    transport::Participant& p = *participant_;
    p.eviction().settle();
    p.stock().settle_kept();
    p.stock().trim(transport::Stock::kNobody);
    p.reaper().reap_dead();
    p.reaper().collect();
  }

  ShmEngine engine_;
  std::shared_ptr<transport::Participant> participant_;
  Holder<Leaf> leaves_{"/leaves"};
  Holder<Plain> plains_{"/plains"};
};

/// With a twin it is what two libraries are that have each linked LOT: two participants, and a
/// pointer of one may be published by the other. By another name of the directory, they do not know
/// each other.
class PointerNode {
 public:
  PointerNode(const EngineOptions& options, const std::string& twin) : copy_(options) {
    if (twin.empty()) return;
    EngineOptions its = options;
    its.directory += "/.";
    its.name = twin;
    twin_.emplace(its);
  }

  void act(const PointerCommand& c, PointerAnswer& answer) {
    if (c.by_twin) return twin_->act(c, &copy_, answer);
    copy_.act(c, twin_ ? &*twin_ : nullptr, answer);
  }

 private:
  PointerCopy copy_;
  std::optional<PointerCopy> twin_;
};

}  // namespace lot::outside
