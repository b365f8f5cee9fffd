// SPDX-License-Identifier: Apache-2.0

// What each variable of the environment may say, and what the options may be.

#include "transport/environment.hpp"

#include <cerrno>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/error.hpp"

#include "lockfree_ring/ring.hpp"
#include "segment/layout.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/variable.hpp"

namespace {

using namespace lot::testing;
using lot::EngineOptions;
using lot::transport::with_environment;

/// The options while a variable has this value.
EngineOptions options_with(const char* name, const char* value) {
  prefix();
  const Variable variable(name, value);
  return with_environment(EngineOptions());
}

/// The error then.
std::string refused(const char* name, const char* value) {
  const auto [error, text] = error_of([&] { (void)options_with(name, value); });
  CHECK(error == (text == "no error" ? 0 : EINVAL));
  return text;
}

std::string refused(const std::function<void(EngineOptions&)>& change) {
  prefix();
  EngineOptions options;
  change(options);
  return error_of([&] { (void)with_environment(options); }).second;
}

}  // namespace

TEST_SUITE_BEGIN("environment");

TEST_CASE("LOT_SIZE is a number of bytes, with a unit or without") {
  constexpr std::uint64_t kKiB = 1 << 10, kMiB = 1 << 20, kGiB = 1 << 30;
  const std::pair<const char*, std::uint64_t> kSizes[] = {
      {"1", 1},
      {"4096", 4096},
      {"4096B", 4096},
      {"3K", 3 * kKiB},
      {"3k", 3 * kKiB},
      {"2M", 2 * kMiB},
      {"2m", 2 * kMiB},
      {"5G", 5 * kGiB},
      {"5g", 5 * kGiB},
      {"1T", kGiB * kKiB},
      {"1t", kGiB * kKiB},
      {"007", 7},
      {"18446744073709551615", UINT64_MAX},
      {"16777215T", 16777215 * kGiB * kKiB},
      {"18014398509481983K", UINT64_MAX - kKiB + 1}};
  for (const auto& [text, bytes] : kSizes) {
    CAPTURE(std::string(text));
    CHECK(options_with("LOT_SIZE", text).size_bytes == bytes);
  }
  for (const char* text :
       {"0", "0K", "-1", "K", "many", "1X", "1KB", "1K ", "1.5M", "1 K", "b", " 7", "+7", " -1",
        "18446744073709551616", "16777216T", "18014398509481984K"}) {
    CHECK(refused("LOT_SIZE", text) ==
          std::string("lot: LOT_SIZE=") + text +
              ": not a size (Invalid argument); write a number of bytes, or one with K, M, G or T "
              "behind it");
  }
  CHECK(options_with("LOT_SIZE", "").size_bytes == EngineOptions().size_bytes);
}

TEST_CASE("LOT_PERMISSIONS are those of a file that this user reads and writes") {
  for (const auto& [text, mode] : {std::pair("600", 0600U), std::pair("0660", 0660U),
                                   std::pair("0606", 0606U), std::pair("666", 0666U)}) {
    CHECK(options_with("LOT_PERMISSIONS", text).permissions == mode);
  }
  for (const char* text : {"0", "0400", "0200", "0700", "0601", "0610", "01600", "1777", "x",
                           "600x", "0680", "0060"}) {
    CHECK(refused("LOT_PERMISSIONS", text)
              .find(std::string("LOT_PERMISSIONS=") + text + ": not usable permissions") !=
          std::string::npos);
  }
}

