// SPDX-License-Identifier: Apache-2.0
#include "transport/neighbours.hpp"

namespace lot::transport {

bool Neighbours::may_gather() noexcept {
  constexpr auto kSeldom = std::chrono::milliseconds(100);
  const auto now = futex::Clock::now().time_since_epoch();
  // Relaxed: two threads may ask at once, which does no harm.
  const futex::Clock::duration last(gathered_.load(std::memory_order_relaxed));
  return now - last >= kSeldom;
}

void Neighbours::ask_others(Questions& questions) noexcept {
  // Relaxed: see may_gather().
  gathered_.store(futex::Clock::now().time_since_epoch().count(), std::memory_order_relaxed);
  for (std::uint32_t k = 1; k < world_.participants(); ++k) {
    // Acquire: edge "state".
    if (k == holder_.own.self || world_.participant_state(k).load(std::memory_order_acquire) == 0)
      continue;
    questions.awaited[k] = !is_silent(k);
    // Relaxed: an answer to an earlier question is as good as one to this question.
    questions.answers[k] = segment_.witnesses()[k].errands.answers();
    holder_.ask(k, segment::errand::kTrim);
  }
}

bool Neighbours::has_answered(const Questions& questions, std::uint32_t k) const noexcept {
  // E2. G1 carries the memory itself.
  return segment_.witnesses()[k].errands.answers_acquired() != questions.answers[k];
}

bool Neighbours::all_have_answered(const Questions& questions) const noexcept {
  for (std::uint32_t k = 1; k < world_.participants(); ++k) {
    if (questions.awaited[k] && !has_answered(questions, k)) return false;
  }
  return true;
}

void Neighbours::note_silent(const Questions& questions) noexcept {
  for (std::uint32_t k = 1; k < world_.participants(); ++k) {
    if (questions.awaited[k] && !has_answered(questions, k)) note_silent(k, questions.answers[k]);
  }
}

bool Neighbours::ask_to_give(std::uint32_t k, const Request& request) noexcept {
  auto& errands = segment_.witnesses()[k].errands;
  errands.ask(request.word());
  std::uint64_t answer = request.word();
  // Where another process has asked meanwhile, something may have
  // been given.
  return ask_and_wait(k, segment::errand::kGive,
                      [&] {
                        answer = errands.request();
                        return answer != request.word();
                      }) &&
         answer != Request::kRefused;
}

bool Neighbours::is_silent(std::uint32_t k) const noexcept {
  const std::uint64_t answers = segment_.witnesses()[k].errands.answers();
  // Relaxed: it only says how long to wait.
  return silent_[k].load(std::memory_order_relaxed) == answers + 1;
}

}  // namespace lot::transport
