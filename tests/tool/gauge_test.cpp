// SPDX-License-Identifier: Apache-2.0

// `lot hz`, `lot bw` and `lot delay` beside publishers, and the DELAY of `lot top`.

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include <lot/lot.hpp>

#include "command.hpp"
#include "lockfree_ring/ring.hpp"
#include "support/error_of.hpp"
#include "support/janitor.hpp"

namespace {

using namespace lot::testing;

[[maybe_unused]] const bool has_janitor = start_janitor();

struct Stamp {
  std::uint32_t sec, nsec;
};
struct Header {
  Stamp stamp;
};
struct Note {
  std::uint64_t number;
  Header header;
};
struct Frame {
  std::uint64_t number;
  lot::ShmVector<std::uint8_t> data;
};

lot::PusherOptions pushing(bool stamps, std::uint32_t depth = 64) {
  lot::PusherOptions options;
  options.stamp = stamps;
  options.depth = depth;
  return options;
}

/// A gauge that writes documents, as long as it runs.
class Gauge : public Running {
 public:
  Gauge(const lot::EngineOptions& options, std::vector<std::string> words)
      : Running(with_json(on(options, std::move(words)))) {}

  /// The next document of which that is true.
  template <class Wanted>
  Json document(Wanted&& wanted) {
    for (;;) {
      const std::string text = line();
      must(!text.empty(), "another document comes");
      Json document = Json::parse(text);
      if (wanted(document)) return document;
    }
  }
  /// The last one.
  Json last() {
    return document([](const Json& d) { return d.at("in_all").get<bool>(); });
  }
  Json interrupted() {
    child().send(SIGINT);
    return last();
  }

 private:
  static std::vector<std::string> with_json(std::vector<std::string> words) {
    words.push_back("--json");
    return words;
  }
};

/// How many observers read the queues of a segment.
std::size_t observers_of(const lot::EngineOptions& options) {
  lot::segment::Segment s(options.directory + "/" + options.segment);
  std::size_t n = 0;
  for (std::uint32_t c = 0; c < s.capacity().channels; ++c) {
    if (lot::ring::writer_state(s.channels()[c].writer.load()) != lot::ring::State::Live) continue;
    const lot::segment::Ring ring = s.ring(c);
    for (std::uint32_t i = 0; i < ring.readers; ++i) {
      const lot::ring::Word position = ring.cells[i].position.load();
      n += ring.who[i].load() != 0 && position != lot::ring::kObserverJoins &&
           lot::ring::is_observer(position);
    }
  }
  return n;
}

bool is_silent(const Json& document) { return document.at("silent").get<bool>(); }
bool has_rate(const Json& document) { return document.at("per_second").is_number(); }

/// A process that pushes notes at a rate, until it is killed.
class Publisher {
 public:
  Publisher(const lot::EngineOptions& options, const std::string& name, const char* topic,
            std::chrono::nanoseconds period, bool stamps)
      : child_([=, this] {
          lot::EngineOptions mine = options;
          mine.name = name;
          lot::ShmEngine engine(mine);
          auto pusher = engine.advertise<Note>(topic, pushing(stamps));
          ready_.tell();
          auto next = std::chrono::steady_clock::now();
          for (std::uint64_t n = 0;; ++n) {
            auto note = pusher.loan();
            note->number = n;
            (void)pusher.push(std::move(note));
            next += period;
            std::this_thread::sleep_until(next);
          }
        }) {
    must(ready_.next() == '.', "the publisher is there");
  }
  Child& child() { return child_; }

 private:
  Steps ready_;
  Child child_;
};

bool is_watched(const lot::EngineOptions& options, std::size_t by = 1) {
  return eventually([&] { return observers_of(options) == by; }, 30s);
}

void push(lot::ShmPusher<Note>& pusher, const Note& note) {
  auto loan = pusher.loan();
  *loan = note;
  REQUIRE(pusher.push(std::move(loan)) == lot::Status::Ok);
}

/// The members of a document that say how many there were.
std::uint64_t published(const Json& document) {
  return document.at("messages").get<std::uint64_t>() + document.at("missed").get<std::uint64_t>();
}

}  // namespace

