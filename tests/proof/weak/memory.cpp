// SPDX-License-Identifier: Apache-2.0
#include "memory.hpp"

#include <ostream>

namespace lot::weak {
namespace {

/// Between two messages that stand beside each other: room for many to come in between.
constexpr Stamp kStep = Stamp{1} << 40;

bool acquires(Order order) { return order != Order::relaxed && order != Order::release; }
bool releases(Order order) {
  return order == Order::release || order == Order::acq_rel || order == Order::seq_cst;
}

}  // namespace

// ---- SeqCst
// --------------------------------------------------------------------------------------

void SeqCst::clear() {
  before_.clear();
  for (auto& steps : of_thread_) steps.clear();
  fence_ = -1;
}

SeqCst::Set SeqCst::before(const Thread& thread) const {
  Set all;
  if (fence_ >= 0) add_with_before(all, static_cast<Id>(fence_));
  for (unsigned t = 0; t < kMostThreads; ++t) {
    const auto& steps = of_thread_[t];
    for (auto step = steps.rbegin(); step != steps.rend(); ++step) {
      if (step->first > thread.now.strongly.of[t]) continue;
      add_with_before(all, step->second);  // and its thread's earlier ones
      break;
    }
  }
  return all;
}

SeqCst::Id SeqCst::enter(const Thread& thread, const Set& before, const std::vector<Id>& after) {
  const auto id = static_cast<Id>(before_.size());
  before_.push_back(before);
  of_thread_[thread.index].emplace_back(thread.clock, id);
  if (after.empty()) return id;
  Set me = before;
  me.set(id);
  for (std::size_t other = 0; other < id; ++other) {
    const bool follows = std::any_of(after.begin(), after.end(),
                                     [&](Id a) { return other == a || before_[other].test(a); });
    if (follows) before_[other] |= me;
  }
  return id;
}

SeqCst::Id SeqCst::enter_fence(const Thread& thread) {
  Set all;
  for (std::size_t id = 0; id < before_.size(); ++id) all.set(id);
  fence_ = static_cast<int>(before_.size());
  return enter(thread, all, {});
}

// ---- Location
// ------------------------------------------------------------------------------------

void Location::clear() {
  messages_.clear();
  for (auto& seen : seen_) seen.clear();
  strict_.clear();
  fenced_ = 0;
}

void Location::begin(Value value) { messages_.push_back({value, kStep, false, {}}); }

Stamp Location::bound(const Thread& thread) const {
  Stamp bound = 0;
  for (unsigned t = 0; t < kMostThreads; ++t) {
    const auto& seen = seen_[t];
    for (auto s = seen.rbegin(); s != seen.rend(); ++s) {
      if (s->clock > thread.now.happens.of[t]) continue;
      bound = std::max(bound, s->stamp);  // its thread has seen nothing newer before
      break;
    }
  }
  return bound;
}

void Location::note(const Thread& thread, Stamp stamp) {
  auto& seen = seen_[thread.index];
  if (seen.empty() || seen.back().stamp < stamp) seen.push_back({thread.clock, stamp});
}

std::size_t Location::first_at(Stamp stamp) const {
  std::size_t i = messages_.size() - 1;
  while (i > 0 && messages_[i - 1].stamp >= stamp) --i;
  return i;
}

bool Location::is_open(std::size_t i) const {
  return is_last(i) ||
         (!messages_[i + 1].follows && messages_[i + 1].stamp - messages_[i].stamp > 1);
}

Stamp Location::behind(std::size_t i) const {
  const Stamp stamp = messages_[i].stamp;
  return is_last(i) ? stamp + kStep : stamp + (messages_[i + 1].stamp - stamp) / 2;
}

// ---- Memory
// --------------------------------------------------------------------------------------

Memory::Mistakes Memory::mistakes_;

const std::pair<const char*, bool Memory::Mistakes::*> Memory::kMistakes[] = {
    {"rmw-is-a-fence", &Mistakes::fences},      {"newest-only", &Mistakes::newest},
    {"stores-in-a-row", &Mistakes::row},        {"no-coherence", &Mistakes::incoherent},
    {"no-seq-cst", &Mistakes::unordered},       {"seq-cst-in-turn", &Mistakes::in_turn},
    {"no-release-sequence", &Mistakes::broken}, {"rmw-not-atomic", &Mistakes::split},
    {"no-release-fence", &Mistakes::silent},
};

bool Memory::make_mistake(std::string_view name) {
  for (const auto& [known, mistake] : kMistakes) {
    if (name == known) return mistakes_.*mistake = true;
  }
  return false;
}

void Memory::list_mistakes(std::ostream& out) {
  for (const auto& mistake : kMistakes) out << "  " << mistake.first << '\n';
}

void Memory::clear() {
  for (Location* location : all_) free_.push_back(location);
  all_.clear();
  strict_.clear();
  alone_ = true;
}

Location& Memory::make() {
  if (free_.empty()) free_.push_back(owned_.emplace_back(std::make_unique<Location>()).get());
  Location& location = *free_.back();
  free_.pop_back();
  location.clear();
  all_.push_back(&location);
  return location;
}

void Memory::give_back(Location& location) {
  const auto found = std::find(all_.rbegin(), all_.rend(), &location);
  if (found == all_.rend()) return;
  *found = all_.back();
  all_.pop_back();
  free_.push_back(&location);
}

void Memory::tick(Thread& thread) {
  ++thread.clock;
  thread.now.happens.of[thread.index] = thread.clock;
}

/// Which seq_cst steps on this word come directly before and behind a step of that place, and
/// whether the graph would stay without a cycle. Of these steps each is ordered behind those of
/// smaller places already, so that the neighbours are enough.
struct Neighbours {
  SeqCst::Set before;
  std::vector<SeqCst::Id> after;
};

namespace {

template <class Strict>
Neighbours neighbours(const SeqCst& graph, const Thread& thread, const std::vector<Strict>& steps,
                      std::pair<Stamp, bool> place) {
  Neighbours found{graph.before(thread), {}};
  const auto by_place = [](const Strict& step, const auto& p) { return step.place < p; };
  const auto first = std::lower_bound(steps.begin(), steps.end(), place, by_place);
  for (auto s = first; s != steps.begin() && (s - 1)->place == (first - 1)->place; --s) {
    graph.add_with_before(found.before, (s - 1)->id);
  }
  auto next = first;
  while (next != steps.end() && next->place == place) ++next;
  for (auto s = next; s != steps.end() && s->place == next->place; ++s)
    found.after.push_back(s->id);
  return found;
}

}  // namespace

bool Memory::fits(const Thread& thread, const Location& at, const Option& option) const {
  if (option.order != Order::seq_cst || alone_) return true;
  if (at.is_last(option.message)) return true;  // nothing comes behind it
  if (mistakes_.unordered) return true;
  if (mistakes_.in_turn) return at.strict_.empty();
  if (strict_.is_full()) return false;
  const auto place = option.writes ? std::pair(at.behind(option.message), false)
                                   : std::pair(at.messages_[option.message].stamp, true);
  const Neighbours near = neighbours(strict_, thread, at.strict_, place);
  return std::none_of(near.after.begin(), near.after.end(),
                      [&](SeqCst::Id id) { return near.before.test(id); });
}

/// Leaves one of the options that judge(message) allows, from the newest on.
template <class Judge>
Memory::Option Memory::choose(Thread& thread, Location& at, Judge&& judge) {
  tick(thread);
  options_.clear();
  std::size_t first = at.first_at(at.bound(thread));
  if (mistakes_.incoherent) first = 0;
  for (std::size_t i = at.messages_.size(); i-- > first;) {
    const Option option = judge(i);
    if (option.writes && !at.is_open(i) && !(mistakes_.split && option.reads)) continue;
    if (!at.is_last(i) && (option.writes ? mistakes_.row : mistakes_.newest)) continue;
    if (option.order == Order::seq_cst && !alone_ && at.messages_[i].stamp < at.fenced_) continue;
    if (fits(thread, at, option)) options_.push_back(option);
  }
  const unsigned chosen =
      options_.size() == 1 ? 0 : choose_(Kind::Value, static_cast<unsigned>(options_.size()));
  lateness_ = at.messages_.size() - 1 - options_[chosen].message;
  return options_[chosen];
}

void Memory::enter_strict(const Thread& thread, Location& at, std::pair<Stamp, bool> place) {
  if (alone_ || strict_.is_full()) return;
  const Neighbours near = neighbours(strict_, thread, at.strict_, place);
  const SeqCst::Id id = strict_.enter(thread, near.before, near.after);
  const auto by_place = [](const auto& p, const Location::Strict& step) { return p < step.place; };
  at.strict_.insert(std::upper_bound(at.strict_.begin(), at.strict_.end(), place, by_place),
                    {place, id});
}

void Memory::read(Thread& thread, Location& at, std::size_t message, Order order) {
  const Message& from = at.messages_[message];
  at.note(thread, from.stamp);
  thread.read.join(from.view);
  if (acquires(order)) thread.now.join(from.view);
}

void Memory::write(Thread& thread, Location& at, const Option& option, Value value) {
  Message made{value, at.behind(option.message), option.reads, {}};
  // A seq_cst step is not strongly before what acquires it, but what comes before it is: so far,
  // the thread's own clock there is that of the step before.
  made.view = releases(option.order) ? thread.now : mistakes_.silent ? View{} : thread.fenced;
  if (option.reads && !mistakes_.broken) made.view.join(at.messages_[option.message].view);
  at.note(thread, made.stamp);
  const auto place = at.messages_.begin() + static_cast<std::ptrdiff_t>(option.message) + 1;
  at.messages_.insert(place, made);
}

Value Memory::load(Thread& thread, Location& at, Order order) {
  const Option option = choose(thread, at, [order](std::size_t i) {
    return Option{i, true, false, order};
  });
  if (order == Order::seq_cst) {
    enter_strict(thread, at, {at.messages_[option.message].stamp, true});
  }
  read(thread, at, option.message, order);
  thread.now.strongly.of[thread.index] = thread.clock;
  return at.messages_[option.message].value;
}

void Memory::store(Thread& thread, Location& at, Value value, Order order) {
  if (at.is_empty()) return at.begin(value);
  const Option option = choose(thread, at, [order](std::size_t i) {
    return Option{i, false, true, order};
  });
  if (order == Order::seq_cst) enter_strict(thread, at, {at.behind(option.message), false});
  write(thread, at, option, value);
  thread.now.strongly.of[thread.index] = thread.clock;
}

Value Memory::change(Thread& thread, Location& at, const Change& change, Order order) {
  const Option option = choose(thread, at, [order](std::size_t i) {
    return Option{i, true, true, order};
  });
  if (order == Order::seq_cst) enter_strict(thread, at, {at.behind(option.message), false});
  const Value old = at.messages_[option.message].value;
  read(thread, at, option.message, order);
  write(thread, at, option, change(old));
  thread.now.strongly.of[thread.index] = thread.clock;
  if (mistakes_.fences && !alone_) fence(thread, Order::seq_cst);
  return old;
}

bool Memory::compare_exchange(Thread& thread, Location& at, Value& expected, Value desired,
                              Order success, Order failure) {
  const Option option = choose(thread, at, [&](std::size_t i) {
    const bool equal = at.messages_[i].value == expected;
    return Option{i, true, equal, equal ? success : failure};
  });
  if (option.order == Order::seq_cst) {
    enter_strict(thread, at,
                 option.writes ? std::pair(at.behind(option.message), false)
                               : std::pair(at.messages_[option.message].stamp, true));
  }
  expected = at.messages_[option.message].value;
  read(thread, at, option.message, option.order);
  if (option.writes) write(thread, at, option, desired);
  thread.now.strongly.of[thread.index] = thread.clock;
  return option.writes;
}

void Memory::fence(Thread& thread, Order order) {
  tick(thread);
  if (acquires(order)) thread.now.join(thread.read);
  if (order == Order::seq_cst && !alone_) {
    for (Location* at : all_) {
      if (at->is_empty()) continue;
      const Stamp strict = at->strict_.empty() ? 0 : at->strict_.back().place.first;
      const Stamp floor = std::max({strict, at->fenced_, at->bound(thread)});
      at->note(thread, floor);
      at->fenced_ = floor;
    }
    if (!strict_.is_full()) strict_.enter_fence(thread);
  }
  thread.now.strongly.of[thread.index] = thread.clock;
  if (releases(order)) thread.fenced = thread.now;
}

}  // namespace lot::weak
