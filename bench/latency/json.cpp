// SPDX-License-Identifier: Apache-2.0
#include "json.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <optional>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "measures.hpp"

namespace ab {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kVersion = 2;
constexpr std::string_view kHeader = "publisher,number,block,loaned_ns,fill_ns,push_ns,entry_ns\n";

// ---- files --------------------------------------------------------------------------------------

[[noreturn]] void fail(const fs::path& path, const std::string& what) {
  throw std::runtime_error(path.string() + ": " + what);
}

std::string read(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file) fail(path, "cannot be read");
  return std::move(text).str();
}

void write_at_once(const fs::path& path, std::string_view text) {
  fs::path unfinished = path;
  unfinished += ".unfinished" + std::to_string(getpid());
  {
    std::ofstream file(unfinished, std::ios::binary);
    file.write(text.data(), static_cast<std::streamsize>(text.size()));
    file.close();
    if (!file) {
      std::error_code ignored;
      fs::remove(unfinished, ignored);
      fail(path, "cannot be written: is there room, and may this user write there?");
    }
  }
  fs::rename(unfinished, path);
}

std::string checksum(std::string_view text) {  // FNV-1a
  std::uint64_t hash = 14695981039346656037u;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211u;
  std::array<char, 17> word{};
  std::snprintf(word.data(), word.size(), "%016llx", static_cast<unsigned long long>(hash));
  return word.data();
}

