// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

#include "lockfree_ring/ring.hpp"

/// How the reader of many rings falls asleep, and how a new ring wakes the readers of its topic:
/// all steps in shared memory, in their order. The system calls are the caller's.
///
/// `Sources` is a container of structs that have a `reader`, one for each ring that is read.
///
/// Edges
///   R5  a mark taken away (release) -> sleeper's compare-and-swap (acquire)
///       carries: the writer word ORPHAN.
namespace lot::ring {

/// What a reader does that has looked everywhere and found nothing.
enum class Rest {
  Look,  ///< there is something to look at after all
  Doze,  ///< sleep on the last word alone, and not for long: there are rings that it could not join
  Sleep,  ///< until one of the words changes
};

/// Rings that have ended are left, senders that wait for room are rung. False: there is something
/// to look at after all.
template <class Sources, class RingBell, class Leave>
bool settle(Sources& sources, RingBell&& ring_bell, Leave&& leave) {
  for (auto s = sources.begin(); s != sources.end();) {
    if (s->reader.sender_waits()) ring_bell(s->reader);
    if (!s->reader.orphaned()) {
      ++s;
      continue;
    }
    if (!s->reader.ended()) return false;
    leave(s->reader);
    s = sources.erase(s);
  }
  return true;
}

/// Leaves marks in the rings, and calls sleep_on(word, value) for each word to sleep on. `version`
/// is the directory's when the sources were all rings of the topic; wake(word) wakes who sleeps on
/// a word.
///
/// Crash: the marks stay behind. The reaper takes them away and wakes.
template <class Sources, class Directory, class SleepOn, class Wake>
Rest lie_down(Sources& sources, const Directory& directory, std::uint32_t version,
              SleepOn&& sleep_on, Wake&& wake) {
  bool all_empty = true;
  for (auto& source : sources) {
    const auto marked = source.reader.mark_sleeping();
    all_empty = marked.has_value();
    if (!all_empty) break;
    sleep_on(source.reader.slot(), *marked);
  }
  // What ended before the marks stood. Whoever ends it later takes the marks away and wakes.
  bool ended = false;
  for (auto& source : sources) ended |= source.reader.orphaned();
  if (ended) {
    // These marks came after that. Another reader, whose mark was taken and who has not fallen
    // asleep yet, would take ours for its own.
    for (auto& source : sources) {
      source.reader.slot().fetch_and(~kSleeper, std::memory_order_relaxed);
      wake(source.reader.slot());
    }
  }
  if (ended || !all_empty) return Rest::Look;
  // A mark does not say whose it is: a new ring may have taken ours, and a reader that knows that
  // ring set it again. So everybody sleeps on the directory, too. Relaxed: sleeping compares.
  const std::uint32_t now = directory.load(std::memory_order_relaxed);
  sleep_on(directory, now);
  return now == version ? Rest::Sleep : Rest::Doze;
}

/// Says that a ring has come, and wakes who may want to read it. All sleep on the directory, but
/// where the kernel waits for one word at a time it is the first ring that is slept on.
///
/// Crash: killed between a mark and its wake, it leaves a reader of somebody else's ring asleep
/// without a mark. The reaper wakes all sleepers of all rings.
template <class Directory, class Rings, class Wake>
void announce(Directory& directory, Rings&& rings, Wake&& wake) {
  // All relaxed: who finds the directory changed takes the registry's lock, which carries the ring;
  // who does not is woken.
  directory.fetch_add(1, std::memory_order_relaxed);
  for (auto&& ring : rings) {
    for (std::uint32_t i = 0; i < ring.depth; ++i) {
      const Word old = ring.slots[i].fetch_and(~kSleeper, std::memory_order_relaxed);
      if ((old & kSleeper) != 0) wake(ring.slots[i]);
    }
  }
  wake(directory);
}

/// What a sender sleeps on when its ring is full, the value of `space`; nothing when there is room
/// after all.
template <class Writer>
std::optional<std::uint32_t> wait_for_room(Writer& writer) {
  const std::uint32_t value = writer.mark_waiting();
  if (writer.room()) return std::nullopt;  // R6: made before the mark stood, so nobody rings
  return value;
}

}  // namespace lot::ring
