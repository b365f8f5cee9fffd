// SPDX-License-Identifier: Apache-2.0
#include "retyper.hpp"

#include <algorithm>
#include <cerrno>
#include <string>
#include <thread>

#include "canary.hpp"
#include "jobs.hpp"

namespace lot::chaos {

using namespace std::chrono_literals;

namespace {

/// A process that is stopped with the registry's lock keeps an observer from looking for less.
constexpr auto kToldTooLate = 1s;

}  // namespace

void Retyper::turn() {
  const bool stays = observes_ && (life_.has(Plant::Blind) || life_.has(Plant::Cling));
  if (end_ && Clock::now() > until_ && !stays) {
    end_ = nullptr;
    std::this_thread::sleep_for(life_.random.between(0ms, 60ms));
  }
  if (!end_) come();
  let([this] { end_->turn(); });
}

void Retyper::quiet() {
  std::this_thread::sleep_for(1ms);
  let([this] { end_->quiet(); });
}

bool Retyper::settle() {
  bool settled = true;
  std::this_thread::sleep_for(1ms);
  let([&] { settled = end_->settle(); });
  return settled;
}

void Retyper::come() {
  topic_ = life_.random.chance(50) ? kPlainShape : kFrameShape;
  std::uint64_t what = life_.random.below(100);
  // Three observe what one publishes: it alone decides the type, and stays long enough.
  const bool blind = life_.has(Plant::Blind);
  if (blind) what = life_.slot % 4 == 0 ? 99 : 0;
  observes_ = what < 40;
  untold_.reset();
  // Most users go soon, so that the type changes; some stay until all have learnt of it.
  const bool soon = !observes_ && !blind && life_.random.chance(80);
  until_ =
      Clock::now() + (soon ? life_.random.between(2ms, 40ms) : life_.random.between(100ms, 3s));
  try {
    if (what >= 65) {
      end_ = make_publisher(life_, engine_, topic_);
    } else {
      end_ = make_inlet(life_, engine_, topic_, observes_ ? Role::Observe : Role::Retype);
    }
    life_.board.refused[topic_ - kFirstShape].forget();
  } catch (const Error& e) {
    if (e.error_number() != EPROTOTYPE) throw;
    note_refusal(e.what());
    std::this_thread::sleep_for(life_.random.between(2ms, 20ms));
  }
}

template <class F>
void Retyper::let(F&& something) {
  if (!end_) return;
  const bool others_published = others_publish();
  try {
    something();
  } catch (const Error& e) {
    const bool is_told = observes_ && e.error_number() == ESTALE;
    const bool has_rejoined = e.error_number() == EPROTOTYPE;  // too late
    if (!is_told && !has_rejoined) throw;
    if (!is_told || !life_.has(Plant::Blind)) {
      life_.count(Count::TypeChanged);
      end_ = nullptr;
      return;
    }
  }
  note_look(others_published);
}

void Retyper::note_refusal(const char* what) {
  life_.count(Count::TypeRefused);
  Doubt& refused = life_.board.refused[topic_ - kFirstShape];
  if (others_are_there()) {
    refused.forget();
  } else if (refused.lasts(life_.settings.patience) && !has_stalled(life_.board)) {
    life_.fail(Finding::Leaked,
               std::string("it keeps a type that no living process uses: ") + what);
  }
}

void Retyper::note_look(bool others_published) {
  if (!observes_ || !others_published || !others_publish()) {
    untold_.reset();
  } else if (!untold_) {
    untold_ = Clock::now();
  } else if (Clock::now() - *untold_ > kToldTooLate && !has_stalled(life_.board)) {
    life_.fail(Finding::Lost, std::string(kTopic[topic_].name) +
                                  ": an observer is not told that it carries another type");
  }
}

bool Retyper::others_publish() const { return any_lives_with(&NodeRecord::pushers); }

bool Retyper::others_are_there() const {
  return others_publish() || any_lives_with(&NodeRecord::pullers);
}

bool Retyper::any_lives_with(NodeRecord::Ends NodeRecord::*ends) const {
  const auto& nodes = life_.board.nodes;
  return std::any_of(nodes.begin(), nodes.end(),
                     [ends, other = other_shape(topic_)](const NodeRecord& node) {
                       return node.doomed.load() == 0 && (node.*ends)[other].load() != 0;
                     });
}

}  // namespace lot::chaos
