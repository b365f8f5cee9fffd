// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdlib>
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

/// What the mutated tree asks at run time: is it mutant N that this process has? mutants.py writes
/// the calls, and says which mutant it is by the environment, which children inherit:
///
///     LOT_MUTANT           the number of the mutant; none: the tree behaves as it was written
///     LOT_MUTANT_REACHED   a file of kReachable bytes; byte N is set when mutant N is asked for
///
/// Each program and each shared object has one state. It is read before any other constructor runs.
/// Memory: the file is mapped, shared. Threads: each may ask at any time.
namespace lot_mutant {

constexpr std::size_t kReachable = std::size_t{1} << 21;

struct State {
  unsigned active = 0;
  unsigned char* reached = nullptr;
};

__attribute__((visibility("hidden"))) inline State state;

__attribute__((visibility("hidden"))) inline void begin() noexcept {
  if (const char* number = std::getenv("LOT_MUTANT")) {
    state.active = static_cast<unsigned>(std::strtoul(number, nullptr, 10));
  }
  const char* path = std::getenv("LOT_MUTANT_REACHED");
  if (path == nullptr || state.reached != nullptr) return;
  const int file = ::open(path, O_RDWR | O_CLOEXEC);
  if (file < 0) return;
  void* at = ::mmap(nullptr, kReachable, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  ::close(file);
  if (at != MAP_FAILED) state.reached = static_cast<unsigned char*>(at);
}

namespace {
__attribute__((constructor(101), used)) void begin_here() { begin(); }
}  // namespace

/// The question, outside of constexpr functions.
__attribute__((always_inline)) inline bool is(unsigned n) noexcept {
  if (__builtin_expect(state.reached != nullptr, 0)) state.reached[n] = 1;
  return __builtin_expect(state.active == n, 0);
}

/// The question in a constexpr function: no mutant while the compiler evaluates it.
__attribute__((always_inline)) constexpr bool maybe(unsigned n) noexcept {
  return !__builtin_is_constant_evaluated() && is(n);
}

// ---- an operator and what stands instead. YES is what is() or maybe() has answered.
// ---------------

#define LOT_MUTANT_OPERATOR(name, written, instead)                                      \
  template <class A, class B>                                                            \
  __attribute__((always_inline)) constexpr auto name(bool yes, const A& a, const B& b) { \
    using Result = decltype(a written b);                                                \
    return yes ? static_cast<Result>(a instead b) : static_cast<Result>(a written b);    \
  }
LOT_MUTANT_OPERATOR(less, <, <=)
LOT_MUTANT_OPERATOR(less_equal, <=, <)
LOT_MUTANT_OPERATOR(greater, >, >=)
LOT_MUTANT_OPERATOR(greater_equal, >=, >)
LOT_MUTANT_OPERATOR(plus, +, -)
LOT_MUTANT_OPERATOR(minus, -, +)
LOT_MUTANT_OPERATOR(times, *, +)
LOT_MUTANT_OPERATOR(divided, /, *)
LOT_MUTANT_OPERATOR(modulo, %, +)
LOT_MUTANT_OPERATOR(both_bits, &, |)
LOT_MUTANT_OPERATOR(either_bit, |, &)
LOT_MUTANT_OPERATOR(one_bit, ^, |)
LOT_MUTANT_OPERATOR(left, <<, >>)
LOT_MUTANT_OPERATOR(right, >>, <<)
#undef LOT_MUTANT_OPERATOR

template <class T>
constexpr T least(bool yes, const T& a, const T& b) {
  return (b < a) != yes ? b : a;
}

template <class T>
constexpr T most(bool yes, const T& a, const T& b) {
  return (a < b) != yes ? b : a;
}

/// The value, or zero.
template <class T>
constexpr T value(bool yes, T value) {
  return yes ? T{} : value;
}

/// A named number: the value, or one more.
template <class T>
constexpr T more(bool yes, T value) {
  return yes ? static_cast<T>(value + 1) : value;
}

/// A duration: as written, or so long that what waits for it waits for ever.
template <class T>
constexpr T longer(bool yes, T value) {
  return yes ? static_cast<T>(value * 1000) : value;
}

}  // namespace lot_mutant
