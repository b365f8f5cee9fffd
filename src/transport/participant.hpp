// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "lot/detail/core.hpp"
#include "lot/error.hpp"
#include "lot/options.hpp"

#include "futex/futex.hpp"
#include "liveness/presence.hpp"
#include "recovery/recovery.hpp"
#include "registry/registry.hpp"
#include "transport/ahead.hpp"
#include "transport/eviction.hpp"
#include "transport/pool.hpp"

namespace lot::transport {

/// The membership of one process (and one copy of the library) in one segment. Engines, pushers and
/// pullers share it. It leaves when the last of them and the last pointer have gone.
///
/// It runs two threads. The witness thread does nothing but end with the process
/// (liveness/death_notice.hpp). The warden sleeps on the notices of the other participants and
/// reaps the dead. It also finishes what other threads have put off because a lock was taken for a
/// moment.
///
/// Threads: all members may be called at once.
/// Crash:   what a participant leaves is found by its index and repaired by a reaper
///          (Recovery::reap()).
class Participant {
 public:
  /// How long opening, leaving and ending wait for another process that does the same.
  static constexpr std::chrono::seconds kGatePatience{5};

  /// Joins the segment that the options name. Where there is none, it is made, or ENOENT is thrown.
  /// Throws lot::Error.
  enum class IfAbsent { Make, Throw };
  static std::shared_ptr<Participant> join(EngineOptions options,
                                           IfAbsent if_absent = IfAbsent::Make);

  ~Participant();
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;

  std::uint32_t index() const noexcept { return holder_.own.self; }
  segment::Segment& segment() noexcept { return segment_; }
  registry::Registry& registry() noexcept { return registry_; }
  mutex_engine::QueueLock queue_lock(std::uint32_t channel) noexcept {
    return segment_.queue_lock(channel, presence_);
  }
  Holder& holder() noexcept { return holder_; }
  const detail::Hub* hub() const noexcept { return &hub_; }

  /// The name that participant k has given itself, at most kNameBytes - 1 bytes of it.
  std::string_view name_of(std::uint32_t k) const noexcept;
  /// Sets the name of this process.
  void rename(std::string_view name) noexcept;

  /// Throws lot::Error in a forked child, where every inherited object is inert, and in a process
  /// that others have taken for dead.
  void check_usable() const {
    // Relaxed: the flag carries nothing, and a thread may see it late.
    if (inert_.load(std::memory_order_relaxed)) [[unlikely]]
      refuse();
  }
  /// Relaxed: as in check_usable().
  bool inert() const noexcept { return inert_.load(std::memory_order_relaxed); }
  [[noreturn]] void refuse() const;

  /// Opens a pool for a new publisher, or, without a topic, for an engine's own messages. The pool
  /// belongs to the participant. It is used again after its publisher has gone and its last message
  /// has died.
  Pool& open_pool(std::string_view topic = {});
  /// The publisher of the pool has gone. Its ring holds `blocks`, or they were retired from it.
  /// Those holds go once the ring is closed.
  void close_pool(Pool& pool, const registry::ChannelName& ring,
                  std::vector<std::uint32_t> blocks) noexcept;

  /// Enters and leaves topics. Counts the handles of this process on each.
  std::uint32_t enter_topic(std::string_view name, const detail::MessageType& type);
  void leave_topic(std::uint32_t topic) noexcept;

  /// The last step of a puller that is destroyed: it leaves the rings that it never looked at, and
  /// the topic. Where a stopped process keeps the registry's lock, the warden does that later.
  void depart(std::list<registry::Departure> departure) noexcept;