TEST_CASE("each switch of the environment is 1 or 0, and comes before the code") {
  prefix();
  const std::pair<const char*, bool (*)(bool)> kSwitches[] = {
      {"LOT_STAMP", &lot::transport::stamps},
      {"LOT_FAST_LANE", &lot::transport::fast_lane},
      {"LOT_PERSIST",
       [](bool asked) {
         EngineOptions options;
         options.persist = asked;
         return with_environment(options).persist;
       }},
      {"LOT_MLOCK", [](bool asked) {
         EngineOptions options;
         options.lock_memory = asked;
         return with_environment(options).lock_memory;
       }}};
  for (const auto& [name, read] : kSwitches) {
    CAPTURE(std::string(name));
    CHECK(read(true));
    CHECK(!read(false));
    for (const bool asked : {false, true}) {
      {
        const Variable on(name, "1");
        CHECK(read(asked));
      }
      {
        const Variable off(name, "0");
        CHECK(!read(asked));
      }
      const Variable empty(name, "");
      CHECK(read(asked) == asked);
    }
    for (const char* text : {"2", "00", "11", "yes", " 1"}) {
      const Variable wrong(name, text);
      CHECK(error_of([says = read] { (void)says(false); }) ==
            std::pair(EINVAL, std::string("lot: ") + name + "=" + text +
                                  ": neither 1 nor 0 (Invalid argument); write 1 or 0, or leave it "
                                  "away"));
    }
  }
}

TEST_CASE("LOT_QUEUE names an engine, and LOT_SEGMENT, LOT_DIR, LOT_USER, LOT_GROUP are texts") {
  prefix();
  using lot::QueueEngine;
  using lot::transport::queue_engine;
  for (const auto asked : {QueueEngine::Ring, QueueEngine::Mutex}) {
    CHECK(queue_engine(asked) == asked);
    const Variable ring("LOT_QUEUE", "ring");
    CHECK(queue_engine(asked) == QueueEngine::Ring);
    const Variable mutex("LOT_QUEUE", "mutex");
    CHECK(queue_engine(asked) == QueueEngine::Mutex);
  }
  const Variable wrong("LOT_QUEUE", "Ring");
  CHECK(error_of([] { (void)queue_engine({}); }).second ==
        "lot: LOT_QUEUE=Ring: not a queue engine (Invalid argument); write ring or mutex, or leave "
        "it away");
  CHECK(options_with("LOT_SEGMENT", "s").segment == "s");
  CHECK(options_with("LOT_DIR", "/d").directory == "/d");
  CHECK(options_with("LOT_USER", "u").user == "u");
  CHECK(options_with("LOT_GROUP", "g").group == "g");
  CHECK(options_with("LOT_GROUP", "").group.empty());
  const Variable group("LOT_GROUP", "4711"), user("LOT_USER", "4712");
  const auto trust = lot::transport::trust_of_environment();
  CHECK(trust.group == 4711);
  CHECK(trust.user == 4712);
  CHECK(trust.mode == 0660);
}

TEST_CASE("options of an engine have bounds, each of which is told; it has a name") {
  const auto bound = [](const char* name, auto member, std::uint64_t most) {
    CAPTURE(std::string(name));
    const auto with = [member](std::uint64_t value) {
      return refused([&](EngineOptions& options) {
        options.*member = static_cast<std::remove_reference_t<decltype(options.*member)>>(value);
      });
    };
    CHECK(with(1) == "no error");
    CHECK(with(most) == "no error");
    for (const std::uint64_t value : {std::uint64_t{0}, most + 1}) {
      CHECK(with(value) ==
            std::string("lot: EngineOptions::") + name + ": " + std::to_string(value) +
                " is out of range (Invalid argument); use 1 to " + std::to_string(most));
    }
  };
  bound("processes", &EngineOptions::processes, 319);
  bound("blocks", &EngineOptions::blocks, lot::ring::kNoBlock - 1);
  bound("topics", &EngineOptions::topics, 1 << 20);
  bound("channels", &EngineOptions::channels, 1 << 20);
  bound("readers", &EngineOptions::readers, 1 << 16);
  EngineOptions options;
  CHECK(with_environment(options).name == program_invocation_short_name);
  options.name = "mine";
  CHECK(with_environment(options).name == "mine");
}

TEST_SUITE_END();
