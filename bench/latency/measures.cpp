// SPDX-License-Identifier: Apache-2.0
#include "measures.hpp"

#include <algorithm>
#include <limits>
#include <map>
#include <utility>

namespace ab {
namespace {

constexpr std::string_view kQuiet = " quiet";

double us(std::int64_t ns) { return static_cast<double>(ns) / 1000; }

std::int64_t stamp_of(const Sample& sample, Stamp stamp) {
  switch (stamp) {
    case Stamp::Loan:
      return sample.loaned_at;
    case Stamp::Fill:
      return sample.filled_at;
    case Stamp::Push:
      return sample.pushed_at;
  }
  return 0;
}

constexpr std::uint32_t kFirstBlock = 1;  ///< of a cell; 0 warms up, and is not recorded

using ByBlock = std::map<std::uint32_t, std::vector<double>>;

void collect(ByBlock& into, const Subscriber& subscriber, Stamp stamp) {
  for (const Sample& sample : subscriber.samples) {
    const std::int64_t from = stamp_of(sample, stamp);
    if (from != 0) into[sample.block].push_back(us(sample.entered_at - from));
  }
}

/// Each at its place, since blocks of several arms are paired.
Blocks in_order(ByBlock&& by_block) {
  Blocks blocks;
  if (by_block.empty()) return blocks;
  const std::uint32_t first = std::min(by_block.begin()->first, kFirstBlock);
  blocks.resize(by_block.rbegin()->first - first + 1);
  for (auto& [block, values] : by_block) blocks[block - first] = std::move(values);
  return blocks;
}

}  // namespace

const char* name_of(Stamp stamp) {
  switch (stamp) {
    case Stamp::Loan:
      return "loan";
    case Stamp::Fill:
      return "fill";
    case Stamp::Push:
      return "push";
  }
  return "";
}

Blocks latencies(const Subscriber& subscriber, Stamp stamp) {
  ByBlock by_block;
  collect(by_block, subscriber, stamp);
  return in_order(std::move(by_block));
}

Blocks latencies(const StreamResult& stream, Stamp stamp) {
  ByBlock by_block;
  for (const Subscriber& subscriber : stream.subscribers) collect(by_block, subscriber, stamp);
  return in_order(std::move(by_block));
}

Blocks times_per_message(const StreamResult& stream) {
  ByBlock by_block;
  for (const BlockTime& block : stream.blocks) {
    if (block.messages == 0) continue;
    by_block[block.block].push_back(us(block.took) / static_cast<double>(block.messages));
  }
  return in_order(std::move(by_block));
}

Blocks compared(const StreamResult& stream, Stamp stamp) {
  Blocks times = times_per_message(stream);
  return times.empty() ? latencies(stream, stamp) : times;
}

Blocks compared_tails(const Conditions& conditions, const StreamResult& stream, Stamp stamp) {
  if (conditions.mode == "ping-pong") return latencies(stream, stamp);
  return compared(stream, stamp);
}

Blocks fairness_gaps(const StreamResult& stream) {
  struct Entries {
    std::int64_t first = std::numeric_limits<std::int64_t>::max();
    std::int64_t last = std::numeric_limits<std::int64_t>::min();
    std::size_t count = 0;
    std::uint32_t block = 0;
    unsigned by = std::numeric_limits<unsigned>::max();  // whom it reached last
  };
  if (stream.subscribers.size() < 2) return {};
  std::map<std::pair<std::uint32_t, std::uint64_t>, Entries> messages;
  for (const Subscriber& subscriber : stream.subscribers) {
    for (const Sample& sample : subscriber.samples) {
      Entries& entries = messages[{sample.publisher, sample.number}];
      if (entries.by == subscriber.index) continue;  // twice: a mistake that others tell of
      entries.by = subscriber.index;
      entries.first = std::min(entries.first, sample.entered_at);
      entries.last = std::max(entries.last, sample.entered_at);
      entries.block = sample.block;
      ++entries.count;
    }
  }
  ByBlock by_block;
  for (const auto& [message, entries] : messages) {
    if (entries.count != stream.subscribers.size()) continue;
    by_block[entries.block].push_back(us(entries.last - entries.first));
  }
  return in_order(std::move(by_block));
}

std::uint64_t sent(const StreamResult& stream) {
  std::uint64_t sum = 0;
  for (const Publisher& publisher : stream.publishers) sum += publisher.sent;
  return sum;
}

Costs costs(const StreamResult& stream) {
  const auto per = [](const auto& nodes, std::uint64_t messages) {
    Cost cost;
    if (messages == 0) return cost;
    const auto each = static_cast<double>(messages);
    for (const auto& node : nodes) {
      const Usage& usage = node.usage;
      cost.cpu_us += usage.cpu_us / each;
      cost.voluntary_switches += static_cast<double>(usage.voluntary_switches) / each;
      cost.involuntary_switches += static_cast<double>(usage.involuntary_switches) / each;
      cost.faults += static_cast<double>(usage.minor_faults + usage.major_faults) / each;
      cost.copied_bytes += static_cast<double>(usage.copied_bytes) / each;
    }
    return cost;
  };
  const std::uint64_t messages = sent(stream);
  return {per(stream.publishers, messages),
          per(stream.subscribers, messages * stream.subscribers.size())};
}

Costs costs_net_of(const StreamResult& stream, const StreamResult* pace) {
  Costs net = costs(stream);
  if (pace == nullptr) return net;
  const Costs idle = costs(*pace);
  const auto subtract = [](Cost& from, const Cost& what) {
    from.cpu_us -= what.cpu_us;
    from.voluntary_switches -= what.voluntary_switches;
    from.involuntary_switches -= what.involuntary_switches;
    from.faults -= what.faults;
  };
  subtract(net.publisher, idle.publisher);
  subtract(net.subscriber, idle.subscriber);
  return net;
}

Blocks cpu_per_message(const StreamResult& stream, const StreamResult* pace) {
  const auto by_block = [](const StreamResult& of) {
    ByBlock costs;
    for (const BlockCost& block : of.block_costs) {
      if (block.sent == 0) continue;
      costs[block.block] = {(block.publishers_us + block.subscribers_us) /
                            static_cast<double>(block.sent)};
    }
    return costs;
  };
  ByBlock costs = by_block(stream);
  if (pace != nullptr) {
    const ByBlock idle = by_block(*pace);
    for (auto& [block, cost] : costs) {
      if (const auto at = idle.find(block); at != idle.end()) cost[0] -= at->second[0];
    }
  }
  return in_order(std::move(costs));
}

std::optional<Ratio> ratio_of_cpu(const StreamResult& of, const StreamResult* pace,
                                  const StreamResult& to, const StreamResult* pace_of_to) {
  const Blocks above = cpu_per_message(of, pace);
  const Blocks below = cpu_per_message(to, pace_of_to);
  if (summarise(above).median <= 0) return std::nullopt;
  return ratio_of_quantiles(above, below, 0.5);
}

double messages_per_second(const StreamResult& stream) {
  const Summary times = summarise(times_per_message(stream));
  return times.count == 0 || times.median <= 0 ? 0 : 1e6 / times.median;
}

const Arm* find(const Cell& cell, std::string_view transport) {
  for (const Arm& arm : cell.arms) {
    if (arm.transport == transport && arm.refused.empty()) return &arm;
  }
  return nullptr;
}

const StreamResult* find(const Cell& cell, std::string_view transport, std::string_view stream) {
  const Arm* arm = find(cell, transport);
  if (arm == nullptr) return nullptr;
  for (const StreamResult& candidate : arm->streams) {
    if (candidate.name == stream) return &candidate;
  }
  return nullptr;
}

std::string quiet(const std::string& transport) { return transport + std::string(kQuiet); }

bool is_quiet(std::string_view arm) { return arm.ends_with(kQuiet); }

std::string transport_of(const std::string& arm) {
  return is_quiet(arm) ? arm.substr(0, arm.size() - kQuiet.size()) : arm;
}

std::string beside(const std::string& arm, const std::string& transport) {
  return is_quiet(arm) ? quiet(transport) : transport;
}

bool sends_nothing(const std::string& arm) {
  const std::string transport = transport_of(arm);
  return transport == kFloorPace || transport == kFloorRos;
}

const StreamResult* pace_of(const Cell& cell, const std::string& arm, const std::string& stream) {
  if (sends_nothing(arm)) return nullptr;
  if (arm.starts_with("ros-")) {
    if (const auto* nodes = find(cell, beside(arm, kFloorRos), stream)) return nodes;
  }
  return find(cell, beside(arm, kFloorPace), stream);
}

bool has_failed(std::string_view refused) { return refused.starts_with("failed: "); }

}  // namespace ab