  /// Makes a ring for the publisher with this pool. In a full segment other publishers make room
  /// for it, as for a message. Throws lot::Error or OutOfMemory.
  registry::ChannelName open_ring(std::uint32_t topic, const registry::RingOptions& options,
                                  std::uint32_t asker);
  /// Ends a ring of this process. Its readers get what is in it and then the end.
  void close_ring(const registry::ChannelName& name) noexcept;
  /// Finishes what closing has left to do, or leaves it to the warden.
  void settle_closing() noexcept;
  /// True when the orphanage holds the ring's blocks, so that the holds of this process on them may
  /// go.
  bool ring_closed(const registry::ChannelName& name) const noexcept;

  /// Reaps participant k if it is dead. False: it lives, or another thread or process is reaping.
  bool reap_if_dead(std::uint32_t k) noexcept;
  /// Reaps all dead participants. True when it has reaped one.
  bool reap_dead() noexcept;
  /// Frees what the orphanage has and no process needs any more: rings without readers, dead
  /// messages. False when the orphanage had nothing.
  bool collect() noexcept;
  /// Claims a run of memory for a block of this process, for the publisher that has the block. The
  /// run gets the block's tag. It comes from the segment, or, when that is full, from what can be
  /// freed. kNone: there is no run, and errno says why: 0, ENOSPC (the file system), EDQUOT (the
  /// publisher has all that PusherOptions::max_bytes gives it).
  std::uint32_t claim_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The same. A publisher that waits for readers does so here, if that can make room for the run.
  std::uint32_t await_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The same, only from memory that is free.
  std::uint32_t try_claim_run(std::uint32_t granules, std::uint32_t tag) noexcept;
  /// The same for Ahead, which leaves its publisher room for as many granules more. The run is
  /// mapped. It is given up when go_on() says no.
  template <class GoOn>
  std::uint32_t claim_run_while(std::uint32_t granules, std::uint32_t tag, GoOn&& go_on) noexcept {
    Pool& pool = holder_.pool_of(tag - 1);
    constexpr auto kNone = segment::Granules<segment::Atomics>::kNone;
    if (!pool.take(granules, granules)) return kNone;
    const std::uint32_t run = segment_.claim_run_while(granules, tag, go_on);
    if (run == kNone) pool.count_out(granules);
    return run;
  }
  /// Claims the granules behind a run that a block of this process has.
  bool extend_run(std::uint32_t end, std::uint32_t granules, std::uint32_t tag) noexcept;
  /// What is kept in the whole segment: messages that processes got from others and have pointers
  /// to, and messages that their own process has published and keeps.
  struct Kept {
    std::uint64_t granules = 0;
    std::uint64_t blocks = 0;
  };
  Kept weigh_kept() noexcept;
  /// Frees what can be freed without giving up a message, for the publisher with this pool.
  void tidy(std::uint32_t asker) noexcept;
  /// Gives idle memory of this process's pools back to the segment, for the need of the publisher
  /// with this pool, or of another process (kNobody). Other publishers keep what reserve() made.
  /// True when there was some.
  static constexpr std::uint32_t kNobody = ~std::uint32_t{0};
  bool trim(std::uint32_t asker) noexcept;
  Eviction& eviction() noexcept { return eviction_; }
  Ahead& ahead() noexcept { return ahead_; }
  /// Lets the calling thread run on the warden's cores, with the priority of a batch thread: it
  /// takes no core from a thread that runs. It was started by a thread that may have a core and a
  /// priority of its own.
  void place_beside_warden() noexcept;
  /// Gives unused memory of the segment back to the system, unit by unit, until enough() is true. A
  /// unit goes if `looks` looks in a row have found it unused. Returns the bytes.
  template <class Enough>
  std::uint64_t give_back_to_system(std::uint32_t looks, Enough&& enough) noexcept {
    std::uint64_t bytes = 0;
    for (std::uint32_t unit = segment_.first_unit(); unit < segment_.units(); ++unit) {
      if (!segment_.is_unused(unit, looks)) continue;
      if (!segment_.can_give_back() || enough()) break;
      bytes += give_back_unit(unit, looks);
    }
    return bytes;
  }
  /// Gives all unused memory back to the system at once, also what lies idle in pools of any
  /// process that answers.
  std::uint64_t give_all_back_to_system() noexcept;
  /// Lets messages go, one after the other, in the order that Eviction gives, until enough() is
  /// true. True when enough() was. Messages of another process are asked for. A stopped process is
  /// waited for once, longer where no other process can make enough() true. It is then passed over
  /// until it answers. `need`: what the asker will have more, in bytes or blocks. `possible`: says
  /// whether these givers can make enough() true. It is asked again when one has refused.
  template <class Enough, class Possible>
  bool evict_until(Enough&& enough, std::uint32_t asker, std::uint64_t need, Shortage shortage,
                   Possible&& possible) noexcept {
    using What = Eviction::Turn::What;
    Eviction::Givers givers = likely_givers();
    const auto until = futex::Clock::now() + kGivePatience;
    eviction_.look_at_others(shortage);
    if (!possible(givers)) return false;
    for (;;) {
      const Eviction::Turn turn = eviction_.evict(asker, need, shortage, givers);
      bool given = true;
      switch (turn.what) {
        case What::Nothing:
          return false;
        case What::Given:
          trim(asker);
          break;
        case What::Ask:
          given = givers[turn.from] = ask_to_give(turn.from, turn.request);
          break;
        case What::TakeOut:
          given = givers[refcount::kOrphanage] = take_out(turn.from, turn.block);
          break;
      }
      if (enough()) return true;
      if (turn.what == What::Given) continue;
      const bool is_late = futex::Clock::now() >= until;
      if (is_late) givers = {};  // messages of this process may still be enough
      eviction_.look_at_others(shortage);
      if (given || possible(givers)) continue;
      // Without that giver there is no room. If it was silent it may be slow, and not stopped.
      if (is_late || turn.what != What::Ask || !is_silent(turn.from)) return false;
      givers[turn.from] = true;
    }
  }

