// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "lot/detail/mapping.hpp"

namespace lot::transport {
class Participant;
}

namespace lot::detail {

/// What all processes see of the memory of a block's message: where it is, and how far it is used.
/// The process that builds the message works on its own words, a Build, and says here what it has
/// come to when it publishes the message.
///
/// A frozen arena gives no memory any more and takes none back: its message is published while
/// pointers that may change it are left.
///
/// Threads: one at a time (a message is built by one thread), but for `frozen`.
/// Memory:  256 bytes, address-free: all places are offsets from the segment's begin.
/// Errors:  allocate() throws lot::Error: EPERM when the message is published, EBADMSG when what
///          another process said here about its memory cannot be.
/// Crash:   the arena is a hint; the truth about memory is in the granules' tags, which name the
///          block, and the reaper frees by them. `references` is read by the reaper.
struct alignas(64) Arena {
  static constexpr unsigned kMaxExtents = 15;
  static constexpr std::uint8_t kPublished = 1;  ///< values of `frozen`
  static constexpr std::uint8_t kDying = 2;
  static constexpr std::uint8_t kTaken = 1;  ///< values of `changed_hands`
  static constexpr std::uint8_t kShown = 2;

  static constexpr std::uint16_t kShared = 1;    ///< pieces lie side by side in it
  static constexpr std::uint16_t kReserved = 2;  ///< reserve() made it: the block keeps it as it is
  struct Extent {
    std::uint32_t granule;   ///< the first
    std::uint32_t granules;  ///< how many
    std::uint16_t living;    ///< allocations in it that were not given back (saturates)
    std::uint16_t kind;      ///< bits kShared and kReserved
    bool is_shared() const noexcept { return (kind & kShared) != 0; }
    bool is_reserved() const noexcept { return (kind & kReserved) != 0; }
  };

  std::uint64_t root;        ///< offset of the message object
  std::uint64_t references;  ///< offset of the first ReferenceList, 0: none
  std::uint64_t topic;       ///< key of the topic that the block is loaned for, 0: none; for people
  /// 1: PusherCore::reserve() made the memory, and other topics have no claim on it. Written by the
  /// home while it has the block alone; read, perhaps stale, by processes that look for memory.
  std::uint32_t reserved;
  /// kTaken: another process than the home has taken the message from a queue, alone, and may have
  /// changed it. kShown: and has published it since.
  std::uint8_t changed_hands;
  /// kPublished: nothing is allocated or given back. kDying: its destructor runs, so that nothing
  /// need be given back. Written by a process that publishes the message, and by the home.
  std::uint8_t frozen;
  // As Build's, of a message that is published: stale until then. Written by the home, and by a
  // process that has taken the message from a queue.
  std::uint8_t extents;
  std::uint8_t current;
  std::uint64_t cursor;
  Extent extent[kMaxExtents];

  /// Memory for `bytes`, or throws OutOfMemory.
  void* allocate(std::size_t bytes, std::size_t align);
  /// Takes a piece back: at once if it is the newest, or the last one living in its extent.
  void deallocate(void* piece, std::size_t bytes) noexcept;

  /// How many extents there are.
  unsigned count() const noexcept {
    const unsigned n = read_once(extents);
    return n < kMaxExtents ? n : kMaxExtents;
  }

  /// Says that another process than the home owns the message alone from now on. It may change it,
  /// and may be killed in the middle of that: the home runs no destructor then.
  void change_hands() noexcept;
  /// Says that every reader of a topic may look at the message from now on, its home too. Whoever
  /// publishes a message calls it that was taken from a queue.
  void show() noexcept;

  /// The message is published, and its process may have pointers left that could make it grow. Any
  /// thread that has a pointer may call it.
  void freeze() noexcept;
  /// The same. Of threads that do so at once, one hears that it was the first.
  bool freeze_first() noexcept;
  bool is_frozen() const noexcept;

