// SPDX-License-Identifier: Apache-2.0
#include "tool/observation.hpp"

#include <algorithm>
#include <cstring>
#include <set>
#include <thread>
#include <utility>

#include "liveness/death_notice.hpp"
#include "liveness/lock_file.hpp"
#include "transport/pool.hpp"
#include "transport/references.hpp"

namespace lot::tool {
namespace {

bool is_alive_in(const segment::Segment& s, const liveness::LockProbe& locks, std::uint32_t k) {
  return locks.is_held(k) ||
         // edge "seat"
         liveness::seat::stands(s.witnesses()[k].seat.load(std::memory_order_acquire));
}

using ring::Word;
using segment::Segment;
using Own = transport::HardwareOwnership;

constexpr std::size_t kMostComplaints = 20;
constexpr std::chrono::milliseconds kRecycling{10};

std::string text_of(const char* bytes, std::size_t room) { return {bytes, strnlen(bytes, room)}; }

double seconds_between(std::uint64_t earlier_ns, std::uint64_t later_ns) {
  return later_ns > earlier_ns ? static_cast<double>(later_ns - earlier_ns) * 1e-9 : 0.0;
}

/// Of the monotonic clock, in nanoseconds.
std::uint64_t now_by_clock() {
  const auto now = std::chrono::steady_clock::now().time_since_epoch();
  return static_cast<std::uint64_t>(now / std::chrono::nanoseconds(1));
}

/// What the warden of one participant has noted.
struct Noted {
  std::map<std::uint64_t, std::uint64_t> since_ns;  ///< by Sighting::what
  std::uint64_t looked_ns = 0;
  std::uint64_t youngest_ns = 0;
};

/// Looks at one segment, once.
///
/// Edges:   the observer writes no shared word, so it is never one side of a pair that both store.
///          Each of its loads is an acquire load. It is the reader's side of the edge that the line
///          names, and all later loads come after it.
class Observer {
 public:
  explicit Observer(Window& window) : s_(window.segment()), capacity_(s_.capacity()) {}

  Observation look() {
    seen_.instance = s_.header().identity.instance;
    seen_.persists = s_.keeps_files();
    find_processes();
    check_lock("registry", s_.directory().lock);
    check_lock("orphanage", s_.directory().orphanage);
    find_topics();
    for (std::uint32_t c = 0; c < capacity_.channels; ++c) find_channel(c);
    count_memory();
    find_references();
    note_queues();
    now_ns_ = now_by_clock();
    for (std::uint32_t b = 0; b < capacity_.blocks; ++b) find_message(b);
    return std::move(seen_);
  }

 private:
  void complain(const std::string& what) {
    if (seen_.damage.size() < kMostComplaints) seen_.damage.push_back(what);
  }

  bool is_alive(std::uint32_t k) const {
    const Process* p = seen_.process(k);
    return p != nullptr && p->alive;
  }
  bool taken(std::uint32_t k) const { return k < taken_.size() && taken_[k]; }

  void find_processes() {
    const liveness::LockProbe locks(s_.path() + ".lock");
    taken_.assign(capacity_.participants, false);
    noted_.resize(capacity_.participants);
    for (std::uint32_t k = 1; k < capacity_.participants; ++k) {
      auto& entry = s_.participants()[k];
      const std::uint32_t state = entry.state.load(std::memory_order_acquire);  // edge "state"
      if (state == 0) continue;
      if (state != 1)
        complain("process " + std::to_string(k) + ": its state is " + std::to_string(state));
      taken_[k] = true;
      const bool alive = is_alive_in(s_, locks, k);
      seen_.processes.push_back(
          {k, text_of(entry.name, sizeof(entry.name)), entry.pid, entry.since_ns, alive, 0});
      read_notes(k);
    }
  }

  void read_notes(std::uint32_t k) {
    const segment::Sightings& table = s_.sightings()[k];
    Noted& noted = noted_[k];
    // Acquire: the warden stores it last (release), so the places are of that look, or of a later
    // one.
    noted.looked_ns = table.looked_ns.load(std::memory_order_acquire);
    for (const auto& place : table.seen) {
      // Edge "sighting": the name, the time, and the name again. Relaxed: the acquire load of the
      // time comes before it.
      const std::uint64_t what = place.what.load(std::memory_order_acquire);
      const std::uint64_t since = place.since_ns.load(std::memory_order_acquire);
      if (what == 0 || place.what.load(std::memory_order_relaxed) != what) continue;
      noted.since_ns[what] = since;
      noted.youngest_ns = std::max(noted.youngest_ns, since);
    }
  }

