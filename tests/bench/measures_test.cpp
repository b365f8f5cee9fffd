// SPDX-License-Identifier: Apache-2.0
#include "measures.hpp"

#include <algorithm>

#include <doctest/doctest.h>

#include "made_up.hpp"

namespace {

using namespace ab;
using namespace ab::testing;
using doctest::Approx;

}  // namespace

TEST_SUITE("lot_ab measures") {
  TEST_CASE("latencies count from the stamp asked for, in microseconds, by block") {
    const StreamResult stream = stream_of({1, 2, 3, 4}, always(50'000));
    CHECK(latencies(stream, Stamp::Fill) == Blocks(3, std::vector<double>(8, 50)));
    CHECK(latencies(stream, Stamp::Loan) == Blocks(3, std::vector<double>(8, 53)));
    CHECK(latencies(stream.subscribers[1], Stamp::Push) == Blocks(3, std::vector<double>(4, 49)));
  }

  TEST_CASE("a message without a stamp has no latency from it") {
    StreamResult stream = stream_of({1, 1, 1, 3}, always(50'000));
    stream.subscribers[0].samples[1].filled_at = 0;
    CHECK(latencies(stream, Stamp::Fill) == Blocks{{50, 50}});
    CHECK(latencies(stream, Stamp::Loan) == Blocks{{53, 53, 53}});
  }

  TEST_CASE("arms are compared by whole blocks where these were timed") {
    StreamResult stream = stream_of({1, 1, 2, 3}, always(50'000));
    CHECK(compared(stream, Stamp::Fill) == latencies(stream, Stamp::Fill));
    CHECK(compared(stream, Stamp::Loan) == latencies(stream, Stamp::Loan));
    stream.blocks = {{1, 1000, 200'000}, {0, 1000, 500'000}, {2, 0, 1}};
    CHECK(compared(stream, Stamp::Loan) == Blocks{{0.5}, {0.2}});
    CHECK(messages_per_second(stream) == Approx(5e6));
  }

  TEST_CASE("tails are those of messages in ping-pong, of blocks in throughput") {
    StreamResult stream = stream_of({1, 1, 2, 3}, always(50'000));
    stream.blocks = {{0, 1000, 500'000}, {1, 1000, 200'000}};
    Conditions conditions;
    conditions.mode = "ping-pong";
    CHECK(compared_tails(conditions, stream, Stamp::Push) == latencies(stream, Stamp::Push));
    conditions.mode = "throughput";
    CHECK(compared_tails(conditions, stream, Stamp::Push) == Blocks{{0.5}, {0.2}});
  }

  TEST_CASE("the fairness gap is that of messages that all subscribers got") {
    // Publishers have numbers of their own; subscriber k is k x (publisher + 1) x 10 us later.
    StreamResult stream =
        stream_of({2, 5, 2, 2}, [](unsigned, unsigned, unsigned publisher, unsigned to) {
          return 1'000 + std::int64_t{to} * (publisher + 1) * 10'000;
        });
    CHECK(fairness_gaps(stream) == Blocks{{40, 40, 80, 80}, {40, 40, 80, 80}});
    auto& samples = stream.subscribers[3].samples;
    samples.erase(samples.begin());  // number 0 of publisher 0
    CHECK(fairness_gaps(stream) == Blocks{{40, 80, 80}, {40, 40, 80, 80}});
    samples.insert(samples.begin(), samples.front());  // another one twice: still not number 0
    CHECK(fairness_gaps(stream) == Blocks{{40, 80, 80}, {40, 40, 80, 80}});
    CHECK(fairness_gaps(stream_of({}, always(1))).empty());
  }

  TEST_CASE("costs are per message sent and per message due, net of pacing") {
    StreamResult stream = stream_of({1, 2, 10, 10}, always(1));  // 100 messages, 200 due
    stream.publishers[0].usage = {1000, 200, 100, 50, 10, 6400};
    stream.subscribers[0].usage = {300, 100, 0, 0, 0, 12800};
    stream.subscribers[1].usage = {100, 100, 0, 0, 0, 12800};
    StreamResult pace = stream_of({1, 2, 10, 10}, always(1));
    pace.publishers[0].usage = {400, 100, 0, 0, 0, 0};
    pace.subscribers[1].usage = {100, 0, 0, 0, 0, 0};
    const Costs gross = costs(stream);
    CHECK(gross.publisher.cpu_us == Approx(10));
    CHECK(gross.publisher.voluntary_switches == Approx(2));
    CHECK(gross.publisher.involuntary_switches == Approx(1));
    CHECK(gross.publisher.faults == Approx(0.6));
    CHECK(gross.publisher.copied_bytes == Approx(64));
    CHECK(gross.subscriber.cpu_us == Approx(2));
    CHECK(gross.subscriber.copied_bytes == Approx(128));
    const Costs net = costs_net_of(stream, &pace);
    CHECK(net.publisher.cpu_us == Approx(6));
    CHECK(net.subscriber.cpu_us == Approx(1.5));
    CHECK(net.publisher.voluntary_switches == Approx(1));
    CHECK(net.publisher.copied_bytes == Approx(64));
    CHECK(costs_net_of(stream, nullptr).publisher.cpu_us == Approx(10));
    CHECK(costs(StreamResult{}).publisher.cpu_us == 0);
  }

  TEST_CASE("processor time per message has a value a block, net of the same block's pacing") {
    StreamResult stream;
    stream.block_costs = {{2, 10, 60, 40}, {1, 10, 20, 10}, {3, 0, 5, 5}};
    CHECK(cpu_per_message(stream, nullptr) == Blocks{{3}, {10}});
    stream.block_costs[1].block = 4;  // each at its place, since other arms' are paired with them
    CHECK(cpu_per_message(stream, nullptr) == Blocks{{}, {10}, {}, {3}});
    stream.block_costs[1].block = 1;
    StreamResult pace;
    pace.block_costs = {{1, 10, 10, 0}, {2, 20, 10, 10}};
    CHECK(cpu_per_message(stream, &pace) == Blocks{{2}, {9}});
    CHECK(ratio_of_cpu(stream, &pace, stream, &pace)->ratio == 1);
    CHECK(ratio_of_cpu(stream, nullptr, pace, nullptr)->ratio == 3);
    CHECK_FALSE(ratio_of_cpu(pace, &stream, stream, nullptr));  // less than pacing alone
    CHECK_FALSE(ratio_of_cpu(stream, nullptr, pace, &stream));
  }

  TEST_CASE("a block in which nothing came keeps its place") {
    StreamResult stream = stream_of({1, 1, 4, 2}, always(50'000));
    auto& samples = stream.subscribers[0].samples;
    samples.erase(std::remove_if(samples.begin(), samples.end(),
                                 [](const Sample& s) { return s.block == 2; }),
                  samples.end());
    CHECK(latencies(stream, Stamp::Fill) == Blocks{{50, 50}, {50, 50}, {}, {50, 50}});
  }

  TEST_CASE("a quiet arm is compared with quiet ones") {
    CHECK(quiet("ring") == "ring quiet");
    CHECK(is_quiet("ring quiet"));
    CHECK_FALSE(is_quiet("ring"));
    CHECK(transport_of("ring quiet") == "ring");
    CHECK(transport_of("ring") == "ring");
    CHECK(beside("tcp quiet", "ring") == "ring quiet");
    CHECK(beside("tcp", "ring") == "ring");
  }

  TEST_CASE("what failed is told from what cannot be had") {
    CHECK(has_failed("failed: hangs"));
    CHECK_FALSE(has_failed(""));
    CHECK_FALSE(has_failed("its nodes share one process"));
  }

  TEST_CASE("an arm that did not run is not found") {
    Cell cell;
    cell.arms = {arm_of("ring", stream_of({}, always(1))), arm_of("udp", {})};
    cell.arms[1].refused = "no network";
    CHECK(find(cell, "ring") == &cell.arms[0]);
    CHECK(find(cell, "ring", "") == &cell.arms[0].streams[0]);
    CHECK(find(cell, "ring", "imu") == nullptr);
    CHECK(find(cell, "udp") == nullptr);
    CHECK(find(cell, "tcp", "") == nullptr);
  }
}
