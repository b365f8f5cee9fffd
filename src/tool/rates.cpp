// SPDX-License-Identifier: Apache-2.0
#include "tool/rates.hpp"

#include <algorithm>
#include <memory>
#include <optional>
#include <thread>

namespace lot::tool {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;
using ring::Word;

constexpr std::chrono::milliseconds kLeast = 300ms;
/// Between two looks: the error of a moment of arrival.
constexpr std::chrono::microseconds kShortest = 100us;
constexpr std::chrono::microseconds kLongest = 5ms;

double seconds_now() {
  return std::chrono::duration<double>(Clock::now().time_since_epoch()).count();
}

Word sequence_at(const segment::Ring& r, std::uint32_t i) {
  return ring::sequence(r.slots[i].load(std::memory_order_acquire));  // R1
}

/// The slot of the newest message.
std::uint32_t newest_slot(const segment::Ring& r) {
  std::uint32_t newest = 0;
  for (std::uint32_t i = 1; i < r.places(); ++i) {
    if (ring::distance(sequence_at(r, i), sequence_at(r, newest)) > 0) newest = i;
  }
  return newest;
}

/// The ring of a channel if its publisher lives and the generation is this one.
std::optional<segment::Ring> live_ring(segment::Segment& s, std::uint32_t channel,
                                       std::uint32_t generation) {
  const Word w = s.channels()[channel].writer.load(std::memory_order_acquire);  // R7
  if (ring::writer_state(w) != ring::State::Live || ring::writer_generation(w) != generation) {
    return std::nullopt;
  }
  segment::Ring r = s.ring(channel);
  if (r.depth == 0) return std::nullopt;
  return r;
}

}  // namespace

template <class Told>
Meter<Told>::Meter(Window& window) : window_(window) {
  find_queues();
}

template <class Told>
void Meter<Told>::find_queues() {
  now_ = seconds_now();
  segment::Segment& s = window_.segment();
  std::erase_if(queues_, [&](const Watched& queue) {
    return !live_ring(s, queue.channel, queue.generation);
  });
  const auto is_watched = [this](std::uint32_t channel, std::uint32_t generation) {
    return std::any_of(queues_.begin(), queues_.end(), [&](const Watched& queue) {
      return queue.channel == channel && queue.generation == generation;
    });
  };
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    const auto generation =
        ring::writer_generation(s.channels()[c].writer.load(std::memory_order_acquire));  // R7
    const auto r = live_ring(s, c, generation);
    if (!r || is_watched(c, generation)) continue;
    const std::uint32_t newest = newest_slot(*r);
    queues_.push_back({c, generation, newest, sequence_at(*r, newest), Told(now_)});
  }
}

template <class Told>
std::uint64_t Meter<Told>::arrivals(Watched& queue) {
  const auto r = live_ring(window_.segment(), queue.channel, queue.generation);
  if (!r || queue.index >= r->places()) return 0;
  const Word before = queue.newest;
  // Most looks find nothing new in the slot of the next message, and need no other slot.
  const std::uint32_t next = (queue.index + 1) % r->places();
  if (ring::distance(sequence_at(*r, next), before) <= 0) return 0;
  queue.index = newest_slot(*r);
  queue.newest = sequence_at(*r, queue.index);
  const auto n = ring::distance(queue.newest, before);
  return n > 0 ? static_cast<std::uint64_t>(n) : 0;
}

template <class Told>
void Meter<Told>::look() {
  now_ = seconds_now();
  for (auto& queue : queues_) queue.told.see(now_, arrivals(queue));
}

template <class Told>
bool Meter<Told>::has_enough() const {
  return std::all_of(queues_.begin(), queues_.end(), [this](const Watched& queue) {
    return queue.told.rate(now_).per_second.has_value();
  });
}

template <class Told>
Rates Meter<Told>::rates() const {
  Rates rates;
  for (const auto& queue : queues_) {
    rates[{queue.channel, queue.generation}] = queue.told.rate(now_);
  }
  return rates;
}

template class Meter<Tempo>;
template class Meter<Pace>;

std::vector<Rates> measure(const std::vector<Window*>& windows, std::chrono::milliseconds at_most) {
  std::vector<std::unique_ptr<RateMeter>> meters;
  for (Window* window : windows) {
    meters.push_back(window != nullptr ? std::make_unique<RateMeter>(*window) : nullptr);
  }
  const auto is_known = [](const auto& meter) { return meter == nullptr || meter->has_enough(); };
  const auto begin = Clock::now();
  const auto pause = std::clamp<std::chrono::microseconds>(at_most / 20, kShortest, kLongest);
  // A segment without a queue has nothing to wait for.
  const bool nothing = std::all_of(meters.begin(), meters.end(), [](const auto& meter) {
    return meter == nullptr || meter->rates().empty();
  });
  for (auto passed = Clock::duration::zero(); !nothing && passed < at_most;
       passed = Clock::now() - begin) {
    if (passed >= kLeast && std::all_of(meters.begin(), meters.end(), is_known)) break;
    std::this_thread::sleep_for(std::min<Clock::duration>(pause, at_most - passed));
    for (const auto& meter : meters) {
      if (meter != nullptr) meter->look();
    }
  }
  std::vector<Rates> all;
  for (const auto& meter : meters) all.push_back(meter != nullptr ? meter->rates() : Rates());
  return all;
}

}  // namespace lot::tool