  /// A dead process may have the lock: the next process that locks takes it over.
  /// Relaxed: only the number in the word is checked.
  void check_lock(const char* what, const segment::Lock& lock) {
    const std::uint32_t word = lock.word.load(std::memory_order_relaxed);
    if (word == 0 || lock::participant(lock::name(word)) < capacity_.participants) return;
    complain(std::string("the lock of the ") + what + ": its holder can not be");
  }

  void find_topics() {
    const auto topics = s_.topics();
    std::vector<bool> waits(topics.size(), false);  // a topic with items that wait needs no user
    for (const auto& channel : s_.channels()) {
      // R9
      const auto state = ring::writer_state(channel.writer.load(std::memory_order_acquire));
      const bool is_left =
          state == ring::State::Orphan && lot::detail::read_once(channel.taken) != 0;
      const std::uint32_t topic = lot::detail::read_once(channel.topic);
      if (is_left && topic < topics.size()) waits[topic] = true;
    }
    for (std::uint32_t t = 0; t < topics.size(); ++t) {
      const auto& entry = topics[t];
      Topic topic{t,
                  text_of(entry.name, sizeof(entry.name)),
                  text_of(entry.type_name, sizeof(entry.type_name)),
                  entry.type_size,
                  {},
                  waits[t],
                  {}};
      if (!topic.name.empty()) name_of_key_[segment::topic_key(topic.name)] = topic.name;
      topic.observers = participants_in(entry.observers, t, "an observer ");
      for (const std::uint32_t k : participants_in(entry.users, t, "a user ")) {
        topic.used = true;
        // Acquire: as the users before it.
        if (entry.pullers[k].load(std::memory_order_acquire) != 0) topic.subscribers.push_back(k);
      }
      if (topic.used || !topic.observers.empty()) seen_.topics.push_back(std::move(topic));
    }
  }

  /// The participants whose bits stand in a topic's users or observers.
  template <class Words>
  std::vector<std::uint32_t> participants_in(const Words& words, std::uint32_t topic,
                                             const char* what) {
    std::vector<std::uint32_t> found;
    for (std::uint32_t k = 0; k < segment::kMaxParticipants; ++k) {
      // Acquire, edge "users": name and type of the topic
      const auto bits = words[k / segment::Atomics::kBitsPerWord].load(std::memory_order_acquire);
      if ((bits & Own::bit(k)) == 0) continue;
      if (k == 0 || k >= capacity_.participants) {
        complain("topic " + std::to_string(topic) + ": " + what + std::to_string(k) +
                 " can not be");
      } else {
        found.push_back(k);
      }
    }
    return found;
  }

  /// A queue, and its writer word when the observer began to look at it.
  struct Looked {
    std::uint32_t channel;
    Word writer;
  };

  void complain_of(const Looked& at, const std::string& what) {
    auto& entry = s_.channels()[at.channel];
    // A process may recycle the queue meanwhile. Then the queue may look like anything until its
    // writer word says so, which takes long if that process is stopped with the registry's lock. So
    // the observer complains only if the queue is not being recycled and its writer word has not
    // changed.
    if (!std::exchange(has_waited_, true)) std::this_thread::sleep_for(kRecycling);
    // Acquire, edge "formed": it loads `formed`, then the lock's word, and the writer word last.
    const bool goes = ring::writer_state(at.writer) == ring::State::Orphan &&
                      entry.formed.load(std::memory_order_acquire) == 0 &&
                      s_.directory().lock.word.load(std::memory_order_acquire) != 0;
    if (!goes && entry.writer.load(std::memory_order_acquire) == at.writer) {
      complain("queue " + std::to_string(at.channel) + ": " + what);
    }
  }

