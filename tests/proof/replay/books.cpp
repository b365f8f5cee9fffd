// SPDX-License-Identifier: Apache-2.0
#include "books.hpp"

#include <algorithm>

namespace lot::replay {
namespace {

std::string n(std::uint64_t number) { return std::to_string(number); }

}  // namespace

long Books::hear(unsigned worker, Tell what, const Arguments& with) {
  switch (what) {
    case Tell::Operation:
      ++operations_;
      break;
    case Tell::Advertise:
      channels_.push_back({worker, with[0], with[1]});
      return static_cast<long>(channels_.size()) - 1;
    case Tell::Unadvertise:
      break;
    case Tell::Subscribe:
      subscribe(worker, with[0]);
      return static_cast<long>(readers_.size()) - 1;
    case Tell::Subscribed:
      subscribed(readers_.at(with[0]));
      break;
    case Tell::Unsubscribe:
      readers_.at(with[0]).has_gone = true;
      break;
    case Tell::Push:
      channels_.at(with[0]).begun = with[1];
      channels_.at(with[0]).is_pushing = true;
      break;
    case Tell::Pushed:
      pushed(channels_.at(with[0]), with[1], with[2] != 0);
      break;
    case Tell::Wait:
      readers_.at(with[0]).waits = true;
      break;
    case Tell::Got:
      got(with[0], with[1], with[2], with[3]);
      break;
    case Tell::GotNone:
      got_none(readers_.at(with[0]), with[1]);
      break;
    case Tell::Put:
      putters_[with[0]].begun = with[1];
      break;
    case Tell::HasPut:
      if (with[2] != 0) putters_[with[0]].done = with[1];
      if (with[2] == 0) putters_[with[0]].begun = with[1] - 1;
      break;
    case Tell::Take:
      taking_.insert(worker);
      break;
    case Tell::Took:
      took(worker, with[0], with[1]);
      break;
    case Tell::TookNone:
      taking_.erase(worker);
      break;
    case Tell::Stage:
    case Tell::Wrong:
      break;  // the conductor's
  }
  return 0;
}

void Books::subscribe(unsigned worker, std::uint64_t topic) {
  readers_.push_back({worker, topic});
  for (std::uint64_t c = 0; c < channels_.size(); ++c) {
    if (channels_[c].topic == topic) readers_.back().at_begin[c] = {channels_[c].done, 0};
  }
}

void Books::subscribed(Reader& reader) {
  reader.is_there = true;
  for (std::uint64_t c = 0; c < channels_.size(); ++c) {
    if (channels_[c].topic != reader.topic) continue;
    reader.at_end.insert(c);
    reader.at_begin[c].second = channels_[c].begun;
  }
}

void Books::pushed(Channel& channel, std::uint64_t number, bool is_done) {
  channel.is_pushing = false;
  if (is_done) {
    channel.done = number;
  } else {
    channel.begun = number - 1;
  }
}

bool Books::is_sure_of(const Reader& reader, std::uint64_t channel) const {
  return reader.is_there && reader.at_end.count(channel) == 0;
}

std::uint64_t Books::begins_behind(const Reader& reader, std::uint64_t channel) const {
  return is_sure_of(reader, channel) ? 0 : reader.at_begin.at(channel).first;
}

void Books::got(std::uint64_t reader, std::uint64_t channel, std::uint64_t number,
                std::uint64_t missed) {
  Reader& r = readers_.at(reader);
  r.waits = false;
  ++messages_;
  const std::string where =
      "reader " + n(reader) + ", channel " + n(channel) + ": message " + n(number);
  if (channel >= channels_.size() || channels_[channel].topic != r.topic) {
    return wrong(where + " is of no channel of its topic");
  }
  if (number > channels_[channel].begun) return wrong(where + " was never pushed");
  const auto known = r.sources.find(channel);
  if (known != r.sources.end()) {
    if (number <= known->second.last) {
      return wrong(where + " came after " + n(known->second.last));
    }
    r.gaps += number - known->second.last - 1;
    known->second.last = number;
  } else {
    const std::uint64_t from = begins_behind(r, channel);
    const std::uint64_t seen =
        is_sure_of(r, channel) ? 0 : std::min(r.at_begin.at(channel).second, number - 1);
    // What was pushed while the reader came may be its or not.
    const std::uint64_t first = std::min(from, number - 1);
    r.gaps += number - 1 - first;
    r.slack += std::max(seen, first) - first;
    r.sources[channel] = {number, 0};
  }
  r.missed = missed;
  look_at_gaps(r);
}

void Books::look_at_gaps(const Reader& r) {
  // A later look may tell of a gap: a message that was passed over in another ring.
  if (r.missed + r.slack < r.gaps) {
    wrong("a reader of topic " + n(r.topic) + " has " + n(r.gaps) + " gaps, " + n(r.slack) +
          " of them perhaps from before it came, and was told of " + n(r.missed) + " missed");
  }
}

void Books::got_none(Reader& reader, std::uint64_t missed) {
  reader.waits = false;
  reader.missed = missed;
}

void Books::took(unsigned worker, std::uint64_t channel, std::uint64_t number) {
  taking_.erase(worker);
  ++messages_;
  const auto it = putters_.find(channel);
  const std::string where = "item " + n(number) + " of " + n(channel);
  if (it == putters_.end() || number > it->second.begun) return wrong(where + " was never put");
  if (!it->second.taken.insert(number).second) return wrong(where + " was taken twice");
  // Of two takers the one that took first may tell it last.
  std::uint64_t& last = last_taken_[{worker, channel}];
  if (number < last) return wrong(where + " was taken after " + n(last) + " by the same worker");
  last = number;
}

void Books::died(unsigned worker) {
  if (taking_.erase(worker) != 0) ++lost_takes_;
  for (Channel& c : channels_) {
    if (c.worker != worker) continue;
    c.was_killed = c.was_killed || c.is_pushing;
    c.is_pushing = false;
  }
  for (Reader& r : readers_) {
    if (r.worker == worker) r.has_gone = true;
  }
}

void Books::drained() {
  for (const Reader& r : readers_) {
    if (r.has_gone || !r.is_there) continue;
    std::uint64_t least = r.gaps - std::min(r.gaps, r.slack), most = r.gaps;
    for (std::uint64_t c = 0; c < channels_.size(); ++c) {
      const Channel& channel = channels_[c];
      if (channel.topic != r.topic) continue;
      const auto known = r.sources.find(c);
      if (known != r.sources.end()) {
        const std::uint64_t last = known->second.last;
        least += channel.done - std::min(channel.done, last);
        most += std::max(channel.done, channel.begun) - std::min(channel.begun, last);
      } else if (is_sure_of(r, c)) {
        least += channel.done;
        most += channel.begun;
      } else {
        const auto& [done, begun] = r.at_begin.at(c);
        least += channel.done - std::min(channel.done, std::max(done, begun));
        most += channel.begun - std::min(channel.begun, done);
      }
    }
    if (r.missed < least || r.missed > most) {
      wrong("a reader of topic " + n(r.topic) + " was told of " + n(r.missed) +
            " missed messages; " + n(least) + " to " + n(most) + " did not come" + places_of(r));
    }
  }
  look_for_items();
}

/// What there is of each channel of the reader's topic, and what the reader has had.
std::string Books::places_of(const Reader& r) const {
  std::string text;
  for (std::uint64_t c = 0; c < channels_.size(); ++c) {
    const Channel& channel = channels_[c];
    if (channel.topic != r.topic) continue;
    const auto known = r.sources.find(c);
    text += "; channel " + n(c) + " of worker " + n(channel.worker) + ": " + n(channel.done) +
            (known == r.sources.end() ? ", none came" : ", the last is " + n(known->second.last));
    if (is_sure_of(r, c)) text += ", all are the reader's";
    if (channel.was_killed) text += ", killed in a push";
  }
  return text;
}

void Books::look_for_items() {
  std::uint64_t lost = 0;
  for (const auto& [channel, p] : putters_) {
    for (std::uint64_t number = 1; number <= p.done; ++number) lost += p.taken.count(number) == 0;
  }
  if (lost > lost_takes_) {
    wrong(n(lost) + " items were put and not taken; " + n(lost_takes_) +
          " takers were killed in a take");
  }
}

bool Books::has_room(std::uint64_t channel) const {
  const Channel& c = channels_[channel];
  for (const Reader& r : readers_) {
    if (r.has_gone || r.topic != c.topic) continue;
    const auto known = r.sources.find(channel);
    const bool has_begun = known != r.sources.end();
    // Not known where it begins: the reader was just coming.
    if (!has_begun && !is_sure_of(r, channel)) return false;
    const std::uint64_t last = has_begun ? known->second.last : 0;
    if (c.done - std::min(c.done, last) >= c.depth) return false;
  }
  return true;
}

void Books::sleeps(unsigned worker) {
  for (std::uint64_t c = 0; c < channels_.size(); ++c) {
    const Channel& channel = channels_[c];
    if (channel.worker != worker || !channel.is_pushing || channel.topic != kLetters) continue;
    if (has_room(c)) {
      wrong("worker " + n(worker) + " sleeps until there is room in channel " + n(c) +
            ", and there is room");
    }
  }
}

void Books::all_asleep() {
  for (const Reader& r : readers_) {
    if (!r.waits || r.has_gone) continue;
    for (const auto& [c, source] : r.sources) {
      if (channels_[c].done <= source.last) continue;
      wrong("all sleep, also worker " + n(r.worker) + ": it waits for a message, and " +
            n(channels_[c].done) + " of channel " + n(c) + " is there");
    }
  }
}

}  // namespace lot::replay
