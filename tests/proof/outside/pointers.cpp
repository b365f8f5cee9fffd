// SPDX-License-Identifier: Apache-2.0

// Pointers of each kind in three processes in lockstep, against a model of std::shared_ptr's: who
// points to what. Messages refer to others, are published, published again and kept, by blocks and
// in slots, by both queue engines; publishers close; at rest a process is killed and replaced. The
// first process has two copies of the library, which publish each other's messages: the model has
// four nodes.
//
// At every rest there is an exact account. For each block of the segment that is in use: which
// message it has, whose it is, which processes hold it, how many granules it has. This must be what
// the model says is alive, and nothing else. And each pointer says how many there are, a weak one
// whether its message lives, and unique() is true where nothing else can see the message.
//
// What a process need only do "soon" (a message that other processes have let go) is waited for,
// with a bound that is no promise.

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <list>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "pointers_node.hpp"
#include "refcount/ownership.hpp"
#include "run.hpp"
#include "support/janitor.hpp"
#include "support/processes.hpp"
#include "transport/pieces.hpp"

namespace lot::outside {
namespace {

constexpr unsigned kNodes = 4;
constexpr int kHost = 0, kTwin = 3;  ///< two nodes that are one process
constexpr int process_of(int node) { return node == kTwin ? kHost : node; }
constexpr unsigned kStepsToRest = 40;
constexpr int kNone = -1;
constexpr int kOrphan = -2;

/// A message, or the copy of one that was kept out of a slot.
struct Object {
  std::uint64_t serial;
  unsigned kind;
  int home;  ///< the node that has made it, or kOrphan
  std::uint64_t granules = 0;
  std::array<int, 2> refs{kNone, kNone};
  bool refers = false;  ///< it has noted references behind its body, which stays as it is then
  bool gone = false;    ///< a rest has seen that it is gone
};

/// A publisher's ring: all that it has pushed, of which it still has the newest.
struct Ring {
  int node;
  std::string publisher;
  unsigned kind;
  bool in_slots;
  std::size_t depth;
  bool ended = false;
  std::vector<int> log{};
  std::size_t oldest() const { return log.size() - std::min(log.size(), depth); }
};

struct Source {
  Ring* ring;
  std::size_t next;
};

/// What a node has of one kind.
struct Hand {
  Ring* ring = nullptr;  ///< of its pusher
  bool subscribed = false;
  std::uint64_t missed = 0;
  std::vector<Source> sources{};
  std::array<int, kUnique> unique;
  std::array<int, kShared> shared;
  std::array<int, kParts> part;
  std::array<int, kWeak> weak;
  Hand() {
    unique.fill(kNone);
    shared.fill(kNone);
    part.fill(kNone);
    weak.fill(kNone);
  }
};

/// A block in use.
struct Entry {
  std::uint64_t serial;
  int home;
  std::set<unsigned> holders;
  std::uint64_t granules;
  auto operator<=>(const Entry&) const = default;
};
using Account = std::vector<Entry>;

std::string to_string(const Account& account) {
  std::string text;
  for (const Entry& e : account) {
    text += "\n  " + std::to_string(e.serial) + " of " + std::to_string(e.home) + ", " +
            std::to_string(e.granules) + " granules, held by";
    for (const unsigned k : e.holders) text += " " + std::to_string(k);
  }
  return text.empty() ? " nothing" : text;
}

class Model {
 public:
  explicit Model(Run& run) : random_(run.random()) {
    options_ = testing::fresh(64 << 20);
    options_.processes = 8;
    options_.blocks = 512;
    options_.topics = 8;
    options_.channels = 32;
    options_.readers = 8;
    for (int k = 0; k < kTwin; ++k) start(k);
  }

  void step(unsigned n) {
    one_act();
    if (n % kStepsToRest != kStepsToRest - 1) return;
    rest();
    const std::uint64_t dice = random_.below(4);
    if (dice == 0) {
      kill(static_cast<int>(random_.below(kNodes)));
      rest();
    }
  }

