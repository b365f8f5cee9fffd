// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

#include "lot/lot.hpp"

#include "job.hpp"
#include "life.hpp"

namespace lot::chaos {

/// Opens engines, publishes, reads and closes everything in some order, again and again: the
/// process joins and leaves the segment many times in one life.
class Juggler final : public Job {
 public:
  Juggler(Life& life, std::uint32_t topic) : life_(life), topic_(topic) {}

  void turn() override;
  void quiet() override;
  bool settle() override;

 private:
  Life& life_;
  std::uint32_t topic_;
  std::optional<ShmEngine> at_rest_;  ///< in a checkpoint every node is a participant
};

}  // namespace lot::chaos
