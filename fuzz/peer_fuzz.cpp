// SPDX-License-Identifier: Apache-2.0

// What writers of other hosts say of themselves in their user data: any bytes. They become an
// error, no peer, or a peer whose own user data say the same.
//
// Input: the user data. (corpus/peer/ has examples)

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "lot/any_message.hpp"
#include "lot/error.hpp"
#include "lot/fuzz.hpp"

#include "gateway/peer.hpp"
#include "support/plant.hpp"

namespace {

using lot::fuzz::planted;
using lot::fuzz::require;
using lot::gateway::Peer;
using lot::gateway::peer_of;

void check(const std::string& user_data) try {
  const std::optional<Peer> peer = peer_of(user_data);
  if (!peer) {
    require((";" + user_data).find(";lot.segment=") == user_data.npos, "a gateway's user data");
    return;
  }
  std::string told = user_data_of(*peer);
  if (planted("other_segment")) told += "lot.segment=other;";
  if (planted("other_number")) told += "lot.ledger=1;lot.written=77;";
  if (planted("lost_type")) told.erase(0, told.find("lot.segment="));
  if (planted("lost_peer")) told.clear();
  const std::optional<Peer> again = peer_of(told);
  require(again.has_value(), "a peer comes back from its user data");
  require(again->segment == peer->segment, "its segment");
  require(again->ledger == peer->ledger, "its ledger");
  if (peer->ledger != 0) require(again->written == peer->written, "how far it has come");
  if (!again->type && told.size() < 1000) require(!peer->type, "its type is not left out");
  if (again->type) require(peer->type && again->type.is_same(peer->type), "its type");
} catch (const lot::Error& e) {
  require(e.error_number() == EBADMSG, "the error of a type that can be none");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  check({reinterpret_cast<const char*>(data), size});
  return 0;
}
