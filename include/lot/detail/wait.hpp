// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <utility>
#include <vector>

namespace lot::detail {

/// One word to sleep on, and the value that it must still have when the kernel looks (futex(2)).
struct FutexWait {
  const void* word;
  std::uint32_t value;
  /// Others may sleep on this value of the word, and a wake-up may be for a few of them only: the
  /// sleeper passes it on (waiting::pass_on).
  bool is_shared = false;
};

/// Hears of many rings by one word (docs/ear.md). What is armed by it needs no words of its own.
class Hearer {
 public:
  /// Hears of the ring of this channel from now on. Called before the mark is left there. Throws
  /// std::bad_alloc.
  virtual void listen(std::uint32_t channel) = 0;
  /// Hears once the directory has another version than this. Throws std::bad_alloc.
  virtual void watch_directory(std::uint32_t version) = 0;

 protected:
  ~Hearer() = default;
};

/// The words that one sleeper sleeps on. It remembers what it slept on last, so that it knows its
/// own marks.
class FutexWaits {
 public:
  FutexWaits() = default;
  FutexWaits(std::initializer_list<FutexWait> waits) : waits_(waits), size_(waits.size()) {}
  FutexWaits(std::size_t count, const FutexWait& wait) : waits_(count, wait), size_(count) {}
  FutexWaits(const FutexWaits&) = default;
  FutexWaits& operator=(const FutexWaits&) = default;
  /// The other one is empty then.
  FutexWaits(FutexWaits&& other) noexcept
      : waits_(std::move(other.waits_)), size_(std::exchange(other.size_, 0)) {}
  FutexWaits& operator=(FutexWaits&& other) noexcept {
    waits_ = std::move(other.waits_);
    size_ = std::exchange(other.size_, 0);
    return *this;
  }
  ~FutexWaits() = default;

  void reserve(std::size_t count) { waits_.reserve(count); }
  void clear() noexcept { size_ = 0; }
  void push_back(const FutexWait& wait) {
    if (size_ == waits_.size()) {
      waits_.push_back(wait);
    } else {
      waits_[size_] = wait;
    }
    ++size_;
  }
  /// Adds a word with a sleeper's mark, which was `found` there. One that this sleeper has left
  /// itself, when it slept on the same value in the same place, does not make the word shared.
  void push_back_marked(const void* word, std::uint32_t value, bool found) {
    const bool is_own = size_ < waits_.size() && waits_[size_].word == word &&
                        waits_[size_].value == value && !waits_[size_].is_shared;
    push_back({word, value, found && !is_own});
  }

  /// By what the next one is armed. Null: it adds its words.
  Hearer* hearer() const noexcept { return hearer_; }
  void hear_by(Hearer* hearer) noexcept { hearer_ = hearer; }

  std::size_t size() const noexcept { return size_; }
  bool empty() const noexcept { return size_ == 0; }
  const FutexWait* begin() const noexcept { return waits_.data(); }
  const FutexWait* end() const noexcept { return waits_.data() + size_; }
  const FutexWait& operator[](std::size_t i) const { return waits_[i]; }
  FutexWait& operator[](std::size_t i) { return waits_[i]; }

 private:
  std::vector<FutexWait> waits_;  ///< behind size_: of an earlier sleep
  std::size_t size_ = 0;
  Hearer* hearer_ = nullptr;
};

}  // namespace lot::detail
