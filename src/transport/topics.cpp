// SPDX-License-Identifier: Apache-2.0
#include "transport/topics.hpp"

#include <exception>
#include <utility>

namespace lot::transport {

std::uint32_t Topics::enter(std::string_view name, const detail::MessageType& type) {
  std::uint32_t topic = 0;
  after_reaping(reaper_, [&] {
    const std::lock_guard guard(topics_mutex_);
    const registry::Registry::Lock lock(registry_);
    topic = registry_.enter(name, type, index());
    try {
      ++topic_uses_[topic];
    } catch (...) {  // the entry was not there
      registry_.leave(topic, index());
      throw;
    }
  });
  return topic;
}

void Topics::leave(std::uint32_t topic) noexcept {
  const std::lock_guard guard(topics_mutex_);
  count_out(topic);
}

void Topics::depart(std::list<registry::Departure> departure) noexcept {
  try {
    const registry::Registry::Lock lock(registry_);
    registry_.remove(departure.front(), index());
  } catch (const std::exception&) {  // a stopped process keeps the registry's lock
    {
      const std::lock_guard guard(departures_mutex_);
      departures_.splice(departures_.end(), departure);
    }
    holder_.ask(index(), segment::errand::kOwn);
    return;
  }
  leave(departure.front().topic);
}

bool Topics::finish_departures() noexcept {
  const std::lock_guard guard(departures_mutex_);
  if (departures_.empty()) return true;
  // The warden must not wait, since it has to watch the other processes.
  const std::unique_lock topics(topics_mutex_, std::try_to_lock);
  if (!topics || !registry_.try_lock()) return false;
  for (const auto& departure : departures_) {
    registry_.remove(departure, index());
    count_out(departure.topic);
  }
  registry_.unlock();
  departures_.clear();
  return true;
}

void Topics::count_out(std::uint32_t topic) noexcept {
  if (--topic_uses_[topic] == 0) {
    topic_uses_.erase(topic);
    registry_.leave(topic, index());
  }
}

}  // namespace lot::transport