  void find_channel(std::uint32_t c) {
    auto& entry = s_.channels()[c];
    const Word w = entry.writer.load(std::memory_order_acquire);  // R7
    const auto state = ring::writer_state(w);
    if (state == ring::State::Free || state == ring::State::Init) return;
    const Looked at{c, w};
    Channel channel;
    channel.channel = c;
    channel.generation = ring::writer_generation(w);
    channel.orphan = state == ring::State::Orphan;
    channel.publisher = ring::writer_owner(w);
    channel.topic = lot::detail::read_once(entry.topic);
    channel.policy = static_cast<Policy>(lot::detail::read_once(entry.policy));
    channel.engine = static_cast<QueueEngine>(lot::detail::read_once(entry.engine));
    if (state != ring::State::Live && state != ring::State::Orphan) {
      return complain_of(at, "its state is " + std::to_string(static_cast<unsigned>(state)));
    }
    if (channel.publisher >= capacity_.participants) {
      return complain_of(at, "its publisher can not be");
    }
    if (channel.topic >= capacity_.topics) return complain_of(at, "its topic can not be");
    const segment::Ring r = s_.ring(c);
    if (r.depth == 0) return complain_of(at, "its numbers make no sense");
    channel.depth = r.depth;
    channel.stamps = lot::detail::read_once(segment::Segment::head_of(r).stamps) == 1;
    channel.taken = r.taken;
    // The observer reads cursors before slots: so a reader is never ahead of the slots.
    const std::vector<Cursor> cursors = cursors_of(at, r);
    const bool marked = (r.space->load(std::memory_order_acquire) & 1) != 0;  // R6
    find_queue(at, r, channel);
    for (const Cursor& cursor : cursors) {
      channel.readers.push_back(reader_at(cursor, at, r, channel));
    }
    const bool full = r.taken ? channel.queue.size() == r.depth
                              : std::any_of(channel.readers.begin(), channel.readers.end(),
                                            [](const Reader& x) { return x.holds_back; });
    channel.waits = marked && !channel.orphan && is_alive(channel.publisher) && full;
    seen_.channels.push_back(std::move(channel));
  }

  /// Where one reader of a queue is.
  struct Cursor {
    std::uint32_t process;
    Word position;
  };

  std::vector<Cursor> cursors_of(const Looked& at, const segment::Ring& r) {
    std::vector<Cursor> cursors;
    for (std::uint32_t i = 0; i < r.readers; ++i) {
      const std::uint32_t who = r.who[i].load(std::memory_order_acquire);  // before its position
      if (who == 0) continue;
      if (who > capacity_.participants) {
        complain_of(at, "a reader of it can not be");
        continue;
      }
      const Word position = r.cells[i].position.load(std::memory_order_acquire);  // R3
      cursors.push_back({who - 1, position});
    }
    return cursors;
  }

  /// Reads the slots of a queue into the channel.
  void find_queue(const Looked& at, const segment::Ring& r, Channel& channel) {
    bool bad_slot = false;
    std::uint32_t newest = 0;
    const std::uint32_t places = r.places();
    std::vector<Word> slots(places);
    for (std::uint32_t i = 0; i < places; ++i) {
      slots[i] = r.slots[i].load(std::memory_order_acquire);  // R1
      if (ring::distance(ring::sequence(slots[i]), ring::sequence(slots[newest])) > 0) newest = i;
    }
    channel.next = ring::next(ring::sequence(slots[newest]));
    channel.published = static_cast<std::uint64_t>(
        std::max<std::int64_t>(0, ring::distance(channel.next, r.first & ring::kSequenceMask)));
    for (std::uint32_t n = 1 + places - r.depth; n <= places; ++n) {  // from the oldest
      const auto i = static_cast<std::uint32_t>((std::uint64_t{newest} + n) % places);
      const Word b = ring::block(slots[i]);
      if (b == ring::kNoBlock) continue;
      if (b >= capacity_.blocks && !(b == ring::kInSlot && r.in_slots())) {
        bad_slot = true;
        continue;
      }
      channel.queue.push_back({ring::sequence(slots[i]), static_cast<std::uint32_t>(b), i});
      if (r.claims != nullptr) {
        channel.unfinished += ring::is_claimed(r.claims[i], ring::sequence(slots[i]));
      }
    }
    if (bad_slot) complain_of(at, "a slot of it names a message that can not be");
  }

