// SPDX-License-Identifier: Apache-2.0
#include "tool/activity.hpp"

#include <algorithm>
#include <set>
#include <tuple>

#include "tool/message_bytes.hpp"
#include "tool/rows.hpp"

namespace lot::tool {
namespace {

/// How far one process is behind on one topic, in all queues of the topic together.
struct Behind {
  std::uint32_t process;
  std::uint32_t topic;
  std::uint64_t lag = 0;
  std::uint64_t lost = 0;
  bool holds_back = false;
  std::optional<double> delay = std::nullopt;
};
/// Of two that are as bad the one with the lower index is named, so that it stays the same.
bool is_worse(const Behind& a, const Behind& b) {
  return std::tie(a.holds_back, a.lost, a.lag, b.process, b.topic) >
         std::tie(b.holds_back, b.lost, b.lag, a.process, a.topic);
}

/// The longer one of two times, of which there may be none.
std::optional<double> longer(std::optional<double> a, std::optional<double> b) {
  return std::max(a, b);  // nothing is less than any
}

/// The ones that read queues, the furthest behind first.
std::vector<Behind> readers_of(const Observation& seen) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, Behind> all;
  for (const auto& c : seen.channels) {
    std::map<std::uint32_t, Behind> here;  // a process may have several places in a queue
    for (const Reader& r : c.readers) {
      const Behind one{r.process, c.topic, r.lag, r.lost, r.holds_back};
      const auto [place, is_new] = here.insert({r.process, one});
      auto& worst = place->second;
      const auto delay = longer(worst.delay, r.delay);
      if (!is_new && is_worse(one, worst)) worst = one;
      worst.delay = delay;
    }
    for (const auto& [process, one] : here) {
      Behind& sum = all.insert({{process, c.topic}, {process, c.topic}}).first->second;
      sum.lag += one.lag;
      sum.lost += one.lost;
      sum.holds_back |= one.holds_back;
      sum.delay = longer(sum.delay, one.delay);
    }
  }
  std::vector<Behind> readers;
  for (const auto& [key, reader] : all) readers.push_back(reader);
  std::sort(readers.begin(), readers.end(), is_worse);
  return readers;
}

template <class Wanted>
std::vector<Channel> live_queues(const Observation& seen, Wanted&& wanted) {
  std::vector<Channel> queues;
  std::copy_if(seen.channels.begin(), seen.channels.end(), std::back_inserter(queues),
               [&](const Channel& c) { return !c.orphan && wanted(c); });
  return queues;
}

void add_flow(const std::vector<Channel>& queues, const Rates& rates, const Sizes& sizes,
              Activity& to) {
  to.rate = rate_of(queues, rates);
  for (const auto& c : queues) {
    to.has_stamps |= c.stamps;
    const auto per_second = rate_of(c, rates).per_second;
    const auto bytes = sizes.mean(c);
    if (!per_second || !bytes) continue;
    to.bytes_per_second = to.bytes_per_second.value_or(0) + *per_second * *bytes;
  }
}

void add_worst(const std::vector<Behind>& readers, Activity& to) {
  for (const Behind& reader : readers) {
    to.lag = std::max(to.lag, reader.lag);
    to.lost = std::max(to.lost, reader.lost);
    to.delay = longer(to.delay, reader.delay);
  }
}

std::string name_of(const Observation& seen, std::uint32_t topic) {
  const Topic* found = seen.topic(topic);
  return found != nullptr ? found->name : "?";
}

void judge_topic(const Observation& seen, const std::vector<Channel>& queues,
                 const std::vector<Behind>& readers, Activity& topic) {
  const auto waits =
      std::find_if(queues.begin(), queues.end(), [](const Channel& c) { return c.waits; });
  topic.is_wrong = true;
  if (waits != queues.end()) {
    const bool is_held = !readers.empty() && readers.front().holds_back;
    topic.state = seen.who(waits->publisher) + " waits for " +
                  (is_held ? seen.who(readers.front().process) : "room");
  } else if (topic.lost != 0) {
    topic.state = seen.who(readers.front().process) + " loses messages";
  } else {
    topic.is_wrong = false;
    if (queues.empty()) topic.state = topic.subscribers != 0 ? "no publisher" : "publisher gone";
  }
}

void judge_process(const Observation& seen, const Process& process,
                   const std::vector<Channel>& queues, const std::vector<Behind>& readers,
                   Activity& row) {
  const auto waits =
      std::find_if(queues.begin(), queues.end(), [](const Channel& c) { return c.waits; });
  row.is_wrong = true;
  if (!process.alive) {
    row.state = "dead";
  } else if (waits != queues.end()) {
    row.state = "waits for room in " + name_of(seen, waits->topic);
  } else if (!readers.empty() && readers.front().holds_back) {
    row.state = "holds " + name_of(seen, readers.front().topic) + " back";
  } else if (row.lost != 0) {
    row.state = "loses " + name_of(seen, readers.front().topic);
  } else {
    row.is_wrong = false;
  }
}

}  // namespace

