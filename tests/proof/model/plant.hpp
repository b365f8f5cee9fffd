// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <optional>
#include <source_location>
#include <string>
#include <string_view>
#include <tuple>

/// Mistakes that are planted at run time, to see whether the model finds them.
///
/// Every atomic step of the headers under test passes through the policy, which knows its place in
/// the source. So one step can be weakened, or left out, without touching the headers.
namespace lot::model {

enum class Operation { Load, Store, Exchange, Fetch, CompareExchange };

/// One atomic step of the source, as written.
struct Step {
  Operation operation;
  std::memory_order order;
  std::memory_order failure;  ///< of a CompareExchange; else the same as `order`
  std::source_location where;
};

/// What is done instead.
struct Done {
  std::memory_order order;
  std::memory_order failure;
  bool dropped = false;  ///< the step is not done at all (a Fetch then only reads, a
                         ///< CompareExchange says that it is done)
  bool stale = false;    ///< a Load: what this thread read there before, if anything
};

/// How a step is spoilt.
struct Damage {
  std::optional<std::memory_order> order = {};  ///< instead of the one that is written
  /// The same for a CompareExchange that fails.
  std::optional<std::memory_order> failure = {};
  bool drop = false;
  bool stale = false;
};

/// Which step is spoilt, and how.
struct Plant {
  std::string file;      ///< end of the path
  unsigned line = 0;     ///< 0: any line
  unsigned column = 0;   ///< 0: any column
  std::string function;  ///< part of the function's name; empty: any
  std::optional<Operation> operation;
  std::optional<std::memory_order> written;
  Damage damage;

  bool names(const Step& step) const;
};

/// The mistakes that are not in an atomic step but in what the transport does around it.
struct Omissions {
  bool wake_readers = false;     ///< publish() says "wake", nobody does
  bool ring_for_room = false;    ///< a reader makes room and does not ring
  bool hazards = false;          ///< the pool reclaims what has left the ring without a look
  bool rings_lock = false;       ///< joiners do not take the registry's lock
  bool answer = false;           ///< a reader that was invited is selected whatever it answers
  bool fence_of_reader = false;  ///< a reader does not order its copy before its look at `begin`
  bool fence_of_writer = false;  ///< a writer does not order `begin` before the message
  bool repair = false;           ///< the next owner of a dead one's lock wakes nobody
};

/// The mistake of this run, and the list of all steps that were seen.
class Garden {
 public:
  Done look(const Step& step);

  /// FILE:LINE[:COLUMN]=DAMAGE, where the damage is an order, fail:ORDER, drop or stale. False: not
  /// of this form.
  bool plant(std::string_view text);
  /// One of the mistakes with a name. False: no such mistake.
  bool plant_named(std::string_view name);
  static void list_names(std::ostream& out);

  bool planted_step_was_seen() const { return !plant_ || seen_; }
  void record_steps() { record_ = true; }
  void list_steps(std::ostream& out) const;

  /// True when values that were read must be remembered.
  bool remembers() const { return plant_ && plant_->damage.stale; }
  void remember(const void* location, unsigned thread, std::uint64_t value) {
    read_[{location, thread}] = value;
  }
  std::optional<std::uint64_t> remembered(const void* location, unsigned thread) const {
    const auto found = read_.find({location, thread});
    return found == read_.end() ? std::nullopt : std::optional(found->second);
  }
  void forget() { read_.clear(); }

  Omissions omitted;

 private:
  std::optional<Plant> plant_;
  bool seen_ = false;
  bool record_ = false;
  std::map<std::tuple<std::string, unsigned, unsigned>, Step> steps_;
  std::map<std::pair<const void*, unsigned>, std::uint64_t> read_;  ///< last values, by thread
};

inline Garden garden;

const char* name_of(std::memory_order order);

}  // namespace lot::model
