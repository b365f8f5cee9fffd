// SPDX-License-Identifier: Apache-2.0
#include "report.hpp"

#include <algorithm>
#include <sstream>

#include <doctest/doctest.h>

#include "made_up.hpp"

namespace {

using namespace ab;
using namespace ab::testing;

Cell fan_out() {
  const Shape shape{1, 2, 10, 20};
  const auto later = [](std::int64_t ns, std::int64_t gap) {
    return [=](unsigned, unsigned, unsigned, unsigned to) { return ns + to * gap; };
  };
  Cell cell;
  cell.conditions.graph = "1p2s";
  cell.conditions.size = 16 << 20;
  cell.arms = {arm_of("ring", stream_of(shape, later(40'000, 9'000), 16 << 20)),
               arm_of("tcp", stream_of(shape, later(8'000'000, 600'000), 16 << 20)),
               arm_of("floor-futex", stream_of(shape, later(20'000, 3'000), 16 << 20)),
               arm_of("floor-pace", stream_of(shape, always(0), 16 << 20))};
  cell.arms[0].streams[0].publishers[0].usage.cpu_us = 200 * 105.0;
  cell.arms[3].streams[0].publishers[0].usage.cpu_us = 200 * 100.0;
  cell.arms[1].streams[0].publishers[0].usage.copied_bytes = std::uint64_t{200} * 3 * (16 << 20);
  for (Subscriber& subscriber : cell.arms[3].streams[0].subscribers) {
    subscriber.received = 0;
    subscriber.samples.clear();
  }
  return cell;
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

/// The words of the n-th line that begins with this name.
std::vector<std::string> row_of(const std::string& text, const std::string& name, int nth = 0) {
  for (const std::string& line : lines_of(text)) {
    if (!line.starts_with(" " + name + " ") || nth-- != 0) continue;
    std::istringstream words(line);
    std::vector<std::string> row;
    for (std::string word; words >> word;) row.push_back(word);
    return row;
  }
  return {};
}

std::string report_of(const Cell& cell, const ReportOptions& options = {}) {
  std::ostringstream out;
  print(out, cell, options);
  return out.str();
}

}  // namespace

TEST_SUITE("lot_ab report") {
  TEST_CASE("numbers are as short as three digits allow") {
    CHECK(number(0.1434) == "0.143");
    CHECK(number(0.9999) == "1.00");
    CHECK(number(1.5) == "1.50");
    CHECK(number(33.14) == "33.1");
    CHECK(number(99.96) == "100");
    CHECK(number(5300.4) == "5300");
    CHECK(number(-2.5) == "-2.50");
    CHECK(ratio_word({1.024, 0.996, 1.05, true}) == "1.02 (1.00-1.05)");
    CHECK(ratio_word({123.4, 0, 0, false}) == "123");
    CHECK(ratio_word({0.0071, 0, 0, false}) == "0.007");
    CHECK(size_word(128) == "128 B");
    CHECK(size_word(1024) == "1 KiB");
    CHECK(size_word(1500) == "1500 B");
    CHECK(size_word(16 << 20) == "16 MiB");
  }

  TEST_CASE("a cell's rows hold counts, latency and ratios to the floors of the cell") {
    const std::string text = report_of(fan_out());
    CAPTURE(text);
    // 400 of 200 x 2; subscriber 0 at 40, 1 at 49: the lower median is 40.
    CHECK(row_of(text, "ring") == std::vector<std::string>{"ring", "200", "x2", "400", "0", "0",
                                                           "40.0", "49.0", "49.0", "-", "2.00",
                                                           "(2.00-2.00)"});
    CHECK(row_of(text, "tcp")[6] == "8000");
    CHECK(text.find("1p2s, 16 MiB, paced at 30 Hz, park, pin none, host, no pool") !=
          std::string::npos);
  }

  TEST_CASE("costs are net of pacing, and other arms are beside ring") {
    const std::string text = report_of(fan_out());
    CAPTURE(text);
    CHECK(row_of(text, "ring", 1)[1] == "5.00");  // of 105, less 100
    CHECK(row_of(text, "tcp", 1) ==               // medians of 8000 and 40, p99 of 8600 and 49
          std::vector<std::string>{"tcp", "200", "(200-200)", "176", "(176-176)", "<0.001"});
    const auto tcp = row_of(text, "tcp", 2);
    CHECK(std::find(tcp.begin(), tcp.end(), "48.0") != tcp.end());
    CHECK(row_of(text, "floor-pace")[1] == "100");
    CHECK(text.find("net of what pacing alone costs") != std::string::npos);
  }

  TEST_CASE("processor time is beside ring's, net of pacing, and a daemon's is told apart") {
    Cell cell = fan_out();
    for (const std::size_t a : {0U, 1U, 3U}) {
      for (std::uint32_t block = 0; block < 10; ++block) {
        cell.arms[a].streams[0].block_costs.push_back({block, 20,
                                                       a == 1   ? 20 * 400.0
                                                       : a == 0 ? 20 * 101.0
                                                                : 20 * 100.0,
                                                       0});
      }
    }
    cell.arms[1].daemon_cpu_us = 200 * 3.0;
    const std::string text = report_of(cell);
    CAPTURE(text);
    const auto tcp = row_of(text, "tcp", 2);
    CHECK(std::find(tcp.begin(), tcp.end(), "(300-300)") != tcp.end());
    CHECK(text.find("the daemon of tcp used 3.00 us") != std::string::npos);
    CHECK(text.find("the daemon of ring") == std::string::npos);
    // What is lost in pacing is no ratio.
    for (BlockCost& block : cell.arms[0].streams[0].block_costs) {
      block.publishers_us = 20 * (block.block % 2 == 0 ? 99.0 : 100.5);
    }
    const auto lost = row_of(report_of(cell), "tcp", 2);
    CHECK(std::find(lost.begin(), lost.end(), "-") != lost.end());
  }

  TEST_CASE("a scenario's arms are beside their quiet twins") {
    Cell cell;
    cell.conditions.graph = "av";
    for (const auto& [name, ns] : {std::pair{"ring", 24'000},
                                   {"ring quiet", 20'000},
                                   {"tcp", 90'000},
                                   {"tcp quiet", 60'000},
                                   {"floor-futex quiet", 10'000}}) {
      cell.arms.push_back(arm_of(name, stream_of({}, always(ns))));
      cell.arms.back().streams[0].name = "imu";
    }
    const std::string text = report_of(cell);
    CAPTURE(text);
    CHECK(text.find(" ring imu  1.20 (1.20-1.20)  1.20 (1.20-1.20)") != std::string::npos);
    CHECK(text.find(" tcp imu   1.50 (1.50-1.50)") != std::string::npos);
    // Beside ring: the quiet beside the quiet.
    CHECK(row_of(text, "tcp quiet imu", 1)[4] == "(3.00-3.00)");
    // And only the quiet floor is there.
    CHECK(row_of(text, "ring quiet imu").back() == "(2.00-2.00)");
    CHECK(row_of(text, "ring imu").back() == "-");
  }

  TEST_CASE("fairness is beside that of the floor, where there is more than one subscriber") {
    const std::string text = report_of(fan_out());
    CAPTURE(text);
    CHECK(row_of(text, "ring", 2) == std::vector<std::string>{"ring", "200", "9.00", "9.00", "9.00",
                                                              "-", "3.00", "(3.00-3.00)"});
    CHECK(row_of(text, "tcp", 3) == std::vector<std::string>{"tcp", "200", "600", "600", "600",
                                                             "66.7", "(66.7-66.7)", "200",
                                                             "(200-200)"});
    Cell one;
    one.arms = {arm_of("ring", stream_of({}, always(1)))};
    CHECK(report_of(one).find("gap") == std::string::npos);
  }

  TEST_CASE("each subscriber has a row when asked for") {
    const std::string text = report_of(fan_out(), {true, Stamp::Push});
    CAPTURE(text);
    CHECK(row_of(text, "ring s0")[6] == "39.0");
    CHECK(row_of(text, "ring s1")[6] == "48.0");
    CHECK(text.find("from push to") != std::string::npos);
  }

  TEST_CASE("ratios count from the stamp that latencies count from") {
    const auto slow_to_fill = [](std::int64_t filling) {
      StreamResult stream = stream_of({1, 1, 10, 20}, always(20'000));
      for (Sample& sample : stream.subscribers[0].samples) sample.loaned_at -= filling;
      return stream;
    };
    Cell cell;  // loan to fill takes 3 us more or less in each
    cell.arms = {arm_of("ring", slow_to_fill(7'000)), arm_of("tcp", slow_to_fill(67'000)),
                 arm_of("floor-futex", slow_to_fill(-8'000))};
    for (Sample& sample : cell.arms[2].streams[0].subscribers[0].samples) {
      sample.filled_at -= 10'000;  // 30 us from fill, 25 from loan
      sample.loaned_at -= 10'000;
    }
    const std::string by_fill = report_of(cell);
    const std::string by_loan = report_of(cell, {false, Stamp::Loan});
    CAPTURE(by_fill);
    CAPTURE(by_loan);
    CHECK(row_of(by_fill, "ring")[9] == "0.67");
    CHECK(row_of(by_loan, "ring")[9] == "1.20");
    CHECK(row_of(by_fill, "tcp", 1)[1] == "1.00");
    CHECK(row_of(by_loan, "tcp", 1)[1] == "3.00");
    CHECK(row_of(by_loan, "tcp", 1)[3] == "3.00");
    CHECK(row_of(by_fill, "tcp", 1)[5] == "1.000");
    CHECK(row_of(by_loan, "tcp", 1)[5] == "<0.001");
  }

  TEST_CASE("of few blocks there is no p") {
    Cell cell;
    cell.arms = {arm_of("ring", stream_of({1, 1, 3, 400}, noisy(4e4, 0.1, 1))),
                 arm_of("tcp", stream_of({1, 1, 3, 400}, noisy(4e5, 0.1, 2)))};
    const auto row = row_of(report_of(cell), "tcp", 1);
    REQUIRE(row.size() > 3);
    CHECK(row[3] == "-");
  }

  TEST_CASE("throughput is in millions a second and by whole blocks") {
    Cell cell = fan_out();
    cell.conditions.mode = "throughput";
    for (std::uint32_t b = 0; b < 8; ++b) {
      cell.arms[0].streams[0].blocks.push_back({b, 1'000'000, 250'000'000});
      cell.arms[2].streams[0].blocks.push_back({b, 1'000'000, 125'000'000});
    }
    const std::string text = report_of(cell);
    CAPTURE(text);
    CHECK(row_of(text, "ring")[6] == "0.250");
    CHECK(row_of(text, "ring")[10] == "2.00");
    const auto costs = row_of(text, "ring", 1);
    CHECK(std::find(costs.begin(), costs.end(), "4.00") != costs.end());
  }

  TEST_CASE("ping-pong has its median from blocks and its tail from messages") {
    Cell cell = fan_out();
    cell.conditions.mode = "ping-pong";
    for (std::uint32_t b = 0; b < 8; ++b) {
      cell.arms[0].streams[0].blocks.push_back({b, 1'000, 30'000'000});
    }
    const auto row = row_of(report_of(cell), "ring");
    CHECK(row[6] == "30.0");
    CHECK(row[7] == "49.0");
    CHECK(row[8] == "49.0");
  }

  TEST_CASE("counts that do not add up are said loudly") {
    Cell cell = fan_out();
    CHECK(counts_add_up(cell));
    CHECK(report_of(cell).find("WRONG") == std::string::npos);
    SUBCASE("too few") { cell.arms[1].streams[0].subscribers[1].received -= 1; }
    SUBCASE("too many") { cell.arms[1].streams[0].subscribers[1].missed += 1; }
    SUBCASE("spoilt") { cell.arms[1].streams[0].subscribers[1].spoilt = 1; }
    CHECK_FALSE(counts_add_up(cell));
    const std::string text = report_of(cell);
    CHECK(text.find("*** WRONG: tcp, subscriber 1: ") != std::string::npos);
    std::ostringstream out;
    print(out, run_of({cell}));
    CHECK(out.str().find("*** WRONG: counts") != std::string::npos);
  }

  TEST_CASE("losses that are accounted for are no error") {
    Cell cell = fan_out();
    Subscriber& subscriber = cell.arms[1].streams[0].subscribers[1];
    subscriber.received = 190;
    subscriber.missed = 7;
    subscriber.lost = 3;
    CHECK(counts_add_up(cell));
    CHECK(row_of(report_of(cell), "tcp")[4] == "7");
    CHECK(row_of(report_of(cell), "tcp")[5] == "3");
  }

  TEST_CASE("what was refused is at the end, with its reason") {
    Cell cell = fan_out();
    Arm udp;
    udp.transport = "udp";
    udp.refused = "it has no way to wait by spinning: --wait park";
    cell.arms.insert(cell.arms.begin(), udp);
    std::ostringstream out;
    print(out, run_of({cell, fan_out()}));
    const auto lines = lines_of(out.str());
    CHECK(lines.back() == "  udp: " + udp.refused);
    CHECK(row_of(out.str(), "udp").empty());
  }

  TEST_CASE("a run that was ended says so") {
    Run run = run_of({fan_out()});
    run.complete = false;
    std::ostringstream out;
    print(out, run);
    CHECK(out.str().find("ended before it was complete") != std::string::npos);
  }

  TEST_CASE("an empty run and arms without a message are printed") {
    std::ostringstream out;
    print(out, Run{});
    Cell cell;
    cell.arms = {arm_of("ring", StreamResult{}), arm_of("tcp", stream_of({1, 1, 0, 0}, always(1)))};
    const std::string text = report_of(cell);
    CAPTURE(text);
    CHECK(row_of(text, "tcp")[5] == "-");
  }

  TEST_CASE("the longest numbers of a scenario fit into 120 columns") {
    const Shape shape{1, 1, 6, 10};
    Cell cell;
    cell.conditions.graph = "av";
    cell.conditions.size = 0;
    cell.conditions.pool = 100;
    for (const char* name : {"ring", "floor-futex", "floor-spin", "fastdds-loan"}) {
      Arm arm = arm_of(name, stream_of(shape, always(33'333'333)));
      arm.streams[0].name = "camera0";
      StreamResult& stream = arm.streams[0];
      stream.publishers[0].sent = 12'000'000;
      stream.subscribers[0] = {0,
                               11'000'000,
                               600'000,
                               400'000,
                               0,
                               {9e9, 24'000'000, 24'000'000, 4'000'000, 0, 1ull << 50},
                               stream.subscribers[0].samples};
      stream.publishers[0].usage = stream.subscribers[0].usage;
      cell.arms.push_back(std::move(arm));
    }
    for (const bool per_subscriber : {false, true}) {
      for (const std::string& line : lines_of(report_of(cell, {per_subscriber, Stamp::Fill}))) {
        CAPTURE(line);
        if (line.starts_with("==")) continue;
        CHECK(line.size() <= 120);
      }
    }
  }
}
