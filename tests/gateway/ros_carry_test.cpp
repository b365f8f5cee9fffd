// SPDX-License-Identifier: Apache-2.0

// lot_gateway beside writers as ROS 2 has them, which say no type of LOT: here they are made by
// CycloneDDS, and have bytes of CDR.

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "gateway/cdr_type.hpp"
#include "gateway/domain.hpp"
#include "gateway/peer.hpp"
#include "gateway/program.hpp"
#include "gateway/quality.hpp"
#include "gateway/two_domains.hpp"
#include "support/processes.hpp"

namespace geometry_msgs {

struct Vector3 {
  double x, y, z;
};
struct Twist {
  Vector3 linear, angular;
};

}  // namespace geometry_msgs

namespace lot::testing {
namespace {

using gateway::CdrTopic;
using gateway::Domain;
using gateway::Entity;
using geometry_msgs::Twist;

struct Host {
  EngineOptions where = fresh();
  ShmEngine engine{where};
};

/// A writer of rt/cmd_vel.
class Writer {
 public:
  explicit Writer(const std::string& type = "geometry_msgs::msg::dds_::Twist_",
                  const std::string& user_data = "")
      : topic_(domain_.participant(), "rt/cmd_vel", type, 1 << 20) {
    const gateway::Qos qos = gateway::qos_of(
        {gateway::Reliability::Reliable, gateway::Durability::Volatile, 64, {}}, user_data);
    writer_ = Entity(dds_create_writer(domain_.participant(), topic_.get(), qos.get(), nullptr),
                     "rt/cmd_vel", "make a writer");
  }

  /// Six numbers, from `first` on.
  void write(double first) const {
    constexpr std::size_t kHead = 4;
    constexpr std::size_t kNumbers = 6;
    std::vector<std::byte> bytes(kHead + kNumbers * sizeof(double));
    bytes[1] = std::byte{1};
    for (std::size_t i = 0; i < kNumbers; ++i) {
      const double number = first + static_cast<double>(i);
      std::memcpy(bytes.data() + kHead + i * sizeof number, &number, sizeof number);
    }
    gateway::require(
        dds_writecdr(writer_.get(), topic_.sample(Bytes(bytes.data(), bytes.size())).release()),
        "rt/cmd_vel", "write");
  }

 private:
  const Domain domain_{alone(1, 0)};
  const CdrTopic topic_;
  Entity writer_;
};

/// Writes until a message comes, which must be right.
void check_it_comes(const Writer& writer, ShmEngine& engine) {
  auto puller = engine.subscribe<Twist>("/cmd_vel");
  ShmSharedPtr<const Twist> seen;
  REQUIRE(eventually(
      [&] {
        writer.write(7);
        seen = puller.pull(20ms);
        return static_cast<bool>(seen);
      },
      30s));
  CHECK(seen->linear.x == 7);
  CHECK(seen->angular.z == 12);
}

TEST_SUITE_BEGIN("gateway");

TEST_CASE("a topic whose type --in says comes in before a subscriber, or a writer, is there") {
  const Watchdog watchdog(60);
  Host host;
  Gateway in(host.where, {"--in", "/cmd_vel:geometry_msgs/msg/Twist"});
  REQUIRE(in.says("in /cmd_vel <- rt/cmd_vel"));
  check_it_comes(Writer(), host.engine);
}

TEST_CASE("a common message of ROS 2 needs neither a subscriber nor a word about its type") {
  const Watchdog watchdog(60);
  Host host;
  Gateway in(host.where, {"--in", "/cmd*"});
  const Writer writer;
  REQUIRE(eventually(
      [&] {
        writer.write(7);
        return static_cast<bool>(host.engine.type_of("/cmd_vel"));
      },
      30s));
  CHECK(host.engine.type_of("/cmd_vel").name() == "geometry_msgs::Twist");
  check_it_comes(writer, host.engine);
}

TEST_CASE("a type that the gateway does not know waits for a subscriber, and it says so") {
  const Watchdog watchdog(60);
  Host host;
  Gateway in(host.where, {"--in", "/*"});
  const Writer writer("robot::msg::dds_::Turn_");
  REQUIRE(in.says("knows no fields of robot::msg::dds_::Turn_"));
  CHECK(in.end().empty());
}

TEST_CASE("a message of ROS 2 comes from a gateway whose type has another identity, too") {
  const Watchdog watchdog(60);
  Host host;
  const AnyType own = AnyType::of<Twist>();
  constexpr std::uint64_t kIdentity = 12345;  // as MD5 is of a type of ROS 1
  const AnyType theirs =
      AnyType::decoded("geometry_msgs/Twist", own.alignment(), own.encoded(), kIdentity);
  Gateway in(host.where, {"--in", "/cmd_vel:geometry_msgs/msg/Twist"});
  check_it_comes(
      Writer("geometry_msgs::msg::dds_::Twist_", gateway::user_data_of({"elsewhere", theirs})),
      host.engine);
}

TEST_CASE("a type that the gateway does not know is a mistake on the command line") {
  const Watchdog watchdog(60);
  Host host;
  for (const char* word : {"/cmd_vel:geometry_msgs/msg/Twister", "/cmd_vel:", "/cmd_vel:Twist"}) {
    CAPTURE(word);
    Gateway in(host.where, {"--in", word});
    REQUIRE(in.says("the gateway knows no fields of a type"));
    CHECK(in.ends() == 2);
  }
}

TEST_SUITE_END();

}  // namespace
}  // namespace lot::testing
