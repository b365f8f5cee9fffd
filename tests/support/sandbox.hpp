// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace lot::testing {

inline constexpr std::uint32_t kFutexWaitv = 449;

/// From now on a system call of this thread, and of those that it begins, has such an end
/// (SECCOMP_RET_...). False: it cannot be arranged here.
inline bool answer(std::uint32_t call, std::uint32_t how) {
  sock_filter filter[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, call, 0, 1),
      BPF_STMT(BPF_RET | BPF_K, how),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog program{4, filter};
  return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
         prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}

/// The call is refused, as in a sandbox or by an older kernel.
inline bool refuse(std::uint32_t call, int error) {
  return answer(call, SECCOMP_RET_ERRNO | static_cast<std::uint32_t>(error));
}

/// From now on this process has a kernel without futex_waitv, as before Linux 5.16.
inline bool forget_futex_waitv() {
  return refuse(kFutexWaitv, ENOSYS) && syscall(kFutexWaitv, nullptr, 0, 0, nullptr, 0) == -1 &&
         errno == ENOSYS;
}

}  // namespace lot::testing
