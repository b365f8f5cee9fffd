// SPDX-License-Identifier: Apache-2.0

// Every operation of the public interface that touches the segment, in the situations that make a
// difference to it.
#include <algorithm>
#include <cstddef>
#include <fstream>
#include <string>
#include <string_view>
#include <thread>
#include <utility>

#include "acts.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "transport/environment.hpp"
#include "transport/participant.hpp"

namespace lot::kill {
namespace {

void membership(std::vector<Operation>& all) {
  all.push_back({"create a segment", Promise::Blocking, {}, join, {}, true});
  all.push_back({"create, an unfinished one is left",
                 Promise::Blocking,
                 {victim([](Node& n) {
                   std::ofstream(n.options.directory + "/" + n.options.segment + ".new") << "x";
                 })},
                 join,
                 {},
                 true});
  all.push_back({"create, killed ones have left one of another size",
                 Promise::Blocking,
                 {dead([](Node& n) {
                   n.options.size_bytes += 2 << 20;
                   n.join();
                 })},
                 join,
                 {},
                 true});
  all.push_back({"open a segment", Promise::Blocking, {witness(join)}, join});
  all.push_back({"open, killed ones have left it",
                 Promise::Blocking,
                 {dead(join), publisher(dead, overwrite(2), kTopic), reader(dead, kTopic),
                  publishes(dead, 3), dead(loan_one), dead([](Node& n) { n.hold(true); })},
                 join,
                 {},
                 true});
  all.push_back(
      {"close, others stay", Promise::Blocking, {witness(join), victim(join)}, [](Node& n) {
         n.engine.reset();
       }});
  all.push_back({"close, last one out",
                 Promise::Blocking,
                 {victim(join)},
                 [](Node& n) { n.engine.reset(); },
                 {},
                 true});
  // As the thread of end_cleanly_on_signals() does it, before the process ends.
  const auto end_by_signal = [](Node&) { transport::Participant::remove_files(); };
  all.push_back({"end by a signal, others stay",
                 Promise::Blocking,
                 victim_publishes(overwrite(3), 2) + Acts{victim(loan_one)},
                 end_by_signal,
                 {},
                 false,
                 Rival::None,
                 1,
                 true});
  all.push_back({"end by a signal, last one out",
                 Promise::Blocking,
                 {victim(join), publisher(victim, overwrite(2), kTopic), publishes(victim, 3)},
                 end_by_signal,
                 {},
                 true,
                 Rival::None,
                 1,
                 true});
  all.push_back({"close with everything open", Promise::Blocking,
                 victim_publishes(overwrite(2), 3) + Acts{victim(loan_one)},
                 [](Node& n) { n.leave(); }});
}

void topics(std::vector<Operation>& all) {
  const auto advertise = [](const PusherOptions& options) {
    return [=](Node& n) { n.pusher.emplace(n.engine->advertise<Number>(kTopic, options)); };
  };
  const Acts both{witness(join), victim(join)};
  all.push_back({"advertise, a new topic", Promise::Blocking, both, advertise(overwrite(3))});
  all.push_back({"advertise, a reader waits", Promise::Blocking,
                 both + Acts{reader(witness, kTopic)}, advertise(block(2))});
  all.push_back({"unadvertise, messages unread", Promise::Blocking,
                 victim_publishes(overwrite(3), 2), [](Node& n) { n.pusher.reset(); }});
  all.push_back(
      {"unadvertise, a reader sleeps", Promise::Blocking,
       victim_publishes(overwrite(2), 1) + Acts{witness([](Node& n) { n.receive_all(); }),
                                                witness([](Node& n) { n.sleep_on_topic(); })},
       [](Node& n) { n.pusher.reset(); }});
  all.push_back({"unadvertise, a reader borrows and keeps", Promise::Blocking,
                 victim_publishes(overwrite(2), 2) + Acts{witness([](Node& n) { n.hold(false); }),
                                                          witness([](Node& n) { n.hold(true); })},
                 [](Node& n) { n.pusher.reset(); }});
  for (const bool blocking : {false, true}) {
    const PusherOptions options = blocking ? block(2) : overwrite(2);
    const std::string policy = blocking ? ", block" : ", overwrite";
    all.push_back(
        {"subscribe, history" + policy, Promise::Blocking,
         both + Acts{publisher(witness, options, kOther), publishes(witness, 3)},
         [](Node& n) { n.puller.emplace(n.engine->subscribe<Number>(kOther, parked(2))); }});
    all.push_back({"unsubscribe" + policy, Promise::Blocking, victim_reads(options, 1),
                   [](Node& n) { n.puller.reset(); }});
  }
  all.push_back({"wait for readers", Promise::Blocking,
                 both + Acts{publisher(victim, overwrite(2), kTopic)},
                 [](Node& n) { return n.pusher->wait_for_readers(1, 10s); },
                 [](Node& n) {
                   n.puller.emplace(n.engine->subscribe<Number>(kTopic, parked()));
                   n.reads_topic = true;
                 }});
  all.push_back({"subscribe, no publisher", Promise::Blocking, both,
                 [](Node& n) { n.puller.emplace(n.engine->subscribe<Number>(kOther, parked())); }});
}

/// The witness has read all of them but one, and the newest stays.
void takes_back(std::vector<Operation>& all, const Way& way) {
  for (const bool blocking : {false, true}) {
    PusherOptions options = blocking ? block(4, way) : overwrite(4, way);
    options.history = 1;
    const std::string policy = blocking ? ", block" : ", overwrite";
    all.push_back({named("loan, what was read is taken back" + policy, way),
                   under(way, {Promise::LockFree, "loan and push, overwrite"}),
                   victim_publishes(options, 3) +
                       Acts{witness([](Node& n) { n.receive_all(); }), publishes(victim, 1)},
                   loan_one});
  }
}

void loans(std::vector<Operation>& all) {
  const Acts fresh{witness(join), victim(join), publisher(victim, overwrite(2), kTopic)};
  all.push_back({"loan, a fresh block", {Promise::LockFree, "loan, give back"}, fresh, loan_one});
  all.push_back({"loan, a used block",
                 {Promise::LockFree, "loan and push, overwrite"},
                 victim_publishes(overwrite(1), 40),
                 loan_one});
  // Two are left, which the probes of a neighbour may take: another process gives none up for them.
  all.push_back({"loan, blocks have run out: evict",
                 {Promise::LockFree, "loan, blocks have run out"},
                 victim_publishes(overwrite(8), 8) + Acts{victim([](Node& n) {
                   while (auto loan = n.pusher->try_loan(Number{})) {
                     n.loans.push_back(std::move(loan));
                     if (n.loans.size() == n.options.blocks - 10) break;
                   }
                 })},
                 [](Node& n) {
                   for (int i = 0; i < 4; ++i) n.loans.push_back(n.pusher->loan(numbered(9, 0)));
                 }});
  // Here, too. The witness has read six, and two are its to read.
  all.push_back(
      {"loan, blocks have run out: take back what was read",
       {Promise::LockFree, "loan, blocks have run out"},
       victim_publishes(block(8), 6) + Acts{witness([](Node& n) { n.receive_all(); }),
                                            publishes(victim, 2), victim([](Node& n) {
                                              while (n.loans.size() < n.options.blocks - 10) {
                                                n.loans.push_back(n.pusher->loan(numbered(9, 0)));
                                              }
                                            })},
       [](Node& n) {
         for (int i = 0; i < 4; ++i) n.loans.push_back(n.pusher->loan(numbered(9, 0)));
       }});
  // Here, too. Then the oldest of the other topic go: there are six, and the newest two stay.
  all.push_back({"loan, blocks have run out: evict another topic's",
                 {Promise::LockFree, "loan, blocks have run out"},
                 victim_publishes(overwrite(8), 6) + Acts{victim([](Node& n) {
                   n.second.emplace(n.engine->advertise<Number>(kOther, overwrite(2)));
                   while (n.loans.size() < n.options.blocks - 8) {
                     n.loans.push_back(n.second->loan(numbered(9, 0)));
                   }
                 })},
                 [](Node& n) {
                   for (int i = 0; i < 4; ++i) n.loans.push_back(n.second->loan(numbered(9, 0)));
                 }});
  // The other processes stand still.
  const auto takes_all_but = [](std::size_t left) {
    return victim([left](Node& n) {
      n.second.emplace(n.engine->advertise<Number>(kFrames, overwrite(2)));
      while (n.loans.size() < n.options.blocks - left) {
        n.loans.push_back(n.second->loan(numbered(9, 0)));
      }
    });
  };
  const auto takes_four = [](Node& n) {
    for (int i = 0; i < 4; ++i) n.loans.push_back(n.second->loan(numbered(9, 0)));
  };
  // The witness could give four up, and stands still.
  all.push_back({"loan, blocks have run out: another process is asked", Promise::Blocking,
                 Acts{witness(join), victim(join), publisher(witness, overwrite(8), kOther),
                      publishes(witness, 6), takes_all_but(8)},
                 [](Node& n) {
                   while (auto loan = n.second->try_loan(numbered(9, 0))) {
                     n.loans.push_back(std::move(loan));
                   }
                 }});
  all.push_back({"give up for another process",
                 {Promise::LockFree, "loan, blocks have run out"},
                 victim_publishes(overwrite(8), 6),
                 [](Node& n) {
                   const auto participant = transport::Participant::join(n.options);
                   for (int i = 0; i < 3; ++i) {
                     participant->eviction().give({transport::Shortage::Blocks, 1, 1});
                   }
                   participant->stock().trim(transport::Stock::kNobody);
                 }});
  // The witness has not looked yet, and is told of what it missed.
  all.push_back({"loan, blocks have run out: from an ended ring", Promise::Blocking,
                 Acts{witness(join), victim(join), reader(witness, kTopic), dead(join),
                      publisher(dead, overwrite(8), kTopic), publishes(dead, 6), takes_all_but(10)},
                 takes_four});
  all.push_back({"reserve memory", {Promise::LockFree, "reserve memory"}, fresh, [](Node& n) {
                   n.pusher->reserve(2, 8000);
                 }});
  all.push_back({"loan given back",
                 {Promise::LockFree, "loan, give back"},
                 fresh + Acts{victim(loan_one)},
                 [](Node& n) { n.loans.clear(); }});
  all.push_back(
      {"make, without a topic", {Promise::LockFree, "make, share, copy, drop"}, fresh, [](Node& n) {
         auto made = n.engine->make<Number>(numbered(n.source, 0));
       }});
  const auto frame = [](Node& n) { n.frame_loans.push_back(n.frames->loan()); };
  const Acts frames{witness(join), victim(join), victim([](Node& n) {
                      n.frames.emplace(n.engine->advertise<Frame>(kFrames, overwrite(1)));
                    })};
  all.push_back({"grow a message",
                 {Promise::LockFree, "grow a message"},
                 frames + Acts{victim(frame)},
                 [](Node& n) {
                   auto& data = n.frame_loans.back()->data;
                   for (const std::size_t size : {20U, 700U, 3000U}) data.resize(size);
                 }});
  all.push_back({"give back what a message has no need of",
                 {Promise::LockFree, "grow a message"},
                 frames + Acts{victim(frame), victim([](Node& n) {
                                 n.frame_loans.back()->data.resize(12000);
                                 n.frame_loans.clear();
                               }),
                               victim(frame)},
                 [](Node& n) {
                   transport::Participant::join(n.options)->stock().trim(transport::Stock::kNobody);
                   n.frame_loans.back()->data.resize(12000);
                 }});
  all.push_back(
      {"give memory back to the system, and get it again",
       {Promise::LockFree, "grow a message"},
       frames + Acts{victim(frame), victim([](Node& n) {
                       n.frame_loans.back()->data.reserve(150'000);  // above the tables' unit
                       n.frame_loans.clear();
                     }),
                     victim(frame)},
       [](Node& n) {
         const auto participant = transport::Participant::join(n.options);
         participant->stock().trim(transport::Stock::kNobody);
         testing::must(participant->stock().give_back_to_system(0, [] { return false; }) != 0,
                       "it had memory to give back");
         n.frame_loans.back()->data.reserve(150'000);
       },
       {},
       false,
       Rival::None,
       8});
  all.push_back({"a grown message given back",
                 {Promise::LockFree, "grow a message"},
                 frames + Acts{victim(frame), victim([](Node& n) {
                                 n.frame_loans.back()->data.resize(700);
                                 n.frame_loans.back()->data.resize(2000);
                               })},
                 [](Node& n) { n.frame_loans.clear(); }});
  // The memory of the last message is shortened, lengthened in place, and replaced.
  all.push_back({"a used block, messages of other sizes",
                 {Promise::LockFree, "grow a message"},
                 frames + Acts{victim(frame), victim([](Node& n) {
                                 n.frame_loans.back()->data.resize(12000);
                                 n.frame_loans.clear();
                               })},
                 [](Node& n) {
                   for (const std::size_t size : {9000U, 9600U, 11000U}) {
                     n.frame_loans.push_back(n.frames->loan());
                     n.frame_loans.back()->data.resize(size);
                     n.frame_loans.clear();
                   }
                 }});
  all.push_back({"a message complete, with memory unused",
                 {Promise::LockFree, "grow a message"},
                 frames + Acts{victim(frame), victim([](Node& n) {
                                 for (const std::size_t size : {700U, 2000U, 6000U, 7500U, 100U}) {
                                   auto& data = n.frame_loans.back()->data;
                                   data.resize(size);
                                   data.shrink_to_fit();
                                 }
                               })},
                 [](Node& n) {
                   ShmSharedPtr<Frame> complete = std::move(n.frame_loans.back());
                   n.frame_loans.clear();
                 }});
}

void pushes(std::vector<Operation>& all, const Way& way) {
  const auto loaned = [](Acts acts) { return std::move(acts) + Acts{victim(loan_one)}; };
  const auto add = [&](const char* name, const Pledge& pledge, const Acts& before) {
    all.push_back({named(name, way), pledge, before, push_loan});
  };
  const Pledge shown = under(way, {Promise::WaitFree, "push, overwrite"});
  add("push, overwrite, an empty ring", shown, loaned(victim_publishes(overwrite(2, way), 0)));
  add("push, overwrite, a full ring wraps", shown, loaned(victim_publishes(overwrite(2, way), 4)));
  add("push, overwrite, one slot", shown, loaned(victim_publishes(overwrite(1, way), 1)));
  add("push, overwrite, a reader sleeps", shown,
      loaned(victim_publishes(overwrite(2, way), 1)) +
          Acts{witness([](Node& n) { n.receive_all(); }),
               witness([](Node& n) { n.sleep_on_topic(); })});
  // The others stand still, so a push wakes none of them. This one does what it does behind a wake
  // of two: the rouser's thread starts.
  all.push_back({named("push, overwrite, the rouser is asked", way), Promise::Blocking,
                 loaned(victim_publishes(overwrite(2, way), 1)) +
                     Acts{witness([](Node& n) { n.receive_all(); }),
                          witness([](Node& n) { n.sleep_on_topic(); })},
                 [](Node& n) {
                   push_loan(n);
                   const auto participant = transport::Participant::join(n.options);
                   const auto ring = participant->segment().ring(0);
                   participant->rouser().rouse(futex::low_half(ring.slots[1]));
                 }});
  add("push, overwrite, a reader borrows", shown,
      loaned(victim_publishes(overwrite(1, way), 1) +
             Acts{witness([](Node& n) { n.hold(true); })}));
  add("push, overwrite, a reader keeps", shown,
      loaned(victim_publishes(overwrite(1, way), 1) +
             Acts{witness([](Node& n) { n.hold(false); })}));
  all.push_back(
      {named("loan and push, a batch is scanned", way),
       under(way, {Promise::LockFree, "loan and push, overwrite"}),
       victim_publishes(overwrite(1, way), 33) + Acts{witness([](Node& n) { n.hold(true); })},
       [](Node& n) { n.publish(2); }});
  add("push, block, room", Promise::Blocking, loaned(victim_publishes(block(2, way), 1)));
  add("push, block, wraps", Promise::Blocking,
      loaned(victim_publishes(block(2, way), 2) + Acts{witness([](Node& n) { n.receive_all(); })}));
  add("push, block, a reader sleeps", Promise::Blocking,
      loaned(victim_publishes(block(2, way), 1)) +
          Acts{witness([](Node& n) { n.receive_all(); }),
               witness([](Node& n) { n.sleep_on_topic(); })});
  add("push, block, a reader borrows", Promise::Blocking,
      loaned(victim_publishes(block(2, way), 1) + Acts{witness([](Node& n) { n.hold(true); })}));
  all.push_back({named("push, block, full: refused", way),
                 under(way, {Promise::LockFree, "push, block, full: refused"}),
                 loaned(victim_publishes(block(1, way), 1)), [](Node& n) {
                   if (n.pusher->try_push(std::move(n.loans.back())) == Status::Ok) std::abort();
                 }});
  all.push_back({named("push, block, full: waits for room", way), Promise::Blocking,
                 loaned(victim_publishes(block(1, way), 1)), push_loan,
                 [](Node& n) { n.receive_all(); }});
}

void pulls(std::vector<Operation>& all, const Way& way) {
  for (const bool blocking : {false, true}) {
    const std::string policy = blocking ? ", block" : ", overwrite";
    const PusherOptions options = blocking ? block(2, way) : overwrite(2, way);
    all.push_back({named("try, nothing there" + policy, way),
                   under(way, {Promise::LockFree, "borrow"}), victim_reads(options, 0),
                   [](Node& n) { return n.puller->try_borrow(); }});
    all.push_back({named("borrow and end" + policy, way), under(way, {Promise::LockFree, "borrow"}),
                   victim_reads(options, 2), [](Node& n) { n.receive(); }});
    all.push_back({named("pull and let go" + policy, way),
                   under(way, {Promise::LockFree, "pull, copy, weak lock, drop"}),
                   victim_reads(options, 2), [](Node& n) { return n.puller->try_pull(); }});
    all.push_back({named("pull sleeps and is woken" + policy, way), Promise::Blocking,
                   victim_reads(options, 0), [](Node& n) { n.kept.push_back(n.puller->pull(10s)); },
                   [](Node& n) { n.publish(1); }});
  }
  all.push_back(
      {named("borrow and end, the sender sleeps for room", way),
       under(way, {Promise::LockFree, "read what the victim published"}),
       victim_reads(block(1, way), 1) + Acts{witness([](Node& n) { n.sleep_for_room(); })},
       [](Node& n) {
         n.receive();
         (void)n.puller->try_borrow();  // and ends it
       }});
  all.push_back(
      {named("unsubscribe, the sender sleeps for room", way), Promise::Blocking,
       victim_reads(block(1, way), 1) + Acts{witness([](Node& n) { n.sleep_for_room(); })},
       [](Node& n) { n.puller.reset(); }});
  all.push_back({named("pull sleeps on two publishers", way), Promise::Blocking,
                 victim_reads(overwrite(2, way), 0) + Acts{witness([=](Node& n) {
                   n.second.emplace(n.engine->advertise<Number>(kOther, overwrite(2, way)));
                 })},
                 [](Node& n) { n.kept.push_back(n.puller->pull(10s)); },
                 [](Node& n) { n.publish(1); }});
  all.push_back({named("pull sleeps until a publisher comes", way), Promise::Blocking,
                 Acts{witness(join), victim(join), reader(victim, kOther),
                      witness([=](Node& n) { n.locked = way.engine == QueueEngine::Mutex; })},
                 [](Node& n) { n.kept.push_back(n.puller->pull(10s)); },
                 [=](Node& n) {
                   n.pusher.emplace(n.engine->advertise<Number>(kOther, overwrite(2, way)));
                   n.publish(1);
                 }});
  all.push_back({named("borrow spins, sleeps and is woken", way), Promise::Blocking,
                 Acts{witness(join), victim(join), publisher(witness, overwrite(2, way), kOther),
                      victim([](Node& n) {
                        n.puller.emplace(n.engine->subscribe<Number>(kOther, {Wait::Adaptive, 0}));
                      })},
                 [](Node& n) { n.borrow = n.puller->borrow(10s); }, [](Node& n) { n.publish(1); }});
  all.push_back({named("timed pull, too late", way), Promise::Blocking,
                 victim_reads(overwrite(2, way), 0), [](Node& n) { return n.puller->pull(2ms); }});
  all.push_back({named("borrow, lapped", way),
                 under(way, {Promise::LockFree, "read what the victim published"}),
                 victim_reads(overwrite(2, way), 7), [](Node& n) { n.receive_all(); }});
  all.push_back(
      {named("try, the publisher has gone", way),
       under(way, {Promise::LockFree, "read what the victim published"}),
       victim_reads(overwrite(2, way), 1) + Acts{witness([](Node& n) { n.pusher.reset(); })},
       [](Node& n) {
         n.receive_all();
         (void)n.puller->try_borrow();  // finds none
       }});
}

/// Subscribers for which a new ring has a cell, since they had subscribed before it came.
void subscribers(std::vector<Operation>& all, const Way& way) {
  const auto add = [&](const std::string& name, const Pledge& pledge, const Acts& before,
                       std::function<void(Node&)> run,
                       std::function<void(Node&)> when_asleep = {}) {
    all.push_back(
        {named(name, way), under(way, pledge), before, std::move(run), std::move(when_asleep)});
  };
  const Acts locks{witness([way](Node& n) { n.locked = way.engine == QueueEngine::Mutex; })};
  const Acts both = Acts{witness(join), victim(join)} + locks;
  const Pledge reads{Promise::LockFree, "read what the victim published"};
  const auto look = [](Node& n) { n.receive(); };
  const auto read = [](Node& n) {
    n.receive_all();
    (void)n.puller->try_borrow();  // finds none
  };
  const auto unsubscribe = [](Node& n) { n.puller.reset(); };
  const Acts gone{witness([](Node& n) { n.pusher.reset(); })};
  for (const bool blocking : {false, true}) {
    const std::string policy = blocking ? ", block" : ", overwrite";
    const PusherOptions options = blocking ? block(2, way) : overwrite(2, way);
    add("try, a new publisher has come" + policy, reads, victim_is_awaited(options, 1), look);
    add("try, a new publisher has come and gone" + policy, reads,
        victim_is_awaited(options, 2) + gone, read);
    add("unsubscribe unseen" + policy, Promise::Blocking, victim_is_awaited(options, 1),
        unsubscribe);
    add("unsubscribe unseen, it has ended" + policy, Promise::Blocking,
        victim_is_awaited(options, 2) + gone, unsubscribe);
    // The victim awaits itself, too.
    add("advertise and push, nobody has looked" + policy, Promise::Blocking,
        both + Acts{bystander(join), reader(witness, kTopic), reader(bystander, kTopic),
                    reader(victim, kTopic)},
        [=](Node& n) {
          n.pusher.emplace(n.engine->advertise<Number>(kTopic, options));
          n.publish(2);
        });
  }
  const Acts for_room =
      victim_is_awaited(block(1, way), 1) + Acts{witness([](Node& n) { n.sleep_for_room(); })};
  add("try, a new publisher sleeps for room", reads, for_room, read);
  add("unsubscribe unseen, the sender sleeps for room", Promise::Blocking, for_room, unsubscribe);
  // The witness has not looked either: all is there for it.
  add("try, a new publisher has come and died", reads,
      both + Acts{dead(join), reader(witness, kTopic), reader(victim, kTopic),
                  publisher(dead, overwrite(2, way), kTopic), publishes(dead, 2)},
      [=](Node& n) {
        n.reap();
        read(n);
      });
  add("advertise and push, a subscriber has died", Promise::Blocking,
      both + Acts{dead(join), reader(dead, kTopic), reader(witness, kTopic)}, [=](Node& n) {
        n.pusher.emplace(n.engine->advertise<Number>(kTopic, block(2, way)));
        n.publish(2);
      });

  const Acts full = both + Acts{reader(witness, kTopic), publisher(victim, block(1, way), kTopic),
                                publishes(victim, 1), victim(loan_one)};
  add("push, block, waits for who has not looked", Promise::Blocking, full, push_loan,
      [](Node& n) { n.receive_all(); });
  add("push, block, who has not looked unsubscribes", Promise::Blocking, full, push_loan,
      [](Node& n) {
        n.puller.reset();
        n.reads_topic = false;
      });
  add("push, block, who has not looked has died", Promise::Blocking,
      both + Acts{dead(join), reader(dead, kTopic), publisher(victim, block(1, way), kTopic),
                  reader(witness, kTopic), publishes(victim, 1),
                  witness([](Node& n) { n.receive_all(); }), victim(loan_one)},
      push_loan);
}

/// A queue whose items are each taken by one. The witness pops what is left.
void queues(std::vector<Operation>& all, const Way& way) {
  const auto options = [way](std::uint32_t depth, Policy policy = Policy::Block) {
    return queueing(depth, policy, way);
  };
  const auto both = [](const QueueOptions& o) {
    const auto open = [o](Node& n) {
      n.open_queue(o);
      n.queue->listen();
    };
    return Acts{witness(join), victim(join), witness(open), victim(open)};
  };
  const auto puts = [](Act (*who)(std::function<void(Node&)>), unsigned count) {
    return Acts{who([=](Node& n) { n.put(count); })};
  };
  // The victim has a ring, and the witness has looked there.
  const auto victim_puts = [&](const QueueOptions& o) {
    return both(o) + puts(victim, 1) + Acts{witness([](Node& n) { n.pop(); })};
  };
  const auto add = [&](const char* name, const Pledge& pledge, const Acts& before,
                       std::function<void(Node&)> run,
                       std::function<void(Node&)> when_asleep = {}) {
    all.push_back({named(name, way), pledge, before, std::move(run), std::move(when_asleep)});
  };
  const Pledge shown = under(way, {Promise::LockFree, "put and pop, overwrite"});
  const auto put = [](Node& n) { n.put(); };
  const auto pop = [](Node& n) { n.pop(); };
  const auto sleeps = witness([](Node& n) { n.sleep_on_queue(); });

  add("put, the first item", Promise::Blocking, both(options(2)), put);
  add("put, an empty queue", Promise::Blocking, victim_puts(options(2)), put);
  add("put, a reader sleeps", Promise::Blocking, victim_puts(options(2)) + Acts{sleeps}, put);
  add("put, what was taken is used again", Promise::Blocking,
      victim_puts(options(2)) + puts(victim, 2) + Acts{witness(pop), witness(pop)},
      [](Node& n) { n.put(2); });
  add("put, full: refused", shown, victim_puts(options(1, Policy::Refuse)) + puts(victim, 1),
      [](Node& n) {
        if (n.queue->try_put(numbered(n.source, n.put_items)) == Status::Ok) std::abort();
      });
  add("put, full: waits for room", Promise::Blocking, victim_puts(options(1)) + puts(victim, 1),
      put, pop);
  add("put, overwrite", shown, victim_puts(options(2, Policy::Overwrite)) + puts(victim, 3), put);
  add("pop, nothing there", shown, both(options(2)), pop);
  add("pop", shown, both(options(2)) + puts(witness, 2), pop);
  add("pop, others have taken what was first", shown,
      both(options(3)) + puts(witness, 3) + Acts{witness(pop)}, pop);
  add("pop, overwritten", shown, both(options(2, Policy::Overwrite)) + puts(witness, 5), pop);
  add(
      "pop sleeps and is woken", Promise::Blocking, both(options(2)),
      [](Node& n) { return n.queue->wait_and_pop_for(10s); }, put);
  add("pop, who puts sleeps for room", shown,
      both(options(1)) + puts(witness, 1) + Acts{witness([](Node& n) { n.sleep_to_put(); })},
      [](Node& n) {
        n.pop();
        n.pop();
      });
  add("pop without a copy, and put it again", Promise::Blocking,
      both(options(2)) + puts(witness, 1) + Acts{victim([=](Node& n) {
        n.tasks.emplace(n.engine->queue<ShmUniquePtr<Number>>(kLeft, options(2)));
        testing::must_go(n.tasks->put(n.tasks->make(numbered(n.source, 0))));
      })},
      [](Node& n) {
        auto task = n.tasks->try_pop();
        testing::must_go(n.tasks->put(std::move(*task)));
        task = n.tasks->try_pop();
      });
  add("open a queue, and listen", Promise::Blocking,
      Acts{witness(join), victim(join), witness([=](Node& n) {
             n.open_queue(options(2));
             n.queue->listen();
           })} +
          puts(witness, 1),
      [=](Node& n) {
        n.open_queue(options(2));
        n.queue->listen();
      });
  add("close a queue with items", Promise::Blocking, victim_puts(options(2)) + puts(victim, 2),
      [](Node& n) { n.queue.reset(); });
  add("close a queue unseen", Promise::Blocking, both(options(2)) + puts(witness, 2),
      [](Node& n) { n.queue.reset(); });
  add("close a queue, who puts sleeps for room", Promise::Blocking,
      both(options(1)) + puts(witness, 1) + Acts{witness([](Node& n) { n.sleep_to_put(); })},
      [](Node& n) {
        n.pop();
        n.queue.reset();
      });
  const auto listens = [=](Act (*who)(std::function<void(Node&)>)) {
    return Acts{who(join), who([=](Node& n) {
                  n.open_queue(options(2));
                  n.queue->listen();
                })};
  };
  add("pop, who put the first items has died",
      under(way, {Promise::LockFree, "pop what the victim put"}),
      listens(witness) + listens(victim) + listens(dead) + puts(dead, 2), [](Node& n) {
        n.reap();
        n.pop();
      });
  add("reap, a dead one who puts, items left", under(way, {Promise::LockFree, "look for the dead"}),
      listens(witness) + listens(dead) + puts(dead, 1) + Acts{witness(pop), victim(join)} +
          puts(dead, 2),
      [](Node& n) { n.reap(); });
  add("reap, a dead one who puts, a reader sleeps",
      under(way, {Promise::LockFree, "look for the dead"}),
      listens(witness) + listens(dead) + Acts{victim(join)} + puts(dead, 1) +
          Acts{witness(pop), sleeps},
      [](Node& n) { n.reap(); });
  add("reap, a dead taker", under(way, {Promise::LockFree, "look for the dead"}),
      listens(witness) + listens(dead) + Acts{victim(join)} + puts(witness, 2) + Acts{dead(pop)},
      [](Node& n) { n.reap(); });
}

/// Another one is in the middle of a pop: it holds the item that comes first. A lock lets nobody in
/// beside it; so with the mutex engine it has died there.
void rivals(std::vector<Operation>& all, const Way& way, Rival how) {
  const auto options = [way](std::uint32_t depth, Policy policy) {
    return queueing(depth, policy, way);
  };
  const auto three = [](const QueueOptions& o) {
    const auto open = [o](Node& n) {
      n.open_queue(o);
      n.queue->listen();
    };
    return Acts{witness(join), victim(join), rival(join), witness(open), victim(open), rival(open)};
  };
  const auto add = [&](const std::string& name, const Pledge& pledge, const Acts& before,
                       std::function<void(Node&)> run) {
    const char* beside = how == Rival::Stopped   ? ", a rival holds it"
                         : how == Rival::Halfway ? ", a rival copies it"
                                                 : ", a dead rival holds it";
    all.push_back(
        {named(name + beside, way), under(way, pledge), before, std::move(run), {}, false, how});
  };
  const Pledge shown{Promise::LockFree, "put and pop, overwrite"};
  // There is a ring, and the witness has looked there.
  const auto items = [&](Act (*who)(std::function<void(Node&)>), unsigned count,
                         const QueueOptions& o) {
    return three(o) + Acts{who([](Node& n) { n.put(); }), witness([](Node& n) { n.pop(); }),
                           who([=](Node& n) { n.put(count); })};
  };
  const Acts two_items = items(witness, 2, options(2, Policy::Block));
  add("pop", shown, two_items, [](Node& n) { n.pop(); });
  add("pop without a copy, and drop", shown,
      two_items + Acts{victim([=](Node& n) {
        n.tasks.emplace(n.engine->queue<ShmUniquePtr<Number>>(kItems, options(2, Policy::Block)));
        n.tasks->listen();
      })},
      [](Node& n) {
        if (auto item = n.tasks->try_pop()) (*item)->check ^= 1;  // it is the victim's alone
      });
  add("put, overwrite", shown, items(victim, 4, options(2, Policy::Overwrite)),
      [](Node& n) { n.put(2); });
  if (how == Rival::Killed) return;  // it is reaped before anything is evicted
  if (way.in_slots) return;          // nothing is evicted there
  // Of all blocks, those in the queue are left, and two. So the third evicts: first what the rival
  // holds, which frees nothing yet, and then the next one.
  add("put and evict", {Promise::LockFree, "loan, blocks have run out"},
      items(victim, 4, options(8, Policy::Overwrite)) + Acts{victim([](Node& n) {
        n.pusher.emplace(n.engine->advertise<Number>(kTopic, overwrite(2)));
        while (n.loans.size() < n.options.blocks - 6) loan_one(n);
      })},
      [](Node& n) { n.put(4); });
}

/// A queue of tasks: what the dead has not finished is the witness's.
void tasks(std::vector<Operation>& all, const Way& way) {
  const auto options = [way](std::uint32_t depth) {
    return queueing(depth, Policy::Block, way, true);
  };
  const auto listens = [](Act (*who)(std::function<void(Node&)>), const QueueOptions& o) {
    return Acts{who(join), who([o](Node& n) {
                  n.open_queue(o);
                  n.queue->listen();
                })};
  };
  const auto puts = [](Act (*who)(std::function<void(Node&)>), unsigned count) {
    return Acts{who([=](Node& n) { n.put(count); })};
  };
  const auto takes = [](Node& n) { n.take_work(); };
  const auto both = [&](std::uint32_t depth) {
    return listens(witness, options(depth)) + listens(victim, options(depth));
  };
  const auto add = [&](const char* name, const Pledge& pledge, const Acts& before,
                       std::function<void(Node&)> run) {
    all.push_back({named(name, way), pledge, before, std::move(run), {}});
  };
  const Pledge shown = under(way, {Promise::LockFree, "put and pop, overwrite"});
  const Pledge looks = under(way, {Promise::LockFree, "look for the dead"});
  add("take a task and finish it", shown, both(2) + puts(witness, 2), [](Node& n) { n.pop(); });
  add("take a task and give it back", shown, both(2) + puts(witness, 2), [](Node& n) {
    n.take_work();
    n.work.give_back();
  });
  add("take a task, others work on the first", shown,
      both(3) + puts(witness, 2) + Acts{witness(takes)}, [](Node& n) { n.pop(); });
  add("finish a task, who puts sleeps for room", shown,
      both(1) + puts(witness, 1) + Acts{victim(takes), witness([](Node& n) { n.sleep_to_put(); })},
      [](Node& n) { n.work.finish(); });
  add("give a task back, a reader sleeps", shown,
      both(1) + puts(witness, 1) +
          Acts{victim(takes), witness([](Node& n) { n.sleep_on_queue(); })},
      [](Node& n) { n.work.give_back(); });
  add("leave with a task", {Promise::Blocking}, both(2) + puts(witness, 2) + Acts{victim(takes)},
      [](Node& n) {
        n.queue.reset();
        n.work = {};
      });
  add("put a task, and take it", {Promise::Blocking}, both(1), [](Node& n) {
    n.put();
    n.take_work();
    n.work.finish();
  });
  add("open a queue of tasks, who put them has died", {Promise::Blocking},
      listens(witness, options(2)) + listens(dead, options(2)) + Acts{victim(join)} + puts(dead, 2),
      [=](Node& n) {
        n.open_queue(options(2));
        n.queue->listen();
        n.pop();
      });
  add("reap, a dead worker", looks,
      listens(witness, options(2)) + listens(dead, options(2)) + Acts{victim(join)} +
          puts(witness, 2) + Acts{dead(takes)},
      [](Node& n) { n.reap(); });
  add("reap, a dead worker, a reader sleeps", looks,
      listens(witness, options(1)) + listens(dead, options(1)) + Acts{victim(join)} +
          puts(witness, 1) + Acts{dead(takes), witness([](Node& n) { n.sleep_on_queue(); })},
      [](Node& n) { n.reap(); });
}

/// What else the mutex engine does in its own way.
void locked_queues(std::vector<Operation>& all) {
  constexpr auto kMutex = QueueEngine::Mutex;
  const auto sleeps =
      Acts{witness([](Node& n) { n.receive_all(); }), witness([](Node& n) { n.sleep_on_topic(); })};
  all.push_back(
      {named("advertise, a reader waits", kMutex), Promise::Blocking,
       Acts{witness(join), victim(join), reader(witness, kTopic),
            witness([](Node& n) { n.locked = true; })},
       [](Node& n) { n.pusher.emplace(n.engine->advertise<Number>(kTopic, block(2, kMutex))); }});
  all.push_back({named("unadvertise, a reader sleeps", kMutex), Promise::Blocking,
                 victim_publishes(overwrite(2, kMutex), 1) + sleeps,
                 [](Node& n) { n.pusher.reset(); }});
  all.push_back({named("subscribe, unsubscribe", kMutex), Promise::Blocking,
                 Acts{witness(join), victim(join), publisher(witness, block(2, kMutex), kOther),
                      publishes(witness, 1)},
                 [](Node& n) {
                   n.puller.emplace(n.engine->subscribe<Number>(kOther, parked(2)));
                   n.puller.reset();
                 }});
  all.push_back({named("reap, a dead publisher, a reader sleeps", kMutex), Promise::Blocking,
                 Acts{witness(join), victim(join), dead(join),
                      publisher(dead, overwrite(2, kMutex), kTopic), reader(witness, kTopic),
                      witness([](Node& n) { n.locked = true; }), publishes(dead, 1)} +
                     sleeps,
                 [](Node& n) { n.reap(); }});
}

/// Each reader is told which messages are for it.
void selection(std::vector<Operation>& all, const Way& way) {
  const PusherOptions options = overwrite(8, way);
  const auto add = [&](const char* name, const Pledge& pledge, const Acts& before,
                       std::function<void(Node&)> run) {
    all.push_back({named(name, way), under(way, pledge), before, std::move(run)});
  };
  const auto locks = [way](Node& n) { n.locked = way.engine == QueueEngine::Mutex; };
  const auto ours = [](std::uint64_t from, std::uint64_t to, std::uint64_t end = ~0ULL) {
    return witness([=](Node& n) {
      n.due_from = n.may_from = from;
      n.due_to = to;
      n.may_to = end;
    });
  };
  // The witness reads; it has read nothing yet when the victim operates.
  const Acts selects{witness(join), victim(join), witness(locks),
                     victim([=](Node& n) { n.advertise_selecting(kTopic, options); }),
                     witness([](Node& n) { n.subscribe_selected(kTopic); })};
  const Acts three = selects + Acts{publishes(victim, 3)};
  const Acts has_selected =
      selects + Acts{victim([](Node& n) { n.select("the witness"); }), publishes(victim, 3)};
  const auto reads = witness([](Node& n) { n.read_selected(); });
  const Pledge selecting{Promise::LockFree, "select and deselect"};
  const Pledge reading{Promise::LockFree, "read what is one's own"};
  add("select, from now on", selecting, three + Acts{ours(3, 3)},
      [](Node& n) { n.select("the witness"); });
  add("select, from the last ones on", selecting, three + Acts{reads, ours(1, 1)},
      [](Node& n) { n.select("the witness", 2); });
  add("select, and publish", selecting, three + Acts{ours(3, 3)}, [](Node& n) {
    n.select("the witness");
    n.publish();
  });
  add("select, a reader that has not looked", selecting,
      Acts{witness(join), victim(join), witness(locks),
           witness([](Node& n) { n.subscribe_selected(kTopic); }),
           victim([=](Node& n) { n.advertise_selecting(kTopic, options); }), publishes(victim, 3),
           ours(4, 4, 4)},
      [](Node& n) {
        if (n.selecting->select("the witness", 0)) std::abort();
        n.publish();
      });
  add("select, nobody of that name", selecting, three + Acts{ours(3, 3, 3)}, [](Node& n) {
    if (n.selecting->select("nobody", 0)) std::abort();
  });
  add("select again", selecting,
      has_selected + Acts{victim([](Node& n) { n.selecting->deselect(*n.reader, 0); }), reads,
                          publishes(victim, 1), ours(0, 3, 3)},
      [](Node& n) { n.select("the witness"); });
  add("deselect", selecting, has_selected + Acts{ours(0, 3)},
      [](Node& n) { n.selecting->deselect(*n.reader, 0); });
  add("deselect, the last ones go another way", selecting, has_selected + Acts{ours(0, 1)},
      [](Node& n) { n.selecting->deselect(*n.reader, 2); });
  add("deselect, the last ones have been read", selecting,
      has_selected + Acts{reads, ours(0, 3, 3)},
      [](Node& n) { n.selecting->deselect(*n.reader, 2); });
  add("ask", selecting,
      has_selected + Acts{witness([](Node& n) { n.selected->confirm(); }), ours(0, 3)},
      [](Node& n) { n.selecting->ask(*n.reader); });
  add("unadvertise, a reader is selected", Promise::Blocking, has_selected + Acts{ours(0, 3)},
      [](Node& n) { n.selecting.reset(); });

  // The victim reads.
  const Acts subscribes{witness(join), victim(join), witness(locks),
                        witness([=](Node& n) { n.advertise_selecting(kOther, options); }),
                        victim([](Node& n) { n.subscribe_selected(kOther); })};
  const Acts is_selected =
      subscribes + Acts{witness([](Node& n) { n.select("the victim"); }), publishes(witness, 2)};
  add("read what is one's own", reading, is_selected, [](Node& n) { n.read_selected(); });
  add("read, a selecting publisher has come", reading,
      Acts{witness(join), victim(join), witness(locks),
           victim([](Node& n) { n.subscribe_selected(kOther); }),
           witness([=](Node& n) { n.advertise_selecting(kOther, options); }),
           publishes(witness, 2)},
      [](Node& n) { n.read_selected(); });
  add("decline", reading, is_selected, [](Node& n) { n.selected->decline(); });
  add("join anew", reading, subscribes, [](Node& n) {
    if (n.selected->join_anew("the witness", 7).size() != 1) std::abort();
  });
  add("confirm", reading, is_selected, [](Node& n) { n.selected->confirm(); });
  add("confirm again", reading,
      is_selected + Acts{victim([](Node& n) { n.selected->confirm(); }),
                         witness([](Node& n) { n.selecting->ask(*n.reader); })},
      [](Node& n) { n.selected->confirm(); });
  add("subscribe to a selecting publisher", Promise::Blocking,
      Acts{witness(join), victim(join), witness(locks),
           witness([=](Node& n) { n.advertise_selecting(kOther, options); }),
           publishes(witness, 2)},
      [](Node& n) { n.subscribe_selected(kOther); });
  add("unsubscribe, selected", Promise::Blocking, is_selected, [](Node& n) { n.selected.reset(); });
}

/// A message whose last holder is another process than its home, which would have it back.
void last_holders(std::vector<Operation>& all) {
  constexpr unsigned kBatch = 70;  // the home looks at what was overwritten so many messages later
  const auto waits = [](Node& n) {
    testing::must(n.home_waits(), "the home waits for its message");
  };
  const auto let_go = [](Node& n) {
    n.kept.clear();
    n.held.reset();
  };
  const auto watched = [](Act (*who)(std::function<void(Node&)>)) {
    return who([](Node& n) { n.publish_watched(); });
  };
  const auto holds = [](Act (*who)(std::function<void(Node&)>)) {
    return who([](Node& n) { n.hold(false); });
  };
  const auto holding =
      victim_reads(overwrite(1), 0) +
      Acts{watched(witness), holds(victim), publishes(witness, kBatch), victim(waits)};
  all.push_back({"last pointer anywhere, the home waits",
                 {Promise::WaitFree, "drop the last one, its home waits"},
                 holding,
                 [](Node& n) { n.kept.clear(); }});
  all.push_back({"close, the home of a kept message waits", Promise::Blocking, holding,
                 [](Node& n) { n.leave(); }});
  all.push_back({"reap, a dead last holder",
                 {Promise::LockFree, "look for the dead"},
                 Acts{witness(join), victim(join), dead(join),
                      publisher(witness, overwrite(1), kOther), reader(dead, kOther),
                      watched(witness), holds(dead), publishes(witness, kBatch), dead(waits)},
                 [](Node& n) { n.reap(); }});

  // The victim is the home.
  const auto held = victim_publishes(overwrite(1), 0) + Acts{watched(victim), holds(witness)};
  const auto waiting = held + Acts{publishes(victim, kBatch), witness(waits)};
  all.push_back({"loan and push, another process keeps a message",
                 {Promise::LockFree, "loan and push, overwrite"},
                 held + Acts{publishes(victim, 60)},
                 [](Node& n) {
                   n.publish(10);
                   if (!n.waits_at_home()) std::abort();
                 }});
  all.push_back({"loan and push, the home waits for a message",
                 {Promise::LockFree, "loan and push, overwrite"},
                 waiting,
                 [](Node& n) { n.publish(2); }});
  // The first thread sleeps so long that the warden can do its errand meanwhile.
  all.push_back({"the warden destroys what another process has let go", Promise::Blocking, waiting,
                 [](Node& n) {
                   while (!n.weak.expired()) std::this_thread::sleep_for(300ms);
                 },
                 let_go});
}

void pointers(std::vector<Operation>& all, const Way& way) {
  const Acts holding =
      victim_reads(overwrite(2, way), 1) + Acts{victim([](Node& n) { n.hold(false); })};
  all.push_back({named("keep a borrowed message", way), under(way, {Promise::WaitFree, "keep"}),
                 victim_reads(overwrite(2, way), 1) + Acts{victim([](Node& n) { n.hold(true); })},
                 [](Node& n) { n.kept.push_back(n.borrow.keep()); }});
  all.push_back({named("copy a pointer", way), under(way, {Promise::WaitFree, "copy"}), holding,
                 [](Node& n) { n.kept.push_back(n.kept.front()); }});
  all.push_back({named("drop a copy", way), under(way, {Promise::WaitFree, "drop a copy"}),
                 holding + Acts{victim([](Node& n) { n.kept.push_back(n.kept.front()); })},
                 [](Node& n) { n.kept.pop_back(); }});
  all.push_back({named("last pointer of a reader", way),
                 under(way, {Promise::WaitFree, "drop the last one here"}), holding,
                 [](Node& n) { n.kept.clear(); }});
  all.push_back({named("last pointer anywhere, the message was overwritten", way),
                 under(way, {Promise::WaitFree, "drop the last one here"}),
                 holding + Acts{publishes(witness, 3)}, [](Node& n) { n.kept.clear(); }});
  all.push_back({named("weak lock, alive", way),
                 under(way, {Promise::WaitFree, "weak lock, alive"}),
                 holding + Acts{victim([](Node& n) {
                   n.weak = n.kept.front();
                   n.kept.clear();
                 })},
                 [](Node& n) { n.kept.push_back(n.weak.lock()); }});
  all.push_back({named("weak lock, dead", way), under(way, {Promise::WaitFree, "weak lock, dead"}),
                 holding + Acts{victim([](Node& n) {
                                  n.weak = n.kept.front();
                                  n.kept.clear();
                                }),
                                publishes(witness, 70)},
                 [](Node& n) { n.kept.push_back(n.weak.lock()); }});
  const Acts made = victim_publishes(overwrite(1, way), 0) +
                    Acts{victim(loan_one), victim([](Node& n) {
                           n.kept.emplace_back(std::move(n.loans.back()));
                           n.loans.clear();
                           n.weak = n.kept.back();
                           if (n.pusher->push(n.kept.back()) == Status::Ok) ++n.published;
                           n.kept.clear();
                         })};
  all.push_back({named("weak lock, alive, by its maker", way),
                 under(way, {Promise::WaitFree, "weak lock, alive"}), made,
                 [](Node& n) { n.kept.push_back(n.weak.lock()); }});
  all.push_back({named("weak lock, dead, by its maker", way),
                 under(way, {Promise::WaitFree, "weak lock, dead"}),
                 made + Acts{publishes(victim, 70)},
                 [](Node& n) { n.kept.push_back(n.weak.lock()); }});
  all.push_back({named("share one's own, and drop it", way),
                 under(way, {Promise::LockFree, "make, share, copy, drop"}),
                 Acts{witness(join), victim(join), publisher(victim, overwrite(1, way), kTopic),
                      victim(loan_one)},
                 [](Node& n) {
                   n.own = ShmSharedPtr<Number>(std::move(n.loans.back()));
                   n.own.reset();
                 }});
  all.push_back({named("publish again what was received", way),
                 under(way, {Promise::LockFree, "publish again what was received"}),
                 holding + Acts{victim([=](Node& n) {
                   n.pusher.emplace(n.engine->advertise<Number>("/again", overwrite(1, way)));
                 })},
                 [](Node& n) {
                   testing::must_go(n.pusher->push(n.kept.front()));
                   n.kept.clear();
                   for (int i = 0; i < 2; ++i)
                     testing::must_go(n.pusher->push(n.pusher->loan(numbered(n.source, 0))));
                 }});
  const Acts referring =
      holding + Acts{victim([](Node& n) {
                       n.frames.emplace(n.engine->advertise<Frame>(kFrames, overwrite(1)));
                       n.frame_loans.push_back(n.frames->loan());
                     }),
                     witness(read_frames)};
  all.push_back({named("a message refers to another", way),
                 under(way, {Promise::LockFree, "publish a message that refers"}), referring,
                 [](Node& n) {
                   n.frame_loans.back()->reference = n.kept.front();
                   n.kept.clear();
                   testing::must_go(n.frames->push(std::move(n.frame_loans.back())));
                 }});
  all.push_back({named("a reference is assigned again", way),
                 under(way, {Promise::LockFree, "publish a message that refers"}),
                 referring + Acts{victim([](Node& n) {
                   n.frame_loans.back()->reference =
                       ShmSharedPtr<const Number>(n.engine->make<Number>(numbered(n.source, 0)));
                 })},
                 [](Node& n) {
                   n.frame_loans.back()->reference = n.kept.front();
                   n.kept.clear();
                   testing::must_go(n.frames->push(std::move(n.frame_loans.back())));
                 }});
  all.push_back({named("a message that refers dies", way),
                 under(way, {Promise::LockFree, "publish a message that refers"}),
                 referring + Acts{victim([](Node& n) {
                   n.frame_loans.back()->reference = n.kept.front();
                   n.kept.clear();
                 })},
                 [](Node& n) { n.frame_loans.clear(); }});
}

void reaps(std::vector<Operation>& all, const Way& way) {
  const Acts three{witness(join), victim(join), dead(join)};
  const auto reap = [](Node& n) { n.reap(); };
  all.push_back({named("reap, a dead publisher, a reader sleeps", way),
                 under(way, {Promise::LockFree, "look for the dead"}),
                 three + Acts{publisher(dead, overwrite(2, way), kTopic), reader(witness, kTopic),
                              publishes(dead, 1), witness([](Node& n) { n.receive_all(); }),
                              witness([](Node& n) { n.sleep_on_topic(); })},
                 reap});
  all.push_back({named("reap, a dead publisher, messages unread and held", way),
                 under(way, {Promise::LockFree, "look for the dead"}),
                 three + Acts{publisher(dead, overwrite(3, way), kTopic), reader(witness, kTopic),
                              publishes(dead, 4), witness([](Node& n) { n.hold(false); }),
                              witness([](Node& n) { n.hold(true); }),
                              dead([](Node& n) { n.loans.push_back(n.pusher->loan()); })},
                 reap});
  all.push_back({named("reap, a dead reader", way),
                 under(way, {Promise::LockFree, "look for the dead"}),
                 three + Acts{publisher(witness, block(2, way), kOther), reader(dead, kOther),
                              publishes(witness, 2), dead([](Node& n) { n.hold(false); }),
                              dead([](Node& n) { n.hold(true); })},
                 reap});
  all.push_back({named("reap, a dead referrer", way),
                 under(way, {Promise::LockFree, "look for the dead"}),
                 three + Acts{publisher(witness, overwrite(1, way), kOther), reader(dead, kOther),
                              publishes(witness, 1), dead([](Node& n) {
                                n.hold(false);
                                n.frames.emplace(n.engine->advertise<Frame>(kFrames, overwrite(1)));
                              }),
                              witness(read_frames), dead([](Node& n) {
                                auto frame = n.frames->loan();
                                frame->data.resize(700);
                                frame->reference = n.kept.front();
                                testing::must_go(n.frames->push(std::move(frame)));
                              })},
                 reap});
  all.push_back({named("collect, an orphan ring loses its last reader", way),
                 under(way, {Promise::LockFree, "collect what nobody needs"}),
                 three + Acts{publisher(dead, overwrite(2, way), kTopic), reader(victim, kTopic),
                              publishes(dead, 2)},
                 [](Node& n) {
                   n.reap();
                   n.puller.reset();
                 }});
}

}  // namespace

void keep_only(std::vector<Operation>& all, std::size_t first,
               const std::vector<std::string>& names) {
  const auto is_left_out = [&names](const Operation& operation) {
    return std::none_of(names.begin(), names.end(), [&operation](const std::string& name) {
      return operation.name.find(name) != std::string::npos;
    });
  };
  all.erase(
      std::remove_if(all.begin() + static_cast<std::ptrdiff_t>(first), all.end(), is_left_out),
      all.end());
}

namespace {

/// The scenes in which it makes a difference that messages travel in their slots.
void in_slots(std::vector<Operation>& all) {
  std::size_t first = all.size();
  pushes(all, kSlots);
  pulls(all, kSlots);
  takes_back(all, kSlots);
  tasks(all, kSlots);
  for (const Rival how : {Rival::Killed, Rival::Stopped, Rival::Halfway}) rivals(all, kSlots, how);
  first = all.size();
  subscribers(all, kSlots);
  keep_only(all, first,
            {"a new publisher has come", "nobody has looked, overwrite", "push, block, "});
  first = all.size();
  queues(all, kSlots);
  keep_only(all, first, {": put, ", ": pop", ": close a queue with items", ": reap"});
  first = all.size();
  observers(all, kSlots);
  keep_only(all, first,
            {"borrow and end", "pull and keep", "push, block", "taken back", "a dead observer"});
  first = all.size();
  pointers(all, kSlots);
  keep_only(all, first,
            {"keep a", "last pointer of", "weak lock, ", "publish again", "refers to another"});
  reaps(all, kSlots);

  const Way mutex{QueueEngine::Mutex, true};
  first = all.size();
  pushes(all, mutex);
  pulls(all, mutex);
  queues(all, mutex);
  tasks(all, mutex);
  rivals(all, mutex, Rival::Killed);
  keep_only(all, first,
            {"a full ring wraps", "overwrite, a reader sleeps", "push, block, wraps",
             "full: waits for room", "mutex: borrow and end, overwrite", "pull and let go, block",
             "borrow, lapped", "put, overwrite", "pop, overwritten", "put it again",
             "take a task and", "dead worker, a", "a dead rival"});
  slots(all);
}

}  // namespace

std::vector<Operation> all_operations() {
  std::vector<Operation> all;
  membership(all);
  topics(all);
  loans(all);
  takes_back(all, kRing);
  for (const Way way : {kRing, Way(QueueEngine::Mutex)}) {
    pushes(all, way);
    pulls(all, way);
    subscribers(all, way);
    queues(all, way);
    tasks(all, way);
    rivals(all, way, Rival::Killed);
    selection(all, way);
    observers(all, way);
    ears(all, way.engine);
  }
  rivals(all, kRing, Rival::Stopped);
  locked_queues(all);
  pointers(all, kRing);
  // LOT_FAST_LANE comes before what a scene says. What is kept of a slot is its keeper's own.
  if (!transport::fast_lane(false)) last_holders(all);
  reaps(all, kRing);
  types(all);
  if (transport::fast_lane(true)) in_slots(all);
  return all;
}

}  // namespace lot::kill
