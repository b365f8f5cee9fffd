// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>

#include "explorer.hpp"

/// What the model of the protocol (../model) uses of Relacy, by the same names, from the explorer:
/// so each scenario is written once.
namespace rl {

namespace weak = lot::weak;

enum memory_order { mo_relaxed, mo_consume, mo_acquire, mo_release, mo_acq_rel, mo_seq_cst };

inline weak::Order std_order(memory_order order) {
  constexpr weak::Order kOrders[] = {weak::Order::relaxed, weak::Order::acquire,
                                     weak::Order::acquire, weak::Order::release,
                                     weak::Order::acq_rel, weak::Order::seq_cst};
  return kOrders[order];
}
inline const char* name(memory_order order) {
  constexpr const char* kNames[] = {"relaxed", "consume", "acquire",
                                    "release", "acq_rel", "seq_cst"};
  return kNames[order];
}

struct debug_info : weak::Place {
  debug_info(const char* in, const char* of, unsigned at) : Place{in, of, at} {}
};

inline weak::Explorer& explorer() { return *weak::Explorer::current(); }

struct context {
  void sched() { explorer().step(); }
  int disable_alloc_ = 0;
};
inline context& ctx() {
  static context only;
  return only;
}
inline unsigned thread_index() { return explorer().thread_index(); }
inline unsigned rand(unsigned count) { return explorer().random(count); }
inline void yield(unsigned, const debug_info&) { explorer().pause(); }
inline void atomic_thread_fence(memory_order order, const debug_info& info) {
  auto& e = explorer();
  e.step();
  e.memory().fence(e.thread(), std_order(order));
  if (e.tells()) e.tell("fence", nullptr, 0, name(order), info);
}

class preemption_disabler {
 public:
  explicit preemption_disabler(context&) { explorer().disable_preemption(1); }
  ~preemption_disabler() { explorer().disable_preemption(-1); }
  preemption_disabler(const preemption_disabler&) = delete;
  preemption_disabler& operator=(const preemption_disabler&) = delete;
};

[[noreturn]] inline void failed(const char* what, const char* file, unsigned line) {
  const std::string path = file;
  explorer().fail(what, path.substr(path.rfind('/') + 1) + ':' + std::to_string(line));
}

template <class T>
class atomic {
 public:
  atomic() : at_(explorer().memory().make()) {}
  ~atomic() {
    if (weak::Explorer::current() != nullptr) explorer().memory().give_back(at_);
  }
  atomic(const atomic&) = delete;
  atomic& operator=(const atomic&) = delete;

  T load(memory_order order, const debug_info& info) const {
    auto& e = explorer();
    e.step();
    const auto value = static_cast<T>(e.memory().load(e.thread(), at_, std_order(order)));
    return tell("load", value, order, info);
  }
  void store(T value, memory_order order, const debug_info& info) {
    auto& e = explorer();
    if (!at_.is_empty()) e.step();
    e.memory().store(e.thread(), at_, static_cast<weak::Value>(value), std_order(order));
    tell("store", value, order, info);
  }
  T exchange(T value, memory_order order, const debug_info& info) {
    return change(
        "exchange", [value](T) { return value; }, order, info);
  }
  T fetch_add(T by, memory_order order, const debug_info& info) {
    return change(
        "fetch_add", [by](T old) { return static_cast<T>(old + by); }, order, info);
  }
  T fetch_sub(T by, memory_order order, const debug_info& info) {
    return change(
        "fetch_sub", [by](T old) { return static_cast<T>(old - by); }, order, info);
  }
  T fetch_or(T by, memory_order order, const debug_info& info) {
    return change(
        "fetch_or", [by](T old) { return static_cast<T>(old | by); }, order, info);
  }
  T fetch_and(T by, memory_order order, const debug_info& info) {
    return change(
        "fetch_and", [by](T old) { return static_cast<T>(old & by); }, order, info);
  }
  bool compare_exchange(T& expected, T desired, memory_order success, memory_order failure,
                        const debug_info& info) {
    auto& e = explorer();
    e.step();
    auto seen = static_cast<weak::Value>(expected);
    const bool done =
        e.memory().compare_exchange(e.thread(), at_, seen, static_cast<weak::Value>(desired),
                                    std_order(success), std_order(failure));
    expected = static_cast<T>(seen);
    tell(done ? "cas" : "cas, no", done ? desired : expected, done ? success : failure, info);
    return done;
  }

  // A futex. The kernel's calls order nothing here.
  void wait(context&, bool, bool, const debug_info& info) {
    tell("sleep", T{}, mo_relaxed, info);
    explorer().sleep(this);
  }
  void wake(context&, unsigned, const debug_info& info) {
    tell("wake", T{}, mo_relaxed, info);
    explorer().wake(this);
  }

 private:
  template <class Change>
  T change(const char* what, Change&& change, memory_order order, const debug_info& info) {
    auto& e = explorer();
    e.step();
    const auto on_values = [&change](weak::Value old) {
      return static_cast<weak::Value>(change(static_cast<T>(old)));
    };
    const auto old =
        static_cast<T>(e.memory().change(e.thread(), at_, on_values, std_order(order)));
    return tell(what, old, order, info);
  }
  T tell(const char* what, T value, memory_order order, const debug_info& info) const {
    if (explorer().tells()) {
      explorer().tell(what, this, static_cast<weak::Value>(value), name(order), info);
    }
    return value;
  }

  weak::Location& at_;
};

/// A plain variable: of two accesses by different threads one must happen before the other, unless
/// both read.
template <class T>
class var {
 public:
  class Proxy {
   public:
    Proxy(var& of, const debug_info& info) : of_(of), info_(info) {}
    operator T() const { return of_.read(info_); }  // NOLINT(google-explicit-constructor)
    void operator=(T value) { of_.write(value, info_); }

   private:
    var& of_;
    debug_info info_;
  };
  Proxy operator()(const debug_info& info) const { return {const_cast<var&>(*this), info}; }

 private:
  T read(const debug_info& info) {
    if (!is_written_) failed("an uninitialised variable is read", info.file, info.line);
    const auto& me = explorer().thread();
    if (writer_ != me.index && writes_.of[writer_] > me.now.happens.of[writer_]) race(info);
    reads_.of[me.index] = me.clock + 1;  // behind the last atomic step
    return value_;
  }
  void write(T value, const debug_info& info) {
    const auto& me = explorer().thread();
    for (unsigned t = 0; t < weak::kMostThreads; ++t) {
      if (t != me.index && std::max(writes_.of[t], reads_.of[t]) > me.now.happens.of[t]) race(info);
    }
    writer_ = me.index;
    writes_.of[me.index] = me.clock + 1;
    is_written_ = true;
    value_ = value;
  }
  [[noreturn]] static void race(const debug_info& info) {
    failed("data race", info.file, info.line);
  }

  T value_{};
  bool is_written_ = false;
  unsigned writer_ = 0;
  weak::Clocks writes_, reads_;
};

template <class T>
bool compare_exchange(atomic<T>& word, T& expected, T desired, memory_order success,
                      memory_order failure, const debug_info& info) {
  return word.compare_exchange(expected, desired, success, failure, info);
}

template <class Suite, unsigned kThreads>
struct test_suite {
  struct params {
    static constexpr unsigned thread_count = kThreads;
  };
  void before() {}
  void after() {}
};
struct test_params;

}  // namespace rl

#define RL_INFO (rl::debug_info(__func__, __FILE__, __LINE__))
#define RL_ASSERT(holds) \
  ((holds) ? static_cast<void>(0) : rl::failed("assertion, " #holds, __FILE__, __LINE__))
