// SPDX-License-Identifier: Apache-2.0
#include "node.hpp"

#include <cerrno>
#include <chrono>
#include <utility>

#include "support/block_words.hpp"
#include "support/must_go.hpp"
#include "support/processes.hpp"
#include "support/topic_types.hpp"
#include "transport/participant.hpp"
#include "types.hpp"

namespace lot::kill {

using namespace std::chrono_literals;

Number numbered(std::uint64_t source, std::uint64_t number) {
  return {source, number, source * 0x9e3779b97f4a7c15U + number * 0xff51afd7ed558ccdU};
}

PullerOptions observing(std::uint64_t history) {
  PullerOptions options{Wait::Park, history};
  options.observer = true;
  return options;
}

bool intact(const Number& message) {
  return message.check == numbered(message.source, message.number).check;
}

namespace {
constexpr std::uint64_t kProbeItems = 7;  ///< the source of items that are not in the books
}

void Account::complain(const std::string& what) {
  if (complaint_.empty()) complaint_ = what;
}

void Account::enter(const Number& message, std::uint64_t missed) {
  if (!intact(message) || message.source >= kSources) {
    complain("a torn message");
    return;
  }
  const auto source = static_cast<std::size_t>(message.source);
  const bool may_begin_anywhere = late_ && !seen_[source];
  if (!may_begin_anywhere && message.number != next_[source] + missed) {
    complain("message " + std::to_string(message.number) + " of source " + std::to_string(source) +
             " after " + std::to_string(next_[source]) + " and " + std::to_string(missed) +
             " missed ones");
  }
  seen_[source] = true;
  next_[source] = message.number + 1;
  missed_ += missed;
}

std::uint64_t Account::last(std::uint64_t source) const {
  return next_[static_cast<std::size_t>(source)];
}

void Node::join() { engine.emplace(options); }

void Node::drop_all() {
  borrow.end();
  over = true;
  if (sleeper.joinable()) sleeper.join();
  set.reset();
  quiet.clear();
  disarm();
  tasks.reset();
  queue.reset();
  own.reset();
  weak.reset();
  kept.clear();
  loans.clear();
  frame_loans.clear();
  frame_puller.reset();
  frames.reset();
  puller.reset();
  ear.reset();
  nameless.reset();
  other.reset();
  for (const std::uint32_t topic : std::exchange(fillers, {})) {
    transport::Participant::join(options)->topics().leave(topic);
  }
  second.reset();
  pusher.reset();
  selected.reset();
  selecting.reset();
}

void Node::disarm() {
  drop_probes();
  probe_slots_queue.reset();
  probe_slots_puller.reset();
  probe_slots.reset();
  probe_queue.reset();
  probe_frames.reset();
  probe_observer.reset();
  probe_block_puller.reset();
  probe_puller.reset();
  probe_block.reset();
  probe_again.reset();
  probe_pusher.reset();
}

void Node::drop_probes() {
  probe_borrow.end();
  probe_loan.reset();
  if (!probe_loans.empty()) {
    probe_loans.clear();
    transport::Participant::join(options)->stock().trim(
        transport::Stock::kNobody);  // its pools would keep all blocks
  }
  probe_kept.reset();
  probe_copy.reset();
  probe_weak.reset();
}

bool Node::reads_now() const { return puller && !sleeper.joinable() && !borrow; }

bool Node::waits_at_home() const {
  const auto participant = transport::Participant::join(options);
  bool any = false;
  for (std::uint32_t b = 0; b < participant->blocks(); ++b) {
    const auto& words = participant->world().block(b);
    any |= test::home_waits(words) && words.home.load() == participant->index() + 1;
  }
  return any;
}

bool Node::home_waits() const {
  if (kept.empty()) return false;
  const auto participant = transport::Participant::join(options);
  const auto& words =
      participant->world().block(detail::PointerAccess::control(kept.front())->block);
  return test::home_waits(words) && words.home.load() != participant->index() + 1;
}

void Node::leave() {
  drop_all();
  engine.reset();
}

void Node::publish(unsigned count) {
  for (unsigned i = 0; i < count; ++i) {
    if (selecting) {
      auto letter =
          detail::build<Number>(selecting->core().loan(detail::message_type<Number>(), true));
      *letter = numbered(source, published);
      const ShmSharedPtr<const Number> shared(std::move(letter));
      auto* const cell = detail::PointerAccess::control(shared);
      if (selecting->core().push_shared(cell, shared.get(), {10s}) == Status::Ok) ++published;
      continue;
    }
    auto message = pusher->loan(numbered(source, published));
    if (ear) {
      publish_heard(std::move(message));
    } else if (pusher->push(std::move(message), 10s) == Status::Ok) {
      ++published;
    }
  }
}

/// There is room at once: the only reader that counts has read all before. It gets this one, too.
void Node::publish_heard(ShmUniquePtr<Number> message) {
  if (pusher->try_push(std::move(message)) != Status::Ok) {
    return account.complain("a publisher waits for an observer");
  }
  const auto heard = ear->try_borrow();
  if (!heard || heard->number != published || heard.missed() != 0) {
    account.complain("a reader misses a message beside an observer");
  }
  ++published;
}

void Node::observe(const char* topic, std::uint64_t history) {
  puller.emplace(engine->subscribe<Number>(topic, observing(history)));
  reads_topic = std::string_view(topic) == kTopic;
}

void Node::hear(const char* topic) { ear.emplace(engine->subscribe<Number>(topic)); }

void Node::enter_halves(std::uint32_t from, std::uint32_t to) {
  auto& topics = transport::Participant::join(options)->topics();
  for (std::uint32_t n = from; n < to; ++n) {
    fillers.push_back(topics.enter("/half" + std::to_string(n), half(n)));
  }
}

std::optional<Description> Node::look_up(const char* topic) const {
  const auto found = transport::Participant::join(options)->topics().type_of(topic);
  if (!found) return std::nullopt;
  const Description& description = found->description();  // throws where it is damaged
  if (found->type().described(found->type()).bytes.empty()) return std::nullopt;
  return description;
}

void Node::publish_watched() {
  const ShmSharedPtr<const Number> message(pusher->loan(numbered(source, published)));
  weak = message;
  watched = true;
  if (pusher->push(message, 10s) == Status::Ok) ++published;
}

bool Node::receive() {
  const auto message = puller->try_borrow();
  if (!message) return false;
  account.enter(*message, message.missed());
  return true;
}

void Node::receive_all() {
  while (receive()) {
  }
}

void Node::sleep_on_topic() {
  sleeper = std::thread([this] {
    for (;;) {
      const auto message = puller->borrow(100ms);
      if (message) {
        account.enter(*message, message.missed());
      } else if (puller->try_borrow()) {
        account.complain("a message that did not wake its reader");
      } else if (puller->status() == Status::PublisherGone) {
        return;
      }
    }
  });
  await_sleeper();
}

void Node::listen() {
  constexpr std::size_t kMoreThanFew = 9;
  set.emplace();
  set->add(*puller, [this] { receive_all(); });
  for (std::size_t i = 0; i < kMoreThanFew; ++i) {
    quiet.push_back(std::make_unique<ShmPuller<Number>>(engine->subscribe<Number>(kQuiet)));
    set->add(*quiet.back(), [] {});
  }
}

void Node::listen_until_the_end() {
  listen();
  sleeper = std::thread([this] {
    while (!over && puller->status() != Status::PublisherGone) set->run_once(100ms);
  });
  await_sleeper();
}

void Node::sleep_for_room() {
  sleeper = std::thread([this] {
    auto message = pusher->loan(numbered(source, published));
    if (pusher->push(std::move(message), 20s) == Status::Ok) {
      ++published;
    } else {
      account.complain("a publisher that nobody lets go on");
    }
  });
  await([](const segment::Ring& ring) { return (ring.space->load() & 1) != 0; });
}

void Node::await_sleeper() {
  await([](const segment::Ring& ring) {
    if (ring.arrived != nullptr) return (ring.arrived->load() & 1) != 0;
    for (std::uint32_t i = 0; i < ring.places(); ++i) {
      if ((ring.slots[i].load() & ring::kSleeper) != 0) return true;
    }
    return false;
  });
}

void Node::await(const std::function<bool(const segment::Ring&)>& mark) const {
  const auto participant = transport::Participant::join(options);
  const bool stands = testing::eventually([&] {
    for (std::uint32_t c = 0; c < participant->world().channels(); ++c) {
      const auto ring = participant->world().ring(c);
      if (ring.depth != 0 && mark(ring)) return true;
    }
    return false;
  });
  testing::must(stands, "somebody fell asleep");
}

void Node::open_queue(const QueueOptions& opts) {
  queue.emplace(engine->queue<Number>(kItems, opts));
  locked = opts.engine == QueueEngine::Mutex;
  redelivers = opts.redeliver;
}

void Node::put(unsigned count) {
  for (unsigned i = 0; i < count; ++i) {
    if (queue->put_for(numbered(source, put_items), 20s) == Status::Ok) ++put_items;
  }
}

void Node::enter_item(const Number& item) {
  if (!intact(item)) return account.complain("a torn item");
  const std::uint64_t bit = std::uint64_t{1} << item.number;
  if ((items.fetch_or(bit) & bit) != 0) {
    account.complain("item " + std::to_string(item.number) + " came twice");
  }
}

std::optional<Number> Node::next_item(std::chrono::milliseconds most) {
  if (!redelivers) return queue->wait_and_pop_for(most);
  auto task = queue->wait_and_take_for(most);
  if (!task) return std::nullopt;
  const Number item = *task;
  task.finish();
  return item;
}

bool Node::pop() {
  const auto item = next_item(0ms);
  if (item) enter_item(*item);
  return item.has_value();
}

void Node::contend() {
  if (queue) {
    pop();
    return;
  }
  kept.push_back(puller->try_pull());
  if (kept.back()) account.enter(*kept.back(), puller->missed());
  receive_all();
}

void Node::take_work() {
  work = queue->try_take();
  testing::must(static_cast<bool>(work), "there is a task");
}

void Node::sleep_on_queue() {
  sleeper = std::thread([this] {
    while (!over) {
      if (const auto item = next_item(100ms)) {
        enter_item(*item);
      } else if (pop()) {
        account.complain("an item that did not wake its reader");
      }
    }
  });
  await_sleeper();
}

void Node::sleep_to_put() {
  sleeper = std::thread([this] {
    const std::uint64_t before = put_items;
    put();
    if (put_items == before) account.complain("somebody who puts and whom nobody lets go on");
  });
  await([](const segment::Ring& ring) { return (ring.space->load() & 1) != 0; });
}

void Node::advertise_selecting(const char* topic, const PusherOptions& opts) {
  selecting = detail::make_selecting_pusher(transport::Participant::join(options), topic,
                                            detail::message_type<Number>(), opts);
}

void Node::subscribe_selected(const char* topic) {
  selected = detail::make_selecting_puller(transport::Participant::join(options), topic,
                                           detail::message_type<Number>(),
                                           {Wait::Park, ~std::uint64_t{0}});
  selected->core().size();  // it has looked for rings
  reads_topic = std::string_view(topic) == kTopic;
}

void Node::select(const char* name, std::size_t back) {
  reader = selecting->select(name, back);
  testing::must(reader.has_value(), "there is a reader to be selected");
}

void Node::read_selected() {
  for (;;) {
    detail::Borrowed borrowed;
    if (selected->core().borrow(borrowed, lot::detail::Limit::now()) != Status::Ok) return;
    const detail::Origin origin = selected->origin();
    const auto& number = *static_cast<const Number*>(borrowed.root);
    account.enter(number, borrowed.missed);
    letters.push_back({number, origin, selected->is_ours(origin)});
    selected->core().done();
    resent += selected->resent("the victim");
  }
}

void Node::hold(bool borrowing) {
  auto message = puller->borrow(10s);
  testing::must(bool(message), "there is a message to hold");
  account.enter(*message, message.missed());
  held = *message;
  if (borrowing) {
    borrow = std::move(message);
  } else {
    kept.push_back(message.keep());
  }
}

void Node::reap() {
  const auto participant = transport::Participant::join(options);
  participant->reaper().reap_dead();
  participant->reaper().collect();
}

void Node::arm() {
  const auto in_blocks = [](Policy policy, std::uint32_t depth) {
    PusherOptions pushing{policy, depth, 1s};
    pushing.fast_lane = false;
    return pushing;
  };
  probe_pusher.emplace(engine->advertise<Number>("/probe", in_blocks(Policy::Overwrite, 2)));
  probe_again.emplace(engine->advertise<Number>("/probe", in_blocks(Policy::Overwrite, 1)));
  probe_puller.emplace(engine->subscribe<Number>("/probe"));
  probe_frames.emplace(engine->advertise<Frame>("/probe-frames", {Policy::Overwrite, 1, 1s}));
  testing::must_go(probe_pusher->push(probe_pusher->loan(numbered(7, 0))));
  (void)probe_puller->try_borrow();  // and ends it
  probe_block.emplace(engine->advertise<Number>("/probe-block", in_blocks(Policy::Block, 1)));
  probe_block_puller.emplace(engine->subscribe<Number>("/probe-block"));
  probe_observer.emplace(engine->subscribe<Number>("/probe-block", observing()));
  QueueOptions putting{2, Policy::Overwrite};
  putting.fast_lane = false;
  probe_queue.emplace(engine->queue<Number>("/probe-items", putting));
  testing::must_go(probe_queue->put(numbered(7, 0)));
  (void)probe_queue->try_pop();  // and drops it
  arm_in_slots();
}

void Node::arm_in_slots() {
  PusherOptions pushing{Policy::Overwrite, 2, 1s};
  pushing.fast_lane = true;
  probe_slots.emplace(engine->advertise<Number>("/probe-slots", pushing));
  probe_slots_puller.emplace(engine->subscribe<Number>("/probe-slots"));
  testing::must_go(probe_slots->push(probe_slots->loan(numbered(7, 0))));
  (void)probe_slots_puller->try_pull();  // and drops it
  QueueOptions putting{2, Policy::Overwrite};
  putting.fast_lane = true;
  probe_slots_queue.emplace(engine->queue<Number>("/probe-slots-items", putting));
  testing::must_go(probe_slots_queue->put(numbered(7, 0)));
  (void)probe_slots_queue->try_pop();  // and drops it
}

void Node::inspect() {
  using testing::must;
  if (ear) publish(4);  // before the dead one is reaped, too
  drop_probes();
  reap();
  if (held) {
    const Number* there = borrow ? borrow.get() : kept.front().get();
    must(intact(*there) && there->number == held->number, "a held message did not change");
    borrow.end();
  }
  if (watched) {  // its home's warden looks once a second
    must(testing::eventually([&] { return weak.expired(); }, 3s),
         "a message dies that nobody holds any more");
  }
  if (nameless) inspect_names();
  if (!fillers.empty()) inspect_room();
  if (retypes) {
    inspect_other_type();
  } else if (queue) {
    inspect_queue();
  } else if (selected) {
    inspect_selected();
  } else if (sleeper.joinable()) {
    sleeper.join();  // it ends when it has been woken and has found the end
  } else if (puller) {
    const bool ended = testing::eventually([&] {
      const auto message = puller->try_borrow();
      if (message) account.enter(*message, message.missed());
      return !message && puller->status() == Status::PublisherGone;
    });
    must(ended, "the reader learned that its publisher is gone");
  }
  auto frame = inspect_frames();
  if (pusher && ear) {
    publish(6);
  } else if (pusher) {
    for (int i = 0; i < 6; ++i) {
      auto message = pusher->loan(numbered(source, published));
      must(pusher->push(std::move(message), 20s) == Status::Ok, "nobody holds the publisher back");
      ++published;
    }
  }
  if (selecting) {
    must(!reader || !selecting->wants(*reader), "the dead want nothing");
    must(!selecting->expects("the victim"), "the dead are not expected");
    must(!selecting->select("the victim", 0), "the dead are not selected");
    if (reader) selecting->deselect(*reader, 1);
    const std::uint64_t before = published;
    publish(6);
    must(published == before + 6, "nobody holds up a publisher that selects its readers");
  }
  if (frame) {
    must(intact(*frame->reference), "what a message refers to outlives new messages");
    frame.reset();
    reap();  // it was the orphanage's: the warden would come by later
  }
  must(account.complaint().empty(), account.complaint().c_str());
}

/// What was said to be a reader's own follows each other, is what it must be, and stays that.
void Node::inspect_selected() {
  using testing::must;
  const bool ended = testing::eventually([&] {
    read_selected();
    return !selected->has_publisher("the victim");
  });
  must(ended, "the reader learned that its publisher is gone");
  resent += selected->resent("the victim");
  std::uint64_t count = 0;
  std::uint64_t last = 0;
  for (Letter& letter : letters) {
    // Who has died says nothing more: what was not said is not its own.
    if (!letter.ours) letter.ours = selected->is_ours(letter.origin).value_or(false);
    const std::uint64_t n = letter.number.number;
    must(*letter.ours || n < due_from || n >= due_to, "what was said to be a reader's is its own");
    if (!*letter.ours) continue;
    must(n >= may_from && n < may_to, "what was not said to be a reader's is not its own");
    must(count == 0 || n == last + 1, "what is a reader's own follows each other");
    last = n;
    ++count;
  }
  must(resent <= count, "only what was a reader's own is sent once more");
  must(!selected->has_remaining("the victim"), "nothing is left unread");
}

/// The topic has one whole type, with names or without. A process that knows names may join if the
/// topic has the same ones, or none.
void Node::inspect_names() {
  using testing::must;
  const auto names = [this] {
    const auto found = transport::Participant::join(options)->topics().type_of(kTopic);
    return found->type().described(found->type()).names;
  };
  const auto& type = detail::message_type<Number>();
  const std::uint64_t before = names();
  const std::uint64_t ours = type.described(type).names;
  bool may_join = true;
  try {
    pusher.emplace(engine->advertise<Number>(kTopic, {Policy::Overwrite, 4, 1s}));
  } catch (const Error& e) {
    must(e.error_number() == EPROTOTYPE, e.what());
    may_join = false;
  }
  must(may_join == (before == 0 || before == ours), "names decide which process may join");
  must(names() == (before == 0 ? ours : before), "a topic keeps its names");
  const auto description = look_up(kTopic);
  must(description && description->names_hash() == names(),
       "the description has the topic's names");
  nameless.reset();  // it never looks
}

/// The topic carries frames now. An observer of the former one is told so.
void Node::inspect_other_type() {
  using testing::must;
  frames.reset();
  auto sends = engine->advertise<Frame>(kTopic, {Policy::Overwrite, 2, 1s});
  auto& segment = transport::Participant::join(options)->segment();
  const std::string wrong = testing::wrong_types(segment);  // the former one is whole, too
  must(wrong.empty(), wrong.c_str());
  if (puller) {
    must(testing::eventually([this] { return is_superseded(); }), "an observer learns of the type");
    puller.reset();
  }
  auto looks_on = engine->subscribe<Frame>(kTopic, observing());
  testing::must_go(sends.push(sends.loan()));
  must(bool(looks_on.pull(10s)), "a message of the new type comes");
}

/// True when a look says so. Reads what came before, and learns that its publisher has gone.
bool Node::is_superseded() {
  try {
    receive_all();
    receive_all();
  } catch (const Error& e) {
    testing::must(e.error_number() == ESTALE, e.what());
    return true;
  }
  return false;
}

/// When the topics have gone that filled the table, as many descriptions of the largest size find
/// room as it can have.
void Node::inspect_room() {
  disarm();
  const auto participant = transport::Participant::join(options);
  for (const std::uint32_t topic : std::exchange(fillers, {})) participant->topics().leave(topic);
  for (std::uint32_t n = 0; n < kLargest; ++n) {
    fillers.push_back(participant->topics().enter("/largest" + std::to_string(n), largest(n)));
    const auto& entry = participant->segment().topics()[fillers.back()];
    testing::must(entry.description.load() != 0, "room for descriptions comes back");
  }
}

/// All items that nobody has taken are ours, and there is room for more.
void Node::inspect_queue() {
  over = true;
  if (work) {
    enter_item(*work);
    work.finish();
  }
  // Not try_pop(): who has found the registry busy does not look for queues for a while.
  const auto pop_or_wait = [this] {
    const auto item = next_item(20ms);
    if (item) enter_item(*item);
    return item.has_value();
  };
  do {
    while (pop_or_wait()) {  // so that who puts goes on
    }
  } while (sleeper.joinable() && (sleeper.join(), true));
  // What the dead had put for itself waits for whoever comes.
  auto left = engine->queue<ShmUniquePtr<Number>>(kLeft);
  while (const auto item = left.try_pop()) {
    if (!intact(**item)) account.complain("a torn item that waited");
  }
  if (put_items == 0) return;
  std::uint64_t popped = 0;
  for (int i = 0; i < 6; ++i) {
    testing::must(queue->put_for(numbered(kProbeItems, 0), 20s) == Status::Ok,
                  "nobody holds up who puts");
    const auto item = next_item(0ms);
    popped += item && item->source == kProbeItems;
  }
  testing::must(popped == 6, "one's own items came");
}

/// All frames that came; the last one stays.
ShmSharedPtr<const Frame> Node::inspect_frames() {
  ShmSharedPtr<const Frame> last;
  if (!frame_puller) return last;
  const bool ended = testing::eventually([&] {
    auto frame = frame_puller->try_pull();
    if (!frame) return frame_puller->status() == Status::PublisherGone;
    ++frames_seen;
    testing::must(bool(frame->reference), "a message refers to what its sender gave it");
    testing::must(intact(*frame->reference), "a message that another one refers to is whole");
    last = std::move(frame);
    return false;
  });
  testing::must(ended, "the reader of frames learned that its publisher is gone");
  return last;
}

void Node::live_again() {
  account.joined_late();
  join();
  pusher.emplace(engine->advertise<Number>(kTopic, {Policy::Overwrite, 4, 1s}));
  puller.emplace(engine->subscribe<Number>(kOther));
  publish(3);
  receive_all();
}

void Node::meet() {
  for (const char* topic : {kTopic, kOther, kFrames}) look_up(topic);  // none is damaged
  if (!puller) return;
  const bool all = testing::eventually([&] {
    const auto message = puller->borrow(50ms);
    if (message) account.enter(*message, message.missed());
    return account.last(kSecondLife) == 3;
  });
  testing::must(all, "the second life's messages came");
  testing::must(account.complaint().empty(), account.complaint().c_str());
}

void Node::start() {
  join();
  pusher.emplace(engine->advertise<Number>(kTopic, {Policy::Overwrite, 4, 1s}));
  puller.emplace(engine->subscribe<Number>(kTopic));
  publish(3);
  receive_all();
  testing::must(account.last(source) == 3, "one's own messages came");
}

const char* name_of(Promise promise) {
  switch (promise) {
    case Promise::WaitFree:
      return "wait-free";
    case Promise::LockFree:
      return "lock-free";
    case Promise::Blocking:
      return "blocking";
  }
  return "?";
}

}  // namespace lot::kill
