// SPDX-License-Identifier: Apache-2.0

// Mistakes that the tests must find, each planted by its name in LOT_FAULTS_PLANT (can_fail.cmake).
// Without it, every call goes on to the library.

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <linux/futex.h>
#include <string_view>
#include <sys/syscall.h>
#include <unistd.h>

#include "futex/futex.hpp"
#include "liveness/lock_file.hpp"
#include "segment/segment.hpp"

namespace {

using lot::detail::FutexWaits;
using lot::futex::Deadline;
using lot::liveness::LockFile;
using lot::segment::Segment;
using lot::segment::Trust;

bool planted(std::string_view mistake) {
  static const char* const name = std::getenv("LOT_FAULTS_PLANT");
  return name != nullptr && name == mistake;
}

/// A deadline of the monotonic clock, taken for one of the real-time clock.
bool wait_in_real_time(const lot::detail::FutexWait& wait, const Deadline& deadline) {
  const auto ns = deadline->time_since_epoch() / std::chrono::nanoseconds(1);
  const timespec until{ns / 1'000'000'000, ns % 1'000'000'000};
  return syscall(SYS_futex, wait.word, FUTEX_WAIT_BITSET | FUTEX_CLOCK_REALTIME, wait.value, &until,
                 nullptr, FUTEX_BITSET_MATCH_ANY) == 0 ||
         errno != ETIMEDOUT;
}

}  // namespace

// The linker (--wrap) sends callers to the second of each pair.

bool real_intact(const LockFile*) asm("__real__ZNK3lot8liveness8LockFile6intactEv");
bool wrap_intact(const LockFile*) asm("__wrap__ZNK3lot8liveness8LockFile6intactEv");
bool wrap_intact(const LockFile* file) { return planted("closed-unnoticed") || real_intact(file); }

void real_abandon(LockFile*) asm("__real__ZN3lot8liveness8LockFile7abandonEv");
void wrap_abandon(LockFile*) asm("__wrap__ZN3lot8liveness8LockFile7abandonEv");
void wrap_abandon(LockFile* file) {
  if (!planted("inherited-lock")) real_abandon(file);
}

bool real_enter_gate(LockFile*, std::chrono::milliseconds) asm(
    "__real__ZN3lot8liveness8LockFile10enter_gateENSt6chrono8durationIlSt5ratioILl1ELl1000EEEE");
bool wrap_enter_gate(LockFile*, std::chrono::milliseconds) asm(
    "__wrap__ZN3lot8liveness8LockFile10enter_gateENSt6chrono8durationIlSt5ratioILl1ELl1000EEEE");
bool wrap_enter_gate(LockFile* file, std::chrono::milliseconds patience) {
  if (planted("gate-not-entered")) return true;
  return real_enter_gate(file, patience) || planted("gate-of-a-removed-file");
}

bool real_stands(std::uint64_t) asm("__real__ZN3lot8liveness4seat6standsEm");
bool wrap_stands(std::uint64_t) asm("__wrap__ZN3lot8liveness4seat6standsEm");
bool wrap_stands(std::uint64_t seat) { return !planted("no-witness") && real_stands(seat); }

Segment::Fit real_examine(const std::string&, std::uint64_t, const Trust&, std::string&) asm(
    "__real__ZN3lot7segment7Segment7examineERKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE"
    "mRKNS0_5TrustERS7_");
Segment::Fit wrap_examine(const std::string&, std::uint64_t, const Trust&, std::string&) asm(
    "__wrap__ZN3lot7segment7Segment7examineERKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE"
    "mRKNS0_5TrustERS7_");
Segment::Fit wrap_examine(const std::string& path, std::uint64_t size, const Trust& trust,
                          std::string& reason) {
  const auto fit = real_examine(path, size, trust, reason);
  return fit == Segment::Fit::Foreign && planted("rubbish-is-stale") ? Segment::Fit::Stale : fit;
}

bool real_wait_any(const FutexWaits&, const Deadline&) asm(
    "__real__ZN3lot5futex8wait_anyERKNS_6detail10FutexWaitsERKSt8optionalINSt6chrono10"
    "time_pointINS6_3_V212steady_clockENS6_8durationIlSt5ratioILl1ELl1000000000EEEEEEE");
bool wrap_wait_any(const FutexWaits&, const Deadline&) asm(
    "__wrap__ZN3lot5futex8wait_anyERKNS_6detail10FutexWaitsERKSt8optionalINSt6chrono10"
    "time_pointINS6_3_V212steady_clockENS6_8durationIlSt5ratioILl1ELl1000000000EEEEEEE");
bool wrap_wait_any(const FutexWaits& waits, const Deadline& deadline) {
  if (deadline && planted("deadline-in-real-time")) return wait_in_real_time(waits[0], deadline);
  return real_wait_any(waits, deadline);
}
