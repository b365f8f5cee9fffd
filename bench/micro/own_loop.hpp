// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>

#include "micro.hpp"
#include "table.hpp"

namespace bench {

/// One end of a ping-pong as a user of the library writes it, with a type of its own and no look at
/// what is lost. It is compiled several times, with the options that people use.
class OwnLoop {
 public:
  virtual ~OwnLoop() = default;
  /// Sends and then receives `trips` balls, or receives and then sends them.
  virtual void play(bool first, std::uint64_t trips) = 0;
};

using MakeOwnLoop = std::unique_ptr<OwnLoop>(lot::ShmEngine& engine, Companion& other, bool first,
                                             Use use);
MakeOwnLoop own_loop_o1, own_loop_o2, own_loop_o3, own_loop_o3_words;

}  // namespace bench