  /// REQUIRES: find_queue().
  Reader reader_at(const Cursor& cursor, const Looked& at, const segment::Ring& r,
                   const Channel& channel) {
    Reader reader{cursor.process};
    reader.awaited = ring::is_awaited(cursor.position);
    reader.observes = ring::is_observer(cursor.position);
    if (cursor.position == ring::kIdle || ring::is_joining(cursor.position) ||
        cursor.position == ring::kObserverJoins) {
      reader.joining = true;
      return reader;
    }
    const Word next_read = ring::sequence(cursor.position);
    const auto lag = ring::distance(channel.next, next_read);
    reader.lag = lag > 0 ? static_cast<std::uint64_t>(lag) : 0;
    if (r.taken) {
      reader.lag = static_cast<std::uint64_t>(std::count_if(
          channel.queue.begin(), channel.queue.end(),
          [&](const Queued& q) { return ring::distance(q.sequence, next_read) >= 0; }));
    }
    reader.lost = (!r.blocking || reader.observes) && !r.taken && reader.lag > r.depth
                      ? reader.lag - r.depth
                      : 0;
    reader.holds_back = r.blocking && !reader.observes && !r.taken && lag >= r.depth;
    if (channel.stamps && reader.lag != 0) reader.delay = delay_at(next_read, r, channel);
    const Word b = ring::block(cursor.position);
    if (b != ring::kNoBlock && b < capacity_.blocks) {
      borrows_.insert({{static_cast<std::uint32_t>(b), cursor.process}, channel.topic});
    } else if (b != ring::kNoBlock) {
      complain_of(at, "a reader of it borrows a message that can not be");
    }
    return reader;
  }

  /// How long ago the first message was pushed that a reader at this place will find. Nothing: it
  /// has gone meanwhile. REQUIRES: the publisher stamps.
  std::optional<double> delay_at(Word next_read, const segment::Ring& r, const Channel& channel) {
    const auto found =
        std::find_if(channel.queue.begin(), channel.queue.end(),
                     [&](const Queued& q) { return ring::distance(q.sequence, next_read) >= 0; });
    if (found == channel.queue.end()) return std::nullopt;
    std::uint64_t pushed = 0;
    if (r.in_slots()) {
      // The word said so when the queue was found.
      if (r.slots.read(found->slot, found->sequence, r.places(), nullptr, 0, &pushed) !=
          ring::Copy::Whole) {
        return std::nullopt;
      }
      return seconds_between(pushed, now_by_clock());
    }
    // Acquire: the time is that of the message in the slot, or of a later one of the same block.
    // Then the slot has changed before that time was written.
    pushed = __atomic_load_n(&s_.arena(found->block).pushed_ns, __ATOMIC_ACQUIRE);
    const Word slot = r.slots[found->slot].load(std::memory_order_acquire);  // R1
    if (ring::sequence(slot) != found->sequence || ring::block(slot) != found->block) {
      return std::nullopt;
    }
    return seconds_between(pushed, now_by_clock());
  }

  void count_memory() {
    granules_.assign(capacity_.blocks, 0);
    auto& granules = s_.granules();
    std::uint64_t used = 0;
    std::uint64_t strange = 0;
    for (std::uint32_t i = 0; i < granules.count(); ++i) {
      const std::uint32_t tag = granules.tag(i);
      if (tag == 0) continue;
      ++used;
      if ((tag & segment::kRingTag) != 0) {
        strange += (tag & ~segment::kRingTag) >= capacity_.channels;
      } else if (tag - 1 < capacity_.blocks) {
        ++granules_[tag - 1];
      } else {
        ++strange;
      }
    }
    if (strange != 0) {
      complain(std::to_string(strange) + " pieces of memory belong to what can not be");
    }
    seen_.memory = {used * segment::kGranule, std::uint64_t{granules.count()} * segment::kGranule};
    seen_.blocks.total = capacity_.blocks;
  }

  void find_references() {
    for (std::uint32_t b = 0; b < capacity_.blocks; ++b) {
      const std::uint32_t home = s_.block(b).home.load(std::memory_order_acquire);  // O3
      if (home == refcount::kHomeFree || home > capacity_.participants) continue;
      transport::each_reference(s_, b, [&](std::uint32_t target) {
        refers_.insert({target, home - 1});
      });
    }
  }