  /// True when the process that has taken the message from a queue has it for itself: neither its
  /// home nor another process looks at it, since it was published neither by itself nor by a
  /// message that refers to it.
  bool was_handed_over() const noexcept;
};
static_assert(sizeof(Arena) == 256);

/// Where the containers of a message allocate while it is built, in private memory of the block's
/// home: so nothing that another process writes puts a piece elsewhere.
///
/// It hands out memory by bumping a cursor: first in the block's own small payload, then in
/// extents: runs of granules. A large piece has an extent of its own, which is at most 1/16 larger
/// than the piece. Small pieces share the current one, which doubles, in place where the granules
/// behind it are free; what they have not used goes back with push(). From the eighth extent on
/// large pieces share as well, in extents as large as all before them: so they suffice for 64 MiB
/// of small pieces, and for 128 times what the first eight have. Nothing is freed one by one,
/// except the newest piece; an extent in which nothing lives is reused, at its new size, or given
/// back. The whole is released at once when the message dies.
///
/// A block comes with the extents of its last message. Until the new one needs one, they are spare:
/// a thread of the home that is short of memory takes them (Pool::take_spare()).
///
/// A process that has taken the message from a queue works on a copy, made of what the arena says
/// (take()): it gets no new extents.
///
/// Invariants
///   A1  The cursor lies in the current region: the shared extent `current` - 1, or the small
///       payload.
///   A2  No piece in use reaches behind the cursor in the current region. A piece moves the cursor
///       back only if it lies in that region itself: the last piece of another extent may end where
///       the current one begins.
///   A3  What the arena says is read once, and checked before it is used: it leads neither outside
///       of the block's own memory nor, at home, to extents that the home has not claimed.
///
/// Threads: one at a time, but for `spare` and `wanted`.
/// Memory:  256 bytes for each block, private (Mapping); touched with the block's first message.
struct alignas(64) Build {
  static constexpr std::uint64_t kLargePiece = 64 << 10;
  /// A run of so many granules is kept, whatever a smaller message needs of it.
  static constexpr std::uint32_t kSmallRun = 16;
  static constexpr unsigned kMaxExtents = Arena::kMaxExtents;
  static constexpr std::uint8_t kBuilders = 0;  ///< values of `spare`
  static constexpr std::uint8_t kSpare = 1;
  using Extent = Arena::Extent;

  std::uint64_t cursor = 0;  ///< next free byte, as an offset
  std::uint64_t limit = 0;   ///< end of the region that cursor is in
  Arena* arena = nullptr;    ///< null: the block is not at home here
  const Mapping* mapping = nullptr;
  /// Offset of the message that was built here: its destructor runs nowhere else.
  std::uint64_t root = 0;
  std::uint8_t extents = 0;  ///< how many of `extent` are there
  std::uint8_t current = 0;  ///< index + 1 of the extent that cursor is in, 0: the small payload
  bool is_told = false;      ///< the arena says what is here
  /// Whose the extents are. kBuilders: of the thread that builds the message, as all else here.
  /// kSpare: of the first that asks, the builder or a thread of the home that is short of memory.
  std::atomic<std::uint8_t> spare{kBuilders};
  /// Such a thread is at them. Set and cleared with the lock of the block's pool.
  std::atomic<std::uint8_t> wanted{0};
  /// While the home freezes what a message refers to: the next block to look at. Private to that.
  std::uint32_t next_to_freeze = 0;
  Extent extent[kMaxExtents] = {};

  /// The home's, of a block that has this arena. Null: in no segment that is mapped here.
  static Build* of(const Arena& arena) noexcept {
    const Mapping* const here = Mapping::of(&arena);
    return here == nullptr ? nullptr : static_cast<Build*>(here->build_of(&arena));
  }

  /// The block is at home here from now on, and has no extents.
  void open(Arena& its, const Mapping& here) noexcept;
  /// It is not, from now on.
  void close() noexcept {
    arena = nullptr;
    cursor = limit = 0;
    extents = 0;
  }
  /// A message begins, in the small payload. What the last one had is still there.
  void begin(std::uint64_t small) noexcept {
    current = 0;
    cursor = small;
    limit = small + Mapping::kSmallBytes;
    is_told = false;
  }

  /// The message is complete: what it has not used goes back. Its home calls it when it publishes
  /// the message.
  void trim() noexcept {
    if (arena->frozen == 0 && (is_spare() || extents != 0)) trim_whole();
  }
  /// Says in the arena where the pieces are, from now on each time that the message gets or loses
  /// an extent.
  void tell() noexcept;
  /// Another process has had the message, which this one, its home, has taken from a queue again:
  /// the pieces are where the arena says, in the extents that are known here.
  void take_again() noexcept;

  /// The extents are the builder's from now on.
  void own_spare() noexcept {
    if (!is_spare()) return;
    spare.store(kBuilders, std::memory_order_relaxed);  // M1
    std::atomic_signal_fence(std::memory_order_seq_cst);
    if (wanted.load(std::memory_order_acquire) != 0) await_taker();  // M1
  }
  bool is_spare() const noexcept { return spare.load(std::memory_order_acquire) == kSpare; }  // M2

