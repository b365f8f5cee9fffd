// SPDX-License-Identifier: Apache-2.0
#include "first_sequence.hpp"

#include "registry/registry.hpp"

namespace {

std::uint64_t first = 0;

using lot::registry::ChannelName;
using lot::registry::Registry;
using lot::registry::RingOptions;

}  // namespace

// The linker (--wrap) sends the callers of Registry::open() to the second of these.
ChannelName really_open(Registry*, std::uint32_t, std::uint32_t, const RingOptions&) asm(
    "__real__ZN3lot8registry8Registry4openEjjRKNS0_11RingOptionsE");
ChannelName open_at_first(Registry*, std::uint32_t, std::uint32_t, const RingOptions&) asm(
    "__wrap__ZN3lot8registry8Registry4openEjjRKNS0_11RingOptionsE");

ChannelName open_at_first(Registry* registry, std::uint32_t topic, std::uint32_t participant,
                          const RingOptions& options) {
  RingOptions changed = options;
  changed.first = first;
  return really_open(registry, topic, participant, changed);
}

namespace lot::testing {
void begin_rings_at(std::uint64_t sequence) { first = sequence; }
}  // namespace lot::testing
