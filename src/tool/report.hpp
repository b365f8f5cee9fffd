// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "tool/commands.hpp"

/// What the commands have in common: a document for programs, or text and hints for people.
namespace lot::tool {

using Json = nlohmann::ordered_json;

class Report {
 public:
  explicit Report(const Settings& settings) : json_(settings.json) {}

  void print(const std::string& text) {
    if (!json_) text_ += text;
  }
  /// A last line that says what to do about something.
  void hint(const std::string& text) { hints_.push_back(text); }
  void ends(Exit exit) { exit_ = graver(exit_, exit); }
  Json& document() { return document_; }

  /// Writes everything to standard output.
  Exit finish();

 private:
  bool json_;
  std::string text_;
  std::vector<std::string> hints_;
  Json document_ = Json::object();
  Exit exit_ = kWell;
};

/// As segment::command(), harmless to a terminal.
std::string command(const std::string& words, const std::string& path);

/// One segment's head: "LOTROS  /dev/shm/LOTROS", or why there is nothing more to say about it.
/// Enters what is wrong with it in the report. True when it can be observed.
bool introduce(const Sight& sight, Report& report, Json& entry);
/// "12 items wait in jobs, 3 in logs"
std::string waiting_text(const Waiting& items);
Json waiting_json(const Waiting& items);
/// Damage and deaths that the observation has found.
void judge(const Sight& sight, const Observation& seen, Report& report, Json& entry);
/// What keeps processes from joining, or makes them wait: something else in the place of a file, a
/// process that is stopped where others must pass. Of all that the settings name, besides `found`.
void look_for_obstacles(const Settings& settings, const std::vector<Sight>& found, Report& report);
/// Nothing was there: says so.
void nothing_found(const Settings& settings, Report& report);

}  // namespace lot::tool
