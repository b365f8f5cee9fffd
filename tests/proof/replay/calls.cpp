// SPDX-License-Identifier: Apache-2.0
#include "calls.hpp"

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <iterator>
#include <linux/futex.h>
#include <optional>
#include <sys/syscall.h>

#include "chaos/random.hpp"
#include "tells.hpp"
#include "tracing.hpp"

namespace lot::replay {
namespace {

using What = Verdict::What;

constexpr long kFutexWaitv = 449, kClone3 = 435, kRseq = 334, kFaccessat2 = 439;
constexpr std::uint64_t kSecond = 1'000'000'000;
/// The wall clock is that much ahead of the others.
constexpr std::uint64_t kWall = 1'800'000'000 * kSecond;
bool is_wall(std::uint64_t clock) { return clock == CLOCK_REALTIME || clock == CLOCK_TAI; }

/// What a process on one core with files of its own is told the same each time. None waits.
constexpr long kTheKernels[]{SYS_read,
                             SYS_write,
                             SYS_open,
                             SYS_openat,
                             SYS_close,
                             SYS_stat,
                             SYS_fstat,
                             SYS_lstat,
                             SYS_newfstatat,
                             SYS_statx,
                             SYS_lseek,
                             SYS_mmap,
                             SYS_munmap,
                             SYS_mprotect,
                             SYS_mremap,
                             SYS_madvise,
                             SYS_mlock,
                             SYS_munlock,
                             SYS_brk,
                             SYS_msync,
                             SYS_fcntl,
                             SYS_ftruncate,
                             SYS_fallocate,
                             SYS_pread64,
                             SYS_pwrite64,
                             SYS_writev,
                             SYS_access,
                             SYS_faccessat,
                             kFaccessat2,
                             SYS_ioctl,
                             SYS_link,
                             SYS_linkat,
                             SYS_unlink,
                             SYS_unlinkat,
                             SYS_rename,
                             SYS_renameat,
                             SYS_renameat2,
                             SYS_mkdir,
                             SYS_rmdir,
                             SYS_readlink,
                             SYS_readlinkat,
                             SYS_getdents64,
                             SYS_getcwd,
                             SYS_chmod,
                             SYS_fchmod,
                             SYS_fchown,
                             SYS_statfs,
                             SYS_fstatfs,
                             SYS_umask,
                             SYS_dup,
                             SYS_getpid,
                             SYS_gettid,
                             SYS_getppid,
                             SYS_getuid,
                             SYS_geteuid,
                             SYS_getgid,
                             SYS_getegid,
                             SYS_getgroups,
                             SYS_uname,
                             SYS_prlimit64,
                             SYS_prctl,
                             SYS_arch_prctl,
                             SYS_sigaltstack,
                             SYS_rt_sigaction,
                             SYS_rt_sigprocmask,
                             SYS_tgkill,
                             SYS_sched_getaffinity,
                             SYS_getrlimit,
                             SYS_fsync,
                             SYS_set_tid_address,
                             SYS_set_robust_list,
                             SYS_clone,
                             kClone3};

/// Which core and which priority a thread has is the conductor's business.
bool is_about_scheduling(long number) {
  return number == SYS_sched_setaffinity || number == SYS_sched_setscheduler ||
         number == SYS_sched_setparam || number == SYS_setpriority || number == SYS_sched_yield;
}

}  // namespace

Verdict Calls::handle(Thread& thread, const user_regs_struct& call,
                      const std::vector<Thread*>& threads) {
  const auto number = static_cast<long>(call.orig_rax);
  switch (number) {
    case kTell:
      return {What::Tells};
    case SYS_exit:
      return {What::Ends};
    case SYS_exit_group:
      return {What::EndsAll};
    case SYS_futex:
      return futex(thread, call, threads);
    case kFutexWaitv:
      return wait_for_many(thread, call);
    case SYS_nanosleep:
      return nap(thread, call.rdi, false, false);
    case SYS_clock_nanosleep:
      return nap(thread, call.rdx, (call.rsi & TIMER_ABSTIME) != 0, is_wall(call.rdi));
    case SYS_clock_gettime:
      return tell_time(thread, call.rdi, call.rsi);
    case SYS_getrandom:
      return make_random(thread, call.rdi, call.rsi);
    case SYS_membarrier:
      return {What::Answered};  // all other threads stand still
    case kRseq:
      return {What::Answered, -ENOSYS};
    case SYS_set_tid_address:
      thread.at_end = call.rdi;
      break;
    case SYS_set_robust_list:
      thread.robust = call.rdi;
      break;
    default:
      break;
  }
  if (is_about_scheduling(number)) return {What::Answered};
  const bool is_kernels =
      std::find(std::begin(kTheKernels), std::end(kTheKernels), number) != std::end(kTheKernels);
  return {is_kernels ? What::Kernel : What::Unknown};
}

Verdict Calls::futex(Thread& thread, const user_regs_struct& call,
                     const std::vector<Thread*>& threads) {
  switch (static_cast<int>(call.rsi) & FUTEX_CMD_MASK) {
    case FUTEX_WAIT:
      return wait(thread, call, false);
    case FUTEX_WAIT_BITSET:
      return wait(thread, call, true);
    case FUTEX_WAKE:
    case FUTEX_WAKE_BITSET:
      return {What::Answered,
              sleepers_.wake(threads, thread.process->place_of(call.rdi), call.rdx & 0x7fffffff)};
    default:  // as on a kernel that cannot lend a priority: the library naps in its place
      return {What::Answered, -ENOSYS};
  }
}

Verdict Calls::wait(Thread& thread, const user_regs_struct& call, bool until_a_time) {
  if (read_word<std::uint32_t>(thread.id, call.rdi) != static_cast<std::uint32_t>(call.rdx)) {
    return {What::Answered, -EAGAIN};
  }
  std::optional<std::uint64_t> until;
  if (call.r10 != 0) {
    until = read_time(thread, call.r10);
    if (!until_a_time) *until += now_;
    if ((call.rsi & FUTEX_CLOCK_REALTIME) != 0) *until -= std::min(*until, kWall);
    if (*until <= now_) return {What::Answered, -ETIMEDOUT};
  }
  sleepers_.sleep(thread, {thread.process->place_of(call.rdi)}, until);
  return {What::Sleeps};
}

Verdict Calls::wait_for_many(Thread& thread, const user_regs_struct& call) {
  struct Entry {  // struct futex_waitv
    std::uint64_t value, address;
    std::uint32_t flags, reserved;
  };
  if (call.rsi == 0 || call.rsi > FUTEX_WAITV_MAX) return {What::Answered, -EINVAL};
  std::vector<Entry> entries(call.rsi);
  read_memory(thread.id, call.rdi, entries.data(), entries.size() * sizeof(Entry));
  std::vector<Place> words;
  for (const Entry& e : entries) {
    if (read_word<std::uint32_t>(thread.id, e.address) != static_cast<std::uint32_t>(e.value)) {
      return {What::Answered, -EAGAIN};
    }
    words.push_back(thread.process->place_of(e.address));
  }
  std::optional<std::uint64_t> until;
  if (call.r10 != 0) {
    until = read_time(thread, call.r10);
    if (is_wall(call.r8)) *until -= std::min(*until, kWall);
    if (*until <= now_) return {What::Answered, -ETIMEDOUT};
  }
  sleepers_.sleep(thread, std::move(words), until);
  return {What::Sleeps};
}

Verdict Calls::nap(Thread& thread, std::uint64_t request, bool until_a_time, bool on_wall_clock) {
  std::uint64_t until = read_time(thread, request);
  if (!until_a_time) {
    until += now_;
  } else if (on_wall_clock) {
    until -= std::min(until, kWall);
  }
  if (until <= now_) return {What::Answered};
  sleepers_.nap(thread, until);
  return {What::Sleeps};
}

Verdict Calls::tell_time(const Thread& thread, std::uint64_t clock, std::uint64_t into) const {
  const std::uint64_t ns = now_ + (is_wall(clock) ? kWall : 0);
  const timespec time{static_cast<time_t>(ns / kSecond), static_cast<long>(ns % kSecond)};
  write_memory(thread.id, into, &time, sizeof(time));
  return {What::Answered};
}

Verdict Calls::make_random(const Thread& thread, std::uint64_t into, std::uint64_t bytes) {
  for (std::uint64_t at = 0; at < bytes; at += sizeof(random_)) {
    random_ = chaos::Random::mix(random_);
    write_memory(thread.id, into + at, &random_,
                 std::min<std::uint64_t>(bytes - at, sizeof(random_)));
  }
  return {What::Answered, static_cast<long>(bytes)};
}

std::uint64_t Calls::read_time(const Thread& thread, std::uint64_t address) {
  const auto time = read_word<timespec>(thread.id, address);
  return static_cast<std::uint64_t>(time.tv_sec) * kSecond +
         static_cast<std::uint64_t>(time.tv_nsec);
}

}  // namespace lot::replay
