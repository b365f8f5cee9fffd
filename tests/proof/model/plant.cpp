// SPDX-License-Identifier: Apache-2.0
#include "plant.hpp"

#include <charconv>
#include <ostream>
#include <utility>

namespace lot::model {
namespace {

constexpr std::pair<const char*, std::memory_order> kOrders[] = {
    {"relaxed", std::memory_order_relaxed}, {"acquire", std::memory_order_acquire},
    {"release", std::memory_order_release}, {"acq_rel", std::memory_order_acq_rel},
    {"seq_cst", std::memory_order_seq_cst},
};

std::optional<std::memory_order> order_of(std::string_view text) {
  for (const auto& [name, value] : kOrders) {
    if (text == name) return value;
  }
  return std::nullopt;
}

struct NamedPlant {
  const char* name;
  Plant plant;
};

constexpr auto kRelaxed = std::memory_order_relaxed;
constexpr auto kAcqRel = std::memory_order_acq_rel;
constexpr auto kRelease = std::memory_order_release;
constexpr auto kSeqCst = std::memory_order_seq_cst;

// Named by what they are, not by their line: they stay when the headers move.
const NamedPlant kPlants[] = {
    {"publish-release-only",  // R2: no order between publishing and looking at the hazards
     {"ring.hpp", 0, 0, "::publish", Operation::Exchange, kSeqCst, {.order = kRelease}}},
    {"second-look-relaxed",  // R2: the reader's half
     {"ring.hpp", 0, 0, "::poll", Operation::Load, kSeqCst, {.order = kRelaxed}}},
    {"second-look-stale",  // the same look, left out
     {"ring.hpp", 0, 0, "::poll", Operation::Load, kSeqCst, {.stale = true}}},
    {"life-bump-relaxed",  // O2: home sees the bump and not the bit
     {"ownership.hpp", 0, 0, "::acquire(", Operation::Fetch, kRelease, {.order = kRelaxed}}},
    {"life-bump-dropped",  // I3: set the bit, and nobody notices
     {"ownership.hpp", 0, 0, "::acquire(", Operation::Fetch, kRelease, {.drop = true}}},
    {"adopt-without-bump",  // adopting for a dead owner is a hand-over too
     {"ownership.hpp", 0, 0, "::adopt(", Operation::Fetch, kRelease, {.drop = true}}},
    {"wanted-not-said",  // O5: the home waits, and no holder knows
     {"ownership.hpp", 0, 0, "::ask_holders(", Operation::Fetch, kRelease, {.drop = true}}},
    {"joiner-not-announced",  // R4
     {"ring.hpp", 0, 0, "::join", Operation::Fetch, kSeqCst, {.drop = true}}},
    {"taken-without-a-look",  // R10: two readers may take the same message
     {"claims.hpp", 0, 0, "empty(", Operation::CompareExchange, kSeqCst, {.drop = true}}},
    {"evicted-and-left-there",  // R2: its block is used again while the slot still names it
     {"ring.hpp", 0, 0, "::take_out", Operation::Fetch, kSeqCst, {.drop = true}}},
    {"floor-not-told",  // R15: a joiner begins with what is taken back
     {"ring.hpp", 0, 0, "::raise_floor", Operation::Store, kSeqCst, {.drop = true}}},
    {"floor-relaxed",  // R15: the writer looks for joiners before they can see the floor
     {"ring.hpp", 0, 0, "::raise_floor", Operation::Store, kSeqCst, {.order = kRelaxed}}},
    {"marks-not-cleared",  // R5: a late sleeper does not see the end
     {"ring.hpp", 0, 0, "clear_sleeper(", Operation::CompareExchange, kSeqCst, {.drop = true}}},
    // Only lot_weak can find these.
    {"clearing-acq-rel",  // H1: the waker looks for ears before its change can be seen
     {"ring.hpp", 0, 0, "clear_sleeper(", Operation::CompareExchange, kSeqCst, {.order = kAcqRel}}},
    {"no-order-of-news",  // H2: a sleeper sees the news, and not what they are about
     {"ear.hpp", 0, 0, "::tell(", Operation::Fetch, kRelease, {.order = kRelaxed}}},
    {"own-bit-not-told",  // O4: another thread takes the hold for granted, and the bit is not there
     {"ownership.hpp", 0, 0, "::acquire(", Operation::Store, kRelease, {.order = kRelaxed}}},
    {"no-barrier",  // P1, M1
     {"private_model.cpp", 0, 0, "::pass(", Operation::Fetch, kSeqCst, {.drop = true}}},
};

const std::pair<const char*, bool Omissions::*> kOmissions[] = {
    {"no-wake", &Omissions::wake_readers},
    {"no-ring-for-room", &Omissions::ring_for_room},
    {"no-look-at-hazards", &Omissions::hazards},
    {"no-lock-for-joiners", &Omissions::rings_lock},
    {"no-look-at-the-answer", &Omissions::answer},
    {"no-repair-after-a-death", &Omissions::repair},
    {"no-fence-behind-a-copy", &Omissions::fence_of_reader},
    {"no-fence-before-a-message", &Omissions::fence_of_writer},
};

}  // namespace

const char* name_of(std::memory_order order) {
  for (const auto& [name, value] : kOrders) {
    if (value == order) return name;
  }
  return "?";
}

bool Plant::names(const Step& step) const {
  return (line == 0 || step.where.line() == line) &&
         (column == 0 || step.where.column() == column) &&
         (!operation || *operation == step.operation) && (!written || *written == step.order) &&
         std::string_view(step.where.file_name()).ends_with(file) &&
         std::string_view(step.where.function_name()).find(function) != std::string_view::npos;
}

Done Garden::look(const Step& step) {
  if (record_) {
    steps_.try_emplace({step.where.file_name(), step.where.line(), step.where.column()}, step);
  }
  if (!plant_ || !plant_->names(step)) return {step.order, step.failure};
  seen_ = true;
  const Damage& damage = plant_->damage;
  return {damage.order.value_or(step.order), damage.failure.value_or(step.failure), damage.drop,
          damage.stale};
}

bool Garden::plant(std::string_view text) {
  Plant p;
  const auto equals = text.find('=');
  const auto colon = text.find(':');
  if (equals == text.npos || colon == text.npos || colon > equals) return false;
  p.file = text.substr(0, colon);
  const char* const end = text.data() + equals;
  const char* at = text.data() + colon + 1;
  auto number = std::from_chars(at, end, p.line);
  if (number.ec != std::errc() || p.line == 0) return false;
  if (number.ptr != end) {
    if (*number.ptr != ':') return false;
    number = std::from_chars(number.ptr + 1, end, p.column);
    if (number.ec != std::errc() || number.ptr != end) return false;
  }
  std::string_view damage = text.substr(equals + 1);
  if (damage == "drop") {
    p.damage.drop = true;
  } else if (damage == "stale") {
    p.damage.stale = true;
  } else if (damage.starts_with("fail:")) {
    p.damage.failure = order_of(damage.substr(5));
    if (!p.damage.failure) return false;
  } else {
    p.damage.order = order_of(damage);
    if (!p.damage.order) return false;
  }
  plant_ = std::move(p);
  return true;
}

bool Garden::plant_named(std::string_view name) {
  for (const auto& [known, plant] : kPlants) {
    if (name == known) {
      plant_ = plant;
      return true;
    }
  }
  for (const auto& [known, omission] : kOmissions) {
    if (name == known) return omitted.*omission = true;
  }
  return false;
}

void Garden::list_names(std::ostream& out) {
  for (const auto& plant : kPlants) out << "  " << plant.name << '\n';
  for (const auto& omission : kOmissions) out << "  " << omission.first << '\n';
}

void Garden::list_steps(std::ostream& out) const {
  constexpr const char* kNames[] = {"load", "store", "exchange", "fetch", "compare_exchange"};
  for (const auto& [place, step] : steps_) {
    const std::string& file = std::get<0>(place);
    out << "site " << file.substr(file.rfind('/') + 1) << ':' << std::get<1>(place) << ':'
        << std::get<2>(place) << ' ' << kNames[static_cast<int>(step.operation)] << ' '
        << name_of(step.order);
    if (step.operation == Operation::CompareExchange) out << ' ' << name_of(step.failure);
    out << '\n';
  }
}

}  // namespace lot::model
