// SPDX-License-Identifier: Apache-2.0
#include "registry/registry.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>
#include <ranges>
#include <string>

#include "lot/error.hpp"

#include "description/wire.hpp"
#include "futex/futex.hpp"
#include "lockfree_ring/sleep.hpp"
#include "robust_mutex/robust_mutex.hpp"

namespace lot::registry {
namespace {

using segment::Atomics;

constexpr std::chrono::milliseconds kPatience{4800};

/// `bits`: users or observers of a topic.
bool has_any(const auto& bits) {
  return std::any_of(std::begin(bits), std::end(bits), [](const auto& word) {
    return word.load(std::memory_order_acquire) != 0;  // edge "users"
  });
}

std::string describe(std::string_view name, std::uint64_t size, std::uint64_t align) {
  return std::string(name) + " (" + std::to_string(size) + " bytes, alignment " +
         std::to_string(align) + ")";
}

std::uint64_t bit(std::uint32_t p) { return std::uint64_t{1} << (p % Atomics::kBitsPerWord); }

void check_name(std::string_view name) {
  if (name.empty() || name.size() >= segment::kTopicNameBytes ||
      name.find('\0') != std::string_view::npos) {
    throw Error(EINVAL, std::string(name), "not a name for a topic",
                "use 1 to " + std::to_string(segment::kTopicNameBytes - 1) + " bytes");
  }
}

std::string_view text(const char* bytes, std::size_t room) { return {bytes, strnlen(bytes, room)}; }

std::string_view name_of(const detail::MessageType& type) {
  return std::string_view(type.name).substr(0, segment::kTypeNameBytes - 1);
}

/// What the topic and this side know of the names of fields, where one of them does not know all.
/// Nothing differs where the topic has no description, or a damaged one.
description::Names names_of(const segment::Segment& segment, const segment::TopicEntry& topic,
                            const detail::Described& here) {
  const std::uint64_t word = topic.description.load(std::memory_order_relaxed);  // the lock
  if (word == 0 || !here.has_names) return {};
  const auto there = TypeTable(segment).copy(word);
  return there ? description::compare_names(*there, here.bytes) : description::Names{};
}

/// Whether the topic carries the type. Names of fields count where both sides know them.
bool carries(const segment::Segment& segment, const segment::TopicEntry& topic,
             const detail::MessageType& type) {
  if (text(topic.type_name, sizeof(topic.type_name)) != name_of(type) ||
      topic.type_size != type.size || topic.type_align != type.align ||
      topic.type_hash != type.hash) {
    return false;
  }
  if (type.described == nullptr) return topic.type_layout == 0;
  const detail::Described& here = type.described(type);
  const std::uint64_t names = topic.type_names.load(std::memory_order_relaxed);  // the lock
  if (topic.type_layout != here.layout) return false;
  if (names != 0 && here.names != 0) return names == here.names;
  return !names_of(segment, topic, here).differ;
}

[[noreturn]] void refuse_subscribers(const std::string& path, std::uint64_t subscribers,
                                     std::uint32_t readers) {
  throw Error(EUSERS, path,
              "the topic has " + std::to_string(subscribers) +
                  " subscribers, and a publisher has " + std::to_string(readers) +
                  " readers at most",
              "make the segment with a larger EngineOptions::readers");
}

[[noreturn]] void refuse_channel(const std::string& path, std::size_t channels) {
  throw Error(ENOSPC, path, "all " + std::to_string(channels) + " channels are in use",
              "make the segment with a larger EngineOptions::channels; " +
                  segment::command("ls", path) +
                  " shows queues whose items wait though their putters have gone");
}

}  // namespace

Registry::Lock::Lock(Registry& registry) : registry_(registry) {
  RobustMutex mutex = registry.mutex();
  for (std::chrono::milliseconds waited{0};
       mutex.lock_for(LockOwner::kStoppedPatience) == RobustMutex::Outcome::Busy;) {
    registry.owner_.require_place(registry.segment_.path());
    const auto stopped = registry.owner_.stopped(mutex.holder());
    if (!stopped.process.empty()) {
      throw Error(EBUSY, registry.segment_.path(),
                  stopped.process + " is stopped while it has the registry's lock", stopped.advice);
    }
    waited += LockOwner::kStoppedPatience;
    if (waited < kPatience) continue;
    throw Error(EBUSY, registry.segment_.path(),
                "another process has held the registry's lock all the time",
                "look for a stopped process that uses it, of another user or in another container "
                "(state T in ps), and continue or kill it");
  }
}
Registry::Lock::~Lock() { registry_.unlock(); }

bool Registry::try_lock() noexcept { return mutex().try_lock() != RobustMutex::Outcome::Busy; }
void Registry::unlock() noexcept { mutex().unlock(); }
RobustMutex Registry::mutex() const noexcept { return {segment_.directory().lock.word, owner_}; }

Registry::Found Registry::find(std::string_view name, const detail::MessageType* type) const {
  const auto topics = segment_.topics();
  const std::vector<bool> waits = topics_with_items();
  Found found;
  for (std::size_t i = 0; i < topics.size(); ++i) {
    segment::TopicEntry& topic = topics[i];
    const bool lasts = waits[i] || has_any(topic.users);
    if (!lasts && !has_any(topic.observers)) {
      if (found.free == nullptr) found.free = &topic;
    } else if (text(topic.name, sizeof(topic.name)) == name) {
      if (lasts) {
        found.lasting = &topic;
        break;
      }
      if (type == nullptr || carries(segment_, topic, *type)) found.observed = &topic;
    }
  }
  return found;
}

std::uint32_t Registry::enter(std::string_view name, const detail::MessageType& type,
                              std::uint32_t participant, Role role) {
  check_name(name);
  const Found found = find(name, &type);
  segment::TopicEntry* const topic = found.lasting != nullptr    ? found.lasting
                                     : found.observed != nullptr ? found.observed
                                                                 : found.free;
  if (topic == nullptr) {
    throw Error(ENOSPC, segment_.path(),
                "all " + std::to_string(segment_.topics().size()) + " topics are in use",
                "make the segment with a larger EngineOptions::topics");
  }
  if (topic == found.free) {
    make_topic(*topic, name, type);
  } else if (!carries(segment_, *topic, type)) {
    refuse_type(*topic, type);
  } else if (type.described != nullptr) {
    name_fields(*topic, type.described(type));
  }
  auto& bits = role == Role::User ? topic->users : topic->observers;
  bits[participant / Atomics::kBitsPerWord].fetch_or(bit(participant),
                                                     std::memory_order_release);  // edge "users"
  return static_cast<std::uint32_t>(topic - segment_.topics().data());
}

/// No process finds the topic until a user's bit stands, and none makes a ring there before. If
/// this process is killed in between, the entry is still free.
void Registry::make_topic(segment::TopicEntry& free, std::string_view name,
                          const detail::MessageType& type) {
  const std::string_view type_name = name_of(type);
  free.type_size = type.size;
  free.type_align = type.align;
  free.type_hash = type.hash;
  free.type_layout = 0;
  // Relaxed: a user's bit carries them (edge "users").
  free.type_names.store(0, std::memory_order_relaxed);
  free.description.store(0, std::memory_order_relaxed);  // the same
  std::memset(free.name, 0, sizeof(free.name));
  std::memset(free.type_name, 0, sizeof(free.type_name));
  std::memcpy(free.name, name.data(), name.size());
  std::memcpy(free.type_name, type_name.data(), type_name.size());
  if (type.described == nullptr) return;
  const detail::Described& described = type.described(type);
  free.type_layout = described.layout;
  free.type_names.store(described.names, std::memory_order_relaxed);  // edge "users" carries it
  free.description.store(TypeTable(segment_).place(described.bytes, descriptions()),
                         std::memory_order_relaxed);  // edge "users" carries it
}

void Registry::name_fields(segment::TopicEntry& topic, const detail::Described& described) {
  // Relaxed: the lock carries both words to the process that changes them.
  const bool had_names = topic.type_names.load(std::memory_order_relaxed) != 0;
  const std::uint64_t before = topic.description.load(std::memory_order_relaxed);
  std::string_view bytes = described.bytes;
  std::uint64_t names = described.names;
  description::Names known;
  if (names == 0) {
    if (had_names) return;
    known = names_of(segment_, topic, described);
    if (!known.here_knows_more) return;
    if (known.topic_knows_more) {
      bytes = known.merged;
      names = known.merged_names;
    }
  } else if (had_names && before != 0) {
    return;
  }
  // The description says all: names_of() reads it where the hash is missing. A process that is
  // killed between the two steps has named the fields; the next one that knows all brings the hash.
  const std::uint64_t word = TypeTable(segment_).place(bytes, descriptions());
  // Relaxed: the lock carries both.
  if (word != 0) topic.description.store(word, std::memory_order_relaxed);
  topic.type_names.store(names, std::memory_order_relaxed);
}

std::shared_ptr<const KnownType> Registry::type_of(std::string_view name) const {
  const Found found = find(name, nullptr);
  const segment::TopicEntry* const topic =
      found.lasting != nullptr ? found.lasting : found.observed;
  if (topic == nullptr) return nullptr;
  const std::uint64_t word = topic->description.load(std::memory_order_relaxed);  // the lock
  std::optional<std::string> bytes("");
  if (word != 0) bytes = TypeTable(segment_).copy(word);
  return std::make_shared<const KnownType>(
      std::string(text(topic->type_name, sizeof(topic->type_name))), *topic, std::move(bytes));
}

std::vector<std::string> Registry::names() const {
  std::vector<std::string> found;
  for (const segment::TopicEntry& topic : segment_.topics()) {
    if (has_any(topic.users)) found.emplace_back(text(topic.name, sizeof(topic.name)));
  }
  return found;
}

bool Registry::is_superseded(std::uint32_t topic) const {
  const segment::TopicEntry& mine = segment_.topics()[topic];
  const Found found = find(text(mine.name, sizeof(mine.name)), nullptr);
  return found.lasting != nullptr && found.lasting != &mine;
}

std::vector<std::uint64_t> Registry::descriptions() const {
  const std::vector<bool> waits = topics_with_items();
  std::vector<std::uint64_t> words;
  for (std::size_t i = 0; i < waits.size(); ++i) {
    const segment::TopicEntry& topic = segment_.topics()[i];
    const std::uint64_t word = topic.description.load(std::memory_order_relaxed);  // the lock
    if (word != 0 && (waits[i] || has_any(topic.users) || has_any(topic.observers))) {
      words.push_back(word);
    }
  }
  return words;
}

void Registry::refuse_type(const segment::TopicEntry& topic,
                           const detail::MessageType& type) const {
  const auto there = text(topic.type_name, sizeof(topic.type_name));
  std::string difference;
  const std::uint64_t word = topic.description.load(std::memory_order_relaxed);  // the lock
  if (word != 0 && type.described != nullptr && there == name_of(type)) {
    const auto bytes = TypeTable(segment_).copy(word);
    const auto theirs = bytes ? description::decode(*bytes) : std::nullopt;
    const auto ours = description::decode(type.described(type).bytes);
    if (theirs && ours) difference = description::first_difference(*theirs, *ours);
  }
  if (difference.empty() && there == name_of(type) && topic.type_hash != type.hash) {
    difference =
        "their TypeIdentity::hash() differs, or the standard library that they are built with";
  }
  throw Error(EPROTOTYPE, std::string(text(topic.name, sizeof(topic.name))),
              "the topic carries " + describe(there, topic.type_size, topic.type_align) +
                  ", this side wants " + describe(name_of(type), type.size, type.align) +
                  (difference.empty() ? "" : "; " + difference),
              "build both sides with the same definition of the message, or use another topic");
}

void Registry::leave(std::uint32_t topic, std::uint32_t participant, Role role) noexcept {
  auto& entry = segment_.topics()[topic];
  auto& bits = role == Role::User ? entry.users : entry.observers;
  // Release, edge "users": a process that finds no user makes another topic of the entry.
  bits[participant / Atomics::kBitsPerWord].fetch_and(~bit(participant), std::memory_order_release);
}

void Registry::add_puller(std::uint32_t topic, std::uint32_t participant) noexcept {
  // Release: edge "pullers".
  segment_.topics()[topic].pullers[participant].fetch_add(1, std::memory_order_release);
}
void Registry::remove_puller(std::uint32_t topic, std::uint32_t participant) noexcept {
  // Relaxed: the lock carries it.
  segment_.topics()[topic].pullers[participant].fetch_sub(1, std::memory_order_relaxed);
}

bool Registry::has_pullers(std::uint32_t topic, std::uint32_t participant) const noexcept {
  const auto& pullers = segment_.topics()[topic].pullers[participant];
  return pullers.load(std::memory_order_acquire) != 0;  // edge "pullers"
}

std::uint32_t Registry::pullers(std::uint32_t topic, std::uint32_t participant) const noexcept {
  // An index that no process has subscribes to nothing, whatever a wild write has put there.
  // Relaxed: the lock carries what a participant stored before it announced its puller.
  return segment_.participants()[participant].state.load(std::memory_order_relaxed) == 0
             ? 0
             : segment_.topics()[topic].pullers[participant].load(std::memory_order_relaxed);
}

void Registry::unsubscribe(std::uint32_t participant) noexcept {
  for (auto& topic : segment_.topics()) {
    auto& pullers = topic.pullers[participant];
    if (pullers.load(std::memory_order_relaxed) != 0) {  // the dead one's byte lock carries it
      pullers.store(0, std::memory_order_seq_cst);       // R13
    }
  }
}

void Registry::forget(std::uint32_t participant) noexcept {
  const auto clear = [mine = bit(participant)](auto& word) {
    // Relaxed: the dead one's byte lock carries its bit.
    if ((word.load(std::memory_order_relaxed) & mine) != 0) {
      word.fetch_and(~mine, std::memory_order_release);  // edge "users"
    }
  };
  for (auto& topic : segment_.topics()) {
    clear(topic.users[participant / Atomics::kBitsPerWord]);
    clear(topic.observers[participant / Atomics::kBitsPerWord]);
  }
}

void Registry::remove(const Departure& departure, std::uint32_t participant) noexcept {
  if (departure.role == Role::Observer) return;  // nothing awaits it
  const auto channels = segment_.channels();
  for (std::uint32_t c = 0; c < channels.size(); ++c) {  // makes no list: this must not fail
    const auto w = channels[c].writer.load(std::memory_order_acquire);  // R7
    const auto state = ring::writer_state(w);
    const ChannelName name{c, ring::writer_generation(w)};
    const auto& known = departure.known;
    if ((state != ring::State::Live && state != ring::State::Orphan) ||
        detail::read_once(channels[c].topic) != departure.topic ||
        std::find(known.begin(), known.end(), name) != known.end()) {
      continue;
    }
    segment::Ring ring = segment_.ring(c);
    if (ring.unsubscribe(participant)) futex::wake_all(ring.space);
  }
  remove_puller(departure.topic, participant);
}

std::uint32_t Registry::granules_of(const RingOptions& options) noexcept {
  const std::uint64_t bytes = segment::Segment::ring_bytes(
      {options.depth, options.stride, options.taken == 0 || options.policy == Policy::Overwrite},
      options.readers, options.taken == segment::kFinished, options.extra);
  return static_cast<std::uint32_t>((bytes + segment::kGranule - 1) / segment::kGranule);
}

namespace {

/// Writes what the ring is to be into its entry. A warden without the registry's lock may still
/// look at the ring that was there before: so each word is written at once. R7 carries them all.
/// REQUIRES: this process has claimed the entry.
void describe(segment::ChannelEntry& entry, std::uint32_t topic, const RingOptions& options) {
  detail::write_once(entry.topic, topic);
  detail::write_once(entry.depth, options.depth);
  detail::write_once(entry.readers, options.readers);
  detail::write_once(entry.policy, static_cast<std::uint32_t>(options.policy));
  detail::write_once(entry.engine, static_cast<std::uint32_t>(options.engine));
  detail::write_once(entry.taken, static_cast<std::uint16_t>(options.taken));
  detail::write_once(entry.stride, options.stride);
  detail::write_once(entry.extra, options.extra);
  detail::write_once(entry.first,
                     options.first != 0 ? options.first : std::uint64_t{options.depth});
}

/// Writes what readers are told of the publisher. REQUIRES: the ring is INIT; the caller makes it.
void introduce(segment::RingHead& head, const segment::ParticipantEntry& publisher, bool stamps) {
  // As describe(): `lot` may still look at what was there before.
  for (std::size_t i = 0; i < sizeof(head.publisher); ++i) {
    detail::write_once(head.publisher[i], publisher.name[i]);
  }
  detail::write_once(head.stamps, std::uint32_t{stamps});
}

}  // namespace

std::optional<ChannelName> Registry::open(std::uint32_t topic, std::uint32_t participant,
                                          const RingOptions& options) {
  std::uint64_t awaited = 0;
  for (std::uint32_t p = 1; p < segment_.capacity().participants; ++p) {
    awaited += pullers(topic, p);
  }
  if (awaited > options.readers) refuse_subscribers(segment_.path(), awaited, options.readers);
  const auto channels = segment_.channels();
  for (std::uint32_t c = 0; c < channels.size(); ++c) {
    auto& entry = channels[c];
    // Acquire, as claim(): the process that set the entry free had recycled its ring.
    const ring::Word w = entry.writer.load(std::memory_order_acquire);
    if (ring::writer_state(w) != ring::State::Free) continue;
    if (!entry.writer.claim(w, participant)) continue;
    const std::uint32_t generation = ring::writer_generation(w) + 1;
    describe(entry, topic, options);
    const std::uint32_t granules = granules_of(options);
    const std::uint32_t run = segment_.claim_run(granules, segment::kRingTag | c);
    detail::write_once(entry.granules, granules);  // as describe()
    detail::write_once(entry.granule, run);
    if (run == segment::Granules<Atomics>::kNone) {
      entry.writer.free(generation);
      return std::nullopt;
    }
    // Survey and others look at rings that another process may recycle meanwhile.
    segment_.keep_run(run, granules);
    segment::Ring ring = segment_.unformed_ring(c);
    if (ring.depth == 0) {
      throw Error(EBADMSG, segment_.path(), "another process has changed a queue while it was made",
                  "end the process that writes where it should not, and try again");
    }
    segment::Segment::construct_queue_lock(ring);
    // R7 carries the zeros.
    if (ring.extra != nullptr) std::memset(ring.extra, 0, ring.readers * segment::kExtraBytes);
    introduce(segment::Segment::head_of(ring), segment_.participants()[participant],
              options.stamps);
    ring.format();
    // From here on a reaper looks at the cells.
    entry.formed.store(1, std::memory_order_seq_cst);  // R13, edge "formed"
    ring.await_pullers(
        segment_.capacity().participants, [&](std::uint32_t p) { return pullers(topic, p); },
        [&pullers = segment_.topics()[topic].pullers](std::uint32_t p) {
          return pullers[p].load(std::memory_order_seq_cst) != 0;  // R13
        });
    entry.writer.go_live(generation, participant);
    announce(topic);
    return ChannelName{c, generation};
  }
  refuse_channel(segment_.path(), channels.size());
}

std::vector<ChannelName> Registry::rings(std::uint32_t topic) const {
  std::vector<ChannelName> found;
  const auto channels = segment_.channels();
  for (std::uint32_t c = 0; c < channels.size(); ++c) {
    const auto w = channels[c].writer.load(std::memory_order_acquire);  // R7
    const auto state = ring::writer_state(w);
    if ((state == ring::State::Live || state == ring::State::Orphan) &&
        detail::read_once(channels[c].topic) == topic) {
      found.push_back({c, ring::writer_generation(w)});
    }
  }
  return found;
}

std::vector<bool> Registry::topics_with_items() const {
  std::vector<bool> found(segment_.capacity().topics, false);
  for (const auto& channel : segment_.channels()) {
    const ring::Word w = channel.writer.load(std::memory_order_acquire);  // R7
    if (w == 0) break;  // channels are taken lowest first: no later one was ever taken
    if (ring::writer_state(w) != ring::State::Orphan) continue;
    if (detail::read_once(channel.taken) == 0) continue;
    const auto c = static_cast<std::uint32_t>(&channel - segment_.channels().data());
    const std::uint32_t topic = detail::read_once(channel.topic);
    if (topic < found.size() && segment_.ring(c).has_news()) found[topic] = true;
  }
  return found;
}

bool Registry::is_open(const ChannelName& name) const noexcept {
  const auto& channel = segment_.channels()[name.channel];
  const auto w = channel.writer.load(std::memory_order_acquire);  // R7
  const auto state = ring::writer_state(w);
  if (ring::writer_generation(w) != name.generation) return false;
  // An ended ring without items may belong to an earlier topic in the same entry.
  return state == ring::State::Live ||
         (state == ring::State::Orphan && detail::read_once(channel.taken) != 0 &&
          segment_.ring(name.channel).has_news());
}

void Registry::recycle(std::uint32_t channel) noexcept {
  auto& entry = segment_.channels()[channel];
  // Before the tags go: a process that claims the memory then sees formed = 0 (G1). Release: an
  // observer that sees the 0 sees that the registry's lock is taken (edge "formed").
  entry.formed.store(0, std::memory_order_release);
  segment_.granules().release_if(
      [channel](std::uint32_t tag) { return tag == (segment::kRingTag | channel); });
}

void Registry::announce(std::uint32_t topic) noexcept {
  // Looks at the channels one by one and makes no list: this must not fail.
  const auto channels = segment_.channels();
  const auto is_of_topic = [&](std::uint32_t c) {
    const auto w = channels[c].writer.load(std::memory_order_acquire);  // R7
    return ring::writer_state(w) == ring::State::Live &&
           detail::read_once(channels[c].topic) == topic;
  };
  ring::announce(
      segment_.directory().version,
      std::views::iota(std::uint32_t{0}, static_cast<std::uint32_t>(channels.size())) |
          std::views::filter(is_of_topic) |
          std::views::transform([this](std::uint32_t c) { return segment_.ring(c); }),
      [](const auto& word) {
        if constexpr (sizeof(word) == sizeof(ring::Word)) {
          futex::wake_all(futex::low_half(word));
        } else {
          futex::wake_all(&word);
        }
      },
      [this](std::uint32_t c) { segment_.ring_ears(c); });
}

}  // namespace lot::registry
