// SPDX-License-Identifier: Apache-2.0

// Topics, their types, rings and who is alive: participants come, take topics or look on there,
// open rings, join those of others, leave, die and are reaped, up to the limits of every table. The
// model is sets, and a list of where descriptions lie; liveness is told by the kernel's locks, as
// in earnest.
//
// Input: operations, a byte each, with arguments behind it (corpus/registry/ has examples)

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "lot/fuzz.hpp"

#include "liveness/lock_file.hpp"
#include "support/directory.hpp"
#include "support/local_segment.hpp"
#include "support/plant.hpp"
#include "support/raw.hpp"

namespace {

using lot::detail::MessageType;
using lot::fuzz::Bytes;
using lot::fuzz::planted;
using lot::fuzz::require;
using lot::liveness::LockFile;
using lot::registry::ChannelName;
using lot::registry::Registry;
using lot::registry::Role;
using lot::ring::State;
using lot::testing::LocalSegment;
using Reader = lot::ring::Reader<lot::segment::Atomics>;

constexpr std::uint32_t kIndexes = 4;  ///< 0 is the orphanage
constexpr std::size_t kPlayers = 4;    ///< one more than there are indexes
constexpr std::uint32_t kTopics = 3;
constexpr std::uint32_t kChannels = 4;
constexpr std::uint32_t kReaders = 2;

/// A type that says what it is made of, or nothing.
struct Type : MessageType {
  /// Types of one group carry each other, where not both have names, and others.
  std::size_t group = 0;
  lot::detail::Described known;
};

Type silent(std::size_t group, std::uint64_t size, std::uint64_t hash, const char* name) {
  return {{size, 8, hash, name, nullptr, true, nullptr}, group, {}};
}
/// An Apple of eight numbers; `name`: what its fields are called.
Type told(std::size_t group, lot::Kind kind, const std::string& name) {
  lot::Description all;
  all.types.resize(2);
  all.types[0].kind = lot::Kind::Struct;
  all.types[0].size = 8;
  all.types[1].kind = kind;
  all.types[1].size = 1;
  for (std::uint64_t i = 0; i < 8; ++i) {
    all.types[0].fields.push_back({name.empty() ? "" : name + std::to_string(i), 1, i, 0, 0});
  }
  Type type = silent(group, 8, 0, "Apple");
  type.known = lot::detail::make_described(all);
  type.described = [](const MessageType& self) -> const lot::detail::Described& {
    return static_cast<const Type&>(self).known;
  };
  return type;
}

/// Their descriptions take one, two and four pieces of the table.
const Type kTypes[] = {silent(0, 8, 0, "Apple"),
                       silent(1, 8, 0, "Pear"),
                       silent(2, 8, 1, "Pear"),
                       silent(3, 16, 0, "Apple"),
                       told(4, lot::Kind::UInt, ""),
                       told(4, lot::Kind::UInt, "seed"),
                       told(4, lot::Kind::UInt, "a part of the apple's peel "),
                       told(5, lot::Kind::Int, "")};

/// Names of topics; the last ones are none.
const std::string kNames[] = {"/a",
                              "/b",
                              "/c",
                              "/d",
                              std::string(199, 'x'),
                              "",
                              std::string(200, 'x'),
                              std::string("/a\0b", 4)};
constexpr std::size_t kGoodNames = 5;

struct Topic {
  std::size_t name = 0;
  std::size_t type = 0;
  std::set<std::uint32_t> users{};
  std::set<std::uint32_t> observers{};
  std::size_t told = 0;     ///< the type whose names and description it has
  std::uint64_t piece = 0;  ///< where the description lies

