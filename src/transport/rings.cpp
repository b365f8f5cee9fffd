// SPDX-License-Identifier: Apache-2.0
#include "transport/rings.hpp"

#include <cerrno>
#include <exception>
#include <optional>
#include <string>

#include "lot/error.hpp"

#include "transport/fill.hpp"

namespace lot::transport {

void check_depth(std::string_view topic, std::uint32_t depth) {
  if (depth == 0 || depth > segment::Segment::kDeepest) {
    throw Error(EINVAL, std::string(topic), "depth " + std::to_string(depth) + " is out of range",
                "set PusherOptions::depth (QueueOptions::depth) to 1 to " +
                    std::to_string(segment::Segment::kDeepest));
  }
}

registry::ChannelName Rings::open(std::uint32_t topic, const registry::RingOptions& options,
                                  std::uint32_t asker) {
  std::optional<registry::ChannelName> name;
  int error = 0;
  const auto try_open = [&] {
    const registry::Registry::Lock lock(registry_);
    name = registry_.open(topic, holder_.own.self, options);
    error = errno;
    return name.has_value();
  };
  const std::uint32_t granules = registry::Registry::granules_of(options);
  after_reaping(reaper_, [&] {
    if (try_open()) return;
    // Without the registry's lock: a warden that is asked to give may want it, and a stopped warden
    // is waited for.
    std::exception_ptr failure;
    memory_.make_room_for_run(granules, asker, [&] {
      try {
        return try_open();
      } catch (...) {
        failure = std::current_exception();
        return true;
      }
    });
    if (failure) std::rethrow_exception(failure);
  });
  if (!name)
    throw OutOfMemory(describe_ring_shortage(memory_, {asker, granules, error}, topic).c_str());
  return *name;
}

void Rings::close(const registry::ChannelName& name) noexcept {
  reaper_.end_ring(name);
  settle_closing();
}

void Rings::settle_closing() noexcept {
  if (!finish_closing() || world_.has_orphan_rings()) {
    holder_.ask(holder_.own.self, segment::errand::kOwn);
  }
}

bool Rings::finish_closing() noexcept {
  if (!reaper_.give_up_rings()) return false;
  // The orphanage holds now what the closed rings held. So the holds of this process may go.
  return stock_.drain(
      [this](const registry::ChannelName& ring) { return reaper_.ring_closed(ring); });
}

bool Rings::are_closed() noexcept { return !reaper_.has_closing_rings() && stock_.has_released(); }

}  // namespace lot::transport
