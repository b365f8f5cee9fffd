// SPDX-License-Identifier: Apache-2.0
#include "policy.hpp"
#include "scenario.hpp"

/// What the threads of one process do without locked operations: the pool's lock that is biased to
/// one thread, the extents that a message has no need of, and the rouser. The code is no template,
/// so its steps stand here once more. Each function says whose steps it has; transcribed.py holds
/// the two against each other.
namespace lot::model {
namespace {

template <class T>
using Atomic = CheckedAtomic<T>;

/// Of scenes that have no segment.
struct Begins {
  Begins() {
    OrdinaryHeap::use();
    killer.aim_at_nobody();
    garden.forget();
  }
};

/// What every core that runs the process passes: membarrier(2). A step as others, which can be left
/// out.
struct ProcessBarrier {
  static void pass() {
    constexpr auto kOrder = std::memory_order_seq_cst;
    const auto here = std::source_location::current();
    if (!garden.look({Operation::Fetch, kOrder, kOrder, here}).dropped) {
      rl::explorer().process_barrier();
    }
  }
};

/// src/transport/biased_lock.hpp. The owner gets the bias back soon.
class BiasedLock {
 public:
  BiasedLock() {
    biased_.write(false);
    alone_.write(0);
  }
  void lock() { take(); }
  /// @ src/transport/biased_lock.hpp unlock
  void unlock() {
    if (biased_.read()) {
      biased_.write(false);
      busy_.store(false, std::memory_order_release);
    } else {
      taken_.store(0, std::memory_order_release);
    }
  }

 private:
  static constexpr std::uint32_t kReturn = 2;
  static constexpr std::uint32_t kUnowned = 0;

  /// @ src/transport/biased_lock.hpp take
  void take() {
    if (owner_.load(std::memory_order_relaxed) == self()) {
      busy_.store(true, std::memory_order_relaxed);
      if (!shared_.load(std::memory_order_relaxed)) {
        biased_.write(true);
        return;
      }
      busy_.store(false, std::memory_order_release);
    }
    lock_shared();
  }

  static std::uint32_t self() { return Policy::this_thread(); }

  /// @ src/transport/biased_lock.cpp lock_shared
  void lock_shared() {
    const std::uint32_t thread = self();
    std::uint32_t inside = 0;
    while (!taken_.compare_exchange_weak(inside, thread, std::memory_order_acquire,
                                         std::memory_order_relaxed)) {
      while (inside != 0) {
        Policy::pause();
        inside = taken_.load(std::memory_order_relaxed);
      }
    }
    const std::uint32_t owner = owner_.load(std::memory_order_relaxed);
    if (owner == kUnowned) {
      owner_.store(self(), std::memory_order_relaxed);
    } else if (owner != self()) {
      if (!shared_.load(std::memory_order_relaxed)) revoke();
      alone_.write(0);
    } else {
      alone_.write(alone_.read() + 1);
      if (alone_.read() == kReturn) shared_.store(false, std::memory_order_relaxed);
    }
  }

  /// @ src/transport/biased_lock.cpp revoke
  void revoke() {
    shared_.store(true, std::memory_order_seq_cst);
    ProcessBarrier::pass();
    while (busy_.load(std::memory_order_acquire)) Policy::pause();
  }

  Atomic<std::uint32_t> owner_, busy_, shared_, taken_;
  Plain<bool> biased_;
  Plain<std::uint32_t> alone_;
};

/// Threads take the lock again and again, and change what it guards.
template <unsigned kThreads>
struct LockIsBiased : Begins, rl::test_suite<LockIsBiased<kThreads>, kThreads> {
  LockIsBiased() { guarded.write(0); }
  void before() {}
  void thread(unsigned t) {
    for (unsigned n = 0; n < times(t); ++n) {
      lock.lock();
      guarded.write(guarded.read() + 1);
      lock.unlock();
    }
  }
  void after() {
    unsigned all = 0;
    for (unsigned t = 0; t < kThreads; ++t) all += times(t);
    RL_ASSERT(guarded.read() == all);
  }
  static constexpr unsigned times(unsigned t) { return t == 0 ? 4 : 1; }

  BiasedLock lock;
  Plain<unsigned> guarded;
};

/// include/lot/detail/arena.hpp, and those of its steps that the pool does under its lock.
class Spares {
 public:
  explicit Spares(unsigned extents) { extents_.write(extents); }

  /// @ include/lot/detail/arena.hpp own_spare
  void own_spare() {
    if (!is_spare()) return;
    spare.store(kBuilders, std::memory_order_relaxed);
    if (wanted.load(std::memory_order_acquire) != 0) await_taker();
  }
  /// @ include/lot/detail/arena.hpp is_spare
  bool is_spare() const { return spare.load(std::memory_order_acquire) == kSpare; }
  /// @ src/transport/pool.cpp lay_out_anew
  void begin() {
    if (extents_.read() != 0) spare.store(Build::kSpare, std::memory_order_release);
  }
  /// What the builder has, and may change as it likes.
  Plain<unsigned>& extents() { return extents_; }

  /// @ src/transport/pool.cpp want_spare
  bool want_spare() {
    lock();
    const bool is_there = is_spare();
    if (is_there) wanted.store(1, std::memory_order_relaxed);
    unlock();
    return is_there;
  }
  /// @ src/transport/pool.cpp take_spare
  unsigned take_spare() {
    unsigned taken = 0;
    lock();
    if (is_spare() && wanted.load(std::memory_order_relaxed) != 0) {
      taken = extents_.read();
      extents_.write(0);
      spare.store(Build::kBuilders, std::memory_order_release);
      wanted.store(0, std::memory_order_release);
    }
    unlock();
    return taken;
  }