  /// Without pointers and publishers nothing is left, while all live and when all have left.
  void end() {
    for (unsigned k = 0; k < kNodes; ++k) {
      for (unsigned kind = 0; kind < kKinds; ++kind) let_go(static_cast<int>(k), kind);
    }
    rest();
    require(expected().empty(), "the model is empty in the end");
    for (int k = 0; k < kTwin; ++k) require(node(k).puppet->leave() == 0, "a process leaves");
    require(testing::files_of(options_) == 0, "no file is left");
  }

 private:
  using Process = Puppet<PointerCommand, PointerAnswer>;
  struct Node {
    std::unique_ptr<Process> puppet;  ///< null: it is the twin
    std::string name;
    std::uint32_t index = 0;
    std::array<Hand, kKinds> hands;
  };

  void start(int k) {
    begin_node(k);
    std::string twin;
    if (k == kHost) twin = begin_node(kTwin).name;
    EngineOptions options = options_;
    options.name = node(k).name;
    node(k).puppet = std::make_unique<Process>(
        [options, twin] { return std::make_unique<PointerNode>(options, twin); });
    node(k).index = tell(k, Do::Settle, 0).index;
    if (k == kHost) node(kTwin).index = tell(kTwin, Do::Settle, 0).index;
    if (!segment_) segment_.emplace(options_.directory + "/" + options_.segment);
  }
  Node& begin_node(int k) {
    node(k) = Node();
    node(k).name = "node" + std::to_string(k) + "_" + std::to_string(lives_++);
    return node(k);
  }

  PointerAnswer tell(int k, Do what, unsigned kind, unsigned a = 0, unsigned b = 0,
                     std::uint64_t n = 0, std::uint64_t serial = 0) {
    return node(process_of(k))
        .puppet->act({what, static_cast<std::uint8_t>(kind), static_cast<std::uint8_t>(a),
                      static_cast<std::uint8_t>(b), static_cast<std::uint32_t>(n), serial,
                      k == kTwin});
  }
  Node& node(int k) { return nodes_[static_cast<unsigned>(k)]; }
  Hand& hand(int k, unsigned kind) { return node(k).hands[kind]; }
  Object& object(int i) { return objects_[static_cast<std::size_t>(i)]; }

  // ---- what is alive, by the model

  /// A ring that has ended may still have its messages, or be gone: a rest waits until it is.
  enum class Ended { MayHave, HasNothing };

  template <class F>
  void each_root(Ended ended, F&& f) {
    for (Node& n : nodes_) {
      for (Hand& h : n.hands) {
        for (const int o : h.unique) f(o);
        for (const int o : h.shared) f(o);
        for (const int o : h.part) f(o);
      }
    }
    for (const Ring& ring : rings_) {
      if (ring.in_slots || (ring.ended && ended == Ended::HasNothing)) continue;
      for (std::size_t i = ring.oldest(); i < ring.log.size(); ++i) f(ring.log[i]);
    }
  }
  std::vector<bool> alive(Ended ended = Ended::MayHave) {
    std::vector<bool> lives(objects_.size(), false);
    std::vector<int> to_follow;
    const auto reach = [&](int o) {
      if (o == kNone || lives[static_cast<std::size_t>(o)]) return;
      lives[static_cast<std::size_t>(o)] = true;
      to_follow.push_back(o);
    };
    each_root(ended, reach);
    while (!to_follow.empty()) {
      const int o = to_follow.back();
      to_follow.pop_back();
      for (const int target : object(o).refs) reach(target);
    }
    return lives;
  }

  long pointers(int k, int o) {
    const Hand& h = hand(k, object(o).kind);
    return std::count(h.shared.begin(), h.shared.end(), o) +
           std::count(h.part.begin(), h.part.end(), o);
  }
  bool has_in_ring(int k, int o) const {
    return std::any_of(rings_.begin(), rings_.end(), [&](const Ring& ring) {
      return ring.node == k && !ring.in_slots &&
             std::find(ring.log.begin() + static_cast<std::ptrdiff_t>(ring.oldest()),
                       ring.log.end(), o) != ring.log.end();
    });
  }
  /// A living message that node k has made refers to it. (kOrphan: of a process that has died.)
  bool refers(int k, int o, const std::vector<bool>& lives) {
    for (std::size_t i = 0; i < objects_.size(); ++i) {
      const Object& from = objects_[i];
      if (lives[i] && from.home == k && (from.refs[0] == o || from.refs[1] == o)) return true;
    }
    return false;
  }
  bool holds(int k, int o, const std::vector<bool>& lives) {
    const auto& unique = hand(k, object(o).kind).unique;
    return object(o).home == k || pointers(k, o) != 0 || has_in_ring(k, o) || refers(k, o, lives) ||
           std::find(unique.begin(), unique.end(), o) != unique.end();
  }

