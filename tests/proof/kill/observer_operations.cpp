// SPDX-License-Identifier: Apache-2.0

// Observers, and what topics carry: descriptions of types, and topics that get another type.
#include <cerrno>
#include <cstdlib>
#include <string>

#include "acts.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "transport/participant.hpp"
#include "types.hpp"

namespace lot::kill {
namespace {

/// It looks on.
Act observer(Act (*who)(std::function<void(Node&)>), const char* topic, std::uint64_t history = 0) {
  return who([=](Node& n) { n.observe(topic, history); });
}

/// There is room, whatever observers do.
void push_at_once(Node& n) {
  if (n.pusher->try_push(std::move(n.loans.back())) != Status::Ok) std::abort();
  n.loans.pop_back();
  ++n.published;
}

/// What it does is refused, as the topic carries another type.
template <class F>
std::function<void(Node&)> refused(F&& f) {
  return [f](Node& n) {
    try {
      f(n);
    } catch (const Error& e) {
      if (e.error_number() == EPROTOTYPE) return;
      throw;
    }
    testing::must(false, "another type is refused");
  };
}

void advertise(Node& n) {
  n.pusher.emplace(n.engine->advertise<Number>(kTopic, overwrite(2)));
  n.publish(2);
}
void advertise_frames(Node& n) {
  n.frames.emplace(n.engine->advertise<Frame>(kTopic, overwrite(2)));
  testing::must_go(n.frames->push(n.frames->loan()));
}
Act advertises_other(Act (*who)(std::function<void(Node&)>), const detail::MessageType& type) {
  return who([&type](Node& n) {
    n.other = detail::make_pusher(transport::Participant::join(n.options), kTopic, type,
                                  overwrite(2), detail::Delivery::ToAll);
  });
}
Act subscribes_nameless(Act (*who)(std::function<void(Node&)>)) {
  return who([](Node& n) {
    n.nameless = detail::make_puller(transport::Participant::join(n.options), kTopic,
                                     nameless_number(), parked(), detail::Delivery::ToAll);
  });
}

}  // namespace

void observers(std::vector<Operation>& all, const Way& way) {
  const auto add = [&](const std::string& name, const Pledge& pledge, const Acts& before,
                       std::function<void(Node&)> run,
                       std::function<void(Node&)> when_asleep = {}) {
    all.push_back(
        {named(name, way), under(way, pledge), before, std::move(run), std::move(when_asleep)});
  };
  const auto publish_one = [](Node& n) { n.publish(1); };
  const auto look = [](Node& n) { n.receive(); };

  // The witness publishes without loss, and reads that itself. The victim looks on.
  const Acts both{witness(join), victim(join)};
  const Acts lossless{publisher(witness, block(2, way), kOther),
                      witness([](Node& n) { n.hear(kOther); })};
  const auto observed = [&](unsigned count) {
    return both + lossless + Acts{observer(victim, kOther), publishes(witness, count)};
  };
  const Pledge looking{Promise::LockFree, "look on, block"};
  add("observe, block", Promise::Blocking, both + lossless + Acts{publishes(witness, 3)},
      [](Node& n) { n.observe(kOther, 2); });
  add("observer: borrow and end", looking, observed(1), look);
  add("observer: borrow and end, lapped", looking, observed(7), [](Node& n) { n.receive_all(); });
  add("observer: pull and keep", looking, observed(2), [](Node& n) { n.hold(false); });
  add(
      "observer: pull sleeps and is woken", Promise::Blocking, observed(0),
      [](Node& n) { n.kept.push_back(n.puller->pull(10s)); }, publish_one);
  add("observer: a new publisher has come", looking,
      both + Acts{observer(victim, kOther)} + lossless + Acts{publishes(witness, 1)}, look);
  add("observer: the publisher has gone", looking,
      both + Acts{observer(victim, kOther), publisher(witness, block(2, way), kOther),
                  victim([](Node& n) { n.receive(); }), publishes(witness, 1),
                  witness([](Node& n) { n.pusher.reset(); })},
      [](Node& n) {
        n.receive_all();
        (void)n.puller->try_borrow();  // finds none
      });
  add("unsubscribe, an observer", Promise::Blocking, observed(3),
      [](Node& n) { n.puller.reset(); });
  add("unsubscribe, an observer keeps", Promise::Blocking,
      observed(1) + Acts{victim([](Node& n) { n.hold(false); }), publishes(witness, 3)},
      [](Node& n) { n.puller.reset(); });
  add("unsubscribe, an observer that has not looked", Promise::Blocking,
      both + Acts{observer(victim, kOther)} + lossless + Acts{publishes(witness, 1)},
      [](Node& n) { n.puller.reset(); });
  add("reap, a dead observer", {Promise::LockFree, "look for the dead"},
      both + lossless +
          Acts{dead(join), observer(dead, kOther), publishes(witness, 2),
               dead([](Node& n) { n.hold(false); }), publishes(witness, 1),
               dead([](Node& n) { n.hold(true); })},
      [](Node& n) { n.reap(); });

  // The victim publishes without loss, and the witness has read all. The bystander looks on, and
  // stands still.
  const auto looked_on = [&](const PusherOptions& options, const Acts& looks) {
    return both +
           Acts{bystander(join),
                publisher(victim, options, kTopic),
                reader(witness, kTopic),
                witness([=](Node& n) { n.locked = way.engine == QueueEngine::Mutex; }),
                observer(bystander, kTopic),
                publishes(victim, 2)} +
           looks + Acts{witness([](Node& n) { n.receive_all(); }), victim(loan_one)};
  };
  const Pledge pushing{Promise::LockFree, "push beside an observer, block"};
  add("push, block, an observer has not looked", pushing, looked_on(block(2, way), {}),
      push_at_once);
  add("push, block, an observer borrows", pushing,
      looked_on(block(2, way), {bystander([](Node& n) { n.hold(true); })}), push_at_once);
  add("push, block, an observer keeps", pushing,
      looked_on(block(2, way), {bystander([](Node& n) { n.hold(false); })}), push_at_once);
  add("push, block, an observer sleeps", pushing,
      looked_on(block(2, way), {bystander([](Node& n) { n.receive_all(); }),
                                bystander([](Node& n) { n.sleep_on_topic(); })}),
      push_at_once);
  add("push, block, an observer has died", pushing,
      victim_publishes(block(2, way), 0) +
          Acts{dead(join), observer(dead, kTopic), publishes(victim, 2),
               dead([](Node& n) { n.hold(true); }), witness([](Node& n) { n.receive_all(); }),
               victim(loan_one)},
      push_at_once);
  PusherOptions short_history = block(4, way);
  short_history.history = 1;
  add("loan, an observer borrows what is taken back",
      {Promise::LockFree, "loan and push, overwrite"},
      looked_on(short_history, {bystander([](Node& n) { n.hold(true); })}), loan_one);
  add("advertise and push, block, an observer waits", Promise::Blocking,
      both + Acts{bystander(join), observer(bystander, kTopic),
                  bystander([](Node& n) { n.reads_topic = false; }),  // the ring may end unseen
                  reader(witness, kTopic),
                  witness([=](Node& n) { n.locked = way.engine == QueueEngine::Mutex; })},
      [=](Node& n) {
        n.pusher.emplace(n.engine->advertise<Number>(kTopic, block(2, way)));
        n.publish(2);
      });
}

void types(std::vector<Operation>& all) {
  const auto add = [&](const std::string& name, const Acts& before, std::function<void(Node&)> run,
                       std::uint32_t topics = 10) {
    Operation operation{name, Promise::Blocking, before, std::move(run)};
    operation.topics = topics;
    all.push_back(std::move(operation));
  };
  const Acts both{witness(join), victim(join)};

  // Programs that know names, and programs that do not.
  const Acts no_names = both + Acts{subscribes_nameless(witness)};
  const Acts names = both + Acts{reader(witness, kTopic)};
  add("advertise, the topic has no names", no_names, advertise);
  add("advertise other names, the topic has none", no_names,
      advertises_other(victim, renamed_number()).act);
  add("advertise without names, the topic has none", no_names,
      advertises_other(victim, nameless_number()).act);
  add("advertise without names, the topic has them", names,
      advertises_other(victim, nameless_number()).act);
  add("advertise without names, a new topic", both,
      advertises_other(victim, nameless_number()).act);
  add("advertise other names, refused", names,
      refused(advertises_other(victim, renamed_number()).act));
  add("advertise another type, refused", names, refused(advertise_frames));
  add("observe another type, refused",
      both + Acts{witness([](Node& n) {
        n.frames.emplace(n.engine->advertise<Frame>(kFrames, overwrite(2)));
      })},
      refused([](Node& n) { n.observe(kFrames); }));
  add("ask what a topic carries", names,
      [](Node& n) { testing::must(n.look_up(kTopic).has_value(), "the topic has a description"); });
  add("advertise, another topic has the same type",
      both + Acts{publisher(witness, overwrite(2), kOther)}, advertise);

  // Only observers are left of a topic.
  const auto retypes = [](Node& n) { n.retypes = true; };
  const Acts deserted = both + Acts{victim(advertise),
                                    observer(witness, kTopic, 2),
                                    witness([](Node& n) { n.receive_all(); }),
                                    witness([](Node& n) { n.reads_topic = false; }),
                                    witness(retypes),
                                    victim([](Node& n) { n.pusher.reset(); })};
  add("advertise another type, an observer is left", deserted, advertise_frames);
  add("advertise the same type, an observer is left", deserted, [](Node& n) {
    advertise(n);
    n.pusher.reset();
  });
  add("advertise another type, a killed observer is left",
      both + Acts{dead(join), observer(dead, kTopic), witness(retypes)}, advertise_frames);
  add("observe, a new topic", both + Acts{witness(retypes)}, [](Node& n) { n.observe(kTopic); });
  add("observe another type, observers are left", deserted,
      [](Node& n) { n.frame_puller.emplace(n.engine->subscribe<Frame>(kTopic, observing())); });
  add("unsubscribe, the last observer", both + Acts{observer(victim, kTopic), witness(retypes)},
      [](Node& n) { n.puller.reset(); });
  const Acts superseded = both + Acts{witness(advertise), observer(victim, kTopic, 2),
                                      witness([](Node& n) { n.pusher.reset(); }),
                                      witness(advertise_frames), witness(retypes)};
  add("observer: the topic has another type", superseded, [](Node& n) {
    testing::must(n.is_superseded(), "an observer learns of the type");
    n.frame_puller.emplace(n.engine->subscribe<Frame>(kTopic, observing()));
  });

  // The table of descriptions is full.
  constexpr std::uint32_t kTopics = kHalves + 10;
  add("advertise, the table of descriptions is full",
      both + Acts{witness([](Node& n) { n.enter_halves(0, kHalves); })}, advertise, kTopics);
  add("advertise, the table of descriptions has little room",
      both + Acts{witness([](Node& n) { n.enter_halves(1, kHalves); })}, advertise, kTopics);
  add(
      "leave a topic, the table of descriptions was full",
      both + Acts{witness([](Node& n) { n.enter_halves(1, kHalves); }),
                  victim([](Node& n) { n.enter_halves(0, 1); })},
      [](Node& n) {
        transport::Participant::join(n.options)->topics().leave(n.fillers.back());
        n.fillers.clear();
      },
      kTopics);
}

}  // namespace lot::kill