  /// Frees what can be freed, and then lets messages go, until enough() is true. enough() tries to
  /// claim a run of so many granules for the publisher with this pool. True when enough() was. No
  /// message goes for a run that can never be had.
  ///
  /// REQUIRES: the caller holds no lock that a warden takes.
  template <class Enough>
  bool make_room_for_run(std::uint32_t granules, std::uint32_t asker, Enough&& enough) noexcept {
    if (granules > segment_.granules().count()) return false;
    tidy(asker);
    if (enough()) return true;
    const bool gathers = may_gather();
    if (gathers && gather_from_others(enough)) return true;
    const auto possible = [&](const Eviction::Givers& givers) {
      return eviction_.can_free_run(asker, granules, givers);
    };
    return evict_until(enough, asker, segment::kGranule * granules, Shortage::Memory, possible) ||
           (!gathers && gather_from_others(enough));
  }

  /// The longest run below `granules` that the publisher with this pool could have if all that may
  /// go for it went, to within a 16th. The file system is not asked for memory: it is assumed to
  /// have what is needed, or nothing (`is_full`).
  std::uint32_t longest_run(std::uint32_t asker, std::uint32_t granules, bool is_full) noexcept;
  /// True when a wait for participant k has ended without an answer, and k has not answered since.
  bool is_silent(std::uint32_t k) const noexcept;

