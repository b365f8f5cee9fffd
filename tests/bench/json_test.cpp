// SPDX-License-Identifier: Apache-2.0
#include "json.hpp"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include <doctest/doctest.h>
#include <nlohmann/json.hpp>

#include "made_up.hpp"

namespace {

using namespace ab;
using namespace ab::testing;
namespace fs = std::filesystem;

Cell cell_of(std::size_t size, std::int64_t latency) {
  Cell cell;
  cell.conditions.size = size;
  cell.conditions.graph = "1p2s";
  cell.arms = {arm_of("ring", stream_of({1, 2, 5, 20}, always(latency), size)),
               arm_of("tcp", stream_of({1, 2, 5, 20}, noisy(4e5, 0.3, 9), size)),
               arm_of("floor-spin", stream_of({1, 2, 5, 20}, always(latency / 4), size)),
               arm_of("floor-futex", stream_of({1, 2, 5, 20}, always(latency / 2), size)),
               arm_of("floor-pace", stream_of({1, 2, 5, 20}, always(0), size))};
  return cell;
}

/// Nothing in it is what a fresh one has.
Run full_run() {
  Cell cell = cell_of(4096, 40'000);
  cell.conditions = {"throughput", "2p3s",      4096, 12.5, 777,  11,   "spin",
                     "same-core",  "container", 3,    7,    true, true, false};
  Arm& arm = cell.arms.front();
  arm.copies = true;
  arm.daemon_cpu_us = 0.3;
  arm.utilisation = {{"publisher 0", 123456789012345, 0.1}, {"subscriber 1", -5, 1.0 / 3}};
  arm.profile = {1.5, 0.25, 1498, {{"memcpy \"quoted\" <T>", 0.7}, {"send", 0.1}}};
  StreamResult& stream = arm.streams.front();
  stream.name = "camera/0";
  stream.rate_hz = 29.97;
  stream.blocks = {{0, 100, 1'000'000}, {1, 100, 1'100'000}};
  stream.block_costs = {{0, 100, 1.5, 0.1}, {1, 99, 1.0 / 3, 7}};
  stream.publishers[0].refused = 4;
  stream.publishers[0].usage = {0.1, 2, 3, 4, 5, 18'446'744'073'709'551'615u};
  stream.subscribers[1].missed = 1;
  stream.subscribers[1].lost = 2;
  stream.subscribers[1].spoilt = 3;
  stream.subscribers[1].samples[3].entered_at = -77;
  Arm refused;
  refused.transport = "fastdds";
  refused.refused = "not found when configured: libfastrtps-dev";
  cell.arms.push_back(refused);
  Run run = run_of({cell, cell_of(128, 30'000)});
  run.complete = false;
  return run;
}

std::size_t files_in(const fs::path& dir) {
  return static_cast<std::size_t>(
      std::distance(fs::directory_iterator(dir), fs::directory_iterator{}));
}

}  // namespace

TEST_SUITE("lot_ab json") {
  TEST_CASE("a run that is saved and loaded is the same run") {
    const TemporaryDirectory dir;
    const Run run = full_run();
    save(run, dir.path());
    CHECK(load(dir.path()) == run);
    CHECK(load(dir.path() / "run.json") == run);
    save(load(dir.path()), dir.path());
    CHECK(load(dir.path()) == run);
  }

  TEST_CASE("statistics are those of the samples") {
    const TemporaryDirectory dir;
    save(run_of({cell_of(4096, 40'000)}), dir.path());
    const auto json = nlohmann::json::parse(std::ifstream(dir.path() / "run.json"));
    const auto& ring = json["cells"][0]["arms"][0]["streams"][0];
    CHECK(ring["subscribers"][1]["latency_us"]["from_fill"]["median"] == 40);
    CHECK(ring["subscribers"][1]["latency_us"]["from_loan"]["p1"] == 43);
    CHECK(ring["subscribers"][1]["sent"] == 100);
    CHECK(ring["all"]["latency_us"]["from_push"]["max"] == 39);
    const auto& to_spin = ring["all"]["to_floor-spin"];
    CHECK(to_spin["median"]["from_fill"]["ratio"] == 4);
    CHECK(to_spin["median"]["from_loan"]["ratio"] == 43.0 / 13);
    CHECK(to_spin["p99"]["from_push"]["ratio"] == 39.0 / 9);
    CHECK(ring["all"]["to_floor-futex"]["median"]["from_fill"]["interval_95"] ==
          std::vector<double>{2, 2});
    CHECK_FALSE(ring["all"].contains("to_ring"));
    const auto& arms = json["cells"][0]["arms"];
    const auto& tcp = arms[1]["streams"][0]["all"]["to_ring"];
    CHECK(tcp["median"]["from_push"]["ratio"] > 5);
    CHECK(tcp["p99"]["from_loan"]["interval_95"].size() == 2);
    CHECK(tcp["rank_p"]["from_fill"] < 0.05);
    CHECK_FALSE(arms[4]["streams"][0]["all"].contains("to_ring"));  // pacing sends nothing
    CHECK(ring["all"]["fairness_gap_us"]["median"] == 0);
    CHECK_FALSE(ring["all"]["latency_us"]["from_fill"].contains("p99.9"));
    CHECK(json["machine"]["kernel"] == "6.1.0");
  }

  TEST_CASE("the gap between subscribers is beside ring's and the floor's") {
    const TemporaryDirectory dir;
    const auto apart = [](std::int64_t gap) {
      return stream_of({1, 2, 5, 20}, [=](unsigned, unsigned, unsigned, unsigned to) {
        return std::int64_t{10'000} + to * gap;
      });
    };
    Cell cell;
    cell.arms = {arm_of("ring", apart(2'000)), arm_of("tcp", apart(9'000)),
                 arm_of("floor-futex", apart(1'000))};
    save(run_of({cell}), dir.path());
    const auto json = nlohmann::json::parse(std::ifstream(dir.path() / "run.json"));
    const auto& tcp = json["cells"][0]["arms"][1]["streams"][0]["all"];
    CHECK(tcp["to_ring"]["fairness_gap"]["ratio"] == 4.5);
    CHECK(tcp["to_ring"]["fairness_gap"]["interval_95"] == std::vector<double>{4.5, 4.5});
    CHECK(tcp["to_floor-futex"]["fairness_gap"]["ratio"] == 9);
  }

  TEST_CASE("in ping-pong ratios of tails are those of messages, in throughput of blocks") {
    const TemporaryDirectory dir;
    Cell cell;
    cell.arms = {arm_of("ring", stream_of({1, 1, 5, 20}, always(10'000))),
                 arm_of("tcp", stream_of({1, 1, 5, 20}, always(30'000)))};
    for (std::uint32_t b = 0; b < 5; ++b) {
      cell.arms[0].streams[0].blocks.push_back({b, 20, 200'000});
      cell.arms[1].streams[0].blocks.push_back({b, 20, 800'000});
    }
    cell.conditions.mode = "ping-pong";
    Cell fast = cell;
    fast.conditions.mode = "throughput";
    save(run_of({cell, fast}), dir.path());
    const auto json = nlohmann::json::parse(std::ifstream(dir.path() / "run.json"));
    const auto to_ring = [&](std::size_t which) {
      return json["cells"][which]["arms"][1]["streams"][0]["all"]["to_ring"];
    };
    CHECK(to_ring(0)["median"]["us_per_message"]["ratio"] == 4);
    CHECK(to_ring(0)["p99"]["from_fill"]["ratio"] == 3);
    CHECK(to_ring(1)["p99"]["us_per_message"]["ratio"] == 4);
  }

  TEST_CASE("raw files begin with a line that names their columns") {
    const TemporaryDirectory dir;
    save(run_of({cell_of(4096, 40'000)}), dir.path());
    const auto json = nlohmann::json::parse(std::ifstream(dir.path() / "run.json"));
    const std::string name = json["cells"][0]["arms"][0]["streams"][0]["subscribers"][1]["raw"];
    std::ifstream file(dir.path() / name);
    std::string line;
    std::getline(file, line);
    CHECK(line == "publisher,number,block,loaned_ns,fill_ns,push_ns,entry_ns");
    std::getline(file, line);
    CHECK(line == "0,0,0,1000000000000,3000,4000,43000");
  }

  TEST_CASE("adding replaces the cell of equal conditions and keeps the others") {
    const TemporaryDirectory dir;
    const Cell small = cell_of(128, 10'000);
    const Cell large = cell_of(4096, 40'000);
    const Cell again = cell_of(128, 20'000);
    add(run_of({small}), dir.path());
    add(run_of({large}), dir.path());
    CHECK(load(dir.path()).cells == std::vector<Cell>{small, large});
    const std::size_t files = files_in(dir.path() / "raw");
    Run newest = run_of({again});
    newest.revision = "new";
    add(newest, dir.path());
    const Run all = load(dir.path());
    CHECK(all.cells == std::vector<Cell>{again, large});
    CHECK(all.revision == "new");
    CHECK(files_in(dir.path() / "raw") == files);  // what no cell names any more is gone
    CHECK(files_in(dir.path()) == 2);
  }

  TEST_CASE("a saved cell has the arms that did not fail") {
    const TemporaryDirectory dir;
    CHECK(saved_cells(dir.path(), run_of({}).machine).empty());
    Cell cell = cell_of(128, 10'000);
    cell.arms.resize(3);
    cell.arms[0].refused = "failed: publisher 0: ended";
    cell.arms[1].refused = "cannot be had here";
    add(run_of({cell}), dir.path());
    CHECK(saved_cells(dir.path(), run_of({}).machine) ==
          std::vector<CellArms>{{cell.conditions, {"tcp", "floor-spin"}}});
  }

  TEST_CASE("another machine's run is not added to") {
    const TemporaryDirectory dir;
    Run run = run_of({cell_of(128, 10'000)});
    add(run, dir.path());
    run.machine.cores = 96;
    CHECK_THROWS_WITH(add(run, dir.path()), doctest::Contains("another machine"));
    CHECK_THROWS_AS(saved_cells(dir.path(), run.machine), std::invalid_argument);
    CHECK(load(dir.path()).machine.cores == 2);
  }

  TEST_CASE("a process that is killed while saving leaves the run that was there") {
    const TemporaryDirectory dir;
    const Run run = run_of({cell_of(128, 10'000)});
    save(run, dir.path());
    // Killed before the rename: unfinished files and raw files that no run names yet.
    std::ofstream(dir.path() / "run.json.unfinished1") << "{\"format\": \"lo";
    std::ofstream(dir.path() / "raw" / "x.csv.unfinished1") << "publisher";
    std::ofstream(dir.path() / "raw" / "x.0123.csv") << "publisher";
    CHECK(load(dir.path()) == run);
    save(run, dir.path());
    CHECK_FALSE(fs::exists(dir.path() / "raw" / "x.csv.unfinished1"));
    CHECK_FALSE(fs::exists(dir.path() / "raw" / "x.0123.csv"));
    CHECK(load(dir.path()) == run);
  }

  TEST_CASE("what is no run is refused with its name") {
    const TemporaryDirectory dir;
    CHECK_THROWS_WITH(load(dir.path()), doctest::Contains("run.json"));
    const auto contents = [&](const char* text) {
      std::ofstream(dir.path() / "run.json") << text;
      return dir.path();
    };
    CHECK_THROWS_WITH(load(contents("{")), doctest::Contains("not a run"));
    CHECK_THROWS_WITH(load(contents("[]")), doctest::Contains("not a run"));
    CHECK_THROWS_WITH(load(contents("{\"format\":\"lot_ab\",\"version\":99}")),
                      doctest::Contains("version 99"));
    CHECK_THROWS_WITH(load(contents("{\"format\":\"lot_ab\",\"version\":2}")),
                      doctest::Contains("run.json"));
  }

  TEST_CASE("a raw file that was cut, changed or is missing is an error, not a shorter run") {
    const TemporaryDirectory dir;
    save(run_of({cell_of(128, 10'000)}), dir.path());
    const fs::path raw = fs::directory_iterator(dir.path() / "raw")->path();
    const auto complains = [&] {
      CHECK_THROWS_WITH(load(dir.path()), doctest::Contains(raw.filename().c_str()));
    };
    std::ifstream file(raw);
    const std::string text{std::istreambuf_iterator<char>(file), {}};
    const auto write = [&](const std::string& contents) {
      std::ofstream(raw, std::ios::trunc) << contents;
      complains();
    };
    write(text.substr(0, text.size() - 3));
    write(text.substr(0, text.rfind('\n', text.size() - 2) + 1));  // a whole line less
    write(text + "0,0,0,1,2,3,4\n");
    write("");
    std::ofstream(raw, std::ios::trunc) << text;
    CHECK(load(dir.path()).cells.size() == 1);
    fs::remove(raw);
    complains();
  }

  TEST_CASE("different conditions have different words, fit for a file's name") {
    const Conditions base;
    std::vector<Conditions> all(15, base);
    all[1].mode = "ping-pong";
    all[2].graph = "av";
    all[3].size = 0;
    all[4].rate_hz = 30.5;
    all[5].messages = 1;
    all[6].block = 1;
    all[7].wait = "spin";
    all[8].pin = "socket";
    all[9].place = "container";
    all[10].pool = 1;
    all[11].depth = 1;
    all[12].lossless = true;
    all[13].ordered = true;
    all[14].fill = false;
    std::vector<std::string> words;
    for (const Conditions& one : all) words.push_back(word_of(one));
    std::sort(words.begin(), words.end());
    CHECK(std::adjacent_find(words.begin(), words.end()) == words.end());
    CHECK(word_of(base) == "paced-1p1s-128-30hz-2000by100-park-none-host-pool0-depth30");
  }
}
