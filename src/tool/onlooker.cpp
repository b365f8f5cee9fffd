// SPDX-License-Identifier: Apache-2.0
#include "tool/onlooker.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <string_view>
#include <thread>
#include <utility>

#include "tool/text.hpp"
#include "tool/writers.hpp"
#include "transport/participant.hpp"
#include "transport/ring_ends.hpp"

namespace lot::tool {
namespace {

using namespace std::chrono_literals;

/// Between two looks for a topic that is not there.
constexpr std::chrono::milliseconds kLook = 100ms;

/// What a segment has of a topic.
enum class Has { Nothing, Observers, Users };
Has what_has(Window& window, const std::string& topic) {
  Has result = Has::Nothing;
  for (const Topic& t : observe(window).topics) {
    if (t.name == topic) result = std::max(result, t.used ? Has::Users : Has::Observers);
  }
  return result;
}

/// A line on standard error.
void say_of(const std::string& what, const std::string& text) {
  std::fprintf(stderr, "* %s: %s\n", shown(what, 200).c_str(), shown(text, kLine).c_str());
}

/// Envelope::publisher_id
std::uint64_t number_of(std::uint32_t channel, std::uint32_t generation) {
  return std::uint64_t{generation} << 32 | channel;
}

}  // namespace

std::shared_ptr<transport::Participant> visit(const Where& where, const std::string& segment,
                                              const std::string& as) {
  EngineOptions options;
  options.directory = where.directory;
  options.segment = segment;
  options.permissions = where.trust.mode;
  if (where.trust.user) options.user = std::to_string(*where.trust.user);
  if (where.trust.group) options.group = std::to_string(*where.trust.group);
  options.name = as;
  return transport::Participant::join(options, transport::IfAbsent::Throw);
}

std::optional<std::string> Search::segment_with(const std::string& topic) {
  std::vector<std::string> found;  // those that have most of it
  Has most = Has::Nothing;
  const auto all = sights(where_);
  for (const Sight& s : all) {
    if (s.window == nullptr) continue;
    const Has has = what_has(*s.window, topic);
    if (has == Has::Nothing || has < most) continue;
    if (has > most) found.clear();
    most = has;
    found.push_back(s.name);
  }
  if (found.size() > 1) {
    throw Error(EINVAL, topic, "the segments " + found[0] + " and " + found[1] + " have this topic",
                "say which one you mean: --segment NAME");
  }
  if (!found.empty()) return found.front();
  for (const Hindrance& h : hindrances(where_, all)) {
    if (!where_.name.empty()) {
      throw Error(h.is_damaged ? EBADMSG : 0, h.path, h.reason, h.advice);
    }
    say_once(h.path, h.reason);
  }
  return std::nullopt;
}

std::string Search::other_name(const std::string& topic) const {
  const std::string other = topic.starts_with('/') ? topic.substr(1) : "/" + topic;
  for (const Sight& s : sights(where_)) {
    if (s.window != nullptr && what_has(*s.window, other) != Has::Nothing) {
      return "there is " + other;
    }
  }
  return "";
}

void Search::say_once(const std::string& path, const std::string& reason) {
  if (said_.insert(path).second) say_of(path, reason);
}

AnyBorrow Onlooker::next(Deadline deadline, const StopToken& stop) {
  for (;;) {
    if (!puller_ && !find(deadline, stop)) return {};
    try {
      AnyBorrow message = puller_->borrow_until(deadline, stop);
      if (message) {
        waits_ = false;
        return message;
      }
      if (leaves_what_was_removed()) continue;
      if (puller_->status() != Status::PublisherGone) return message;
      say_that_it_waits("it has no publisher now");
      if (std::chrono::steady_clock::now() >= deadline) return message;
    } catch (const Error& e) {
      // The topic has another type, or this process was stopped and taken for dead.
      if (e.error_number() != ESTALE) throw;
      leave();
    }
  }
}

/// Other processes do not find a segment whose file was removed: they make another one. Here it
/// stays as long as a publisher does, and no other segment lies in that place.
bool Onlooker::leaves_what_was_removed() {
  const segment::Segment& here = participant_->segment();
  if (here.is_at_its_path()) return false;
  if (puller_->publishers() != 0 && !exists(here.path())) return false;
  say("the files of its segment were removed: looking for it anew");
  leave();
  return true;
}

void Onlooker::leave() noexcept {
  puller_.reset();
  engine_.reset();
  participant_.reset();
}

Postmark Onlooker::postmark() const noexcept {
  const detail::Origin origin = core_->origin();
  return {number_of(origin.channel, origin.generation), origin.sequence, core_->pushed()};
}

const std::string& Onlooker::publisher() const noexcept {
  const detail::Origin origin = core_->origin();
  const auto sources = core_->sources();
  return std::find_if(sources.begin(), sources.end(),
                      [&](const transport::Source& s) {
                        return s.name.channel == origin.channel &&
                               s.name.generation == origin.generation;
                      })
      ->publisher;
}

std::vector<std::uint64_t> Onlooker::publishers_read() const {
  std::vector<std::uint64_t> all;
  if (!puller_) return all;
  for (const auto& s : core_->sources())
    all.push_back(number_of(s.name.channel, s.name.generation));
  return all;
}

std::uint64_t Onlooker::memory() const noexcept { return core_->memory(); }

bool Onlooker::find(Deadline deadline, const StopToken& stop) {
  while (!try_to_find()) {
    say_that_it_waits("no process uses this topic yet");
    constexpr unsigned kSeldom = 10;  // it takes as long as the look before
    if (!has_said_other_ && looks_++ % kSeldom == 0) {
      const std::string other = search_.other_name(topic_);
      has_said_other_ = !other.empty();
      if (has_said_other_) say(other);
    }
    const auto now = std::chrono::steady_clock::now();
    if (stop.stop_requested() || now >= deadline) return false;
    std::this_thread::sleep_for(std::min<std::chrono::nanoseconds>(kLook, deadline - now));
  }
  ++times_;
  const std::string& type = puller_->type().name();
  if (!type_.empty() && type_ != type) say("the topic carries " + type + " now");
  type_ = type;
  waits_ = false;
  if (puller_->publishers() == 0) say_that_it_waits("it has no publisher yet");
  return true;
}

bool Onlooker::try_to_find() {
  const auto segment = search_.segment_with(topic_);
  if (!segment) return false;
  PullerOptions options;
  options.observer = true;
  options.history = history_;
  try {
    participant_ = visit(where_, *segment, as_);
    engine_.emplace(participant_);
    puller_.emplace(engine_->subscribe_any(topic_, options));
    core_ = &detail::PullerAccess::core(*puller_);
    return true;
  } catch (const Error& e) {
    leave();
    if (e.error_number() != ENOENT) throw;  // segment or topic have just gone
    return false;
  }
}

void Onlooker::say_that_it_waits(const char* reason) {
  if (!std::exchange(waits_, true)) say(std::string(reason) + ": waiting (Ctrl-C ends)");
}

void Onlooker::say(const std::string& text) const { say_of(topic_, text); }

void Complaints::note(const Error& error) {
  if (error.error_number() == EBADMSG) {
    exit_ = graver(exit_, kDamaged);
  } else if (error.error_number() != EINVAL) {  // a vector that is too short is well
    exit_ = graver(exit_, kWrong);
  }
  const std::string what = std::to_string(error.error_number()) + error.object();
  if (std::exchange(about_, what) != what) onlooker_.say(reason_of(error));
}

std::string reason_of(const Error& error) {
  const std::string_view all = error.what();
  return std::string(all.substr(all.starts_with("lot: ") ? 5 : 0));
}

}  // namespace lot::tool