  long uses(int k, int o, const std::vector<bool>& lives) {
    long n = pointers(k, o);
    for (int other = 0; other < static_cast<int>(kNodes); ++other) {
      if (other == k) continue;
      n += object(o).home == other ? pointers(other, o) != 0 : holds(other, o, lives);
    }
    return n;
  }
  /// Nothing but the one pointer of node k can see it.
  bool is_alone(int k, int o, const std::vector<bool>& lives) {
    if (pointers(k, o) != 1 || has_in_ring(k, o)) return false;
    for (int other = kOrphan; other < static_cast<int>(kNodes); ++other) {
      if (other == kNone) continue;
      if (refers(other, o, lives)) return false;
      if (other >= 0 && other != k && holds(other, o, lives)) return false;
    }
    return true;
  }

  Account expected() {
    const std::vector<bool> lives = alive();
    Account account;
    for (std::size_t i = 0; i < objects_.size(); ++i) {
      if (!lives[i]) continue;
      const Object& o = objects_[i];
      Entry entry{o.serial, o.home, {}, o.granules};
      for (unsigned k = 0; k < kNodes; ++k) {
        if (holds(static_cast<int>(k), static_cast<int>(i), lives)) entry.holders.insert(k);
      }
      account.push_back(std::move(entry));
    }
    std::sort(account.begin(), account.end());
    return account;
  }

  // ---- what is alive, by the segment's own words

  int node_of(std::uint32_t index) const {
    for (unsigned k = 0; k < kNodes; ++k) {
      if (nodes_[k].index == index) return static_cast<int>(k);
    }
    return kNone;  // a process that is dead and not reaped
  }

  Account found() {
    using Own = refcount::Ownership<segment::Atomics>;
    segment::Segment& s = *segment_;
    std::vector<std::uint64_t> granules(s.capacity().blocks, 0);
    for (std::uint32_t i = 0; i < s.granules().count(); ++i) {
      const std::uint32_t tag = s.granules().tag(i);
      if (tag != 0 && (tag & segment::kRingTag) == 0) ++granules[tag - 1];
    }
    Account account;
    for (std::uint32_t b = 0; b < s.capacity().blocks; ++b) {
      auto& words = s.block(b);
      const std::uint32_t home = words.home.load();
      if (home == refcount::kHomeFree && granules[b] == 0) continue;
      Entry entry{*reinterpret_cast<const std::uint64_t*>(s.small(b)),
                  home == refcount::kHomeOrphanage ? kOrphan : node_of(home - 1),
                  {},
                  granules[b]};
      for (std::uint32_t k = 1; k < s.capacity().participants; ++k) {
        if ((Own::word(words, k).load() & Own::bit(k)) != 0) {
          entry.holders.insert(static_cast<unsigned>(node_of(k)));
        }
      }
      account.push_back(std::move(entry));
    }
    std::sort(account.begin(), account.end());
    return account;
  }

  // ---- a rest

  void rest() {
    std::string wrong;
    const bool good = testing::eventually(
        [&] {
          drain_ended();
          for (int k = 0; k < static_cast<int>(kNodes); ++k) tell(k, Do::Settle, 0);
          wrong = what_is_wrong();
          return wrong.empty();
        },
        std::chrono::seconds(pointer_plant.empty() ? 30 : 3));
    require(good, wrong);
    has_ended_ = false;
    const std::vector<bool> lives = alive();
    for (std::size_t i = 0; i < lives.size(); ++i) objects_[i].gone = !lives[i];
  }

