// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "lot/detail/mapping.hpp"
#include "lot/detail/poison.hpp"

namespace lot::transport {
class Participant;
}

namespace lot::detail {

/// What all processes see of the memory of a block's message: where it is, and how much of it is
/// used. The process that builds the message works on a private copy of these words, a Build. It
/// writes the result here when it publishes the message.
///
/// A frozen arena gives no memory any more and takes none back. Its message is published, and some
/// process still has pointers through which the message could be changed.
///
/// Threads: one at a time (one thread builds a message), but for `frozen`.
/// Memory:  256 bytes, address-free: all places are offsets from the begin of the segment.
/// Errors:  allocate() throws lot::Error: EPERM when the message is published, EBADMSG when what
///          another process wrote here about its memory is impossible.
/// Crash:   the arena is a hint. The truth about memory is in the tags of the granules: they name
///          the block, and the reaper frees by them. The reaper reads `references`.
struct alignas(64) Arena {
  static constexpr unsigned kMaxExtents = 15;
  static constexpr std::uint8_t kPublished = 1;  ///< values of `frozen`
  static constexpr std::uint8_t kDying = 2;
  static constexpr std::uint8_t kTaken = 1;  ///< values of `changed_hands`
  static constexpr std::uint8_t kShown = 2;

  static constexpr std::uint16_t kShared = 1;    ///< several pieces lie side by side in the extent
  static constexpr std::uint16_t kReserved = 2;  ///< made by reserve(); the block keeps it whole
  struct Extent {
    std::uint32_t granule;   ///< index of the first granule
    std::uint32_t granules;  ///< how many
    std::uint16_t living;    ///< allocations in it that were not given back (saturates)
    std::uint16_t kind;      ///< bits kShared and kReserved
    bool is_shared() const noexcept { return (kind & kShared) != 0; }
    bool is_reserved() const noexcept { return (kind & kReserved) != 0; }
  };

  std::uint64_t root;        ///< offset of the message object
  std::uint64_t references;  ///< offset of the first ReferenceList, 0: none
  std::uint64_t topic;       ///< key of the topic that the block is loaned for, 0: none; for people
  /// 1: PusherCore::reserve() made the memory, and other topics have no claim on it. The home
  /// writes it while it has the block alone. Processes that look for memory read it; they may read
  /// a stale value.
  std::uint32_t reserved;
  /// kTaken: a process other than the home has taken the message from a queue, alone, and may have
  /// changed it. kShown: that process has also published it since.
  std::uint8_t changed_hands;
  /// kPublished: the arena gives no memory and takes none back. kDying: the destructor of the
  /// message runs, so no piece need be given back. The home writes it, and so does a process that
  /// publishes the message.
  std::uint8_t frozen;
  // The next four are as in Build, for a message that is published. They are stale until then. The
  // home writes them, and so does a process that has taken the message from a queue.
  std::uint8_t extents;
  std::uint8_t current;
  std::uint64_t cursor;
  /// When a publisher that stamps has pushed the message last, in ns of the monotonic clock. It
  /// means something only in the ring of such a publisher: others leave what stands here. That
  /// publisher writes it before each push, also while readers have the message. They read it only
  /// when they are asked for it.
  std::uint64_t pushed_ns;
  Extent extent[kMaxExtents];

  /// Returns memory for `bytes`, or throws OutOfMemory.
  void* allocate(std::size_t bytes, std::size_t align);
  /// Takes a piece back. Its memory is free at once if it is the newest piece, or the last living
  /// one of its extent.
  void deallocate(void* piece, std::size_t bytes) noexcept;

  /// How many extents there are.
  unsigned count() const noexcept {
    const unsigned n = read_once(extents);
    return n < kMaxExtents ? n : kMaxExtents;
  }

  /// Says that a process other than the home owns the message alone from now on. That process may
  /// change the message, and may be killed halfway: so the home does not run the destructor.
  void change_hands() noexcept;
  /// Says that every reader of a topic may look at the message from now on, the home too. A process
  /// that publishes a message which it took from a queue calls it.
  void show() noexcept;

  /// Freezes the arena: the message is published, and its process may still have pointers that
  /// could make it grow. Any thread that has a pointer may call it.
  void freeze() noexcept;
  /// Freezes the arena. If several threads call it at once, it returns true to exactly one of them.
  bool freeze_first() noexcept;
  bool is_frozen() const noexcept;

