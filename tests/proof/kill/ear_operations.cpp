// SPDX-License-Identifier: Apache-2.0

// Wait sets and descriptors that listen by ears (docs/ear.md): the listener is killed, and the
// ringer.
#include <string>
#include <utility>

#include "acts.hpp"

namespace lot::kill {
namespace {

/// It waits by a set that listens by an ear: a topic without publishers gives it words enough.
void listens(Node& n) { n.listen(); }
void runs_once(Node& n) { n.set->run_once(10s); }
void looks(Node& n) { n.set->run_once(0s); }
void descriptor(Node& n) { (void)n.puller->fd(); }

}  // namespace

void ears(std::vector<Operation>& all, QueueEngine engine) {
  const auto add = [&](const std::string& name, const Acts& before, std::function<void(Node&)> run,
                       std::function<void(Node&)> when_asleep = {}) {
    all.push_back(
        {named(name, engine), Promise::Blocking, before, std::move(run), std::move(when_asleep)});
  };
  const auto publish_one = [](Node& n) { n.publish(1); };

  // The victim listens.
  const Acts reads = victim_reads(overwrite(2, engine), 0);
  add("set: listens, and looks at nothing", reads, [](Node& n) {
    n.listen();
    looks(n);
  });
  add("set: sleeps and is woken", reads + Acts{victim(listens), victim(looks)}, runs_once,
      publish_one);
  add("set: a message is there",
      reads + Acts{victim(listens), victim(looks)} + Acts{publishes(witness, 1)}, [](Node& n) {
        runs_once(n);
        looks(n);
      });
  add("set: the publisher has gone",
      reads + Acts{victim(listens), victim(looks), publishes(witness, 1),
                   witness([](Node& n) { n.pusher.reset(); })},
      [](Node& n) {
        runs_once(n);
        looks(n);
      });
  add("set: goes", reads + Acts{victim(listens), victim(looks)}, [](Node& n) { n.set.reset(); });
  add("set: close with everything open", reads + Acts{victim(listens), victim(looks)},
      [](Node& n) { n.leave(); });
  add("fd: the first", reads, descriptor);
  add("fd: nothing to read", reads + Acts{victim(descriptor), publishes(witness, 1)}, [](Node& n) {
    n.receive();
    n.receive();  // finds none, and listens again
  });
  add("fd: goes", reads + Acts{victim(descriptor)}, [](Node& n) { n.puller.reset(); });

  // The victim rings.
  const Acts heard = victim_publishes(overwrite(2, engine), 0) +
                     Acts{witness([](Node& n) { n.listen_until_the_end(); })};
  add("push, a set listens", heard, publish_one);
  add("push twice, a set listens", heard, [](Node& n) { n.publish(2); });
  add("close a ring, a set listens", heard + Acts{publishes(victim, 1)},
      [](Node& n) { n.pusher.reset(); });
  add("advertise, a set listens", heard, [=](Node& n) {
    n.second.emplace(n.engine->advertise<Number>(kTopic, overwrite(2, engine)));
  });
  add("push, a descriptor listens",
      victim_publishes(overwrite(2, engine), 0) + Acts{witness(descriptor)}, publish_one);

  // The victim repairs what a listener has left.
  const Acts three{witness(join), victim(join), dead(join),
                   publisher(witness, overwrite(2, engine), kOther), reader(dead, kOther)};
  add("reap, a dead set", three + Acts{dead(listens), dead(looks), publishes(witness, 1)},
      [](Node& n) { n.reap(); });
  add("reap, a dead descriptor", three + Acts{dead(descriptor), publishes(witness, 1)},
      [](Node& n) { n.reap(); });
}

}  // namespace lot::kill
