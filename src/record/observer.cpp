// SPDX-License-Identifier: Apache-2.0
#include "record/observer.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <exception>
#include <filesystem>
#include <limits>
#include <new>
#include <sys/stat.h>
#include <thread>
#include <utility>

#include "lot/error.hpp"

#include "record/pattern.hpp"
#include "record/types.hpp"

namespace lot::record {
namespace {

using namespace std::chrono_literals;
using Topic = RecorderStatus::Topic;

constexpr auto kLook = Visits::kSpan;  ///< between two looks for topics
/// So many messages of a topic are taken before another one has its turn.
constexpr std::size_t kAtOnce = 64;
/// A message of so much memory is copied at once: it takes no block while it waits.
constexpr std::uint64_t kSmall = 4096;
/// A part of a quota: of the segment.
constexpr std::uint64_t kPartOfSegment = 8;
constexpr std::uint64_t kAllThereIs = std::numeric_limits<std::uint64_t>::max();

}  // namespace

std::string name_in_file(const std::string& topic) {
  constexpr std::size_t kRun = 8;  // docs/ros.md: RUN, a blank, and a name that begins with /
  const auto is_digit = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
  const bool is_of_ros = topic.size() > kRun + 1 && topic[kRun] == ' ' && topic[kRun + 1] == '/' &&
                         std::all_of(topic.begin(), topic.begin() + kRun, is_digit);
  return is_of_ros ? topic.substr(kRun + 1) : topic;
}

Observer::Observer(const RecorderOptions& options, Join join, Ledger& ledger, const Clock& clock,
                   Backlog& backlog)
    : options_(options),
      join_(std::move(join)),
      ledger_(ledger),
      clock_(clock),
      backlog_(backlog) {}

Observer::~Observer() { leave(); }

void Observer::begin() {
  look();
  has_begun_ = true;
}

void Observer::run(const StopToken& stop) {
  set_.add_timer(kLook, [this] {
    look_and_note();
    choose_visits();
  });
  while (!stop.stop_requested()) {
    try {
      set_.run(stop);
    } catch (const std::exception&) {
      find_faulty();
    }
  }
  look_and_note();
  take_the_rest();
  leave();
}

void Observer::take_the_rest() noexcept {
  for (Subscription& s : subscriptions_) {
    try {
      s.rest = s.puller.size();
    } catch (const std::exception& e) {
      note(s, e);
    }
  }
  end_ = Clock::Steady::now();
  for (Subscription& s : subscriptions_) {
    while (s.rest != 0 && !s.has_gone) {
      const std::size_t taken = take_some(s, std::min(kAtOnce, s.rest));
      if (taken == 0) break;
      s.rest -= std::min(s.rest, taken);
    }
  }
}

// ---- the segment
// ---------------------------------------------------------------------------------

void Observer::join() {
  try {
    participant_ = join_();
  } catch (const Error& e) {
    if (e.error_number() != ENOENT) throw;
    return;  // there is none: the next look asks again
  }
  engine_.emplace(participant_);
  struct stat status {};
  const std::string& path = participant_->segment().path();
  ledger_.joined(path, stat(path.c_str(), &status) == 0 ? status.st_mode : 0);
}

void Observer::leave() {
  for (Subscription& s : subscriptions_) {
    deafen(s);
    s.has_gone = true;
  }
  forget_those_that_have_gone();
  refused_.clear();
  engine_.reset();
  participant_.reset();
  version_.reset();
}

/// Others took this process for dead; or the files of the segment were removed, and others make a
/// new one. Here it stays as long as a publisher does, and no other segment lies in that place.
bool Observer::must_leave() {
  try {
    participant_->check_usable();
    const segment::Segment& segment = participant_->segment();
    if (segment.is_at_its_path()) return false;
    const auto has_publisher = [](Subscription& s) { return s.puller.publishers() != 0; };
    return std::filesystem::exists(segment.path()) ||
           std::ranges::none_of(subscriptions_, has_publisher);
  } catch (const Error& e) {
    if (e.error_number() != ESTALE) throw;
    return true;
  }
}

std::uint64_t Observer::limit() const {
  if (options_.max_held_bytes != 0) return options_.max_held_bytes;
  return participant_->segment().size() / kPartOfSegment;
}

// ---- topics
// --------------------------------------------------------------------------------------

void Observer::look() {
  forget_those_that_have_gone();
  if (participant_ != nullptr && must_leave()) leave();
  if (participant_ == nullptr) join();
  if (participant_ == nullptr) return;
  // Acquire: D1.
  const std::uint32_t version =
      participant_->segment().directory().version.load(std::memory_order_acquire);
  if (version_ == version && !again_) return;
  again_ = false;
  version_ = version;
  find_topics();
}

void Observer::look_and_note() noexcept try { look(); } catch (const std::exception& e) {
  again_ = true;
  try {
    ledger_.went_wrong(e.what());
  } catch (const std::bad_alloc&) {
    // There is not even memory to say so.
  }
}

void Observer::find_topics() {
  for (const std::string& topic : participant_->topics().names()) {
    const auto has = [&](bool is_trigger) {
      return std::ranges::any_of(subscriptions_, [&](const Subscription& s) {
        return s.topic == topic && !s.has_gone && (s.stream == nullptr) == is_trigger;
      });
    };
    const std::string name = name_in_file(topic);
    const bool is_trigger = !options_.trigger.empty() && name == options_.trigger;
    try {
      if (ledger_.expects_more() && engine_->type_of(topic)) ledger_.saw(name);
      if (is_trigger && !has(true)) subscribe(topic, true);
      if (is_chosen(name) && !has(false)) consider(topic);
    } catch (const Error& e) {
      // It has just gone, or has no place for a reader; or its type changes just now.
      again_ = true;
      if (e.error_number() != ENOENT) ledger_.went_wrong(e.what());
    }
  }
}

bool Observer::is_chosen(const std::string& name) const {
  return matches_any(options_.topics, name) && !matches_any(options_.except, name);
}

void Observer::consider(const std::string& topic) {
  const AnyType type = engine_->type_of(topic);
  if (!type) return;
  const auto refused = refused_.find(topic);
  if (refused != refused_.end() && refused->second == type.name()) return;
  try {
    subscribe(topic, false);
    refused_.erase(topic);
  } catch (const Error& e) {
    const bool is_its_type = e.error_number() == EINVAL || e.error_number() == EBADMSG;
    if (!is_its_type) throw;
    refused_[topic] = type.name();
    ledger_.refuse(name_in_file(topic), e.what());
  }
}

void Observer::subscribe(const std::string& topic, bool is_trigger) {
  PullerOptions how;
  how.observer = true;
  how.max_held_bytes = limit();
  // All of what comes later came after the begin. Of what was there the last one: it may be
  // latched.
  how.history = has_begun_ ? kAllThereIs : is_trigger ? 0 : 1;
  AnyPuller puller = engine_->subscribe_any(topic, how);
  std::shared_ptr<const Stream> stream;
  if (!is_trigger) stream = stream_of(topic, puller.type());
  Subscription& s = subscriptions_.emplace_back(std::move(puller));
  s.topic = topic;
  s.stream = std::move(stream);
  if (has_begun_) {
    for (const transport::Source& source : s.core->sources()) s.fresh.push_back(source.name);
  }
  listen(s);
}

void Observer::listen(Subscription& s) {
  if (s.is_listening) return;
  set_.add(s.puller, [this, &s] { take_some(s, kAtOnce); });
  s.is_listening = true;
}

void Observer::deafen(Subscription& s) noexcept {
  if (std::exchange(s.is_listening, false)) set_.remove(s.puller);
}

void Observer::choose_visits() {
  bool is_any = false;
  for (Subscription& s : subscriptions_) {
    if (s.has_gone) continue;
    std::uint32_t depth = std::numeric_limits<std::uint32_t>::max();
    for (const transport::Source& source : s.core->sources()) {
      depth = std::min(depth, source.reader.ring().depth);
    }
    s.visits.decide(depth);
    const bool is_visited = s.visits.by_timer();
    if (!is_visited) listen(s);
    if (is_visited) deafen(s);
    is_any = is_any || is_visited;
  }
  if (is_any && !visiting_) visiting_ = set_.add_timer(Visits::kEvery, [this] { visit(); });
  if (!is_any && visiting_) set_.remove(*std::exchange(visiting_, {}));
}

void Observer::visit() noexcept {
  for (Subscription& s : subscriptions_) {
    if (s.visits.by_timer() && !s.has_gone) take_some(s, kAtOnce);
  }
}

std::shared_ptr<const Stream> Observer::stream_of(const std::string& topic, const AnyType& type) {
  const std::string name = name_in_file(topic);
  for (const auto& stream : streams_) {
    if (stream->name == name && stream->type.known() == type.known()) return stream;
  }
  auto stream = std::make_shared<Stream>(topic, type);
  stream->metadata = pairs_of(type);
  stream->metadata["lot.topic"] = topic;
  stream->line = ledger_.line_of(stream->name, topic, stream->schema.name, stream->metadata);
  streams_.push_back(stream);
  return stream;
}

void Observer::forget_those_that_have_gone() {
  for (Subscription& s : subscriptions_) {
    if (!s.has_gone || s.stream == nullptr) continue;
    const std::uint64_t missed = s.puller.missed_total() - s.told;
    if (missed != 0) ledger_.miss(s.stream->line, missed);
  }
  std::erase_if(subscriptions_, [](const Subscription& s) { return s.has_gone; });
}

/// The set has thrown for one of its pullers, and does not say for which one.
void Observer::find_faulty() noexcept {
  bool is_found = false;
  for (Subscription& s : subscriptions_) {
    try {
      if (!s.has_gone) (void)s.puller.size();
    } catch (const std::exception& e) {
      note(s, e);
      is_found = true;
    }
  }
  if (!is_found) std::this_thread::sleep_for(10ms);  // the next look says what is wrong
}

// ---- messages
// ------------------------------------------------------------------------------------

void Observer::note(Subscription& s, const std::exception& error) noexcept {
  const auto* const known = dynamic_cast<const Error*>(&error);
  try {
    if (known != nullptr && known->error_number() == ESTALE) {
      s.has_gone = true;
      deafen(s);
      again_ = true;
    } else {
      ledger_.went_wrong(error.what());
    }
  } catch (const std::exception&) {
    // There is not even memory to say so.
  }
}

std::size_t Observer::take_some(Subscription& s, std::size_t most) noexcept {
  std::size_t taken = 0;
  const std::uint64_t told = s.told;
  try {
    const std::uint64_t room = backlog_.room(limit());
    for (; taken < most; ++taken) {
      if (batch_held_ != 0 && batch_held_ >= room) break;
      if (!take(s)) break;
    }
  } catch (const std::exception& e) {
    note(s, e);
    ++taken;  // the next look goes on behind what was wrong
  }
  s.visits.took(taken, s.told - told);
  try {
    backlog_.put(batch_);
    batch_held_ = 0;
  } catch (const std::exception& e) {
    for (const Entry& entry : batch_) {
      if (entry.stream != nullptr) ledger_.add(entry.stream->line, &Topic::lost, 1);
    }
    batch_.clear();
    batch_held_ = 0;
    note(s, e);
  }
  return taken;
}

bool Observer::take(Subscription& s) {
  AnyBorrow message = s.puller.try_borrow();
  if (!message) return false;
  if (s.stream == nullptr) {
    batch_.emplace_back();
    return true;
  }
  put_in(s, message);
  return true;
}

/// Of a publisher's first message here: how many it had pushed before.
std::uint64_t Observer::missed_before(Subscription& s, const AnyBorrow& message) {
  if (s.fresh.empty()) return 0;
  const detail::Origin origin = s.core->origin();
  const auto is_it = [&](const registry::ChannelName& name) {
    return name.channel == origin.channel && name.generation == origin.generation;
  };
  const auto found = std::ranges::find_if(s.fresh, is_it);
  if (found == s.fresh.end()) return 0;
  s.fresh.erase(found);
  const std::uint64_t before = message.envelope().sequence;
  return before - std::min(before, message.missed());
}

void Observer::put_in(Subscription& s, AnyBorrow& message) {
  if (end_) *end_ += 1ns;
  const auto now = end_.value_or(Clock::Steady::now());
  const Stream& stream = *s.stream;
  const std::uint64_t missed = message.missed() + missed_before(s, message);
  s.told += message.missed();
  if (options_.max_rate > 0) {
    const auto period = std::chrono::nanoseconds(std::llround(1e9 / options_.max_rate));
    if (now < s.due) {
      if (missed != 0) ledger_.miss(stream.line, missed);
      ledger_.add(stream.line, &Topic::left_out, 1);
      return;
    }
    s.due = s.due + period > now ? s.due + period : now + period;
  }
  Entry entry;
  entry.stream = s.stream;
  entry.head.sequence = ledger_.number(stream.line, missed);
  entry.head.log_time = clock_.at(now);
  const auto pushed = s.core->pushed();
  entry.head.publish_time = pushed ? clock_.at(std::min(*pushed, now)) : entry.head.log_time;
  entry.held = s.core->memory();
  try {
    if (entry.held <= kSmall) {
      put_encoded(stream, message.root(), entry);
    } else {
      try {
        entry.message = message.keep();
      } catch (const OutOfMemory&) {
        put_encoded(stream, message.root(), entry);
      } catch (const Error& e) {
        if (e.error_number() != EDQUOT) throw;
        put_encoded(stream, message.root(), entry);
      }
    }
  } catch (const Error& e) {
    if (e.error_number() == ESTALE) throw;
    ledger_.add(stream.line, &Topic::damaged, 1);
    ledger_.went_wrong(e.what());
    return;
  } catch (const std::bad_alloc&) {
    ledger_.add(stream.line, &Topic::lost, 1);
    throw;
  }
  batch_held_ += entry.held;
  batch_.push_back(std::move(entry));
}

void Observer::put_encoded(const Stream& stream, const Value& message, Entry& entry) {
  encode(stream.program, message, encoded_);
  entry.bytes.reserve(encoded_.size());
  for (const Bytes& piece : encoded_.pieces()) {
    entry.bytes.insert(entry.bytes.end(), piece.begin(), piece.end());
  }
  entry.held = entry.bytes.size();
}

}  // namespace lot::record
