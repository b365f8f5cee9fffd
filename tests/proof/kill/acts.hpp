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

/// How a scene's queue works, and where its messages travel.
struct Way {
  Way(QueueEngine e, bool s = false) : engine(e), in_slots(s) {}
  QueueEngine engine;
  bool in_slots;  ///< in their slots, else in blocks
};
inline const Way kRing{QueueEngine::Ring};
inline const Way kSlots{QueueEngine::Ring, true};

inline PusherOptions pushing(Policy policy, std::uint32_t depth, const Way& way) {
  PusherOptions options{policy, depth, 10s, way.engine};
  options.fast_lane = way.in_slots;
  return options;
}
inline PusherOptions overwrite(std::uint32_t depth, const Way& way = kRing) {
  return pushing(Policy::Overwrite, depth, way);
}
inline PusherOptions block(std::uint32_t depth, const Way& way = kRing) {
  return pushing(Policy::Block, depth, way);
}
inline QueueOptions queueing(std::uint32_t depth, Policy policy, const Way& way,
                             bool redeliver = false) {
  return {depth, policy, way.engine, Wait::Park, redeliver, way.in_slots};
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

/// What promises not to wait does so with the ring; the mutex engine's steps wait for a lock. Where
/// messages travel in their slots, a probe shows it that uses such ones.
inline Pledge under(const Way& way, const Pledge& pledge) {
  if (way.engine == QueueEngine::Mutex) return Promise::Blocking;
  return way.in_slots ? Pledge(pledge.promise, shown_in_slots(pledge.shown_by)) : pledge;
}
inline std::string named(const std::string& name, const Way& way) {
  return std::string(way.in_slots ? "slots: " : "") +
         (way.engine == QueueEngine::Mutex ? "mutex: " : "") + name;
}
/// Leaves out those of the operations from `first` on whose name has none of these in it.
void keep_only(std::vector<Operation>& all, std::size_t first,
               const std::vector<std::string>& names);

}  // namespace lot::kill