  bool exists() const { return !users.empty() || !observers.empty(); }
  bool carries(std::size_t other) const {
    const std::uint64_t mine = kTypes[told].known.names, theirs = kTypes[other].known.names;
    return kTypes[type].group == kTypes[other].group &&
           (mine == theirs || mine == 0 || theirs == 0);
  }
};

struct Channel {
  State state = State::Free;
  std::uint32_t generation = 0;
  std::uint32_t topic = 0;
  std::uint32_t owner = 0;
  std::multiset<std::uint32_t> readers{};
};

/// A process; all of it goes when it dies.
struct Player {
  std::unique_ptr<LockFile> lock{};
  std::uint32_t index = 0;
  std::vector<std::uint32_t> topics{};    ///< a use each
  std::vector<std::uint32_t> observed{};  ///< the same, of an observer
  std::vector<ChannelName> rings{};
  std::vector<std::pair<std::uint32_t, Reader>> readers{};  ///< by channel
};

class Fuzz {
 public:
  Fuzz(LocalSegment& local, const std::string& lock_path, Bytes bytes)
      : local_(local), lock_path_(lock_path), watcher_(lock_path), bytes_(bytes) {
    local_.clear();
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
    Player& player = players_[operation % kPlayers];
    if (!player.lock) return come(player);
    switch (operation / kPlayers % 16) {
      case 0:
      case 1:
        return enter(player, Role::User);
      case 2:
        return enter(player, Role::Observer);
      case 3:
        return leave_topic(player);
      case 4:
      case 5:
        return open(player);
      case 6:
        return close(player);
      case 7:
      case 8:
        return join(player);
      case 9:
        return leave_ring(player);
      case 10:
        return die(player);
      case 11:
        return leave(player);
      case 12:
      case 13:
        return reap(player);
      default:
        return collect(player);
    }
  }

  /// Takes the first index that no living process has; what a dead one left there is repaired.
  void come(Player& player) {
    std::uint32_t expected = 1;
    while (expected < kIndexes && owner_of(expected) != nullptr) ++expected;
    auto lock = std::make_unique<LockFile>(lock_path_);
    std::uint32_t k = 1;
    while (k < kIndexes && !lock->try_lock(k)) ++k;
    require(k == expected, "which index is free");
    if (k == kIndexes) return;
    const bool dead = local_.world().participant_state(k).load() != 0;
    require(dead == (dead_.count(k) != 0), "whether somebody died there");
    if (dead) repair(*lock, k);
    local_.world().participant_state(k).take();
    player.lock = std::move(lock);
    player.index = k;
  }

  void enter(Player& player, Role role) {
    const std::size_t name = bytes_.below(std::size(kNames));
    const std::size_t type = bytes_.below(std::size(kTypes));
    const auto expected = name < kGoodNames ? place_for(name, type) : std::nullopt;
    const auto topic = attempt([&] {
      const Registry::Lock lock(local_.registry());
      return local_.registry().enter(kNames[name], kTypes[type], player.index, role);
    });
    require(topic == expected, "which topic is entered");
    if (!topic) return;
    Topic& entered = topics_[*topic];
    const bool brings_names =
        kTypes[type].known.names != 0 && kTypes[entered.told].known.names == 0;
    if (!entered.exists() || brings_names) {
      const std::uint64_t piece = piece_for(type);
      if (!entered.exists()) entered = {name, type};
      entered.told = type;
      entered.piece = piece;
    }
    (role == Role::User ? entered.users : entered.observers).insert(player.index);
    (role == Role::User ? player.topics : player.observed).push_back(*topic);
  }

  /// As the transport does it: the last use of a process takes it out of the topic.
  void leave_topic(Player& player) {
    const std::size_t which = bytes_.below(player.topics.size() + player.observed.size());
    const bool uses = which < player.topics.size();
    auto& all = uses ? player.topics : player.observed;
    if (all.empty()) return;
    const auto use =
        all.begin() + static_cast<std::ptrdiff_t>(uses ? which : which - player.topics.size());
    const std::uint32_t topic = *use;
    all.erase(use);
    if (std::count(all.begin(), all.end(), topic) != 0) return;
    const Registry::Lock lock(local_.registry());
    local_.registry().leave(topic, player.index, uses ? Role::User : Role::Observer);
    (uses ? topics_[topic].users : topics_[topic].observers).erase(player.index);
  }

  void open(Player& player) {
    const std::uint32_t topic =
        player.topics.empty() ? 0 : player.topics[bytes_.below(player.topics.size())];
    const std::uint32_t depth = 1 + static_cast<std::uint32_t>(bytes_.below(5));
    const bool blocking = bytes_.below(2) != 0;
    const std::uint32_t version = local_.segment().directory().version.load();
    const auto opened = attempt([&] {
      const Registry::Lock lock(local_.registry());
      const auto made = local_.registry().open(
          topic, player.index,
          {depth, kReaders, blocking ? lot::Policy::Block : lot::Policy::Overwrite});
      require(made.has_value(), "there is memory for each ring");
      return *made;
    });
    const auto free = std::find_if(channels_.begin(), channels_.end(),
                                   [](const Channel& c) { return c.state == State::Free; });
    require(opened.has_value() == (free != channels_.end()), "whether there is a channel");
    if (!opened) return;
    require(opened->channel == static_cast<std::uint32_t>(free - channels_.begin()) &&
                opened->generation == free->generation + 1,
            "which channel is taken");
    require(local_.segment().directory().version.load() != version, "a new ring is announced");
    *free = {State::Live, opened->generation, topic, player.index};
    player.rings.push_back(*opened);
    const auto ring = local_.world().ring(opened->channel);
    require(ring.depth == depth && ring.readers == kReaders && ring.blocking == blocking,
            "the ring");
  }