TEST_SUITE_BEGIN("gauge");

TEST_CASE("lot hz tells the rate of a publisher, by its pushes or by their arrivals") {
  const Watchdog watchdog(120);
  for (const auto& [period, count] : {std::pair{250000us, 8}, {10000us, 150}, {500us, 2000}}) {
    for (const bool stamps : {false, true}) {
      CAPTURE(period.count());
      CAPTURE(stamps);
      const Room room;
      const Publisher publisher(room.options(), "camera", "/notes", period, stamps);
      Gauge hz(room.options(),
               {"hz", "/notes", "--count", std::to_string(count), "--interval", "100"});
      const Json all = hz.last();
      CHECK(hz.finish().exit == 0);
      CHECK(all.at("messages") == count);
      CHECK(all.at("times") == (stamps ? "pushes" : "arrivals"));
      CHECK(all.at("topic") == "/notes");
      // The rate is what was published in the time that it says; of what was missed before the
      // first message it says nothing.
      const double rate = all.at("per_second").get<double>();
      const double steps = rate * all.at("seconds").get<double>();
      CHECK(steps > static_cast<double>(count) - 1.001);
      CHECK(steps < static_cast<double>(published(all)) - 0.999);
      CHECK(rate < 3e6 / static_cast<double>(period.count()));
      const Json& intervals = all.at("interval_seconds");
      CHECK(intervals.at("min") <= intervals.at("mean"));
      CHECK(intervals.at("mean") <= intervals.at("max"));
      CHECK(all.at("publishers").size() == 1);
      CHECK(all.at("publishers").at(0).at("publisher") == "camera");
    }
  }
}

TEST_CASE("lot hz has seen or missed each message of a publisher at full speed") {
  const Watchdog watchdog(300);
  constexpr std::uint64_t kMessages = 300000;
  for (const std::uint32_t depth : {4U, 16384U}) {
    CAPTURE(depth);
    const Room room;
    lot::EngineOptions options = room.options();
    options.blocks = 2 * depth + 512;
    options.size_bytes = 64 << 20;
    Steps ready, go, done, end;
    Child publisher([&] {
      lot::ShmEngine engine(options);
      auto pusher = engine.advertise<Note>("/notes", pushing(true, depth));
      ready.tell();
      must(go.next() == '.', "it may go");
      auto next = std::chrono::steady_clock::now();
      for (std::uint64_t n = 0; n < kMessages; ++n) {  // 1 MHz
        while (std::chrono::steady_clock::now() < next) {
        }
        next += 1us;
        auto note = pusher.loan();
        note->number = n;
        (void)pusher.push(std::move(note));
      }
      done.tell();
      (void)end.next(120s);
    });
    REQUIRE(ready.next() == '.');
    Gauge hz(options, {"hz", "/notes", "--interval", "100"});
    REQUIRE(is_watched(options));
    go.tell();
    REQUIRE(done.next(120s) == '.');
    (void)hz.document(is_silent);
    const Json all = hz.interrupted();
    CHECK(hz.finish().exit == 0);
    CHECK(published(all) == kMessages);
    CHECK(all.at("publishers").at(0).at("messages") == all.at("messages"));
    // What was missed before the first one that was seen could be of any publisher.
    CHECK(all.at("publishers").at(0).at("missed") <= all.at("missed"));
    MESSAGE("depth " << depth << ": missed " << all.at("missed").dump() << " of " << kMessages
                     << " at " << all.at("per_second").dump() << "/s");
    end.tell();
    CHECK(publisher.wait() == 0);
  }
}

