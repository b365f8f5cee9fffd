// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "tool/observation.hpp"
#include "tool/rates.hpp"

/// What people read as one row. Ten publishers and ten subscribers of one topic are 110 ends, and
/// most of them say the same.
namespace lot::tool {

/// So many that are alike have a row each; more share one.
inline constexpr std::size_t kMostAlike = 3;

/// A queue, or all queues of a topic that are alike. Queues whose publishers have gone look the
/// same to people: they share a row, however few they are.
struct Row {
  std::vector<Channel> channels;  ///< at least one
  Channel sum;  ///< lengths and lags added up; one reader of each process and handle
};
/// `each`: a row for each queue.
std::vector<Row> rows(const std::vector<Channel>& channels, bool each);

/// Nothing is known when the publisher has gone, or its queue is younger than the first look.
Rate rate_of(const Channel& c, const Rates& rates);
/// The rate of all these queues together; nothing is known when nothing is known of one.
Rate rate_of(const std::vector<Channel>& channels, const Rates& rates);
/// "30.0/s", "< 2/s", ""
std::string text_of(const Rate& rate);

/// Readers of a row that are alike.
using Readers = std::vector<Reader>;
std::vector<Readers> groups(const std::vector<Reader>& readers, bool each);

/// Processes of one name, but for the number at its end.
using Processes = std::vector<Process>;
std::vector<Processes> groups(const std::vector<Process>& processes, bool each);
/// "camera", "camera_*": what the names have in common.
std::string common_name(const Processes& group);

/// "3 camera" where all are the same process, else "10 processes".
std::string processes_text(const Observation& seen, const std::vector<std::uint32_t>& indices);
/// "68 MiB of 1012 MiB, 77 of 16384 messages"
std::string fill_text(const Observation& seen);
/// The publisher of a row: "1 camera", "(gone)", "(2 gone)", "10 publishers".
std::string publisher_text(const Observation& seen, const Row& row);

}  // namespace lot::tool