  /// As the transport does it: the ring is the orphanage's, and freed when nobody reads it.
  void close(Player& player) {
    if (player.rings.empty()) return;
    const ChannelName name = player.rings.back();
    player.rings.pop_back();
    require(player.lock->try_lock(0), "the orphanage is free");
    lot::transport::Recovery recovery(local_.world());
    recovery.orphan_ring(name.channel, player.index);
    recovery.collect();
    player.lock->unlock(0);
    channels_[name.channel].state = State::Orphan;
    channels_[name.channel].owner = 0;
    recycled();
  }

  void join(Player& player) {
    const auto c = static_cast<std::uint32_t>(bytes_.below(kChannels));
    const std::uint32_t older = bytes_.below(4) == 0 ? 1 : 0;
    Channel& channel = channels_[c];
    if (channel.state == State::Free) return;
    const Registry::Lock lock(local_.registry());
    bool full = false;
    const auto reader =
        Reader::join(local_.world().ring(c), channel.generation - older, player.index, 0, full);
    const bool room = channel.readers.size() < kReaders;
    require(full == !room, "whether the ring has all its readers");
    require(reader.has_value() == (room && channel.state == State::Live && older == 0),
            "who may join");
    if (!reader) return;
    channel.readers.insert(player.index);
    player.readers.emplace_back(c, *reader);
  }

  void leave_ring(Player& player) {
    if (player.readers.empty()) return;
    const auto which = static_cast<std::ptrdiff_t>(bytes_.below(player.readers.size()));
    auto& [c, reader] = player.readers[static_cast<std::size_t>(which)];
    reader.leave();
    channels_[c].readers.erase(channels_[c].readers.find(player.index));
    player.readers.erase(player.readers.begin() + which);
  }

  void die(Player& player) {
    dead_.insert(player.index);
    player = Player();
  }

  /// Leaving is a reap of oneself.
  void leave(Player& player) {
    dead_.insert(player.index);
    const std::uint32_t k = player.index;
    repair(*player.lock, k);
    player = Player();
  }

  void reap(Player& player) {
    const auto k = static_cast<std::uint32_t>(1 + bytes_.below(kIndexes - 1));
    if (k == player.index) return;
    const bool free = player.lock->try_lock(k);
    require(free == (owner_of(k) == nullptr), "whether a process lives");
    if (!free) return;
    if (local_.world().participant_state(k).load() != 0) repair(*player.lock, k);
    player.lock->unlock(k);
  }

  void repair(LockFile& lock, std::uint32_t k) {
    require(lock.try_lock(0), "the orphanage is free");
    require(local_.reap(k), "there is something to repair");
    lock.unlock(0);
    dead_.erase(k);
    for (Topic& topic : topics_) {
      topic.users.erase(k);
      topic.observers.erase(k);
    }
    for (Channel& channel : channels_) {
      channel.readers.erase(k);
      if (channel.state == State::Live && channel.owner == k) {
        channel.state = State::Orphan;
        channel.owner = 0;
      }
    }
    recycled();
  }

  void collect(Player& player) {
    require(player.lock->try_lock(0), "the orphanage is free");
    local_.collect();
    player.lock->unlock(0);
    recycled();
  }

  void recycled() {
    for (Channel& channel : channels_) {
      if (channel.state == State::Orphan && channel.readers.empty()) {
        channel = {State::Free, channel.generation + 1};
      }
    }
  }

  // ---- the model
  // ----------------------------------------------------------------------------------

  const Player* owner_of(std::uint32_t k) const {
    for (const Player& player : players_) {
      if (player.lock && player.index == k) return &player;
    }
    return nullptr;
  }

  /// The topic of that name that has users; there is one at most.
  std::optional<std::uint32_t> topic_used(std::size_t name) const {
    for (std::uint32_t t = 0; t < kTopics; ++t) {
      if (!topics_[t].users.empty() && topics_[t].name == name) return t;
    }
    return std::nullopt;
  }

