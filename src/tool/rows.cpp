// SPDX-License-Identifier: Apache-2.0
#include "tool/rows.hpp"

#include <algorithm>
#include <set>

#include "tool/text.hpp"

namespace lot::tool {
namespace {

constexpr double kNegligible = 0.01;  ///< so small a part of a sum does not count

/// Adds the numbers of one queue to those of another, and each reader's numbers to those of the
/// same process. A process that reads by several handles has as many readers in each queue.
void add(const Channel& from, Channel& to) {
  to.depth += from.depth;
  to.unfinished += from.unfinished;
  to.queue.insert(to.queue.end(), from.queue.begin(), from.queue.end());
  std::set<std::size_t> met;
  for (const Reader& r : from.readers) {
    std::size_t i = 0;
    while (i < to.readers.size() && (to.readers[i].process != r.process || met.contains(i))) ++i;
    met.insert(i);
    if (i == to.readers.size()) {
      to.readers.push_back(r);
      continue;
    }
    Reader& same = to.readers[i];
    same.joining |= r.joining;
    same.observes &= r.observes;
    same.awaited |= r.awaited;
    same.holds_back |= r.holds_back;
    same.lag += r.lag;
    same.lost += r.lost;
  }
}

/// Puts those that are alike together, in the order of the first of each kind. A group that
/// `is_one` refuses is taken apart again.
template <class T, class Alike, class IsOne>
std::vector<std::vector<T>> grouped(const std::vector<T>& all, Alike&& alike, IsOne&& is_one) {
  std::vector<std::vector<T>> groups;
  for (const T& t : all) {
    const auto found = std::find_if(groups.begin(), groups.end(),
                                    [&](const auto& group) { return alike(group.front(), t); });
    if (found != groups.end()) {
      found->push_back(t);
    } else {
      groups.push_back({t});
    }
  }
  std::vector<std::vector<T>> result;
  for (auto& group : groups) {
    if (is_one(group)) {
      result.push_back(std::move(group));
    } else {
      for (const T& t : group) result.push_back({t});
    }
  }
  return result;
}

template <class T>
bool are_many(const std::vector<T>& group) {
  return group.size() > kMostAlike;
}

/// "camera_" of "camera_12"
std::string stem(const std::string& name) {
  const auto last = name.find_last_not_of("0123456789");
  return last == name.npos ? name : name.substr(0, last + 1);
}

}  // namespace

std::vector<Row> rows(const std::vector<Channel>& channels, bool each) {
  const auto alike = [](const Channel& a, const Channel& b) {
    return a.topic == b.topic && a.orphan == b.orphan && a.engine == b.engine &&
           a.policy == b.policy && a.taken == b.taken && a.waits == b.waits;
  };
  const auto is_one = [each](const std::vector<Channel>& group) {
    return !each && (group.front().orphan || are_many(group));
  };
  std::vector<Row> all;
  for (auto& group : grouped(channels, alike, is_one)) {
    Row row{{}, group.front()};
    for (std::size_t i = 1; i < group.size(); ++i) add(group[i], row.sum);
    row.channels = std::move(group);
    all.push_back(std::move(row));
  }
  return all;
}

Rate rate_of(const Channel& c, const Rates& rates) {
  const auto found = rates.find({c.channel, c.generation});
  return found != rates.end() && !c.orphan ? found->second : Rate();
}

Rate rate_of(const std::vector<Channel>& channels, const Rates& rates) {
  Rate all;
  double known = 0;
  double bounds = 0;
  bool is_known = true;
  for (const auto& c : channels) {
    const Rate rate = rate_of(c, rates);
    if (!rate.per_second && !rate.below) return {};
    is_known = is_known && rate.per_second;
    known += rate.per_second.value_or(0);
    bounds += rate.per_second ? 0 : *rate.below;
  }
  if (channels.empty()) return {};
  // A publisher that is silent does not hide the rate of the others.
  if (is_known || bounds < kNegligible * known) {
    all.per_second = known;
  } else {
    all.below = known + bounds;
  }
  return all;
}

std::string text_of(const Rate& rate) {
  if (rate.per_second) return rate_text(*rate.per_second);
  return rate.below ? below_text(*rate.below) : "";
}

std::vector<Readers> groups(const std::vector<Reader>& readers, bool each) {
  const auto alike = [](const Reader& a, const Reader& b) {
    return a.joining == b.joining && a.observes == b.observes && a.awaited == b.awaited &&
           a.holds_back == b.holds_back && (a.lost != 0) == (b.lost != 0);
  };
  return grouped(readers, alike, [each](const Readers& group) { return !each && are_many(group); });
}

std::vector<Processes> groups(const std::vector<Process>& processes, bool each) {
  const auto alike = [](const Process& a, const Process& b) {
    return a.alive == b.alive && stem(a.name) == stem(b.name);
  };
  return grouped(processes, alike,
                 [each](const Processes& group) { return !each && are_many(group); });
}

std::string common_name(const Processes& group) {
  const std::string& first = group.front().name;
  const bool all =
      std::all_of(group.begin(), group.end(), [&](const Process& p) { return p.name == first; });
  return all ? first : stem(first) + "*";
}

std::string processes_text(const Observation& seen, const std::vector<std::uint32_t>& indices) {
  const std::set<std::uint32_t> different(indices.begin(), indices.end());
  return different.size() == 1 ? printable(seen.who(*different.begin()), 24)
                               : std::to_string(different.size()) + " processes";
}

std::string fill_text(const Observation& seen) {
  return bytes_text(seen.memory.used) + " of " + bytes_text(seen.memory.total) + ", " +
         std::to_string(seen.blocks.used) + " of " + std::to_string(seen.blocks.total) +
         " messages";
}

std::string publisher_text(const Observation& seen, const Row& row) {
  const std::size_t n = row.channels.size();
  if (n == 1) return printable(seen.who(row.sum.publisher), 24);
  return row.sum.orphan ? "(" + std::to_string(n) + " gone)" : std::to_string(n) + " publishers";
}

}  // namespace lot::tool
