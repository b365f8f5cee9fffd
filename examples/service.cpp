// SPDX-License-Identifier: Apache-2.0
/// Request and response: two planner processes answer a robot's questions. One planner is killed at
/// work, and the other one gets its request.
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <vector>

#include <lot/lot.hpp>

#include "example.hpp"

namespace {

using namespace std::chrono_literals;

struct Goal {
  double x, y;
};
struct Point {
  double x, y;
};
struct Path {
  std::uint64_t planner;         ///< the process that has made it
  lot::ShmVector<Point> points;  ///< built in shared memory: no copy on the way
};

constexpr std::uint32_t kPoints = 100'000;

bool planner() {
  const lot::StopToken stop = lot::stop_on_signals();  // Ctrl-C, and SIGTERM of main()
  lot::ShmEngine engine;
  const auto server = engine.serve<Goal, Path>("plan", [](const Goal& goal, Path& path) {
    path.planner = static_cast<std::uint64_t>(getpid());
    path.points.resize(kPoints);
    for (std::uint32_t i = 0; i < kPoints; ++i) {
      const double part = double(i + 1) / kPoints;
      path.points[i] = {goal.x * part, goal.y * part};
    }
  });
  lot::WaitSet().run(stop);  // the server has a thread of its own
  return true;
}

bool robot(std::vector<pid_t>& planners) {
  const lot::StopToken stop = lot::stop_on_signals();
  lot::ShmEngine engine;
  lot::ClientOptions options;
  options.retry = true;  // another planner begins anew
  auto plan = engine.client<Goal, Path>("plan", options);
  std::uint32_t of_first = 0, right = 0;
  constexpr std::uint32_t kGoals = 200;
  for (std::uint32_t n = 1; n <= kGoals; ++n) {
    if (n == kGoals / 2) kill(planners.front(), SIGKILL);
    const auto path = plan.call(Goal{double(n), 1}, 10s, stop);
    if (!path) {
      std::printf("no path: %s\n", lot::to_string(plan.status()));
      return false;
    }
    right += path->points.back().x == double(n);
    of_first += path->planner == static_cast<std::uint64_t>(planners.front());
  }
  std::printf(
      "%u of %u paths are right, of %u points each; %u are of the planner that was killed\n", right,
      kGoals, kPoints, of_first);
  return right == kGoals;
}

}  // namespace

int main() {
  return example::run("service", [] {
    std::vector<pid_t> planners;
    while (planners.size() < 2) planners.push_back(example::start("planner", planner));
    const bool good = robot(planners);
    for (const pid_t child : planners) kill(child, SIGTERM);
    for (const pid_t child : planners) example::finish(child);
    return good;
  });
}