  /// A publisher that waits for room in its queue waits for memory and blocks, too, while readers
  /// have yet to read what has them. It waits until search() says that it is done, or the patience
  /// has ended. look() is a small search, which asks no other process. True when one of them was.
  ///
  /// REQUIRES: may_await_readers().
  template <class Search, class Look>
  bool await_readers(Search&& search, Look&& look, std::uint32_t asker,
                     Shortage shortage) noexcept {
    const auto until = detail::after(eviction_.patience(asker));
    for (;;) {
      // Before the search, so that what they read meanwhile counts.
      eviction_.look_at_others(shortage);
      const bool more = eviction_.has_unread(shortage);
      if (search()) return true;
      auto now = futex::Clock::now();
      if (!more || now >= until) return false;
      const auto again = std::min(until, now + kReaderSearch);
      for (; now < again; now = futex::Clock::now()) {
        std::this_thread::sleep_until(std::min(again, now + kReaderLook));
        tidy(asker);
        if (look()) return true;
        while (eviction_.could_give(asker, shortage) != 0 && eviction_.give_up(asker)) {
          trim(asker);
          if (look()) return true;
        }
      }
    }
  }
  /// False for the warden, which must not wait: it watches the other processes.
  bool may_await_readers(std::uint32_t asker) noexcept {
    return std::this_thread::get_id() != warden_.get_id() && eviction_.patience(asker).count() != 0;
  }

  /// Asks all other processes to give back the idle memory of their pools. Returns when enough() is
  /// true (it is asked now and then), when all have answered, or when the patience has ended, so
  /// that a stopped process delays the caller no longer. True when enough() was.
  template <class Enough>
  bool gather_from_others(Enough&& enough,
                          std::chrono::milliseconds patience = kAnswerPatience) noexcept {
    Questions questions;
    ask_others(questions);
    const auto until = futex::Clock::now() + patience;
    bool all = false;
    while (!all) {
      // Asked before enough(), so that the last answers count.
      all = all_have_answered(questions) || futex::Clock::now() >= until;
      if (enough()) return true;
      if (!all) std::this_thread::sleep_for(kAnswerLook);
    }
    return false;
  }
  /// True when the other processes were not asked within the last 100 ms. While messages of this
  /// process can make room, the others are asked no more often.
  bool may_gather() noexcept;

  /// True when the pointer belongs to this segment, whichever copy of the library made it.
  bool same_segment(const detail::ControlCell& cell) const noexcept;
  /// True when the message of a unique pointer was taken from a queue. Other processes may still
  /// look at its block, though not at the message.
  bool was_received(const detail::ControlCell& cell) const noexcept {
    // Relaxed: the slot that the message was taken from carries it (R1).
    return !holder_.is_home(cell.block) ||
           holder_.in_queue[cell.block].load(std::memory_order_relaxed) != 0;
  }
  /// The trust of a process whose code does not state one: what the environment says.
  static segment::Trust trust_of_environment();
  /// The queue engine that LOT_QUEUE in the environment names, else the one that the code asks for.
  static QueueEngine queue_engine(QueueEngine asked);
  /// The process is about to end, in the midst of its work. If it is the last one on a segment, the
  /// segment's files go. Nothing else is touched: other processes reap this one when it is dead.
  /// From then on no engine comes or goes, and fork() waits for the end. REQUIRES: watch_forks()
  /// before.
  static void remove_files() noexcept;
  /// From now on fork() leaves the child no held lock and no descriptor of this library.
  static void watch_forks() noexcept;
  /// The participant that has mapped this address, or null.
  static Participant* at(const void* address) noexcept;

  // What Recovery asks of its World.
  std::uint32_t participants() const noexcept;
  std::atomic<std::uint32_t>& part(std::uint32_t k) noexcept;
  std::uint32_t blocks() const noexcept { return segment_.capacity().blocks; }
  segment::BlockWords& block(std::uint32_t b) noexcept { return segment_.block(b); }
  std::uint32_t channels() const noexcept { return segment_.capacity().channels; }
  std::atomic<ring::Word>& channel_writer(std::uint32_t c) noexcept;
  segment::Ring ring(std::uint32_t c) const noexcept { return segment_.ring(c); }
  template <class F>
  void each_reference(std::uint32_t b, F&& f) {
    holder_.each_reference(b, f);
  }
  bool lock_rings() noexcept { return registry_.try_lock(); }
  void unlock_rings() noexcept { registry_.unlock(); }
  void recycle_ring(std::uint32_t c) noexcept { registry_.recycle(c); }
  void release_extents(const std::vector<bool>& dead) noexcept;
  void renew_directory() noexcept;
  void unsubscribe(std::uint32_t k) noexcept { registry_.unsubscribe(k); }
  void forget(std::uint32_t k) noexcept;
  void wake(std::atomic<ring::Word>& word) noexcept { futex::wake_all(futex::low_half(word)); }
  void wake(std::atomic<std::uint32_t>& word) noexcept { futex::wake_all(&word); }

