// SPDX-License-Identifier: Apache-2.0
#include "explorer.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace lot::weak {
namespace {

constexpr std::size_t kStack = 256 * 1024;
/// So many steps without a switch are a thread that waits for others and does not say so.
constexpr unsigned kPatience = 300;

}  // namespace

Explorer::Explorer(const Suite& suite, Search& search, const Limits& limits)
    : suite_(suite),
      search_(search),
      limits_(limits),
      memory_([this](Kind kind, unsigned count) { return choose(kind, count); }) {
  if (suite.threads >= kMostThreads) std::abort();
  for (unsigned i = 0; i <= suite.threads; ++i) {
    Fiber& fiber = fibers_[i];
    fiber.explorer = this;
    fiber.index = i;
    fiber.stack = std::make_unique<char[]>(kStack);
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = fiber.stack.get();
    fiber.context.uc_stack.ss_size = kStack;
    const auto self = reinterpret_cast<std::uintptr_t>(&fiber);
    makecontext(&fiber.context, reinterpret_cast<void (*)()>(&Explorer::enter), 2,
                static_cast<unsigned>(self), static_cast<unsigned>(self >> 32));
  }
  current_ = this;
}

Explorer::~Explorer() { current_ = nullptr; }

/// The first function of a fiber. makecontext() passes numbers of 32 bits only.
void Explorer::enter(unsigned low, unsigned high) {
  auto* fiber = reinterpret_cast<Fiber*>(std::uintptr_t{high} << 32 | low);
  fiber->explorer->live(*fiber);
}

/// One turn for each execution.
void Explorer::live(Fiber& me) {
  for (;;) {
    if (alone_part_ != nullptr) {
      (*alone_part_)();
      leave(me.context);
    } else {
      suite_.thread(me.index);
      me.state_of_run = State::Ended;
      run_next(Kind::Free, false);
    }
  }
}

Outcome Explorer::run() {
  for (;;) {
    execute();
    ++outcome_.executions;
    if (!outcome_.failure.empty()) return outcome_;
    if (!search_.next()) {
      outcome_.complete = true;
      return outcome_;
    }
    if (outcome_.executions >= limits_.executions) return outcome_;
  }
}

void Explorer::execute() {
  begin();
  suite_.make();
  play_alone(suite_.before);
  if (outcome_.failure.empty()) play();
  if (outcome_.failure.empty()) play_alone(suite_.after);
  if (outcome_.failure.empty()) suite_.destroy();
}

void Explorer::begin() {
  search_.begin();
  memory_.clear();
  outcome_.trace.clear();
  outcome_.history.clear();
  questions_ = 0;
  steps_ = alone_for_ = 0;
  ran_ = 0;
  undisturbed_ = 0;
  for (unsigned i = 0; i <= suite_.threads; ++i) {
    fibers_[i].state_of_run = State::Ready;
    fibers_[i].last_ran = 0;
    fibers_[i].state = {};
    fibers_[i].state.index = i;
  }
  running_ = suite_.threads;
}

/// before() or after(), on a fiber too, so that fail() can leave it.
void Explorer::play_alone(const std::function<void()>& part) {
  running_ = suite_.threads;
  Fiber& main = fibers_[running_];
  memory_.set_alone(true);
  alone_part_ = &part;
  swapcontext(&driver_, &main.context);
  alone_part_ = nullptr;
}

/// All threads, until each has ended.
void Explorer::play() {
  Fiber& main = fibers_[suite_.threads];
  for (unsigned i = 0; i < suite_.threads; ++i) Memory::follow(fibers_[i].state, main.state);
  main.state_of_run = State::Ended;
  memory_.set_alone(false);
  running_ = choose(Kind::Free, suite_.threads);
  swapcontext(&driver_, &fibers_[running_].context);
  for (unsigned i = 0; i < suite_.threads; ++i) Memory::follow(main.state, fibers_[i].state);
}