 private:
  struct Build {
    static constexpr std::uint32_t kBuilders = 0, kSpare = 1;
  };
  static constexpr std::uint32_t kBuilders = Build::kBuilders, kSpare = Build::kSpare;

  /// @ src/transport/arena.cpp await_taker
  void await_taker() {
    lock();
    wanted.store(0, std::memory_order_relaxed);
    unlock();
  }
  /// The pool's lock, as an ordinary one.
  void lock() {
    std::uint32_t open = 0;
    while (!lock_.compare_exchange_strong(open, 1, std::memory_order_acquire,
                                          std::memory_order_relaxed)) {
      open = 0;
      Policy::pause();
    }
  }
  void unlock() { lock_.store(0, std::memory_order_release); }

  Atomic<std::uint32_t> spare, wanted, lock_;
  Plain<unsigned> extents_;
};

/// A builder makes two messages, with the extents of former ones, while another thread is short of
/// memory. Each extent is the builder's or the taker's.
struct SparesAreTaken : Begins, rl::test_suite<SparesAreTaken, 2> {
  void before() { taken.write(0); }
  void thread(unsigned t) {
    if (t == 0) {
      for (unsigned n = 0; n < 2; ++n) {
        spares.begin();
        spares.own_spare();
        spares.extents().write(spares.extents().read() + 1);
      }
    } else {
      for (unsigned n = 0; n < 2; ++n) {
        if (!spares.want_spare()) continue;
        ProcessBarrier::pass();
        taken.write(taken.read() + spares.take_spare());
      }
    }
  }
  void after() { RL_ASSERT(spares.extents().read() + taken.read() == 4); }

  Spares spares{2};
  Plain<unsigned> taken;
};

/// src/transport/rouser.hpp. A word is known by its number.
class Rouser {
 public:
  using Word = Atomic<std::uint32_t>;
  explicit Rouser(std::array<Word, 2>& words) : words_(words) {}

  /// @ src/transport/rouser.cpp rouse
  void rouse(std::uint32_t word) {
    if (!note(word)) return words_[word - 1].wake_all();
    std::uint32_t is = state_.load(std::memory_order_seq_cst);
    if (is == kAwake) return;
    if (is == kEnding) return words_[word - 1].wake_all();
    if (!state_.compare_exchange_strong(is, kAwake, std::memory_order_seq_cst,
                                        std::memory_order_relaxed)) {
      return;
    }
    state_.wake_one();
  }
  /// @ src/transport/rouser.cpp stop
  void stop() {
    state_.store(kEnding, std::memory_order_seq_cst);
    state_.wake_one();
  }
  /// @ src/transport/rouser.cpp run
  void run() {
    for (;;) {
      wake_noted();
      std::uint32_t is = kAwake;
      if (!state_.compare_exchange_strong(is, kAsleep, std::memory_order_seq_cst)) break;
      if (!has_notes()) state_.wait_while(kAsleep);
      is = kAsleep;
      (void)state_.compare_exchange_strong(is, kAwake, std::memory_order_seq_cst);
    }
    wake_noted();
  }
  /// Its thread was started.
  void begin() { state_.store(kAwake, std::memory_order_relaxed); }

 private:
  enum State : std::uint32_t { kAbsent, kAwake, kAsleep, kEnding };

  /// @ src/transport/rouser.cpp note
  bool note(std::uint32_t word) {
    for (auto& place : places_) {
      std::uint32_t there = 0;
      if (place.compare_exchange_strong(there, word, std::memory_order_seq_cst) || there == word) {
        return true;
      }
    }
    return false;
  }
  /// @ src/transport/rouser.cpp has_notes
  bool has_notes() const {
    for (auto& place : places_) {
      if (place.load(std::memory_order_seq_cst) != 0) return true;
    }
    return false;
  }
  /// @ src/transport/rouser.cpp wake_noted
  void wake_noted() {
    constexpr std::uint32_t nullptr_ = 0;
    for (auto& place : places_) {
      if (place.load(std::memory_order_seq_cst) == nullptr_) continue;
      const std::uint32_t word = place.exchange(nullptr_, std::memory_order_seq_cst);
      if (word != 0) words_[word - 1].wake_all();
    }
  }

  std::array<Word, 2>& words_;
  Atomic<std::uint32_t> state_;
  std::array<Atomic<std::uint32_t>, 2> places_;
};

/// A process changes a word, and leaves the wake to its rouser; a sleeper waits for two such
/// changes.
struct RouserWakes : Begins, rl::test_suite<RouserWakes, 3> {
  void before() { rouser.begin(); }
  void thread(unsigned t) {
    if (t == 0) {
      for (std::uint32_t word : {1U, 2U}) {
        words[word - 1].fetch_add(1, std::memory_order_seq_cst);
        rouser.rouse(word);
      }
    } else if (t == 1) {
      rouser.run();
    } else {
      for (auto& word : words) {
        while (word.load(std::memory_order_acquire) == 0) word.wait_while(0);
      }
      rouser.stop();
    }
  }
  void after() {}

  std::array<Rouser::Word, 2> words;
  Rouser rouser{words};
};

const Entered entered{
    {"lock_is_biased", "one thread is in the biased lock", cast_of<LockIsBiased<2>>},
    {"lock_is_biased_three_threads", "the same of three threads", cast_of<LockIsBiased<3>>},
    {"spares_are_taken", "an extent is the builder's or the taker's", cast_of<SparesAreTaken>},
    {"rouser_wakes", "the rouser wakes all that it was asked to wake", cast_of<RouserWakes>},
};

}  // namespace
}  // namespace lot::model
