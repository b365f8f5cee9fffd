// SPDX-License-Identifier: Apache-2.0

// Ownership words, the block pool and reaping: three processes, played in one, loan, share,
// publish, read, keep, refer, let go, die and are reaped, over a real segment. The model is the set
// of those who hold each message.
//
// Input: policies and depths | operations, a byte each, with arguments behind it
// (corpus/pool/ has examples)

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <vector>

#include "lot/fuzz.hpp"

#include "support/local_segment.hpp"
#include "support/plant.hpp"
#include "support/raw.hpp"
#include "transport/pool.hpp"

namespace {

using lot::detail::ControlBlock;
using lot::detail::MessageType;
using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;
using lot::ring::kNoBlock;
using lot::ring::Word;
using lot::testing::LocalSegment;
using lot::transport::Holder;
using lot::transport::Pool;
namespace hold = lot::transport::hold;
using Writer = lot::ring::Writer<lot::segment::Atomics>;
using Reader = lot::ring::Reader<lot::segment::Atomics>;

constexpr std::uint32_t kBlocks = 12;
constexpr std::uint32_t kProcesses = 3;  ///< participants 1, 2, 3
constexpr std::uint32_t kPools = 2;      ///< the first one with a ring
constexpr std::uint32_t kNone = Pool::kNone;

/// What lies in a message's payload.
struct Payload {
  std::uint64_t number;
  std::uint64_t echo;
};

/// The numbers of the messages whose destructor has run.
std::vector<std::uint64_t> destroyed;

void destroy(void* message) noexcept {
  const auto& payload = *static_cast<Payload*>(message);
  require(payload.echo == ~payload.number, "the payload when it is destroyed");
  destroyed.push_back(payload.number);
  if (planted("destroyed_twice")) destroyed.push_back(payload.number);
}

constexpr MessageType kPlain{sizeof(Payload), alignof(Payload), 0, "plain", nullptr, true, nullptr};
constexpr MessageType kClass{sizeof(Payload), alignof(Payload), 0, "class", &destroy,
                             false,           nullptr};

struct Message {
  std::uint32_t block;
  std::uint32_t generation;
  std::uint32_t home;  ///< participant, or 0: the orphanage
  unsigned life;       ///< which one of its home's lives it was made in
  bool plain;
  bool dead = false;
  bool destroyed = false;                  ///< what it referred to is let go
  bool seen = false;                       ///< its pointers are not all that ever had it
  std::vector<std::uint64_t> refers_to{};  ///< numbers
};

/// A pointer, a loan, a weak pointer: which message it is to.
using Numbers = std::vector<std::uint64_t>;

/// What one process has: all of it goes when it dies.
struct Private {
  explicit Private(LocalSegment& local, std::uint32_t self) {
    holder.segment = &local.segment();
    holder.own = lot::transport::HardwareOwnership(self);
    holder.controls = controls.data();
    holder.make_tables(kBlocks);
    holder.pools = &pools;
    for (std::uint32_t b = 0; b < kBlocks; ++b) controls[b].block = b;
    for (std::uint32_t i = 0; i < kPools; ++i) pools.push_back(std::make_unique<Pool>(holder, i));
  }
  std::array<ControlBlock, kBlocks> controls{};
  Holder holder;
  std::vector<std::unique_ptr<Pool>> pools;
  Writer writer;
  lot::registry::ChannelName ring{};
  std::map<std::uint32_t, Reader> readers;  ///< by channel
};

/// A ring, by the messages in its slots, oldest first; none: evicted.
struct RingModel {
  std::uint32_t owner;
  std::uint32_t depth;
  bool blocking;
  bool orphan = false;
  std::deque<std::optional<std::uint64_t>> slots{};

