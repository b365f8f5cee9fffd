// SPDX-License-Identifier: Apache-2.0

// The rows of `lot top`, from observations that the test makes up.

#include "tool/activity.hpp"

#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include "lockfree_ring/ring.hpp"
#include "tool/rows.hpp"

namespace {

using namespace lot::tool;

std::string number(std::optional<double> value) {
  return value ? std::to_string(std::lround(*value * 10)) : "-";
}

/// "/a 1>2 RATE bytes=BYTES/10 MEMORY lag=LAG/LOST delay=SECONDS/10 state"; `!`: it is wrong.
std::string text_of(const std::vector<Activity>& rows) {
  std::string all;
  for (const Activity& a : rows) {
    const std::string rate = lot::tool::text_of(a.rate);
    all += "\n" + a.name + (a.pid != 0 ? " pid=" + std::to_string(a.pid) : "") + " " +
           std::to_string(a.publishers) + ">" + std::to_string(a.subscribers) + " " +
           (rate.empty() ? "-" : rate) + " bytes=" + number(a.bytes_per_second) + " " +
           std::to_string(a.memory) + " lag=" + std::to_string(a.lag) + "/" +
           std::to_string(a.lost) + " delay=" + number(a.delay) + (a.has_stamps ? " stamps" : "") +
           (a.is_wrong ? " !" : " ") + a.state;
  }
  return all;
}

Channel queue(std::uint32_t channel, std::uint32_t publisher, std::uint32_t topic,
              std::vector<Reader> readers) {
  Channel c;
  c.channel = channel;
  c.generation = 7;
  c.publisher = publisher;
  c.topic = topic;
  c.readers = std::move(readers);
  return c;
}

Reader reader(std::uint32_t process, std::uint64_t lag, std::uint64_t lost = 0,
              bool holds_back = false, std::optional<double> delay = std::nullopt) {
  Reader r{process};
  r.lag = lag;
  r.lost = lost;
  r.holds_back = holds_back;
  r.delay = delay;
  return r;
}

/// A camera publishes on /a, which a viewer reads; nobody uses /b but a viewer that has read it.
Observation scene() {
  Observation seen;
  seen.processes = {
      {1, "camera", 11, 0, true, 100}, {2, "viewer", 12, 0, true, 0}, {4, "", 14, 0, true, 0}};
  seen.topics = {{0, "/a", "A", 8, {2}, true, {}},
                 {1, "/b", "B", 8, {}, true, {}},
                 {2, "/watched", "C", 8, {}, false, {4}}};
  seen.channels = {queue(5, 1, 0, {reader(2, 3)})};
  return seen;
}

struct Case {
  std::function<void(Observation&)> change;
  const char* topics;
  const char* processes;
};

const Rates kRates = {{{5, 7}, {10, {}, 0, 0}}, {{6, 7}, {5, {}, 0, 0}}};

}  // namespace

TEST_SUITE_BEGIN("activity");

