// SPDX-License-Identifier: Apache-2.0
#include "figures.hpp"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include <doctest/doctest.h>

#include "made_up.hpp"

namespace {

using namespace ab;
using namespace ab::testing;
namespace fs = std::filesystem;

/// About what a machine of 2 cores gives, in nanoseconds.
double median_of(const std::string& transport, double size) {
  if (transport == "tcp") return 42'000 + size * 0.45;
  if (transport == "tcp-nagle") return 43'000 + size * 0.45;
  if (transport == "uds") return 33'000 + size * 0.3;
  if (transport == "udp") return 45'000 + size * 2.5;
  if (transport == "tzc") return 58'000;
  if (transport == "lot2021") return 37'000 + size * 0.04;
  if (transport == "iceoryx") return 38'000;
  if (transport == "fastdds") return 54'000 + size * 0.3;
  if (transport == "floor-futex") return 31'500;
  return 34'000;  // ring, mutex
}

constexpr std::size_t kSizes[] = {128, 512, 1024, 16384, 131072, 1048576, 4194304, 16777216};

Cell paced(const std::string& graph, const Shape& shape, std::size_t size,
           const std::vector<std::string>& transports, double factor, double per_subscriber) {
  Cell cell;
  cell.conditions.graph = graph;
  cell.conditions.size = size;
  std::uint64_t seed = size;
  for (const std::string& transport : transports) {
    const double median = factor * median_of(transport, static_cast<double>(size));
    const Latency base = noisy(median, 0.12, ++seed);
    const double step = median * per_subscriber;
    const bool nagle = transport == "tcp-nagle";
    cell.arms.push_back(
        arm_of(transport, stream_of(
                              shape,
                              [=](unsigned b, unsigned m, unsigned p, unsigned to) {
                                const std::int64_t burst = nagle && m % 2 == 1 ? 33'000'000 : 0;
                                return base(b, m, p, to) + burst + std::llround(step * to);
                              },
                              size)));
  }
  return cell;
}

Run everything() {
  Run run = run_of({});
  const std::vector<std::string> all{"ring",
                                     "mutex",
                                     "lot2021",
                                     "tcp",
                                     "udp",
                                     "uds",
                                     "tzc",
                                     "iceoryx",
                                     "fastdds",
                                     "floor-futex",
                                     "lot2021-direct",
                                     "fastdds-loan",
                                     "udp-65507",
                                     "ros-lot",
                                     "ros-lot-immediate",
                                     "ros-lot-mutex",
                                     "ros-tcp",
                                     "ros-udp",
                                     "ros-tzc",
                                     "ros-intra"};
  const std::vector<std::string> several{"ring",    "tcp",     "tzc",    "floor-futex",
                                         "ros-lot", "ros-tcp", "ros-tzc"};
  for (const std::size_t size : kSizes) {
    double factor = 1;
    for (const char* place : {"host", "container", "containers"}) {
      run.cells.push_back(paced("1p1s", {}, size, all, factor, 0));
      run.cells.back().conditions.place = place;
      factor *= 1.12;
    }
    run.cells.push_back(
        paced("1p1s", {}, size, {"ring", "mutex", "iceoryx", "floor-spin"}, 0.1, 0));
    run.cells.back().conditions.wait = "spin";
    factor = 0.3;
    for (const char* pin : {"same-core", "other-core"}) {
      run.cells.push_back(
          paced("1p1s", {}, size, {"ring", "tcp", "floor-futex", "ros-lot", "ros-tcp"}, factor, 0));
      run.cells.back().conditions.pin = pin;
      factor = 0.95;
    }
    run.cells.push_back(paced("1p5s", {1, 5, 10, 10}, size, several, 1.1, 0.3));
    run.cells.push_back(paced("1p5s", {1, 5, 10, 10}, size,
                              {"ring", "tcp", "tzc", "floor-futex", "ros-tcp"}, 1.1, 0.25));
    run.cells.back().conditions.ordered = true;
    run.cells.push_back(paced("5p1s", {5, 1, 10, 10}, size, several, 1.3, 0));
  }
  for (const std::size_t size : {512u, 1024u}) {
    run.cells.push_back(paced("1p1s", {1, 1, 10, 50}, size, {"ring", "tcp", "tcp-nagle"}, 1, 0));
    run.cells.back().conditions.pool = 100;
    run.cells.push_back(
        paced("1p1s", {1, 1, 10, 50}, size, {"ros-lot", "ros-tcp", "ros-tcp-nodelay"}, 1, 0));
  }
  double nodes = 2;
  for (const char* graph : {"1p1s", "1p5s", "5p1s"}) {
    Cell cell = paced(graph, {1, 1, 1, 1}, 16 << 20, {"ring", "tcp", "mutex", "lot2021"}, 1, 0);
    cell.conditions.pool = 50;
    cell.conditions.messages = 1;
    for (Arm& arm : cell.arms) {
      const double busy = nodes * (arm.transport == "tcp"     ? 0.3
                                   : arm.transport == "ring"  ? 0.01
                                   : arm.transport == "mutex" ? 0.02
                                                              : 0.06);
      for (int i = 0; i < 600; ++i) {
        const std::int64_t at = std::int64_t{i} * 100'000'000;
        arm.utilisation.push_back({"publisher 0", at, busy * (1 + 0.1 * std::sin(i * 0.7))});
        arm.utilisation.push_back({"subscriber 0", at + 10'000'000, busy});
      }
      arm.profile = {
          busy * 60, busy * 10, 700, {{"memcpy", busy}, {"a|b", 3 * busy}, {"x", 2 * busy}}};
    }
    run.cells.push_back(std::move(cell));
    nodes += 1;
  }
  return run;
}

std::string text_of(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::string line_of(const std::vector<std::string>& lines, const std::string& name) {
  for (const std::string& line : lines) {
    if (line.starts_with(name + ":")) return line;
  }
  return {};
}

bool has_gnuplot() { return std::system("command -v gnuplot >/dev/null") == 0; }

constexpr const char* kFigures[] = {
    "fig3a", "fig3b", "fig5a", "fig5b", "fig5c", "fig6a",      "fig6b", "fig6c", "fig6d", "fig7a",
    "fig7b", "fig7c", "fig7d", "fig8",  "peers", "peers-spin", "ros3a", "ros3b", "ros5a", "ros5b",
    "ros5c", "ros6a", "ros6b", "ros6c", "ros6d", "ros7a",      "ros7b", "ros7c", "ros7d"};

}  // namespace

TEST_SUITE("lot_ab figures") {
  // LOT_AB_FIGURES=DIR: there, to be looked at.
  TEST_CASE("every figure is drawn from a run that has all cells") {
    const TemporaryDirectory temporary;
    const char* kept = std::getenv("LOT_AB_FIGURES");
    const fs::path dir = kept != nullptr ? fs::path(kept) : temporary.path();
    const auto lines = draw(everything(), dir);
    for (const char* name : kFigures) {
      const std::string line = line_of(lines, name);
      CAPTURE(line);
      CHECK(line.find("left out") == std::string::npos);
      CHECK(fs::file_size(dir / "figures" / (std::string(name) + ".tsv")) > 0);
      if (!has_gnuplot()) {
        CHECK(line.find("gnuplot-nox") != std::string::npos);
        continue;
      }
      CHECK(line.find(".svg") != std::string::npos);
      CHECK(text_of(dir / "figures" / (std::string(name) + ".svg")).ends_with("</svg>\n\n"));
      CHECK(text_of(dir / "figures" / (std::string(name) + ".png")).starts_with("\x89PNG"));
    }
    CHECK_FALSE(fs::exists(dir / "figures" / "fig3a.log"));
  }

  TEST_CASE("a figure whose cells are absent is left out, and says what it needs") {
    const TemporaryDirectory dir;
    const auto lines = draw(run_of({}), dir.path());
    CHECK(lines.size() == std::size(kFigures) + 1);  // and table 1
    for (const std::string& line : lines) {
      CAPTURE(line);
      CHECK(line.find("left out: needs ") != std::string::npos);
    }
    CHECK(fs::is_empty(dir.path() / "figures"));
  }

  TEST_CASE("a figure that is left out does not leave an earlier run's") {
    const TemporaryDirectory dir;
    fs::create_directories(dir.path() / "figures");
    std::ofstream(dir.path() / "figures" / "fig7c.png") << "old";
    draw(run_of({}), dir.path());
    CHECK(fs::is_empty(dir.path() / "figures"));
  }

  TEST_CASE("one placement is no comparison of placements") {
    const TemporaryDirectory dir;
    Run run = run_of({paced("1p1s", {}, 128, {"ring"}, 1, 0)});
    CHECK(line_of(draw(run, dir.path()), "fig3b").find("two placements") != std::string::npos);
    run.cells.push_back(paced("1p1s", {}, 128, {"ring"}, 1.2, 0));
    run.cells.back().conditions.place = "container";
    CHECK(line_of(draw(run, dir.path()), "fig3b").find("left out") == std::string::npos);
  }

  TEST_CASE("one transport is no comparison of transports") {
    const TemporaryDirectory dir;
    const Run run = run_of({paced("1p1s", {}, 128, {"ring", "floor-futex"}, 1, 0)});
    CHECK(line_of(draw(run, dir.path()), "fig6a").find("two of these transports") !=
          std::string::npos);
  }

  TEST_CASE("a profiled cell gives no boxes") {
    const TemporaryDirectory dir;
    Run run = run_of({paced("1p5s", {1, 5, 5, 4}, 128, {"ring"}, 1, 0)});
    CHECK(line_of(draw(run, dir.path()), "fig7c").find("left out") == std::string::npos);
    run.cells[0].arms[0].utilisation = {{"publisher 0", 0, 0.1}};
    CHECK(line_of(draw(run, dir.path()), "fig7c").find("left out") != std::string::npos);
  }

  TEST_CASE("peers are shown parked and spinning, each from its own cells") {
    const TemporaryDirectory dir;
    Run run = run_of({paced("1p1s", {}, 128, {"ring", "lot2021-direct", "udp-65507"}, 1, 0),
                      paced("1p1s", {}, 4096, {"ring", "fastdds-loan", "iceoryx"}, 1, 0)});
    auto lines = draw(run, dir.path());
    CHECK(line_of(lines, "peers").ends_with("; without lot2021, mutex, fastdds"));
    CHECK(line_of(lines, "peers-spin").find("--wait spin") != std::string::npos);
    run.cells.push_back(paced("1p1s", {}, 1024, {"ring", "iceoryx", "mutex"}, 0.1, 0));
    run.cells.back().conditions.wait = "spin";
    lines = draw(run, dir.path());
    const std::string parked = text_of(dir.path() / "figures" / "peers.tsv");
    const std::string spinning = text_of(dir.path() / "figures" / "peers-spin.tsv");
    CHECK(parked.find("\t1024\t") == std::string::npos);
    CHECK(parked.find("LOT of 2021, direct") != std::string::npos);
    CHECK(spinning.find("\t1024\t") != std::string::npos);
    CHECK(spinning.find("\t4096\t") == std::string::npos);
  }

  TEST_CASE("a transport that was not measured is named") {
    const TemporaryDirectory dir;
    const Run run = run_of({paced("1p1s", {}, 128, {"ring", "tcp", "uds"}, 1, 0)});
    CHECK(line_of(draw(run, dir.path()), "fig6a").ends_with("; without udp, tzc"));
  }

  TEST_CASE("all cells of a figure are of one setting: the one with the most to show") {
    const TemporaryDirectory dir;
    Run run = run_of({});
    for (const std::size_t size : {128u, 1024u, 16384u}) {
      run.cells.push_back(paced("1p5s", {1, 5, 5, 4}, size, {"tzc"}, 1, 0));
      run.cells.back().conditions.wait = "spin";
    }
    run.cells.push_back(paced("1p5s", {1, 5, 5, 4}, 4096, {"tzc"}, 1, 0));
    draw(run, dir.path());
    const std::string data = text_of(dir.path() / "figures" / "fig7d.tsv");
    CHECK(data.find("; spin, host") != std::string::npos);
    CHECK(data.find("\t16384\t20\t") != std::string::npos);
    CHECK(data.find("\t4096\t") == std::string::npos);
  }

  TEST_CASE("boxes hold the quantiles of their series") {
    const TemporaryDirectory dir;
    Run run = run_of({Cell{}});
    run.cells[0].conditions.graph = "5p1s";
    run.cells[0].arms = {
        arm_of("tzc", stream_of({5, 1, 10, 10}, [](unsigned b, unsigned m, unsigned p, unsigned) {
                 return std::int64_t{1000} * (b * 10 + m + 1 + 1000 * p);
               }))};
    draw(run, dir.path());
    const std::string data = text_of(dir.path() / "figures" / "fig5c.tsv");
    CAPTURE(data);
    CHECK(data.find("\t128\t100\t1\t1\t25\t50\t75\t99\t100\n") != std::string::npos);
    CHECK(data.find("\t128\t100\t4001\t4001\t4025\t4050\t4075\t4099\t4100\n") != std::string::npos);
  }

  TEST_CASE("utilisation is the sum over nodes, without other arms' turns") {
    const TemporaryDirectory dir;
    Run run = run_of({paced("1p1s", {}, 128, {"ring"}, 1, 0)});
    auto& readings = run.cells[0].arms[0].utilisation;
    for (std::int64_t i = 0; i < 20; ++i) {
      const std::int64_t at = i * 100'000'000 + (i >= 10 ? 60'000'000'000 : 0);
      readings.push_back({"publisher 0", at, 0.25});
      readings.push_back({"subscriber 0", at + 20'000'000, 0.5});
    }
    draw(run, dir.path());
    const std::string data = text_of(dir.path() / "figures" / "fig8.tsv");
    CAPTURE(data);
    CHECK(data.find("\n0\t0.75\n0.1\t0.75\n") != std::string::npos);
    CHECK(data.find("\n1.9\t0.75\n") != std::string::npos);
  }

  TEST_CASE("table 1 has the three hottest places, hottest first") {
    const TemporaryDirectory dir;
    draw(everything(), dir.path());
    const std::string table = text_of(dir.path() / "figures" / "table1.md");
    CAPTURE(table);
    CHECK(table.find("| TCP 1p1s ") != std::string::npos);
    CHECK(table.find("36.00 |   6.00 |     700 | a\\|b 1.80, x 1.20, memcpy 0.60") !=
          std::string::npos);
    CHECK(std::count(table.begin(), table.end(), '\n') == 2 + 4 * 3);
  }

  TEST_CASE("names with quotes and marks of gnuplot's are only text") {
    const TemporaryDirectory dir;
    Run run = run_of({paced("1p5s", {1, 5, 5, 4}, 128, {"ring"}, 1, 0)});
    run.machine.cpu = "it's {a}_b^c \"@\" \\ `date`\n";
    const std::string line = line_of(draw(run, dir.path()), "fig7c");
    CAPTURE(line);
    if (has_gnuplot()) CHECK(line.find(".png") != std::string::npos);
  }
}