  void* grow(std::size_t bytes, std::size_t align) {
    return is_told ? grow_told(bytes, align) : find_room(bytes, align);
  }
  void give_back(const void* piece, std::size_t bytes) noexcept;

  /// This one, not the home's, is of a message that the process has taken from a queue and another
  /// has made. Throws lot::Error (EBADMSG) when what the arena says cannot be.
  void take(Arena& its);

  std::uint64_t aligned_cursor(std::size_t align) const noexcept {
    return (cursor + (align - 1)) & ~std::uint64_t{align - 1};
  }
  void note_piece(unsigned index) noexcept {
    if (extent[index].living != 0xffff) ++extent[index].living;
  }

 private:
  static constexpr unsigned kNone = kMaxExtents;  ///< no extent

  unsigned char* at(std::uint64_t offset) const noexcept { return mapping->base() + offset; }
  std::uint64_t begin_of(const Extent& e) const noexcept;
  transport::Participant* home() const noexcept;
  bool adopt_pieces(const Arena& said) noexcept;
  void* find_room(std::size_t bytes, std::size_t align);
  void* grow_told(std::size_t bytes, std::size_t align);
  void* find_extent(std::size_t bytes, std::size_t align, std::uint32_t granules);
  void* place_in_current(std::size_t bytes, std::size_t align) noexcept;
  unsigned claim(transport::Participant& p, std::size_t bytes, std::uint32_t granules, bool alone);
  void* begin_in(unsigned index, std::size_t bytes) noexcept;
  bool grow_current(transport::Participant& p, std::size_t bytes, std::size_t align) noexcept;
  unsigned idle_extent(std::uint32_t granules, bool shared) const noexcept;
  std::uint64_t granules_shared() const noexcept;
  void resize(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept;
  void shorten(transport::Participant& p, unsigned index, std::uint32_t granules) noexcept;
  void trim_whole() noexcept;
  void await_taker() noexcept;
  void trim_current() noexcept;
  void drop_idle(transport::Participant& p) noexcept;
  void drop(transport::Participant& p, unsigned index) noexcept;
};
static_assert(sizeof(Build) == sizeof(Arena));  // Mapping::build_of()

/// As Arena::allocate(), of a message that is published, or not at home here.
[[gnu::cold, gnu::noinline]] void* allocate_elsewhere(Arena& arena, std::size_t bytes,
                                                      std::size_t align);

inline void* Arena::allocate(std::size_t bytes, std::size_t align) {
  Build* const build = Build::of(*this);
  if (build != nullptr && build->arena == this && read_once(frozen) != kPublished) {
    const std::uint64_t begin = build->aligned_cursor(align);
    const std::uint64_t end = build->limit;
    // Below the limit also when it is empty: each piece begins in the region that has it.
    if (begin < end && bytes <= end - begin && bytes < Build::kLargePiece) {
      build->cursor = begin + bytes;
      if (build->current != 0) build->note_piece(build->current - 1U);
      return build->mapping->base() + begin;
    }
    return build->grow(bytes, align);
  }
  return allocate_elsewhere(*this, bytes, align);
}

/// Which blocks a message refers to (ShmRef): a list in the message's own memory, so that the
/// message keeps them alive and a reaper can adopt them.
///
/// Crash: an entry is there only while the message's home has a hold on its block for it: the hold
///        is taken before the entry is written, and given up after the entry is emptied. Killed in
///        between, the home leaves a hold without an entry, which goes with its ownership bit.
struct ReferenceList {
  static constexpr std::uint32_t kEntries = 7;
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  /// Written by the home alone, while it builds the message; `block` is read by a reaper.
  struct Entry {
    std::uint32_t block;  ///< kNone: free
    std::uint32_t refs;   ///< how many ShmRef of the message refer to it; the home's alone
  };
  std::uint64_t next;  ///< offset of the next list, 0: none
  Entry entry[kEntries];
};
static_assert(sizeof(ReferenceList) == 64);

/// The arena of the message that this thread is constructing right now, or null.
Arena*& arena_being_built() noexcept;

/// Containers that this thread default-constructs meanwhile belong to `arena`.
class BuildScope {
 public:
  explicit BuildScope(Arena* arena) noexcept
      : being_built_(arena_being_built()), before_(being_built_) {
    being_built_ = arena;
  }
  ~BuildScope() { being_built_ = before_; }
  BuildScope(const BuildScope&) = delete;
  BuildScope& operator=(const BuildScope&) = delete;

 private:
  Arena*& being_built_;
  Arena* const before_;
};

}  // namespace lot::detail
