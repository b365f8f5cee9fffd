// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>

#include "lot/detail/mutex.hpp"

namespace lot::transport {

/// How long a participant lives: it leaves its segment when its last handle and its last pointer
/// have gone, and it is destroyed when its last weak pointer has gone, too.
///
/// Threads: all members may be called at once.
/// Memory:  private to the process.
class Lifetime {
 public:
  /// What lives so long.
  class Owner {
   public:
    /// True while the process has pointers to messages. Asked only after all handles have gone.
    virtual bool holds_pointers() noexcept = 0;
    /// The last handle and the last pointer have gone. Called once.
    virtual void leave() noexcept = 0;
    /// Nothing refers to the owner any more: it destroys itself, and with it this object.
    virtual void end() noexcept = 0;

   protected:
    ~Owner() = default;
  };

  explicit Lifetime(Owner& owner) noexcept : owner_(owner) {}
  Lifetime(const Lifetime&) = delete;
  Lifetime& operator=(const Lifetime&) = delete;

  /// Between enter() and exit() the owner neither leaves nor is destroyed. REQUIRES: the caller has
  /// a pointer or a weak pointer of it.
  void enter() noexcept {
    // seq_cst: life_ and left_ are looked at crosswise (see life_).
    life_.fetch_add(kReference | kInside, std::memory_order_seq_cst);
  }
  void exit() noexcept {
    // Relaxed: the compare-and-swap decides. seq_cst: see life_.
    std::uint64_t v = life_.load(std::memory_order_relaxed);
    while ((v & kClosing) == 0) {
      // seq_cst: see life_.
      if (life_.compare_exchange_weak(v, v - (kReference | kInside), std::memory_order_seq_cst,
                                      std::memory_order_relaxed)) {
        return;
      }
    }
    exit_when_closing();
  }
  /// A weak pointer more. REQUIRES: the caller has a pointer or a weak pointer already.
  void add_reference() noexcept {
    life_.fetch_add(kReference, std::memory_order_relaxed);  // relaxed: the caller has one
  }
  void drop_reference() noexcept {
    // acq_rel, as in std::shared_ptr: the thread that deletes the owner sees what the others did.
    const std::uint64_t left = life_.fetch_sub(kReference, std::memory_order_acq_rel) - kReference;
    if ((left & kReferences) == 0) owner_.end();
  }
  /// All handles have gone. From now on the last pointer makes the owner leave. REQUIRES: between
  /// enter() and exit().
  void close() noexcept { life_.fetch_or(kClosing, std::memory_order_seq_cst); }  // see life_
  bool has_left() noexcept;

 private:
  void exit_when_closing() noexcept;
  void leave_if_unused() noexcept;

  Owner& owner_;
  std::atomic<bool> left_{false};
  detail::Mutex leave_mutex_{detail::Rank::Leave};

  /// {closing : 1 | references : 31 | inside : 32}. Closing: all handles have gone. References: the
  /// membership is one, each weak pointer and each thread inside is one. At none the owner is
  /// destroyed. Inside: threads that are dropping a last pointer.
  ///
  /// seq_cst, with left_: a thread that enters bumps life_, and may look at left_ and take a hold.
  /// The thread that makes the owner leave sets left_, and then looks at life_ and the holds. One
  /// of the two sees the other.
  static constexpr std::uint64_t kInside = 1;
  static constexpr std::uint64_t kInsideMask = 0xffffffff;
  static constexpr std::uint64_t kReference = std::uint64_t{1} << 32;
  static constexpr std::uint64_t kReferences = std::uint64_t{0x7fffffff} << 32;
  static constexpr std::uint64_t kClosing = std::uint64_t{1} << 63;
  std::atomic<std::uint64_t> life_{kReference};
};

}  // namespace lot::transport
