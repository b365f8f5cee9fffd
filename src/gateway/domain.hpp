// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include <dds/dds.h>

#include "gateway/entity.hpp"

namespace lot::gateway {

/// Which DDS domain, and how to reach it.
struct DomainSettings {
  std::uint32_t id = 0;
  /// Network interfaces, by name or address. Empty: CycloneDDS chooses one.
  std::string interface;
  /// Larger samples are dropped before they are put together.
  std::uint64_t max_size = std::uint64_t{64} << 20;
  /// More elements of CycloneDDS's `Domain`, as XML: they come before the gateway's own, and those
  /// of CYCLONEDDS_URI before both.
  std::string more;

  bool operator==(const DomainSettings&) const = default;
};

/// The one DDS domain of this process, and a participant in it.
///
/// Threads: all members may be called at once. CycloneDDS has threads of its own.
/// Errors:  lot::Error (EREMOTEIO), which says what CycloneDDS said; its log has more.
/// Memory:  CycloneDDS's.
/// Crash:   other participants forget this one when its lease has ended: 10 s.
class Domain {
 public:
  explicit Domain(const DomainSettings& settings);

  dds_entity_t participant() const noexcept { return participant_.get(); }

 private:
  Entity domain_;  ///< destroyed last
  Entity participant_;
};

}  // namespace lot::gateway
