// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <unistd.h>

#include "gateway/domain.hpp"

namespace lot::testing {

/// Settings of a domain of this process that only the process's other domains meet: on the loopback
/// interface, without multicast. `id`: each domain of a process has another one. `met_as`: which
/// domain it is for others; that of a gateway of this test is 0.
inline gateway::DomainSettings alone(std::uint32_t id, std::uint32_t met_as = 77) {
  gateway::DomainSettings settings;
  settings.id = id;
  settings.interface = "127.0.0.1";
  settings.more =
      "<General><AllowMulticast>false</AllowMulticast></General>"
      "<Discovery><ExternalDomainId>" +
      std::to_string(met_as) + "</ExternalDomainId><Tag>lot" + std::to_string(getpid()) +
      "</Tag><ParticipantIndex>auto</ParticipantIndex>"
      "<MaxAutoParticipantIndex>99</MaxAutoParticipantIndex>"
      "<Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery>";
  return settings;
}

}  // namespace lot::testing
