// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "lot/detail/arena.hpp"
#include "lot/detail/atomics.hpp"
#include "lot/detail/changed_by.hpp"
#include "lot/detail/control.hpp"

#include "lockfree_ring/ear.hpp"
#include "lockfree_ring/ring.hpp"
#include "lockfree_ring/sleep.hpp"
#include "lockfree_ring/writer_word.hpp"
#include "refcount/ownership.hpp"
#include "refcount/participant_state.hpp"
#include "robust_mutex/queue_lock.hpp"
#include "segment/errands.hpp"
#include "segment/sightings.hpp"

// The classes that ChangedBy names: each changes the words of its type, and no other code does.
namespace lot::liveness {
class DeathNotice;
}
namespace lot::registry {
class Registry;
}
namespace lot::selection {
class TopicReplies;
}
namespace lot::transport {
class Warden;
class World;
}  // namespace lot::transport
namespace lot::segment {
class Segment;
}

/// The layout of every byte of a segment (docs/layout.md). All zero bytes are a valid empty table,
/// so that the maker of a segment writes only the header. The segment has no address of any
/// process, and nothing of the C library.
namespace lot::segment {

using Atomics = detail::HardwareAtomics;
using BlockWords = refcount::BlockWords<Atomics>;
using Ring = ring::Ring<Atomics>;
using Cell = ring::Cell<Atomics>;
using Listeners = ring::Listeners<Atomics>;
using EarWords = ring::EarWords<Atomics>;
using Ear = ring::Ear<Atomics>;

inline constexpr char kMagic[8] = {'L', 'O', 'T', 'S', 'H', 'M', '\r', '\n'};
inline constexpr std::uint32_t kLayoutVersion = 18;

inline constexpr std::uint32_t kMaxParticipants = 320;  // index 0, the orphanage, included
static_assert(kMaxParticipants <= Atomics::kOwnWords * Atomics::kBitsPerWord);
static_assert(kMaxParticipants <= ring::kWorkerMask);
/// The first ears (docs/ear.md) are those of the participants, by index; wait sets claim the
/// others.
inline constexpr std::uint32_t kFirstFreeEar = kMaxParticipants;
static_assert(kFirstFreeEar < ring::kEars);
inline constexpr std::uint64_t kGranule = 4096;  ///< unit of message memory
/// Payload that every block has without an extent.
inline constexpr std::uint64_t kSmallBytes = detail::Mapping::kSmallBytes;
/// LOT asks the file system for memory, and gives it back, in units of this size.
inline constexpr std::uint64_t kUnit = 2 << 20;
inline constexpr std::size_t kTopicNameBytes = 200;
inline constexpr std::size_t kTypeNameBytes = 232;
/// The table of descriptions (docs/descriptions.md), in pieces of 64 bytes.
inline constexpr std::uint64_t kDescriptionsBytes = 1 << 20;
inline constexpr std::uint64_t kDescriptionPiece = 64;

/// The first 64 bytes. They never change their meaning, so that a newer library can tell an old
/// segment from other bytes.
struct Identity {
  char magic[8];
  std::uint32_t layout_version;
  std::uint32_t header_bytes;
  std::uint64_t fingerprint;  ///< pointer width, byte order, cache line, widths
  std::uint64_t size;         ///< bytes of the file
  std::uint64_t instance;     ///< random: tells one segment of this name from the next
  std::uint64_t boot;         ///< hash of the system's boot id: locks of another boot mean nothing
  std::uint64_t reserved[2];
};
static_assert(sizeof(Identity) == 64);

/// The numbers that a segment is made with. Everything else follows from them.
struct Capacity {
  std::uint64_t size = 0;
  std::uint32_t participants = kMaxParticipants;
  std::uint32_t blocks = 16384;
  std::uint32_t topics = 1024;
  std::uint32_t channels = 2048;
  std::uint32_t readers = 256;  ///< of one channel
};

/// Offsets of the tables. Each process computes the same ones from the capacity.
struct Geometry {
  std::uint64_t participants, witnesses, directory, topics, channels, blocks, arenas, small, tags,
      units, sightings, replies, descriptions, listeners, ears, news, data;
  std::uint64_t granules;  ///< in the data area
  static Geometry of(const Capacity& capacity);
};

struct Header {
  Identity identity;
  Capacity capacity;
  std::uint64_t check;  ///< check_of(capacity): another capacity would make tables of other bytes
};
std::uint64_t check_of(const Capacity& capacity) noexcept;

/// A participant as others see it. Only `state` matters to LOT; the rest is for people.
struct alignas(64) ParticipantEntry {
  refcount::ParticipantState<Atomics> state;  ///< written under byte lock k
  std::int32_t pid;                           ///< in its own namespace: never used for liveness
  std::uint64_t since_ns;
  char name[48];
};
static_assert(sizeof(ParticipantEntry) == 64);

/// A lock between processes (robust_mutex/lock_word.hpp), on a line of its own.
struct alignas(64) Lock {
  std::atomic<std::uint32_t> word;
};

/// Says whether a participant lives (docs/locks.md), and takes what others ask of its warden.
struct alignas(64) Witness {
  /// {incarnation : 32 | notice : 32} (liveness/death_notice.hpp); the notice is a futex. Changed
  /// by the participant's witness thread, by the kernel when it dies, and by the process
  /// that has its byte.
  detail::ChangedBy<std::atomic<std::uint64_t>, liveness::DeathNotice> seat;
  Errands errands;
};
static_assert(sizeof(Witness) == 64 && offsetof(Witness, errands) == 8);

/// The words that all processes look at to find each other.
struct alignas(64) Directory {
  ring::DirectoryVersion<Atomics> version;  ///< futex; bumped by each advertise, and by reapers
  /// The reaper bumps it when the orphanage has got what the dead one had. Until it changes, no
  /// warden need search. Edge D3: bumped (release) before the dead one's name goes -> load by a
  /// warden before it searches (acquire); carries the homes that are the orphanage's now.
  detail::ChangedBy<std::atomic<std::uint32_t>, transport::World> adoptions;
  /// Monotonic clock: when a warden last looked for memory that no process uses. The warden that
  /// changes it does the next look. If that warden is killed, one look is lost.
  detail::ChangedBy<std::atomic<std::uint64_t>, transport::Warden> looked_ns;
  /// Not 0: the files stay when the last process leaves. A process that joins sets it before it can
  /// put anything, and no process takes it back. The process that leaves last reads it. Relaxed:
  /// the gate carries it; or the death of the process that has set it, which the reader has seen
  /// before.
  detail::ChangedBy<std::atomic<std::uint32_t>, Segment> persists;
  Lock lock;       ///< registry: topics, joining, recycling
  Lock orphanage;  ///< held by the process that acts for the orphanage; it has byte 0 as well
};
static_assert(sizeof(Directory) == 192 && offsetof(Directory, persists) == 16);

/// Where a description lies in the table: {place in pieces 16, bytes 16, check 32}. The check is a
/// hash of the bytes. 0: there is none.
constexpr std::uint64_t make_description(std::uint64_t piece, std::uint64_t bytes,
                                         std::uint32_t check) {
  return piece << 48 | bytes << 32 | check;
}
constexpr std::uint64_t description_offset(std::uint64_t word) {
  return (word >> 48) * kDescriptionPiece;
}
constexpr std::uint64_t description_bytes(std::uint64_t word) { return word >> 32 & 0xffff; }
constexpr auto description_check(std::uint64_t word) { return static_cast<std::uint32_t>(word); }

/// A topic exists while a bit of `users` or `observers` stands. Participant p and its reaper write
/// bit p.
struct alignas(64) TopicEntry {
  detail::ChangedBy<std::atomic<std::uint64_t>, registry::Registry> users[Atomics::kOwnWords];
  /// Participants that only look on: the topic's name is free for another type.
  detail::ChangedBy<std::atomic<std::uint64_t>, registry::Registry> observers[Atomics::kOwnWords];
  std::uint64_t type_size;
  std::uint64_t type_align;
  std::uint64_t type_hash;    ///< TypeIdentity::hash(), and whose containers it has
  std::uint64_t type_layout;  ///< Description::layout_hash(); 0: its type says nothing
  /// Description::names_hash(), or 0 until a process comes that knows all names.
  detail::ChangedBy<std::atomic<std::uint64_t>, registry::Registry> type_names;
  /// Where the description is. It may get another place, with names.
  detail::ChangedBy<std::atomic<std::uint64_t>, registry::Registry> description;
  char name[kTopicNameBytes];
  char type_name[kTypeNameBytes];
  /// [p]: how many pullers participant p has on the topic. Written by p and its reaper. A lossless
  /// publisher waits for all of them.
  detail::ChangedBy<std::atomic<std::uint16_t>, registry::Registry> pullers[kMaxParticipants];
};
static_assert(sizeof(TopicEntry) == 1216);

/// What participants reply to the publishers of a topic that select their readers: two bits a
/// participant (selection/replies.hpp). They mean something only while the participant has pullers
/// on the topic.
struct Replies {
  static constexpr std::uint32_t kPerWord = 32;
  detail::ChangedBy<std::atomic<std::uint64_t>, selection::TopicReplies>
      words[kMaxParticipants / kPerWord];
};
static_assert(sizeof(Replies) == 80 && kMaxParticipants % Replies::kPerWord == 0);

/// One publisher's ring on a topic. The publisher writes the plain fields while the writer word is
/// INIT, each by write_once(): processes without the registry's lock read them by read_once() and
/// may have seen the ring that was there before.
struct alignas(64) ChannelEntry {
  ring::WriterWord<Atomics> writer;
  std::uint64_t first;  ///< sequence of the first message
  std::uint32_t topic;
  std::uint32_t depth;
  std::uint32_t readers;
  std::uint32_t policy;    ///< lot::Policy
  std::uint32_t granule;   ///< first granule of the ring's memory
  std::uint32_t granules;  ///< how many
  /// 1: the plain fields are complete.
  detail::ChangedBy<std::atomic<std::uint32_t>, registry::Registry> formed;
  std::uint32_t engine;  ///< lot::QueueEngine
  std::uint16_t taken;   ///< 0: all readers get a message; else kTaken, kFinished
  /// Bytes from slot to slot where messages travel in the slots: 64, 128 or 256. 0: they lie in
  /// blocks, and a slot is a word.
  std::uint16_t stride;
  std::uint32_t extra;  ///< bytes of extra memory for each reader: 0 or kExtraBytes
};
static_assert(sizeof(ChannelEntry) == 64);

/// ChannelEntry::extra. A module above makes of it what it wants.
inline constexpr std::uint32_t kExtraBytes = 16;

/// ChannelEntry::taken.
inline constexpr std::uint32_t kTaken = 1;     ///< one reader takes a message
inline constexpr std::uint32_t kFinished = 2;  ///< and the message stays in its slot until finished

inline constexpr std::uint16_t kStrides[] = {64, 128, 256};

/// ChannelEntry::stride for messages of this type, with the time of their push or without: 0 where
/// they can not travel in the slots.
constexpr std::uint16_t stride_for(const detail::MessageType& type, bool with_time) {
  if (!type.plain || type.align > 16) return 0;
  for (const std::uint16_t stride : kStrides) {
    if (type.size <= ring::Slots<Atomics>::room(stride, with_time)) return stride;
  }
  return 0;
}

/// Words of a message that travels in its slot. The last one may end behind the message: there the
/// payload of a block goes on, and so does what a reader copies into.
constexpr std::uint32_t words_of(const detail::MessageType& type) {
  return static_cast<std::uint32_t>((type.size + sizeof(ring::Word) - 1) / sizeof(ring::Word));
}

/// True when messages of the type lie in the payload that every block has.
constexpr bool is_small(const detail::MessageType& type) {
  return type.size <= kSmallBytes && type.align <= 64;
}

/// How many granules a message has. At most `all`, even if a wild write has hit the words.
inline std::uint64_t granules_of(const detail::Arena& arena, std::uint64_t all) {
  std::uint64_t sum = 0;
  for (unsigned i = 0, n = arena.count(); i < n; ++i) {
    sum += detail::read_once(arena.extent[i].granules);
  }
  return sum < all ? sum : all;
}

/// Whether reserve() made the block's memory: a hint for publishers that look for memory.
inline void set_reserved(detail::Arena& arena, bool yes) {
  detail::write_once<std::uint32_t>(arena.reserved, yes ? 1 : 0);
}
inline bool is_reserved(const detail::Arena& arena) {
  return detail::read_once(arena.reserved) != 0;
}

/// The first bytes of a ring's memory. Behind it lie who[], slots[] (at a multiple of the stride),
/// cells[], claims[] where workers must finish messages, and the extra memory if the ring's maker
/// has asked for it.
struct RingHead {
  alignas(64) std::atomic<std::uint32_t> roster;
  std::atomic<std::uint32_t> returned;
  std::atomic<ring::Word> floor;  ///< joiners of a lossless ring begin here at the earliest
  /// The name of the publisher's process, as `name` of its ParticipantEntry: for Envelope, and for
  /// publishers that select their readers. The maker writes it, and `stamps`, while the writer word
  /// is INIT: R7 carries both. The name stays when the participant has gone.
  char publisher[sizeof(ParticipantEntry::name)];
  alignas(64) std::atomic<std::uint32_t> space;
  std::uint32_t stamps;     ///< 1: each push writes its time: Arena::pushed_ns, or into the slot
  mutex_engine::Lock lock;  ///< of the mutex engine
};
static_assert(std::is_standard_layout_v<RingHead> && offsetof(RingHead, roster) == 0);
static_assert(sizeof(RingHead) == 192 && offsetof(RingHead, space) == 64);

/// The owner of one granule: 0 if free, block + 1, or kRingTag | channel. The owner's own words say
/// whether it lives. So a reaper finds by the tags what it must free.
using Tag = std::atomic<std::uint32_t>;
inline constexpr std::uint32_t kRingTag = std::uint32_t{1} << 31;

static_assert(sizeof(detail::Arena) == kSmallBytes);  // Mapping::small_of()
static_assert(sizeof(BlockWords) == 64);
static_assert(sizeof(Cell) == 64);
static_assert(sizeof(Listeners) == 64 && sizeof(EarWords) == 64);
/// Bytes of the news of one ear, a bit for each channel, in whole lines.
constexpr std::uint64_t news_bytes(std::uint32_t channels) {
  return (Ear::news_words(channels) * sizeof(ring::Word) + 63) / 64 * 64;
}
static_assert(news_bytes(2048) == 256);

}  // namespace lot::segment