  /// The last topic of that name that has observers only, and carries the type, or any.
  std::optional<std::uint32_t> topic_observed(std::size_t name,
                                              std::optional<std::size_t> type) const {
    for (std::uint32_t t = kTopics; t-- > 0;) {
      const Topic& topic = topics_[t];
      if (topic.exists() && topic.users.empty() && topic.name == name &&
          (!type || topic.carries(*type))) {
        return t;
      }
    }
    return std::nullopt;
  }

  /// Where a process comes to. Nothing: it is refused.
  std::optional<std::uint32_t> place_for(std::size_t name, std::size_t type) const {
    if (const auto used = topic_used(name)) {
      return topics_[*used].carries(type) ? used : std::nullopt;
    }
    if (const auto observed = topic_observed(name, type)) return observed;
    for (std::uint32_t t = 0; t < kTopics; ++t) {
      if (!topics_[t].exists()) return t;
    }
    return std::nullopt;
  }

  static std::uint64_t pieces(std::size_t type) {
    constexpr std::uint64_t kPiece = lot::segment::kDescriptionPiece;
    return (kTypes[type].known.bytes.size() + kPiece - 1) / kPiece;
  }
  /// Where a description comes to lie: with equal bytes, else in the first gap.
  std::uint64_t piece_for(std::size_t type) const {
    std::set<std::uint64_t> taken;
    for (const Topic& topic : topics_) {
      if (!topic.exists() || pieces(topic.told) == 0) continue;
      if (topic.told == type) return topic.piece;
      for (std::uint64_t i = 0; i < pieces(topic.told); ++i) taken.insert(topic.piece + i);
    }
    std::uint64_t first = 0;
    for (const std::uint64_t piece : taken) {
      if (piece >= first + pieces(type)) break;
      first = piece + 1;
    }
    return first;
  }

  /// What it returns, or nothing when it throws lot::Error.
  template <class Do>
  static auto attempt(Do&& what) -> std::optional<decltype(what())> {
    try {
      return what();
    } catch (const lot::Error&) {
      return std::nullopt;
    }
  }

  void check() {
    for (std::uint32_t k = 1; k < kIndexes; ++k) {
      const bool lives = owner_of(k) != nullptr;
      require(watcher_.held_by_other(k) == lives, "who is alive");
      require((local_.world().participant_state(k).load() != 0) == (lives || dead_.count(k) != 0),
              "which indexes are taken");
    }
    for (std::uint32_t t = 0; t < kTopics; ++t) check_topic(t);
    for (std::size_t name = 0; name < kGoodNames; ++name) check_type(name);
    for (std::uint32_t c = 0; c < kChannels; ++c) check_channel(c);
    for (std::uint32_t t = 0; t < kTopics; ++t) {
      std::vector<ChannelName> live;
      for (std::uint32_t c = 0; c < kChannels; ++c) {
        if (channels_[c].state == State::Live && channels_[c].topic == t) {
          live.push_back({c, channels_[c].generation});
        }
      }
      auto rings = local_.registry().rings(t);
      std::erase_if(rings, [&](const ChannelName& n) { return !local_.registry().is_open(n); });
      require(rings == live, "the rings of a topic");
    }
  }

  void check_topic(std::uint32_t t) {
    lot::segment::TopicEntry& real = local_.segment().topics()[t];
    const Topic& topic = topics_[t];
    const auto bits = [](const std::set<std::uint32_t>& who) {
      std::uint64_t all = 0;
      for (const std::uint32_t k : who) all |= std::uint64_t{1} << k;
      return all;
    };
    require(real.users[0].load() == bits(topic.users), "the users of a topic");
    require(real.observers[0].load() == bits(topic.observers), "the observers of a topic");
    if (!topic.exists()) return;
    const MessageType& type = kTypes[topic.type];
    require(real.name == kNames[topic.name] && real.type_name == std::string(type.name) &&
                real.type_size == type.size && real.type_hash == type.hash,
            "name and type of a topic");
    const lot::detail::Described& known = kTypes[topic.told].known;
    require(real.type_layout == known.layout && real.type_names.load() == known.names,
            "layout and names of a topic's type");
    const std::uint64_t word = real.description.load();
    require(
        lot::segment::description_bytes(word) == known.bytes.size() &&
            lot::segment::description_offset(word) == topic.piece * lot::segment::kDescriptionPiece,
        "where a description lies");
    require(word == 0 || lot::registry::TypeTable(local_.segment()).copy(word) == known.bytes,
            "a description");
    const auto used = topic_used(topic.name);
    require(local_.registry().is_superseded(t) == (used && *used != t),
            "whether a topic was made anew");
  }