TEST_CASE("lot hz --all tells of each publisher, and of one that takes the place of a killed one") {
  const Watchdog watchdog(120);
  const Room room;
  Publisher fast(room.options(), "fast", "/notes", 1ms, true);
  Publisher slow(room.options(), "slow", "/notes", 20ms, false);
  Gauge hz(room.options(), {"hz", "/notes", "--all", "--interval", "50"});
  const auto names_of = [](const Json& document) {
    std::vector<std::string> names;
    for (const auto& p : document.at("publishers")) names.push_back(p.at("publisher"));
    std::sort(names.begin(), names.end());
    return names;
  };
  const auto has = [&](std::vector<std::string> names) {
    return hz.document([&](const Json& d) { return names_of(d) == names && has_rate(d); });
  };
  const Json both = has({"fast", "slow"});
  CHECK(both.at("times") == "both");
  for (const auto& p : both.at("publishers")) {
    CHECK(p.at("times") == (p.at("publisher") == "fast" ? "pushes" : "arrivals"));
  }
  fast.child().kill9();
  (void)has({"slow"});
  const Publisher again(room.options(), "fast", "/notes", 1ms, true);
  const Json later = has({"fast", "slow"});
  for (const auto& p : later.at("publishers")) {
    for (const auto& before : both.at("publishers")) {
      CHECK((p.at("publisher_id") == before.at("publisher_id")) ==
            (p.at("publisher") == "slow" && before.at("publisher") == "slow"));
    }
  }
  CHECK(hz.interrupted().at("missed") == 0);
  CHECK(hz.finish().exit == 0);
  Running together(on(room.options(), {"hz", "/notes", "--interval", "50"}));
  CHECK_FALSE(names(together.line(), "PUBLISHER"));
  Running text(on(room.options(), {"hz", "/notes", "--all", "--interval", "50"}));
  CHECK(names(text.line(), "PUBLISHER"));
  bool has_fast = false;
  bool has_slow = false;
  bool has_all = false;
  while (!has_fast || !has_slow || !has_all) {
    const std::string line = text.line();
    REQUIRE(!line.empty());
    has_fast |= line.ends_with("  fast");
    has_slow |= line.ends_with("  slow");
    has_all |= line.ends_with("  all");
  }
}

TEST_CASE("a topic that falls silent has no rate, and has one again when messages come") {
  const Watchdog watchdog(120);
  const Room room;
  Publisher publisher(room.options(), "camera", "/notes", 5ms, true);
  Gauge hz(room.options(), {"hz", "/notes", "--interval", "50"});
  (void)hz.document(has_rate);
  stop(publisher.child());
  Json document = hz.document(is_silent);
  CHECK(document.at("per_second").is_null());
  CHECK(document.at("interval_seconds").is_null());
  CHECK(document.at("messages") == 0);
  CHECK(document.at("silent_seconds") >= 1);
  publisher.child().send(SIGCONT);
  (void)hz.document(has_rate);
  publisher.child().kill9();
  (void)hz.document(is_silent);
  Running text(on(room.options(), {"hz", "/notes", "--interval", "50"}));
  CHECK(text.line().starts_with("no message for "));
  CHECK(text.says(": waiting"));
  const Publisher again(room.options(), "camera", "/notes", 5ms, true);
  (void)hz.document(has_rate);
}

TEST_CASE("of a slow topic lot hz tells the rate, and how long ago its last message came") {
  const Watchdog watchdog(120);
  const Room room;
  const Publisher publisher(room.options(), "camera", "/notes", 3s, false);
  Running hz(on(room.options(), {"hz", "/notes", "--interval", "100"}));
  std::string line;
  for (int n = 0; n < 400 && line.find("/s") == line.npos; ++n) line = hz.line();
  for (int n = 0; n < 200 && line.find(", the last ") == line.npos; ++n) line = hz.line();
  CHECK_MESSAGE(line.find(", the last ") != line.npos, line);
  CHECK(line.ends_with(" ago"));
}