 private:
  /// How long to wait for another process that acts for the orphanage.
  static constexpr std::chrono::seconds kOrphanagePatience{2};
  /// The same inside the gate, where processes that come and go wait. They get in within a second.
  static constexpr std::chrono::milliseconds kOrphanagePatienceInGate{400};

  static constexpr std::chrono::milliseconds kAnswerPatience{10};
  static constexpr std::chrono::microseconds kAnswerLook{100};
  static constexpr std::chrono::milliseconds kReaderLook{1};
  static constexpr std::chrono::milliseconds kReaderSearch{20};
  /// How long to wait for one giver of a message. A busy machine runs its warden late.
  static constexpr std::chrono::milliseconds kGiverPatience{200};
  /// How long to wait for all givers together. Another process may be faster to take what was
  /// given.
  static constexpr std::chrono::seconds kGivePatience{1};
  /// Which participants were asked for memory, and how often they had answered before.
  struct Questions {
    std::array<bool, segment::kMaxParticipants> asked{};
    std::array<std::uint32_t, segment::kMaxParticipants> answers;
  };

  struct OwnedHub : detail::Hub {
    Participant* owner = nullptr;
  };
  struct Draining {
    Pool* pool;
    registry::ChannelName ring;
    std::vector<std::uint32_t> blocks;
    bool releasing;  ///< a thread is giving up what the ring held: blocks may still come home
  };
  using Recovery = recovery::Recovery<detail::HardwareAtomics, Participant>;
  class GateGuard;

  void remove_files_if_last() noexcept;
  void settle_files() noexcept;
  void note_settled() noexcept;
  std::optional<std::uint32_t> claim_spare_block() noexcept;
  std::uint64_t give_back_unit(std::uint32_t unit, std::uint32_t looks) noexcept;
  bool make_room_in(Pool& pool, std::uint32_t granules) noexcept;
  bool is_kept(std::uint32_t b) noexcept;

