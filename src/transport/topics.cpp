// SPDX-License-Identifier: Apache-2.0
#include "transport/topics.hpp"

#include <algorithm>
#include <exception>
#include <utility>

namespace lot::transport {

std::uint32_t Topics::enter(std::string_view name, const detail::MessageType& type, Role role) {
  if (type.described != nullptr) (void)type.described(type);  // made once, and under no lock
  std::uint32_t topic = 0;
  after_reaping(reaper_, [&] {
    const std::lock_guard guard(topics_mutex_);
    const registry::Registry::Lock lock(registry_);
    topic = registry_.enter(name, type, index(), role);
    try {
      ++topic_uses_[{topic, role}];
    } catch (...) {  // the entry was not there
      registry_.leave(topic, index(), role);
      throw;
    }
  });
  return topic;
}

void Topics::leave(std::uint32_t topic, Role role) noexcept {
  const std::lock_guard guard(topics_mutex_);
  count_out(topic, role);
}

std::shared_ptr<const registry::KnownType> Topics::type_of(std::string_view name) {
  std::shared_ptr<const registry::KnownType> found;
  after_reaping(reaper_, [&] {
    const registry::Registry::Lock lock(registry_);
    found = registry_.type_of(name);
  });
  return found;
}

std::vector<std::string> Topics::names() {
  const registry::Registry::Lock lock(registry_);
  return registry_.names();
}

const std::shared_ptr<const registry::KnownType>& Topics::share(
    std::shared_ptr<const registry::KnownType> type) {
  const std::lock_guard guard(topics_mutex_);
  const auto earlier = std::ranges::find_if(
      shared_types_, [&](const auto& shared) { return shared->is_equal(*type); });
  return earlier != shared_types_.end() ? *earlier : shared_types_.emplace_back(std::move(type));
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
  leave(departure.front().topic, departure.front().role);
}

bool Topics::finish_departures() noexcept {
  const std::lock_guard guard(departures_mutex_);
  if (departures_.empty()) return true;
  // The warden must not wait, since it has to watch the other processes.
  const std::unique_lock topics(topics_mutex_, std::try_to_lock);
  if (!topics || !registry_.try_lock()) return false;
  for (const auto& departure : departures_) {
    registry_.remove(departure, index());
    count_out(departure.topic, departure.role);
  }
  registry_.unlock();
  departures_.clear();
  return true;
}

void Topics::count_out(std::uint32_t topic, Role role) noexcept {
  const auto uses = topic_uses_.find({topic, role});
  if (--uses->second == 0) {
    topic_uses_.erase(uses);
    registry_.leave(topic, index(), role);
  }
}

}  // namespace lot::transport
