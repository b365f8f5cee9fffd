// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "tool/commands.hpp"
#include "tool/flow.hpp"
#include "tool/onlooker.hpp"
#include "tool/report.hpp"

/// What `lot hz`, `lot bw` and `lot delay` have in common: they look at each message of a topic,
/// and write a line now and then.
namespace lot::tool {

/// A message that has come.
struct Seen {
  const AnyBorrow& message;
  const Onlooker& from;
  Postmark mark;
  /// How many its publisher has pushed since the last one that was seen, itself too: more than one
  /// where some were missed. 1 of the first one.
  std::uint64_t n;
  Flow::Time now;
};

/// What a verb makes of the messages.
///
/// Threads: one.
class Gauge {
 public:
  using Time = Flow::Time;
  /// A row of text: a cell for each column. One of one cell is a line of its own. The last column
  /// may be of any width.
  using Row = std::vector<std::string>;

  virtual ~Gauge() = default;
  virtual Row head() const = 0;
  /// The topic has this type now: the first one, or another one. What came before is of the past.
  /// Throws lot::Error: EINVAL where the gauge has nothing to tell of this type.
  virtual void begin(const AnyType& type) = 0;
  /// What the gauge tells of a message; nothing: it has none of that. Throws as Value.
  virtual std::optional<std::int64_t> figure(const Seen& seen) = 0;
  /// The message, with its figure.
  virtual void see(const Seen& seen, std::optional<std::int64_t> figure) = 0;
  /// Of all publishers these are there.
  virtual void keep(const std::vector<std::uint64_t>& publishers) = 0;
  /// The rows of a line, of the last seconds or of all that came.
  virtual std::vector<Row> rows(Time now, bool all) = 0;
  /// The same, as members of a document.
  virtual Json document(Time now, bool all) = 0;
  /// False: nothing came that it could tell about.
  virtual bool has_seen_any() const = 0;
};

/// Gives the gauge each message of the topic, and prints what it tells: until the user ends it, the
/// options do, or the program that reads the lines has gone. What is wrong with a message it says,
/// and goes on. Throws lot::Error as Onlooker, and as Gauge::begin() of the first type.
Exit run(const char* command, const Settings& settings, const GaugeOptions& options, Gauge& gauge);

/// "no message for 12 s"
std::string silence_text(const FlowTold& told);
/// What all documents tell of a flow.
Json flow_json(const FlowTold& told);
/// Figures in the unit that is `scale` of theirs; null where there are none.
Json figures_json(const Figures& figures, double scale);

}  // namespace lot::tool
