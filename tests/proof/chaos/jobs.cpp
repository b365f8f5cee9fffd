// SPDX-License-Identifier: Apache-2.0
#include "jobs.hpp"

#include <array>

#include "finisher.hpp"
#include "juggler.hpp"
#include "publisher.hpp"
#include "relay.hpp"
#include "retyper.hpp"
#include "worker.hpp"

namespace lot::chaos {
namespace {

std::unique_ptr<Job> make_putter(Life& life, ShmEngine& engine, const Part& part) {
  if (part.from != part.to) return std::make_unique<Worker>(life, engine, part.from, part.to);
  if (kTopic[part.to].kind == Kind::Plain) {
    return std::make_unique<Putter<Plain>>(life, engine, part.to);
  }
  return std::make_unique<Putter<Frame>>(life, engine, part.to);
}

std::unique_ptr<Job> make_taker(Life& life, ShmEngine& engine, std::uint32_t topic) {
  if (kTopic[topic].kind == Kind::Plain) {
    return std::make_unique<Taker<Plain>>(life, engine, topic);
  }
  return std::make_unique<Taker<Frame>>(life, engine, topic);
}

std::unique_ptr<Job> make_finisher(Life& life, ShmEngine& engine, std::uint32_t topic) {
  if (kTopic[topic].kind == Kind::Plain) {
    return std::make_unique<Finisher<Plain>>(life, engine, topic);
  }
  return std::make_unique<Finisher<Frame>>(life, engine, topic);
}

std::unique_ptr<Job> make_relay(Life& life, ShmEngine& engine, const Part& part) {
  if (kTopic[part.to].kind == Kind::Seen) {
    return std::make_unique<Relay<Seen>>(life, engine, part.from, part.to);
  }
  return std::make_unique<Relay<Frame>>(life, engine, part.from, part.to);
}

}  // namespace

std::unique_ptr<Job> make_publisher(Life& life, ShmEngine& engine, std::uint32_t topic) {
  if (kTopic[topic].kind == Kind::Plain) {
    return std::make_unique<Publisher<Plain>>(life, engine, topic);
  }
  return std::make_unique<Publisher<Frame>>(life, engine, topic);
}

std::unique_ptr<Job> make_inlet(Life& life, ShmEngine& engine, std::uint32_t topic, Role role) {
  if (has_tasks(topic)) return make_finisher(life, engine, topic);
  if (is_put(topic)) return make_taker(life, engine, topic);
  switch (kTopic[topic].kind) {
    case Kind::Plain:
      return std::make_unique<Inlet<Plain>>(life, engine, topic, role);
    case Kind::Frame:
      return std::make_unique<Inlet<Frame>>(life, engine, topic, role);
    default:
      return std::make_unique<Inlet<Seen>>(life, engine, topic, role);
  }
}

Jobs make_jobs(Life& life, std::optional<ShmEngine>& engine) {
  const Part part = part_of(life.slot);
  Jobs jobs;
  const auto read_some = [&](std::uint64_t n) {
    for (; n > 0; --n) {
      const std::uint32_t topic = life.random.pick(kFirstShape);
      const bool observes = part.role == Role::Observe;
      jobs.push_back(make_inlet(life, *engine, topic, observes ? Role::Observe : Role::Read));
    }
  };
  switch (part.role) {
    case Role::Publish:
      jobs.push_back(make_publisher(life, *engine, part.to));
      if (life.random.chance(20)) read_some(1);
      break;
    case Role::Read:
    case Role::Observe:
      read_some(1 + life.random.below(3));
      break;
    case Role::Sleep:
      // Where a message that did not wake is still there at the end of the sleep.
      jobs.push_back(make_inlet(
          life, *engine,
          std::array{kLossless, kMixed, kRefuse, kPoints, kSeen}[life.random.below(5)], part.role));
      break;
    case Role::Put:
      jobs.push_back(make_putter(life, *engine, part));
      break;
    case Role::Take:
      for (std::uint32_t t = kFirstTaken; t < kFirstTask; ++t) {
        jobs.push_back(make_taker(life, *engine, t));
      }
      break;
    case Role::Finish:
      for (std::uint32_t t = kFirstTask; t < kFirstShape; ++t) {
        jobs.push_back(make_finisher(life, *engine, t));
      }
      break;
    case Role::Relay:
      jobs.push_back(make_relay(life, *engine, part));
      break;
    case Role::Annotate:
      jobs.push_back(std::make_unique<Annotator>(life, *engine, part.from, part.to));
      break;
    case Role::Retype:
      jobs.push_back(std::make_unique<Retyper>(life, *engine));
      break;
    case Role::Juggle:
      engine.reset();
      jobs.push_back(std::make_unique<Juggler>(life, part.to));
      break;
  }
  return jobs;
}

}  // namespace lot::chaos