TEST_CASE("topics and processes have rows that say what they do and what is wrong") {
  const char* const kIdle = "\n4 pid=14 0>0 - bytes=- 0 lag=0/0 delay=- ";
  const std::string no_b = "\n/b 0>0 - bytes=- 0 lag=0/0 delay=- publisher gone";
  const std::vector<Case> cases = {
      {[](Observation&) {}, "\n/a 1>1 10.0/s bytes=- 0 lag=3/0 delay=- ",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- "
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=3/0 delay=- "},
      {[](Observation& o) {
         o.channels[0].readers = {reader(2, 3, 2, false, 0.5), reader(4, 9, 1)};
       },
       "\n/a 1>2 10.0/s bytes=- 0 lag=9/2 delay=5 !2 viewer loses messages",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- "
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=3/2 delay=5 !loses /a"
       "\n4 pid=14 0>1 - bytes=- 0 lag=9/1 delay=- !loses /a"},
      {[](Observation& o) {
         o.channels[0].readers = {reader(2, 9), reader(4, 3, 0, true)};
         o.channels[0].waits = true;
       },
       "\n/a 1>2 10.0/s bytes=- 0 lag=9/0 delay=- !1 camera waits for 4",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- !waits for room in /a"
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=9/0 delay=- "
       "\n4 pid=14 0>1 - bytes=- 0 lag=3/0 delay=- !holds /a back"},
      {[](Observation& o) {
         o.channels[0].readers = {};
         o.channels[0].waits = true;
         o.channels[0].stamps = true;
         o.channels[0].topic = 9;
         o.topics[1].subscribers = {4, 2};
       },
       "\n/a 0>1 - bytes=- 0 lag=0/0 delay=- no publisher"
       "\n/b 0>2 - bytes=- 0 lag=0/0 delay=- no publisher",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- stamps !waits for room in ?"
       "\n2 viewer pid=12 0>2 - bytes=- 0 lag=0/0 delay=- "
       "\n4 pid=14 0>1 - bytes=- 0 lag=0/0 delay=- "},
      {[](Observation& o) {
         o.channels[0].waits = o.channels[0].stamps = true;
         o.channels.push_back(o.channels[0]);
         o.channels[1].channel = 6;
       },
       "\n/a 1>1 15.0/s bytes=- 0 lag=6/0 delay=- stamps !1 camera waits for room",
       "\n1 camera pid=11 1>0 15.0/s bytes=- 100 lag=0/0 delay=- stamps !waits for room in /a"
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=6/0 delay=- "},
      {[](Observation& o) {
         o.channels[0].readers = {};
         o.channels[0].waits = true;
       },
       "\n/a 1>1 10.0/s bytes=- 0 lag=0/0 delay=- !1 camera waits for room",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- !waits for room in /a"
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=0/0 delay=- "},
      {[](Observation& o) {  // an orphaned queue counts for its readers alone
         o.channels[0].orphan = o.channels[0].stamps = o.channels[0].waits = true;
         o.topics[0].subscribers = {};
       },
       "\n/a 0>1 - bytes=- 0 lag=3/0 delay=- no publisher",
       "\n1 camera pid=11 0>0 - bytes=- 100 lag=0/0 delay=- "
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=3/0 delay=- "},
      {[](Observation& o) {
         o.processes[0].alive = false;
         o.messages = {{0, 0, 1, "/a", 4096, {}}, {1, 0, 1, "/b", 64, {}}, {2, 0, 1, "/a", 64, {}}};
         o.topics.pop_back();
       },
       "\n/a 1>1 10.0/s bytes=- 4160 lag=3/0 delay=- "
       "\n/b 0>0 - bytes=- 64 lag=0/0 delay=- publisher gone",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- !dead"
       "\n2 viewer pid=12 0>1 - bytes=- 0 lag=3/0 delay=- "},
      {[](Observation& o) {  // the topic of the queue that is behind most is named
         o.channels = {queue(5, 1, 0, {reader(2, 3, 1)}), queue(6, 4, 1, {reader(2, 3, 2)}),
                       queue(7, 4, 1, {reader(2, 1)})};
       },
       "\n/a 1>1 10.0/s bytes=- 0 lag=3/1 delay=- !2 viewer loses messages"
       "\n/b 1>1 - bytes=- 0 lag=4/2 delay=- !2 viewer loses messages",
       "\n1 camera pid=11 1>0 10.0/s bytes=- 100 lag=0/0 delay=- "
       "\n2 viewer pid=12 0>2 - bytes=- 0 lag=4/2 delay=- !loses /b"
       "\n4 pid=14 1>0 - bytes=- 0 lag=0/0 delay=- "}};
  for (std::size_t n = 0; n < cases.size(); ++n) {
    CAPTURE(n);
    Observation seen = scene();
    cases[n].change(seen);
    std::string topics = cases[n].topics;
    if (topics.find("/b") == topics.npos) topics += no_b;
    std::string processes = cases[n].processes;
    if (processes.find("\n4") == processes.npos) processes += kIdle;
    CHECK(text_of(topics_of(seen, kRates, Sizes())) == topics);
    CHECK(text_of(processes_of(seen, kRates, Sizes())) == processes);
  }
}

TEST_CASE("of several places of one process in a queue the worst counts, and of queues the sum") {
  struct Place {
    std::vector<Reader> readers;
    const char* says;
  };
  const Place kPlaces[] = {
      {{reader(2, 3), reader(2, 5)}, "lag=5/0 delay=- "},
      {{reader(2, 5), reader(2, 3)}, "lag=5/0 delay=- "},
      {{reader(2, 5), reader(2, 3, 1)}, "lag=3/1 delay=- !loses /a"},
      {{reader(2, 5, 2), reader(2, 3, 0, true)}, "lag=3/0 delay=- !holds /a back"},
      {{reader(2, 3, 0, false, 2.0), reader(2, 5, 0, false, 1.0)}, "lag=5/0 delay=20 "},
      {{reader(2, 5, 0, false, 1.0), reader(2, 3, 0, false, 2.0)}, "lag=5/0 delay=20 "},
      {{reader(2, 5), reader(2, 3, 0, false, 0.5)}, "lag=5/0 delay=5 "}};
  for (const auto& [readers, says] : kPlaces) {
    Observation seen = scene();
    seen.channels[0].readers = readers;
    CHECK(text_of({processes_of(seen, {}, Sizes())[1]}) ==
          std::string("\n2 viewer pid=12 0>1 - bytes=- 0 ") + says);
  }
  Observation seen = scene();
  seen.channels = {queue(5, 1, 0, {reader(2, 3, 1, false, 0.5)}),
                   queue(6, 4, 0, {reader(2, 4, 2, true, 0.3), reader(4, 1)})};
  CHECK(text_of(topics_of(seen, {}, Sizes())) ==
        "\n/a 2>2 - bytes=- 0 lag=7/3 delay=5 !2 viewer loses messages"
        "\n/b 0>0 - bytes=- 0 lag=0/0 delay=- publisher gone");
}

TEST_CASE("of readers that are as bad, and of topics, the one of the lower index is named") {
  const auto state = [](std::vector<Reader> readers) {
    Observation seen = scene();
    seen.channels[0].readers = std::move(readers);
    return topics_of(seen, {}, Sizes())[0].state;
  };
  CHECK(state({reader(4, 5, 1), reader(2, 5, 1)}) == "2 viewer loses messages");
  CHECK(state({reader(2, 5, 1), reader(4, 6, 1)}) == "4 loses messages");
  CHECK(state({reader(2, 6, 1), reader(4, 5, 2)}) == "4 loses messages");
  Observation seen = scene();
  seen.channels = {queue(6, 1, 1, {reader(2, 5, 1)}), queue(5, 1, 0, {reader(2, 5, 1)})};
  CHECK(processes_of(seen, {}, Sizes())[1].state == "loses /a");
}

TEST_CASE("the size of a queue's messages is that of those seen last, and the bandwidth follows") {
  Sizes sizes;
  Observation seen = scene();
  Channel& c = seen.channels[0];
  const auto mean = [&](std::uint64_t next, std::vector<Queued> queue) {
    c.next = next;
    c.queue = std::move(queue);
    sizes.note(seen);
    return number(sizes.mean(c));
  };
  const std::uint32_t in_slot = lot::ring::kInSlot;
  CHECK(mean(10, {}) == "-");
  CHECK(text_of({topics_of(seen, kRates, sizes)[0]}) ==
        "\n/a 1>1 10.0/s bytes=- 0 lag=3/0 delay=- ");
  seen.messages = {{0, 0, 1, "/a", 8192, {}},
                   {1, 0, 1, "/a", 4096, {}},
                   {2, 0, 4, "/a", 64, {}},
                   {3, 0, 1, "/b", 64, {}}};
  CHECK(mean(10, {}) == "61440");  // readers were faster: of all that the publisher has made for it
  CHECK(mean(12, {{10, 0}, {11, 1}, {12, 77}}) == "61440");
  CHECK(mean(12, {{10, 0}, {11, 1}}) == "61440");  // these are known
  CHECK(mean(13, {{11, 1}, {12, 0}}) == "67499");  // (0.7 * 1.7 * 12288 + 8192) / (0.7 * 3.4 + 1)
  seen.topics[0].type_size = 100;
  CHECK(mean(14, {{13, in_slot}}) == "47743");
  CHECK(text_of({topics_of(seen, kRates, sizes)[0]}) ==
        "\n/a 1>1 10.0/s bytes=477430 12352 lag=3/0 delay=- ");
  c.generation = 8;  // another publisher's
  CHECK(mean(3, {{1, in_slot}, {2, in_slot}}) == "1000");
  c.generation = 9;  // its sequences are about to begin anew
  CHECK(mean(1, {{lot::ring::kSequenceMask, in_slot}, {0, 1}}) == "20980");
  c.channel = 6;
  CHECK(mean(2, {{1, 1}}) == "40960");
  c.generation = 7;
  CHECK(sizes.mean(c) == std::nullopt);
  c.orphan = true;
  CHECK(mean(2, {{1, 1}}) == "-");
  c.orphan = false;
  c.topic = 9;
  CHECK(mean(1, {}) == "-");
  CHECK(mean(2, {{1, in_slot}}) == "0");
  // Two queues, of which one has no rate, and one no size.
  Observation two = scene();
  two.channels = {queue(5, 1, 0, {}), queue(6, 1, 0, {}), queue(7, 1, 0, {}), queue(5, 1, 0, {})};
  two.topics[0].type_size = 100;
  for (auto& channel : two.channels) channel.queue = {{1, in_slot}};
  two.channels[1].queue = {};
  two.channels[3].channel = 8;
  Sizes of_two;
  of_two.note(two);
  const Rates rates = {{{5, 7}, {10, {}, 0, 0}}, {{6, 7}, {5, {}, 0, 0}}, {{8, 7}, {3, {}, 0, 0}}};
  CHECK(number(processes_of(two, rates, of_two)[0].bytes_per_second) == "13000");
}

TEST_SUITE_END();