  bool names(std::uint64_t m) const { return std::count(slots.begin(), slots.end(), m) != 0; }
};

/// What the model knows of a process. It stands until the process is reaped.
struct Process {
  std::unique_ptr<Private> real{};  ///< none: it is dead
  bool entered = false;
  unsigned life = 0;
  bool blocking = false;
  std::uint32_t depth = 1;
  std::uint32_t channel = 0;
  Numbers loans{};
  Numbers pointers{};
  Numbers retired{};                                 ///< left the ring, perhaps borrowed
  std::set<std::uint32_t> cells{};                   ///< rings that it has joined
  std::map<std::uint32_t, std::uint64_t> borrows{};  ///< by channel
};

class Fuzz {
 public:
  Fuzz(LocalSegment& local, Bytes bytes) : local_(local), bytes_(bytes) {
    local_.clear();
    destroyed.clear();
    for (std::uint32_t p = 1; p <= kProcesses; ++p) {
      const std::uint8_t form = bytes_.byte();
      processes_[p].blocking = form % 2 != 0;
      processes_[p].depth = static_cast<std::uint32_t>(1 + form / 2 % 4U);
    }
  }

  void run() {
    while (bytes_.left() != 0) {
      step();
      spoil();
      check();
    }
    end();
  }

 private:
  // ---- operations
  // ---------------------------------------------------------------------------------

  void step() {
    const unsigned operation = bytes_.byte();
    self_ = static_cast<std::uint32_t>(1 + operation / 32 % kProcesses);
    Process& p = processes_[self_];
    if (!p.entered) return enter(p);
    if (!p.real) {
      if (operation % 32 < 8) reap(self_);
      return;
    }
    switch (operation % 32) {
      case 0:
      case 1:
      case 2:
        return loan(p);
      case 3:
      case 4:
        return push_unique(p);
      case 5:
        return push_shared(p);
      case 6:
        return share(p);
      case 7:
        return abandon(p);
      case 8:
        if (const auto m = pick(p.pointers)) copy(p, *m);
        return;
      case 9:
      case 10:
        return drop(p, bytes_.below(p.pointers.size()));
      case 11:
      case 12:
        return borrow(p);
      case 13:
        return keep(p);
      case 14:
        return done(p);
      case 15:
        return join(p);
      case 16:
        return leave_ring(p);
      case 17:
        return make_weak(p);
      case 18:
        return lock_weak(p);
      case 19:
        return refer(p);
      case 20:
        return grow(p);
      case 21:
        return scan(p);
      case 22:
        return evict(p);
      case 23:
        p.real->pools[bytes_.below(kPools)]->trim(true);
        return;
      case 24:
        p.real->pools[0]->prepare();
        return;
      case 25:
        p.real->pools[bytes_.below(kPools)]->poll_kept();
        return;
      case 26:
        p.real.reset();  // dies
        return;
      case 27:
        return reap(self_);  // leaves: the same code
      case 28:
        for (auto& pool : p.real->pools) pool->drain();
        return;
      default:
        return collect();
    }
  }

  void enter(Process& p) {
    if (rings_.size() == local_.world().channels())
      return;  // readers keep the rings of those who have left
    p.entered = true;
    local_.world().participant_state(self_).take();
    p.real = std::make_unique<Private>(local_, self_);
    const lot::registry::Registry::Lock lock(local_.registry());
    const auto opened = local_.registry().open(
        0, self_,
        {p.depth, kProcesses + 1, p.blocking ? lot::Policy::Block : lot::Policy::Overwrite});
    require(opened.has_value(), "there is memory for each ring");
    p.real->ring = *opened;
    p.real->writer = Writer(local_.world().ring(p.real->ring.channel));
    p.channel = p.real->ring.channel;
    ++p.life;
    require(rings_.count(p.channel) == 0, "a ring that is opened was free");
    rings_[p.channel] = {self_, p.depth, p.blocking};
  }

  void loan(Process& p) {
    const std::uint32_t index = static_cast<std::uint32_t>(bytes_.below(kPools));
    const bool plain = bytes_.below(2) == 0;
    Pool& pool = *p.real->pools[index];
    std::uint32_t b = pool.try_loan();
    if (b == kNone && index == 0) {
      scan(p);
      b = pool.try_loan();
    }
    if (b == kNone) b = pool.claim();
    if (b == kNone) return;
    destroy_the_dead();
    require(!living_in(b), "a block that is loaned carries no message that lives");
    auto* payload =
        static_cast<Payload*>(pool.lay_out(p.real->controls[b], plain ? kPlain : kClass, false));
    const std::uint64_t number = messages_.size();
    *payload = {number, ~number};
    messages_.push_back({b, generation(b), self_, p.life, plain});
    p.loans.push_back(number);
  }

