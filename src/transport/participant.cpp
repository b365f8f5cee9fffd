// SPDX-License-Identifier: Apache-2.0
#include "transport/participant.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <map>
#include <new>
#include <pthread.h>
#include <sys/mman.h>
#include <system_error>
#include <unistd.h>

#include "lot/detail/no_signals.hpp"
#include "lot/error.hpp"

#include "segment/system_limits.hpp"

namespace lot::transport {

const char* environment(const char* name) {
  const char* value = secure_getenv(name);
  return value != nullptr && *value != '\0' ? value : nullptr;
}

namespace {

/// The participants of this process. The object is never destroyed, since static destructors that
/// run after this library's may release pointers.
struct Process {
  std::mutex joining;  ///< held while a thread joins, which may take long; taken before `mutex`
  std::mutex mutex;    ///< guards the lists
  std::map<std::string, std::weak_ptr<Participant>> by_path;
  std::vector<Participant*> all;
};
Process& process() {
  static auto* const p = new Process;
  return *p;
}

std::uint64_t parse_size(const char* text) {
  char* end = nullptr;
  errno = 0;
  std::uint64_t n = std::strtoull(text, &end, 10);
  const char unit = *end != '\0' ? *end++ : 'B';
  const unsigned shift = unit == 'B'                  ? 0
                         : unit == 'K' || unit == 'k' ? 10
                         : unit == 'M' || unit == 'm' ? 20
                         : unit == 'G' || unit == 'g' ? 30
                         : unit == 'T' || unit == 't' ? 40
                                                      : 64;
  if (end == text || *end != '\0' || shift == 64 || errno != 0 || n == 0 || text[0] == '-' ||
      n > (~std::uint64_t{0} >> shift)) {
    throw Error(EINVAL, std::string("LOT_SIZE=") + text, "not a size",
                "write a number of bytes, or one with K, M, G or T behind it");
  }
  return n << shift;
}

unsigned parse_permissions(const char* text) {
  char* end = nullptr;
  const unsigned long mode = std::strtoul(text, &end, 8);
  if (*end != '\0' || (mode & ~0666UL) != 0 || (mode & 0600) != 0600) {
    throw Error(EINVAL, std::string("LOT_PERMISSIONS=") + text, "not usable permissions",
                "write them in octal: 0600 (you), 0660 (your group), 0666 (everybody)");
  }
  return static_cast<unsigned>(mode);
}

bool parse_switch(const char* name, const char* text) {
  if (std::strcmp(text, "0") == 0 || std::strcmp(text, "1") == 0) return *text == '1';
  throw Error(EINVAL, std::string(name) + "=" + text, "neither yes nor no",
              "write 1 or 0, or leave it away");
}

void take_rights_from_environment(EngineOptions& options) {
  if (const char* v = environment("LOT_PERMISSIONS")) options.permissions = parse_permissions(v);
  if (const char* v = environment("LOT_USER")) options.user = v;
  if (const char* v = environment("LOT_GROUP")) options.group = v;
}

EngineOptions with_environment(EngineOptions options) {
  if (const char* v = environment("LOT_SEGMENT")) options.segment = v;
  if (const char* v = environment("LOT_DIR")) options.directory = v;
  if (const char* v = environment("LOT_SIZE")) options.size_bytes = parse_size(v);
  take_rights_from_environment(options);
  if (const char* v = environment("LOT_PERSIST")) options.persist = parse_switch("LOT_PERSIST", v);
  if (const char* v = environment("LOT_MLOCK")) options.lock_memory = parse_switch("LOT_MLOCK", v);
  if (options.name.empty()) options.name = program_invocation_short_name;
  const auto check = [](const char* what, std::uint64_t value, std::uint64_t most) {
    if (value == 0 || value > most) {
      throw Error(EINVAL, std::string("EngineOptions::") + what,
                  std::to_string(value) + " is out of range", "use 1 to " + std::to_string(most));
    }
  };
  check("processes", options.processes, segment::kMaxParticipants - 1);
  check("blocks", options.blocks, ring::kNoBlock - 1);
  check("topics", options.topics, 1U << 20);
  check("channels", options.channels, 1U << 20);
  check("readers", options.readers, 1U << 16);
  return options;
}

[[noreturn, gnu::cold]] void refuse_without_memory(const std::string& path) {
  throw Error(ENOMEM, path, "no memory for what a process needs to join",
              segment::advice_on_address_space());
}

/// Throws: the segment is in use and lets fewer users in than was asked for (*narrow*).
[[noreturn]] void refuse_narrow(const std::string& path, const std::string& reason) {
  throw Error(EPERM, path, reason + "; and it is in use",
              "end all that use it (" + segment::command("ls", path) +
                  " names them) and start again, then it is made anew; or ask for no more than "
                  "those do (LOT_GROUP, LOT_PERMISSIONS), or set LOT_SEGMENT");
}

/// The contents of a segment that would be removed and made anew.
struct Contents {
  std::uint64_t items = 0;  ///< items that wait in queues and are to stay
  bool is_narrow = false;   ///< it lets fewer users in than was asked for
  /// A notice stands: that process may have lost its byte to closefrom().
  bool is_lived_in = false;
};

/// `has_size`: the segment has the size that was asked for. It would be joined if it let all users
/// in.
///
/// REQUIRES: the gate is held.
Contents look_into(const std::string& path, const segment::Trust& trust, bool has_size) {
  using segment::Segment;
  Contents contents;
  std::string ignored;
  const auto fit = Segment::examine(path, 0, trust, ignored);
  contents.is_narrow = fit == Segment::Fit::Narrow;
  if (fit != Segment::Fit::Fits && !contents.is_narrow) return contents;
  try {
    const Segment segment(path, Segment::Access::ReadOnly, trust);
    for (std::uint32_t k = 1; k < segment.capacity().participants; ++k) {
      contents.is_lived_in |=
          // Acquire: edges "state" and "seat".
          segment.participants()[k].state.load(std::memory_order_acquire) != 0 &&
          liveness::seat::stands(segment.witnesses()[k].seat.load(std::memory_order_acquire));
    }
    if (!has_size && !segment.keeps_files()) return contents;
    for (std::uint32_t c = 0; c < segment.capacity().channels; ++c) {
      contents.items += segment.waiting_items(c);
    }
  } catch (const std::bad_alloc&) {
    refuse_without_memory(path);
  } catch (const Error& e) {
    if (!segment::means_damage(e)) throw;
    return {};  // it is damaged: no process can take what is in there
  }
  return contents;
}

using Fit = segment::Segment::Fit;

/// What a process finds at the path where it wants to join, seen with the gate held.
struct Found {
  Fit fit = Fit::Absent;
  std::string reason;       ///< why it does not fit
  std::string lock_reason;  ///< why its lock file lets fewer users in than was asked for
  bool used = false;  ///< by other processes; looked for only where the segment or the lock file
                      ///< would be removed
  Contents contents;  ///< looked at in that case only
};

/// Throws if what was found can neither be joined nor made anew.
void require_free(const std::string& path, const Found& found, Participant::IfAbsent if_absent) {
  const bool is_narrow = found.fit == Fit::Narrow;
  if (found.fit == Fit::Stale && found.used) {
    throw Error(EBUSY, path, found.reason + ", and it is in use",
                "leave LOT_SIZE as those have it who use it, stop them, or set LOT_SEGMENT");
  }
  if (found.used && is_narrow) refuse_narrow(path, found.reason);
  if (found.used && !found.lock_reason.empty()) refuse_narrow(path + ".lock", found.lock_reason);
  if (found.fit == Fit::Fits) return;
  if (if_absent == Participant::IfAbsent::Throw) {
    throw Error(ENOENT, path, "nobody uses it any more", "there is nothing to be done");
  }
  const std::uint64_t items = found.contents.items;
  if (items == 0) return;
  const std::string size = is_narrow ? "" : "LOT_SIZE";
  const std::string rights = found.contents.is_narrow ? "LOT_GROUP and LOT_PERMISSIONS" : "";
  throw Error(
      ENOTEMPTY, path,
      found.reason + ", and " + std::to_string(items) +
          (items == 1 ? " item waits in it that is to stay" : " items wait in it that are to stay"),
      "take them without " + size + (size.empty() || rights.empty() ? "" : ", ") + rights +
          ", or drop them by " + segment::command("clean --with-items", path));
}

/// Removes the lock file. The next process makes a new one.
void remove_lock_file(const std::string& path, const std::string& reason,
                      const std::string& advice) {
  if (::unlink((path + ".lock").c_str()) == -1 && errno != ENOENT) {
    throw Error(errno, path + ".lock", reason, advice);
  }
}

/// The lock file is made anew at most this often. Each time a process that asks for less may have
/// made the new one.
constexpr int kMostRenewals = 8;

/// Removes a lock file whose mode is too narrow. A file that exists keeps its mode; a new one gets
/// the mode that was asked for.
void renew_lock_file(const std::string& path, const std::string& lock_reason, int renewed) {
  if (renewed > kMostRenewals) {
    throw Error(EPERM, path + ".lock", lock_reason + "; and new ones are so, too",
                "name a directory with LOT_DIR whose file system has such modes");
  }
  remove_lock_file(path, lock_reason + "; and it cannot be removed",
                   "remove it as the owner of its directory, or set LOT_SEGMENT or LOT_DIR");
}

segment::Capacity capacity_of(const EngineOptions& options) {
  return {options.size_bytes, options.processes + 1, options.blocks,
          options.topics,     options.channels,      options.readers};
}

}  // namespace

segment::Trust Participant::trust_of_environment() {
  EngineOptions options;
  take_rights_from_environment(options);
  return segment::Trust::of(options);
}

QueueEngine Participant::queue_engine(QueueEngine asked) {
  const char* name = environment("LOT_QUEUE");
  if (name == nullptr) return asked;
  if (std::strcmp(name, "ring") == 0) return QueueEngine::Ring;
  if (std::strcmp(name, "mutex") == 0) return QueueEngine::Mutex;
  throw Error(EINVAL, std::string("LOT_QUEUE=") + name, "not a queue engine",
              "write ring or mutex, or leave it away");
}

void check_depth(std::string_view topic, std::uint32_t depth) {
  if (depth == 0 || depth > segment::Segment::kDeepest) {
    throw Error(EINVAL, std::string(topic), "depth " + std::to_string(depth) + " is out of range",
                "set PusherOptions::depth (QueueOptions::depth) to 1 to " +
                    std::to_string(segment::Segment::kDeepest));
  }
}

/// Leaves the gate at its end. The segment is opened, made and removed only inside the gate.
class Participant::GateGuard {
 public:
  explicit GateGuard(liveness::LockFile& file) : file_(&file) {}
  ~GateGuard() { file_->leave_gate(); }
  GateGuard(const GateGuard&) = delete;
  GateGuard& operator=(const GateGuard&) = delete;

