// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "result.hpp"
#include "statistics.hpp"

/// What a run's results are counted as: latencies, gaps and costs. Times are microseconds.
namespace ab {

/// From which stamp a latency counts; it ends when the callback is entered.
enum class Stamp { Loan, Fill, Push };
const char* name_of(Stamp);
inline constexpr Stamp kStamps[] = {Stamp::Loan, Stamp::Fill, Stamp::Push};

/// The k-th of these blocks is block k of the cell; one in which nothing came is empty.
Blocks latencies(const Subscriber&, Stamp);
Blocks latencies(const StreamResult&, Stamp);  ///< of all its subscribers together
/// Time per message, one value a block: of ping-pong and throughput.
Blocks times_per_message(const StreamResult&);
/// What arms are compared by: time per message where blocks were timed as a whole (no clock is read
/// between their messages), else the latency from that stamp.
Blocks compared(const StreamResult&, Stamp);
/// What their tails are compared by. A block's time says nothing of its slowest message; in
/// ping-pong messages have latencies, too, and these are it.
Blocks compared_tails(const Conditions&, const StreamResult&, Stamp);
/// Of each message that all subscribers got: last entry less first. None with one subscriber.
Blocks fairness_gaps(const StreamResult&);

/// CPU time, switches, faults and copies per message: of publishers per message sent, of
/// subscribers per message due (sent, times subscribers).
struct Cost {
  double cpu_us = 0;
  double voluntary_switches = 0;
  double involuntary_switches = 0;
  double faults = 0;  ///< minor and major
  double copied_bytes = 0;
};
struct Costs {
  Cost publisher;
  Cost subscriber;
};
Costs costs(const StreamResult&);
/// That less what pacing alone costs; `pace` null where it was not measured. Copies stay.
Costs costs_net_of(const StreamResult&, const StreamResult* pace);

/// Processor time of all ends together per message sent, one value a block; net of what pacing
/// costs in the same block if `pace` is not null.
Blocks cpu_per_message(const StreamResult&, const StreamResult* pace);
/// Of medians of that: nothing where one of them is lost in what pacing costs.
std::optional<Ratio> ratio_of_cpu(const StreamResult& of, const StreamResult* pace,
                                  const StreamResult& to, const StreamResult* pace_of_to);

std::uint64_t sent(const StreamResult&);  ///< by all publishers: what each subscriber is due
double messages_per_second(const StreamResult&);  ///< the median block's; 0: none was timed

/// The arm of this name in the cell if it ran there, and its stream of this name; else null.
const Arm* find(const Cell&, std::string_view transport);
const StreamResult* find(const Cell&, std::string_view transport, std::string_view stream);

/// A quiet twin's name is its transport's, and one word more.
std::string quiet(const std::string& transport);
bool is_quiet(std::string_view arm);
std::string transport_of(const std::string& arm);

/// The arm of `transport` that `arm` is to be compared with: of quiet ones the quiet one.
std::string beside(const std::string& arm, const std::string& transport);

/// Of Arm::refused: it ran, and failed; conditions that it cannot have are no failure.
bool has_failed(std::string_view refused);

inline constexpr const char* kRing = "ring";  ///< what others are beside
inline constexpr const char* kFloorSpin = "floor-spin";
inline constexpr const char* kFloorFutex = "floor-futex";
inline constexpr const char* kFloorPace = "floor-pace";
inline constexpr const char* kFloorRos = "floor-ros";

/// Its subscribers hear nothing: it is there for its cost.
bool sends_nothing(const std::string& arm);
/// What the processes of an arm cost when nothing is sent: for nodes of ROS, other nodes of ROS
/// where they were measured. Null where nothing was.
const StreamResult* pace_of(const Cell& cell, const std::string& arm, const std::string& stream);

}  // namespace ab
