// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <csignal>
#include <cstdlib>
#include <fcntl.h>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <unistd.h>
#include <utility>
#include <vector>

#include "lot/options.hpp"

#include "support/processes.hpp"
#include "support/scratch.hpp"

/// lot_gateway, as a user runs it.
namespace lot::testing {

/// Settings of CycloneDDS by which the programs of one test meet each other alone.
inline std::string uri_of_this_test() {
  return "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface "
         "address=\"127.0.0.1\"/></Interfaces><AllowMulticast>false</AllowMulticast></General>"
         "<Discovery><Tag>lot" +
         std::to_string(getpid()) +
         "</Tag><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>99"
         "</MaxAutoParticipantIndex><Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery>"
         "</Domain></CycloneDDS>";
}

/// One line of the table that it prints.
struct Line {
  std::uint64_t carried = 0, bytes = 0, missed = 0, before = 0, lost = 0, refused = 0, damaged = 0,
                looped = 0, unheard = 0;
};

class Gateway {
 public:
  Gateway(const EngineOptions& segment, std::vector<std::string> words) {
    const std::string uri = uri_of_this_test();
    child_ = Child([&] {
      const int out = open(out_.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
      const int err = open(err_.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
      must(dup2(out, 1) == 1 && dup2(err, 2) == 2, "its output");
      setenv("CYCLONEDDS_URI", uri.c_str(), 1);
      setenv("LOT_SEGMENT", segment.segment.c_str(), 1);
      words.insert(words.begin(), "lot_gateway");
      std::vector<char*> arguments;
      for (std::string& word : words) arguments.push_back(word.data());
      arguments.push_back(nullptr);
      execv(LOT_GATEWAY, arguments.data());
      must(false, LOT_GATEWAY);
    });
  }

  /// Waits until it has said so.
  bool says(const std::string& text) const {
    return eventually([&] { return said().find(text) != std::string::npos; });
  }
  std::string said() const { return text_of(err_); }
  /// SIGTERM: the lines that it prints then, by direction and topic: "out /pose".
  std::map<std::string, Line> end() {
    child_.send(SIGTERM);
    exit_ = child_.wait();
    return lines();
  }
  /// Waits until it has ended by itself: its exit status.
  int ends() { return exit_ = child_.wait(); }
  /// What it has carried until now.
  std::map<std::string, Line> look() {
    truncate(out_.c_str(), 0);
    child_.send(SIGUSR1);
    eventually([&] { return !lines().empty(); });
    return lines();
  }
  /// How many tables it has printed, since look() last.
  std::size_t tables() const {
    const std::string all = text_of(out_);
    std::size_t n = 0;
    for (std::size_t at = 0; (at = all.find("carried", at)) != std::string::npos; ++at) ++n;
    return n;
  }
  void send(int signal) const { child_.send(signal); }
  void kill9() { child_.kill9(); }
  int exit() const { return exit_; }

 private:
  static std::string text_of(const std::string& file) {
    std::ifstream in(file);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  std::map<std::string, Line> lines() const {
    std::istringstream all(text_of(out_));
    std::map<std::string, Line> lines;
    for (std::string text; std::getline(all, text);) {
      std::istringstream in(text);
      std::string direction, topic;
      Line line;
      in >> direction >> line.carried >> line.bytes >> line.missed >> line.before >> line.lost >>
          line.refused >> line.damaged >> line.looped >> line.unheard >> topic;
      if (in) lines[direction + " " + topic] = line;
    }
    return lines;
  }

  std::unique_ptr<Directory> scratch_ = std::make_unique<Directory>();
  std::string out_ = scratch_->file("out");
  std::string err_ = scratch_->file("err");
  Child child_;
  int exit_ = -1;
};

}  // namespace lot::testing
