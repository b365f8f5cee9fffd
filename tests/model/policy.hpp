// SPDX-License-Identifier: Apache-2.0
#pragma once

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
  void aim(unsigned step) { remaining_[rl::thread_index()] = step; }
  void aim_at_nobody() { remaining_ = {}; }

  void step() {
    unsigned& remaining = remaining_[rl::thread_index()];
    if (remaining != 0 && --remaining == 0) throw Killed{};
  }

 private:
  std::array<unsigned, 8> remaining_{};
};

inline Killer killer;

/// std::atomic's interface on rl::atomic. compare_exchange_weak never fails spuriously: every loop
/// around one must stand the other failures anyway, and the search stays bounded.
template <class T>
class CheckedAtomic {
  using Where = std::source_location;
  using Order = std::memory_order;

 public:
  CheckedAtomic() { value_.store(T{}, rl::mo_relaxed, rl::debug_info("initial", "", 0)); }

  T load(Order order, Where where = Where::current()) const {
    const Done done = begin(Operation::Load, order, where);
    return value_.load(for_load(done.order), info(where));
  }

  void store(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Store, order, where);
    if (!done.dropped) value_.store(value, for_store(done.order), info(where));
  }

  T exchange(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Exchange, order, where);
    return value_.exchange(value, for_both(done.order), info(where));
  }

  T fetch_add(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    return value_.fetch_add(value, for_both(done.order), info(where));
  }
  T fetch_sub(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    return value_.fetch_sub(value, for_both(done.order), info(where));
  }
  T fetch_or(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    return value_.fetch_or(value, for_both(done.order), info(where));
  }
  T fetch_and(T value, Order order, Where where = Where::current()) {
    const Done done = begin(Operation::Fetch, order, where);
    if (done.dropped) return value_.load(rl::mo_relaxed, info(where));
    return value_.fetch_and(value, for_both(done.order), info(where));
  }

  bool compare_exchange_strong(T& expected, T desired, Order success, Order failure,
                               Where where = Where::current()) {
    const Done done = begin(Operation::CompareExchange, success, where);
    const rl::memory_order weakened = for_both(done.order);
    return value_.compare_exchange(rl::bool_t<false>(), expected, desired, weakened,
                                   no_stronger(for_load(failure), weakened), info(where));
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

  /// FUTEX_WAIT: the comparison and the falling asleep are one step, and the kernel's bucket lock
  /// is a full barrier on both sides.
  void wait_while(T value, Where where = Where::current()) {
    killer.step();
    rl::context& c = rl::ctx();
    c.atomic_thread_fence_seq_cst();
    {
      rl::preemption_disabler until_asleep(c);
      if (value_.load(rl::mo_acquire, info(where)) != value) return;
    }
    value_.wait(c, false, false, info(where));
  }

  /// FUTEX_WAKE of everybody.
  void wake_all(Where where = Where::current()) {
    killer.step();
    rl::context& c = rl::ctx();
    c.atomic_thread_fence_seq_cst();
    value_.wake(c, 100, info(where));
  }

 private:
  static Done begin(Operation operation, Order order, const Where& where) {
    killer.step();
    return garden.look({operation, order, where});
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
  /// Relacy refuses a failure order that is stronger than what the success order loads with.
  static rl::memory_order no_stronger(rl::memory_order failure, rl::memory_order success) {
    const rl::memory_order most = success == rl::mo_acq_rel   ? rl::mo_acquire
                                  : success == rl::mo_release ? rl::mo_relaxed
                                                              : success;
    return failure < most ? failure : most;
  }

  rl::atomic<T> value_;
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

/// Few participants in many words: 0 and 1, 2 and 3, 4 and 5 share an ownership word.
struct Policy {
  template <class T>
  using Atomic = CheckedAtomic<T>;

  static constexpr std::size_t kLine = 16;
  static constexpr unsigned kOwnWords = 3;
  static constexpr unsigned kBitsPerWord = 2;

  static void pause() { rl::yield(1, RL_INFO); }
  static void prefetch_read(const void*) {}
  static void prefetch_write(const void*) {}
};

}  // namespace lot::model
