// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <sys/types.h>
#include <vector>

#include <nlohmann/json.hpp>

#include "settings.hpp"

namespace demo {

using Json = nlohmann::json;

/// Ctrl-C, or a signal that means the same.
struct Interrupted : std::runtime_error {
  Interrupted() : std::runtime_error("interrupted") {}
};

// ---- in the process that the user has started
// -----------------------------------------------------

/// A process of the demo: this program once more, in another role. It hears single letters on its
/// standard input and answers with lines of JSON, {"event": ...}, on its standard output.
struct Child {
  std::string name;
  pid_t pid = -1;  ///< -1: it has ended
  int control = -1;
  int reports = -1;
  std::string unfinished_line;
  std::map<std::string, Json> said;  ///< by event: the last report

  bool has_said(const std::string& event) const { return said.count(event) != 0; }
  static constexpr char kStop = 's';
  static constexpr char kPause = 'p';  ///< camera: stay between loan and push
  void tell(char word) const;
  /// SIGKILL; returns when it is dead.
  void kill();
};

/// All children. None of them outlives it.
class Family {
 public:
  Family() = default;
  ~Family();
  Family(const Family&) = delete;
  Family& operator=(const Family&) = delete;

  /// Starts this program with these settings. A dead child of that name is replaced.
  Child& start(const std::string& name, const Settings& settings);
  Child& operator[](const std::string& name) { return *children_.at(name); }

  /// Listens to the children until `done`. Throws when it takes too long or when a child ends
  /// that was neither killed nor has said "done".
  void wait_until(const std::string& what, const std::function<bool()>& done,
                  std::chrono::seconds patience = std::chrono::seconds(20));
  /// Lets all of them leave in peace.
  void dismiss();

  std::function<void()> on_report;  ///< called when something was said

 private:
  void listen(std::chrono::milliseconds timeout);
  void hear(Child& child);

  std::map<std::string, std::unique_ptr<Child>> children_;
};

/// SIGINT, SIGTERM and SIGHUP end what waits in a Family by Interrupted.
void catch_signals();
/// Has one of them come?
bool interrupted();

std::string consumer_name(unsigned number);

// ---- in a child
// -------------------------------------------------------------------------------------

/// What the parent wants.
class Control {
 public:
  /// REQUIRES: one at a time. With `leave_in_peace`, SIGTERM only means stop().
  explicit Control(bool leave_in_peace);
  /// Never waits.
  bool stop();
  bool pause();
  /// Until told to stop.
  void wait();

 private:
  void listen(int timeout_ms);
  bool stop_ = false;
  bool pause_ = false;
};

void say(const std::string& event, Json more = Json::object());

/// CPU seconds of this process since it was made.
class CpuTime {
 public:
  CpuTime();
  double seconds() const;

 private:
  double begin_;
};

}  // namespace demo
