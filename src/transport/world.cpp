// SPDX-License-Identifier: Apache-2.0
#include "transport/world.hpp"

#include <cstring>

namespace lot::transport {

std::string_view World::name_of(std::uint32_t k) const noexcept {
  if (k >= participants()) return {};  // the index comes from a damaged word
  const auto& entry = segment_.participants()[k];
  return {entry.name, strnlen(entry.name, sizeof(entry.name))};
}

/// How many channels, from the lowest, were ever in use. Channels are taken lowest first. A thread
/// that has seen one of a higher number has seen those below it, so a search ends at the first
/// channel that was never taken. (After 2^31 uses a channel looks new. A search may then end too
/// early, until the channel is taken once more.)
std::uint32_t World::used_channels() noexcept {
  // Relaxed: the number only grows, and two threads find the same. The writer words are acquired
  // (R7): a ring that is found is whole.
  std::uint32_t used = used_channels_.load(std::memory_order_relaxed);
  // Acquire: R7.
  while (used < channels() && channel_writer(used).load(std::memory_order_acquire) != 0) ++used;
  used_channels_.store(used, std::memory_order_relaxed);  // as above
  return used;
}

bool World::has_orphan_rings() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    // Acquire: R9.
    const auto w = channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(w) == ring::State::Orphan) return true;
  }
  return false;
}

/// Whether a ring has ended whose readers are at their last messages. A ring of items to be taken
/// counts only when it has no news: its items may wait for long, and the reader that takes the last
/// one says so. A hint: a ring may be recycled meanwhile.
bool World::has_ending_rings() noexcept {
  const std::uint32_t used = used_channels();
  for (std::uint32_t c = 0; c < used; ++c) {
    // Acquire: R9.
    const auto w = channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(w) != ring::State::Orphan) continue;
    const segment::Ring r = ring(c);
    if (!r.taken || !r.has_news()) return true;
  }
  return false;
}

void World::renew_directory() noexcept {
  auto& version = segment_.directory().version;
  version.bump();
  futex::wake_all(&version.word());
}

/// Crash:   killed after this and before the dead participant's name goes, the next reaper does it
///          all again.
void World::forget(std::uint32_t k) noexcept {
  // The dead participant may have had this lock. Freed here, it keeps no process waiting.
  if (registry_.try_lock()) registry_.unlock();
  registry_.forget(k);
  segment_.free_ears(k);
  segment_.directory().adoptions.fetch_add(1, std::memory_order_release);  // D3
}

void World::release_extents(const std::vector<bool>& dead) noexcept {
  segment_.granules().release_if([&dead](std::uint32_t tag) {
    return (tag & segment::kRingTag) == 0 && tag - 1 < dead.size() && dead[tag - 1];
  });
}

}  // namespace lot::transport
