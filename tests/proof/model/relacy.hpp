// SPDX-License-Identifier: Apache-2.0
#pragma once

/// Relacy, without the macros by which it pretends to be the standard library: the headers under
/// test are templates on their atomics and need no pretence. With LOT_MODEL_WEAK our own explorer
/// stands in its place, which does not take a read-modify-write for a fence (../weak).

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <iostream>
#include <map>
#include <optional>
#include <random>
#include <source_location>
#include <sstream>
#include <string>
#include <string_view>
#include <thread>
#include <unistd.h>
#include <vector>

#ifdef LOT_MODEL_WEAK

#include "as_relacy.hpp"

#else

#pragma push_macro("assert")
#pragma push_macro("errno")
#include <relacy/relacy.hpp>
#undef memory_order_relaxed
#undef memory_order_consume
#undef memory_order_acquire
#undef memory_order_release
#undef memory_order_acq_rel
#undef memory_order_seq_cst
#undef new
#undef delete
#undef malloc
#undef calloc
#undef realloc
#undef free
#pragma pop_macro("assert")
#pragma pop_macro("errno")

namespace rl {

/// Relacy wants a failure order that is no stronger than the other; C++17 does not. So it is only
/// told the order of what is about to happen.
template <class T>
bool compare_exchange(atomic<T>& word, T& expected, T desired, memory_order success,
                      memory_order failure, const debug_info& info) {
  context& c = ctx();
  c.sched();
  preemption_disabler one_step(c);
  const bool will = word.debug_value() == expected;
  word.compare_exchange(bool_t<false>(), expected, desired, will ? success : failure, info);
  return will;
}

}  // namespace rl

#endif
