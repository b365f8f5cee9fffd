// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cerrno>
#include <string>
#include <utility>

#include <dds/dds.h>

#include "lot/error.hpp"

namespace lot::gateway {

/// Throws lot::Error for what CycloneDDS calls an error; else the same number.
inline dds_return_t require(dds_return_t result, const std::string& object, const char* failed) {
  if (result >= 0) return result;
  const int number = result == DDS_RETCODE_BAD_PARAMETER          ? EINVAL
                     : result == DDS_RETCODE_INCONSISTENT_POLICY  ? EINVAL
                     : result == DDS_RETCODE_PRECONDITION_NOT_MET ? EEXIST
                     : result == DDS_RETCODE_OUT_OF_RESOURCES     ? ENOMEM
                                                                  : EREMOTEIO;
  throw Error(number, object,
              std::string("CycloneDDS could not ") + failed + ": " + dds_strretcode(-result), "");
}

/// An entity of CycloneDDS, and all that was made in it: deleted with this.
class Entity {
 public:
  /// None.
  Entity() noexcept = default;
  /// What a dds_create_...() has returned. Throws lot::Error where that is an error.
  Entity(dds_entity_t made, const std::string& object, const char* failed)
      : entity_(require(made, object, failed)) {}
  Entity(Entity&& other) noexcept : entity_(std::exchange(other.entity_, 0)) {}
  Entity& operator=(Entity&& other) noexcept {
    std::swap(entity_, other.entity_);
    return *this;
  }
  ~Entity() {
    if (entity_ > 0) dds_delete(entity_);
  }

  dds_entity_t get() const noexcept { return entity_; }

 private:
  dds_entity_t entity_ = 0;
};

}  // namespace lot::gateway
