// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "life.hpp"

namespace lot::chaos {

/// The books of one subscription: everything that was published since it joined is either received
/// or missed, in order and once.
///
/// What can be checked exactly, though publishers die in the middle of a push, and though missed()
/// is one number for all publishers of a topic:
///
///  - *Order.* Each publisher (incarnation) numbers its messages 0, 1, 2 ... A message that was
///    refused (Full) gives its number to the next one, so a ring has every number once: received
///    numbers rise, and a step of more than one is a gap.
///  - *Gaps.* Where a gap opens, missed() must have covered it by then. The difference is
///        credit = all that missed() has told - all gaps so far,
///    and less than 0 means: lost. It may be more than 0 for a while: a publisher's ring whose
///    missed messages are told with a message of another ring, before its own next one (a pull has
///    no block yet for a message that came to a slot while it looked). But when
///    a look has found nothing every ring was read to its end and it is 0. The message that a
///    dying publisher may or may not have got out is no problem: it makes no gap, being the last.
///  - *The end.* A look that finds nothing has looked at every ring. So whatever was completely
///    published (Incarnation::done) before that look began must be in the books. Publishers that
///    are killed leave `done` behind, and so the tail of a dead one is checked as well.
///  - *The beginning.* A publisher that advertises after subscribe() has returned is read from its
///    number 0 on. One that was there before is read from where the subscription found it, less
///    the history; that place is known from its counters before and after subscribe(), within the
///    messages that were pushed meanwhile. Where first number and missed() leave open what was the
///    first number of all, the credit is an interval, until the next look that finds nothing.
///  - *Block.* There is no gap at all behind the first number. (Before it there may be one: a
///    reader that joins later than the publisher came gets at most depth - 1 old messages and the
///    rest as missed.)
///  - *Observers.* For one all publishers overwrite: under Block there may be gaps, too, which
///    missed() covers. A publisher that comes later is read from its number 0 on, if a look has
///    found it before it ended.
///  - *Little memory.* Publishers under Overwrite then take their oldest messages back, and a
///    reader may have counted some whose number it cannot tell yet. Then only "not lost" is
///    checked, by the gaps, and not "none too many"; under Block all of it is.
class Account {
 public:
  Account(Life& life, std::uint32_t topic, bool observes)
      : life_(life), topic_(topic), observes_(observes) {}

  void before_subscribe();
  void after_subscribe(std::uint64_t history);

  void before_look();
  void received(const Place& place, std::uint64_t missed);
  void found_nothing();

  /// In a checkpoint, when no node publishes: a publisher that lives and was not heard, or 0.
  std::uint32_t unheard();
  /// Says that this one was never heard.
  [[noreturn]] void fail_unheard(std::uint32_t incarnation) {
    fail(Finding::Lost, "never heard of a publisher that is there", incarnation);
  }
  /// True for a publisher that came after the subscription.
  bool is_late(std::uint32_t incarnation) const { return incarnation >= began_; }

 private:
  /// A publisher that was heard.
  struct Ring {
    std::uint32_t incarnation;
    std::uint64_t next;
    std::uint64_t done;  ///< before the look
    bool over;           ///< its publisher had ended before the look
  };
  /// A publisher that may have been there when we subscribed, and was not heard yet: its first
  /// number for us is in [least, most].
  struct Early {
    std::uint32_t incarnation;
    std::uint64_t least, most;
    bool was_live;  ///< already before
    bool joined;    ///< for certain; these come first
    std::uint64_t done;
  };

  Incarnation& record(std::uint32_t i) const { return life_.board.incarnations[i]; }
  /// True when this publisher waits for the reader.
  bool blocking(std::uint32_t i) const { return record(i).blocking != 0 && !observes_; }
  bool is_exact(std::uint32_t i) const { return life_.epoch.roomy || blocking(i); }
  /// A reader that joins a ring of depth 1 late, under Block, is told what it missed, and gets
  /// nothing.
  bool credit_may_stay() const { return topic_ == kRefuse; }
  /// Calls f(index, record) for each publisher that the topic has had since its segment was made.
  template <class F>
  void each_publisher(F&& f) const {
    for (std::uint32_t i = life_.board.newest[topic_].load(); i != 0; i = record(i).before) {
      f(i, record(i));
    }
  }
  Ring* find(std::uint32_t incarnation);
  void first_of(const Place& place, std::int64_t& least_gap, std::int64_t& most_gap);
  void settle_credit();
  [[noreturn]] void fail(Finding finding, const std::string& what, std::uint32_t incarnation);

  Life& life_;
  std::uint32_t topic_;
  bool observes_;
  std::uint32_t began_ = 0;  ///< incarnations from here on are read from their number 0
  std::vector<Early> early_;
  std::vector<Ring> rings_;
  std::int64_t least_credit_ = 0;
  std::int64_t most_credit_ = 0;
};

}  // namespace lot::chaos