std::string file_word(std::string_view name) {
  std::string word;
  for (const char c : name) {
    const bool plain = (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                       c == '-' || c == '_' || c == '.';
    word += plain ? c : '_';
  }
  return word;
}

// ---- samples ------------------------------------------------------------------------------------

std::string to_csv(const std::vector<Sample>& samples) {
  std::string text(kHeader);
  text.reserve(text.size() + samples.size() * 56);
  std::array<char, 24> digits;
  const auto put = [&](auto number, char after) {
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr;
    text.append(digits.data(), end);
    text += after;
  };
  for (const Sample& sample : samples) {
    put(sample.publisher, ',');
    put(sample.number, ',');
    put(sample.block, ',');
    put(sample.loaned_at, ',');
    put(sample.filled_at - sample.loaned_at, ',');
    put(sample.pushed_at - sample.loaned_at, ',');
    put(sample.entered_at - sample.loaned_at, '\n');
  }
  return text;
}

std::vector<Sample> from_csv(const fs::path& path) {
  const std::string text = read(path);
  if (!text.starts_with(kHeader)) fail(path, "is not a file of samples");
  if (!path.stem().string().ends_with('.' + checksum(text))) {
    fail(path, "was changed since it was written: its checksum is not that in its name");
  }
  std::vector<Sample> samples;
  const char* at = text.data() + kHeader.size();
  const char* const end = text.data() + text.size();
  const auto get = [&](auto& number, char after) {
    const auto [next, error] = std::from_chars(at, end, number);
    if (error != std::errc{} || next == end || *next != after) {
      fail(path, "line " + std::to_string(samples.size() + 2) + " is not a sample");
    }
    at = next + 1;
  };
  while (at != end) {
    Sample sample{};
    get(sample.publisher, ',');
    get(sample.number, ',');
    get(sample.block, ',');
    get(sample.loaned_at, ',');
    get(sample.filled_at, ',');
    get(sample.pushed_at, ',');
    get(sample.entered_at, '\n');
    sample.filled_at += sample.loaned_at;
    sample.pushed_at += sample.loaned_at;
    sample.entered_at += sample.loaned_at;
    samples.push_back(sample);
  }
  return samples;
}

// ---- what was measured, there and back: each pair names the same fields -------------------------

Json to_json(const Usage& usage) {
  return {{"cpu_us", usage.cpu_us},
          {"voluntary_switches", usage.voluntary_switches},
          {"involuntary_switches", usage.involuntary_switches},
          {"minor_faults", usage.minor_faults},
          {"major_faults", usage.major_faults},
          {"copied_bytes", usage.copied_bytes}};
}
Usage usage_of(const Json& json) {
  return {json.at("cpu_us"),       json.at("voluntary_switches"), json.at("involuntary_switches"),
          json.at("minor_faults"), json.at("major_faults"),       json.at("copied_bytes")};
}

Json to_json(const Conditions& conditions) {
  return {{"mode", conditions.mode},         {"graph", conditions.graph},
          {"size", conditions.size},         {"rate_hz", conditions.rate_hz},
          {"messages", conditions.messages}, {"block", conditions.block},
          {"wait", conditions.wait},         {"pin", conditions.pin},
          {"place", conditions.place},       {"pool", conditions.pool},
          {"depth", conditions.depth},       {"lossless", conditions.lossless},
          {"ordered", conditions.ordered},   {"fill", conditions.fill}};
}
Conditions conditions_of(const Json& json) {
  return {json.at("mode"),     json.at("graph"), json.at("size"),  json.at("rate_hz"),
          json.at("messages"), json.at("block"), json.at("wait"),  json.at("pin"),
          json.at("place"),    json.at("pool"),  json.at("depth"), json.at("lossless"),
          json.at("ordered"),  json.at("fill")};
}

Json to_json(const Machine& machine) {
  return {{"cpu", machine.cpu},
          {"cores", machine.cores},
          {"sockets", machine.sockets},
          {"memory_gib", machine.memory_gib},
          {"kernel", machine.kernel},
          {"distribution", machine.distribution},
          {"compiler", machine.compiler},
          {"governor", machine.governor},
          {"virtualised", machine.virtualised},
          {"load_before", machine.load_before}};
}
Machine machine_of(const Json& json) {
  return {json.at("cpu"),        json.at("cores"),    json.at("sockets"),
          json.at("memory_gib"), json.at("kernel"),   json.at("distribution"),
          json.at("compiler"),   json.at("governor"), json.at("virtualised"),
          json.at("load_before")};
}

Json to_json(const Profile& profile) {
  Json json{{"cpu_s", profile.cpu_s},
            {"spin_s", profile.spin_s},
            {"samples", profile.samples},
            {"hottest", Json::array()}};
  for (const HotSpot& spot : profile.hottest) {
    json["hottest"].push_back({{"symbol", spot.symbol}, {"seconds", spot.seconds}});
  }
  return json;
}
Profile profile_of(const Json& json) {
  Profile profile{json.at("cpu_s"), json.at("spin_s"), json.value("samples", std::uint64_t{0}), {}};
  for (const Json& spot : json.at("hottest")) {
    profile.hottest.push_back({spot.at("symbol"), spot.at("seconds")});
  }
  return profile;
}

// ---- what it comes to ---------------------------------------------------------------------------

Json to_json(const Summary& summary) {
  if (summary.count == 0) return nullptr;
  Json json{{"count", summary.count}, {"min", summary.min},       {"p1", summary.p1},
            {"p25", summary.p25},     {"median", summary.median}, {"p75", summary.p75},
            {"p99", summary.p99},     {"max", summary.max}};
  if (summary.p999) json["p99.9"] = *summary.p999;
  return json;
}

template <typename Of>  // a Subscriber or a StreamResult
Json latencies_of(const Of& of) {
  Json json;
  for (const Stamp stamp : kStamps) {
    json[std::string("from_") + name_of(stamp)] = to_json(summarise(latencies(of, stamp)));
  }
  return json;
}

Json to_json(const std::optional<Ratio>& ratio) {
  if (!ratio) return nullptr;
  Json json{{"ratio", ratio->ratio}};
  if (ratio->known) json["interval_95"] = {ratio->low, ratio->high};
  return json;
}

Json to_json(const Cost& cost) {
  return {{"cpu_us", cost.cpu_us},
          {"voluntary_switches", cost.voluntary_switches},
          {"involuntary_switches", cost.involuntary_switches},
          {"faults", cost.faults},
          {"copied_bytes", cost.copied_bytes}};
}
Json to_json(const Costs& costs) {
  return {{"publisher", to_json(costs.publisher)}, {"subscriber", to_json(costs.subscriber)}};
}

Json to_json(const std::optional<double>& value) { return value ? Json(*value) : Json(nullptr); }

/// The names of what arms are compared by, each with a stamp.
std::vector<std::pair<std::string, Stamp>> measures_of(bool timed) {
  if (timed) return {{"us_per_message", Stamp::Fill}};  // the same from each stamp
  std::vector<std::pair<std::string, Stamp>> names;
  for (const Stamp stamp : kStamps)
    names.emplace_back(std::string("from_") + name_of(stamp), stamp);
  return names;
}

/// Ratios to another arm's stream, and how likely none of them means anything.
Json ratios(const Conditions& conditions, const StreamResult& own, const StreamResult& other) {
  Json json{{"median", Json::object()}, {"p99", Json::object()}, {"rank_p", Json::object()}};
  for (const auto& [name, stamp] : measures_of(!own.blocks.empty())) {
    const Blocks a = compared(own, stamp);
    const Blocks b = compared(other, stamp);
    json["median"][name] = to_json(ratio_of_quantiles(a, b, 0.5));
    json["rank_p"][name] = to_json(p_of_block_medians(a, b));
  }
  const bool by_blocks = !own.blocks.empty() && conditions.mode != "ping-pong";
  for (const auto& [name, stamp] : measures_of(by_blocks)) {
    json["p99"][name] = to_json(ratio_of_quantiles(compared_tails(conditions, own, stamp),
                                                   compared_tails(conditions, other, stamp), 0.99));
  }
  const Blocks gaps = fairness_gaps(own);
  if (!gaps.empty()) {
    json["fairness_gap"] = to_json(ratio_of_quantiles(gaps, fairness_gaps(other), 0.5));
  }
  return json;
}

Json derived(const Cell& cell, const Arm& arm, const StreamResult& stream) {
  Json json{{"latency_us", latencies_of(stream)}};
  if (!stream.blocks.empty()) {
    json["us_per_message"] = to_json(summarise(times_per_message(stream)));
    json["messages_per_second"] = messages_per_second(stream);
  }
  const StreamResult* pace = pace_of(cell, arm.transport, stream.name);
  if (!sends_nothing(arm.transport)) {  // it has nothing to compare
    const auto compare_with = [&](const std::string& other, const std::string& key) {
      const StreamResult* result = find(cell, other, stream.name);
      if (result == nullptr || arm.transport == other) return;
      json[key] = ratios(cell.conditions, stream, *result);
      const StreamResult* pace_of_it = pace_of(cell, other, stream.name);
      const bool net = pace != nullptr && pace_of_it != nullptr;
      json[key][net ? "cpu_net_of_pacing" : "cpu"] =
          to_json(net ? ratio_of_cpu(stream, pace, *result, pace_of_it)
                      : ratio_of_cpu(stream, nullptr, *result, nullptr));
    };
    for (const std::string other : {kRing, kFloorSpin, kFloorFutex}) {
      compare_with(beside(arm.transport, other), "to_" + other);
    }
    compare_with(quiet(arm.transport), "to_quiet");
  }
  const Blocks gaps = fairness_gaps(stream);
  if (!gaps.empty()) json["fairness_gap_us"] = to_json(summarise(gaps));
  json["per_message"] = to_json(costs(stream));
  if (pace != nullptr) {
    json["per_message_net_of_pacing"] = to_json(costs_net_of(stream, pace));
  }
  return json;
}

// ---- cells --------------------------------------------------------------------------------------

Json to_json(const Cell& cell, const fs::path& dir) {
  Json arms = Json::array();
  for (const Arm& arm : cell.arms) {
    Json streams = Json::array();
    for (const StreamResult& stream : arm.streams) {
      Json one{{"name", stream.name}, {"size", stream.size}, {"rate_hz", stream.rate_hz}};
      one["publishers"] = Json::array();
      for (const Publisher& publisher : stream.publishers) {
        one["publishers"].push_back({{"index", publisher.index},
                                     {"sent", publisher.sent},
                                     {"refused", publisher.refused},
                                     {"usage", to_json(publisher.usage)}});
      }
      one["subscribers"] = Json::array();
      for (const Subscriber& subscriber : stream.subscribers) {
        const std::string text = to_csv(subscriber.samples);
        std::string name = "raw/" + word_of(cell.conditions) + "." + file_word(arm.transport);
        if (!stream.name.empty()) name += '.' + file_word(stream.name);
        name += ".s" + std::to_string(subscriber.index) + '.' + checksum(text) + ".csv";
        if (!fs::exists(dir / name)) write_at_once(dir / name, text);
        one["subscribers"].push_back({{"index", subscriber.index},
                                      {"sent", sent(stream)},
                                      {"received", subscriber.received},
                                      {"missed", subscriber.missed},
                                      {"lost", subscriber.lost},
                                      {"spoilt", subscriber.spoilt},
                                      {"latency_us", latencies_of(subscriber)},
                                      {"usage", to_json(subscriber.usage)},
                                      {"raw", name}});
      }
      one["blocks"] = Json::array();
      for (const BlockTime& block : stream.blocks) {
        one["blocks"].push_back(
            {{"block", block.block}, {"messages", block.messages}, {"took_ns", block.took}});
      }
      one["block_costs"] = Json::array();
      for (const BlockCost& block : stream.block_costs) {
        one["block_costs"].push_back({{"block", block.block},
                                      {"sent", block.sent},
                                      {"publishers_cpu_us", block.publishers_us},
                                      {"subscribers_cpu_us", block.subscribers_us}});
      }
      one["all"] = derived(cell, arm, stream);
      streams.push_back(std::move(one));
    }
    Json utilisation = Json::array();
    for (const Utilisation& reading : arm.utilisation) {
      utilisation.push_back(
          {{"node", reading.node}, {"at_ns", reading.at}, {"cores", reading.cores}});
    }
    arms.push_back({{"transport", arm.transport},
                    {"is_floor", arm.is_floor},
                    {"copies", arm.copies},
                    {"refused", arm.refused},
                    {"streams", std::move(streams)},
                    {"daemon_cpu_us", arm.daemon_cpu_us},
                    {"utilisation", std::move(utilisation)},
                    {"profile", to_json(arm.profile)}});
  }
  return {{"conditions", to_json(cell.conditions)},
          {"command", cell.command},
          {"revision", cell.revision},
          {"arms", std::move(arms)}};
}

Cell cell_of(const Json& json, const fs::path& dir) {
  Cell cell;
  cell.conditions = conditions_of(json.at("conditions"));
  cell.command = json.value("command", "");
  cell.revision = json.value("revision", "");
  for (const Json& from : json.at("arms")) {
    Arm arm;
    arm.transport = from.at("transport");
    arm.is_floor = from.at("is_floor");
    arm.copies = from.at("copies");
    arm.refused = from.at("refused");
    for (const Json& one : from.at("streams")) {
      StreamResult stream;
      stream.name = one.at("name");
      stream.size = one.at("size");
      stream.rate_hz = one.at("rate_hz");
      for (const Json& publisher : one.at("publishers")) {
        stream.publishers.push_back({publisher.at("index"), publisher.at("sent"),
                                     publisher.at("refused"), usage_of(publisher.at("usage"))});
      }
      for (const Json& subscriber : one.at("subscribers")) {
        stream.subscribers.push_back({subscriber.at("index"), subscriber.at("received"),
                                      subscriber.at("missed"), subscriber.at("lost"),
                                      subscriber.at("spoilt"), usage_of(subscriber.at("usage")),
                                      from_csv(dir / subscriber.at("raw").get<std::string>())});
      }
      for (const Json& block : one.at("blocks")) {
        stream.blocks.push_back({block.at("block"), block.at("messages"), block.at("took_ns")});
      }
      for (const Json& block : one.at("block_costs")) {
        stream.block_costs.push_back({block.at("block"), block.at("sent"),
                                      block.at("publishers_cpu_us"),
                                      block.at("subscribers_cpu_us")});
      }
      arm.streams.push_back(std::move(stream));
    }
    arm.daemon_cpu_us = from.at("daemon_cpu_us");
    for (const Json& reading : from.at("utilisation")) {
      arm.utilisation.push_back({reading.at("node"), reading.at("at_ns"), reading.at("cores")});
    }
    arm.profile = profile_of(from.at("profile"));
    cell.arms.push_back(std::move(arm));
  }
  return cell;
}

// ---- directories --------------------------------------------------------------------------------

void remove_other_raw_files(const Json& json, const fs::path& dir) {
  std::set<std::string> named;
  for (const Json& cell : json.at("cells")) {
    for (const Json& arm : cell.at("arms")) {
      for (const Json& stream : arm.at("streams")) {
        for (const Json& subscriber : stream.at("subscribers")) {
          named.insert(subscriber.at("raw").get<std::string>());
        }
      }
    }
  }
  for (const auto& entry : fs::directory_iterator(dir / "raw")) {
    const std::string name = entry.path().filename();
    const bool ours = name.ends_with(".csv") || name.find(".unfinished") != std::string::npos;
    if (ours && !named.contains("raw/" + name)) fs::remove(entry.path());
  }
}

/// Parses a run.json as far as every reader needs; explains what else it is.
Json read_run(const fs::path& file) {
  Json json;
  try {
    json = Json::parse(read(file));
    if (json.at("format") != "lot_ab") fail(file, "is not a run of lot_ab");
    if (json.at("version") != kVersion) {
      fail(file, "is of version " + json.at("version").dump() + " and this program reads version " +
                     std::to_string(kVersion) + ": choose another directory, or delete this one");
    }
  } catch (const Json::exception& error) {
    fail(file, std::string("is not a run of lot_ab: ") + error.what());
  }
  return json;
}

void check_machine(const Json& json, const Machine& now, const fs::path& file) {
  const Machine before = machine_of(json.at("machine"));
  if (before.cpu == now.cpu && before.cores == now.cores && before.kernel == now.kernel) return;
  throw std::invalid_argument(file.string() + ": was measured on another machine (" + before.cpu +
                              ", " + std::to_string(before.cores) + " cores, " + before.kernel +
                              "): choose another directory");
}

void save_with(Json cells, const Run& run, const fs::path& dir) {
  fs::create_directories(dir / "raw");
  for (const Cell& cell : run.cells) {
    Json fresh = to_json(cell, dir);
    const auto same = std::find_if(cells.begin(), cells.end(), [&](const Json& old) {
      return old.at("conditions") == fresh.at("conditions");
    });
    if (same != cells.end()) {
      *same = std::move(fresh);
    } else {
      cells.push_back(std::move(fresh));
    }
  }
  const Json json{{"format", "lot_ab"},       {"version", kVersion},
                  {"command", run.command},   {"started", run.started},
                  {"revision", run.revision}, {"seed", run.seed},
                  {"complete", run.complete}, {"machine", to_json(run.machine)},
                  {"cells", std::move(cells)}};
  write_at_once(dir / "run.json", json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
  remove_other_raw_files(json, dir);
}

}  // namespace

std::string word_of(const Conditions& conditions) {
  std::ostringstream word;
  word << conditions.mode << '-' << conditions.graph << '-' << conditions.size << '-'
       << conditions.rate_hz << "hz-" << conditions.messages << "by" << conditions.block << '-'
       << conditions.wait << '-' << conditions.pin << '-' << conditions.place << "-pool"
       << conditions.pool << "-depth" << conditions.depth
       << (conditions.lossless ? "-lossless" : "") << (conditions.ordered ? "-ordered" : "")
       << (conditions.fill ? "" : "-unfilled");
  return file_word(word.str());
}

void save(const Run& run, const fs::path& dir) { save_with(Json::array(), run, dir); }

void add(const Run& run, const fs::path& dir) {
  const fs::path file = dir / "run.json";
  if (!fs::exists(file)) return save(run, dir);
  Json old = read_run(file);
  check_machine(old, run.machine, file);
  save_with(std::move(old.at("cells")), run, dir);
}

std::vector<CellArms> saved_cells(const fs::path& dir, const Machine& machine) {
  std::vector<CellArms> cells;
  const fs::path file = dir / "run.json";
  if (!fs::exists(file)) return cells;
  const Json json = read_run(file);
  check_machine(json, machine, file);
  for (const Json& cell : json.at("cells")) {
    CellArms saved{conditions_of(cell.at("conditions")), {}};
    for (const Json& arm : cell.at("arms")) {
      if (!has_failed(arm.at("refused").get<std::string>()))
        saved.arms.push_back(arm.at("transport"));
    }
    cells.push_back(std::move(saved));
  }
  return cells;
}

Run load(const fs::path& path) {
  const fs::path file = fs::is_directory(path) ? path / "run.json" : path;
  const Json json = read_run(file);
  if (!json.value("cells", Json::array()).empty() && !fs::exists(file.parent_path() / "raw")) {
    fail(
        file,
        "the single samples beside it (raw/), from which tables, figures and comparisons are made, "
        "were not kept; what was made of them may lie there, as tables.txt and figures/");
  }
  try {
    Run run;
    run.command = json.at("command");
    run.started = json.at("started");
    run.revision = json.at("revision");
    run.seed = json.at("seed");
    run.complete = json.at("complete");
    run.machine = machine_of(json.at("machine"));
    for (const Json& cell : json.at("cells")) {
      run.cells.push_back(cell_of(cell, file.parent_path()));
    }
    return run;
  } catch (const Json::exception& error) {
    fail(file, error.what());
  }
}

}  // namespace ab
