// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>

#include "lot/value.hpp"

#include "codec/program.hpp"
#include "gateway/buffers.hpp"
#include "gateway/entity.hpp"

namespace lot::gateway {

/// What all samples of a topic share. A sample that CycloneDDS still has may outlive its topic.
struct CdrShared {
  explicit CdrShared(std::uint64_t most) : max_size(most) {}

  Buffers buffers;
  const std::uint64_t
      max_size;  ///< of what comes from the network, with the four bytes of the head
  /// Samples from the network that were larger. The threads of CycloneDDS count, the route reads: a
  /// count, which orders nothing.
  std::atomic<std::uint64_t> too_large{0};
};

/// A sample: bytes of CDR, with the four of the head. The bytes do not change.
///
/// Threads: distinct objects freely.
/// Memory:  a share of the sample, whose buffer goes back to the topic with the last share.
class CdrSample {
 public:
  /// None.
  CdrSample() noexcept = default;
  /// Takes over a share that CycloneDDS has given.
  explicit CdrSample(ddsi_serdata* taken) noexcept : data_(taken) {}
  CdrSample(CdrSample&& other) noexcept : data_(std::exchange(other.data_, nullptr)) {}
  CdrSample& operator=(CdrSample&& other) noexcept {
    std::swap(data_, other.data_);
    return *this;
  }
  ~CdrSample() {
    if (data_ != nullptr) ddsi_serdata_unref(data_);
  }

  [[nodiscard]] explicit operator bool() const noexcept { return data_ != nullptr; }
  /// All bytes of it. REQUIRES: there is one.
  Bytes bytes() const noexcept;
  /// Which of its writer's samples it is, from 1 on. 0: it does not come from the network.
  /// REQUIRES: there is one.
  std::uint64_t number() const noexcept;
  /// When it was made, for its readers. REQUIRES: there is one, and DDS does not have it yet.
  void stamp(dds_time_t time) noexcept { data_->timestamp.v = time; }
  /// The share, which the caller gives to CycloneDDS.
  ddsi_serdata* release() noexcept { return std::exchange(data_, nullptr); }

 private:
  ddsi_serdata* data_ = nullptr;
};

/// A topic of a DDS domain without keys, whose samples the process has as bytes of CDR. CycloneDDS
/// 0.10 makes topics of types that a compiler knows. This one has a type of its own, of which only
/// the name is known, and which looks into no sample.
///
///     CdrTopic topic(participant, "rt/pose", "robot::msg::dds_::Pose_", 64 << 20);
///     CdrSample sample = topic.sample(program, message.root());
///     dds_forwardcdr(writer, sample.release());
///
/// Threads: all members may be called at once.
/// Errors:  lot::Error, std::bad_alloc.
/// Memory:  Buffers.
/// Crash:   nothing of it is shared.
class CdrTopic {
 public:
  /// Throws lot::Error: EINVAL for a name that DDS does not allow.
  CdrTopic(dds_entity_t participant, const std::string& name, const std::string& type,
           std::uint64_t max_size);

  dds_entity_t get() const noexcept { return topic_.get(); }
  /// The bytes of a message, padded to whole words as DDS sends them. Throws as codec::encode().
  CdrSample sample(const codec::Program& program, const Value& message) const;
  /// A copy of bytes of CDR, with the head. Throws std::bad_alloc.
  CdrSample sample(Bytes bytes) const;
  /// Samples from the network that were dropped for their size.
  std::uint64_t too_large() const noexcept {
    return shared_->too_large.load(std::memory_order_relaxed);  // relaxed: a count alone
  }

 private:
  std::shared_ptr<CdrShared> shared_;
  ddsi_sertype* type_ = nullptr;  ///< CycloneDDS has it as long as the topic
  Entity topic_;
};

}  // namespace lot::gateway
