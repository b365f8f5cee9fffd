// SPDX-License-Identifier: Apache-2.0

// As many processes, readers and publishers as a segment is made for.

#include "support/processes.hpp"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <string>
#include <unistd.h>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "message.hpp"
#include "support/error_of.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

constexpr unsigned kWatchdog = 300;
constexpr auto kPatience = 200s;

/// Processes of one kind, which say when they have joined and when they have done their work.
class Nodes {
 public:
  Nodes(std::size_t count, const char* role, const lot::EngineOptions& options, unsigned messages,
        std::size_t partners) {
    const std::string n = std::to_string(messages);
    const std::string p = std::to_string(partners);
    for (std::size_t i = 0; i < count; ++i) {
      nodes_.emplace_back([&] {
        alarm(kWatchdog);
        begin_.become(0, 100);
        leave_.become(0, 101);
        said_.become(1, STDOUT_FILENO);
        execl(LOT_LIMITS_NODE, LOT_LIMITS_NODE, role, options.directory.c_str(),
              options.segment.c_str(), n.c_str(), p.c_str(), nullptr);
        must(false, LOT_LIMITS_NODE);
      });
    }
  }

  /// All have said that they are so far.
  bool are_ready() {
    return std::all_of(nodes_.begin(), nodes_.end(),
                       [&](const Child&) { return said_.next(kPatience) == '.'; });
  }
  void go() { tell(begin_); }
  /// What remains after go(): the work, and leaving.
  bool finish() {
    const bool worked = are_ready();
    tell(leave_);
    for (Child& node : nodes_) good_ += node.wait() == 0;
    return worked && good_ == nodes_.size();
  }
  void kill_one() {
    nodes_.back().kill9();
    nodes_.pop_back();
  }

 private:
  void tell(const Steps& order) const {
    for (std::size_t i = 0; i < nodes_.size(); ++i) order.tell();
  }

  Steps begin_;
  Steps leave_;
  Steps said_;
  std::vector<Child> nodes_;
  std::size_t good_ = 0;
};

}  // namespace

TEST_SUITE_BEGIN("limits");

TEST_CASE("as many processes as there can be, most of them readers of one topic") {
  const Watchdog watchdog(kWatchdog);
  auto options = fresh();
  options.processes = 319;
  constexpr std::size_t kReaders = 250;
  constexpr std::size_t kPublishers = 4;
  {
    lot::ShmEngine engine(options);
    lot::segment::Segment segment(engine.path());
    Nodes readers(kReaders, "read", options, 20, kPublishers);
    Nodes publishers(kPublishers, "publish", options, 20, kReaders);
    Nodes others(options.processes - 1 - kReaders - kPublishers, "join", options, 0, 0);
    REQUIRE(readers.are_ready());
    REQUIRE(publishers.are_ready());
    REQUIRE(others.are_ready());
    CHECK(Audit(segment).participants == 319);

    Child beyond([&] {
      const auto [error, text] = error_of([&] { lot::ShmEngine one_more(options); });
      must(error == EUSERS, text.c_str());
      must(names(text, "EngineOptions::processes"), text.c_str());
    });
    CHECK(beyond.wait() == 0);

    readers.go();
    publishers.go();
    CHECK(publishers.finish());
    CHECK(readers.finish());
    // Whoever is killed makes place for another.
    others.kill_one();
    Nodes another(kReaders + kPublishers + 1, "join", options, 0, 0);
    CHECK(another.are_ready());
    CHECK(Audit(segment).participants == 319);
    for (Nodes* nodes : {&another, &others}) {
      nodes->go();
      CHECK(nodes->finish());
    }
    CHECK(eventually([&] { return Audit(segment).participants == 1; }));
    CHECK(Audit(segment).nothing());
  }
  CHECK(files_of(options) == 0);
}

TEST_CASE("64 publishers of one topic, and 190 readers, lose nothing") {
  const Watchdog watchdog(kWatchdog);
  auto options = fresh();
  options.processes = 256;
  options.readers = 190;
  constexpr std::size_t kReaders = 190;
  constexpr std::size_t kPublishers = 64;
  {
    lot::ShmEngine engine(options);
    lot::segment::Segment segment(engine.path());
    Nodes publishers(kPublishers, "publish", options, 20, kReaders);
    REQUIRE(publishers.are_ready());
    Nodes readers(kReaders, "read", options, 20, kPublishers);
    REQUIRE(readers.are_ready());
    CHECK(Audit(segment).readers == kReaders * kPublishers);
    const auto [error, text] = error_of([&] { return engine.subscribe<Numbered>("/t"); });
    CHECK(error == EUSERS);
    CHECK(names(text, "EngineOptions::readers"));
    readers.go();
    publishers.go();
    CHECK(publishers.finish());
    CHECK(readers.finish());
    CHECK(eventually([&] { return Audit(segment).participants == 1; }));
    CHECK(eventually([&] { return Audit(segment).nothing(); }));
  }
  CHECK(files_of(options) == 0);
}

TEST_SUITE_END();
