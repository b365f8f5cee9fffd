// SPDX-License-Identifier: Apache-2.0

// What a neighbour can do while another process stands still anywhere.
#include <map>
#include <string_view>

#include "node.hpp"
#include "support/must_go.hpp"
#include "transport/participant.hpp"

namespace lot::kill {
namespace {

using namespace std::chrono_literals;

void read_all(Node& n) {
  if (!n.reads_now()) return;
  if (n.retypes) {
    n.is_superseded();
  } else {
    n.receive_all();
  }
}
void read_own(Node& n) {
  while (n.probe_puller->try_borrow()) {
  }
}
void publish_own(Node& n) {
  testing::must_go(n.probe_pusher->push(n.probe_pusher->loan(numbered(7, 0))));
}
void look_on(Node& n) {
  while (n.probe_observer->try_borrow()) {
  }
}
void put_and_pop(Node& n) {
  testing::must_go(n.probe_queue->put(numbered(7, 0)));
  (void)n.probe_queue->try_pop();  // and drops it
}
/// The same with messages in slots.
bool loan_slots(Node& n) {
  n.probe_loan = n.probe_slots->loan(numbered(7, 0));
  return true;
}
void push_slots(Node& n) { testing::must_go(n.probe_slots->push(std::move(n.probe_loan))); }
void publish_slots(Node& n) {
  testing::must_go(n.probe_slots->push(n.probe_slots->loan(numbered(7, 0))));
}
void publish_and_borrow_slots(Node& n) {
  publish_slots(n);
  while (n.probe_slots_puller->try_borrow()) {
  }
}
void keep_slots(Node& n) {
  publish_slots(n);
  if (const auto borrowed = n.probe_slots_puller->try_borrow()) n.probe_kept = borrowed.keep();
  n.probe_kept.reset();
  publish_slots(n);
  n.probe_kept = n.probe_slots_puller->try_pull();
  n.probe_kept.reset();
}
void put_and_pop_slots(Node& n) {
  testing::must_go(n.probe_slots_queue->put(numbered(7, 0)));
  (void)n.probe_slots_queue->try_pop();  // and drops it
}
void pop_item(Node& n) {
  if (n.queue && !n.sleeper.joinable()) n.pop();
}
/// From the victim, if it selects its readers, or to it, if it reads.
void select_and_deselect(Node& n) {
  if (!n.selecting) return;
  if (n.reader) n.selecting->deselect(*n.reader, 1);
  n.reader = n.selecting->select("the victim", 0);
  n.publish();
  if (n.reader) n.selecting->ask(*n.reader);
}
void read_selected(Node& n) {
  if (!n.selected) return;
  n.selected->confirm();
  n.read_selected();
}
/// The victim looks on. What it has not read holds nothing up.
bool is_heard(Node& n) { return n.ear && !n.locked; }
void publish_heard(Node& n) { n.publish(1); }
/// The lock of its queues is nobody's who stands still.
bool unlocked(Node& n) { return !n.locked; }
bool locked(Node& n) { return n.locked && !n.sleeper.joinable(); }
/// To the victim, if it reads here.
void publish_other(Node& n) {
  if (!n.pusher || n.ear) return;  // publish_heard() has that reader
  auto message = n.pusher->loan(numbered(n.source, n.published));
  if (n.pusher->try_push(std::move(message)) == Status::Ok) ++n.published;
}
void read_or_pop(Node& n) {
  if (n.queue) {
    n.pop();
  } else {
    read_all(n);
    publish_other(n);
  }
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
  if (const auto kept = n.probe_puller->try_pull()) testing::must_go(n.probe_again->push(kept));
}
void refer(Node& n) {
  publish_own(n);
  auto frame = n.probe_frames->loan();
  frame->reference = n.probe_puller->try_pull();
  testing::must_go(n.probe_frames->push(std::move(frame)));
}
void collect(Node& n) { transport::Participant::join(n.options)->reaper().collect(); }
void look_for_the_dead(Node& n) { transport::Participant::join(n.options)->reaper().reap_dead(); }

void subscribe(Node& n) { const auto puller = n.engine->subscribe<Number>(kOther); }
void advertise(Node& n) { const auto pusher = n.engine->advertise<Number>("/short-lived"); }

void loan_and_give_back(Node& n) { const auto loan = n.probe_pusher->loan(numbered(7, 0)); }
void reserve(Node& n) { n.probe_pusher->reserve(1, 1000); }

bool take_all_blocks(Node& n) {
  if (n.locked) return false;  // its own queues give their oldest up, under their locks
  const auto participant = transport::Participant::join(n.options);
  const auto free = [&] {
    for (std::uint32_t b = 0; b < participant->blocks(); ++b) {
      if (participant->world().block(b).home.load() == refcount::kHomeFree) return true;
    }
    return false;
  };
  while (free()) n.probe_loans.push_back(n.probe_pusher->loan(Number{}));
  return true;
}
void loan_without_blocks(Node& n) { const auto loan = n.probe_pusher->try_loan(Number{}); }

bool fill_block(Node& n) {
  while (auto loan = n.probe_block->try_loan(numbered(7, 0))) {
    if (n.probe_block->try_push(std::move(loan)) == Status::Full) break;
  }
  n.probe_loan = n.probe_block->try_loan(numbered(7, 0));
  return bool(n.probe_loan);
}
void push_refused(Node& n) {
  if (n.probe_block->try_push(std::move(n.probe_loan)) == Status::Ok) {
    n.account.complain("a push into a full ring");
  }
}

// ---- wait-free: one operation each, made ready before it is counted -----------------------------

bool loan_own(Node& n) {
  n.probe_loan = n.probe_pusher->loan(numbered(7, 0));
  return true;
}
void push_own(Node& n) { testing::must_go(n.probe_pusher->push(std::move(n.probe_loan))); }

bool loan_other(Node& n) {
  if (!n.pusher || n.blocking || n.locked) return false;
  n.probe_loan = n.pusher->loan(numbered(n.source, n.published));
  return true;
}
void push_other(Node& n) {
  if (n.pusher->push(std::move(n.probe_loan)) == Status::Ok) ++n.published;
}

/// The victim's message where there is one.
bool borrow_one(Node& n) {
  if (n.borrow) return true;
  publish_own(n);
  n.probe_borrow = n.probe_puller->try_borrow();
  return bool(n.probe_borrow);
}
void keep(Node& n) { n.probe_kept = (n.borrow ? n.borrow : n.probe_borrow).keep(); }

bool pull_own(Node& n) {
  publish_own(n);
  n.probe_kept = n.probe_puller->try_pull();
  return bool(n.probe_kept);
}
bool hold_one(Node& n) {
  if (n.kept.empty()) return pull_own(n);
  n.probe_kept = n.kept.front();
  return true;
}
void copy(Node& n) { n.probe_copy = n.probe_kept; }
bool copied(Node& n) {
  const bool held = hold_one(n);
  copy(n);
  return held;
}
void drop_copy(Node& n) { n.probe_copy.reset(); }
/// Of a message of the victim, so that our bit goes and not the message.
bool hold_last(Node& n) {
  if (!n.reads_now() || n.locked) return false;
  n.probe_kept = n.puller->try_pull();
  if (n.probe_kept) n.account.enter(*n.probe_kept, n.puller->missed());
  return bool(n.probe_kept);
}
/// The same of a message that the victim would have back.
bool hold_wanted(Node& n) {
  if (n.borrow || n.kept.size() != 1 || !n.home_waits()) return false;  // inspect() needs `held`
  n.probe_kept = std::move(n.kept.front());
  n.kept.clear();
  n.held.reset();
  return true;
}
bool make_one(Node& n) {
  n.probe_kept = ShmSharedPtr<const Number>(n.engine->make<Number>(numbered(7, 0)));
  return true;
}
void drop_last(Node& n) { n.probe_kept.reset(); }

bool look_after(Node& n) {
  const bool held = hold_one(n);
  n.probe_weak = n.probe_kept;
  return held;
}
void lock_weak(Node& n) { n.probe_copy = n.probe_weak.lock(); }
bool look_after_a_dead_one(Node& n) {
  const ShmSharedPtr<Number> made = n.engine->make<Number>(numbered(7, 0));
  n.probe_weak = ShmSharedPtr<const Number>(made);
  return true;
}
void lock_dead(Node& n) {
  if (n.probe_weak.lock()) n.account.complain("a weak pointer to a dead message was locked");
}

/// Long, and again and again: who traces it may be held up for as long as one sleep lasts.
void doze(Node&) {
  for (int i = 0; i < 10; ++i) std::this_thread::sleep_for(10ms);
}
void sleep_long(Node&) { std::this_thread::sleep_for(500ms); }
void grow_often(Node& n) {
  for (int i = 0; i < 20; ++i) grow(n);
}

}  // namespace

const char* shown_in_slots(const char* probe) {
  if (probe == nullptr) return nullptr;
  static const std::map<std::string_view, const char*> probes = {
      {"push, overwrite", "slots: push, overwrite"},
      {"loan and push, overwrite", "slots: loan, push and borrow"},
      {"borrow", "slots: loan, push and borrow"},
      {"drop the last one here", "drop the last one at home"},
      {"pull, copy, weak lock, drop", "slots: keep, pull, drop"},
      {"publish again what was received", "slots: keep, pull, drop"},
      {"put and pop, overwrite", "slots: put and pop, overwrite"}};
  const auto found = probes.find(probe);
  return found != probes.end() ? found->second : probe;
}

const std::vector<Probe>& all_probes() {
  constexpr auto kWaitFree = Promise::WaitFree;
  constexpr auto kLockFree = Promise::LockFree;
  constexpr auto kBlocking = Promise::Blocking;
  static const std::vector<Probe> probes = {
      {"push, overwrite", kWaitFree, push_own, loan_own},
      {"push to the victim, overwrite", kWaitFree, push_other, loan_other},
      {"keep", kWaitFree, keep, borrow_one},
      {"copy", kWaitFree, copy, hold_one},
      {"drop a copy", kWaitFree, drop_copy, copied},
      {"drop the last one here", kWaitFree, drop_last, hold_last},
      {"drop the last one, its home waits", kWaitFree, drop_last, hold_wanted},
      {"drop the last one at home", kWaitFree, drop_last, make_one},
      {"weak lock, alive", kWaitFree, lock_weak, look_after},
      {"weak lock, dead", kWaitFree, lock_dead, look_after_a_dead_one},
      {"read what the victim published", kLockFree, read_all, unlocked},
      {"pop what the victim put", kLockFree, pop_item, unlocked},
      {"put and pop, overwrite", kLockFree, put_and_pop},
      {"loan, give back", kLockFree, loan_and_give_back},
      {"loan and push, overwrite", kLockFree, publish_own},
      {"push, block, full: refused", kLockFree, push_refused, fill_block},
      {"push beside an observer, block", kLockFree, publish_heard, is_heard},
      {"look on, block", kLockFree, look_on, fill_block},
      {"publish to the victim", kLockFree, publish_other, unlocked},
      {"pull, copy, weak lock, drop", kLockFree, keep_and_drop},
      {"borrow", kLockFree, read_own},
      {"grow a message", kLockFree, grow},
      {"reserve memory", kLockFree, reserve},
      {"make, share, copy, drop", kLockFree, make_and_share},
      {"publish again what was received", kLockFree, publish_again},
      {"publish a message that refers", kLockFree, refer},
      {"select and deselect", kLockFree, select_and_deselect, unlocked},
      {"read what is one's own", kLockFree, read_selected, unlocked},
      {"collect what nobody needs", kLockFree, collect},
      {"look for the dead", kLockFree, look_for_the_dead},
      {"loan, blocks have run out", kLockFree, loan_without_blocks, take_all_blocks},
      {"slots: push, overwrite", kWaitFree, push_slots, loan_slots},
      {"slots: loan, push and borrow", kLockFree, publish_and_borrow_slots},
      {"slots: keep, pull, drop", kLockFree, keep_slots},
      {"slots: put and pop, overwrite", kLockFree, put_and_pop_slots},
      {"subscribe, unsubscribe", kBlocking, subscribe, {}, nullptr, true},
      {"advertise, unadvertise", kBlocking, advertise, {}, nullptr, true},
      {"mutex: the victim's queue", kBlocking, read_or_pop, locked},
      {"one that waits for more than the registry's lock",
       kBlocking,
       sleep_long,
       {},
       "is free",
       true},
      {"a lock-free one that takes the registry's lock", kLockFree, advertise, {}, "waits for"},
      {"a wait-free one that sleeps", kWaitFree, doze, {}, ": sleeps"},
      {"a wait-free one that takes long", kWaitFree, grow_often, {}, "more than 5000 instructions"},
  };
  return probes;
}

}  // namespace lot::kill
