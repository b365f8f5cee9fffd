// SPDX-License-Identifier: Apache-2.0
#include "selection/replies.hpp"

#include <atomic>

namespace lot::selection {
namespace {

constexpr std::uint64_t kDeclines = 1;
constexpr std::uint64_t kConfirmed = 2;

/// A participant's two bits in the word of 32 participants.
constexpr std::uint64_t at(std::uint64_t bits, std::uint32_t participant) {
  return bits << (2 * (participant % segment::Replies::kPerWord));
}

}  // namespace

// All of them are relaxed: a reply brings nothing else. What must not be an earlier process's reply
// is ordered by the edge "pullers".

void TopicReplies::set(std::uint64_t bits, std::uint32_t participant) noexcept {
  // Relaxed: see above.
  word_of(participant).fetch_or(at(bits, participant), std::memory_order_relaxed);
}
void TopicReplies::take_back(std::uint64_t bits, std::uint32_t participant) noexcept {
  // Relaxed: see above.
  word_of(participant).fetch_and(~at(bits, participant), std::memory_order_relaxed);
}
bool TopicReplies::has(std::uint64_t bit, std::uint32_t participant) const noexcept {
  // Relaxed: see above.
  const std::uint64_t word = word_of(participant).load(std::memory_order_relaxed);
  return (word & at(bit, participant)) != 0;
}

void TopicReplies::begin(std::uint32_t participant) noexcept {
  take_back(kDeclines | kConfirmed, participant);
}
void TopicReplies::decline(std::uint32_t participant) noexcept { set(kDeclines, participant); }
void TopicReplies::confirm(std::uint32_t participant) noexcept {
  set(kConfirmed, participant);
  // In this order: a publisher that sees that the participant does not decline may ask.
  take_back(kDeclines, participant);
}

bool TopicReplies::wants(std::uint32_t participant) const noexcept {
  // The pullers first: they bring what begin() has done (edge "pullers").
  return registry_.has_pullers(topic_, participant) && !has(kDeclines, participant);
}
bool TopicReplies::has_confirmed(std::uint32_t participant) const noexcept {
  // As in wants().
  return registry_.has_pullers(topic_, participant) && has(kConfirmed, participant);
}
void TopicReplies::ask(std::uint32_t participant) noexcept { take_back(kConfirmed, participant); }

}  // namespace lot::selection
