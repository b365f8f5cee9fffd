// SPDX-License-Identifier: Apache-2.0

#include "segment/layout.hpp"

// Each shared word that says which processes there are has one class that changes it.
void wrong(lot::segment::ParticipantEntry& participant, lot::segment::Witness& witness,
           lot::segment::Directory& directory, lot::segment::Sighting& sighting) {
  participant.state.store(1);
  witness.seat.store(0);
  directory.version.fetch_add(1);
  directory.adoptions.fetch_add(1);
  directory.looked_ns.store(1);
  directory.persists.store(1);
  sighting.what.store(0);
}
