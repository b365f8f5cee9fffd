// SPDX-License-Identifier: Apache-2.0

// Operations that break a promise each: the inspection must find every one of them.
#include <atomic>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <stdexcept>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>
#include <utility>

#include "acts.hpp"
#include "support/must_go.hpp"
#include "support/raw.hpp"
#include "transport/participant.hpp"
#include "types.hpp"

namespace lot::kill {
namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kNobody = 6;  ///< an index that no process of a scene has
constexpr std::uint32_t kFreeBlock = 40;

std::shared_ptr<transport::Participant> participant(Node& n) {
  return transport::Participant::join(n.options);
}

std::vector<Act> scene(std::function<void(Node&)> last, unsigned published = 2) {
  const auto subscribe = [](Node& n) {
    n.puller.emplace(n.engine->subscribe<Number>(kTopic, {Wait::Park, 0}));
    n.reads_topic = true;
  };
  return {{Who::Witness, [](Node& n) { n.join(); }},
          {Who::Victim, [](Node& n) { n.join(); }},
          {Who::Victim,
           [](Node& n) { n.pusher.emplace(n.engine->advertise<Number>(kTopic, overwrite(4))); }},
          {Who::Witness, subscribe},
          {Who::Victim, [=](Node& n) { n.publish(published); }},
          {Who::Witness, std::move(last)}};
}

/// The runs are forks: what they count together lies in shared memory.
std::atomic<unsigned>* counter_of_runs() {
  return static_cast<std::atomic<unsigned>*>(mmap(nullptr, sizeof(std::atomic<unsigned>),
                                                  PROT_READ | PROT_WRITE,
                                                  MAP_SHARED | MAP_ANONYMOUS, -1, 0));
}

void holds_both_ways(Node& n) {
  n.hold(false);
  n.hold(true);
}

/// A word of the message in a slot of the first ring.
unsigned char& message_word(Node& n, std::uint32_t slot, std::size_t word) {
  constexpr std::size_t kHead = 2;  // the words before the message
  auto& first = participant(n)->world().ring(0).slots[slot];
  return reinterpret_cast<unsigned char&>(*(&first + kHead + word));
}
bool holds_number(const unsigned char& small, const Number& number) {
  return std::memcmp(&small, &number, sizeof(number)) == 0;
}

std::uint32_t index_of_witness(Node& n) {
  const auto entries = participant(n)->segment().participants();
  std::uint32_t k = 1;
  while (std::strcmp(entries[k].name, "the witness") != 0) ++k;
  return k;
}
void make_witness_use(Node& n, segment::TopicEntry& topic) {
  test::raw(topic.users[0]).fetch_or(std::uint64_t{1} << index_of_witness(n));
}
/// Makes a topic that the witness uses and does not know, with the type of the first one.
segment::TopicEntry& another_topic(Node& n, const char* name) {
  const auto topics = participant(n)->segment().topics();
  const segment::TopicEntry& first = topics[0];
  segment::TopicEntry& other = topics[3];
  other.type_size = first.type_size;
  other.type_align = first.type_align;
  other.type_hash = first.type_hash;
  other.type_layout = first.type_layout;
  test::raw(other.type_names) = first.type_names.load();
  test::raw(other.description) = first.description.load();
  std::memcpy(other.type_name, first.type_name, sizeof(other.type_name));
  std::strncpy(other.name, name, sizeof(other.name) - 1);
  make_witness_use(n, other);
  return other;
}

}  // namespace

