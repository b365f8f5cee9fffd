// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

#include "lockfree_ring/ring.hpp"

/// How the reader of many rings falls asleep, and how a new ring wakes the readers of its topic:
/// all steps in shared memory, in their order. The system calls are the caller's.
///
/// `Sources` is a container of structs that have a `reader`, one for each ring that is read, and a
/// `Turn`: while it lives they are alone with a ring of the mutex engine.
///
/// Edges
///   R5  a mark taken away (release) -> sleeper's look at the slot (acquire)
///       carries: the directory's new version, the writer word ORPHAN, or that messages have come
///       back.
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
[[gnu::hot]] bool settle(Sources& sources, RingBell&& ring_bell, Leave&& leave) {
  for (auto s = sources.begin(); s != sources.end();) {
    if (s->reader.sender_waits()) ring_bell(s->reader);
    if (!s->reader.orphaned()) {
      ++s;
      continue;
    }
    if (!s->reader.ended() || s->reader.has_returns()) return false;
    if (s->reader.is_unfinished()) {  // by others: it may come back
      ++s;
      continue;
    }
    leave(s->reader);
    s = sources.erase(s);
  }
  return true;
}

/// Leaves a mark in one ring, or says on its condition that somebody sleeps. False: there is
/// something to look at after all.
template <class Source, class SleepOn>
bool leave_mark(Source& source, SleepOn& sleep_on) {
  auto* arrived = source.reader.ring().arrived;
  if (arrived == nullptr) {
    const auto marked = source.reader.mark_sleeping();
    if (marked) sleep_on(source.reader.slot(), *marked);
    return marked.has_value();
  }
  const typename Source::Turn turn(source);
  const auto announced = source.reader.announce_sleeping();
  if (announced) sleep_on(*arrived, *announced);
  return announced.has_value();
}

/// Leaves marks in the rings, and calls sleep_on(word, value) for each word to sleep on. `version`
/// is the directory's when the sources were all rings of the topic.
///
/// Crash: the marks stay behind, and cost one needless wake each.
template <class Sources, class Directory, class SleepOn>
Rest lie_down(Sources& sources, const Directory& directory, std::uint32_t version,
              SleepOn&& sleep_on) {
  for (auto& source : sources) {
    if (!leave_mark(source, sleep_on)) return Rest::Look;
  }
  // What changed before the marks stood. Whoever changes it later takes the marks away, which
  // begins a new round of the slot, and wakes.
  bool any_live = false;
  for (auto& source : sources) {
    if (source.reader.is_closing() || source.reader.has_returns()) return Rest::Look;
    any_live = any_live || !source.reader.orphaned();
  }
  const std::uint32_t now = directory.load(std::memory_order_relaxed);  // R5 has acquired it
  // A new publisher wakes the readers of live rings (announce), and sleepers on the directory.
  if (now != version || !any_live) sleep_on(directory, now);
  return now == version ? Rest::Sleep : Rest::Doze;
}

/// The readers of a ring look again: wakes those who sleep there.
///
/// Crash: killed between a mark and its wake, it leaves a reader asleep without a mark.
template <class Ring, class Wake>
void wake_sleepers(Ring& ring, Wake&& wake) {
  if (ring.arrived != nullptr) {
    ring.clear_sleepers();
    wake(*ring.arrived);
    return;
  }
  for (std::uint32_t i = 0; i < ring.depth; ++i) {
    if (clear_sleeper(ring.slots[i])) wake(ring.slots[i]);
  }
}

/// Says that a ring has come, and wakes who may want to read it: who has nothing to read sleeps on
/// the directory's version, the others in the other rings of the topic.
///
/// Crash: as wake_sleepers(). The reaper wakes all sleepers of all rings.
template <class Directory, class Rings, class Wake>
void announce(Directory& directory, Rings&& rings, Wake&& wake) {
  // Relaxed: R5 carries it, and who finds it changed takes the registry's lock, which carries the
  // ring.
  directory.fetch_add(1, std::memory_order_relaxed);
  for (auto&& ring : rings) wake_sleepers(ring, wake);
  wake(directory);
}

/// What a sender sleeps on when its ring is full, the value of `space`; nothing when there is
/// room() after all.
template <class Writer, class Room>
std::optional<std::uint32_t> wait_for_room(Writer& writer, Room&& room) {
  const std::uint32_t value = writer.mark_waiting();
  if (room()) return std::nullopt;  // R6: made before the mark stood, so nobody rings
  return value;
}

}  // namespace lot::ring
