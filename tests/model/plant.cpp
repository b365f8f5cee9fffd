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

std::memory_order one_weaker(std::memory_order order) {
  return order == std::memory_order_seq_cst ? std::memory_order_acq_rel : std::memory_order_relaxed;
}

struct NamedPlant {
  const char* name;
  Plant plant;
};

// Named by what they are, not by their line: they stay when the headers move.
const NamedPlant kPlants[] = {
    {"publish-release-only",  // R2: no order between publishing and looking at the hazards
     {"ring.hpp", 0, "::publish", Operation::Exchange, std::memory_order_seq_cst,
      std::memory_order_release}},
    {"second-look-relaxed",  // R2: the reader's half
     {"ring.hpp", 0, "::poll", Operation::Load, std::memory_order_seq_cst,
      std::memory_order_relaxed}},
    {"life-bump-relaxed",  // O2: home sees the bump and not the bit
     {"ownership.hpp", 0, "::acquire(", Operation::Fetch, std::memory_order_release,
      std::memory_order_relaxed}},
    {"life-bump-dropped",  // I3: set the bit, and nobody notices
     {"ownership.hpp", 0, "::acquire(", Operation::Fetch, std::memory_order_release, {}, true}},
    {"adopt-without-bump",  // adopting for a dead owner is a hand-over too
     {"ownership.hpp", 0, "::adopt(", Operation::Fetch, std::memory_order_release, {}, true}},
    {"joiner-not-announced",  // R4
     {"ring.hpp", 0, "::join", Operation::Fetch, std::memory_order_seq_cst, {}, true}},
    {"marks-not-cleared",  // R5: a late sleeper does not see the end
     {"ring.hpp", 0, "::clear_sleepers", Operation::Fetch, std::memory_order_release, {}, true}},
};

const std::pair<const char*, bool Omissions::*> kOmissions[] = {
    {"no-wake", &Omissions::wake_readers},
    {"no-ring-for-room", &Omissions::ring_for_room},
    {"no-look-at-hazards", &Omissions::hazards},
    {"no-lock-for-joiners", &Omissions::rings_lock},
};

}  // namespace

const char* name_of(std::memory_order order) {
  for (const auto& [name, value] : kOrders) {
    if (value == order) return name;
  }
  return "?";
}

bool Plant::names(const Step& step) const {
  return std::string_view(step.where.file_name()).ends_with(file) &&
         (line == 0 || step.where.line() == line) &&
         std::string_view(step.where.function_name()).find(function) != std::string_view::npos &&
         (!operation || *operation == step.operation) && (!written || *written == step.order);
}

Done Garden::look(const Step& step) {
  if (record_) {
    steps_.try_emplace({step.where.file_name(), step.where.line(), step.where.column()}, step);
  }
  if (!plant_) return {step.order};
  const std::tuple place{step.where.file_name(), unsigned{step.where.line()},
                         unsigned{step.where.column()}};
  const auto [known, is_new] = named_.try_emplace(place, false);
  if (is_new) known->second = plant_->names(step);
  if (!known->second) return {step.order};
  seen_ = true;
  return {plant_->instead.value_or(one_weaker(step.order)), plant_->drop};
}

bool Garden::plant(std::string_view text) {
  const auto colon = text.rfind(':');
  if (colon == std::string_view::npos) return false;
  const auto equals = text.find('=', colon);
  Plant p;
  p.file = text.substr(0, colon);
  const auto number = text.substr(colon + 1, equals == text.npos ? text.npos : equals - colon - 1);
  const auto end = number.data() + number.size();
  if (std::from_chars(number.data(), end, p.line).ptr != end || p.line == 0) return false;
  if (equals != std::string_view::npos) {
    const auto order = text.substr(equals + 1);
    p.drop = order == "drop";
    for (const auto& [name, value] : kOrders) {
      if (order == name) p.instead = value;
    }
    if (!p.drop && !p.instead) return false;
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
    out << file.substr(file.rfind('/') + 1) << ':' << std::get<1>(place) << ' '
        << kNames[static_cast<int>(step.operation)] << ' ' << name_of(step.order) << '\n';
  }
}

}  // namespace lot::model