  /// True when the process that took the message from a queue has it alone. Neither the home nor
  /// another process looks at the message: that process did not publish it, and published no
  /// message that refers to it.
  bool was_handed_over() const noexcept;
};
static_assert(sizeof(Arena) == 256);

/// Where the containers of a message allocate while it is built. It is private memory of the
/// block's home, so another process cannot move a piece elsewhere by writing to the segment.
///
/// Build hands out memory by bumping a cursor: first in the block's own small payload, then in
/// extents, which are runs of granules. A large piece has an extent of its own, which is at most
/// 1/16 larger than the piece. Small pieces share the current extent. It doubles in place where the
/// granules behind it are free; push() gives back what the pieces have not used. From the eighth
/// extent on large pieces share extents as well, each as large as all before it. So the extents
/// suffice for 64 MiB of small pieces, and for 128 times what the first eight have. No piece is
/// freed alone, except the newest one. An extent in which no piece lives is reused, at its new
/// size, or given back. The whole memory is released at once when the message dies.
///
/// A block comes with the extents of its last message. Until the new message needs one, they are
/// spare: a thread of the home that is short of memory takes them (Pool::take_spare()).
///
/// A process that has taken the message from a queue works on a copy, made from what the arena says
/// (take()). It gets no new extents.
///
/// Invariants
///   A1  The cursor lies in the current region: the shared extent `current` - 1, or the small
///       payload.
///   A2  No piece in use reaches behind the cursor in the current region. A piece moves the cursor
///       back only if it lies in that region itself: the last piece of another extent may end where
///       the current one begins.
///   A3  Build reads each word of the arena once, and checks it before it uses it. So the word
///       leads neither outside of the block's own memory nor, at home, to extents that the home has
///       not claimed.
///
/// Threads: one at a time, but for `spare` and `wanted`.
/// Memory:  256 bytes for each block, private (Mapping); touched with the block's first message.
struct alignas(64) Build {
  static constexpr std::uint64_t kLargePiece = 64 << 10;
  /// A block keeps a run of up to this many granules, even if its next message needs less.
  static constexpr std::uint32_t kSmallRun = 16;
  static constexpr unsigned kMaxExtents = Arena::kMaxExtents;
  static constexpr std::uint8_t kBuilders = 0;  ///< values of `spare`
  static constexpr std::uint8_t kSpare = 1;
  using Extent = Arena::Extent;

  std::uint64_t cursor = 0;  ///< next free byte, as an offset
  std::uint64_t limit = 0;   ///< end of the region that cursor is in
  Arena* arena = nullptr;    ///< null: this process is not the home of the block
  const Mapping* mapping = nullptr;
  /// Offset of the message that was built here. Its destructor runs only in this process.
  std::uint64_t root = 0;
  std::uint8_t extents = 0;  ///< how many entries of `extent` are in use
  std::uint8_t current = 0;  ///< the current extent's index + 1, 0: the small payload
  bool is_told = false;      ///< the arena says what stands here
  /// Which thread owns the extents. kBuilders: the thread that builds the message; it owns all else
  /// here as well. kSpare: the first thread that asks for them, which is the builder or a thread of
  /// the home that is short of memory.
  std::atomic<std::uint8_t> spare{kBuilders};
  /// 1: a thread that is short of memory works on the extents. That thread sets and clears it while
  /// it has the lock of the block's pool.
  std::atomic<std::uint8_t> wanted{0};
  /// The next block to look at, while the home freezes what a message refers to. Only the freezing
  /// thread uses it.
  std::uint32_t next_to_freeze = 0;
  Extent extent[kMaxExtents] = {};

  /// The Build of the block that has this arena, in its home. Null: no segment that this process
  /// has mapped has this arena.
  static Build* of(const Arena& arena) noexcept {
    const Mapping* const here = Mapping::of(&arena);
    return here == nullptr ? nullptr : static_cast<Build*>(here->build_of(&arena));
  }

  /// This process is the home of the block from now on. The block has no extents yet.
  void open(Arena& its, const Mapping& here) noexcept;
  /// This process is not the home any more.
  void close() noexcept {
    arena = nullptr;
    cursor = limit = 0;
    extents = 0;
  }
  /// A message begins, in the small payload. The extents of the last message are still there.
  void begin(std::uint64_t small) noexcept {
    current = 0;
    cursor = small;
    limit = small + Mapping::kSmallBytes;
    is_told = false;
  }