  void note_queues() {
    for (const Channel& channel : seen_.channels) {
      // An orphaned queue belongs to the orphanage once its publisher's name is gone.
      for (const Queued& q : channel.queue) {
        if (q.block == ring::kInSlot) continue;
        queues_.insert({q.block, {channel.publisher, q.sequence, channel.topic}});
      }
    }
  }

  Age age_of(std::uint32_t k, std::uint32_t b, std::uint32_t generation) const {
    const Noted& noted = noted_[k];
    const auto found = noted.since_ns.find(std::uint64_t{b + 1} << 32 | generation);
    if (found != noted.since_ns.end()) return {seconds_between(found->second, now_ns_), {}};
    if (noted.looked_ns == 0) return {};
    const bool full = noted.since_ns.size() == segment::Sightings::kMost;
    return {{}, seconds_between(full ? noted.youngest_ns : noted.looked_ns, now_ns_)};
  }

  /// The ownership words of a message, as they were at one moment.
  struct Owned {
    std::uint64_t own[segment::Atomics::kOwnWords];
    std::uint64_t life;
    std::uint32_t home;
    std::uint32_t home_points;
  };

  Owned owned(std::uint32_t b) {
    auto& words = s_.block(b);
    Owned seen{};
    // If the message dies meanwhile, the observer reads the words once more. The acquire loads keep
    // the words between the two looks at `life`.
    for (int tries = 0; tries < 3; ++tries) {
      seen.life = words.life.load(std::memory_order_acquire);
      seen.home = words.home.load(std::memory_order_acquire);
      seen.home_points = words.home_points.load(std::memory_order_acquire);
      for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
        seen.own[w] = words.own[w].load(std::memory_order_acquire);
      }
      if (words.life.load(std::memory_order_acquire) == seen.life) break;
    }
    return seen;
  }

  void find_message(std::uint32_t b) {
    const auto [own, life, home, home_points] = owned(b);
    if (home == refcount::kHomeFree) return;
    ++seen_.blocks.used;
    if (home > capacity_.participants) {
      return complain("message " + std::to_string(b) + ": who made it can not be");
    }
    const std::uint32_t maker = home - 1;
    const std::uint32_t generation = refcount::generation_of(life);
    const auto key = name_of_key_.find(s_.arena(b).topic);
    Message message{b,
                    generation,
                    maker,
                    key != name_of_key_.end() ? key->second : "",
                    granules_[b] != 0 ? granules_[b] * segment::kGranule : segment::kSmallBytes,
                    {}};
    for (auto& process : seen_.processes) {
      if (process.index == maker) process.bytes += message.bytes;
    }
    const auto add = [&](std::uint32_t k, Holder::How how) -> Holder& {
      return message.holders.emplace_back(Holder{k, how, {}, {}, {}});
    };
    const auto queues = queues_.equal_range(b);
    for (auto q = queues.first; q != queues.second; ++q) {
      Holder& holder = add(q->second.publisher, Holder::How::Queues);
      holder.sequence = q->second.sequence;
      holder.topic = q->second.topic;
    }
    const auto first = borrows_.lower_bound({{b, 0}, 0});
    for (auto i = first; i != borrows_.end() && i->first.first == b; ++i) {
      Holder& holder = add(i->first.second, Holder::How::Borrows);
      holder.topic = i->second;
      holder.age = age_of(i->first.second, b, generation);
    }
    for (std::uint32_t k = 0; k < segment::kMaxParticipants; ++k) {
      if ((own[k / segment::Atomics::kBitsPerWord] & Own::bit(k)) == 0) continue;
      if (k >= capacity_.participants || (k != 0 && !taken(k))) {
        // A process that has left or come meanwhile may have a bit here. A bit beyond the table is
        // damage.
        if (k >= capacity_.participants) {
          complain("message " + std::to_string(b) + ": a holder " + std::to_string(k) +
                   " can not be");
        }
        continue;
      }
      find_hold(message, k, home_points != 0);
    }
    if (message.holders.empty()) {
      add(maker, Holder::How::Spare);
      seen_.held_back += granules_[b] * segment::kGranule;
    }
    seen_.messages.push_back(std::move(message));
  }