  /// What a process is told that has no type.
  void check_type(std::size_t name) const {
    auto topic = topic_used(name);
    if (!topic) topic = topic_observed(name, std::nullopt);
    const auto found = local_.registry().type_of(kNames[name]);
    require((found != nullptr) == topic.has_value(), "whether there is a topic");
    if (!topic) return;
    const lot::detail::Described& known = kTypes[topics_[*topic].told].known;
    const lot::Description& description = found->description();
    require((description.root().kind == lot::Kind::Opaque) == known.bytes.empty() &&
                (known.bytes.empty() || description.names_hash() == known.names),
            "the description of a topic");
  }

  void check_channel(std::uint32_t c) {
    const Channel& channel = channels_[c];
    const auto word = local_.world().channel_writer(c).load();
    require(lot::ring::writer_state(word) == channel.state &&
                lot::ring::writer_generation(word) == channel.generation &&
                (channel.state == State::Free || lot::ring::writer_owner(word) == channel.owner),
            "the state of a channel");
    const auto ring = local_.world().ring(c);
    std::multiset<std::uint32_t> readers;
    for (std::uint32_t i = 0; i < ring.readers; ++i) {
      if (ring.who[i] != 0) readers.insert(ring.who[i] - 1);
    }
    require(readers == channel.readers, "the readers of a ring");
    if ((++looks_ + c) % 16 != 0) return;
    std::uint32_t granules = 0;
    for (std::uint32_t i = 0; i < local_.segment().granules().count(); ++i) {
      granules += local_.segment().granules().tag(i) == (lot::segment::kRingTag | c);
    }
    require((granules != 0) == (channel.state != State::Free), "the memory of a ring");
  }

  void end() {
    for (Player& player : players_) {
      if (player.lock) leave(player);
      check();
    }
    for (std::uint32_t k = 1; k < kIndexes; ++k) {
      if (dead_.count(k) == 0) continue;
      require(watcher_.try_lock(k), "the dead hold no lock");
      repair(watcher_, k);
      watcher_.unlock(k);
    }
    const lot::testing::Audit audit(local_.segment());
    require(audit.nothing() && audit.participants == 0, "nothing is left behind");
  }

  /// Makes one of the mistakes that check() must find.
  void spoil() {
    if (++steps_ % 8 != 0) return;
    auto& topic = local_.segment().topics()[0];
    if (planted("lost_user")) lot::test::raw(topic.users[0]) = 0;
    if (planted("leaked_user")) lot::test::raw(topic.users[0]) |= 8;
    if (planted("lost_observer")) lot::test::raw(topic.observers[0]) = 0;
    if (planted("moved_description") && topic.description.load() != 0) {
      lot::test::raw(topic.description) += std::uint64_t{1} << 48;
    }
    if (planted("lost_names")) lot::test::raw(topic.type_names) = 0;
    if (planted("renamed_topic")) topic.name[1] = 'z';
    if (planted("retyped_topic")) ++topic.type_size;
    if (planted("lost_ring")) lot::test::raw(local_.world().channel_writer(0)) = 0;
    if (planted("lost_memory")) local_.registry().recycle(0);
    if (planted("lost_lock")) {
      for (Player& player : players_) {
        if (player.lock) player.lock->unlock(player.index);
      }
    }
    if (planted("leaked_reader") && local_.world().ring(0).depth != 0)
      local_.world().ring(0).who[1] = 2;
  }

  LocalSegment& local_;
  const std::string& lock_path_;
  LockFile watcher_;
  Bytes bytes_;
  unsigned steps_ = 0;
  unsigned looks_ = 0;
  std::array<Player, kPlayers> players_;
  std::set<std::uint32_t> dead_;  ///< indexes whose process died, not reaped yet
  std::array<Topic, kTopics> topics_;
  std::array<Channel, kChannels> channels_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const auto* const directory = new lot::fuzz::Directory;
  static const auto* const lock_path = new std::string(directory->path() + "/registry.lock");
  static auto* const local = new LocalSegment({6 << 20, kIndexes, 4, kTopics, kChannels, kReaders});
  Fuzz(*local, *lock_path, Bytes(data, size)).run();
  return 0;
}
