// SPDX-License-Identifier: Apache-2.0
#include "liveness/death_notice.hpp"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <linux/futex.h>
#include <new>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>
#include <utility>

#include "lot/detail/no_signals.hpp"
#include "lot/error.hpp"

#include "futex/futex.hpp"
#include "segment/system_limits.hpp"

namespace lot::liveness {
namespace {

static_assert(seat::kSleepers == FUTEX_WAITERS && seat::kDied == FUTEX_OWNER_DIED &&
              seat::kThread == FUTEX_TID_MASK);

constexpr std::chrono::seconds kAnswerPatience{2};
constexpr std::chrono::hours kAsLongAsItTakes{24};
/// After each such time the asker checks whether a sandbox has ended the witness thread alone.
constexpr std::chrono::milliseconds kLook{100};

}  // namespace

bool seat::stands(std::uint64_t seat) noexcept {
  return (notice(seat) & kDied) == 0 && (notice(seat) & kThread) != 0;
}

DeathNotice::DeathNotice() : maker_(getpid()) {
  static_assert(offsetof(List, offset) == offsetof(robust_list_head, futex_offset) &&
                offsetof(List, pending) == offsetof(robust_list_head, list_op_pending) &&
                offsetof(List, node) == sizeof(robust_list_head));
  void* page =
      mmap(nullptr, sizeof(List), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (page == MAP_FAILED) throw std::bad_alloc();
  madvise(page, sizeof(List), MADV_DONTFORK);  // so that no forked child can change it
  mlock(page, sizeof(List));                   // if allowed: it must be there when memory runs out
  list_ = new (page) List{};
  list_->head.next = &list_->head;
  list_->node.next = &list_->head;
}

DeathNotice::~DeathNotice() {
  end();
  if (getpid() == maker_) munmap(list_, sizeof(List));  // a child has no such page (MADV_DONTFORK)
}

bool DeathNotice::claim(Seat& seat, std::uint64_t seen) {
  seat_ = &seat;
  seen_ = seen;
  if (!has_thread_) start();
  ask(Order::Claim, kAsLongAsItTakes);
  if (!has_thread_) {
    throw Error(EPERM, "the witness thread (lot-witness)",
                "was ended alone by the system, as a sandbox does for a system call "
                "(SECCOMP_RET_KILL_THREAD)",
                "let it call prctl, set_robust_list, gettid and futex, or refuse them with an "
                "error (SECCOMP_RET_ERRNO)");
  }
  return ours_ != 0;
}

bool DeathNotice::renew() noexcept {
  // Acquire, edge "seat": what the process did that has the seat now, if it is another one.
  const std::uint64_t now = seat_->load(std::memory_order_acquire);
  if (now == ours_) return true;
  if (!is_ours(now)) return false;
  ask(Order::Renew, kAnswerPatience);
  return true;
}

void DeathNotice::end() noexcept {
  if (!has_thread_) return;
  ask(Order::End, kAnswerPatience);
  if (std::exchange(has_thread_, false)) pthread_join(thread_, nullptr);
}

bool DeathNotice::judge(Seat& seat, std::uint64_t seen) noexcept {
  // acq_rel, edge "seat": what the dead process did, to the next owner of the index.
  return seat.compare_exchange_strong(seen, seat::make(seat::incarnation(seen), seat::kJudged),
                                      std::memory_order_acq_rel, std::memory_order_relaxed);
}

void DeathNotice::start() {
  const detail::NoSignals quiet;
  const auto begin = [](void* self) -> void* {
    static_cast<DeathNotice*>(self)->run();
    return nullptr;
  };
  if (const int error = pthread_create(&thread_, nullptr, begin, this)) {
    throw Error(error, "the witness thread", "cannot be started", segment::advice_on_threads());
  }
  has_thread_ = true;
}

/// A thread that ends writes nothing, so this asks the C library.
bool DeathNotice::has_ended() noexcept {
  if (has_thread_ && pthread_tryjoin_np(thread_, nullptr) == 0) has_thread_ = false;
  return !has_thread_;
}

/// True when this process may change the seat: it has our incarnation, and does not say that a
/// reaper judged us. After a judgement others may have given away what we had.
bool DeathNotice::is_ours(std::uint64_t seat) const noexcept {
  return seat::incarnation(seat) == seat::incarnation(ours_) && seat::notice(seat) != seat::kJudged;
}

/// Gives the witness thread an order and waits until it is done. One thread at a time asks: the
/// thread that joins, and later the warden.
void DeathNotice::ask(Order order, std::chrono::nanoseconds patience) noexcept {
  const auto until = futex::Clock::now() + patience;
  order_.store(order, std::memory_order_release);  // carries seat_ and seen_ to the witness thread
  futex::wake_all(&order_);
  // Acquire: what the witness thread has stored in ours_.
  while (order_.load(std::memory_order_acquire) == order && !has_ended()) {
    const auto now = futex::Clock::now();
    if (now >= until) return;
    futex::wait(&order_, static_cast<std::uint32_t>(order), std::min(until, now + kLook));
  }
}

/// The witness thread. It alone writes the notice of a living process. Another thread could still
/// write it after this thread has died with the process and the kernel has read the list.
void DeathNotice::run() noexcept {
  pthread_setname_np(pthread_self(), "lot-witness");
  const bool is_heard = syscall(SYS_set_robust_list, list_, sizeof(robust_list_head)) == 0;
  const std::uint32_t notice =
      is_heard ? static_cast<std::uint32_t>(syscall(SYS_gettid)) | seat::kSleepers
               : seat::kUnwitnessed;
  for (;;) {
    const Order order = order_.load(std::memory_order_acquire);  // what the asker has stored
    if (order == Order::None) {
      futex::wait(&order_, static_cast<std::uint32_t>(order), {});
      continue;
    }
    if (order == Order::Claim) {
      take(notice);
    } else {
      const std::uint64_t said =
          order == Order::Renew ? ours_ : seat::make(seat::incarnation(ours_), 0);
      std::uint64_t now = seat_->load(std::memory_order_relaxed);  // the next step checks it
      // Release, edge "seat": what this process did before it gives the seat up.
      while (ours_ != 0 && is_ours(now) &&
             !seat_->compare_exchange_weak(now, said, std::memory_order_release,
                                           std::memory_order_relaxed)) {
      }
      if (order == Order::End) {
        ours_ = 0;
        unlink();
      }
    }
    // The warden may have run out of patience, and have given another order since. Release: carries
    // ours_ to the asker.
    Order done = order;
    if (order_.compare_exchange_strong(done, Order::None, std::memory_order_release,
                                       std::memory_order_relaxed)) {
      futex::wake_all(&order_);
    }
    if (order == Order::End) return;
  }
}

/// Takes the seat. Links the node first: else a death in between would leave a notice that stands
/// for ever.
void DeathNotice::take(std::uint32_t notice) noexcept {
  const auto* word = static_cast<const char*>(futex::low_half(seat_->word()));
  list_->offset = word - reinterpret_cast<const char*>(&list_->node);
  list_->head.next = &list_->node;
  std::atomic_signal_fence(std::memory_order_seq_cst);  // the kernel reads it as this thread does
  const std::uint64_t ours = seat::make(seat::incarnation(seen_) + 1, notice);
  // Edge "seat". Acquire: what the seat's former owner did. Release: our name, which others find
  // in locks.
  if (seat_->compare_exchange_strong(seen_, ours, std::memory_order_acq_rel,
                                     std::memory_order_relaxed)) {
    ours_ = ours;
  } else {
    unlink();
  }
}

void DeathNotice::unlink() noexcept {
  std::atomic_signal_fence(std::memory_order_seq_cst);  // as in take(): the kernel's order is ours
  list_->head.next = &list_->head;
}

}  // namespace lot::liveness
