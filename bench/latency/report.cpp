// SPDX-License-Identifier: Apache-2.0
#include "report.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ostream>
#include <vector>

#include "rivals.hpp"

namespace ab {
namespace {

// ---- a table of words ---------------------------------------------------------------------------

/// Columns as wide as their widest word; the first one to the left, the others to the right.
class Table {
 public:
  explicit Table(std::vector<std::string> head) : rows_{std::move(head)} {}
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  void print(std::ostream& out) const {
    std::vector<std::size_t> widths(rows_.front().size());
    for (const auto& row : rows_) {
      for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
    }
    for (const auto& row : rows_) {
      std::string line = " ";
      for (std::size_t i = 0; i < row.size(); ++i) {
        const std::string gap(widths[i] - row[i].size(), ' ');
        line += i == 0 ? row[i] + gap : "  " + gap + row[i];
      }
      line.erase(line.find_last_not_of(' ') + 1);
      out << line << '\n';
    }
  }

 private:
  std::vector<std::vector<std::string>> rows_;
};

std::string with_digits(double value, int digits) {
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", digits, value);
  return text;
}

std::string per_message(double value) {
  if (std::abs(value) < 0.0005) return "0";
  return number(value);
}

std::string bytes_word(double bytes) {
  if (bytes < 1) return "0";
  if (bytes < 1024) return with_digits(bytes, 0) + " B";
  if (bytes < 1024 * 1024) return with_digits(bytes / 1024, 1) + " KiB";
  return with_digits(bytes / (1024 * 1024), 1) + " MiB";
}

std::string ratio_word(const std::optional<Ratio>& ratio) {
  return ratio ? ab::ratio_word(*ratio) : "-";
}

// ---- counts -------------------------------------------------------------------------------------

bool adds_up(const Arm& arm, const StreamResult& stream, const Subscriber& subscriber) {
  if (subscriber.spoilt != 0) return false;
  if (sends_nothing(arm.transport)) return true;
  return sent(stream) == subscriber.received + subscriber.missed + subscriber.lost;
}

void complain(std::ostream& out, const Cell& cell) {
  for (const Arm& arm : cell.arms) {
    for (const StreamResult& stream : arm.streams) {
      for (const Subscriber& subscriber : stream.subscribers) {
        if (adds_up(arm, stream, subscriber)) continue;
        out << "  *** WRONG: " << arm.transport << (stream.name.empty() ? "" : " ") << stream.name
            << ", subscriber " << subscriber.index << ": ";
        if (subscriber.spoilt != 0) out << subscriber.spoilt << " payloads were spoilt; ";
        out << sent(stream) << " sent, " << subscriber.received << " received + "
            << subscriber.missed << " missed + " << subscriber.lost
            << " lost = " << subscriber.received + subscriber.missed + subscriber.lost << " ***\n";
      }
    }
  }
}

// ---- the tables of a cell -----------------------------------------------------------------------

std::string row_name(const Arm& arm, const StreamResult& stream) {
  return stream.name.empty() ? arm.transport : arm.transport + " " + stream.name;
}

struct Counts {
  std::uint64_t received = 0;
  std::uint64_t missed = 0;
  std::uint64_t lost = 0;
};

/// What a row of arrivals is made of.
struct Arrival {
  std::string name;
  std::string due;
  Counts counts;
  Blocks middle;  ///< for the median, and ratios of it
  Blocks tail;
};

void print_arrivals(std::ostream& out, const Cell& cell, const ReportOptions& options) {
  Table table(
      {"us", "sent", "received", "missed", "lost", "median", "p99", "max", "x spin", "x futex"});
  const auto add = [&](const Arrival& arrival, const Arm& arm, const std::string& stream) {
    std::vector<std::string> row{arrival.name, arrival.due, std::to_string(arrival.counts.received),
                                 std::to_string(arrival.counts.missed),
                                 std::to_string(arrival.counts.lost)};
    const Summary typical = summarise(arrival.middle);
    const Summary worst = summarise(arrival.tail);
    row.push_back(typical.count == 0 ? "-" : number(typical.median));
    row.push_back(worst.count == 0 ? "-" : number(worst.p99));
    row.push_back(worst.count == 0 ? "-" : number(worst.max));
    for (const char* floor : {kFloorSpin, kFloorFutex}) {
      const StreamResult* bound = find(cell, beside(arm.transport, floor), stream);
      row.push_back(bound == nullptr ? "-"
                                     : ratio_word(ratio_of_quantiles(
                                           arrival.middle, compared(*bound, options.stamp), 0.5)));
    }
    table.add(std::move(row));
  };
  for (const Arm& arm : cell.arms) {
    if (sends_nothing(arm.transport)) continue;
    for (const StreamResult& stream : arm.streams) {
      const std::string due = std::to_string(sent(stream));
      if (!options.per_subscriber) {
        Counts all;
        for (const Subscriber& subscriber : stream.subscribers) {
          all.received += subscriber.received;
          all.missed += subscriber.missed;
          all.lost += subscriber.lost;
        }
        const std::size_t readers = stream.subscribers.size();
        add({row_name(arm, stream), readers == 1 ? due : due + " x" + std::to_string(readers), all,
             compared(stream, options.stamp),
             compared_tails(cell.conditions, stream, options.stamp)},
            arm, stream.name);
        continue;
      }
      for (const Subscriber& subscriber : stream.subscribers) {
        // As if it were alone; the clock of whole blocks is no subscriber's.
        StreamResult alone;
        alone.subscribers = {subscriber};
        alone.blocks = stream.blocks;
        add({row_name(arm, stream) + " s" + std::to_string(subscriber.index),
             due,
             {subscriber.received, subscriber.missed, subscriber.lost},
             compared(alone, options.stamp),
             compared_tails(cell.conditions, alone, options.stamp)},
            arm, stream.name);
      }
    }
  }
  table.print(out);
}

std::string p_word(const std::optional<double>& p) {
  if (!p) return "-";
  return *p < 0.001 ? "<0.001" : with_digits(*p, 3);
}

/// Ratios of median and p99 to another stream of the cell, and the rank test's p.
void add_ratios(std::vector<std::string>& row, const Cell& cell, const ReportOptions& options,
                const StreamResult& own, const StreamResult& other) {
  const Blocks a = compared(own, options.stamp);
  const Blocks b = compared(other, options.stamp);
  row.push_back(ratio_word(ratio_of_quantiles(a, b, 0.5)));
  row.push_back(
      ratio_word(ratio_of_quantiles(compared_tails(cell.conditions, own, options.stamp),
                                    compared_tails(cell.conditions, other, options.stamp), 0.99)));
  row.push_back(p_word(p_of_block_medians(a, b)));
}

void print_beside_ring(std::ostream& out, const Cell& cell, const ReportOptions& options) {
  Table table({"x ring", "median", "p99", "rank p"});
  bool any = false;
  for (const Arm& arm : cell.arms) {
    if (transport_of(arm.transport) == kRing || sends_nothing(arm.transport)) continue;
    for (const StreamResult& stream : arm.streams) {
      const StreamResult* ring = find(cell, beside(arm.transport, kRing), stream.name);
      if (ring == nullptr) continue;
      any = true;
      std::vector<std::string> row{row_name(arm, stream)};
      add_ratios(row, cell, options, stream, *ring);
      table.add(std::move(row));
    }
  }
  if (!any) return;
  out << "   beside ring; p is that of block medians\n";
  table.print(out);
}

void print_costs(std::ostream& out, const Cell& cell) {
  Table table(
      {"a message", "cpu us pub / sub", "cpu x ring", "switches", "faults", "copied", "M/s"});
  for (const Arm& arm : cell.arms) {
    for (const StreamResult& stream : arm.streams) {
      std::vector<std::string> row{row_name(arm, stream)};
      const StreamResult* pace = pace_of(cell, arm.transport, stream.name);
      const Costs cost = costs_net_of(stream, pace);
      const auto switches = [](const Cost& of) {
        return of.voluntary_switches + of.involuntary_switches;
      };
      const auto both = [&](double publisher, double subscriber) {
        row.push_back(per_message(publisher) + " / " + per_message(subscriber));
      };
      both(cost.publisher.cpu_us, cost.subscriber.cpu_us);
      const StreamResult* ring = find(cell, beside(arm.transport, kRing), stream.name);
      row.push_back(
          ring == nullptr || ring == &stream || sends_nothing(arm.transport)
              ? "-"
              : ratio_word(ratio_of_cpu(stream, pace, *ring,
                                        pace_of(cell, beside(arm.transport, kRing), stream.name))));
      both(switches(cost.publisher), switches(cost.subscriber));
      both(cost.publisher.faults, cost.subscriber.faults);
      const auto readers = static_cast<double>(stream.subscribers.size());
      row.push_back(
          bytes_word(cost.publisher.copied_bytes + cost.subscriber.copied_bytes * readers));
      const double rate = messages_per_second(stream);
      row.push_back(rate > 0 ? number(rate / 1e6) : "-");
      table.add(std::move(row));
    }
  }
  table.print(out);
  for (const Arm& arm : cell.arms) {
    if (arm.daemon_cpu_us == 0 || arm.streams.empty()) continue;
    std::uint64_t messages = 0;
    for (const StreamResult& stream : arm.streams) messages += sent(stream);
    out << "  beside it, the daemon of " << arm.transport << " used "
        << number(arm.daemon_cpu_us / static_cast<double>(std::max<std::uint64_t>(messages, 1)))
        << " us of processor time a message\n";
  }
}

/// What others on the machine do to a transport: its streams with all topics, and without those
/// that are there to disturb.
void print_disturbance(std::ostream& out, const Cell& cell, const ReportOptions& options) {
  Table table({"x quiet", "median", "p99", "rank p"});
  bool any = false;
  for (const Arm& arm : cell.arms) {
    if (sends_nothing(arm.transport) || is_quiet(arm.transport)) continue;
    for (const StreamResult& stream : arm.streams) {
      const StreamResult* quiet_one = find(cell, quiet(arm.transport), stream.name);
      if (quiet_one == nullptr) continue;
      any = true;
      std::vector<std::string> row{row_name(arm, stream)};
      add_ratios(row, cell, options, stream, *quiet_one);
      table.add(std::move(row));
    }
  }
  if (!any) return;
  out << "   with the cameras, beside the same without them (quiet)\n";
  table.print(out);
}

/// Of messages that all subscribers got, from the first one's entry to the last one's.
void print_fairness(std::ostream& out, const Cell& cell) {
  Table table({"gap us", "messages", "median", "p99", "max", "x ring", "x futex"});
  bool any = false;
  for (const Arm& arm : cell.arms) {
    for (const StreamResult& stream : arm.streams) {
      const Blocks gaps = fairness_gaps(stream);
      const Summary summary = summarise(gaps);
      if (summary.count == 0) continue;
      any = true;
      std::vector<std::string> row{row_name(arm, stream), std::to_string(summary.count),
                                   number(summary.median), number(summary.p99),
                                   number(summary.max)};
      for (const char* other : {kRing, kFloorFutex}) {
        const StreamResult* result = find(cell, beside(arm.transport, other), stream.name);
        row.push_back(result == nullptr || transport_of(arm.transport) == other
                          ? "-"
                          : ratio_word(ratio_of_quantiles(gaps, fairness_gaps(*result), 0.5)));
      }
      table.add(std::move(row));
    }
  }
  if (!any) return;
  out << "   between the first and the last subscriber's entry\n";
  table.print(out);
}

void print_refused(std::ostream& out, const Cell& cell) {
  for (const Arm& arm : cell.arms) {
    if (!arm.refused.empty()) out << "  " << arm.transport << ": " << arm.refused << '\n';
  }
}

bool any_refused(const Cell& cell) {
  return std::any_of(cell.arms.begin(), cell.arms.end(),
                     [](const Arm& arm) { return !arm.refused.empty(); });
}

bool any_timed(const Cell& cell) {
  for (const Arm& arm : cell.arms) {
    for (const StreamResult& stream : arm.streams) {
      if (!stream.blocks.empty()) return true;
    }
  }
  return false;
}

void print_measured(std::ostream& out, const Cell& cell, const ReportOptions& options) {
  out << "== " << title_of(cell.conditions) << "\n";
  if (any_timed(cell)) {
    out << "   time per message, of whole blocks"
        << (cell.conditions.mode == "ping-pong" ? "; p99 and max of single messages\n" : "\n");
  } else {
    out << "   from " << name_of(options.stamp) << " to the callback's entry\n";
  }
  print_arrivals(out, cell, options);
  print_beside_ring(out, cell, options);
  print_disturbance(out, cell, options);
  out << (find(cell, kFloorPace) == nullptr ? "   pacing included\n"
          : find(cell, kFloorRos) == nullptr
              ? "   net of what pacing alone costs (floor-pace)\n"
              : "   net of what pacing alone costs (floor-pace, and floor-ros for nodes of ROS)\n");
  print_costs(out, cell);
  print_fairness(out, cell);
  complain(out, cell);
}

void print_rivals(std::ostream& out, const Run& run) {
  const std::vector<RivalCheck> checks = check_rivals(run);
  if (checks.empty()) return;
  out << "\n== Rivals: do they reach here what they are known to reach?\n";
  for (const RivalCheck& check : checks) {
    out << " " << check.rival << ": " << check.reached << ", at most " << check.limit << ": "
        << check.verdict << "\n   " << check.where << "\n";
  }
}

}  // namespace

std::string number(double value) {
  const double size = std::abs(value);
  if (size < 0.9995) return with_digits(value, 3);
  if (size < 9.995) return with_digits(value, 2);
  if (size < 99.95) return with_digits(value, 1);
  return with_digits(value, 0);
}

std::string ratio_word(const Ratio& ratio) {
  const int digits = ratio.ratio < 0.0995  ? 3
                     : ratio.ratio < 9.995 ? 2
                     : ratio.ratio < 99.95 ? 1
                                           : 0;
  const std::string word = with_digits(ratio.ratio, digits);
  if (!ratio.known) return word;
  return word + " (" + with_digits(ratio.low, digits) + "-" + with_digits(ratio.high, digits) + ")";
}

std::string size_word(std::size_t bytes) {
  if (bytes >= 1 << 20 && bytes % (1 << 20) == 0) return std::to_string(bytes >> 20) + " MiB";
  if (bytes >= 1 << 10 && bytes % (1 << 10) == 0) return std::to_string(bytes >> 10) + " KiB";
  return std::to_string(bytes) + " B";
}

std::string title_of(const Conditions& conditions) {
  std::string title = conditions.graph;
  if (conditions.size != 0) title += ", " + size_word(conditions.size);
  title += ", " + conditions.mode;
  if (conditions.mode == "paced" && conditions.size != 0) {
    title += " at " + with_digits(conditions.rate_hz, conditions.rate_hz < 10 ? 1 : 0) + " Hz";
  }
  title += ", " + conditions.wait + ", pin " + conditions.pin + ", " + conditions.place;
  title += conditions.pool == 0 ? ", no pool" : ", pool of " + std::to_string(conditions.pool);
  if (conditions.lossless) title += ", lossless";
  if (conditions.ordered) title += ", ordered";
  if (!conditions.fill) title += ", not filled";
  title += "; " + std::to_string(conditions.messages) + " messages in blocks of " +
           std::to_string(conditions.block);
  return title;
}

bool counts_add_up(const Cell& cell) {
  for (const Arm& arm : cell.arms) {
    for (const StreamResult& stream : arm.streams) {
      for (const Subscriber& subscriber : stream.subscribers) {
        if (!adds_up(arm, stream, subscriber)) return false;
      }
    }
  }
  return true;
}

void print(std::ostream& out, const Cell& cell, const ReportOptions& options) {
  print_measured(out, cell, options);
  if (any_refused(cell)) {
    out << "   not measured:\n";
    print_refused(out, cell);
  }
}

void print(std::ostream& out, const Run& run, const ReportOptions& options) {
  const Machine& machine = run.machine;
  out << machine.cpu << ", " << machine.cores << " cores, " << machine.sockets
      << (machine.sockets == 1 ? " socket, " : " sockets, ") << number(machine.memory_gib)
      << " GiB; " << machine.distribution << ", " << machine.kernel << ", " << machine.compiler
      << "\ngovernor " << machine.governor << ", virtualised " << machine.virtualised << ", load "
      << machine.load_before << "\n"
      << run.command << "; " << run.started << "; " << run.revision << "; seed " << run.seed
      << "\n";
  for (const Cell& cell : run.cells) {
    out << '\n';
    if (cell.revision != run.revision && !cell.revision.empty()) {
      out << "measured before, at " << cell.revision << ", by " << cell.command << '\n';
    }
    print_measured(out, cell, options);
  }
  const bool refused = std::any_of(run.cells.begin(), run.cells.end(), any_refused);
  if (refused) out << "\n== Not measured\n";
  for (const Cell& cell : run.cells) {
    if (!any_refused(cell)) continue;
    out << " " << title_of(cell.conditions) << '\n';
    print_refused(out, cell);
  }
  print_rivals(out, run);
  const bool sound = std::all_of(run.cells.begin(), run.cells.end(), counts_add_up);
  if (!sound) out << "\n*** WRONG: counts do not add up or payloads were spoilt; see above ***\n";
  if (!run.complete) out << "\nThe run was ended before it was complete.\n";
}

}  // namespace ab