std::vector<Plant> planted_operations() {
  std::vector<Plant> all;
  const auto plant = [&](
                         const char* name, const char* found_as, std::function<void(Node&)> harm,
                         std::function<void(Node&)> last = [](Node&) {}) {
    all.push_back({{name, Promise::Blocking, scene(std::move(last)), std::move(harm)}, found_as});
  };
  plant("a hold of nobody", "is free and held", [](Node& n) {
    test::raw(participant(n)->world().block(kFreeBlock).own[0])
        .fetch_or(std::uint64_t{1} << kNobody);
  });
  plant("a block at home with nobody", "is at home with the dead", [](Node& n) {
    test::raw(participant(n)->world().block(kFreeBlock).home).store(kNobody + 1);
  });
  plant("an operation that throws", "the operation throws: all is lost",
        [](Node&) { throw std::runtime_error("all is lost"); });
  plant("memory of a message that is not there", "belongs to no message",
        [](Node& n) { participant(n)->segment().granules().claim(1, kFreeBlock + 1); });
  plant("a reader's cell of nobody", "has a dead reader", [](Node& n) {
    const auto p = participant(n);
    for (std::uint32_t c = 0; c < p->world().channels(); ++c) {
      const auto ring = p->world().ring(c);
      if (ring.depth != 0) ring.who[ring.readers - 1].store(kNobody + 1);
    }
  });
  plant("a cell in a ring that has ended", "has ended and awaits a reader", [](Node& n) {
    const auto ring = participant(n)->world().ring(0);
    ring.cells[ring.readers - 1].position.store(ring::awaited(ring.first));
    ring.who[ring.readers - 1].store(ring.who[0].load());  // the witness has joined with another
    n.pusher.reset();
  });
  plant("a topic of nobody", "a topic is used by the dead", [](Node& n) {
    test::raw(participant(n)->segment().topics()[3].users[0]).fetch_or(std::uint64_t{1} << kNobody);
  });
  plant("an observer that is not there", "a topic is observed by the dead", [](Node& n) {
    test::raw(participant(n)->segment().topics()[3].observers[0])
        .fetch_or(std::uint64_t{1} << kNobody);
  });
  plant("two topics of one name", "topic /numbers is there twice",
        [](Node& n) { another_topic(n, kTopic); });
  plant("a topic with a description that is none", "topic /more has a damaged description",
        [](Node& n) { test::raw(another_topic(n, "/more").description) = 1; });
  plant("a topic with the description of another type",
        "topic /more has the description of another type",
        [](Node& n) { another_topic(n, "/more").type_layout ^= 1; });
  plant("a topic with a description of other names",
        "topic /more has a description with other names",
        [](Node& n) { test::raw(another_topic(n, "/more").type_names) ^= 1; });
  plant("equal descriptions in two places", "topic /more does not share its description",
        [](Node& n) {
          constexpr std::uint64_t kElsewhere = 100;
          auto& word = test::raw(another_topic(n, "/more").description);
          const std::uint64_t from = segment::description_offset(word);
          const std::uint64_t bytes = segment::description_bytes(word);
          auto* const table =
              reinterpret_cast<unsigned char*>(participant(n)->segment().descriptions().data());
          std::memcpy(table + kElsewhere * segment::kDescriptionPiece, table + from, bytes);
          word = segment::make_description(kElsewhere, bytes, segment::description_check(word));
        });
  plant("a description is written", "the description of this type is damaged", [](Node& n) {
    auto& segment = participant(n)->segment();
    const std::uint64_t at = segment::description_offset(segment.topics()[0].description.load());
    segment.descriptions()[at / sizeof(std::uint64_t)] ^= 1;
  });
  plant("the table of descriptions is written where nothing lies", "memory that nobody owns",
        [](Node& n) { participant(n)->segment().descriptions().back() ^= 1; });
  plant(
      "a held message is written", "a held message did not change",
      [](Node& n) {
        const auto p = participant(n);
        const auto ring = p->world().ring(0);
        for (std::uint32_t i = 0; i < ring.depth; ++i) {
          const ring::Word b = ring::block(ring.slots[i].load());
          if (b >= p->blocks()) continue;
          *p->segment().small(static_cast<std::uint32_t>(b)) ^= 1;
        }
      },
      holds_both_ways);
  plant("a number is left out", "message 3 of source 1 after 2 and 0 missed", [](Node& n) {
    ++n.published;
    n.publish(1);
  });
  plant("a message comes twice", "message 2 of source 1 after 3 and 0 missed", [](Node& n) {
    n.publish(1);
    --n.published;
    n.publish(1);
  });
  plant("a message is taken back", "published 4, seen by the witness 2", [](Node& n) {
    n.publish(1);
    auto& slot = participant(n)->world().ring(0).slots[2];
    slot.store(ring::make(ring::sequence(slot.load()) - 4, ring::kNoBlock));
    n.publish(1);
  });
  plant("memory of nobody is written", "memory that nobody owns", [](Node& n) {
    auto& segment = participant(n)->segment();
    segment.base()[segment.size() - 1] ^= 1;
  });
  // Without a reader, which would look in vain for the end of its publisher's ring.
  all.push_back(
      {{"a lock that nobody will open",
        Promise::Blocking,
        {{Who::Witness, [](Node& n) { n.join(); }}, {Who::Victim, [](Node& n) { n.join(); }}},
        [](Node& n) {
          auto& segment = participant(n)->segment();
          const auto seat = segment.witnesses()[1].seat.load();  // one that lives, and has no lock
          segment.directory().lock.word = lock::make_name(1, liveness::seat::incarnation(seat));
        }},
       "locked"});
  plant("a file is left", "files are left", [](Node& n) {
    std::ofstream(n.options.directory + "/" + n.options.segment + ".left") << "x";
  });
  all.push_back({{"the first message is left out", Promise::Blocking, scene([](Node&) {}, 0),
                  [](Node& n) {
                    ++n.published;
                    n.publish(1);
                  }},
                 "message 1 of source 1 after 0 and 0 missed"});
  plant("the second life's name is taken", "have the same name", [](Node& n) {
    const auto p = participant(n);
    const auto& own = p->segment().participants()[p->index()].name;
    for (auto& entry : p->segment().participants()) {
      if (entry.state.load() != 0) std::memcpy(entry.name, own, sizeof(own));
    }
  });
  auto frames = scene([](Node&) {});
  frames.push_back(
      {Who::Victim, [](Node& n) {
         n.frames.emplace(n.engine->advertise<Frame>(kFrames, {Policy::Overwrite, 1, 1s}));
       }});
  frames.push_back(
      {Who::Witness, [](Node& n) { n.frame_puller.emplace(n.engine->subscribe<Frame>(kFrames)); }});
  all.push_back({{"a reference is null", Promise::Blocking, frames,
                  [](Node& n) { testing::must_go(n.frames->push(n.frames->loan())); }},
                 "refers to what its sender gave it"});
  frames.push_back(
      {Who::Victim, [](Node& n) { testing::must_go(n.frames->push(n.frames->loan())); }});
  frames.push_back({Who::Witness, [](Node& n) { (void)n.frame_puller->try_pull(); }});
  const auto opens = [](Node& n) {
    n.join();
    QueueOptions putting{4, Policy::Block, QueueEngine::Ring, Wait::Park};
    putting.fast_lane = false;  // what is planted writes into blocks
    n.open_queue(putting);
    n.queue->listen();
  };
  const std::vector<Act> items{{Who::Witness, opens},
                               {Who::Victim, opens},
                               {Who::Victim, [](Node& n) { n.put(); }},
                               {Who::Witness, [](Node& n) { n.pop(); }}};
  all.push_back({{"an item is another's", Promise::Blocking, items,
                  [](Node& n) {
                    ++n.put_items;
                    n.put();
                  }},
                 "items that nobody had taken"});
  all.push_back({{"an item comes twice", Promise::Blocking, items,
                  [](Node& n) {
                    --n.put_items;
                    n.put();
                  }},
                 "item 0 came twice"});
  auto contended = items;
  contended.push_back({Who::Rival, opens});
  contended.push_back({Who::Victim, [](Node& n) { n.put(); }});
  all.push_back({{"a rival's item is written",
                  Promise::Blocking,
                  contended,
                  [](Node& n) {
                    const auto p = participant(n);
                    const ring::Word b = ring::block(p->world().ring(0).slots[1].load());
                    const Number other = numbered(kVictim, 40);
                    std::memcpy(p->segment().small(static_cast<std::uint32_t>(b)), &other,
                                sizeof(other));
                  },
                  {},
                  false,
                  Rival::Stopped},
                 "the rival got an item that was not in the queue"});
  all.push_back(
      {{"a frame is lost", Promise::Blocking, frames, [](Node&) {}}, "published 1 frames, seen 0"});
  return all;
}

