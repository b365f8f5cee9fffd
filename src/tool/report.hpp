// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "tool/commands.hpp"

/// What the commands have in common: a document for programs, or text and hints for people.
namespace lot::tool {

using Json = nlohmann::ordered_json;
template <class T>
Json or_null(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}

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
  /// For a command that cannot go on: writes the text to standard error; with --json the document,
  /// too, where it is a hint.
  Exit refuse(const std::string& text, Exit exit);

 private:
  bool json_;
  std::string text_;
  std::vector<std::string> hints_;
  Json document_ = Json::object();
  Exit exit_ = kWell;
};

/// As segment::command(), with unprintable bytes replaced: names could steer a terminal.
std::string command(const std::string& words, const std::string& path);

/// Prints a segment's first line: "LOTROS  /dev/shm/LOTROS", or why there is nothing more to say
/// about it. Notes in the report what is wrong with it. True when it can be observed.
bool introduce(const Sight& sight, Report& report, Json& entry);
/// "12 items wait in jobs, 3 in logs"
std::string waiting_text(const Waiting& items);
Json waiting_json(const Waiting& items);
/// Reports the damage and the deaths that the observation has found.
void judge(const Sight& sight, const Observation& seen, Report& report, Json& entry);
/// Reports what keeps processes from joining or makes them wait: something else in the place of a
/// file, a stopped process where others must pass. It looks at all that the settings name, besides
/// `found`.
void look_for_obstacles(const Settings& settings, const std::vector<Sight>& found, Report& report);
/// Reports that nothing was found.
void nothing_found(const Settings& settings, Report& report);

}  // namespace lot::tool
