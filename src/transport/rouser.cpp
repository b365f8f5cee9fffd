// SPDX-License-Identifier: Apache-2.0
#include "transport/rouser.hpp"

#include <algorithm>
#include <exception>
#include <optional>
#include <pthread.h>

#include "lot/detail/no_signals.hpp"

#include "futex/futex.hpp"

namespace lot::transport {

void Rouser::rouse(const void* word) noexcept {
  if (!note(word)) return futex::wake_all(word);
  std::uint32_t is = state_.load(std::memory_order_seq_cst);  // N1
  if (is == kAwake) return;
  if (is == kEnding) return futex::wake_all(word);
  const bool starts = is == kAbsent;
  // N1. Relaxed where it fails: another thread was quicker, and does what this one would.
  if (!state_.compare_exchange_strong(is, kAwake, std::memory_order_seq_cst,
                                      std::memory_order_relaxed)) {
    return;
  }
  starts ? start() : futex::wake_one(&state_);
}

void Rouser::stop() noexcept {
  if (!thread_.joinable()) return;
  state_.store(kEnding, std::memory_order_seq_cst);  // N1
  futex::wake_one(&state_);
  thread_.join();
}

/// False: there is no place. A word that has a place needs no other: the thread takes it out before
/// it wakes.
bool Rouser::note(const void* word) noexcept {
  for (auto& place : places_) {
    const void* there = nullptr;
    if (place.compare_exchange_strong(there, word, std::memory_order_seq_cst) ||  // N1
        there == word) {
      return true;
    }
  }
  return false;
}

bool Rouser::has_notes() const noexcept {
  return std::any_of(places_.begin(), places_.end(), [](const auto& place) {
    return place.load(std::memory_order_seq_cst) != nullptr;  // N1
  });
}

void Rouser::wake_noted() noexcept {
  for (auto& place : places_) {
    if (place.load(std::memory_order_seq_cst) == nullptr) continue;               // N1
    const void* const word = place.exchange(nullptr, std::memory_order_seq_cst);  // N1
    if (word != nullptr) futex::wake_all(word);
  }
}

/// Where the system has no thread, the next request tries again.
void Rouser::start() noexcept {
  try {
    const detail::NoSignals quiet;
    thread_ = std::thread([this] { run(); });
  } catch (const std::exception&) {
    state_.store(kAbsent, std::memory_order_seq_cst);  // N1
    wake_noted();
  }
}

void Rouser::run() noexcept {
  pthread_setname_np(pthread_self(), "lot-rouser");
  warden_.lend_cores();
  for (;;) {
    wake_noted();
    std::uint32_t is = kAwake;
    if (!state_.compare_exchange_strong(is, kAsleep, std::memory_order_seq_cst)) break;  // N1
    if (!has_notes()) futex::wait(&state_, kAsleep, std::nullopt);
    is = kAsleep;  // it has notes, or the sleep has ended without a reason
    (void)state_.compare_exchange_strong(is, kAwake, std::memory_order_seq_cst);  // N1
  }
  wake_noted();  // it is to end
}

}  // namespace lot::transport
