// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "futex/futex.hpp"
#include "plant.hpp"
#include "relacy.hpp"

/// The atomics policy of the model: every access is checked by Relacy, may be the last one of a
/// process that is killed, and may be weakened to see whether the model notices.
namespace lot::model {

/// Takes the heap away from Relacy, which replaces operator new: it would explore the ways in which
/// memory may be used again, and find leaks in what outlives a run. Shared memory is no heap.
struct OrdinaryHeap : rl::context {
  static void use() { rl::ctx().*(&OrdinaryHeap::disable_alloc_) = 1; }
};

/// Thrown where a process is killed: unwinding is all that it still does, and nothing on its way
/// touches shared memory.
struct Killed {};

/// Kills the process that a thread plays, at one of its next atomic steps.
class Killer {
 public:
  /// 0: not at all.
  void aim(unsigned step) {
    remaining_[rl::thread_index()] = step;
    dead_[rl::thread_index()] = false;
  }
  void aim_at_nobody() {
    remaining_ = {};
    dead_ = {};
  }

  void step() {
    unsigned& remaining = remaining_[rl::thread_index()];
    if (remaining == 0 || --remaining != 0) return;
    dead_[rl::thread_index()] = true;
    throw Killed{};
  }
  /// It was hit: what is left of it must touch nothing.
  bool has_hit() const { return dead_[rl::thread_index()]; }

 private:
  std::array<unsigned, 8> remaining_{};
  std::array<bool, 8> dead_{};
};

inline Killer killer;

template <class T>
class CheckedAtomic;

/// Where a thread sleeps: FUTEX_WAIT, or futex_waitv when it is on many words. The kernel compares
/// one word and queues the thread on it, then the next one; each of these is one step under the
/// lock of the word's bucket. (Its system calls order more than that; nobody has promised it.)
class Bed {
  using Where = std::source_location;

 public:
  Bed() { pillow_.store(0, rl::mo_relaxed, rl::debug_info("initial", "", 0)); }
  ~Bed() {
    for (const auto& leave : queues_) leave();
  }
  Bed(const Bed&) = delete;
  Bed& operator=(const Bed&) = delete;

  /// One word more to sleep on, while it has this value.
  template <class T>
  void add(const CheckedAtomic<T>& word, T value, bool is_shared = false) {
    words_.push_back([this, &word, value](Where where) { return queue_on(word, value, where); });
    if (!is_shared) return;
    duties_.push_back([&word, value] {
      if (word.load(std::memory_order_relaxed) != value) word.wake(futex::kWakes);
    });
  }
  /// As waiting::pass_on().
  void pass_on() const {
    for (const auto& duty : duties_) duty();
  }
  void sleep(Where where = Where::current()) {
    for (const auto& queue_on : words_) {
      if (!queue_on(where)) return;
    }
    if (!woken_) pillow_.wait(rl::ctx(), false, false, info(where));
  }
  void wake(Where where) {
    woken_ = true;
    pillow_.wake(rl::ctx(), 1, info(where));
  }

 private:
  /// False when the word has another value, or somebody has woken us already.
  template <class T>
  bool queue_on(const CheckedAtomic<T>& word, T value, Where where) {
    killer.step();
    word.take_bucket(where);
    rl::preemption_disabler one_step(rl::ctx());
    if (woken_ || word.value_.load(rl::mo_acquire, info(where)) != value) return false;
    word.beds_.push_back(this);
    queues_.push_back([this, &word] { std::erase(word.beds_, this); });
    return true;
  }
  static rl::debug_info info(const Where& where) {
    return rl::debug_info(where.function_name(), where.file_name(), where.line());
  }

  bool woken_ = false;
  rl::atomic<unsigned> pillow_;
  std::vector<std::function<bool(Where)>> words_;
  std::vector<std::function<void()>> queues_;  ///< how to leave those that we are on
  std::vector<std::function<void()>> duties_;  ///< how to wake others that sleep on them
};

/// A plain variable: two accesses that nothing orders are a data race, and fail the run.
template <class T>
class Plain {
  using Where = std::source_location;

 public:
  T read(Where where = Where::current()) const { return value_(info(where)); }
  void write(T value, Where where = Where::current()) { value_(info(where)) = value; }

 private:
  static rl::debug_info info(const Where& where) {
    return rl::debug_info(where.function_name(), where.file_name(), where.line());
  }

  rl::var<T> value_;
};

/// std::atomic's interface on rl::atomic. compare_exchange_weak never fails spuriously: every loop
/// around one must stand the other failures anyway, and the search stays bounded.
template <class T>
class CheckedAtomic {
  using Where = std::source_location;
  using Order = std::memory_order;

 public:
  CheckedAtomic() { value_.store(T{}, rl::mo_relaxed, rl::debug_info("initial", "", 0)); }

  /// Of a word whose bits each belong to somebody: changes of one bit must be ordered by more than
  /// the schedule. (Relacy does stores and read-modify-writes in the order of the schedule; a
  /// machine may not.)
  void watch_bits(unsigned count) {
    for (bits_.resize(count); auto& bit : bits_) bit.write(0);
  }

  T load(Order order, Where where = Where::current()) const {
    const Done done = begin(Operation::Load, order, order, where);
    const auto before = done.stale ? garden.remembered(this, rl::thread_index()) : std::nullopt;
    if (before) {
      rl::ctx().sched();
      return static_cast<T>(*before);
    }
    return remember(value_.load(for_load(done.order), info(where)));
  }

  void store(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Store, order, order, where);
    if (done.dropped) return;
    touch(static_cast<T>(~T{0}), where);
    value_.store(value, for_store(done.order), info(where));
  }