std::vector<Plant> planted_beside_observers() {
  std::vector<Plant> all;
  const auto plant = [&](const char* name, const char* found_as, Acts before,
                         std::function<void(Node&)> harm, std::uint32_t topics = 10) {
    Operation operation{name, Promise::Blocking, std::move(before), std::move(harm)};
    operation.topics = topics;
    all.push_back({std::move(operation), found_as});
  };
  const Acts both{witness(join), victim(join)};
  const Acts heard = both + Acts{publisher(witness, block(2), kOther),
                                 witness([](Node& n) { n.hear(kOther); }), publishes(witness, 1)};
  plant("an observer is waited for", "a publisher waits for an observer", heard, [](Node& n) {
    const auto ring = participant(n)->world().ring(0);
    ring.who[ring.readers - 1].store(index_of_witness(n) + 1);
    ring.cells[ring.readers - 1].position.store(ring::make(ring.first, ring::kNoBlock));
    ring.roster->fetch_add(1);
  });
  plant("a message comes between", "a reader misses a message beside an observer", heard,
        [](Node& n) {
          n.pusher.emplace(n.engine->advertise<Number>(kOther, overwrite(2)));
          n.publish(1);
        });
  const Acts deserted = both + Acts{witness([](Node& n) {
                          n.observe(kTopic);
                          n.reads_topic = false;
                          n.retypes = true;
                        })};
  plant("an observed topic keeps its type", "the topic carries lot::kill::Number", deserted,
        [](Node& n) { make_witness_use(n, participant(n)->segment().topics()[0]); });
  plant("an observer does not learn that its topic has another type",
        "an observer learns of the type", deserted,
        [](Node& n) { participant(n)->segment().topics()[0].name[1] = 'x'; });
  const Acts no_names = both + Acts{witness([](Node& n) {
                          n.nameless =
                              detail::make_puller(participant(n), kTopic, nameless_number(),
                                                  parked(), detail::Delivery::ToAll);
                        })};
  plant("names without a description of them", "the description has the topic's names", no_names,
        [](Node& n) { test::raw(participant(n)->segment().topics()[0].type_names) = 1; });
  plant("a topic without names that is closed to all", "names decide which process may join",
        no_names, [](Node& n) { participant(n)->segment().topics()[0].type_layout ^= 1; });
  plant(
      "a description whose topic stays", "room for descriptions comes back",
      both + Acts{witness([](Node& n) { n.enter_halves(1, kHalves); })},
      [](Node& n) {
        n.enter_halves(0, 1);
        make_witness_use(n, participant(n)->segment().topics()[n.fillers.back()]);
      },
      kHalves + 10);
  return all;
}

