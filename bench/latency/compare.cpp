// SPDX-License-Identifier: Apache-2.0
#include "compare.hpp"

#include <algorithm>
#include <cstdio>
#include <ostream>
#include <string>
#include <vector>

#include "measures.hpp"
#include "report.hpp"

namespace ab {

const char* const kCompareRule =
    "Ratios are B/A, of the time per message (ping-pong, throughput) or of the latency from fill\n"
    "to callback (paced), with 95 % intervals from a bootstrap of whole blocks. A machine's own\n"
    "drift is that of a floor in the same cells: floor-spin when waiting by spinning, else\n"
    "floor-futex.\n"
    "Beyond noise, so slower, is a median whose ratio relative to the floor's own lies above 1.05\n"
    "with its whole interval and whose plain ratio lies above 1 with its whole interval; or a p99\n"
    "(from 1000 messages on) of which the same holds with 1.25 in place of 1.05. Faster is the\n"
    "converse. Without a floor the plain ratio must pass both, between two machines the relative\n"
    "one alone; with fewer than 4 blocks nothing is beyond noise.\n"
    "Exit status: 0 same or faster, 1 something is slower, 2 bad use, 3 nothing in common that\n"
    "could be compared, 4 something went wrong (a run that cannot be read).\n";

namespace {

constexpr double kMedianMargin = 1.05;
constexpr double kP99Margin = 1.25;
constexpr std::size_t kFewestForP99 = 1000;

Conditions comparable(Conditions conditions) {
  conditions.messages = 0;
  conditions.block = 0;
  return conditions;
}

const Cell* counterpart(const Run& run, const Cell& cell) {
  for (const Cell& candidate : run.cells) {
    if (comparable(candidate.conditions) == comparable(cell.conditions)) return &candidate;
  }
  return nullptr;
}

enum class Verdict { Same, Faster, Slower };

Verdict judge(const std::optional<Change>& change, double margin, bool same_machine) {
  if (!change || !change->raw.known || !change->relative.known) return Verdict::Same;
  const bool more = !same_machine || change->raw.low > 1;
  const bool less = !same_machine || change->raw.high < 1;
  // A floor that drifted does not say exactly how far others drift.
  const double drift = std::max(change->floor.ratio, 1 / change->floor.ratio);
  if (same_machine) margin = std::max(margin, drift);
  if (change->relative.low > margin && more) return Verdict::Slower;
  if (change->relative.high < 1 / margin && less) return Verdict::Faster;
  return Verdict::Same;
}

/// A line of the report, all words at their places.
void put(std::ostream& out, const std::string& name, const std::string& a, const std::string& b,
         const std::string& median, const std::string& p99, const std::string& floor,
         const std::string& verdict) {
  char line[256];
  std::snprintf(line, sizeof line, "  %-26s %8s %8s  %18s  %18s  %18s  %s", name.c_str(), a.c_str(),
                b.c_str(), median.c_str(), p99.c_str(), floor.c_str(), verdict.c_str());
  out << line << '\n';
}

class Comparison {
 public:
  Comparison(std::ostream& out, const Cell& a, const Cell& b, bool same_machine)
      : out_(out), a_(a), b_(b), same_machine_(same_machine) {
    floor_ = a.conditions.wait == "spin" ? kFloorSpin : kFloorFutex;
  }

  /// Counts what is slower and faster.
  void run(unsigned& compared_arms, unsigned& slower, unsigned& faster) {
    for (const Arm& arm : b_.arms) {
      for (const StreamResult& stream : arm.streams) {
        const StreamResult* before = find(a_, arm.transport, stream.name);
        if (before == nullptr || sends_nothing(arm.transport)) continue;
        const Verdict verdict = one(arm, *before, stream);
        compared_arms += arm.is_floor ? 0 : 1;
        slower += verdict == Verdict::Slower;
        faster += verdict == Verdict::Faster;
      }
    }
  }

 private:
  static std::size_t count(const Blocks& blocks) { return summarise(blocks).count; }

