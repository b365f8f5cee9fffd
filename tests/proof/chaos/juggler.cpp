// SPDX-License-Identifier: Apache-2.0
#include "juggler.hpp"

#include <thread>

#include "jobs.hpp"
#include "node.hpp"
#include "publisher.hpp"
#include "transport/participant.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

void Juggler::turn() {
  at_rest_.reset();
  Random& random = life_.random;
  std::optional<ShmEngine> first;
  std::optional<ShmEngine> second;
  open_engine(life_, first);
  if (random.chance(50)) open_engine(life_, second);  // the same participant
  std::optional<Publisher<Plain>> publisher;
  std::unique_ptr<Job> reader;
  if (random.chance(80)) publisher.emplace(life_, second ? *second : *first, topic_);
  if (random.chance(80)) reader = make_inlet(life_, *first, random.pick(kFirstShape));
  if (random.chance(30)) second.reset();
  for (std::uint64_t n = random.below(8); n > 0 && life_.stage() == Stage::Run; --n) {
    if (publisher) publisher->turn();
    if (reader) reader->turn();
    // What wardens do with what was long unused, at once.
    if (random.chance(20)) {
      const auto participant = transport::Participant::join(life_.epoch.engine);
      participant->stock().give_back_to_system(0, [] { return false; });
    }
  }
  // Handles, and pointers that they hold, may outlive their engines.
  for (unsigned n = 0; n < 6; ++n) {
    life_.doing(Doing::Closing, topic_);
    switch (random.below(4)) {
      case 0:
        first.reset();
        break;
      case 1:
        second.reset();
        break;
      case 2:
        publisher.reset();
        break;
      default:
        reader.reset();
    }
  }
  life_.doing(Doing::Running);
  std::this_thread::sleep_for(random.between(0ms, 20ms));
}

void Juggler::quiet() {
  if (!at_rest_) open_engine(life_, at_rest_);
  life_.doing(Doing::Running);
  std::this_thread::sleep_for(2ms);
}

bool Juggler::settle() {
  quiet();
  return true;
}

}  // namespace lot::chaos