  /// The message is complete: Build gives back what it has not used. The home calls it when it
  /// publishes the message.
  void trim() noexcept {
    if (arena->frozen == 0 && (is_spare() || extents != 0)) trim_whole();
  }
  /// Writes into the arena where the pieces are. From now on Build does so each time that the
  /// message gets or loses an extent.
  void tell() noexcept;
  /// Takes a message over again. Another process had it, and this process, the home, has taken it
  /// from a queue. The pieces are where the arena says, in the extents that Build knows.
  void take_again() noexcept;

  /// The builder owns the extents from now on.
  void own_spare() noexcept {
    if (!is_spare()) return;
    // M1: the fence keeps the compiler from moving the load before the store. ProcessBarrier of the
    // thread that sets `wanted` does the rest.
    spare.store(kBuilders, std::memory_order_relaxed);
    std::atomic_signal_fence(std::memory_order_seq_cst);             // M1, for the compiler
    if (wanted.load(std::memory_order_acquire) != 0) await_taker();  // M1
  }
  bool is_spare() const noexcept { return spare.load(std::memory_order_acquire) == kSpare; }  // M2

  void* grow(std::size_t bytes, std::size_t align) {
    void* const piece = is_told ? grow_told(bytes, align) : find_room(bytes, align);
    unpoison(piece, bytes);
    return piece;
  }
  void give_back(const void* piece, std::size_t bytes) noexcept;
  /// Other processes, or another message, may have the memory from now on.
  void unpoison_all() const noexcept {
    if constexpr (kPoisons) unpoison_whole();
  }

  /// Fills this Build from the arena. It is a Build of a message that another process has made and
  /// this process has taken from a queue. Throws lot::Error (EBADMSG) when what the arena says is
  /// impossible.
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
  bool learn_pieces(const Arena& said) noexcept;
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
  void unpoison_whole() const noexcept;
  void await_taker() noexcept;
  void trim_current() noexcept;
  void drop_idle(transport::Participant& p) noexcept;
  void drop(transport::Participant& p, unsigned index) noexcept;
};
static_assert(sizeof(Build) == sizeof(Arena));  // Mapping::build_of()

/// As Arena::allocate(), for a message that is published, or whose home is another process.
[[gnu::cold, gnu::noinline]] void* allocate_elsewhere(Arena& arena, std::size_t bytes,
                                                      std::size_t align);

inline void* Arena::allocate(std::size_t bytes, std::size_t align) {
  Build* const build = Build::of(*this);
  if (build != nullptr && build->arena == this && read_once(frozen) != kPublished) {
    const std::uint64_t begin = build->aligned_cursor(align);
    const std::uint64_t end = build->limit;
    // The begin is below the limit even for an empty piece: each piece begins in the region that
    // has it.
    if (begin < end && bytes <= end - begin && bytes < Build::kLargePiece) {
      build->cursor = begin + bytes;
      if (build->current != 0) build->note_piece(build->current - 1U);
      unpoison(build->mapping->base() + begin, bytes);
      return build->mapping->base() + begin;
    }
    return build->grow(bytes, align);
  }
  return allocate_elsewhere(*this, bytes, align);
}

/// Which blocks a message refers to (ShmRef). The list lies in the message's own memory, so that
/// the message keeps the blocks alive and a reaper can adopt them.
///
/// Crash:   an entry is there only while the message's home has a hold on its block for it. The
///          home takes the hold before it writes the entry, and gives the hold up after it has
///          emptied the entry. Killed in between, the home leaves a hold without an entry. That
///          hold goes with the home's ownership bit.
struct ReferenceList {
  static constexpr std::uint32_t kEntries = 7;
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  /// The home alone writes it, while it builds the message. A reaper reads `block`.
  struct Entry {
    std::uint32_t block;  ///< kNone: free
    std::uint32_t refs;   ///< how many ShmRef of the message refer to it; only the home uses it
  };
  std::uint64_t next;  ///< offset of the next list, 0: none
  Entry entry[kEntries];
};
static_assert(sizeof(ReferenceList) == 64);

/// The arena of the message that this thread is constructing right now, or null.
Arena*& arena_being_built() noexcept;

/// While it lives, containers that this thread default-constructs belong to `arena`.
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