  void push_unique(Process& p) {
    const auto m = pick(p.loans);
    if (!m || !room(p)) return;
    std::erase(p.loans, *m);
    lot::transport::HardwareOwnership::hand_to_ring(control(p, *m).hold);
    publish(p, *m);
  }

  void push_shared(Process& p) {
    const auto m = pick(p.pointers);
    if (!m || !room(p)) return;
    p.real->holder.acquire(block(*m), hold::kRing);
    publish(p, *m);
  }

  /// As the transport's Pusher does it.
  void publish(Process& p, std::uint64_t m) {
    Pool& pool = *p.real->pools[0];
    const auto published = p.real->writer.publish(block(m));
    messages_[m].seen = true;
    RingModel& ring = rings_.at(p.channel);
    std::optional<std::uint64_t> replaced;
    if (ring.slots.size() == ring.depth) {
      replaced = ring.slots.front();
      ring.slots.pop_front();
    }
    ring.slots.emplace_back(m);
    require(published.replaced == (replaced ? block(*replaced) : kNoBlock), "what a push replaces");
    if (published.replaced == block(m)) {
      p.real->holder.release(block(m), hold::kRing);
    } else if (replaced) {
      pool.retire(block(*replaced), !p.blocking);
      if (!p.blocking) p.retired.push_back(*replaced);
      let_foreign_go(p);
    }
  }

  void let_foreign_go(Process& p) {
    std::array<std::uint32_t, 4> some;
    while (const std::size_t n = p.real->pools[0]->take_foreign(some)) {
      for (std::size_t i = 0; i < n; ++i) p.real->holder.release(some[i], hold::kRing);
    }
  }

  void share(Process& p) {
    const auto m = pick(p.loans);
    if (!m) return;
    std::erase(p.loans, *m);
    p.pointers.push_back(*m);
    auto& words = local_.world().block(block(*m));
    messages_[*m].seen = bytes_.below(2) == 0;
    if (messages_[*m].seen) {
      lot::transport::HardwareOwnership::note_pointers(words, control(p, *m).hold);
    } else {
      lot::transport::HardwareOwnership::keep_unseen(words, control(p, *m).hold);
    }
  }

  /// As a ShmWeakPtr does it.
  void make_weak(Process& p) {
    const auto m = pick(p.pointers);
    if (!m) return;
    weak_.push_back(*m);
    if (!planted("weak_unseen")) {
      lot::transport::HardwareOwnership::end_unseen(control(p, *m).hold);
    }
    messages_[*m].seen = true;
  }

  void abandon(Process& p) {
    const auto m = pick(p.loans);
    if (!m) return;
    std::erase(p.loans, *m);
    messages_[*m].dead = true;
    p.real->pools[control(p, *m).pool]->give_back(block(*m));
  }

  void copy(Process& p, std::uint64_t m) {
    control(p, m).hold.add_pointer();
    p.pointers.push_back(m);
  }

  /// As the transport's Participant does it.
  void drop(Process& p, std::size_t index) {
    if (p.pointers.empty()) return;
    const std::uint64_t m = p.pointers[index];
    p.pointers.erase(p.pointers.begin() + static_cast<std::ptrdiff_t>(index));
    auto& word = control(p, m).hold;
    if (word.drop_pointer_of_several()) return;
    const bool unseen =
        lot::transport::HardwareOwnership::die_unseen(local_.world().block(block(m)), word);
    require(unseen != messages_[m].seen, "what dies as a unique pointer's message");
    if (unseen) {
      messages_[m].dead = true;
      p.real->pools[control(p, m).pool]->give_back(block(m));
    } else {
      p.real->holder.release(block(m), hold::kPointer);
    }
  }

  void join(Process& p) {
    const auto c = static_cast<std::uint32_t>(bytes_.below(local_.world().channels()));
    const auto history = bytes_.below(4) == 0 ? Reader::kFromTheStart : bytes_.below(3);
    const Word writer = local_.world().channel_writer(c).load();
    if (p.real->readers.count(c) != 0 || lot::ring::writer_state(writer) != lot::ring::State::Live)
      return;
    bool full = false;
    const auto reader = Reader::join(local_.world().ring(c), lot::ring::writer_generation(writer),
                                     self_, history, full);
    if (!reader) return;
    p.real->readers.emplace(c, *reader);
    p.cells.insert(c);
  }