std::vector<Plant> planted_in_slots() {
  std::vector<Plant> all;
  const auto plant = [&](const char* name, const char* found_as, Acts before,
                         std::function<void(Node&)> harm, Rival rival = Rival::None) {
    all.push_back({{named(name, kSlots),
                    Promise::Blocking,
                    std::move(before),
                    std::move(harm),
                    {},
                    false,
                    rival},
                   found_as});
  };
  // The witness has read none of the four, which fill the ring.
  const Acts full = victim_publishes(overwrite(4, kSlots), 4);
  plant("an unread message is written", "a torn message", full,
        [](Node& n) { message_word(n, 1, 2) ^= 1; });
  plant("a publisher begins before its time", "missed 1, and 0 were overwritten", full,
        [](Node& n) {
          const auto ring = participant(n)->world().ring(0);
          ring.slots.begin(0, ring::advance(ring.first, ring.places()));
        });
  // In a ring of the witness, whose first slots no process reads or writes again.
  const Acts at_rest{witness(join), victim(join), publisher(witness, overwrite(16, kSlots), kOther),
                     publishes(witness, 2)};
  plant("a slot says what no publisher says", "has a damaged slot", at_rest, [](Node& n) {
    const auto ring = participant(n)->world().ring(0);
    ring.slots.begin(0, ring::advance(ring.first, 1));
  });
  plant("a slot for messages has a block", "has a block in a slot for messages", at_rest,
        [](Node& n) {
          const auto ring = participant(n)->world().ring(0);
          ring.slots[0].store(ring::make(ring.first, kFreeBlock));
        });
  plant("a kept copy is written", "a held message did not change",
        full + Acts{witness([](Node& n) { n.hold(false); })}, [](Node& n) {
          const auto p = participant(n);
          const std::uint32_t home = index_of_witness(n) + 1;
          for (std::uint32_t b = 0; b < p->blocks(); ++b) {
            if (p->world().block(b).home.load() == home) {
              *p->segment().small(b) ^= 1;
            }
          }
        });
  // The witness has looked at the victim's ring, and does so again when the rival has gone on.
  const Acts copied{witness(join),
                    victim(join),
                    rival(join),
                    publisher(victim, overwrite(4, kSlots), kTopic),
                    reader(witness, kTopic),
                    reader(rival, kTopic),
                    publishes(victim, 1),
                    witness([](Node& n) { n.receive_all(); })};
  plant(
      "a slot is written where a reader copies it", "the rival: child: not so: a torn message",
      copied, [](Node& n) { message_word(n, 0, 2) ^= 1; }, Rival::Halfway);
  plant(
      "a copy is written that its reader has made", "the rival: child: not so: a torn message",
      copied,
      [](Node& n) {
        const auto p = participant(n);
        for (std::uint32_t b = 0; b < p->blocks(); ++b) {
          if (holds_number(*p->segment().small(b), numbered(kVictim, 0)) &&
              p->world().block(b).home.load() != p->index() + 1) {
            *p->segment().small(b) ^= 1;
          }
        }
      },
      Rival::Stopped);
  return all;
}

