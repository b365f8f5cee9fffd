// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <map>
#include <string>

#include <dds/dds.h>

#include "gateway/domain.hpp"
#include "gateway/entity.hpp"

namespace lot::gateway {

/// The writers that other participants of a domain have.
///
/// Threads: one.
/// Errors:  lot::Error, std::bad_alloc.
/// Memory:  what the writers say of themselves.
/// Crash:   nothing of it is shared.
class Discovery {
 public:
  struct Writer {
    std::string topic;
    std::string type;
    std::string user_data;
    bool is_reliable = false;
    bool is_latched = false;
  };
  using Guid = std::array<unsigned char, sizeof(dds_guid_t::v)>;

  explicit Discovery(const Domain& domain);

  /// Looks for what has come and gone. True: something has.
  bool look();
  const std::map<Guid, Writer>& writers() const noexcept { return writers_; }
  /// A condition, which holds while look() would find something.
  dds_entity_t get() const noexcept { return news_.get(); }

 private:
  Entity reader_;
  Entity news_;
  dds_guid_t own_{};
  std::map<Guid, Writer> writers_;
};

}  // namespace lot::gateway
