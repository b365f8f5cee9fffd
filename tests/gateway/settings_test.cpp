// SPDX-License-Identifier: Apache-2.0

// What a gateway is told, what gateways tell each other, and what one tells its successor: names,
// files of settings, user data, ledgers, rates.

#include <cerrno>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "gateway/ledger.hpp"
#include "gateway/names.hpp"
#include "gateway/peer.hpp"
#include "gateway/rate_limit.hpp"
#include "gateway/settings_file.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"
#include "support/scratch.hpp"

namespace lot::testing {
namespace {

using namespace gateway;

struct Pose {
  double x = 0;
  ShmVector<std::int32_t> parts;
};

Settings read(const std::string& text) {
  const Directory directory;
  write_file(directory.file(), text);
  Settings settings;
  read_settings(directory.file(), settings);
  return settings;
}

/// The line that an error names, and what it says.
std::string wrong(const std::string& text) {
  const auto [number, what] = error_of([&] { (void)read(text); });
  CHECK(number == EINVAL);
  return what.substr(what.find(".mcap:") + 6);
}

TEST_SUITE_BEGIN("gateway");

TEST_CASE("topics and types are called in DDS as ROS 2 calls them, and back") {
  CHECK(dds_topic_of("/camera/front") == "rt/camera/front");
  CHECK(dds_topic_of("pose") == "rt/pose");
  CHECK(topic_of_dds("rt/camera/front") == "/camera/front");
  for (const char* name : {"", "/", "//a", "/a/", "/a b", "/1a", "/a/1", "/a-b", "/a*"}) {
    CAPTURE(name);
    CHECK(!dds_topic_of(name));
  }
  for (const char* name : {"", "rt", "rt/", "rq/serviceRequest", "ros_discovery_info", "rt/a//b"}) {
    CAPTURE(name);
    CHECK(!topic_of_dds(name));
  }
  CHECK(dds_type_of("sensor_msgs/msg/Image") == "sensor_msgs::msg::dds_::Image_");
}

TEST_CASE("a file of settings has topics with their quality of service, and limits") {
  const Settings s = read(
      "domain: 7\n"
      "interface: eth0\n"
      "max_size_mib: 2\n"
      "most_incoming: 9\n"
      "out:\n"
      "  - /camera/*\n"
      "  - {topics: /map, durability: transient_local, depth: 1, dds_topic: rt/other}\n"
      "in:\n"
      "  - topics: /cmd_vel\n"
      "    reliability: best_effort\n"
      "    deadline_ms: 1.5\n"
      "    max_rate: 100\n"
      "    max_memory_mib: 0.5\n"
      "    type: geometry_msgs/msg/Twist\n");
  CHECK(s.domain.id == 7);
  CHECK(s.domain.interface == "eth0");
  CHECK(s.domain.max_size == 2 << 20);
  CHECK(s.most_incoming == 9);
  REQUIRE(s.out.size() == 2);
  CHECK(s.out[0].topics == "/camera/*");
  CHECK(s.out[0] == RouteSettings{"/camera/*", "", {}, {}, ""});
  CHECK(s.out[1].dds_topic == "rt/other");
  CHECK(s.out[1].quality.durability == Durability::TransientLocal);
  CHECK(s.out[1].quality.depth == 1);
  REQUIRE(s.in.size() == 1);
  CHECK(s.in[0].quality.reliability == Reliability::BestEffort);
  CHECK(s.in[0].quality.deadline.count() == 1'500'000);
  CHECK(s.in[0].limits.max_rate == 100);
  CHECK(s.in[0].limits.max_bytes == 1 << 19);
  CHECK(s.in[0].type == "geometry_msgs/msg/Twist");
  CHECK(read("").out.empty());
}

TEST_CASE("what a file of settings does not mean is an error with its line") {
  CHECK(wrong("out: [/a]\nouch: 1").starts_with("2: there is no setting ouch"));
  CHECK(wrong("out: /a").starts_with("1: here belongs a list of topics"));
  CHECK(wrong("out:\n- {depth: 1}").starts_with("2: the topics are missing"));
  CHECK(wrong("in:\n- topics: /a\n  depth: 0").starts_with("3: here belongs a number from 1"));
  CHECK(wrong("domain: 1\nnode: a\ndomain: 2").starts_with("3: domain is there twice"));
  CHECK(wrong("out: [{topics: /a, depth: 1, depth: 2}]").starts_with("1: depth is there twice"));
  CHECK(wrong("node: my node").starts_with("1: ROS 2 allows no such name of a node"));
  CHECK(wrong("node: a/b").starts_with("1: ROS 2 allows no such name of a node"));
  CHECK(wrong("max_size_mib: 0").starts_with("1: here belongs a number from 1"));
  CHECK(wrong("out:\n- {topics: /a*, dds_topic: rt/a}")
            .starts_with("2: dds_topic is the name of one"));
  CHECK(wrong("in:\n- topics: /a\n  depth: 1.5").starts_with("3: here belongs a whole number"));
  CHECK(wrong("domain: 0.5").starts_with("1: here belongs a whole number"));
  for (const std::string key : {"max_rate: 1", "max_memory_mib: 1", "type: std_msgs/msg/String"}) {
    CHECK(read("in: [{topics: /a, " + key + "}]").in.size() == 1);
    CHECK(wrong("out: [{topics: /a, " + key + "}]").find("of topics that come in") !=
          std::string::npos);
  }
  CHECK(wrong("in:\n- {topics: /a, depth: .nan}").starts_with("2: here belongs a number"));
  CHECK(wrong("in: [{topics: /a, reliability: some}]").starts_with("1: some is neither"));
  CHECK(wrong("in: [{topics: /a, durability: some}]").starts_with("1: some is neither"));
  CHECK(wrong("in:\n- {topics: /a, type: a/msg/A}").starts_with("2: the gateway knows no fields"));
  CHECK(wrong("domain: 233").starts_with("1: here belongs a number from 0 to 232"));
  CHECK(wrong("[1, 2]").starts_with("1: here belong settings"));
  CHECK(wrong("a: [").starts_with("1: "));
  Settings settings;
  CHECK(error_of([&] { read_settings("/nowhere/at/all", settings); }).first == ENOENT);
}

TEST_CASE("a writer's user data says the segment and the type, and nothing to strangers") {
  const AnyType type = AnyType::of<Pose>();
  const std::string data = user_data_of({"boot;1=%", type, 77, 1234});
  const auto peer = peer_of(data);
  REQUIRE(peer);
  CHECK(peer->segment == "boot;1=%");
  CHECK(peer->type.is_same(type));
  CHECK(peer->ledger == 77);
  CHECK(peer->written == 1234);
  CHECK(peer_of("lot.segment=here;lot.ledger=7x;")->ledger == 0);
  CHECK(!peer_of(""));
  CHECK(!peer_of("typehash=RIHS01_00;"));
  CHECK(!peer_of("lot.segment"));
  CHECK(peer_of("lot.segment=;=;;x")->segment.empty());
  CHECK(!peer_of("lot.segment=here;")->type);
  for (std::size_t cut = 1; cut < data.size(); cut += 7) {
    CAPTURE(cut);
    const int number = error_of([&] { (void)peer_of(data.substr(0, cut)); }).first;
    CHECK((number == 0 || number == EBADMSG));
  }
}

std::size_t ledger_size(const Directory& directory) {
  const std::string file = directory.file("another.state");
  Ledger(file, "here");
  return std::filesystem::file_size(file);
}

TEST_CASE("a ledger that is opened again says what was written last") {
  const Directory directory;
  const std::string file = directory.file("gateway.state");
  Progress progress;
  std::uint64_t id = 0;
  {
    Ledger ledger(file, "here");
    id = ledger.id();
    CHECK(id != 0);
    for (std::uint64_t next = 1; next < 4; ++next) {
      progress.written = next;
      progress.counts.front() = 10 * next;
      progress.set_next(5, next);
      ledger.entry(Ledger::Way::Out, "/pose")->write(progress);
    }
    CHECK(ledger.entry(Ledger::Way::In, "/pose")->told().written == 0);
    CHECK(error_of([&] { Ledger(file, "here"); }).first == EBUSY);
  }
  {
    Ledger ledger(file, "here");
    CHECK(ledger.id() == id);
    const Progress told = ledger.entry(Ledger::Way::Out, "/pose")->told();
    CHECK(told.written == 3);
    CHECK(told.counts.front() == 30);
    CHECK(told.next_of(5) == 3);
    CHECK(told.next_of(6) == 0);
    int topics = 0;
    ledger.for_each([&](Ledger::Way, std::string_view topic, const Progress&) {
      CHECK(topic == "/pose");
      ++topics;
    });
    CHECK(topics == 2);
  }
  Ledger elsewhere(file, "there");  // another segment
  CHECK(elsewhere.id() != id);
  CHECK(elsewhere.entry(Ledger::Way::Out, "/pose")->told().written == 0);
}

TEST_CASE("a file of something else is no ledger, and stays as it is") {
  const Directory directory;
  const std::string file = directory.file("gateway.state");
  for (const std::size_t size : {std::size_t{5}, ledger_size(directory)}) {
    const std::string text(size, 'x');
    std::ofstream(file) << text;
    CHECK(error_of([&] { Ledger(file, "here"); }).first == EEXIST);
    std::ifstream in(file);
    CHECK(std::string{std::istreambuf_iterator<char>(in), {}} == text);
  }
}

TEST_CASE("a ledger takes 512 topics, and no name of 256 bytes") {
  const Directory directory;
  Ledger ledger(directory.file("gateway.state"), "here");
  CHECK(ledger.entry(Ledger::Way::Out, std::string(256, 'x')) == nullptr);
  for (int i = 0; i < 512; ++i) {
    CHECK(ledger.entry(Ledger::Way::Out, std::to_string(i)) != nullptr);
  }
  CHECK(ledger.entry(Ledger::Way::Out, "one more") == nullptr);
  CHECK(ledger.entry(Ledger::Way::Out, "7") == ledger.entry(Ledger::Way::Out, "7"));
}

TEST_CASE("progress forgets the line that was not used for longest") {
  Progress progress;
  for (std::uint64_t id = 1; id <= Progress::kMostLines; ++id) progress.set_next(id, 100 + id);
  progress.set_next(1, 200);
  progress.set_next(99, 300);
  CHECK(progress.next_of(1) == 200);
  CHECK(progress.next_of(2) == 0);
  CHECK(progress.next_of(3) == 103);
  CHECK(progress.next_of(99) == 300);
}

TEST_CASE("a rate lets a second's worth pass at once, and then so many a second") {
  RateLimit::Clock::time_point now{};
  RateLimit limit(10);
  const auto passed = [&](int asked) {
    int count = 0;
    for (int i = 0; i < asked; ++i) count += limit.allows(now);
    return count;
  };
  CHECK(passed(100) == 10);
  now += 500ms;
  CHECK(passed(100) == 5);
  now += 1h;
  CHECK(passed(100) == 10);
  RateLimit none(0);
  for (int i = 0; i < 1000; ++i) CHECK(none.allows(now));
  RateLimit slow(0.5);
  CHECK(slow.allows(now));
  CHECK(!slow.allows(now + 1s));
  CHECK(slow.allows(now + 2s));
}

TEST_SUITE_END();

}  // namespace
}  // namespace lot::testing