  void borrow(Process& p) {
    const auto reader = pick(p.real->readers);
    if (reader == p.real->readers.end() || p.borrows.count(reader->first) != 0) return;
    std::uint64_t missed = 0;
    const Word b = reader->second.poll(missed);
    if (b == kNoBlock) return;
    const auto& payload =
        *reinterpret_cast<const Payload*>(local_.segment().small(static_cast<std::uint32_t>(b)));
    require(payload.number < messages_.size() && payload.echo == ~payload.number &&
                block(payload.number) == b && rings_.at(reader->first).names(payload.number),
            "what is read is in the ring");
    p.borrows[reader->first] = payload.number;
  }

  void keep(Process& p) {
    const auto borrow = pick(p.borrows);
    if (borrow == p.borrows.end()) return;
    p.real->holder.acquire(block(borrow->second), hold::kPointer);
    p.pointers.push_back(borrow->second);
  }

  void done(Process& p) {
    const auto borrow = pick(p.borrows);
    if (borrow == p.borrows.end()) return;
    p.real->readers.at(borrow->first).done();
    p.borrows.erase(borrow);
  }

  void leave_ring(Process& p) {
    const auto reader = pick(p.real->readers);
    if (reader == p.real->readers.end()) return;
    reader->second.leave();
    p.borrows.erase(reader->first);
    p.cells.erase(reader->first);
    p.real->readers.erase(reader);
  }

  void lock_weak(Process& p) {
    const auto m = pick(weak_);
    if (!m) return;
    const Message& message = messages_[*m];
    auto& words = local_.world().block(message.block);
    const bool locked =
        p.real->holder.own.acquire_weak(words, control(p, *m).hold, message.generation) ==
        lot::refcount::Left::Held;
    require(locked || !held(*m), "a weak pointer to a message that is held");
    require(!locked || !message.dead, "a weak pointer to a message that has died");
    if (!locked) return;
    p.pointers.push_back(*m);
  }

  /// A loaned message refers to one that is kept, as by ShmRef.
  void refer(Process& p) {
    const auto m = pick(p.loans);
    const auto target = pick(p.pointers);
    if (!m || !target || messages_[*m].plain) return;
    auto& to = messages_[*m].refers_to;
    if (to.size() == 3 || std::find(to.begin(), to.end(), *target) != to.end()) return;
    auto& arena = local_.segment().arena(block(*m));
    auto* const base = local_.segment().base();
    if (arena.references == 0) {
      auto* fresh = static_cast<lot::detail::ReferenceList*>(
          arena.allocate(sizeof(lot::detail::ReferenceList), 8));
      fresh->next = 0;
      for (auto& entry : fresh->entry) entry = {lot::detail::ReferenceList::kNone, 0};
      arena.references = local_.segment().offset_of(fresh);
    }
    auto& list = *reinterpret_cast<lot::detail::ReferenceList*>(base + arena.references);
    p.real->holder.acquire(block(*target), hold::kRing);
    list.entry[to.size()] = {block(*target), 1};
    to.push_back(*target);
    messages_[*target].seen = true;
  }

  /// A loaned message takes an extent.
  void grow(Process& p) {
    const auto m = pick(p.loans);
    if (!m) return;
    auto& build = local_.segment().build(block(*m));
    const auto granules = static_cast<std::uint32_t>(1 + bytes_.below(4));
    if (build.extents == lot::detail::Build::kMaxExtents) return;
    const std::uint32_t run = local_.segment().claim_run(granules, block(*m) + 1);
    require(run != lot::segment::Granules<lot::segment::Atomics>::kNone,
            "there are granules enough");
    build.extent[build.extents++] = {run, granules, 1, 0};
  }

  void scan(Process& p) {
    std::set<std::uint32_t> hazards;
    p.real->writer.hazards([&](Word b) { hazards.insert(static_cast<std::uint32_t>(b)); });
    p.real->pools[0]->scan([&](std::uint32_t b) { return hazards.count(b) != 0; });
    std::erase_if(p.retired, [&](std::uint64_t m) { return hazards.count(block(m)) == 0; });
    let_foreign_go(p);
  }

