// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "world.hpp"

/// The receiving end of a topic: all channels, those that are there and those that come. What a
/// puller does, reduced to its atomic steps.
namespace lot::model {

class Subscription {
 public:
  /// Joins what is there.
  void join(Process& process);
  /// Goes, without having looked at anything.
  void end();
  /// Borrows, reads and checks the next message of any ring. False: there is none.
  bool receive();
  /// The same, until something is there or a ring has ended; sleeps meanwhile.
  void await_change();

  std::uint64_t received() const { return received_; }
  std::uint64_t missed() const { return missed_; }
  std::size_t rings() const { return sources_.size(); }

 private:
  struct Source {
    std::uint32_t channel;
    std::uint32_t generation;
    ring::Reader<Policy> reader;
    Process* process;
    struct Turn : model::Turn {
      explicit Turn(const Source& s) : model::Turn(*s.process, s.channel) {}
    };
  };

  /// REQUIRES: the registry's lock.
  void find_rings();
  void begin(std::uint32_t channel, std::uint32_t generation, const ring::Reader<Policy>& reader);
  void leave(ring::Reader<Policy>& reader);

  Process* process_ = nullptr;
  std::uint32_t version_ = 0;  ///< of the directory, when sources_ was right
  std::vector<Source> sources_;
  std::uint64_t received_ = 0;
  std::uint64_t missed_ = 0;
};

}  // namespace lot::model