  Participant(const EngineOptions& options, const segment::Trust& trust,
              std::shared_ptr<liveness::LockFile> lock_file);
  static Participant& of(const detail::ControlCell* cell) noexcept;
  static std::shared_ptr<Participant> joined(const EngineOptions& options, const std::string& path,
                                             const segment::Trust& trust);
  static std::shared_ptr<Participant> admit(const EngineOptions& options, const std::string& path,
                                            const segment::Trust& trust,
                                            const std::shared_ptr<liveness::LockFile>& file);
  void fill_hub() noexcept;
  void fill_pointers() noexcept;
  void fill_weak_pointers() noexcept;
  void fill_answers() noexcept;
  void take_index(const EngineOptions& options);
  bool try_take_index(bool of_a_dead_one, futex::Clock::time_point until);
  bool repair_index(futex::Clock::time_point until) noexcept;
  void warden();
  void keep_own_lock() noexcept;
  void expel() noexcept;
  void forget_sightings() noexcept;
  void note_sightings() noexcept;
  bool enter_orphanage() noexcept;
  void leave_orphanage() noexcept;
  /// False when something is left to do: a lock was taken, or others hold messages.
  bool finish_closing() noexcept;
  bool is_closing(std::uint32_t channel) noexcept;
  /// True when no hold of a ring is left that a thread of this process has still to give up.
  bool rings_closed() noexcept;
  bool is_releasing() noexcept;
  /// REQUIRES: pools_mutex_ is held. Destructors of messages run under it.
  bool trim_pools() noexcept;
  /// Gives back the extents that messages under construction do not need yet, in the pools that
  /// may(index) names.
  ///
  /// REQUIRES: pools_mutex_, so that one thread at a time wants spare extents. What a thread takes
  /// was then wanted before its own barrier.
  template <class May>
  bool take_spare(May&& may) noexcept;
  void stand_guard() noexcept;
  void ring_warden() noexcept;
  /// False when some departures are left.
  bool finish_departures() noexcept;
  /// Counts one handle of the topic less. REQUIRES: topics_mutex_.
  void count_out(std::uint32_t topic) noexcept;
  void run_errands(std::uint32_t asked) noexcept;
  void settle_kept() noexcept;
  void settle_idle() noexcept;
  void give_unused_back() noexcept;
  void tell_homes() noexcept;
  void ask_others(Questions& questions) noexcept;
  /// Asks participant k for messages. False: it has given nothing, or has not answered.
  bool ask_to_give(std::uint32_t k, const Request& request) noexcept;
  /// Brings participant k's warden an errand and waits until done() is true. False: k has not
  /// answered in time. It is then not asked again until it has answered something.
  template <class Done>
  bool ask_and_wait(std::uint32_t k, std::uint32_t errand, Done&& done) noexcept;
  /// All other participants but the silent ones (is_silent()). The warden has no givers: it must
  /// not wait.
  Eviction::Givers likely_givers() const noexcept;
  /// Takes a message out of the ended ring of a channel, and frees it. False: the message has not
  /// become free.
  bool take_out(std::uint32_t channel, std::uint32_t block) noexcept;
  bool all_have_answered(const Questions& questions) noexcept;
  bool look_around() noexcept;
  bool watch_others() noexcept;
  std::uint32_t used_channels() noexcept;

  void enter() noexcept;
  void exit() noexcept;
  void drop_reference() noexcept;
  void leave_if_unused() noexcept;
  bool has_left() noexcept;
  /// True when the one pointer of this process is all that can see the message.
  bool is_alone(const detail::ControlCell& cell) const noexcept;
  bool holds_pointers() noexcept;
  bool has_orphan_rings() noexcept;
  bool has_ending_rings() noexcept;
  bool has_deserted_ring() noexcept;
  /// Called when the last handle has gone. The participant leaves now, or when the last pointer
  /// goes.
  static void handle_gone(Participant* p) noexcept;
  void leave() noexcept;

  /// Held while a lock file is opened or closed: a forked child must know all descriptors that it
  /// has to close.
  static std::mutex& no_fork() noexcept;
  static void prepare_fork() noexcept;
  static void after_fork_in_parent() noexcept;
  static void after_fork_in_child() noexcept;

  OwnedHub hub_;
  const segment::Trust trust_;
  std::shared_ptr<liveness::LockFile> lock_file_;
  std::atomic<bool> inert_{false};  ///< true in a forked child, or if is_expelled_
  std::atomic<bool> is_expelled_{false};
  segment::Segment segment_;
  liveness::Presence presence_;
  alignas(64) Holder holder_;
  registry::Registry registry_;
  std::size_t cells_bytes_ = 0;

  std::mutex reap_mutex_;  ///< byte locks do not exclude threads of one process
  /// Held while kept messages die, with no other lock, since their destructors are the
  /// application's code. Taken before pools_mutex_.
  std::mutex settle_mutex_;
  std::mutex pools_mutex_;
  std::vector<std::unique_ptr<Pool>> pools_;
  std::vector<Draining> draining_;
  std::vector<Pool*> idle_;
  Eviction eviction_{holder_, segment_};
  Ahead ahead_{*this};
  std::mutex topics_mutex_;
  std::unordered_map<std::uint32_t, unsigned> topic_uses_;