  void evict(Process& p) {
    if (p.blocking) return;
    const Word b = p.real->writer.evict_oldest();
    auto& slots = rings_.at(p.channel).slots;
    const auto oldest =
        std::find_if(slots.begin(), slots.end(), [](const auto& m) { return m.has_value(); });
    require(b == (oldest == slots.end() ? kNoBlock : block(**oldest)), "what is evicted");
    if (b == kNoBlock) return;
    p.retired.push_back(**oldest);
    oldest->reset();
    p.real->pools[0]->retire(static_cast<std::uint32_t>(b), true);
  }

  void reap(std::uint32_t k) {
    Process& p = processes_[k];
    p.real.reset();
    require(local_.reap(k), "there was something to reap");
    rings_.at(p.channel).orphan = true;
    for (Message& m : messages_) {
      if (m.home != k || m.destroyed) continue;
      m.home = 0;
      m.destroyed = m.dead;
    }
    Process fresh;
    fresh.life = p.life;
    fresh.blocking = p.blocking;
    fresh.depth = p.depth;
    p = std::move(fresh);
    collected();
  }

  void collect() {
    require(local_.collect(), "nobody has the registry's lock");
    collected();
  }

  /// What a reap or a collection makes of the orphanage.
  void collected() {
    destroy_the_dead();
    std::erase_if(rings_, [this](const auto& ring) {
      return ring.second.orphan &&
             std::none_of(processes_.begin(), processes_.end(),
                          [&](const auto& p) { return p.cells.count(ring.first) != 0; });
    });
    for (bool any = true; any;) {
      any = false;
      for (std::uint64_t m = 0; m < messages_.size(); ++m) {
        if (messages_[m].home != 0 || messages_[m].dead || held(m)) continue;
        messages_[m].dead = messages_[m].destroyed = any = true;
      }
    }
    for (std::uint32_t b = 0; b < kBlocks; ++b) {
      const auto m = living_in(b);
      const bool adopted = (local_.world().block(b).own[0].load() & 1) != 0;
      require(adopted == (m && needed(*m)), "what the orphanage holds after a collection");
      require(local_.world().block(b).home.load() != 1 || m,
              "what is at home with the orphanage lives");
    }
  }

  // ---- the model
  // ----------------------------------------------------------------------------------

  /// How often process k holds a message in its rings and by messages of its own.
  std::uint64_t rings_of(std::uint32_t k, std::uint64_t m) {
    const Process& p = processes_[k];
    auto n = std::count(p.retired.begin(), p.retired.end(), m);
    for (const auto& [c, ring] : rings_) {
      if (ring.owner == k && !ring.orphan) n += std::count(ring.slots.begin(), ring.slots.end(), m);
    }
    return static_cast<std::uint64_t>(n) + references_of(k, m);
  }
  std::uint64_t references_of(std::uint32_t home, std::uint64_t m) {
    std::uint64_t n = 0;
    for (const Message& other : messages_) {
      if (other.home == home && !other.destroyed) {
        n += static_cast<std::uint64_t>(
            std::count(other.refers_to.begin(), other.refers_to.end(), m));
      }
    }
    return n;
  }
  std::uint64_t pointers_of(std::uint32_t k, std::uint64_t m) {
    const Process& p = processes_[k];
    return static_cast<std::uint64_t>(std::count(p.pointers.begin(), p.pointers.end(), m) +
                                      std::count(p.loans.begin(), p.loans.end(), m));
  }
  bool holds(std::uint32_t k, std::uint64_t m) {
    return processes_[k].entered && pointers_of(k, m) + rings_of(k, m) != 0;
  }
  /// True when the orphanage must hold it.
  bool needed(std::uint64_t m) {
    for (const auto& [c, ring] : rings_) {
      if (!ring.orphan) continue;
      if (ring.names(m)) return true;
      for (const Process& p : processes_) {
        const auto borrow = p.borrows.find(c);
        if (!ring.blocking && borrow != p.borrows.end() && borrow->second == m) return true;
      }
    }
    return references_of(0, m) != 0;
  }
  bool held(std::uint64_t m) {
    if (needed(m)) return true;
    for (std::uint32_t k = 1; k <= kProcesses; ++k) {
      if (holds(k, m)) return true;
    }
    return false;
  }
  std::optional<std::uint64_t> living_in(std::uint32_t b) const {
    for (std::uint64_t m = messages_.size(); m-- > 0;) {
      if (messages_[m].block == b && !messages_[m].dead) return m;
    }
    return std::nullopt;
  }

