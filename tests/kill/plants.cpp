// SPDX-License-Identifier: Apache-2.0

// Operations that break a promise each: the inspection must find every one of them.
#include <fstream>
#include <utility>

#include "node.hpp"
#include "transport/participant.hpp"

namespace lot::kill {
namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kNobody = 6;  ///< an index that no process of a scene has
constexpr std::uint32_t kFreeBlock = 40;

std::shared_ptr<transport::Participant> participant(Node& n) {
  return transport::Participant::join(n.options);
}

std::vector<Act> scene(std::function<void(Node&)> last) {
  const auto subscribe = [](Node& n) {
    n.puller.emplace(n.engine->subscribe<Number>(kTopic, {Wait::Park, 0}));
    n.reads_topic = true;
  };
  return {{Who::Witness, [](Node& n) { n.join(); }},
          {Who::Victim, [](Node& n) { n.join(); }},
          {Who::Victim,
           [](Node& n) {
             n.pusher.emplace(n.engine->advertise<Number>(kTopic, {Policy::Overwrite, 4, 1s}));
           }},
          {Who::Witness, subscribe},
          {Who::Victim, [](Node& n) { n.publish(2); }},
          {Who::Witness, std::move(last)}};
}

void holds_both_ways(Node& n) {
  n.hold(false);
  n.hold(true);
}

}  // namespace

std::vector<Operation> planted_operations() {
  std::vector<Operation> all;
  const auto plant = [&](
                         const char* name, std::function<void(Node&)> harm,
                         std::function<void(Node&)> last = [](Node&) {}) {
    all.push_back({name, Promise::LockFree, scene(std::move(last)), std::move(harm)});
  };
  plant("a hold of nobody", [](Node& n) {
    participant(n)->block(kFreeBlock).own[0].fetch_or(std::uint64_t{1} << kNobody);
  });
  plant("a block at home with nobody",
        [](Node& n) { participant(n)->block(kFreeBlock).home.store(kNobody + 1); });
  plant("memory of a message that is not there",
        [](Node& n) { participant(n)->segment().granules().claim(0, kFreeBlock + 1); });
  plant("a reader's cell of nobody", [](Node& n) {
    const auto p = participant(n);
    for (std::uint32_t c = 0; c < p->channels(); ++c) {
      const auto ring = p->ring(c);
      if (ring.depth != 0) ring.who[ring.readers - 1].store(kNobody + 1);
    }
  });
  plant("a topic of nobody", [](Node& n) {
    participant(n)->segment().topics()[3].users[0].fetch_or(std::uint64_t{1} << kNobody);
  });
  plant(
      "a held message is written",
      [](Node& n) {
        const auto p = participant(n);
        const auto ring = p->ring(0);
        for (std::uint32_t i = 0; i < ring.depth; ++i) {
          const ring::Word b = ring::block(ring.slots[i].load());
          if (b == ring::kNoBlock) continue;
          *p->segment().small(static_cast<std::uint32_t>(b)) ^= 1;
        }
      },
      holds_both_ways);
  plant("a number is left out", [](Node& n) {
    ++n.published;
    n.publish(1);
  });
  plant("a message comes twice", [](Node& n) {
    n.publish(1);
    --n.published;
    n.publish(1);
  });
  plant("a message is taken back", [](Node& n) {
    n.publish(1);
    auto& slot = participant(n)->ring(0).slots[2];
    slot.store(ring::make(ring::sequence(slot.load()) - 4, ring::kNoBlock));
    n.publish(1);
  });
  plant("memory of nobody is written", [](Node& n) {
    auto& segment = participant(n)->segment();
    segment.base()[segment.size() - 1] ^= 1;
  });
  plant("a lock that nobody will open", [](Node& n) {
    auto& mutex = participant(n)->segment().directory().lock.mutex;
    mutex.__data.__lock = 1;  // the first process of the system
  });
  plant("a file is left", [](Node& n) {
    std::ofstream(n.options.directory + "/" + n.options.segment + ".left") << "x";
  });
  return all;
}

}  // namespace lot::kill
