// SPDX-License-Identifier: Apache-2.0
#include "plan.hpp"

#include <algorithm>
#include <array>
#include <initializer_list>

namespace lot::chaos {

using namespace std::chrono_literals;

Part part_of(unsigned slot) {
  // Relays and their sources first, so that a small run has them too. One relay for each relayed
  // topic: then a message is never in two rings of it.
  static constexpr std::array<Part, 46> parts{{
      {Role::Publish, 0, kCount},
      {Role::Read, 0, 0},
      {Role::Publish, 0, kCamera},
      {Role::Sleep, 0, 0},
      {Role::Relay, kCamera, kCameraRelay},
      {Role::Publish, 0, kLossless},
      {Role::Read, 0, 0},
      {Role::Publish, 0, kPoints},
      {Role::Annotate, kCamera, kSeen},
      {Role::Read, 0, 0},
      {Role::Put, kJobs, kJobs},
      {Role::Take, 0, 0},
      {Role::Publish, 0, kRefuse},
      {Role::Juggle, 0, kMixed},
      {Role::Sleep, 0, 0},
      {Role::Put, kJobs, kDone},
      {Role::Relay, kPoints, kPointsRelay},
      {Role::Publish, 0, kMixed},
      {Role::Read, 0, 0},
      {Role::Relay, kSeen, kSeenRelay},
      {Role::Relay, kCameraRelay, kSecondRelay},
      {Role::Take, 0, 0},
      {Role::Put, kParcels, kParcels},
      {Role::Publish, 0, kLossless},
      {Role::Read, 0, 0},
      {Role::Juggle, 0, kLossless},
      {Role::Observe, 0, 0},
      {Role::Publish, 0, kCount},
      {Role::Juggle, 0, kCount},
      {Role::Sleep, 0, 0},
      {Role::Publish, 0, kCamera},
      {Role::Annotate, kPoints, kSeen},
      {Role::Put, kJobs, kDone},
      {Role::Read, 0, 0},
      {Role::Publish, 0, kMixed},
      {Role::Juggle, 0, kRefuse},
      {Role::Publish, 0, kPoints},
      {Role::Read, 0, 0},
      {Role::Put, kTasks, kTasks},
      {Role::Finish, 0, 0},
      {Role::Put, kErrands, kErrands},
      {Role::Finish, 0, 0},
      {Role::Retype, 0, 0},
      {Role::Retype, 0, 0},
      {Role::Retype, 0, 0},
      {Role::Retype, 0, 0},
  }};
  return slot < parts.size() ? parts[slot] : Part{Role::Read, 0, 0};
}

namespace {

/// Something that a node of this role does, and is to be killed over.
Doing aim_at(Role role, Random& random) {
  const auto one_of = [&random](std::initializer_list<Doing> some) {
    return some.begin()[random.below(some.size())];
  };
  using enum Doing;
  switch (role) {
    case Role::Publish:
    case Role::Put:
      return one_of({Advertising, Loaning, Filling, Pushing, Pushing});
    case Role::Read:
    case Role::Observe:
    case Role::Take:
    case Role::Sleep:
      return one_of({Subscribing, Looking, Reading, Reading, Closing});
    case Role::Finish:
      return one_of({Looking, Reading, Reading, Finishing, Finishing});
    case Role::Retype:
      return one_of({Advertising, Advertising, Subscribing, Subscribing, Closing});
    case Role::Juggle:
      return one_of({Opening, Advertising, Subscribing, Loaning, Pushing, Closing, Closing});
    default:
      return one_of({Advertising, Subscribing, Looking, Reading, Pushing, Pushing});
  }
}

}  // namespace

Fate fate_of(std::uint64_t seed, unsigned slot, std::uint32_t life, bool spared) {
  Random random = Random::of(seed, slot, life, 2);
  Fate fate{};
  const std::uint64_t kind = random.below(100);
  if (kind < 45) {
    fate.end = Fate::End::Kill;
    fate.at = random.between(0ns, kFirstMoments);
    fate.stopped = fate.killed_while_stopped = random.chance(12);
    fate.stop_at = fate.at;
    fate.stop_for = random.between(1ms, 30ms);
  } else if (kind < 92) {
    fate.end = Fate::End::Kill;
    fate.at = random.between(kFirstMoments, 2600ms);
    fate.stopped = random.chance(35);
    fate.killed_while_stopped = random.chance(40);
    fate.stop_at = fate.killed_while_stopped ? fate.at : random.between(0ns, fate.at);
    fate.stop_for = random.chance(5) ? random.between(100ms, 400ms) : random.between(1ms, 60ms);
    if (!fate.killed_while_stopped && random.chance(60)) {
      fate.aim = aim_at(part_of(slot).role, random);
      // What comes once, at the beginning, is aimed at then.
      if (fate.aim <= Doing::Subscribing && random.chance(70)) fate.at = random.between(3ms, 60ms);
    }
  } else {
    fate.end = Fate::End::Leave;
    fate.at = random.between(0ns, 2s);
    fate.killed_while_leaving = random.chance(40);
    fate.leave_for = random.between(0ns, 25ms);
  }
  if (part_of(slot).role == Role::Sleep && fate.at > kFirstMoments) {
    fate.at = random.between(5s, 30s);  // long enough to sleep too long
    fate.aim.reset();
  }
  if (spared) {
    fate.end = Fate::End::Spared;
    fate.killed_while_stopped = false;
  }
  return fate;
}

EpochPlan epoch_plan(const Settings& settings, std::uint64_t epoch) {
  Random random = Random::of(settings.seed, epoch, 3);
  EpochPlan plan{};
  // A long one, then short ones: each of them begins with everybody opening the segment at once.
  const bool is_long = epoch % 5 == 0;
  plan.calms = is_long ? 2 : 0;
  plan.kills = is_long ? 2 * settings.checkpoint : 20 + static_cast<unsigned>(random.below(60));
  if (is_long) {
    for (unsigned n = 0; n < 3; ++n) plan.spared.push_back(random.pick(settings.processes));
  }
  using End = EpochPlan::End;
  plan.end = std::array{End::KillAll, End::LeaveAll, End::Mixed, End::Witnessed,
                        End::KillAndGoOn}[random.below(5)];
  plan.roomy = random.chance(60);
  plan.size_bytes = plan.roomy ? 384 << 20 : (8 + 2 * random.below(5)) << 20;
  plan.blocks = plan.roomy ? 8192U : 256U << random.below(3);
  // The more indexes, the more words of ownership bits are in use.
  plan.processes =
      std::max<std::uint32_t>(settings.processes + 8, std::array{64U, 128U, 319U}[random.below(3)]);
  return plan;
}

Publishing publishing(Random& random, std::uint32_t topic) {
  const Topic& t = kTopic[topic];
  Publishing plan{};
  plan.engine = random.chance(50) ? QueueEngine::Ring : QueueEngine::Mutex;
  plan.depth = t.depths[random.below(t.depths.size())];
  plan.history =
      random.chance(50) ? PusherOptions::kAll : static_cast<std::uint32_t>(random.below(3));
  const bool block =
      t.queueing == Queueing::Block || (t.queueing == Queueing::Either && random.chance(50));
  plan.policy = block ? Policy::Block : Policy::Overwrite;
  plan.block_for = random.chance(10) ? 500ms : random.between(1ms, 30ms);
  plan.refuses = topic == kRefuse || (is_put(topic) && random.chance(30));
  if (plan.refuses && random.chance(50)) plan.policy = Policy::Refuse;
  plan.reserved = random.chance(20) ? 1 + random.below(4) : 0;
  plan.max_bytes = random.chance(20) ? (64 + random.below(1024)) << 10 : 0;
  plan.in_slots = random.chance(50);
  return plan;
}

PusherOptions pusher_options(const Publishing& plan) {
  PusherOptions options{plan.policy, plan.depth, plan.block_for, plan.engine, 0, plan.history};
  options.max_bytes = plan.max_bytes;
  options.fast_lane = plan.in_slots;
  return options;
}

Reading reading(Random& random, Role role) {
  using Style = Reading::Style;
  Reading plan{};
  plan.style =
      std::array{Style::Borrow, Style::TryBorrow, Style::Pull, Style::TryPull}[random.below(4)];
  plan.options.wait =
      std::array{Wait::Park, Wait::Park, Wait::Adaptive, Wait::Spin}[random.below(4)];
  plan.options.max_held_bytes = PullerOptions::kNoQuota;
  if ((role == Role::Read || role == Role::Sleep) && random.chance(40)) {
    plan.options.max_held_bytes = (1 + random.below(64)) << 10;
  }
  plan.options.observer =
      role == Role::Observe || ((role == Role::Read || role == Role::Sleep) && random.chance(20));
  plan.patience = plan.options.wait == Wait::Spin ? 200us : random.between(500us, 5ms);
  if (role != Role::Relay) {  // which reads what comes, so that it never relays a message twice
    plan.options.history = std::array<std::uint64_t, 5>{0, 0, 1, 3, 1000}[random.below(5)];
    plan.rejoin_percent = random.chance(30) ? 2 : 0;
  }
  if (role == Role::Sleep) {
    plan.sleeps_long = true;
    plan.style = random.chance(50) ? Style::Borrow : Style::Pull;
    plan.options.wait = random.chance(70) ? Wait::Park : Wait::Adaptive;
  }
  plan.keep_percent = std::array{0U, 20U, 100U}[random.below(3)];
  plan.most_kept = static_cast<unsigned>(random.below(6));
  plan.weak_percent = random.chance(30) ? 30 : 0;
  plan.linger_percent = random.chance(30) ? 10 : 1;
  // Some outlast their publisher and its reaping.
  plan.longest_linger = random.chance(20) ? 800ms : 3ms;
  return plan;
}

std::uint64_t frame_words(Random& random) {
  const std::uint64_t kind = random.below(1000);
  if (kind < 900) return random.below(700);
  if (kind < 995) return random.below(1 << 14);
  return random.below(1 << 19);
}

}  // namespace lot::chaos
