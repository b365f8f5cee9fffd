// SPDX-License-Identifier: Apache-2.0

// What only messages have that travel in the slots of their ring (docs/fast-lane.md): each step of
// the publisher's and the reader's copy, and what a process does that has no block for a copy.
#include <cstdlib>
#include <string>

#include "acts.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"

namespace lot::kill {
namespace {

const Acts kBoth{witness(join), victim(join)};
const Pledge kPushes{Promise::LockFree, "slots: loan, push and borrow"};

PusherOptions stamped(PusherOptions options) {
  options.stamp = true;
  return options;
}

/// A third reader stands still, or has died, where it copies the newest message. The victim then
/// writes over it.
void copying_readers(std::vector<Operation>& all) {
  const Acts copying{witness(join),
                     victim(join),
                     rival(join),
                     publisher(victim, overwrite(1, kSlots), kTopic),
                     reader(witness, kTopic),
                     reader(rival, kTopic),
                     publishes(victim, 1)};
  const auto add = [&](const char* name, Rival how) {
    all.push_back(
        {named(name, kSlots), kPushes, copying, [](Node& n) { n.publish(3); }, {}, false, how});
  };
  add("loan and push, a reader stands still in its copy", Rival::Halfway);
  add("loan and push, a reader stands still behind its copy", Rival::Stopped);
  add("loan and push, a reader has died behind its copy", Rival::Killed);
}

/// The victim reads, and has all blocks.
void without_blocks(std::vector<Operation>& all) {
  const Acts has_all =
      kBoth + Acts{publisher(witness, overwrite(4, kSlots), kOther), reader(victim, kOther),
                   publishes(witness, 3), victim([](Node& n) {
                     n.second.emplace(n.engine->advertise<Number>("/own", overwrite(2)));
                     while (auto loan = n.second->try_loan(Number{})) {
                       n.loans.push_back(std::move(loan));
                     }
                   })};
  all.push_back({named("pull, no block is left", kSlots), Promise::Blocking, has_all, [](Node& n) {
                   testing::must(!n.puller->try_pull(), "no pull without a block");
                   testing::must(n.puller->status() == Status::HoldsTooMuch, "it says why");
                 }});
  all.push_back({named("borrow, no block is left", kSlots), kPushes, has_all,
                 [](Node& n) { testing::must(n.receive(), "a borrow needs no block"); }});
  for (auto operation = all.end() - 2; operation != all.end(); ++operation) {
    operation->leaves_blocks = false;
  }
}

void ends(std::vector<Operation>& all) {
  all.push_back({named("close with everything open", kSlots), Promise::Blocking,
                 victim_publishes(overwrite(2, kSlots), 3) + Acts{victim(loan_one)},
                 [](Node& n) { n.leave(); }});
  all.push_back({named("open, killed ones have left it", kSlots),
                 Promise::Blocking,
                 {dead(join), publisher(dead, overwrite(2, kSlots), kTopic), reader(dead, kTopic),
                  publishes(dead, 3), dead(loan_one), dead([](Node& n) { n.hold(true); })},
                 join,
                 {},
                 true});
  all.push_back({named("unadvertise, messages unread", kSlots), Promise::Blocking,
                 victim_publishes(overwrite(3, kSlots), 2), [](Node& n) { n.pusher.reset(); }});
  all.push_back(
      {named("unadvertise, a reader borrows and keeps", kSlots), Promise::Blocking,
       victim_publishes(overwrite(2, kSlots), 2) +
           Acts{witness([](Node& n) { n.hold(false); }), witness([](Node& n) { n.hold(true); })},
       [](Node& n) { n.pusher.reset(); }});
}

}  // namespace

void slots(std::vector<Operation>& all) {
  const PusherOptions stamps = stamped(overwrite(2, kSlots));
  all.push_back({named("push, overwrite, stamped", kSlots),
                 {Promise::WaitFree, "slots: push, overwrite"},
                 victim_publishes(stamps, 4) + Acts{victim(loan_one)},
                 push_loan});
  all.push_back({named("pull and let go, stamped", kSlots),
                 {Promise::LockFree, "slots: keep, pull, drop"},
                 victim_reads(stamps, 2),
                 [](Node& n) {
                   testing::must(n.puller->try_pull() && n.puller->envelope().pushed.has_value(),
                                 "a message has its time");
                 }});
  // The caller keeps its message: what is pushed is a copy.
  all.push_back({named("push what is shared, twice", kSlots), kPushes,
                 victim_publishes(overwrite(1, kSlots), 2) + Acts{victim(loan_one)}, [](Node& n) {
                   n.own = ShmSharedPtr<Number>(std::move(n.loans.back()));
                   n.loans.clear();
                   testing::must_go(n.pusher->push(n.own));
                   n.own->number = ++n.published;
                   n.own->check = numbered(n.source, n.published).check;
                   testing::must_go(n.pusher->push(n.own));
                   ++n.published;
                   n.own.reset();
                 }});
  for (const bool blocking : {false, true}) {
    const PusherOptions options = blocking ? block(2, kSlots) : overwrite(2, kSlots);
    const char* const policy = blocking ? ", block" : ", overwrite";
    all.push_back({named(std::string("subscribe, history") + policy, kSlots), Promise::Blocking,
                   kBoth + Acts{publisher(witness, options, kOther), publishes(witness, 3)},
                   [](Node& n) {
                     n.puller.emplace(n.engine->subscribe<Number>(kOther, parked(2)));
                     n.receive_all();
                   }});
  }
  copying_readers(all);
  without_blocks(all);
  ends(all);
}

}  // namespace lot::kill
