// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>

#include "registry/registry.hpp"
#include "transport/memory.hpp"
#include "transport/pool.hpp"
#include "transport/reaper.hpp"
#include "transport/stock.hpp"

namespace lot::transport {

/// The rings of this process's publishers: they open, end, and their messages go to the orphanage.
///
/// Threads: all members may be called at once.
/// Crash:   a ring that its maker has not finished, or that it had begun to close, is found by the
///          maker's index (Recovery::orphan_ring()).
class Rings {
 public:
  Rings(World& world, registry::Registry& registry, const Holder& holder, Reaper& reaper,
        Stock& stock, Memory& memory) noexcept
      : world_(world),
        registry_(registry),
        holder_(holder),
        reaper_(reaper),
        stock_(stock),
        memory_(memory) {}

  /// Makes a ring for the publisher with the pool `asker`. In a full segment other publishers make
  /// room for it, as for a message. Throws lot::Error or OutOfMemory.
  registry::ChannelName open(std::uint32_t topic, const registry::RingOptions& options,
                             std::uint32_t asker);
  /// Ends a ring of this process. Its readers get what is in it and then the end.
  void close(const registry::ChannelName& name) noexcept;
  /// Finishes what closing has left to do, or leaves it to the warden.
  void settle_closing() noexcept;
  /// False when something is left to do: a lock was taken, or others hold messages.
  bool finish_closing() noexcept;
  /// True when no hold of a ring is left that a thread of this process has still to give up.
  bool are_closed() noexcept;

 private:
  World& world_;
  registry::Registry& registry_;
  const Holder& holder_;
  Reaper& reaper_;
  Stock& stock_;
  Memory& memory_;
};

/// Throws lot::Error when no ring can be so deep.
void check_depth(std::string_view topic, std::uint32_t depth);

}  // namespace lot::transport