void Sizes::note(const Observation& seen) {
  static constexpr double kKept = 0.7;  ///< of the weight of what was seen before
  std::map<std::uint32_t, const Message*> by_block;
  for (const auto& m : seen.messages) by_block[m.block] = &m;
  std::map<std::pair<std::uint32_t, std::uint32_t>, Sum> sums;
  for (const auto& c : seen.channels) {
    if (c.orphan) continue;
    const Topic* const topic = seen.topic(c.topic);
    const std::uint64_t type_size = topic != nullptr ? topic->type_size : 0;
    const auto before = sums_.find({c.channel, c.generation});
    const bool is_new = before == sums_.end();
    Sum sum = is_new ? Sum() : before->second;
    double bytes = 0;
    double messages = 0;
    const auto add = [&](const Message& m) {
      bytes += static_cast<double>(bytes_by_memory(m.bytes, type_size));
      ++messages;
    };
    for (const auto& q : c.queue) {
      if (!is_new && ring::distance(q.sequence, sum.next) < 0) continue;
      if (q.block == ring::kInSlot) {
        bytes += static_cast<double>(type_size);
        ++messages;
      } else if (const auto found = by_block.find(q.block); found != by_block.end()) {
        add(*found->second);
      }
    }
    if (messages == 0 && sum.messages == 0 && topic != nullptr) {  // readers were faster
      for (const auto& m : seen.messages) {
        if (m.home == c.publisher && m.topic == topic->name) add(m);
      }
    }
    if (messages != 0) {
      sum.bytes = sum.bytes * kKept + bytes;
      sum.messages = sum.messages * kKept + messages;
    }
    sum.next = c.next;
    sums[{c.channel, c.generation}] = sum;
  }
  sums_ = std::move(sums);
}

std::optional<double> Sizes::mean(const Channel& channel) const {
  const auto found = sums_.find({channel.channel, channel.generation});
  if (found == sums_.end() || found->second.messages == 0) return std::nullopt;
  return found->second.bytes / found->second.messages;
}

std::vector<Activity> topics_of(const Observation& seen, const Rates& rates, const Sizes& sizes) {
  const auto all_readers = readers_of(seen);
  std::map<std::string, std::uint64_t> memory;
  for (const auto& m : seen.messages) memory[m.topic] += m.bytes;
  std::vector<Activity> rows;
  for (const auto& topic : seen.topics) {
    if (!topic.used) continue;  // it has observers only
    Activity row;
    row.name = topic.name;
    const auto queues = live_queues(seen, [&](const Channel& c) { return c.topic == topic.index; });
    std::set<std::uint32_t> publishers;
    for (const auto& c : queues) publishers.insert(c.publisher);
    std::vector<Behind> readers;
    std::set<std::uint32_t> subscribers(topic.subscribers.begin(), topic.subscribers.end());
    for (const auto& reader : all_readers) {
      if (reader.topic != topic.index) continue;
      readers.push_back(reader);
      subscribers.insert(reader.process);
    }
    row.publishers = publishers.size();
    row.subscribers = subscribers.size();
    row.memory = memory[topic.name];
    add_flow(queues, rates, sizes, row);
    add_worst(readers, row);
    judge_topic(seen, queues, readers, row);
    rows.push_back(std::move(row));
  }
  return rows;
}

std::vector<Activity> processes_of(const Observation& seen, const Rates& rates,
                                   const Sizes& sizes) {
  const auto all_readers = readers_of(seen);
  std::vector<Activity> rows;
  for (const auto& process : seen.processes) {
    Activity row;
    row.name = seen.who(process.index);
    row.pid = process.pid;
    const auto queues =
        live_queues(seen, [&](const Channel& c) { return c.publisher == process.index; });
    std::set<std::uint32_t> published;
    for (const auto& c : queues) published.insert(c.topic);
    std::vector<Behind> readers;
    std::set<std::uint32_t> read;
    for (const auto& reader : all_readers) {
      if (reader.process != process.index) continue;
      readers.push_back(reader);
      read.insert(reader.topic);
    }
    for (const auto& topic : seen.topics) {
      const auto& subscribers = topic.subscribers;
      if (std::count(subscribers.begin(), subscribers.end(), process.index) != 0) {
        read.insert(topic.index);
      }
    }
    row.publishers = published.size();
    row.subscribers = read.size();
    row.memory = process.bytes;
    add_flow(queues, rates, sizes, row);
    add_worst(readers, row);
    judge_process(seen, process, queues, readers, row);
    rows.push_back(std::move(row));
  }
  return rows;
}

}  // namespace lot::tool
