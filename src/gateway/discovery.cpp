// SPDX-License-Identifier: Apache-2.0
#include "gateway/discovery.hpp"

#include <algorithm>
#include <cstring>

#include "gateway/quality.hpp"

namespace lot::gateway {
namespace {

constexpr const char* kDiscovery = "discovery";

Discovery::Guid guid_of(const dds_guid_t& guid) {
  Discovery::Guid result{};
  std::copy(std::begin(guid.v), std::end(guid.v), result.begin());
  return result;
}

Discovery::Writer writer_of(const dds_builtintopic_endpoint_t& endpoint) {
  dds_reliability_kind_t reliability = DDS_RELIABILITY_BEST_EFFORT;
  dds_durability_kind_t durability = DDS_DURABILITY_VOLATILE;
  (void)dds_qget_reliability(endpoint.qos, &reliability, nullptr);
  (void)dds_qget_durability(endpoint.qos, &durability);
  return {endpoint.topic_name, endpoint.type_name, user_data_in(endpoint.qos),
          reliability == DDS_RELIABILITY_RELIABLE, durability != DDS_DURABILITY_VOLATILE};
}

}  // namespace

Discovery::Discovery(const Domain& domain)
    : reader_(dds_create_reader(domain.participant(), DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr,
                                nullptr),
              kDiscovery, "look for writers"),
      news_(dds_create_readcondition(reader_.get(), DDS_ANY_STATE), kDiscovery,
            "wait for writers") {
  require(dds_get_guid(domain.participant(), &own_), kDiscovery, "say who this participant is");
}

bool Discovery::look() {
  bool has_changed = false;
  for (;;) {
    void* taken = nullptr;
    dds_sample_info_t info{};
    const dds_return_t count =
        require(dds_take(reader_.get(), &taken, &info, 1, 1), kDiscovery, "look for writers");
    if (count == 0) return has_changed;
    const auto& endpoint = *static_cast<const dds_builtintopic_endpoint_t*>(taken);
    if (std::memcmp(endpoint.participant_key.v, own_.v, sizeof own_.v) != 0) {
      has_changed = true;
      if (info.instance_state == DDS_IST_ALIVE && info.valid_data) {
        writers_[guid_of(endpoint.key)] = writer_of(endpoint);
      } else {
        writers_.erase(guid_of(endpoint.key));
      }
    }
    require(dds_return_loan(reader_.get(), &taken, count), kDiscovery, "look for writers");
  }
}

}  // namespace lot::gateway