  std::string what_is_wrong() {
    const Account has = found();
    const Account wants = expected();
    if (has != wants) {
      return "the segment has" + to_string(has) + "\nthe model has" + to_string(wants);
    }
    const std::vector<bool> lives = alive();
    for (unsigned k = 0; k < kNodes; ++k) {
      for (unsigned kind = 0; kind < kKinds; ++kind) {
        const PointerAnswer answer = tell(static_cast<int>(k), Do::Report, kind);
        const std::string wrong = wrong_cells(static_cast<int>(k), kind, answer.cells[kind], lives);
        if (!wrong.empty()) {
          return wrong + " of node " + std::to_string(k) + ", kind " + std::to_string(kind);
        }
      }
    }
    return "";
  }

  std::string wrong_cells(int k, unsigned kind, const Cells& cells,
                          const std::vector<bool>& lives) {
    const Hand& h = hand(k, kind);
    for (unsigned i = 0; i < kUnique; ++i) {
      if (cells.unique[i].serial != serial(h.unique[i])) return "unique " + std::to_string(i);
    }
    for (unsigned i = 0; i < kShared; ++i) {
      const std::string wrong = wrong_cell(k, h.shared[i], cells.shared[i], lives);
      if (!wrong.empty()) return wrong + " of shared " + std::to_string(i);
    }
    for (unsigned i = 0; i < kParts; ++i) {
      const std::string wrong = wrong_cell(k, h.part[i], cells.part[i], lives);
      if (!wrong.empty()) return wrong + " of part " + std::to_string(i);
    }
    for (unsigned i = 0; i < kWeak; ++i) {
      const int o = h.weak[i];
      const bool is_alive = o != kNone && lives[static_cast<std::size_t>(o)];
      const long wanted = is_alive ? uses(k, o, lives) : 0;
      if (is_alive != (cells.weak[i].serial != 0)) return "expired() of weak " + std::to_string(i);
      if (cells.weak[i].uses != wanted) return "use_count() of weak " + std::to_string(i);
    }
    return "";
  }
  std::uint64_t serial(int o) { return o == kNone ? 0 : object(o).serial; }

  std::string wrong_cell(int k, int o, const Cell& cell, const std::vector<bool>& lives) {
    if (cell.serial != serial(o)) return "the message " + std::to_string(cell.serial);
    if (o == kNone) return "";
    const long wanted = uses(k, o, lives);
    if (cell.uses != wanted) {
      return "use_count() " + std::to_string(cell.uses) + ", not " + std::to_string(wanted);
    }
    const bool alone = is_alone(k, o, lives);
    if (cell.alone && !alone) return "unique(), which others can see";
    if (!cell.alone && alone && object(o).home == k) return "unique(), which no other can see";
    return "";
  }

  // ---- what the nodes do

  int add(std::uint64_t serial, unsigned kind, int home) {
    objects_.push_back({serial, kind, home});
    return static_cast<int>(objects_.size() - 1);
  }

  static std::uint64_t granules_of(std::uint64_t numbers) {
    const std::uint64_t bytes = numbers * sizeof(std::uint32_t);
    return bytes >= detail::Build::kLargePiece ? transport::fit(bytes) : 0;
  }
  /// As few as fit into the small payload, or a run of their own, which no idle block keeps.
  std::uint64_t any_body() {
    return random_.chance(60) ? random_.below(9) : 17'000 + random_.below(33'000);
  }

  template <std::size_t N>
  unsigned pick(const std::array<int, N>&) {
    return static_cast<unsigned>(random_.below(N));
  }

  void one_act() {
    const int k = static_cast<int>(random_.below(kNodes));
    const unsigned kind = random_.chance(65) ? 0 : 1;
    Hand& h = hand(k, kind);
    switch (random_.below(16)) {
      case 0:
      case 1:
      case 2:
        return loan(k, kind, h);
      case 3:
        return h.ring != nullptr && random_.chance(15) ? close(k, kind, h) : advertise(k, kind, h);
      case 4:
        return h.subscribed && random_.chance(10) ? unsubscribe(k, kind, h) : subscribe(k, kind, h);
      case 5:
      case 6:
        return push(k, kind, h);
      case 7:
        return push_again(k, kind, h);
      case 8:
      case 9:
      case 10:
        if (h.subscribed) pull(k, kind, pick(h.shared));
        return;
      case 11:
        if (kind == 0) refer(k, h);
        return;
      case 12:
        return drop(k, kind, h);
      default:
        return point(k, kind, h);
    }
  }

