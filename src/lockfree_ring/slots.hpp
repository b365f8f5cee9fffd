// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "lockfree_ring/words.hpp"

/// The slots of a ring, and messages that travel in them (docs/fast-lane.md).
///
/// A slot is its word, or as many words as the ring's *stride* says:
///
///     word | begin | the message ...................... | time of the push
///
/// `word` says which message is there, as in any ring; its block is kInSlot. `begin` says which
/// message the publisher has last begun to write there. So a slot has a message for a reader at `s`
/// while both say s. Where messages are taken, `begin` says nothing: a reader whose copy is not
/// whole does not get the message out of its slot. The reader copies the message and then looks at
/// `begin`. No process waits for another one that is in the middle of a copy.
///
/// Edge
///   R16  begin store, fence (release), stores of the message in Slots::write
///        -> loads of the message, fence (acquire), begin load in Slots::read
///        carries: "the message that was here goes". A reader whose copy has a word of a newer
///        message finds that message's `begin`.
namespace lot::ring {

/// The block of a slot whose message lies in the slot itself. No segment has so many blocks.
inline constexpr Word kInSlot = kNoBlock - 1;

/// What a copy of a message is worth.
enum class Copy {
  Whole,
  Overwritten,  ///< the publisher has begun to write a newer message there
  Damaged,      ///< no publisher can have left this `begin`
};

/// A view of the slots of one ring. Copyable; owns nothing.
template <class P>
class Slots {
 public:
  using Shared = typename P::template Atomic<Word>;

  Slots() = default;
  /// One word a slot: the messages lie in blocks.
  Slots(Shared* words) noexcept : words_(words) {}  // NOLINT(google-explicit-constructor)
  /// `stride` bytes a slot: the messages lie in the slots. REQUIRES: the stride is a power of two,
  /// and larger than the words before the message.
  static Slots with_messages(Shared* words, std::size_t stride) noexcept {
    Slots slots(words);
    slots.shift_ = static_cast<unsigned>(std::countr_zero(stride / sizeof(Word)));
    return slots;
  }
  /// Bytes of the longest message that a slot has room for.
  static constexpr std::size_t room(std::size_t stride, bool with_time) noexcept {
    return stride - (kHead + (with_time ? 1 : 0)) * sizeof(Word);
  }

  /// The word of slot i.
  Shared& operator[](std::size_t i) const { return words_[i << shift_]; }
  bool have_messages() const noexcept { return shift_ != 0; }
  /// Bytes from slot to slot.
  std::size_t stride() const noexcept { return sizeof(Word) << shift_; }

  /// Makes slot i, before any process knows the ring. `first` is the sequence of its first message,
  /// `before` the one of the message that would have been there a lap earlier.
  void format(std::uint32_t i, Word first, Word before) const {
    words_[std::size_t{i} << shift_].store(make(before, kNoBlock),
                                           std::memory_order_relaxed);         // R7
    if (have_messages()) begin_of(i).store(first, std::memory_order_relaxed);  // R7
  }

  /// Says that the message of this sequence comes into slot i next: what is there goes.
  void begin(std::uint32_t i, Word sequence) const {
    begin_of(i).store(sequence, std::memory_order_relaxed);  // R16: the fence in write()
  }
  /// Writes a message into slot i: its first `words`, the last of which may end behind it, and
  /// where the ring has that, the time of its push. The exchange of the word then publishes it.
  /// REQUIRES: no reader needs what is there, or begin() has told; the message fits.
  ///
  /// A reader that spins has the first line of the slot. So that line comes last, and the exchange
  /// at once behind it: else the reader would take the line away in between.
  ///
  /// Crash: killed before the exchange, the slot has no message.
  [[gnu::hot]] void write(std::uint32_t i, const void* message, std::size_t words,
                          const Word* time) const {
    P::release_fence();  // R16
    Shared* const to = message_of(i);
    const auto* const from = static_cast<const unsigned char*>(message);
    // Relaxed, all of them: R1 carries the message, and R16 tells the reader of a newer one.
    if (time != nullptr) time_of(i).store(*time, std::memory_order_relaxed);  // R1, R16
    const auto put = [&](std::size_t w) {
      Word word;
      std::memcpy(&word, from + w * sizeof(Word), sizeof(Word));
      to[w].store(word, std::memory_order_relaxed);  // R1, R16
    };
    // Four at a time: one by one, the loop's own instructions are more than half.
    std::size_t w = words;
    while (w % 4 != 0) put(--w);
    for (; w != 0; w -= 4) {
      put(w - 1);
      put(w - 2);
      put(w - 3);
      put(w - 4);
    }
  }

  /// Copies the message of this sequence out of slot i, as write() has got it, and the time of its
  /// push if `time` is not null. `places`: how many slots the ring has. REQUIRES: the word said
  /// that it is there (acquire).
  [[gnu::hot]] Copy read(std::uint32_t i, Word sequence, std::uint32_t places, void* into,
                         std::size_t words, Word* time) const {
    const Shared* const from = message_of(i);
    auto* const to = static_cast<unsigned char*>(into);
    // Relaxed, all of them: as in write().
    for (std::size_t w = 0; w < words; ++w) {
      const Word word = from[w].load(std::memory_order_relaxed);  // R1, R16
      std::memcpy(to + w * sizeof(Word), &word, sizeof(Word));
    }
    if (time != nullptr) *time = time_of(i).load(std::memory_order_relaxed);  // R1, R16
    P::acquire_fence();                                                       // R16
    const Word begun = begin_of(i).load(std::memory_order_relaxed);           // R16
    if (begun == sequence) [[likely]]
      return Copy::Whole;
    return distance(begun, sequence) % places == 0 ? Copy::Overwritten : Copy::Damaged;
  }

  /// Fetches the first cache line of slot i for a reader.
  void prefetch_first(std::uint32_t i) const { P::prefetch_read(&(*this)[i]); }
  /// Fetches the cache lines of slot i for a reader that has the first one.
  void prefetch_rest(std::uint32_t i) const {
    const Shared* const slot = &(*this)[i];
    for (std::size_t w = kLineWords; w < std::size_t{1} << shift_; w += kLineWords) {
      P::prefetch_read(slot + w);
    }
  }
  /// Fetches the cache lines of slot i for the publisher.
  void prefetch_write(std::uint32_t i) const {
    const Shared* const slot = &(*this)[i];
    P::prefetch_write(slot);
    for (std::size_t w = kLineWords; w < std::size_t{1} << shift_; w += kLineWords) {
      P::prefetch_write(slot + w);
    }
  }

 private:
  static constexpr std::size_t kHead = 2;  ///< words before the message
  static constexpr std::size_t kLineWords = P::kLine / sizeof(Word);

  Shared& begin_of(std::uint32_t i) const { return words_[(std::size_t{i} << shift_) + 1]; }
  Shared* message_of(std::uint32_t i) const { return words_ + (std::size_t{i} << shift_) + kHead; }
  Shared& time_of(std::uint32_t i) const { return words_[(std::size_t{i + 1} << shift_) - 1]; }

  Shared* words_ = nullptr;
  unsigned shift_ = 0;
};

}  // namespace lot::ring