  /// Which messages have died since: only those that nobody held, but for others that died.
  void destroy_the_dead() {
    for (bool any = true; any;) {
      any = false;
      for (std::uint64_t m = 0; m < messages_.size(); ++m) {
        Message& message = messages_[m];
        if (message.destroyed || message.home == 0) continue;
        if (!message.dead && has_died(message) && !held(m)) message.dead = any = true;
        if (message.dead && processes_[message.home].real &&
            local_.segment().arena(message.block).references == 0) {
          message.destroyed = any = true;
        }
      }
    }
    for (const Message& message : messages_) {
      require(message.dead || message.home == 0 || !has_died(message),
              "a message that died was held by nobody");
    }
  }
  bool has_died(const Message& message) const {
    return generation(message.block) != message.generation;
  }

  void check() {
    destroy_the_dead();
    for (std::uint64_t m = 0; m < messages_.size(); ++m) {
      if (!messages_[m].dead) check_message(m);
    }
    for (std::uint32_t b = 0; b < kBlocks; ++b) check_block(b);
    for (const Process& p : processes_) {
      for (const auto& [c, m] : p.borrows) require(!messages_[m].dead, "what is borrowed lives");
    }
    if (steps_ % 16 == 0) check_granules();
    std::set<std::uint64_t> once;
    for (const std::uint64_t m : destroyed) {
      require(once.insert(m).second && messages_[m].dead,
              "a message is destroyed once, when it died");
    }
  }

  void check_granules() {
    auto& granules = local_.segment().granules();
    for (std::uint32_t i = 0; i < granules.count(); ++i) {
      const std::uint32_t tag = granules.tag(i);
      if (tag == 0) continue;
      if ((tag & lot::segment::kRingTag) != 0) {
        require(rings_.count(tag & ~lot::segment::kRingTag) != 0,
                "a ring that has memory is there");
      } else {
        require(tag <= kBlocks && local_.world().block(tag - 1).home.load() != 0,
                "a block that has memory is used");
      }
    }
  }

  void check_message(std::uint64_t m) {
    const Message& message = messages_[m];
    require(local_.world().block(message.block).home.load() == message.home + 1,
            "whose memory it is");
    const auto& payload = *reinterpret_cast<const Payload*>(local_.segment().small(message.block));
    require(payload.number == m && payload.echo == ~m, "the payload of a message that lives");
    Numbers blocks;
    local_.world().each_reference(message.block, [&](std::uint32_t b) { blocks.push_back(b); });
    Numbers expected;
    for (const std::uint64_t target : message.refers_to) expected.push_back(block(target));
    require(blocks == expected, "what a message refers to");
  }

  void check_block(std::uint32_t b) {
    auto& words = local_.world().block(b);
    const auto m = living_in(b);
    for (std::uint32_t k = 1; k <= kProcesses; ++k) {
      const bool at_home = words.home.load() == k + 1;
      const bool own = (words.own[0].load() >> k & 1) != 0;
      require(own == (at_home || (m && holds(k, *m))), "who holds a block");
      require(!at_home || processes_[k].entered, "whose home a block has");
      if (!processes_[k].real) continue;
      const std::uint64_t word = processes_[k].real->controls[b].hold.load();
      const std::uint64_t rings = (word & hold::kRingMask) / hold::kRing;
      const std::uint64_t pointers = m ? pointers_of(k, *m) : 0;
      const std::uint64_t named = m ? rings_of(k, *m) : 0;
      require((word & hold::kBusy) == 0 && ((word & hold::kHeld) != 0) == own &&
                  ((word & hold::kHome) != 0) == at_home,
              "what a process knows of its bit");
      // A pool holds its idle blocks by one pointer, or by the hold of the ring that they left.
      const bool idle = at_home && pointers + named == 0;
      require(hold::pointers(word) == pointers || (idle && !m && hold::pointers(word) == 1),
              "how many pointers a process has");
      require(rings == named || (at_home && rings == named + 1), "how many rings hold a block");
    }
    if ((words.own[0].load() & 1) == 0)
      require(!m || !needed(*m), "the orphanage holds what it must");
  }