  std::thread warden_;
  std::atomic<bool> warden_stop_{false};
  // Both relaxed: errands (E1) carry the first. What the second tells of is in the file system.
  std::atomic<bool> is_ending_{false};  ///< a signal ends the process: the files are to go
  /// 1: this process has done what it can for its files. remove_files() sleeps on the word.
  std::atomic<std::uint32_t> files_settled_{0};
  std::mutex departures_mutex_;
  std::list<registry::Departure> departures_;  ///< those that the warden has to finish
  // Only the warden uses these, from here...
  detail::FutexWaits watched_;        ///< what it sleeps on
  futex::Clock::time_point looked_;   ///< its last look for what no errand and no notice tells it
  bool orphans_ = true;               ///< the last search found orphans, or there was no search yet
  std::uint32_t bequests_ = 0;        ///< Directory::bequests before the last search
  std::vector<std::uint64_t> lives_;  ///< [blocks] `life` when it last looked
  /// [blocks] other processes held this message, as far as can be seen.
  std::vector<bool> was_held_;
  std::vector<std::uint64_t> prints_;      ///< [pools] a hash over the blocks at its last look
  std::vector<std::uint64_t> new_prints_;  ///< [pools] while it looks
  std::vector<bool> to_settle_;            ///< [pools] while it looks
  std::vector<std::uint8_t> idle_looks_;   ///< [blocks] how many looks in a row found it unchanged
  std::vector<bool> to_trim_;              ///< [pools] while it looks
  // ... to here.
  std::atomic<std::uint32_t> used_channels_{0};
  std::atomic<futex::Clock::rep> gathered_{0};  ///< when the other processes were asked last
  /// By participant: its count of answers plus 1 when a wait for it last ended without an answer;
  /// 0: that never happened. Private to the process.
  std::array<std::atomic<std::uint64_t>, segment::kMaxParticipants> silent_{};

  std::atomic<bool> left_{false};
  std::mutex leave_mutex_;
  bool lock_lost_ = false;  ///< this process must lock its byte again; used by the warden only
  /// What the last look saw this process hold, and since when. Only the warden uses it.
  std::unordered_map<std::uint64_t, std::uint64_t> held_since_;

  /// {closing : 1 | references : 31 | inside : 32}. Closing: all handles have gone. References: the
  /// membership is one, each weak pointer and each thread inside is one. At none the object is
  /// destroyed. Inside: threads that are dropping a last pointer.
  ///
  /// seq_cst, with left_: a thread that enters bumps life_, and may look at left_ and take a hold.
  /// The thread that makes the participant leave sets left_, and then looks at life_ and the holds.
  /// One of the two sees the other.
  static constexpr std::uint64_t kInside = 1;
  static constexpr std::uint64_t kInsideMask = 0xffffffff;
  static constexpr std::uint64_t kReference = std::uint64_t{1} << 32;
  static constexpr std::uint64_t kReferences = std::uint64_t{0x7fffffff} << 32;
  static constexpr std::uint64_t kClosing = std::uint64_t{1} << 63;
  std::atomic<std::uint64_t> life_{kReference};
};

/// Calls f. If f finds all places taken, it is called again after the dead have lost theirs. For so
/// long another process may be reaping.
template <class F>
void after_reaping(Participant& participant, F&& f) {
  constexpr std::chrono::milliseconds kAnotherReaper{20};
  const auto until = futex::Clock::now() + kAnotherReaper;
  for (;;) {
    try {
      f();
      return;
    } catch (const Error& e) {
      const bool full = e.error_number() == EUSERS || e.error_number() == ENOSPC;
      if (!full || futex::Clock::now() >= until) throw;
    }
    if (!participant.reap_dead()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

/// Throws lot::Error when no queue can be so deep.
void check_depth(std::string_view topic, std::uint32_t depth);
/// A variable of the environment. Null when it is not set or empty, or when the program has rights
/// that its caller lacks (secure_getenv).
const char* environment(const char* name);

}  // namespace lot::transport