  T exchange(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Exchange, order, order, where);
    return remember(value_.exchange(value, for_both(done.order), info(where)));
  }

  T fetch_add(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    return remember(value_.fetch_add(value, for_both(done.order), info(where)));
  }
  T fetch_sub(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    return remember(value_.fetch_sub(value, for_both(done.order), info(where)));
  }
  T fetch_or(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    const T old = remember(value_.fetch_or(value, for_both(done.order), info(where)));
    touch(value, where);
    return old;
  }
  T fetch_and(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    const T old = remember(value_.fetch_and(value, for_both(done.order), info(where)));
    touch(~value, where);
    return old;
  }

  bool compare_exchange_strong(T& expected, T desired, Order success, Order failure,
                               Where where = Where::current()) {
    const Done done = begin(Operation::CompareExchange, success, failure, where);
    if (done.dropped) return true;
    const bool will = rl::compare_exchange(value_, expected, desired, for_both(done.order),
                                           for_load(done.failure), info(where));
    remember(expected);
    return will;
  }
  bool compare_exchange_strong(T& expected, T desired, Order order,
                               Where where = Where::current()) {
    return compare_exchange_strong(expected, desired, order, order, where);
  }
  bool compare_exchange_weak(T& expected, T desired, Order success, Order failure,
                             Where where = Where::current()) {
    return compare_exchange_strong(expected, desired, success, failure, where);
  }
  bool compare_exchange_weak(T& expected, T desired, Order order, Where where = Where::current()) {
    return compare_exchange_strong(expected, desired, order, order, where);
  }

  /// FUTEX_WAIT.
  void wait_while(T value, Where where = Where::current()) const {
    Bed bed;
    bed.add(*this, value);
    bed.sleep(where);
  }

  /// FUTEX_WAKE of some: how many there were.
  int wake(int count, Where where = Where::current()) const {
    killer.step();
    take_bucket(where);
    int woken = 0;
    for (; woken < count && !beds_.empty(); ++woken) {
      beds_.front()->wake(where);
      beds_.erase(beds_.begin());
    }
    return woken;
  }
  void wake_one(Where where = Where::current()) const { wake(1, where); }

  /// FUTEX_WAKE of everybody.
  void wake_all(Where where = Where::current()) const {
    killer.step();
    take_bucket(where);
    for (Bed* bed : beds_) bed->wake(where);
    beds_.clear();
  }

 private:
  static Done begin(Operation operation, Order order, Order failure, const Where& where) {
    killer.step();
    return garden.look({operation, order, failure, where});
  }
  /// Orders who sleeps on the word and who wakes, one after the other.
  void take_bucket(const Where& where) const {
    if (!bucket_) {
      rl::preemption_disabler until_made(rl::ctx());
      bucket_.emplace();
      bucket_->store(0, rl::mo_relaxed, rl::debug_info("initial", "", 0));
    }
    bucket_->fetch_add(1, rl::mo_acq_rel, info(where));
  }
  void touch(T bits, Where where) {
    for (unsigned i = 0; i < bits_.size(); ++i) {
      if ((bits >> i & 1) != 0) bits_[i].write(0, where);
    }
  }
  T remember(T value) const {
    if (garden.remembers()) garden.remember(this, rl::thread_index(), value);
    return value;
  }
  static rl::debug_info info(const Where& where) {
    return rl::debug_info(where.function_name(), where.file_name(), where.line());
  }

  static rl::memory_order for_both(Order order) {
    switch (order) {
      case Order::relaxed:
        return rl::mo_relaxed;
      case Order::consume:
      case Order::acquire:
        return rl::mo_acquire;
      case Order::release:
        return rl::mo_release;
      case Order::acq_rel:
        return rl::mo_acq_rel;
      case Order::seq_cst:
        break;
    }
    return rl::mo_seq_cst;
  }
  static rl::memory_order for_load(Order order) {
    const rl::memory_order mo = for_both(order);
    return mo == rl::mo_acq_rel ? rl::mo_acquire : mo == rl::mo_release ? rl::mo_relaxed : mo;
  }
  static rl::memory_order for_store(Order order) {
    const rl::memory_order mo = for_both(order);
    return mo == rl::mo_acq_rel ? rl::mo_release : mo == rl::mo_acquire ? rl::mo_relaxed : mo;
  }

  friend class Bed;
  rl::atomic<T> value_;
  mutable std::vector<Bed*> beds_;  ///< who sleeps here
  mutable std::optional<rl::atomic<unsigned>> bucket_;
  std::vector<Plain<int>> bits_;
};

/// Few participants in many words: 0 and 1, 2 and 3, 4 and 5 share an ownership word.
struct Policy {
  template <class T>
  using Atomic = CheckedAtomic<T>;

  static constexpr std::size_t kLine = 16;
  static constexpr unsigned kOwnWords = 3;
  static constexpr unsigned kBitsPerWord = 2;

  static void pause() { rl::yield(1, RL_INFO); }
  struct Patience {
    void wait(std::uint32_t thread) {
      RL_ASSERT(thread != this_thread());
      pause();
    }
  };
  static std::uint32_t this_thread() { return rl::thread_index() + 1; }
  static void passed() {}
  /// Set by scenarios that do damage. All others must never see any.
  static inline bool does_damage = false;
  static void damage_seen() { RL_ASSERT(does_damage); }
  static void acquire_fence() {
    if (!garden.omitted.fence_of_reader) rl::atomic_thread_fence(rl::mo_acquire, RL_INFO);
  }
  static void release_fence() {
    if (!garden.omitted.fence_of_writer) rl::atomic_thread_fence(rl::mo_release, RL_INFO);
  }
  static void prefetch_read(const void*) {}
  static void prefetch_write(const void*) {}
};

}  // namespace lot::model
