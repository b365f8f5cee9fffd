// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdio>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "lot/lot.hpp"

#include "support/must_go.hpp"
#include "support/neighbour.hpp"

namespace lot::testing {

/// A process in a segment that does what it is told: it says its name on a topic, and says whose
/// names it has heard there.
class Puppet {
 public:
  Puppet(const EngineOptions& options, char name)
      : name_(name), child_([&options, name, this] { live(options, name); }) {
    joined_ = answer_.next() == 'y';
  }

  bool joined() const { return joined_; }
  pid_t pid() const { return child_.pid(); }
  /// Whether `other` hears what this one says now.
  bool reaches(Puppet& other) {
    say();
    return eventually([&] { return other.has_heard(name_); }, 5s);
  }
  bool talks_to(Puppet& other) { return reaches(other) && other.reaches(*this); }
  /// The opposite of talks_to(), which would wait for what does not come.
  bool knows_nothing_of(Puppet& other) {
    say();
    other.say();
    return !has_heard(other.name_) && !other.has_heard(name_);
  }
  void stop() const {
    child_.send(SIGSTOP);
    int status = 0;
    must(waitpid(child_.pid(), &status, WUNTRACED) == child_.pid() && WIFSTOPPED(status), "stop");
  }
  void go_on() const { child_.send(SIGCONT); }
  void kill9() { child_.kill9(); }
  /// Leaves the segment and ends.
  bool leave() {
    tell("x");
    return child_.wait() == 0;
  }

 private:
  struct Word {
    char name;
  };

  void tell(std::string_view order) const {
    for (const char c : order) order_.tell(c);
  }
  void say() {
    tell("s");
    must(answer_.next() == 'y', "it was said");
  }
  bool has_heard(char name) {
    tell(std::string("h") + name);
    return answer_.next() == 'y';
  }

  void live(const EngineOptions& options, char name) {
    std::optional<ShmEngine> engine;
    try {
      engine.emplace(named(options, std::string(1, name).c_str()));
    } catch (const Error& e) {
      std::fprintf(stderr, "%c does not join: %s\n", name, e.what());
      answer_.tell('n');
      return;
    }
    auto mouth = engine->advertise<Word>("/talk");
    auto ears = engine->subscribe<Word>("/talk");
    answer_.tell('y');
    std::set<char> heard;
    for (;;) {
      switch (order_.next(60s)) {
        case 's':
          must_go(mouth.push(mouth.loan(Word{name})));
          answer_.tell('y');
          break;
        case 'h': {
          while (auto seen = ears.try_pull()) heard.insert(seen->name);
          answer_.tell(heard.erase(order_.next()) != 0 ? 'y' : 'n');
          break;
        }
        default:
          return;
      }
    }
  }

  char name_;
  bool joined_ = false;
  Steps order_, answer_;
  Child child_;
};

}  // namespace lot::testing
