// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "result.hpp"

/// The memory that the conductor of a cell and its nodes share: orders, and what came of them. It
/// is an anonymous file whose descriptor the nodes inherit, so that containers share it too and
/// nothing is left behind.
///
/// Who writes what: the conductor writes `order` and then raises `turn`; each node writes its own
/// record and samples; `listening`, `sent_all` and `finished` are counted up by the nodes whose
/// turn it is and set to 0 by the conductor between turns. A node that is killed leaves a count
/// short: the conductor sees that its crew has ended, and the cell fails.
namespace ab {

inline std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// A counter to sleep on, in shared memory.
class Gate {
 public:
  std::uint32_t load() const { return value_.load(std::memory_order_acquire); }
  void set(std::uint32_t value);
  void raise() { add(1); }
  /// Sleeps until it is not `seen`, or until `patience` has passed: what it is then.
  std::uint32_t wait_while(std::uint32_t seen, std::chrono::nanoseconds patience) const;
  /// Sleeps until it is at least `value`, asking `goes_on()` now and then; false: it said no.
  template <class GoesOn>
  bool wait_for(std::uint32_t value, GoesOn&& goes_on) const {
    for (std::uint32_t seen = load(); seen < value;) {
      if (!goes_on()) return false;
      seen = wait_while(seen, std::chrono::milliseconds(50));
    }
    return true;
  }

 private:
  void add(std::uint32_t n);

  std::atomic<std::uint32_t> value_;
};

struct Order {
  std::uint32_t block;
  std::uint64_t messages;  ///< of each publisher of the arm's first stream; of others by their rate
  bool recorded;           ///< false: to warm up
  bool ends;               ///< no block: leave
};

enum class NodeState : std::uint32_t { Starting, Ready, Failed, Ended };

struct NodeRecord {
  std::atomic<NodeState> state;
  std::int32_t pid;  ///< in the namespace of the node
  std::uint64_t sent;
  std::uint64_t refused;
  std::uint64_t received;
  std::uint64_t missed;
  std::uint64_t spoilt;
  Usage usage;
  std::uint64_t samples;       ///< stored from samples_at on
  std::uint64_t most_samples;  ///< set by the conductor, as the next one
  std::uint64_t samples_at;    ///< offset in the board
  std::int64_t began, ended;   ///< the last block: of a publisher, of a subscriber
  std::uint64_t profile_at;    ///< set by the conductor: kProfileBytes of text, or 0
  std::uint64_t profile_size;
  char error[1024];
};

/// What the nodes of one arm are told, and tell each other during its turn.
struct ArmRecord {
  Gate turn;
  Order order;
  Gate listening;                   ///< subscribers that wait for messages now
  Gate sent_all;                    ///< publishers that have pushed all of their block
  Gate finished;                    ///< subscribers that have got all that will come
  Gate rested;                      ///< nodes that have nothing more to do in this turn
  std::atomic<std::int64_t> start;  ///< of the first message, decided by the first publisher
  Gate network;                     ///< its network is there
};

struct Head {
  Gate arrivals;  ///< raised when any node becomes ready, fails, or rests
  Gate stop;      ///< not 0: leave at once
  std::uint32_t arms;
  std::uint32_t nodes;
  std::uint64_t plan_at, plan_size;  ///< JSON: plan.hpp
  std::uint64_t free_at;             ///< what lies behind is given out by the conductor
};

inline constexpr std::size_t kProfileBytes = 256 << 10;

class Board {
 public:
  /// Makes one, with so many bytes to give() out.
  Board(std::size_t arms, std::size_t nodes, std::size_t bytes);
  /// One that was inherited.
  explicit Board(int fd);
  ~Board();
  Board(const Board&) = delete;
  Board& operator=(const Board&) = delete;

  int fd() const { return fd_; }
  Head& head() const { return *reinterpret_cast<Head*>(base_); }
  ArmRecord& arm(std::size_t i) const;
  NodeRecord& node(std::size_t i) const;
  Sample* samples(const NodeRecord& node) const;
  char* profile(const NodeRecord& node) const;
  std::string plan() const;
  void set_plan(const std::string& text);
  /// The offset of bytes that nobody has yet.
  std::uint64_t give(std::size_t bytes);

 private:
  void map(std::size_t size);

  int fd_;
  std::byte* base_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace ab
