// SPDX-License-Identifier: Apache-2.0

// Bytes of CDR as samples of CycloneDDS: between two domains of one process.

#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "codec/decode.hpp"
#include "codec/schema.hpp"
#include "gateway/cdr_type.hpp"
#include "gateway/domain.hpp"
#include "gateway/names.hpp"
#include "gateway/quality.hpp"
#include "gateway/ros_graph.hpp"
#include "gateway/two_domains.hpp"
#include "support/error_of.hpp"
#include "support/processes.hpp"

namespace lot::testing {
namespace {

using namespace gateway;

struct Shot {
  std::uint32_t number = 0;
  ShmString label;
  ShmVector<std::uint8_t> pixels;
};

constexpr const char* kType = "lot::msg::dds_::Shot_";
constexpr std::uint64_t kMost = 32 << 20;

Entity writer_of(const Domain& domain, const CdrTopic& topic) {
  dds_qos_t* const qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(10));
  dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, 0);
  Entity writer(dds_create_writer(domain.participant(), topic.get(), qos, nullptr), "writer", "");
  dds_delete_qos(qos);
  return writer;
}

Entity reader_of(const Domain& domain, const CdrTopic& topic) {
  dds_qos_t* const qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(10));
  dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, 0);
  Entity reader(dds_create_reader(domain.participant(), topic.get(), qos, nullptr), "reader", "");
  dds_delete_qos(qos);
  return reader;
}

void wait_for_match(const Entity& writer, std::uint32_t readers = 1) {
  dds_publication_matched_status_t status{};
  do {
    std::this_thread::sleep_for(5ms);
    require(dds_get_publication_matched_status(writer.get(), &status), "writer", "look");
  } while (status.current_count < readers);
}

CdrSample take(const Entity& reader) {
  for (;;) {
    ddsi_serdata* taken = nullptr;
    dds_sample_info_t info{};
    const dds_return_t count =
        require(dds_takecdr(reader.get(), &taken, 1, &info, DDS_ANY_STATE), "reader", "take");
    CdrSample sample(count == 1 ? taken : nullptr);
    if (count == 1 && info.valid_data) return sample;
    std::this_thread::sleep_for(1ms);
  }
}

/// Two domains of this process, with a topic each.
struct Pair {
  Domain here{alone(1)};
  Domain there{alone(2)};
  CdrTopic out{here.participant(), "rt/shots", kType, kMost};
  CdrTopic in{there.participant(), "rt/shots", kType, kMost};
};

}  // namespace
}  // namespace lot::testing

/// What processes of ROS 2 tell each other, as LOT has it.
namespace rmw_dds_common {

struct Gid {
  std::uint8_t data[24];
};
struct NodeEntitiesInfo {
  lot::ShmString node_namespace;
  lot::ShmString node_name;
  lot::ShmVector<Gid> reader_gid_seq;
  lot::ShmVector<Gid> writer_gid_seq;
};
struct ParticipantEntitiesInfo {
  Gid gid;
  lot::ShmVector<NodeEntitiesInfo> node_entities_info_seq;
};

}  // namespace rmw_dds_common