TEST_CASE("the gauges wait for a topic, and end with 1 when nothing came") {
  const Watchdog watchdog(120);
  for (const char* verb : {"hz", "bw", "delay"}) {
    CAPTURE(std::string(verb));
    const Room room;
    const Ran ran = run_lot(on(room.options(), {verb, "/notes", "--duration", "0.3", "--json"}));
    CHECK(ran.exit == 1);
    CHECK(ran.json().at("in_all") == true);
    CHECK(ran.json().at("messages") == 0);
    CHECK(ran.json().at("type").is_null());
    CHECK(names(ran.err, "no process uses this topic yet"));
    CHECK(names(run_lot(on(room.options(), {verb, "/notes", "--duration", "0.3"})).out,
                "no message for "));
    Gauge follower(room.options(), {verb, "/notes", "--interval", "20"});
    (void)follower.line();
    Publisher publisher(room.options(), "camera", "/notes", 5ms, true);
    const Json document =
        follower.document([](const Json& d) { return d.at("messages").get<int>() >= 5; });
    CHECK(names(document.at("type").get<std::string>(), "Note"));
    publisher.child().kill9();
    (void)follower.document(is_silent);
    (void)follower.interrupted();
    CHECK(follower.finish().exit == 0);
    CHECK(room.files() == 0);  // it was the last one, and leaves no file
  }
}

TEST_CASE("the gauges go on when the topic gets another type") {
  const Watchdog watchdog(120);
  const Room room;
  for (const char* verb : {"hz", "bw", "delay"}) {
    CAPTURE(std::string(verb));
    Gauge follower(room.options(), {verb, "/things", "--interval", "20"});
    {
      const Publisher publisher(room.options(), "one", "/things", 5ms, true);
      (void)follower.document([](const Json& d) { return d.at("messages").get<int>() >= 5; });
    }
    lot::ShmEngine engine(room.options());
    std::optional<lot::ShmPusher<Frame>> pusher;
    REQUIRE(eventually([&] {  // the dead one still has the topic, until it is reaped
      return error_of([&] {
               pusher.emplace(engine.advertise<Frame>("/things", pushing(true)));
             }).first == 0;
    }));
    const Json document = follower.document([&](const Json& d) {
      auto frame = pusher->loan();
      frame->data.resize(1000);
      (void)pusher->push(std::move(frame));
      return d.at("messages").get<int>() >= 5 && names(d.at("type").get<std::string>(), "Frame");
    });
    if (std::string(verb) == "bw") {  // nothing is left of the other type's sizes
      CHECK(document.at("message_bytes").at("min") == sizeof(Frame) + 1000);
      CHECK(document.at("message_bytes").at("max") == sizeof(Frame) + 1000);
    }
    CHECK(names(follower.err(), "the topic carries"));
    const Json all = follower.interrupted();
    CHECK(all.at("messages") > document.at("messages"));
    CHECK(follower.finish().exit == 0);
  }
}

TEST_CASE("lot bw tells how large messages are, to the byte") {
  const Watchdog watchdog(120);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Frame>("/frames", pushing(false));
  Gauge bw(room.options(), {"bw", "/frames", "--count", "6", "--interval", "20"});
  REQUIRE(is_watched(room.options()));
  for (const std::size_t bytes : {0U, 100U, 5000U, 70000U, 5U, 12345U}) {
    auto frame = pusher.loan();
    frame->data.resize(bytes);
    (void)pusher.push(std::move(frame));
  }
  const Json all = bw.last();
  CHECK(bw.finish().exit == 0);
  const Json& sizes = all.at("message_bytes");
  CHECK(all.at("sizes") == "exact");
  CHECK(sizes.at("min") == sizeof(Frame));
  CHECK(sizes.at("max") == sizeof(Frame) + 70000);
  const double mean = sizeof(Frame) + 87450 / 6.0;
  CHECK(sizes.at("mean").get<double>() == doctest::Approx(mean));
  CHECK(all.at("bytes_per_second").get<double>() ==
        doctest::Approx(all.at("per_second").get<double>() * mean));
}

