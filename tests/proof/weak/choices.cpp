// SPDX-License-Identifier: Apache-2.0
#include "choices.hpp"

#include <charconv>
#include <stdexcept>

namespace lot::weak {

std::string to_text(const Trace& trace) {
  std::string text;
  for (const auto& [question, answer] : trace) {
    if (!text.empty()) text += ',';
    text += std::to_string(question) + ':' + std::to_string(answer);
  }
  return text;
}

bool from_text(std::string_view text, Trace& trace) {
  const char* at = text.data();
  const char* const end = at + text.size();
  while (at != end) {
    auto& [question, answer] = trace.emplace_back();
    auto read = std::from_chars(at, end, question);
    if (read.ec != std::errc() || read.ptr == end || *read.ptr != ':') return false;
    read = std::from_chars(read.ptr + 1, end, answer);
    if (read.ec != std::errc()) return false;
    at = read.ptr;
    if (at != end && *at++ != ',') return false;
  }
  return true;
}

unsigned Bounded::choose(Kind kind, unsigned count) {
  const bool costs = kind != Kind::Free;
  if (costs && left_ == 0) {
    cut_ = true;
    return 0;
  }
  if (at_ == path_.size()) path_.push_back({0, count, costs});
  const Node& node = path_[at_++];
  if (node.count != count || node.costs != costs) {
    throw std::logic_error("an execution that is done once more takes another way");
  }
  if (costs && node.chosen != 0) --left_;
  return node.chosen;
}

bool Bounded::next() {
  while (!path_.empty() && path_.back().chosen + 1 == path_.back().count) path_.pop_back();
  if (path_.empty()) return false;
  ++path_.back().chosen;
  return true;
}

void Random::begin() {
  random_.seed(static_cast<std::minstd_rand::result_type>(number_ * 2654435761U % 2147483646U + 1));
  random_.discard(3);  // the first ones of near seeds are near, too
  constexpr unsigned kSwitches[] = {2, 4, 8, 16, 32};
  constexpr unsigned kValues[] = {1, 4, 8, 16, 28};  // of 32 are old ones
  switches_ = kSwitches[random_() % 5];
  values_ = kValues[random_() % 5];
}

unsigned Random::choose(Kind kind, unsigned count) {
  if (kind == Kind::Free) return static_cast<unsigned>(random_() % count);
  const bool deviates =
      kind == Kind::Thread ? random_() % switches_ == 0 : random_() % 32 < values_;
  if (!deviates) return 0;
  return 1 + static_cast<unsigned>(random_() % (count - 1));
}

unsigned Replay::choose(Kind /*kind*/, unsigned count) {
  const std::uint32_t question = question_++;
  if (at_ == trace_.size() || trace_[at_].first != question) return 0;
  const std::uint32_t answer = trace_[at_++].second;
  if (answer >= count) throw std::logic_error("the trace is of another scenario");
  return answer;
}

}  // namespace lot::weak
