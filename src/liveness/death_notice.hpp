// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <pthread.h>
#include <sys/types.h>

#include "lot/detail/changed_by.hpp"

/// The kernel's notice of a death. It is a word in shared memory. When the process ends the kernel
/// changes the word, and wakes one of the threads that sleep on it. docs/locks.md has the reasons.
///
/// The process has a witness thread, which gives the kernel a list of its own (set_robust_list).
/// Head and only node of the list lie in private memory. The list's offset leads from the node to
/// the word. The witness thread does nothing else: other code may need the C library's list.
///
/// Source: set_robust_list(2), "The kernel's robust futex ABI" in the kernel's documentation.
namespace lot::liveness {

/// A seat says which process has an index: {incarnation : 32 | notice : 32}. The kernel sees only
/// the notice, at futex::low_half(). LOT changes both at once.
namespace seat {
inline constexpr std::uint32_t kSleepers = std::uint32_t{1} << 31;  ///< FUTEX_WAITERS
inline constexpr std::uint32_t kDied = std::uint32_t{1} << 30;      ///< FUTEX_OWNER_DIED
inline constexpr std::uint32_t kThread = kDied - 1;                 ///< FUTEX_TID_MASK
/// The process is dead, as a process says that had its byte. This counts whichever process has the
/// byte now. (No thread that a process begins has the id 1.)
inline constexpr std::uint32_t kJudged = kDied | 1;
/// The process is there, but its kernel takes no list: only its byte says whether it lives.
inline constexpr std::uint32_t kUnwitnessed = kSleepers;

constexpr std::uint64_t make(std::uint32_t incarnation, std::uint32_t notice) {
  return std::uint64_t{incarnation} << 32 | notice;
}
constexpr std::uint32_t notice(std::uint64_t seat) { return static_cast<std::uint32_t>(seat); }
constexpr std::uint32_t incarnation(std::uint64_t seat) {
  return static_cast<std::uint32_t>(seat >> 32);
}
/// True while its process lives, as far as the notice says.
bool stands(std::uint64_t seat) noexcept;
}  // namespace seat

/// The notice of this process. All changes of a seat are here, but for the kernel's.
class DeathNotice {
 public:
  using Seat = detail::ChangedBy<std::atomic<std::uint64_t>, DeathNotice>;

  /// Throws lot::Error when there is no memory for the list.
  DeathNotice();
  ~DeathNotice();
  DeathNotice(const DeathNotice&) = delete;
  DeathNotice& operator=(const DeathNotice&) = delete;

  /// Takes the seat, whose word was `seen`, in its next incarnation. False: the seat has changed
  /// meanwhile. Begins the witness thread. Throws lot::Error when the thread cannot be started, or
  /// when a sandbox ends it.
  ///
  /// Crash: killed before this step, the seat is as it was. Killed after it, the kernel marks the
  /// notice.
  bool claim(Seat& seat, std::uint64_t seen);
  /// Sets the notice again if another process has changed it. False: this process was judged, or
  /// another process has the seat by now. REQUIRES: claim() has returned true.
  bool renew() noexcept;
  /// Gives the seat up, and ends the thread.
  void end() noexcept;
  /// Says to all that the process of the seat, whose word was `seen`, is dead. False: the seat has
  /// changed meanwhile. REQUIRES: its byte.
  static bool judge(Seat& seat, std::uint64_t seen) noexcept;

 private:
  /// The list as the kernel reads it (linux/futex.h).
  struct List {
    struct Node {
      Node* next;
    };
    Node head;
    long offset;  ///< from a node to its word
    Node* pending;
    Node node;
  };
  enum class Order : std::uint32_t { None, Claim, Renew, End };

  bool is_ours(std::uint64_t seat) const noexcept;
  void start();
  bool has_ended() noexcept;
  void ask(Order order, std::chrono::nanoseconds patience) noexcept;
  void run() noexcept;
  void take(std::uint32_t notice) noexcept;
  void unlink() noexcept;

  /// A shared mapping that no other process has. When memory runs out, the kernel may drop the
  /// private pages of a process that it has killed, before it reads the list.
  List* list_;
  const pid_t maker_;
  Seat* seat_ = nullptr;
  std::uint64_t seen_ = 0;
  std::uint64_t ours_ = 0;                 ///< the seat's word while it is ours; else 0
  std::atomic<Order> order_{Order::None};  ///< futex; the witness thread sets None when it is done
  pthread_t thread_{};
  bool has_thread_ = false;
};

}  // namespace lot::liveness