TEST_CASE("lot bw says what is damaged in a message, goes on, and ends with 3") {
  const Watchdog watchdog(120);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Frame>("/frames", pushing(false));
  Gauge bw(room.options(), {"bw", "/frames", "--interval", "20"});
  REQUIRE(is_watched(room.options()));
  auto frame = pusher.loan();
  frame->data.resize(5000);
  std::array<unsigned char, sizeof(frame->data)> bytes;
  auto* const place = static_cast<void*>(&frame->data);
  std::memcpy(bytes.data(), place, bytes.size());
  std::memset(place, 0x5a, bytes.size());
  const lot::ShmSharedPtr<const Frame> kept(std::move(frame));
  (void)pusher.push(kept);
  (void)pusher.push(kept);
  CHECK(bw.says("data: it"));
  (void)pusher.push(pusher.loan());
  (void)bw.document([](const Json& d) { return d.at("messages") == 3; });
  const Json all = bw.interrupted();
  CHECK(bw.finish().exit == 3);
  CHECK(all.at("message_bytes").at("max") == sizeof(Frame));       // of the one that is whole
  CHECK(bw.err().find("data: it") == bw.err().rfind("data: it"));  // once
  std::memcpy(place, bytes.data(), bytes.size());                  // its destructor runs here
}

TEST_CASE("lot hz counts a message that its queue names wrongly as missed, and ends with 3") {
  const Watchdog watchdog(120);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Note>("/notes", pushing(false));
  Gauge hz(room.options(), {"hz", "/notes", "--interval", "20"});
  REQUIRE(is_watched(room.options()));
  push(pusher, {});
  (void)hz.document([](const Json& d) { return d.at("messages") == 1; });
  stop(hz.child());
  push(pusher, {});
  lot::segment::Segment s(room.options().directory + "/" + room.options().segment);
  const lot::segment::Ring ring = s.ring(0);
  REQUIRE(ring.depth == 64);
  for (std::uint32_t i = 0; i < ring.depth; ++i) {
    const auto slot = ring.slots[i].load();
    if (lot::ring::block(slot) == lot::ring::kNoBlock) continue;
    ring.slots[i].store(lot::ring::make(lot::ring::sequence(slot), 100000));
  }
  hz.child().send(SIGCONT);
  CHECK(hz.says("a message is damaged"));
  push(pusher, {});
  (void)hz.document([](const Json& d) { return d.at("messages") == 2; });
  CHECK(hz.interrupted().at("missed") == 1);
  CHECK(hz.finish().exit == 3);
}

TEST_CASE("lot delay tells how long ago a message was pushed, and says where that is not known") {
  const Watchdog watchdog(120);
  const Room room;
  Publisher publisher(room.options(), "camera", "/notes", 5ms, false);
  Gauge delay(room.options(), {"delay", "/notes", "--interval", "20"});
  Json document = delay.document([](const Json& d) { return d.at("messages").get<int>() >= 5; });
  CHECK(document.at("delay_seconds").is_null());
  CHECK(document.at("with_time") == 0);
  CHECK(names(delay.err(), "PusherOptions::stamp"));
  CHECK(names(delay.err(), "LOT_STAMP=1"));
  CHECK(names(delay.err(), "camera"));
  (void)delay.interrupted();
  CHECK(delay.finish().exit == 1);  // it has told nothing
  CHECK(names(run_lot(on(room.options(), {"delay", "/notes", "--count", "2"})).out,
              "2 messages, without a time"));
  publisher.child().kill9();
  const Publisher stamping(room.options(), "camera", "/notes", 5ms, true);
  Gauge stamped(room.options(), {"delay", "/notes", "--count", "50"});
  document = stamped.last();
  CHECK(stamped.finish().exit == 0);
  CHECK(stamped.err().empty());
  CHECK(document.at("with_time") == 50);
  CHECK(document.at("since") == "push");
  CHECK(document.at("clock") == "steady");
  const Json& delays = document.at("delay_seconds");
  CHECK(delays.at("min") > 0);
  for (const char* larger : {"p50", "mean", "p99", "max"})
    CHECK(delays.at(larger) >= delays.at("min"));
  CHECK(delays.at("p99") <= delays.at("max"));
  CHECK(delays.at("p50") <= delays.at("p99"));
}

