// SPDX-License-Identifier: Apache-2.0
#include "transport/participant.hpp"

#include <chrono>
#include <map>
#include <mutex>
#include <new>
#include <pthread.h>
#include <thread>
#include <utility>
#include <vector>

#include "lot/detail/mutex.hpp"
#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "transport/environment.hpp"

namespace lot::transport {
namespace {

/// How long the last handle waits for another process that acts for the orphanage.
constexpr std::chrono::seconds kOrphanagePatience{2};

/// The participants of this process. The object is never destroyed, since static destructors that
/// run after this library's may release pointers.
struct Process {
  /// held while a thread joins, which may take long
  detail::Mutex joining{detail::Rank::Joining};
  detail::Mutex mutex{detail::Rank::Process};  ///< guards the lists
  std::map<std::string, std::weak_ptr<Participant>> by_path;
  std::vector<Participant*> all;
};
Process& process() {
  static auto* const p = new Process;
  return *p;
}

}  // namespace

/// The participant that this process has at the path already. Null: it has none.
std::shared_ptr<Participant> Participant::joined(const EngineOptions& options,
                                                 const std::string& path,
                                                 const segment::Trust& trust) {
  std::shared_ptr<Participant> existing;  // declared before the guard: if it is the last handle, it
                                          // goes after the mutex is unlocked
  const std::lock_guard guard(process().mutex);
  existing = process().by_path[path].lock();
  if (!existing || existing->inert()) return nullptr;
  const std::string other = existing->segment().other_size(options.size_bytes);
  if (!other.empty()) refuse_stale(path, other);
  existing->membership_.lock_file().require(trust);
  const std::string reason = existing->membership_.lock_file().shortfall(trust);
  if (!reason.empty()) refuse_narrow(path + ".lock", reason);
  if (options.lock_memory) existing->segment().lock_memory();
  if (options.persist) existing->segment().keep_files();
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
  if (options.persist) p->segment().keep_files();
  const std::lock_guard guard(process().mutex);
  process().by_path[path] = handle;
  process().all.push_back(p);
  return handle;
}

std::shared_ptr<Participant> Participant::join(EngineOptions options, IfAbsent if_absent) {
  // A visitor says itself which segment it means.
  if (if_absent == IfAbsent::Make) options = with_environment(std::move(options));
  const std::string path = segment::path_of(options.directory, options.segment);
  segment::Trust trust = segment::Trust::of(options);
  trust.wants_all = if_absent == IfAbsent::Make;
  watch_forks();
  const std::lock_guard joining(process().joining);
  std::shared_ptr<Participant> handle = joined(options, path, trust);
  if (handle) return handle;
  pass_gate(options, path, trust, if_absent,
            [&](const auto& lock_file) { handle = admit(options, path, trust, lock_file); });
  handle->reaper().reap_all_dead();
  return handle;
}

Participant::Participant(const EngineOptions& options, const segment::Trust& trust,
                         std::shared_ptr<liveness::LockFile> lock_file)
    : membership_(options, trust, std::move(lock_file)),
      registry_(segment(), membership_.presence()),
      world_(segment(), registry_),
      hub_(membership_, lifetime_, holder_),
      control_blocks_(blocks(), hub_),
      ahead_(segment(), warden_thread_),
      rouser_(warden_thread_),
      eviction_(holder_, segment()),
      stock_(segment(), holder_, ahead_),
      reaper_(membership_, world_, holder_),
      neighbours_(segment(), world_, holder_),
      memory_({segment(), world_, holder_, ahead_, eviction_, stock_, reaper_, neighbours_,
               warden_thread_}),
      topics_(registry_, holder_, reaper_),
      rings_(world_, registry_, holder_, reaper_, stock_, memory_),
      warden_({membership_, world_, holder_, warden_thread_, eviction_, stock_, reaper_, rings_,
               topics_, process().mutex}) {
  holder_.segment = &segment();
  holder_.controls = control_blocks_.all();
  holder_.make_tables(blocks());
  eviction_.prepare(blocks(), segment().capacity().channels);
  take_index(options.name);
  try {
    warden_.start();
  } catch (...) {
    membership_.return_index();
    throw;
  }
}

/// REQUIRES: the gate is held.
void Participant::take_index(std::string_view name) {
  membership_.lock_file().take_turn();
  membership_.take_index(name, [this](futex::Clock::time_point until) {
    holder_.own = HardwareOwnership(membership_.index());
    return reaper_.repair_index(until);
  });
  membership_.lock_file().take_turn();
  holder_.next_free = (blocks() / world_.participants()) * index();
}

void Participant::handle_gone(Participant* p) noexcept {
  if (p->inert()) return;  // a forked child touches nothing and has no thread to stop
  p->lifetime_.enter();
  p->ahead_.stop();  // the block that it is making is a hold of this process
  p->rouser_.stop();
  p->descriptors_.stop();
  // Closing is finished here: when the warden brings the last block home, no thread checks whether
  // the participant may leave. The wait is bounded, since a process that acts for the orphanage may
  // be stopped.
  const auto until = futex::Clock::now() + kOrphanagePatience;
  while (p->rings_.finish_closing(),
         !p->rings_.are_closed() && (futex::Clock::now() < until || p->stock_.is_releasing())) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  p->lifetime_.close();
  p->lifetime_.exit();
}

bool Participant::holds_pointers() noexcept { return stock_.holds_pointers(); }

void Participant::leave() noexcept {
  warden_.stop();
  // Not earlier: a child that is forked meanwhile must close the lock file.
  const std::lock_guard guard(process().mutex);
  membership_.lock_file().abandon();
  std::erase(process().all, this);
}

void Participant::end() noexcept { delete this; }

Participant* Participant::at(const void* address) noexcept {
  const std::lock_guard guard(process().mutex);
  for (Participant* p : process().all) {
    const auto* base = p->segment().base();
    if (address >= base && address < base + p->segment().size() && !p->inert()) return p;
  }
  return nullptr;
}

void Participant::remove_files() noexcept {
  const auto until = futex::Clock::now() + kGatePatience;
  const auto lock = [until](detail::Mutex& mutex) {
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
  for (Participant* p : process().all) p->warden_.end_soon();
  for (Participant* p : process().all) p->membership_.await_settled(until);
}

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
  for (Participant* p : process().all) p->membership_.abandon();
  process().all.clear();
  process().by_path.clear();
  process().mutex.unlock();
  process().joining.unlock();
}

}  // namespace lot::transport