namespace lot::testing {
namespace {

TEST_SUITE_BEGIN("gateway");

TEST_CASE("a message of any size comes through another domain as it was encoded") {
  const Watchdog watchdog(110);
  Pair pair;
  const Entity writer = writer_of(pair.here, pair.out);
  const Entity reader = reader_of(pair.there, pair.in);
  wait_for_match(writer);
  ShmEngine engine(fresh());
  const AnyType type = AnyType::of<Shot>();
  auto pusher = engine.advertise_any("/shots", type);
  const codec::Program encoding(type.description());
  const codec::Program decoding(pusher.type().description());
  std::uint32_t number = 0;
  for (const std::size_t size :
       {0U, 1U, 2U, 3U, 4U, 100U, 1339U, 1340U, 70000U, 1U << 20, 16U << 20}) {
    CAPTURE(size);
    const auto shot = engine.make<Shot>();
    shot->number = ++number;
    shot->label = "shot";
    for (std::size_t i = 0; i < size; ++i) {
      shot->pixels.push_back(static_cast<std::uint8_t>(i * 7 + i / 251));
    }
    const AnyMessage sent(ShmSharedPtr<const Shot>(engine.make<Shot>(*shot)));
    CdrSample sample = pair.out.sample(encoding, sent.root());
    const std::vector<std::byte> bytes(sample.bytes().begin(), sample.bytes().end());
    CHECK(bytes.size() % 4 == 0);
    require(dds_writecdr(writer.get(), sample.release()), "writer", "write");
    const CdrSample got = take(reader);
    CHECK(got.number() == number);
    REQUIRE(got.bytes().size() == bytes.size());
    CHECK(std::memcmp(got.bytes().data(), bytes.data(), bytes.size()) == 0);
    AnyLoan loan = pusher.loan();
    decode(decoding, got.bytes(), loan.root());
    const AnyMessage made = std::move(loan).share();
    const auto seen = made.as<Shot>();
    REQUIRE(seen);
    CHECK(seen->number == number);
    CHECK(seen->label == "shot");
    CHECK(seen->pixels == shot->pixels);
  }
}

TEST_CASE("a sample that is larger than allowed is dropped and counted") {
  const Watchdog watchdog(60);
  Pair pair;
  constexpr std::uint64_t kSmall = 1000;
  const CdrTopic strict(pair.there.participant(), "rt/shots", kType, kSmall);
  const Entity writer = writer_of(pair.here, pair.out);
  const Entity reader = reader_of(pair.there, strict);
  wait_for_match(writer);
  const std::vector<std::byte> large(2000, std::byte{1});
  const std::vector<std::byte> small(kSmall, std::byte{2});
  require(dds_writecdr(writer.get(), pair.out.sample(Bytes(large.data(), large.size())).release()),
          "writer", "write");
  require(dds_writecdr(writer.get(), pair.out.sample(Bytes(small.data(), small.size())).release()),
          "writer", "write");
  const CdrSample got = take(reader);
  CHECK(got.bytes().size() == kSmall);
  CHECK(got.bytes().data()[kSmall - 1] == std::byte{2});
  CHECK(strict.too_large() == 1);
}

TEST_CASE("a sample outlives its reader, topic and domain") {
  const Watchdog watchdog(60);
  CdrSample kept;
  {
    Pair pair;
    const Entity writer = writer_of(pair.here, pair.out);
    const Entity reader = reader_of(pair.there, pair.in);
    wait_for_match(writer);
    const std::vector<std::byte> bytes(100, std::byte{3});
    require(dds_writecdr(writer.get(), pair.out.sample(Bytes(bytes.data(), 100)).release()),
            "writer", "write");
    kept = take(reader);
  }
  CHECK(kept.bytes().size() == 100);
  CHECK(kept.bytes().data()[99] == std::byte{3});
}

TEST_CASE("ROS 2 is told of a node with its readers and writers, also when it comes later") {
  const Watchdog watchdog(60);
  const Domain here(alone(1));
  const Domain there(alone(2));
  RosGraph graph(here, "gateway_of_a_test", 24);
  dds_guid_t reader{};
  dds_guid_t writer{};
  reader.v[0] = 7;
  writer.v[15] = 9;
  graph.tell({reader, reader}, {writer});

  ShmEngine engine(fresh());
  const AnyType type = AnyType::of<rmw_dds_common::ParticipantEntitiesInfo>();
  auto pusher = engine.advertise_any("/info", type);
  const codec::Program program(pusher.type().description());
  const CdrTopic topic(there.participant(), "ros_discovery_info",
                       dds_type_of(codec::schema_of(pusher.type().description()).name), kMost);
  const Qos qos = qos_of({Reliability::Reliable, Durability::TransientLocal, 1, {}}, "");
  const Entity taker(dds_create_reader(there.participant(), topic.get(), qos.get(), nullptr),
                     "reader", "");
  AnyLoan loan = pusher.loan();
  decode(program, take(taker).bytes(), loan.root());
  const AnyMessage made = std::move(loan).share();
  const auto info = made.as<rmw_dds_common::ParticipantEntitiesInfo>();
  REQUIRE(info);
  dds_guid_t participant{};
  require(dds_get_guid(here.participant(), &participant), "participant", "look");
  CHECK(std::memcmp(info->gid.data, participant.v, sizeof participant.v) == 0);
  REQUIRE(info->node_entities_info_seq.size() == 1);
  const auto& node = info->node_entities_info_seq[0];
  CHECK(std::string(node.node_namespace) == "/");
  CHECK(std::string(node.node_name) == "gateway_of_a_test");
  REQUIRE(node.reader_gid_seq.size() == 2);
  CHECK(node.reader_gid_seq[1].data[0] == 7);
  REQUIRE(node.writer_gid_seq.size() == 1);
  CHECK(node.writer_gid_seq[0].data[15] == 9);
}

TEST_CASE("a domain has any number of topics of one type") {
  const Watchdog watchdog(60);
  const Domain domain(alone(1));
  std::vector<std::unique_ptr<CdrTopic>> topics;
  for (int i = 0; i < 300; ++i) {
    const std::string name = "rt/shots" + std::to_string(i);
    topics.push_back(std::make_unique<CdrTopic>(domain.participant(), name, kType, kMost));
  }
  CHECK(topics.back()->get() > 0);
}

TEST_CASE("an interface that is not there is an error that names those that are") {
  DomainSettings settings = alone(1);
  settings.interface = "none0";
  const auto [number, what] = error_of([&] { const Domain domain(settings); });
  CHECK(number == ENODEV);
  CHECK(what.find("there are ") != std::string::npos);
}

TEST_CASE("a name that DDS does not allow is an error that says so") {
  const Watchdog watchdog(60);
  const Domain domain(alone(1));
  CHECK(error_of([&] { CdrTopic(domain.participant(), "no name?", kType, kMost); }).first ==
        EINVAL);
}

TEST_SUITE_END();

}  // namespace
}  // namespace lot::testing