TEST_CASE("lot delay measures the time between push and look: of a message that waits it is long") {
  const Watchdog watchdog(120);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Note>("/notes", pushing(true));
  Gauge delay(room.options(), {"delay", "/notes", "--interval", "20"});
  REQUIRE(is_watched(room.options()));
  stop(delay.child());
  push(pusher, Note{});
  std::this_thread::sleep_for(300ms);
  delay.child().send(SIGCONT);
  const Json document = delay.document([](const Json& d) { return d.at("messages") == 1; });
  CHECK(document.at("delay_seconds").at("min") >= 0.3);
  (void)delay.interrupted();
  CHECK(delay.finish().exit == 0);
}

TEST_CASE("lot delay --field measures since a time in the message") {
  const Watchdog watchdog(120);
  const Room room;
  lot::ShmEngine engine(room.options());
  auto pusher = engine.advertise<Note>("/notes", pushing(false));
  Gauge delay(room.options(), {"delay", "/notes", "--field", "header.stamp", "--count", "3"});
  Running table(on(room.options(), {"delay", "/notes", "--field", "header.stamp", "--count", "3",
                                    "--interval", "600000"}));
  REQUIRE(is_watched(room.options(), 2));
  const auto now = std::chrono::system_clock::now().time_since_epoch() / 1s;
  for (const std::int64_t ago : {std::int64_t{100}, std::int64_t{50}, now}) {  // one is zero
    push(pusher, Note{1, {{static_cast<std::uint32_t>(now - ago), 0}}});
  }
  const Json document = delay.last();
  CHECK(delay.finish().exit == 0);
  CHECK(document.at("messages") == 3);
  CHECK(document.at("with_time") == 2);
  CHECK(table.line().empty());
  CHECK(table.line() == "in all:");
  CHECK(names(table.line(), "MESSAGES       TIMED      MISSED"));
  CHECK(names(table.line(), "         3           2           0"));
  CHECK(document.at("since") == "header.stamp");
  CHECK(document.at("clock") == "system");
  CHECK(document.at("delay_seconds").at("min") >= 50);
  CHECK(document.at("delay_seconds").at("max") >= 100);
  CHECK(names(delay.err(), "is zero"));
  Gauge wrong(room.options(), {"delay", "/notes", "--field", "header.time"});
  REQUIRE(is_watched(room.options()));
  push(pusher, Note{});
  CHECK(wrong.finish().exit == 1);
  CHECK(names(wrong.err(), "stamp"));  // there is that one
}

TEST_CASE("each line comes through a pipe when it is made, and a closed pipe ends the gauge") {
  const Watchdog watchdog(120);
  const Room room;
  const Publisher publisher(room.options(), "camera", "/notes", 5ms, true);
  for (const char* verb : {"hz", "bw", "delay"}) {
    CAPTURE(std::string(verb));
    Running follower(on(room.options(), {verb, "/notes", "--interval", "30"}));
    std::string line = follower.line();
    while (line.starts_with("no message")) line = follower.line();  // none has come yet
    CHECK(names(line, "MESSAGES"));
    CHECK(!follower.line().empty());
    CHECK(!follower.line().empty());
    REQUIRE(is_watched(room.options()));
    follower.close_output();
    CHECK(follower.finish().exit == 0);
    CHECK(follower.err().empty());
    CHECK(is_watched(room.options(), 0));  // it has left the queue itself
  }
}

