// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <dds/dds.h>

#include "gateway/settings.hpp"

namespace lot::gateway {

struct DeleteQos {
  void operator()(dds_qos_t* qos) const noexcept { dds_delete_qos(qos); }
};
using Qos = std::unique_ptr<dds_qos_t, DeleteQos>;

/// For a reader or a writer. `user_data`: what others see of it. Throws nothing.
inline Qos qos_of(const Quality& quality, const std::string& user_data) {
  Qos qos(dds_create_qos());
  // A writer waits so long at most: only where kUnacknowledged (domain.cpp) is used up.
  constexpr dds_duration_t kLongestWait = DDS_MSECS(100);
  const auto depth = static_cast<std::int32_t>(quality.depth);
  const bool is_reliable = quality.reliability != Reliability::BestEffort;
  dds_qset_reliability(qos.get(),
                       is_reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                       kLongestWait);
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, depth);
  const bool is_latched = quality.durability == Durability::TransientLocal;
  dds_qset_durability(qos.get(),
                      is_latched ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  if (is_latched) {
    dds_qset_durability_service(qos.get(), 0, DDS_HISTORY_KEEP_LAST, depth, DDS_LENGTH_UNLIMITED,
                                DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  }
  if (quality.deadline > Duration()) {
    dds_qset_deadline(qos.get(), quality.deadline.count());
  }
  dds_qset_ignorelocal(qos.get(), DDS_IGNORELOCAL_PARTICIPANT);
  if (!user_data.empty()) dds_qset_userdata(qos.get(), user_data.data(), user_data.size());
  return qos;
}

/// The user data of an endpoint; empty: it has none. Throws std::bad_alloc.
inline std::string user_data_in(const dds_qos_t* qos) {
  void* data = nullptr;
  std::size_t size = 0;
  if (!dds_qget_userdata(qos, &data, &size) || data == nullptr) return "";
  const std::unique_ptr<void, void (*)(void*)> owner(data, dds_free);
  return {static_cast<const char*>(data), size};
}

}  // namespace lot::gateway