  /// Finds out why process k has its bit on the message.
  void find_hold(Message& message, std::uint32_t k, bool home_points) {
    const auto has = [&](Holder::How how) {
      return std::any_of(message.holders.begin(), message.holders.end(),
                         [&](const Holder& h) { return h.process == k && h.how == how; });
    };
    const Age age = age_of(k, message.block, message.generation);
    const bool refers = refers_.contains({message.block, k});
    bool keeps;
    if (k == refcount::kOrphanage) {
      keeps = false;  // the message is in its queues, or about to be freed
    } else if (k == message.home) {
      keeps = home_points;
    } else if (has(Holder::How::Queues) || refers) {
      // The bit may stand for these alone: only the warden of process k knows of pointers.
      keeps = age.seconds.has_value() && !has(Holder::How::Borrows);
    } else {
      keeps = true;
    }
    if (refers) message.holders.push_back({k, Holder::How::Refers, {}, {}, {}});
    if (keeps) message.holders.push_back({k, Holder::How::Keeps, age, {}, {}});
  }

  struct QueuedAt {
    std::uint32_t publisher;
    std::uint64_t sequence;
    std::uint32_t topic;
  };

  Segment& s_;
  const segment::Capacity& capacity_;
  Observation seen_;
  std::uint64_t now_ns_ = 0;
  bool has_waited_ = false;
  std::vector<bool> taken_;
  std::vector<Noted> noted_;
  std::vector<std::uint64_t> granules_;  ///< by block
  std::map<std::uint64_t, std::string> name_of_key_;
  std::set<std::pair<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t>>
      borrows_;                                               ///< {{block, process}, topic}
  std::set<std::pair<std::uint32_t, std::uint32_t>> refers_;  ///< {block, process}
  std::multimap<std::uint32_t, QueuedAt> queues_;             ///< by block
};

}  // namespace

const char* to_string(Holder::How how) {
  switch (how) {
    case Holder::How::Keeps:
      return "keeps";
    case Holder::How::Borrows:
      return "borrows";
    case Holder::How::Queues:
      return "queues";
    case Holder::How::Refers:
      return "refers";
    case Holder::How::Spare:
      return "spare";
  }
  return "?";
}

const Process* Observation::process(std::uint32_t index) const {
  for (const auto& p : processes) {
    if (p.index == index) return &p;
  }
  return nullptr;
}

const Topic* Observation::topic(std::uint32_t index) const {
  for (const auto& t : topics) {
    if (t.index == index) return &t;
  }
  return nullptr;
}

std::string Observation::who(std::uint32_t index) const {
  if (index == refcount::kOrphanage) return "(gone)";
  const Process* p = process(index);
  return std::to_string(index) + (p != nullptr && !p->name.empty() ? " " + p->name : "");
}

Observation observe(Window& window) {
  Observation seen = Observer(window).look();
  if (window.torn()) seen.damage.push_back("it is shorter than it was when we began to look");
  return seen;
}

namespace {

std::vector<std::uint32_t> taken_by(Window& window, bool wanted_alive) {
  Segment& s = window.segment();
  const liveness::LockProbe locks(s.path() + ".lock");
  std::vector<std::uint32_t> found;
  for (std::uint32_t k = 1; k < s.capacity().participants; ++k) {
    const bool alive = is_alive_in(s, locks, k);
    // edge "state"
    const bool counts = alive || s.participants()[k].state.load(std::memory_order_acquire) != 0;
    if (counts && alive == wanted_alive) found.push_back(k);
  }
  return found;
}

}  // namespace

std::vector<std::uint32_t> living(Window& window) { return taken_by(window, true); }
std::vector<std::uint32_t> dead(Window& window) { return taken_by(window, false); }

Waiting waiting(Window& window) {
  const Segment& s = window.segment();
  Waiting found;
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    const std::uint32_t items = s.waiting_items(c);
    if (items == 0) continue;
    const std::uint32_t topic = lot::detail::read_once(s.channels()[c].topic);
    found[topic < s.capacity().topics ? text_of(s.topics()[topic].name, segment::kTopicNameBytes)
                                      : "?"] += items;
  }
  return found;
}

}  // namespace lot::tool
