// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

/// What is left open in an execution: which thread runs, what a load reads, where a store goes in
/// the order of its word. A search answers these questions, in another way in each execution.
namespace lot::weak {

enum class Kind {
  Free,    ///< all answers are alike
  Thread,  ///< 0: no forced switch of threads
  Value,   ///< 0: the newest value
};

/// Answers that are not the first one, by the number of their question. They are all that is needed
/// to do an execution once more.
using Trace = std::vector<std::pair<std::uint32_t, std::uint32_t>>;

std::string to_text(const Trace& trace);
/// False: the text is no trace.
bool from_text(std::string_view text, Trace& trace);

class Search {
 public:
  virtual ~Search() = default;
  /// Called before each execution.
  virtual void begin() = 0;
  /// A number below `count`.
  virtual unsigned choose(Kind kind, unsigned count) = 0;
  /// After an execution. False: there is no other one.
  virtual bool next() = 0;
};

/// All executions with at most `bound` answers that cost: forced switches, old values, and stores
/// that go before newer ones, together.
class Bounded final : public Search {
 public:
  explicit Bounded(unsigned bound) : bound_(bound) {}
  void begin() override {
    at_ = 0;
    left_ = bound_;
  }
  unsigned choose(Kind kind, unsigned count) override;
  bool next() override;
  /// True when some execution would go on beyond the bound.
  bool was_cut() const { return cut_; }

 private:
  struct Node {
    unsigned chosen;
    unsigned count;
    bool costs;
  };
  unsigned bound_;
  unsigned left_ = 0;
  std::size_t at_ = 0;
  bool cut_ = false;
  std::vector<Node> path_;
};

/// So many random executions. The n-th one is seeded with n, and draws first how often it switches
/// threads, and how often it reads old values.
class Random final : public Search {
 public:
  explicit Random(std::uint64_t executions, std::uint64_t first = 1)
      : number_(first), left_(executions) {}
  void begin() override;
  unsigned choose(Kind kind, unsigned count) override;
  bool next() override {
    ++number_;
    return --left_ != 0;
  }

 private:
  std::uint64_t number_;
  std::uint64_t left_;
  std::minstd_rand random_;
  unsigned switches_ = 2;  ///< one in so many
  unsigned values_ = 2;
};

/// One execution once more.
class Replay final : public Search {
 public:
  explicit Replay(Trace trace) : trace_(std::move(trace)) {}
  void begin() override { at_ = question_ = 0; }
  unsigned choose(Kind kind, unsigned count) override;
  bool next() override { return false; }

 private:
  Trace trace_;
  std::size_t at_ = 0;
  std::uint32_t question_ = 0;
};

}  // namespace lot::weak
