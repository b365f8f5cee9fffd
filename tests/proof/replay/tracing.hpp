// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <sys/types.h>
#include <sys/user.h>
#include <vector>

/// Threads that stand still but for the one that the conductor lets run.
///
/// Source: ptrace(2): PTRACE_SYSEMU stops before a system call, and the kernel does not do it. So
///         the conductor answers what must be the same in each run, and lets the kernel do the
///         rest.
namespace lot::replay {

/// Why a thread stands still again.
struct Stop {
  enum class Why {
    Stepped,  ///< one instruction was done
    Call,     ///< it is about to do a system call, which the kernel will not do
    Ended,    ///< the thread is gone
    Signal,   ///< a signal came for it: something is wrong
  };
  Why why;
  int signal = 0;
};

/// The system lets no process be traced: no run can be made.
struct Refused : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Starts this program anew, as a traced child: at the same addresses each time, with an empty
/// environment, without the kernel's clock page (the vDSO), and with the same random bytes. Returns
/// when it stands before its first instruction. Throws Refused, or std::runtime_error.
pid_t start_program(const std::string& path, const std::vector<std::string>& arguments,
                    std::uint64_t seed);

/// One instruction.
Stop step(pid_t thread);
/// On to the next system call.
Stop run_to_call(pid_t thread);
/// Lets the kernel do the call before which the thread stands. `child`: the thread that it has
/// begun, which stands before its first instruction; else 0. REQUIRES: Stop::Why::Call.
Stop do_call(pid_t thread, const user_regs_struct& at_call, pid_t& child);
/// Lets a thread run to its end: it stands before a call that ends it.
void run_to_end(pid_t thread);

user_regs_struct registers(pid_t thread);
/// What the call before which the thread stands returns.
void answer(pid_t thread, long result);
std::uint64_t place(pid_t thread);

/// Copies of a stopped process's memory. False: there is none, or not all of it.
bool read_memory(pid_t process, std::uint64_t address, void* into, std::size_t bytes);
bool write_memory(pid_t process, std::uint64_t address, const void* from, std::size_t bytes);
/// A text that ends by a zero byte, or after so many bytes.
std::string read_text(pid_t process, std::uint64_t address, std::size_t most);
template <class T>
T read_word(pid_t process, std::uint64_t address) {
  T word{};
  read_memory(process, address, &word, sizeof(word));
  return word;
}

}  // namespace lot::replay