unsigned Explorer::choose(Kind kind, unsigned count) {
  if (count < 2) return 0;
  const unsigned answer = search_.choose(kind, count);
  if (answer != 0) outcome_.trace.emplace_back(questions_, answer);
  ++questions_;
  return answer;
}

void Explorer::count_step() {
  if (++steps_ > limits_.steps) fail("livelock", "the execution does not end");
}

void Explorer::step() {
  if (alone_part_ != nullptr || undisturbed_ > 0) return;
  count_step();
  run_next(Kind::Thread, ++alone_for_ < kPatience);
}

void Explorer::pause() {
  if (alone_part_ != nullptr) fail("livelock", "it waits, and no other thread runs");
  count_step();
  run_next(Kind::Thread, false);
}

void Explorer::sleep(const void* bed) {
  if (alone_part_ != nullptr) fail("deadlock", "it sleeps, and no other thread runs");
  Fiber& me = fibers_[running_];
  me.state_of_run = State::Asleep;
  me.bed = bed;
  run_next(Kind::Free, false);
}

void Explorer::wake(const void* bed) {
  for (unsigned i = 0; i < suite_.threads; ++i) {
    Fiber& fiber = fibers_[i];
    if (fiber.state_of_run == State::Asleep && fiber.bed == bed) fiber.state_of_run = State::Ready;
  }
}

/// Lets a thread run that can: this one first, if it may stay; the others in the order in which
/// they have last run, so that threads that wait for each other all get to run.
void Explorer::run_next(Kind kind, bool may_stay) {
  const unsigned me = running_;
  others_.clear();
  for (unsigned i = 0; i < suite_.threads; ++i) {
    if (i != me && fibers_[i].state_of_run == State::Ready) others_.push_back(i);
  }
  std::sort(others_.begin(), others_.end(), [this](unsigned a, unsigned b) {
    return std::pair(fibers_[a].last_ran, a) < std::pair(fibers_[b].last_ran, b);
  });
  const bool can_stay = fibers_[me].state_of_run == State::Ready;
  if (may_stay) {
    others_.insert(others_.begin(), me);
  } else if (can_stay && others_.empty()) {
    others_.push_back(me);
  }
  if (others_.empty()) {
    const bool all_ended =
        std::all_of(fibers_.begin(), fibers_.begin() + suite_.threads,
                    [](const Fiber& fiber) { return fiber.state_of_run == State::Ended; });
    if (!all_ended) fail("deadlock", "each thread sleeps, or has ended");
    return leave(fibers_[me].context);
  }
  fibers_[me].last_ran = ++ran_;
  switch_to(others_[choose(kind, static_cast<unsigned>(others_.size()))]);
}

void Explorer::switch_to(unsigned next) {
  const unsigned me = running_;
  if (next == me) return;
  running_ = next;
  alone_for_ = 0;
  swapcontext(&fibers_[me].context, &fibers_[next].context);
}

void Explorer::leave(ucontext_t& from) { swapcontext(&from, &driver_); }

void Explorer::fail(const char* what, const std::string& where) {
  outcome_.failure = what;
  outcome_.where = "in thread " + std::to_string(running_) + ' ' + where;
  setcontext(&driver_);
  std::abort();
}

void Explorer::process_barrier() {
  step();
  // Behind what the caller has done, and before what it does next: a barrier of each thread, at
  // some place between two of its steps.
  memory_.fence(thread(), Order::seq_cst);
  for (unsigned i = 0; i < suite_.threads; ++i) memory_.fence(fibers_[i].state, Order::seq_cst);
  memory_.fence(thread(), Order::seq_cst);
}

void Explorer::tell(const char* what, const void* word, Value value, const char* order,
                    const Place& place) {
  const char* const slash = std::strrchr(place.file, '/');
  char line[512];
  std::snprintf(line, sizeof line, "%2u  %-9s %-8s %#18llx at %p, %zu late  %s:%u %.80s\n",
                running_, what, order, static_cast<unsigned long long>(value), word,
                memory_.lateness(), slash == nullptr ? place.file : slash + 1, place.line,
                place.function);
  outcome_.history += line;
}

}  // namespace lot::weak
