// SPDX-License-Identifier: Apache-2.0

// What a neighbour can do while another process stands still anywhere.
#include "node.hpp"
#include "transport/participant.hpp"

namespace lot::kill {
namespace {

using namespace std::chrono_literals;

void read_all(Node& n) {
  if (n.puller && !n.sleeper.joinable() && !n.borrow) n.receive_all();
}
void read_own(Node& n) {
  while (n.probe_puller->try_borrow()) {
  }
}
void publish_own(Node& n) { n.probe_pusher->push(n.probe_pusher->loan(numbered(7, 0))); }
/// To the victim, if it reads here.
void publish_other(Node& n) {
  if (!n.pusher) return;
  auto message = n.pusher->loan(numbered(n.source, n.published));
  if (n.pusher->try_push(std::move(message)) == Status::Ok) ++n.published;
}
void keep_and_drop(Node& n) {
  auto kept = n.probe_puller->try_pull();
  auto copy = kept;
  const ShmWeakPtr<const Number> weak = kept;
  kept.reset();
  kept = weak.lock();
}
void grow(Node& n) {
  auto frame = n.probe_frames->loan();
  frame->data.resize(3000);
}
void make_and_share(Node& n) {
  ShmSharedPtr<Number> own = n.engine->make<Number>(numbered(7, 0));
  const auto copy = own;
  own.reset();
}
void publish_again(Node& n) {
  publish_own(n);
  if (const auto kept = n.probe_puller->try_pull()) n.probe_again->push(kept);
}
void refer(Node& n) {
  publish_own(n);
  auto frame = n.probe_frames->loan();
  frame->reference = n.probe_puller->try_pull();
  n.probe_frames->push(std::move(frame));
}
void collect(Node& n) { transport::Participant::join(n.options)->collect(); }
void look_for_the_dead(Node& n) { transport::Participant::join(n.options)->reap_dead(); }

void subscribe(Node& n) { const auto puller = n.engine->subscribe<Number>(kOther); }
void advertise(Node& n) { const auto pusher = n.engine->advertise<Number>("/short-lived"); }

}  // namespace

const std::vector<Probe>& all_probes() {
  static const std::vector<Probe> probes = {
      {"read what the victim published", Promise::LockFree, read_all},
      {"loan and push, overwrite", Promise::LockFree, publish_own},
      {"publish to the victim", Promise::LockFree, publish_other},
      {"pull, copy, weak lock, drop", Promise::LockFree, keep_and_drop},
      {"borrow", Promise::LockFree, read_own},
      {"grow a message", Promise::LockFree, grow},
      {"make, share, copy, drop", Promise::LockFree, make_and_share},
      {"publish again what was received", Promise::LockFree, publish_again},
      {"publish a message that refers", Promise::LockFree, refer},
      {"collect what nobody needs", Promise::LockFree, collect},
      {"look for the dead", Promise::LockFree, look_for_the_dead},
      {"subscribe, unsubscribe", Promise::Blocking, subscribe},
      {"advertise, unadvertise", Promise::Blocking, advertise},
  };
  return probes;
}

}  // namespace lot::kill
