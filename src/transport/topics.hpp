// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "lot/detail/control.hpp"
#include "lot/detail/mutex.hpp"

#include "registry/registry.hpp"
#include "transport/pool.hpp"
#include "transport/reaper.hpp"

namespace lot::transport {

/// The topics that this process is a user of. It counts its handles on each.
///
/// Threads: all members may be called at once.
/// Crash:   the registry has the process among the users of a topic until a reaper forgets it.
class Topics {
 public:
  Topics(registry::Registry& registry, const Holder& holder, Reaper& reaper) noexcept
      : registry_(registry), holder_(holder), reaper_(reaper) {}
  Topics(const Topics&) = delete;
  Topics& operator=(const Topics&) = delete;

  using Role = registry::Role;

  /// Throws lot::Error.
  std::uint32_t enter(std::string_view name, const detail::MessageType& type,
                      Role role = Role::User);
  void leave(std::uint32_t topic, Role role = Role::User) noexcept;
  /// Null: there is no such topic. Throws lot::Error (EBADMSG, EBUSY).
  std::shared_ptr<const registry::KnownType> type_of(std::string_view name);
  /// The names of all topics that have users. Throws lot::Error (EBUSY).
  std::vector<std::string> names();
  /// One of the types that this process publishes or reads without having them: the one that was
  /// given, or an earlier one that is the same. It lives as long as this. Throws std::bad_alloc.
  const std::shared_ptr<const registry::KnownType>& share(
      std::shared_ptr<const registry::KnownType> type);

  /// The last step of a puller that is destroyed: it leaves the rings that it never looked at, and
  /// the topic. Where a stopped process keeps the registry's lock, the warden does that later.
  void depart(std::list<registry::Departure> departure) noexcept;
  /// False when some departures are left. Does not wait.
  bool finish_departures() noexcept;

 private:
  /// Counts one handle of the topic less. REQUIRES: topics_mutex_.
  void count_out(std::uint32_t topic, Role role) noexcept;
  std::uint32_t index() const noexcept { return holder_.own.self; }

  registry::Registry& registry_;
  const Holder& holder_;
  Reaper& reaper_;
  detail::Mutex topics_mutex_{detail::Rank::Topics};
  std::map<std::pair<std::uint32_t, Role>, unsigned> topic_uses_;
  std::list<std::shared_ptr<const registry::KnownType>> shared_types_;
  detail::Mutex departures_mutex_{detail::Rank::Departures};
  std::list<registry::Departure> departures_;  ///< those that the warden has to finish
};

}  // namespace lot::transport