Plant planted_failure() {
  return {{"an error is swallowed, and a hold leaks", Promise::Blocking, scene([](Node&) {}),
           [](Node& n) {
             const int fd = ::open("/dev/null", O_RDONLY | O_CLOEXEC);
             if (fd != -1) {
               ::close(fd);
             } else {
               test::raw(participant(n)->world().block(kFreeBlock).own[0])
                   .fetch_or(std::uint64_t{1} << kNobody);
             }
           }},
          "is free and held"};
}

Plant planted_shrinking() {
  auto* const runs = counter_of_runs();
  return {{"points that are not reached", Promise::Blocking, scene([](Node&) {}),
           [=](Node&) {
             const unsigned calls = runs->fetch_add(1) == 0 ? 40 : 4;
             for (unsigned i = 0; i < calls; ++i) syscall(SYS_getppid);
           }},
          "points were not reached"};
}

Plant planted_on_the_way() {
  return {{"harm that does not last", Promise::Blocking, scene([](Node&) {}),
           [](Node& n) {
             auto& bits = test::raw(participant(n)->world().block(kFreeBlock).own[0]);
             bits.fetch_or(std::uint64_t{1} << kNobody);
             n.publish(1);
             bits.fetch_and(~(std::uint64_t{1} << kNobody));
           }},
          "is free and held"};
}

std::vector<Operation> planted_changes() {
  const auto changes = [](const char* name, bool in_the_first) {
    auto* const runs = counter_of_runs();
    return Operation{name, Promise::Blocking, scene([](Node&) {}), [=](Node& n) {
                       auto* const byte = const_cast<volatile unsigned char*>(
                           participant(n)->segment().small(kFreeBlock));
                       const unsigned char mask = (runs->fetch_add(1) == 0) == in_the_first;
                       *byte = *byte ^ mask;
                       n.publish(1);
                     }};
  };
  return {changes("a change that only the first run does", true),
          changes("a change that the first run does not do", false)};
}

std::vector<Operation> planted_pledges() {
  const auto nothing = [](Node&) {};
  return {{"a lock-free operation that names no probe", Promise::LockFree, {}, nothing},
          {"a wait-free operation that names a lock-free probe",
           {Promise::WaitFree, "borrow"},
           {},
           nothing},
          {"an operation that names a blocking probe",
           {Promise::LockFree, "subscribe, unsubscribe"},
           {},
           nothing}};
}

}  // namespace lot::kill
