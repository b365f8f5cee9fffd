// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

#include "lot/detail/changed_by.hpp"

#include "lockfree_ring/ring.hpp"

/// How the reader of many rings goes to sleep, and how a new ring wakes the readers of its topic.
/// This has all steps in shared memory, in their order. The caller makes the system calls.
///
/// `Sources` is a container of structs, one for each ring that is read. Each has a `reader` and a
/// type `Turn`. While a Turn lives, the reader has the lock of a ring of the mutex engine.
///
/// Edges
///   R5  a mark taken away (release) -> sleeper's look at the slot (acquire)
///       carries: the directory's new version, the writer word ORPHAN, or `returned`.
namespace lot::ring {

/// The directory's version. It says that there may be new rings. Futex.
template <class P>
class DirectoryVersion
    : public detail::ChangedBy<typename P::template Atomic<std::uint32_t>, DirectoryVersion<P>> {
 public:
  /// D1. Relaxed: it carries nothing. A reader that finds it changed takes the registry's lock,
  /// which carries the ring.
  void bump() { this->fetch_add(1, std::memory_order_relaxed); }
};

/// What a reader does next that has looked at every ring and found nothing.
enum class Rest {
  Look,   ///< look again: something has changed
  Doze,   ///< sleep briefly, on the last word alone: there are rings that it could not join yet
  Sleep,  ///< sleep until one of the words changes
};

/// Leaves the rings that have ended, and rings senders that wait for room. False: the reader must
/// look again.
template <class Sources, class RingBell, class Leave>
[[gnu::hot]] bool settle(Sources& sources, RingBell&& ring_bell, Leave&& leave) {
  for (auto s = sources.begin(); s != sources.end();) {
    if (s->reader.sender_waits()) ring_bell(s->reader);
    if (!s->reader.orphaned()) {
      ++s;
      continue;
    }
    if (!s->reader.ended() || s->reader.has_returns()) return false;
    if (s->reader.is_unfinished()) {  // other workers have messages, which may come back
      ++s;
      continue;
    }
    leave(s->reader);
    s = sources.erase(s);
  }
  return true;
}

/// Leaves a sleeper's mark in one ring, or on the condition of a ring of the mutex engine. False:
/// the reader must look again.
template <class Source, class SleepOn>
bool leave_mark(Source& source, SleepOn& sleep_on) {
  auto* arrived = source.reader.ring().arrived;
  bool stood = false;
  if (arrived == nullptr) {
    const auto marked = source.reader.mark_sleeping(stood);
    if (marked) sleep_on(source.reader.slot(), *marked, stood);
    return marked.has_value();
  }
  const typename Source::Turn turn(source);
  const auto announced = source.reader.announce_sleeping(stood);
  if (announced) sleep_on(*arrived, *announced, stood);
  return announced.has_value();
}

/// Leaves marks in the rings, and calls sleep_on(word, value, stood) for each word to sleep on.
/// `stood`: another sleeper has left the mark, and a push may wake only some of them. `version` is
/// the directory's version at which the sources were all rings of the topic.
///
/// Crash: the marks stay behind, and cost one needless wake each.
template <class Sources, class Directory, class SleepOn>
Rest prepare_to_sleep(Sources& sources, const Directory& directory, std::uint32_t version,
                      SleepOn&& sleep_on) {
  for (auto& source : sources) {
    if (!leave_mark(source, sleep_on)) return Rest::Look;
  }
  // Now looks for what changed before the marks stood. A process that changes it later takes the
  // marks away, which begins a new round of each slot, and wakes the reader.
  bool any_live = false;
  for (auto& source : sources) {
    if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look;
    any_live = any_live || !source.reader.orphaned();
  }
  const std::uint32_t now = directory.load(std::memory_order_relaxed);  // R5 has acquired it
  // A new publisher wakes the readers of live rings (announce), and sleepers on the directory.
  if (now != version || !any_live) sleep_on(directory.word(), now, false);
  return now == version ? Rest::Sleep : Rest::Doze;
}

/// Wakes the readers that sleep on a ring, so that they look again. ring_ears(channel) rings the
/// ears that listen to the ring (ear.hpp).
///
/// Crash: killed after it has taken a mark away and before the wake, it leaves a reader asleep
/// without a mark.
template <class Ring, class Wake, class RingEars>
void wake_sleepers(Ring& ring, Wake&& wake, RingEars&& ring_ears) {
  if (ring.arrived != nullptr) {
    ring.clear_sleepers();
    wake(*ring.arrived);
  } else {
    for (std::uint32_t i = 0; i < ring.places(); ++i) {
      if (clear_sleeper(ring.slots[i])) wake(ring.slots[i]);
    }
  }
  ring_ears(ring.channel);
}

/// Says that there is a new ring, and wakes the readers that may want it. A reader without a ring
/// sleeps on the directory's version. The other readers sleep in the other rings of the topic.
///
/// Crash: as wake_sleepers(). The reaper wakes all sleepers of all rings.
template <class Directory, class Rings, class Wake, class RingEars>
void announce(Directory& directory, Rings&& rings, Wake&& wake, RingEars&& ring_ears) {
  directory.bump();
  for (auto&& ring : rings) wake_sleepers(ring, wake, ring_ears);
  wake(directory.word());
}

/// Marks that the sender of a full ring sleeps for room. Returns the value of `space` to sleep on,
/// or nothing when there is room() after all.
template <class Writer, class Room>
std::optional<std::uint32_t> arm_for_room(Writer& writer, Room&& room) {
  const std::uint32_t value = writer.mark_waiting();
  // R6: a reader that made room before the mark stood tells nobody.
  if (room()) return std::nullopt;
  return value;
}

}  // namespace lot::ring