  void loan(int k, unsigned kind, Hand& h) {
    const unsigned a = pick(h.unique);
    const std::uint64_t numbers = kind == 0 ? any_body() : 0;
    if (h.unique[a] != kNone && random_.chance(50)) {
      if (kind != 0 || object(h.unique[a]).refers) return;
      tell(k, Do::Regrow, kind, a, 0, numbers);
      object(h.unique[a]).granules = granules_of(numbers);
      return;
    }
    tell(k, Do::Loan, kind, a, 0, numbers, ++serials_);
    h.unique[a] = add(serials_, kind, k);
    object(h.unique[a]).granules = granules_of(numbers);
  }

  void advertise(int k, unsigned kind, Hand& h) {
    if (h.ring != nullptr) return;
    // One that the model could not tell from the new one.
    for (const Ring& ring : rings_) {
      if (ring.node == k && ring.kind == kind) return;
    }
    const std::size_t depth = 1 + random_.below(4);
    const bool fast_lane = random_.chance(60);
    const unsigned how = (fast_lane ? 1U : 0U) | (random_.chance(30) ? 2U : 0U);
    tell(k, Do::Advertise, kind, 0, 0, depth << 8 | how);
    rings_.push_back({k, node(k).name, kind, fast_lane && kind == 1, depth});
    h.ring = &rings_.back();
    for (int other = 0; other < static_cast<int>(kNodes); ++other) {
      Hand& reader = hand(other, kind);
      if (!reader.subscribed) continue;
      tell(other, Do::Look, kind);
      reader.sources.push_back({h.ring, 0});
    }
  }
  void close(int k, unsigned kind, Hand& h) {
    tell(k, Do::Close, kind);
    h.ring->ended = true;
    h.ring = nullptr;
  }
  void subscribe(int k, unsigned kind, Hand& h) {
    if (h.subscribed) return;
    for (const Ring& ring : rings_) {
      if (ring.ended) return;  // whether it finds that one is chance
    }
    tell(k, Do::Subscribe, kind);
    tell(k, Do::Look, kind);
    h.subscribed = true;
    h.missed = 0;
    for (Ring& ring : rings_) {
      if (ring.kind == kind) h.sources.push_back({&ring, ring.log.size()});
    }
  }
  void unsubscribe(int k, unsigned kind, Hand& h) {
    tell(k, Do::Unsubscribe, kind);
    h.subscribed = false;
    h.sources.clear();
  }

  void push(int k, unsigned kind, Hand& h) {
    const unsigned a = pick(h.unique);
    if (h.ring == nullptr || h.unique[a] == kNone) return;
    require(tell(k, Do::PushUnique, kind, a).status == Status::Ok, "a push");
    h.ring->log.push_back(std::exchange(h.unique[a], kNone));
  }
  void push_again(int k, unsigned kind, Hand& h) {
    const unsigned a = pick(h.shared);
    const bool has_twin = k == kHost || k == kTwin;
    const bool is_twins = has_twin && random_.chance(50);
    const int o = is_twins ? hand(k == kHost ? kTwin : kHost, kind).shared[a] : h.shared[a];
    if (h.ring == nullptr || o == kNone) return;
    const Do what = is_twins ? Do::PushTwins : Do::PushShared;
    require(tell(k, what, kind, a).status == Status::Ok, "a push of a shared message");
    h.ring->log.push_back(o);
  }