  Verdict one(const Arm& arm, const StreamResult& before, const StreamResult& after) {
    const Blocks a = compared(before, Stamp::Fill);
    const Blocks b = compared(after, Stamp::Fill);
    const StreamResult* floor_a = find(a_, beside(arm.transport, floor_), before.name);
    const StreamResult* floor_b = find(b_, beside(arm.transport, floor_), after.name);
    const bool has_floor = floor_a != nullptr && floor_b != nullptr;
    // Without a floor: as if it were always the same.
    const Blocks constant_a(a.size(), {1.0});
    const Blocks constant_b(b.size(), {1.0});
    const Blocks below_a = has_floor ? compared(*floor_a, Stamp::Fill) : constant_a;
    const Blocks below_b = has_floor ? compared(*floor_b, Stamp::Fill) : constant_b;
    const auto median = change_of_quantiles(a, below_a, b, below_b, 0.5);
    const Blocks tail_a = compared_tails(a_.conditions, before, Stamp::Fill);
    const Blocks tail_b = compared_tails(b_.conditions, after, Stamp::Fill);
    const auto p99 = change_of_quantiles(tail_a, below_a, tail_b, below_b, 0.99);
    const Summary of_a = summarise(a);
    const Summary of_b = summarise(b);

    Verdict verdict = Verdict::Same;
    std::string word = "same";
    if (arm.is_floor) {
      word = "floor";
    } else {
      const Verdict middle = judge(median, kMedianMargin, same_machine_);
      const Verdict tail = std::min(count(tail_a), count(tail_b)) < kFewestForP99
                               ? Verdict::Same
                               : judge(p99, kP99Margin, same_machine_);
      const bool by_tail = middle == Verdict::Same || tail == Verdict::Slower;
      verdict = by_tail ? tail : middle;
      if (verdict == Verdict::Slower) word = "SLOWER";
      if (verdict == Verdict::Faster) word = "faster";
      if (verdict != middle) word += " (p99)";
    }
    const auto say = [](const std::optional<Change>& change) {
      return change ? ratio_word(change->raw) : std::string("-");
    };
    put(out_, arm.transport + (after.name.empty() ? "" : " " + after.name),
        of_a.count == 0 ? "-" : number(of_a.median), of_b.count == 0 ? "-" : number(of_b.median),
        say(median), say(p99), has_floor && median ? ratio_word(median->floor) : "-", word);
    return verdict;
  }

  std::ostream& out_;
  const Cell& a_;
  const Cell& b_;
  bool same_machine_;
  const char* floor_;
};

std::string machine_word(const Run& run) {
  return run.machine.cpu + ", " + std::to_string(run.machine.cores) + " cores, " +
         run.machine.kernel;
}

}  // namespace

int compare(std::ostream& out, const Run& a, const Run& b) {
  out << "A: " << a.revision << ", " << a.started << ", " << machine_word(a) << "\n"
      << "B: " << b.revision << ", " << b.started << ", " << machine_word(b) << "\n";
  const bool same_machine = machine_word(a) == machine_word(b);
  if (!same_machine) {
    out << "The machines differ: judged by what is relative to the floors alone.\n";
  }
  unsigned arms = 0;
  unsigned slower = 0;
  unsigned faster = 0;
  unsigned only_b = 0;
  for (const Cell& cell : b.cells) {
    const Cell* before = counterpart(a, cell);
    if (before == nullptr) {
      ++only_b;
      continue;
    }
    out << "\n== " << title_of(cell.conditions) << '\n';
    put(out, "", "A us", "B us", "median B/A", "p99 B/A", "floor B/A", "");
    Comparison(out, *before, cell, same_machine).run(arms, slower, faster);
  }
  unsigned only_a = 0;
  for (const Cell& cell : a.cells) only_a += counterpart(b, cell) == nullptr;
  if (only_a + only_b != 0) {
    out << "\nOnly in A: " << only_a << " cells; only in B: " << only_b << ".\n";
  }
  if (arms == 0) {
    out << "\nThe runs have nothing in common that could be compared.\n";
    return kNothingInCommon;
  }
  out << "\n" << arms << " compared: " << slower << " slower, " << faster << " faster.\n";
  return slower == 0 ? 0 : 1;
}

}  // namespace ab