  /// Everybody lets go of everything and leaves: nothing may be left.
  void end() {
    for (self_ = 1; self_ <= kProcesses; ++self_) {
      Process& p = processes_[self_];
      if (!p.real) continue;
      while (!p.pointers.empty()) drop(p, 0);
      while (!p.loans.empty()) abandon(p);
      while (!p.real->readers.empty()) leave_ring(p);
      check();
    }
    for (Process& p : processes_) {
      if (!p.real) continue;
      scan(p);
      for (auto& pool : p.real->pools) pool->trim(true);
    }
    check();
    for (std::uint64_t m = 0; m < messages_.size(); ++m) {
      const Message& message = messages_[m];
      const Process& home = processes_[message.home];
      if (message.plain || !message.dead || !home.real || home.life != message.life) continue;
      require(std::count(destroyed.begin(), destroyed.end(), m) == 1, "what died was destroyed");
    }
    check_granules();
    for (std::uint32_t k = 1; k <= kProcesses; ++k) {
      if (processes_[k].entered) reap(k);
      check();
    }
    collect();
    const lot::testing::Audit audit(local_.segment());
    if (!audit.nothing()) std::fprintf(stderr, "%s\n", audit.text().c_str());
    require(audit.nothing(), "nothing is left behind");
  }

  /// Makes one of the mistakes that check() must find.
  void spoil() {
    if (++steps_ % 8 != 0) return;
    for (std::uint64_t m = 0; m < messages_.size(); ++m) {
      if (messages_[m].dead || !held(m)) continue;
      auto& words = local_.world().block(block(m));
      if (planted("lost_hold")) lot::test::raw(words.own[0]) = 0;
      if (planted("leaked_hold")) lot::test::raw(words.own[0]) |= 14;
      if (planted("early_death")) ++lot::test::raw(words.life);
      if (planted("stolen_home")) lot::test::raw(words.home) = lot::refcount::kHomeFree;
      if (planted("changed_payload")) ++*local_.segment().small(block(m));
      if (planted("lost_references")) local_.segment().arena(block(m)).references = 0;
    }
    if (planted("leaked_granule")) local_.segment().claim_run(1, kBlocks + 1);
    if (planted("lost_ring")) local_.segment().claim_run(1, lot::segment::kRingTag | 7);
  }

  // ---- small things
  // -------------------------------------------------------------------------------

  std::uint32_t block(std::uint64_t m) const { return messages_[m].block; }
  ControlBlock& control(Process& p, std::uint64_t m) const {
    return p.real->holder.control(block(m));
  }
  std::uint32_t generation(std::uint32_t b) const {
    return lot::refcount::generation_of(local_.world().block(b).life.load());
  }
  static bool room(Process& p) { return p.real->writer.room(); }

  std::optional<std::uint64_t> pick(const Numbers& all) {
    const std::size_t i = bytes_.below(all.size());
    return all.empty() ? std::nullopt : std::optional(all[i]);
  }
  template <class Key, class Of>
  typename std::map<Key, Of>::iterator pick(std::map<Key, Of>& all) {
    auto at = all.begin();
    std::advance(at, bytes_.below(all.size()));
    return at;
  }

  LocalSegment& local_;
  Bytes bytes_;
  std::uint32_t self_ = 0;
  unsigned steps_ = 0;
  std::array<Process, kProcesses + 1> processes_;  ///< the first is nobody
  std::map<std::uint32_t, RingModel> rings_;       ///< by channel
  std::vector<Message> messages_;                  ///< by number
  Numbers weak_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static auto* const local =
      new LocalSegment({6 << 20, kProcesses + 1, kBlocks, 1, kProcesses + 2, kProcesses + 1});
  Fuzz(*local, Bytes(data, size)).run();
  return 0;
}
