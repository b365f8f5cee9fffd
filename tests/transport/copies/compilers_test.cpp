// SPDX-License-Identifier: Apache-2.0

// Programs that g++ has built and programs that clang has built on one segment.

#include <cstdio>
#include <string>
#include <unistd.h>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/processes.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const std::string& prefix_taken = prefix();

const std::string kOwn = LOT_PEER;
const std::string kOther = LOT_OTHER_PEER;  // empty: there is no second compiler

Child start(const std::string& program, const char* role, const lot::EngineOptions& options,
            unsigned count, unsigned readers) {
  return Child([&] {
    const std::string n = std::to_string(count);
    const std::string r = std::to_string(readers);
    execl(program.c_str(), program.c_str(), role, options.directory.c_str(),
          options.segment.c_str(), n.c_str(), r.c_str(), nullptr);
    must(false, program.c_str());
  });
}

bool there_are_two() {
  if (kOther.empty()) std::puts("skipped: no second compiler here");
  return !kOther.empty();
}

}  // namespace

TEST_SUITE_BEGIN("copies");

TEST_CASE("what one compiler's program publishes another's reads, whichever makes the segment") {
  if (!there_are_two()) return;
  const Watchdog watchdog(120);
  for (const std::string& publisher : {kOwn, kOther}) {
    for (const std::string& first : {kOwn, kOther}) {
      const auto options = fresh();
      Child reader = start(first, "read", options, 100, 2);
      REQUIRE(eventually([&] { return files_of(options) >= 2; }));
      Child sender = start(publisher, "publish", options, 100, 2);
      Child second = start(first == kOwn ? kOther : kOwn, "read", options, 100, 2);
      CHECK(sender.wait() == 0);
      CHECK(reader.wait() == 0);
      CHECK(second.wait() == 0);
      CHECK(eventually([&] { return files_of(options) == 0; }));
    }
  }
}

TEST_CASE("one compiler's program repairs what a killed one of another compiler leaves") {
  if (!there_are_two()) return;
  const Watchdog watchdog(120);
  for (const std::string& victim : {kOwn, kOther}) {
    const std::string& rest = victim == kOwn ? kOther : kOwn;
    const auto options = fresh();
    Child sender = start(rest, "publish", options, 3000, 2);
    Child reader = start(rest, "read", options, 3000, 2);
    Child killed = start(victim, "read", options, 3000, 2);
    {
      lot::ShmEngine engine(options);
      lot::segment::Segment segment(engine.path());
      REQUIRE(eventually([&] { return Audit(segment).own_bits > 4; }, 30s));
      killed.kill9();
    }
    CHECK(sender.wait() == 0);
    CHECK(reader.wait() == 0);
    CHECK(eventually([&] { return files_of(options) == 0; }));
  }
}

TEST_SUITE_END();