  /// False: there was no message.
  bool pull(int k, unsigned kind, unsigned to) {
    Hand& h = hand(k, kind);
    const PointerAnswer answer = tell(k, Do::Pull, kind, to);
    if (answer.serial == 0) {
      for (const Source& s : h.sources) {
        require(s.next == s.ring->log.size(), "a message is not delivered");
      }
      return false;
    }
    for (Source& s : h.sources) {
      if (s.ring->publisher != answer.publisher || answer.sequence < s.next) continue;
      const std::size_t next = std::max(s.next, s.ring->oldest());
      require(answer.sequence == next, "which message comes next");
      h.missed += next - s.next;
      require(answer.missed == h.missed, "how many messages were missed");
      const int o = s.ring->log[next];
      require(object(o).serial == answer.serial, "which message it is");
      s.next = next + 1;
      if (to != kDrop) h.shared[to] = s.ring->in_slots ? add(answer.serial, kind, k) : o;
      return true;
    }
    throw Differs("a message of a publisher that there is not, or a second time");
  }

  void refer(int k, Hand& h) {
    unsigned a = pick(h.unique);
    for (unsigned i = 0; i < kUnique && h.unique[a] == kNone; ++i) a = (a + 1) % kUnique;
    const unsigned b = static_cast<unsigned>(random_.below(2));
    const unsigned from = pick(h.shared);
    const unsigned to = pick(h.shared);
    if (random_.chance(30)) {
      if (h.shared[from] == kNone) return;
      tell(k, Do::Follow, 0, from, b, to);
      h.shared[to] = object(h.shared[from]).refs[b];
    } else if (h.unique[a] == kNone) {
      return;
    } else if (random_.chance(60) && h.shared[from] != kNone) {
      tell(k, Do::Refer, 0, a, b, from);
      object(h.unique[a]).refs[b] = h.shared[from];
      object(h.unique[a]).refers = true;
    } else {
      tell(k, Do::Unrefer, 0, a, b);
      object(h.unique[a]).refs[b] = kNone;
    }
  }

  void drop(int k, unsigned kind, Hand& h) {
    switch (random_.below(5)) {
      case 0:
        return drop_cell(k, kind, Do::DropUnique, h.unique);
      case 1:
      case 2:
        return drop_cell(k, kind, Do::DropShared, h.shared);
      case 3:
        return drop_cell(k, kind, Do::DropPart, h.part);
      default:
        return drop_cell(k, kind, Do::DropWeak, h.weak);
    }
  }
  template <std::size_t N>
  void drop_cell(int k, unsigned kind, Do what, std::array<int, N>& cells) {
    const unsigned a = pick(cells);
    tell(k, what, kind, a);
    cells[a] = kNone;
  }

  void point(int k, unsigned kind, Hand& h) {
    const unsigned a = pick(h.shared);
    const unsigned b = pick(h.shared);
    switch (random_.below(6)) {
      case 0: {
        const unsigned u = pick(h.unique);
        if (h.unique[u] == kNone) return;
        tell(k, Do::Share, kind, u, b);
        h.shared[b] = std::exchange(h.unique[u], kNone);
        return;
      }
      case 1:
        tell(k, Do::Copy, kind, a, b);
        h.shared[b] = h.shared[a];
        return;
      case 2: {
        const unsigned part = pick(h.part);
        if (h.shared[a] == kNone) return;
        tell(k, Do::Alias, kind, a, part);
        h.part[part] = h.shared[a];
        return;
      }
      case 3: {
        const unsigned weak = pick(h.weak);
        if (h.shared[a] == kNone) return;
        tell(k, Do::Weaken, kind, a, weak);
        h.weak[weak] = h.shared[a];
        return;
      }
      default:
        return lock(k, kind, h, pick(h.weak), b);
    }
  }

  /// What lives can be locked; what a rest has seen gone can not. In between its home may not have
  /// noticed yet that it is dead, and then it lives again.
  void lock(int k, unsigned kind, Hand& h, unsigned weak, unsigned to) {
    const int o = h.weak[weak];
    if (o == kNone) return;
    const bool lives = alive(Ended::HasNothing)[static_cast<std::size_t>(o)];
    const PointerAnswer answer = tell(k, Do::Lock, kind, weak, to);
    if (answer.serial == 0) return require(!lives, "a weak pointer to a living message");
    require(answer.serial == object(o).serial, "what a weak pointer leads to");
    require(!object(o).gone, "a weak pointer to a message that has died");
    h.shared[to] = o;
  }

