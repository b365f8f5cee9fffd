// SPDX-License-Identifier: Apache-2.0
#include "tool/watch.hpp"

#include <algorithm>
#include <utility>

#include "lot/error.hpp"

#include "tool/text.hpp"

namespace lot::tool {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds kNewsStay{10};

std::uint64_t instance_of(Window& window) { return window.segment().header().identity.instance; }

/// True when the window that was opened before still shows what lies there now.
bool is_same(const Sight& before, const Sight& now) {
  return before.name == now.name && before.window != nullptr && now.window != nullptr &&
         !before.window->torn() && instance_of(*before.window) == instance_of(*now.window) &&
         before.window->segment().size() == now.window->segment().size();
}

}  // namespace

void Watch::look() {
  for (auto& segment : segments_) {
    if (segment.meter != nullptr) segment.meter->look();
  }
}

bool Watch::has_enough() const {
  return std::all_of(segments_.begin(), segments_.end(), [](const Watched& segment) {
    return segment.meter == nullptr || segment.meter->has_enough();
  });
}

void Watch::tell(const std::string& text) {
  if (has_looked_) news_.push_back({text, Clock::now()});
}

std::vector<std::string> Watch::news() const {
  std::vector<std::string> lines;
  if (!problem_.empty()) lines.push_back(problem_);
  for (const auto& news : news_) lines.push_back(news.text);
  if (segments_.empty() && problem_.empty()) {
    lines.push_back(where_.name.empty()
                        ? "no segments in " + printable(where_.directory, 200) + ": waiting for one"
                        : "no segment " + printable(path_of(where_, where_.name), 200) +
                              ": waiting for it");
  }
  return lines;
}

Watched Watch::observed(Sight now) {
  Watched segment;
  const auto before = std::find_if(segments_.begin(), segments_.end(),
                                   [&](const Watched& w) { return w.sight.name == now.name; });
  if (before == segments_.end()) {
    tell(printable(now.name) + " has come");
  } else if (is_same(before->sight, now)) {
    segment = std::move(*before);
  } else if (now.window != nullptr) {
    tell(printable(now.name) + " has come anew");
  }
  if (segment.sight.window == nullptr) segment.sight = std::move(now);
  if (segment.sight.window == nullptr) return segment;
  Window& window = *segment.sight.window;
  if (segment.meter == nullptr) {
    segment.meter = std::make_unique<PaceMeter>(window);
  } else {
    segment.meter->find_queues();
    segment.meter->look();
  }
  segment.seen = observe(window);
  segment.sizes.note(segment.seen);
  const Rates rates = segment.meter->rates();
  segment.topics = topics_of(segment.seen, rates, segment.sizes);
  segment.processes = processes_of(segment.seen, rates, segment.sizes);
  return segment;
}

void Watch::refresh() {
  std::erase_if(news_, [](const News& news) { return Clock::now() - news.at > kNewsStay; });
  std::vector<Sight> found;
  problem_.clear();
  try {
    found = sights(where_);
  } catch (const Error& e) {  // the directory has gone, or was closed to this user
    problem_ = printable(e.what(), kLine);
  }
  std::vector<std::string> names;
  for (const auto& segment : segments_) names.push_back(segment.sight.name);
  std::vector<Watched> now;
  for (auto& sight : found) now.push_back(observed(std::move(sight)));
  for (const auto& name : names) {
    const bool is_there = std::any_of(
        now.begin(), now.end(), [&](const Watched& segment) { return segment.sight.name == name; });
    if (!is_there) tell(printable(name) + " has gone");
  }
  segments_ = std::move(now);
  has_looked_ = true;
}

}  // namespace lot::tool