 private:
  liveness::LockFile* file_;
};

/// The participant that this process has at the path already. Null: it has none.
std::shared_ptr<Participant> Participant::joined(const EngineOptions& options,
                                                 const std::string& path,
                                                 const segment::Trust& trust) {
  std::shared_ptr<Participant> existing;  // declared before the guard: if it is the last handle, it
                                          // goes after the mutex is unlocked
  const std::lock_guard guard(process().mutex);
  existing = process().by_path[path].lock();
  if (!existing || existing->inert()) return nullptr;
  existing->lock_file_->require(trust);
  const std::string reason = existing->lock_file_->shortfall(trust);
  if (!reason.empty()) refuse_narrow(path + ".lock", reason);
  if (options.lock_memory) existing->segment_.lock_memory();
  if (options.persist) existing->segment_.keep_files();
  return existing;
}

/// Joins the segment that exists. REQUIRES: the gate is held, and this process has its turn.
std::shared_ptr<Participant> Participant::admit(const EngineOptions& options,
                                                const std::string& path,
                                                const segment::Trust& trust,
                                                const std::shared_ptr<liveness::LockFile>& file) {
  const auto make = [&] {
    try {
      return new Participant(options, trust, file);
    } catch (const std::bad_alloc&) {
      refuse_without_memory(path);
    }
  };
  auto* p = make();
  std::shared_ptr<Participant> handle(p, &handle_gone);
  if (options.persist) p->segment_.keep_files();
  const std::lock_guard guard(process().mutex);
  process().by_path[path] = handle;
  process().all.push_back(p);
  return handle;
}

std::shared_ptr<Participant> Participant::join(EngineOptions options, IfAbsent if_absent) {
  options = with_environment(std::move(options));
  const std::string path = segment::path_of(options.directory, options.segment);
  segment::Trust trust = segment::Trust::of(options);
  trust.wants_all = if_absent == IfAbsent::Make;  // without Make the caller is a visitor
  watch_forks();
  const std::lock_guard joining(process().joining);
  if (auto existing = joined(options, path, trust)) return existing;

  for (int renewed = 0;;) {
    auto file = std::make_shared<liveness::LockFile>(path + ".lock", trust);
    if (!file->enter_gate(kGatePatience)) continue;  // the last participant has removed the file
    GateGuard gate(*file);
    bool ours = false;  // a segment exists that the lock file belongs to
    bool made = false;  // this call has made the segment
    const auto in_use = [&] { return file->held_by_other(0, segment::kMaxParticipants); };
    try {
      Found found;
      const Fit fit = segment::Segment::examine(path, options.size_bytes, trust, found.reason);
      found.fit = fit;
      ours = fit == Fit::Fits || fit == Fit::Stale || fit == Fit::Narrow;
      if (fit == Fit::Foreign) {
        throw Error(EINVAL, path, found.reason, "remove it if it is yours, or set LOT_SEGMENT");
      }
      found.lock_reason = file->shortfall(trust);
      const bool goes = fit != Fit::Fits || !found.lock_reason.empty();
      if (goes && ours) found.contents = look_into(path, trust, fit != Fit::Stale);
      found.used = goes && (found.contents.is_lived_in || in_use());
      // Without its locks this process is not in the gate, and `used` says nothing.
      file->require_intact();
      if (fit == Fit::Absent && found.used) {
        // The segment of living processes was removed, and the lock file belongs to them.
        remove_lock_file(
            path, "it is used with a segment that was removed",
            "stop those who use it (its owner can also remove it), or set LOT_SEGMENT");
        continue;
      }
      require_free(path, found, if_absent);
      if (fit != Fit::Fits) segment::Segment::remove(path, trust);
      if (!found.lock_reason.empty()) {
        renew_lock_file(path, found.lock_reason, ++renewed);
        continue;
      }
      if (fit != Fit::Fits) {
        ours = false;
        segment::Segment::create(path, capacity_of(options), trust);
        made = true;
      }
      ours = true;
      file->take_turn();
      return admit(options, path, trust, file);
    } catch (...) {
      if (made && !in_use()) {
        segment::Segment::remove(path, trust);
        ours = false;
      }
      if (!ours && !in_use()) ::unlink((path + ".lock").c_str());
      throw;
    }
  }
}

Participant::Participant(const EngineOptions& options, const segment::Trust& trust,
                         std::shared_ptr<liveness::LockFile> lock_file)
    : trust_(trust),
      lock_file_(std::move(lock_file)),
      segment_(segment::path_of(options.directory, options.segment),
               segment::Segment::Access::ReadWrite, trust),
      presence_(segment_, *lock_file_),
      registry_(segment_, presence_) {
  if (options.lock_memory) segment_.lock_memory();
  fill_hub();
  const std::uint32_t blocks = segment_.capacity().blocks;
  cells_bytes_ = blocks * sizeof(detail::ControlCell);
  void* cells =
      mmap(nullptr, cells_bytes_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (cells == MAP_FAILED) throw std::bad_alloc();
  holder_.cells = static_cast<detail::ControlCell*>(cells);
  for (std::uint32_t b = 0; b < blocks; ++b) {
    auto* cell = new (&holder_.cells[b]) detail::ControlCell{};
    cell->hub = &hub_;
    cell->block = b;
  }
  holder_.segment = &segment_;
  holder_.make_tables(blocks);
  lives_.resize(blocks);
  was_held_.resize(blocks);
  idle_looks_.resize(blocks);
  eviction_.prepare(blocks, segment_.capacity().channels);
  holder_.pools = &pools_;
  pools_.reserve(segment_.capacity().channels + 64);
  prints_.resize(pools_.capacity());
  new_prints_.resize(pools_.capacity());
  to_settle_.resize(pools_.capacity());
  to_trim_.resize(pools_.capacity());
  draining_.reserve(pools_.capacity());  // closing a publisher then needs no memory
  idle_.reserve(pools_.capacity());
  watched_.reserve(futex::kMaxWords);
  bool is_there = false;
  try {
    lock_file_->take_turn();
    take_index(options);
    is_there = true;
    lock_file_->take_turn();
    holder_.next_free = (blocks / segment_.capacity().participants) * holder_.own.self;
    try {
      const detail::NoSignals quiet;
      warden_ = std::thread([this] { warden(); });
    } catch (const std::system_error& e) {
      throw Error(e.code().value(), segment_.path(), "no thread to watch over the others",
                  segment::advice_on_threads());
    }
  } catch (...) {
    // Release: edge "state".
    if (is_there) part(index()).store(0, std::memory_order_release);
    munmap(holder_.cells, cells_bytes_);
    throw;
  }
}

Participant::~Participant() { munmap(holder_.cells, cells_bytes_); }

void Participant::fill_hub() noexcept {
  hub_.owner = this;
  fill_pointers();
  fill_weak_pointers();
  fill_answers();
}

/// Fills in what pointers do.
void Participant::fill_pointers() noexcept {
  hub_.drop_last = [](detail::ControlCell* c) noexcept {
    Participant& p = of(c);
    if (p.inert()) return;
    p.enter();
    p.holder_.release(c->block, hold::kPointer);
    p.exit();
  };
  hub_.abandoned = [](detail::ControlCell* c) noexcept {
    Participant& p = of(c);
    if (p.inert()) return;
    p.enter();
    if (p.was_received(*c)) {
      p.holder_.release(c->block, hold::kPointer);
    } else {
      p.holder_.pool_of(*c).give_back(*c);
    }
    p.exit();
  };
  hub_.acquire = [](detail::ControlCell* c) noexcept {
    of(c).holder_.acquire(c->block, hold::kPointer);
  };
  hub_.shared_from_unique = [](detail::ControlCell* c) noexcept {
    Participant& p = of(c);
    // Only one thread has the pointer.
    if (p.holder_.is_home(c->block)) p.holder_.complete(c->block);
    p.hub_.points(c);
  };
  hub_.points = [](detail::ControlCell* c) noexcept {
    Participant& p = of(c);
    HardwareOwnership::note_pointers(p.segment_.block(c->block), c->hold);
  };
}

/// Fills in what weak pointers do.
void Participant::fill_weak_pointers() noexcept {
  hub_.lock_weak = [](detail::ControlCell* c, std::uint32_t generation) noexcept {
    Participant& p = of(c);
    if (p.inert()) return false;
    p.enter();
    segment::BlockWords& words = p.segment_.block(c->block);
    const Left left =
        p.has_left() ? Left::Gone : p.holder_.own.acquire_weak(words, c->hold, generation);
    if (left == Left::Wanted) p.holder_.tell_home(c->block);
    p.exit();
    return left == Left::Held;
  };
  hub_.generation = [](const detail::ControlCell* c) noexcept {
    // Relaxed: the caller has seen its message live. A later number says that it has died, and
    // nothing else: only who locks a weak pointer looks at the message.
    return refcount::generation_of(
        of(c).segment_.block(c->block).life.load(std::memory_order_relaxed));
  };
  hub_.expired = [](const detail::ControlCell* c, std::uint32_t generation) noexcept {
    Participant& p = of(c);
    return p.inert() || p.has_left() || p.hub_.generation(c) != generation;
  };
  hub_.weak_count = [](detail::ControlCell* c, int change) noexcept {
    Participant& p = of(c);
    if (change > 0) {
      // Relaxed: the caller has a pointer or a weak pointer already.
      p.life_.fetch_add(kReference, std::memory_order_relaxed);
    } else {
      p.drop_reference();
    }
  };
}

/// Fills in what pointers ask.
void Participant::fill_answers() noexcept {
  hub_.path = [](const detail::ControlCell* c) noexcept { return of(c).segment_.path().c_str(); };
  hub_.instance = [](const detail::ControlCell* c) noexcept {
    return of(c).segment_.header().identity.instance;
  };
  hub_.others = [](const detail::ControlCell* c) noexcept {
    Participant& p = of(c);
    segment::BlockWords& words = p.segment_.block(c->block);
    const std::uint32_t self = p.index();
    // Relaxed, as home_points below: a count is out of date at once in any case.
    const std::uint32_t home = words.home.load(std::memory_order_relaxed);
    std::size_t n = 0;
    for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
      std::uint64_t holders = words.own[w].load(std::memory_order_acquire);  // O1
      const auto without = [&](std::uint32_t k) {
        holders = HardwareOwnership::holders(holders, w, k);
      };
      without(refcount::kOrphanage);
      without(self);
      // Relaxed: see above.
      if (home > 1 && words.home_points.load(std::memory_order_relaxed) == 0) without(home - 1);
      n += static_cast<std::size_t>(std::popcount(holders));
    }
    return n;
  };
  hub_.alone = [](const detail::ControlCell* c) noexcept {
    const Participant& p = of(c);
    return !p.inert() && p.is_alone(*c);
  };
  hub_.base = [](const detail::ControlCell* c) noexcept -> const unsigned char* {
    return of(c).segment_.base();
  };
}

Participant& Participant::of(const detail::ControlCell* cell) noexcept {
  return *static_cast<const OwnedHub*>(cell->hub)->owner;
}

std::uint32_t Participant::participants() const noexcept {
  return segment_.capacity().participants;
}
std::atomic<std::uint32_t>& Participant::part(std::uint32_t k) noexcept {
  return segment_.participants()[k].state;
}
std::atomic<ring::Word>& Participant::channel_writer(std::uint32_t c) noexcept {
  return segment_.channels()[c].writer;
}

std::string_view Participant::name_of(std::uint32_t k) const noexcept {
  if (k >= participants()) return {};  // the index comes from a damaged word
  const auto& entry = segment_.participants()[k];
  return {entry.name, strnlen(entry.name, sizeof(entry.name))};
}
void Participant::rename(std::string_view name) noexcept {
  auto& entry = segment_.participants()[index()];
  std::memset(entry.name, 0, sizeof(entry.name));
  std::memcpy(entry.name, name.data(), std::min(name.size(), sizeof(entry.name) - 1));
}

void Participant::refuse() const {
  // Relaxed: it only chooses the text.
  if (is_expelled_.load(std::memory_order_relaxed)) {
    throw Error(ESTALE, segment_.path(),
                "this process was stopped, and taken for dead: another one has its place",
                "make new lot objects; a kernel that allows set_robust_list() prevents it");
  }
  throw Error(ECHILD, segment_.path(), "this object was inherited through fork() and is inert",
              "make a new lot::ShmEngine in the child, or exec");
}

/// True only if other threads and processes have done all their reads before: each hold that goes
/// is released, and acquired here.
bool Participant::is_alone(const detail::ControlCell& cell) const noexcept {
  // A ring's hold stands while the ring has the message, and until no hazard names it (I1).
  const std::uint64_t v = cell.hold.load(std::memory_order_acquire);  // O4
  if ((v & hold::kHolds) != hold::kPointer) return false;
  const segment::BlockWords& words = segment_.block(cell.block);
  const std::uint64_t life = words.life.load(std::memory_order_acquire);  // O2
  std::uint32_t maker = index();
  // The home's bit stands as long as the home has the memory, whether it looks at the message or
  // not. It does not count when this process took the message from a queue and has not published it
  // since.
  if ((v & hold::kHome) == 0 && segment_.arena(cell.block).was_handed_over()) {
    // Relaxed: only the number counts. What the home has done is in its bit (O1).
    const std::uint32_t home = words.home.load(std::memory_order_relaxed);
    if (home > refcount::kHomeOrphanage) maker = home - 1;
  }
  for (std::uint32_t w = 0; w < segment::Atomics::kOwnWords; ++w) {
    std::uint64_t holders = words.own[w].load(std::memory_order_acquire);  // O1
    for (const std::uint32_t k : {index(), maker}) {
      holders = HardwareOwnership::holders(holders, w, k);
    }
    if (holders != 0) return false;
  }
  // A hold may have moved behind the search. Then it has bumped the version (I3). Relaxed: the load
  // of the bit that it has left behind carries the bump (O1).
  return words.life.load(std::memory_order_relaxed) == life;
}

/// Between enter() and exit() the participant neither leaves nor is destroyed. REQUIRES: the caller
/// has a pointer or a weak pointer of it.
void Participant::enter() noexcept {
  // seq_cst: life_ and left_ are looked at crosswise (see life_).
  life_.fetch_add(kReference | kInside, std::memory_order_seq_cst);
}

void Participant::exit() noexcept {
  // Relaxed: the compare-and-swap decides. seq_cst: see life_.
  std::uint64_t v = life_.load(std::memory_order_relaxed);
  while ((v & kClosing) == 0) {
    // seq_cst: see life_.
    if (life_.compare_exchange_weak(v, v - (kReference | kInside), std::memory_order_seq_cst,
                                    std::memory_order_relaxed)) {
      return;
    }
  }
  // All handles have gone. The last thread that comes out makes the participant leave, if no
  // pointer remains. seq_cst: see life_.
  life_.fetch_sub(kInside, std::memory_order_seq_cst);
  leave_if_unused();
  drop_reference();
}

void Participant::drop_reference() noexcept {
  // acq_rel, as in std::shared_ptr: the thread that deletes the object sees what the others did.
  const std::uint64_t left = life_.fetch_sub(kReference, std::memory_order_acq_rel) - kReference;
  if ((left & kReferences) == 0) delete this;
}

bool Participant::has_left() noexcept {
  if (!left_.load(std::memory_order_seq_cst)) return false;  // see life_
  const std::lock_guard guard(leave_mutex_);  // the thread that has set it may take it back
  // Relaxed: the mutex carries it.
  return left_.load(std::memory_order_relaxed);
}

void Participant::leave_if_unused() noexcept {
  const auto unused = [this] {
    // seq_cst: see life_.
    return (life_.load(std::memory_order_seq_cst) & kInsideMask) == 0 && !holds_pointers();
  };
  {
    const std::lock_guard guard(leave_mutex_);
    // Relaxed: the mutex carries it.
    if (left_.load(std::memory_order_relaxed) || !unused()) return;
    left_.store(true, std::memory_order_seq_cst);  // see life_
    if (!unused()) {  // a weak pointer was locked just now: its holder calls this again
      left_.store(false, std::memory_order_seq_cst);  // see life_
      return;
    }
  }
  leave();
}

/// True when the process still has pointers to messages. Called only after all handles have gone. A
/// block that is ready for a loan carries a pointer hold of its pool, so the pools give such blocks
/// back first. With each block goes what its message referred to, which then may be ready itself.
bool Participant::holds_pointers() noexcept {
  // Both locks: the warden has pointer holds for a moment while it settles or drains.
  const std::scoped_lock guard(settle_mutex_, pools_mutex_);
  while (trim_pools()) {
  }
  for (std::uint32_t b = 0; b < segment_.capacity().blocks; ++b) {
    // seq_cst: see life_.
    if (hold::pointers(holder_.cells[b].hold.load(std::memory_order_seq_cst)) != 0) return true;
  }
  return false;
}

void Participant::handle_gone(Participant* p) noexcept {
  if (p->inert()) return;  // a forked child touches nothing and has no thread to stop
  p->enter();
  p->ahead_.stop();  // the block that it is making is a hold of this process
  // Closing is finished here: when the warden brings the last block home, no thread checks whether
  // the participant may leave. The wait is bounded, since a process that acts for the orphanage may
  // be stopped.
  const auto until = futex::Clock::now() + kOrphanagePatience;
  while (p->finish_closing(),
         !p->rings_closed() && (futex::Clock::now() < until || p->is_releasing())) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  p->life_.fetch_or(kClosing, std::memory_order_seq_cst);  // see life_
  p->exit();
}

void Participant::leave() noexcept {
  warden_stop_.store(true, std::memory_order_relaxed);  // relaxed: the errand (E1) carries it
  ring_warden();
  warden_.join();
  {
    // Not earlier: a child that is forked meanwhile must close the lock file.
    const std::lock_guard guard(process().mutex);
    lock_file_->abandon();
    std::erase(process().all, this);
  }
  drop_reference();  // the reference that all handles share
}

bool Participant::same_segment(const detail::ControlCell& cell) const noexcept {
  return cell.hub == &hub_ || cell.hub->instance(&cell) == segment_.header().identity.instance;
}

Participant* Participant::at(const void* address) noexcept {
  const std::lock_guard guard(process().mutex);
  for (Participant* p : process().all) {
    const auto* base = p->segment_.base();
    if (address >= base && address < base + p->segment_.size() && !p->inert()) return p;
  }
  return nullptr;
}

void Participant::remove_files() noexcept {
  const auto until = futex::Clock::now() + kGatePatience;
  const auto lock = [until](std::mutex& mutex) {
    bool is_ours = mutex.try_lock();
    while (!is_ours && futex::Clock::now() < until) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      is_ours = mutex.try_lock();
    }
    return is_ours;
  };
  // Both locks are kept for ever. So no participant leaves, none joins, and no child is forked: it
  // would have both mutexes locked and no thread to unlock them. A participant that is joining just
  // now has files, too.
  (void)lock(process().joining);
  if (!lock(process().mutex)) return;
  for (Participant* p : process().all) {
    p->is_ending_.store(true, std::memory_order_relaxed);  // relaxed: the errand (E1) carries it
    p->ring_warden();
  }
  for (Participant* p : process().all) {
    // Relaxed: what it tells of is in the file system.
    while (p->files_settled_.load(std::memory_order_relaxed) == 0 &&
           futex::wait(&p->files_settled_, 0, until)) {
    }
  }
}

std::mutex& Participant::no_fork() noexcept { return process().mutex; }

void Participant::watch_forks() noexcept {
  static const int registered =
      pthread_atfork(&prepare_fork, &after_fork_in_parent, &after_fork_in_child);
  (void)registered;
}

void Participant::prepare_fork() noexcept {
  process().joining.lock();
  process().mutex.lock();
}
void Participant::after_fork_in_parent() noexcept {
  process().mutex.unlock();
  process().joining.unlock();
}
void Participant::after_fork_in_child() noexcept {
  for (Participant* p : process().all) {
    p->inert_.store(true, std::memory_order_relaxed);  // relaxed: the child has one thread
    p->presence_.abandon();
    p->lock_file_->abandon();  // else the child would make the parent look alive to other processes
  }
  process().all.clear();
  process().by_path.clear();
  process().mutex.unlock();
  process().joining.unlock();
}

}  // namespace lot::transport