TEST_CASE("signals end the gauges with a line about all that came") {
  const Watchdog watchdog(120);
  const Room room;
  const Publisher publisher(room.options(), "camera", "/notes", 5ms, true);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    CAPTURE(signal);
    Running hz(on(room.options(), {"hz", "/notes", "--interval", "30"}));
    std::string line = hz.line();
    while (line.starts_with("no message")) line = hz.line();  // none has come yet
    for (int lines = 0; lines < 4; ++lines) CHECK(!hz.line().empty());
    hz.child().send(signal);
    do {
      line = hz.line();
    } while (line != "in all:");
    CHECK(names(hz.line(), "pushes"));
    CHECK(hz.line().empty());
    CHECK(hz.finish().exit == 0);
  }
}

TEST_CASE("the gauges refuse a queue, and a topic that two segments have") {
  const Watchdog watchdog(120);
  const Room room;
  lot::ShmEngine one(room.options("one"));
  lot::ShmEngine two(room.options("two"));
  auto jobs = one.queue<std::uint64_t>("jobs");
  CHECK(jobs.put(1) == lot::Status::Ok);
  const Publisher in_one(room.options("one"), "camera", "/notes", 5ms, true);
  const Publisher in_two(room.options("two"), "camera", "/notes", 5ms, true);
  for (const char* verb : {"hz", "bw", "delay"}) {
    CAPTURE(std::string(verb));
    Ran ran = run_lot({verb, "jobs", "--dir", room.path()});
    CHECK(ran.exit == 1);
    CHECK(names(ran.err, "queue"));
    ran = run_lot({verb, "/notes", "--dir", room.path()});
    CHECK(ran.exit == 1);
    CHECK(names(ran.err, "--segment"));
    ran = run_lot({verb, "/notes", "--dir", room.path(), "--segment", "two", "--count", "3"});
    CHECK(ran.exit == 0);
    CHECK(run_lot({verb, "--dir", room.path()}).exit == 2);
    for (const char* wrong : {"--window=0", "--window=nan", "--interval=0", "--count=0",
                              "--duration=-1", "--duration=nan", "--field"}) {
      CHECK(run_lot({verb, "/notes", "--dir", room.path(), wrong}).exit == 2);
    }
  }
  CHECK(jobs.size() == 1);
}

TEST_CASE("lot top tells how long the oldest message waits for its slowest subscriber") {
  const Watchdog watchdog(120);
  const Room room;
  lot::EngineOptions options = room.options();
  options.name = "camera";
  lot::ShmEngine engine(options);
  auto pusher = engine.advertise<Note>("/notes", pushing(true, 4));
  auto plain = engine.advertise<Note>("/plain", pushing(false, 4));
  auto puller = engine.subscribe<Note>("/notes");
  auto other = engine.subscribe<Note>("/plain");
  const auto delay_of = [&](const std::string& topic) {
    const Json top = run_lot(on(options, {"top", "--json", "--interval", "1"})).json();
    const Json& seen = top.at("segments").at(0);
    Json delay;
    for (const auto& row : seen.at("topics")) {
      if (row.at("name") == topic) delay = row.at("delay_seconds");
    }
    if (topic == "/notes")
      CHECK(seen.at("processes").at(0).at("delay_seconds").is_null() == delay.is_null());
    return delay;
  };
  CHECK(delay_of("/notes").is_null());
  push(pusher, Note{});
  push(plain, Note{});
  std::this_thread::sleep_for(400ms);
  push(pusher, Note{});
  const double oldest = delay_of("/notes").get<double>();
  CHECK(oldest >= 0.4);
  CHECK(delay_of("/plain").is_null());
  CHECK(names(run_lot(on(options, {"top", "--once", "--interval", "1"})).out, "DELAY"));
  REQUIRE(puller.try_pull());
  const double next = delay_of("/notes").get<double>();
  std::this_thread::sleep_for(400ms);
  CHECK(delay_of("/notes").get<double>() >= next + 0.4);
  for (int n = 0; n < 10; ++n) push(pusher, Note{});  // it is lost
  CHECK(delay_of("/notes").get<double>() > 0);
  while (puller.try_pull()) {
  }
  CHECK(delay_of("/notes").is_null());
}

TEST_SUITE_END();