  // ---- ends

  /// A ring that has ended goes when its readers have read it, and have seen that it ended: they
  /// look at every try of this rest.
  void drain_ended() {
    has_ended_ |= std::any_of(rings_.begin(), rings_.end(), [](const Ring& r) { return r.ended; });
    if (!has_ended_) return;
    for (int k = 0; k < static_cast<int>(kNodes); ++k) {
      for (unsigned kind = 0; kind < kKinds; ++kind) {
        while (hand(k, kind).subscribed && pull(k, kind, kDrop)) {
        }
        std::erase_if(hand(k, kind).sources, [](const Source& s) { return s.ring->ended; });
      }
    }
    rings_.remove_if([](const Ring& ring) { return ring.ended; });
  }

  void kill(int k) {
    const int process = process_of(k);
    node(process).puppet->kill9();
    for (Ring& ring : rings_) {
      if (ring.node < 0 || process_of(ring.node) != process) continue;
      ring.node = kNone;
      ring.ended = true;
    }
    for (Object& o : objects_) {
      if (o.home >= 0 && process_of(o.home) == process) o.home = kOrphan;
    }
    start(process);
  }

  void let_go(int k, unsigned kind) {
    Hand& h = hand(k, kind);
    for (unsigned i = 0; i < kUnique; ++i) tell(k, Do::DropUnique, kind, i);
    for (unsigned i = 0; i < kShared; ++i) tell(k, Do::DropShared, kind, i);
    for (unsigned i = 0; i < kParts; ++i) tell(k, Do::DropPart, kind, i);
    h.unique.fill(kNone);
    h.shared.fill(kNone);
    h.part.fill(kNone);
    if (h.ring != nullptr) close(k, kind, h);
  }

  Random& random_;
  EngineOptions options_;
  unsigned lives_ = 0;
  std::array<Node, kNodes> nodes_;
  std::optional<segment::Segment> segment_;
  std::deque<Object> objects_;
  std::list<Ring> rings_;
  std::uint64_t serials_ = 0;
  bool has_ended_ = false;  ///< a ring, since the last rest
};

int main(int argc, char** argv) {
  Run run(argc, argv, 1200, kPointerMistakes);
  testing::prefix();
  require(testing::start_janitor(), "a janitor");
  for (const Mistake& m : kPointerMistakes) {
    if (run.planted(m.name)) pointer_plant = m.name;
  }
  return run_model<Model>(run);
}

}  // namespace
}  // namespace lot::outside

// The linker (--wrap) sends the test's own calls to the second of each pair.

std::uint32_t
real_refer(lot::detail::Arena&, lot::detail::ControlBlock*, const void*, std::size_t) asm(
    "__real__ZN3lot6detail5referERNS0_5ArenaEPNS0_"
    "12ControlBlockEPKvm");
std::uint32_t
wrap_refer(lot::detail::Arena&, lot::detail::ControlBlock*, const void*, std::size_t) asm(
    "__wrap__ZN3lot6detail5referERNS0_5ArenaEPNS0_"
    "12ControlBlockEPKvm");
void real_unrefer(lot::detail::Arena&, std::uint32_t) noexcept
    asm("__real__ZN3lot6detail7unreferERNS0_5ArenaEj");
void wrap_unrefer(lot::detail::Arena&, std::uint32_t) noexcept
    asm("__wrap__ZN3lot6detail7unreferERNS0_5ArenaEj");

std::uint32_t wrap_refer(lot::detail::Arena& arena, lot::detail::ControlBlock* target,
                         const void* object, std::size_t bytes) {
  const std::uint32_t block = real_refer(arena, target, object, bytes);
  if (lot::outside::makes("unheld", 1)) real_unrefer(arena, block);
  return block;
}
void wrap_unrefer(lot::detail::Arena& arena, std::uint32_t block) noexcept {
  if (!lot::outside::makes("unlet", 1)) real_unrefer(arena, block);
}

int main(int argc, char** argv) { return lot::outside::main(argc, argv); }
