// SPDX-License-Identifier: Apache-2.0
#include "tracing.hpp"

#include <cerrno>
#include <csignal>
#include <cstring>
#include <elf.h>
#include <sys/personality.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <unistd.h>

#include "chaos/random.hpp"
#include "support/ptrace.hpp"

namespace lot::replay {
namespace {

using testing::trace;

constexpr std::uintptr_t kOptions =
    PTRACE_O_TRACESYSGOOD | PTRACE_O_TRACECLONE | PTRACE_O_TRACEEXEC | PTRACE_O_EXITKILL;
constexpr int kCallStop = SIGTRAP | 0x80;  ///< PTRACE_O_TRACESYSGOOD

[[noreturn]] void fail(const char* what) {
  throw std::runtime_error(std::string(what) + ": " + std::strerror(errno));
}

int wait_for(pid_t thread) {
  int status = 0;
  while (waitpid(thread, &status, __WALL) == -1) {
    if (errno != EINTR) fail("waitpid");
  }
  return status;
}

Stop stop_of(int status) {
  if (!WIFSTOPPED(status)) return {Stop::Why::Ended};
  const int signal = WSTOPSIG(status);
  if (signal == kCallStop) return {Stop::Why::Call};
  if (signal == SIGTRAP) return {Stop::Why::Stepped};
  return {Stop::Why::Signal, signal};
}

Stop go(pid_t thread, int how) {
  if (trace(how, thread) == -1) fail("ptrace");
  return stop_of(wait_for(thread));
}

/// What the kernel tells the program on its stack: no clock page, and random bytes of the seed.
void settle_auxiliary_vector(pid_t process, std::uint64_t seed) {
  std::uint64_t at = registers(process).rsp;
  at += 8 * (read_word<std::uint64_t>(process, at) + 2);       // argc, arguments, null
  while (read_word<std::uint64_t>(process, at) != 0) at += 8;  // the environment
  for (at += 8;; at += sizeof(Elf64_auxv_t)) {
    auto entry = read_word<Elf64_auxv_t>(process, at);
    if (entry.a_type == AT_NULL) return;
    if (entry.a_type == AT_RANDOM) {
      const std::uint64_t bytes[2] = {chaos::Random::mix(seed), chaos::Random::mix(~seed)};
      write_memory(process, entry.a_un.a_val, bytes, sizeof(bytes));
    } else if (entry.a_type == AT_SYSINFO_EHDR) {
      entry.a_type = AT_IGNORE;
      write_memory(process, at, &entry, sizeof(entry));
    }
  }
}

[[noreturn]] void become(const std::string& path, const std::vector<std::string>& arguments) {
  std::vector<char*> argv;
  for (const std::string& a : arguments) argv.push_back(const_cast<char*>(a.c_str()));
  argv.push_back(nullptr);
  char* environment[] = {nullptr};
  personality(ADDR_NO_RANDOMIZE);
  if (trace(PTRACE_TRACEME, 0) == -1) _exit(127);
  raise(SIGSTOP);
  execve(path.c_str(), argv.data(), environment);
  _exit(127);
}

}  // namespace

pid_t start_program(const std::string& path, const std::vector<std::string>& arguments,
                    std::uint64_t seed) {
  const pid_t child = fork();
  if (child == -1) fail("fork");
  if (child == 0) become(path, arguments);
  if (!WIFSTOPPED(wait_for(child)) || trace(PTRACE_SETOPTIONS, child, 0, kOptions) == -1 ||
      trace(PTRACE_CONT, child) == -1) {
    throw Refused("a worker cannot be traced");
  }
  if (!testing::is_event(wait_for(child), PTRACE_EVENT_EXEC)) {
    throw std::runtime_error("a worker cannot be started");
  }
  settle_auxiliary_vector(child, seed);
  return child;
}

Stop step(pid_t thread) { return go(thread, PTRACE_SYSEMU_SINGLESTEP); }
Stop run_to_call(pid_t thread) { return go(thread, PTRACE_SYSEMU); }

Stop do_call(pid_t thread, const user_regs_struct& at_call, pid_t& child) {
  constexpr unsigned kInstruction = 2;  // syscall
  user_regs_struct again = at_call;
  again.rip -= kInstruction;
  again.rax = at_call.orig_rax;
  again.orig_rax = ~0ULL;
  trace(PTRACE_SETREGS, thread, 0, reinterpret_cast<std::uintptr_t>(&again));
  child = 0;
  for (;;) {  // the first stop is the end of the call that was not done
    if (trace(PTRACE_SINGLESTEP, thread) == -1) fail("ptrace");
    const int status = wait_for(thread);
    if (testing::is_event(status, PTRACE_EVENT_CLONE)) {
      unsigned long id = 0;
      trace(PTRACE_GETEVENTMSG, thread, 0, reinterpret_cast<std::uintptr_t>(&id));
      child = static_cast<pid_t>(id);
      wait_for(child);
      continue;
    }
    const Stop stop = stop_of(status);
    if (stop.why != Stop::Why::Stepped || place(thread) != again.rip) return stop;
  }
}

void run_to_end(pid_t thread) {
  user_regs_struct again = registers(thread);
  again.rip -= 2;
  again.rax = again.orig_rax;
  trace(PTRACE_SETREGS, thread, 0, reinterpret_cast<std::uintptr_t>(&again));
  if (trace(PTRACE_CONT, thread) == -1) fail("ptrace");
}

user_regs_struct registers(pid_t thread) {
  user_regs_struct all{};
  trace(PTRACE_GETREGS, thread, 0, reinterpret_cast<std::uintptr_t>(&all));
  return all;
}

void answer(pid_t thread, long result) {
  trace(PTRACE_POKEUSER, thread, offsetof(user_regs_struct, rax),
        static_cast<std::uintptr_t>(result));
}

std::uint64_t place(pid_t thread) {
  return static_cast<std::uint64_t>(
      trace(PTRACE_PEEKUSER, thread, offsetof(user_regs_struct, rip)));
}

bool read_memory(pid_t process, std::uint64_t address, void* into, std::size_t bytes) {
  const iovec here{into, bytes};
  const iovec there{reinterpret_cast<void*>(address), bytes};
  return process_vm_readv(process, &here, 1, &there, 1, 0) == static_cast<ssize_t>(bytes);
}

std::string read_text(pid_t process, std::uint64_t address, std::size_t most) {
  std::string text;
  for (char c; text.size() < most && read_memory(process, address, &c, 1) && c != '\0'; ++address) {
    text += c;
  }
  return text;
}

bool write_memory(pid_t process, std::uint64_t address, const void* from, std::size_t bytes) {
  const iovec here{const_cast<void*>(from), bytes};
  const iovec there{reinterpret_cast<void*>(address), bytes};
  return process_vm_writev(process, &here, 1, &there, 1, 0) == static_cast<ssize_t>(bytes);
}

}  // namespace lot::replay
