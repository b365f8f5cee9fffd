// SPDX-License-Identifier: Apache-2.0
#include "gateway/ros_graph.hpp"

#include <algorithm>
#include <cstdint>
#include <utility>

#include "codec/program.hpp"
#include "gateway/quality.hpp"

namespace lot::gateway {
namespace {

constexpr const char* kTopic = "ros_discovery_info";
constexpr const char* kType = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
constexpr std::uint64_t kMostBytes = std::uint64_t{1} << 20;

/// Writes CDR: the few kinds of values that the message has.
class Cdr {
 public:
  explicit Cdr(std::size_t gid_bytes)
      : gid_bytes_(gid_bytes), bytes_{std::byte{0}, std::byte{1}, std::byte{0}, std::byte{0}} {}

  void number(std::size_t value) {
    bytes_.resize(bytes_.size() + codec::padding(bytes_.size(), sizeof(std::uint32_t)));
    for (unsigned shift = 0; shift < 32; shift += 8) bytes_.push_back(std::byte(value >> shift));
  }
  void text(const std::string& value) {
    number(value.size() + 1);
    for (const char c : value) bytes_.push_back(static_cast<std::byte>(c));
    bytes_.push_back(std::byte{0});
  }
  void gid(const dds_guid_t& guid) {
    for (const unsigned char c : guid.v) bytes_.push_back(std::byte{c});
    bytes_.resize(bytes_.size() + (gid_bytes_ - sizeof guid.v));
  }
  void gids(const std::vector<dds_guid_t>& guids) {
    number(guids.size());
    for (const dds_guid_t& guid : guids) gid(guid);
  }
  Bytes bytes() const { return {bytes_.data(), bytes_.size()}; }

 private:
  const std::size_t gid_bytes_;
  std::vector<std::byte> bytes_;
};

}  // namespace

RosGraph::RosGraph(const Domain& domain, std::string node, std::size_t gid_bytes)
    : node_(std::move(node)),
      gid_bytes_(std::max(gid_bytes, sizeof(dds_guid_t::v))),
      topic_(domain.participant(), kTopic, kType, kMostBytes) {
  require(dds_get_guid(domain.participant(), &participant_), kTopic, "say who it is");
  const Qos qos = qos_of({Reliability::Reliable, Durability::TransientLocal, 1, {}}, "");
  writer_ = Entity(dds_create_writer(domain.participant(), topic_.get(), qos.get(), nullptr),
                   kTopic, "make a writer");
}

void RosGraph::tell(const std::vector<dds_guid_t>& readers,
                    const std::vector<dds_guid_t>& writers) {
  Cdr cdr(gid_bytes_);
  cdr.gid(participant_);
  cdr.number(1);  // node
  cdr.text("/");  // its namespace
  cdr.text(node_);
  cdr.gids(readers);
  cdr.gids(writers);
  require(dds_writecdr(writer_.get(), topic_.sample(cdr.bytes()).release()), kTopic, "write");
}

}  // namespace lot::gateway
