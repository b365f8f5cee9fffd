// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "node.hpp"

/// What scenes are made of.
namespace lot::kill {

using namespace std::chrono_literals;

inline PusherOptions overwrite(std::uint32_t depth, QueueEngine engine = QueueEngine::Ring) {
  return {Policy::Overwrite, depth, 10s, engine};
}
inline PusherOptions block(std::uint32_t depth, QueueEngine engine = QueueEngine::Ring) {
  return {Policy::Block, depth, 10s, engine};
}
inline PullerOptions parked(std::uint64_t history = 0) { return {Wait::Park, history}; }

inline Act victim(std::function<void(Node&)> act) { return {Who::Victim, std::move(act)}; }
inline Act witness(std::function<void(Node&)> act) { return {Who::Witness, std::move(act)}; }
inline Act bystander(std::function<void(Node&)> act) { return {Who::Bystander, std::move(act)}; }
inline Act dead(std::function<void(Node&)> act) { return {Who::Dead, std::move(act)}; }
inline Act rival(std::function<void(Node&)> act) { return {Who::Rival, std::move(act)}; }

inline void join(Node& n) { n.join(); }

/// Joined, and publishing on its topic.
inline Act publisher(Act (*who)(std::function<void(Node&)>), const PusherOptions& options,
                     const char* topic) {
  return who([=](Node& n) {
    n.pusher.emplace(n.engine->advertise<Number>(topic, options));
    n.blocking = options.policy == Policy::Block;
    n.locked = options.engine == QueueEngine::Mutex;
  });
}
inline Act reader(Act (*who)(std::function<void(Node&)>), const char* topic,
                  std::uint64_t history = 0) {
  return who([=](Node& n) {
    n.puller.emplace(n.engine->subscribe<Number>(topic, parked(history)));
    n.reads_topic = std::string_view(topic) == kTopic;
  });
}
inline void read_frames(Node& n) { n.frame_puller.emplace(n.engine->subscribe<Frame>(kFrames)); }
inline Act publishes(Act (*who)(std::function<void(Node&)>), unsigned count) {
  return who([=](Node& n) { n.publish(count); });
}

using Acts = std::vector<Act>;
inline Acts operator+(Acts a, const Acts& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

/// The victim publishes, the witness reads.
inline Acts victim_publishes(const PusherOptions& options, unsigned count) {
  return {witness(join),
          victim(join),
          publisher(victim, options, kTopic),
          reader(witness, kTopic),
          witness([=](Node& n) { n.locked = options.engine == QueueEngine::Mutex; }),
          publishes(victim, count)};
}
/// The witness publishes, the victim reads.
inline Acts victim_reads(const PusherOptions& options, unsigned count) {
  return {witness(join), victim(join), publisher(witness, options, kOther), reader(victim, kOther),
          publishes(witness, count)};
}

/// The same, but the victim had subscribed before, and has not looked since.
inline Acts victim_is_awaited(const PusherOptions& options, unsigned count) {
  return {witness(join), victim(join), reader(victim, kOther), publisher(witness, options, kOther),
          publishes(witness, count)};
}

inline void loan_one(Node& n) {
  n.loans.push_back(n.pusher->loan(numbered(n.source, n.published)));
}
inline void push_loan(Node& n) {
  if (n.pusher->push(std::move(n.loans.back()), 10s) == Status::Ok) ++n.published;
  n.loans.pop_back();
}

/// What promises not to wait does so with the ring; the mutex engine's steps wait for a lock.
inline Pledge under(QueueEngine engine, const Pledge& pledge) {
  return engine == QueueEngine::Ring ? pledge : Pledge(Promise::Blocking);
}
inline std::string named(const std::string& name, QueueEngine engine) {
  return engine == QueueEngine::Ring ? name : "mutex: " + name;
}

}  // namespace lot::kill
