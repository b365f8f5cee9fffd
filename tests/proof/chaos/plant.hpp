// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>

#include "findings.hpp"

namespace lot::chaos {

/// Mistakes that are made on purpose, to see that the checks can fail.
enum class Plant : std::uint8_t {
  None,
  Tear,
  Smear,
  Refer,
  Weak,
  Trust,
  Skip,
  Miss,
  Overlook,
  More,
  Ghost,
  Overrun,
  Deaf,
  Twice,
  TakeTwice,
  Drop,
  Spill,
  Forget,
  Share,
  Recount,
  Leak,
  LeakAtEnd,
  Hoard,
  Greed,
  Cling,
  Keep,
  Spoil,
  Blind,
  File,
  Wedge,
  Doze,
  Stay,
  Crash
};

struct Mistake {
  Plant plant;
  const char* name;
  Finding expected;  ///< what it must be found as
  const char* says;
};

inline constexpr std::array<Mistake, 32> kMistakes{{
    {Plant::Tear, "tear", Finding::Torn, "a publisher writes into what it pushes just now"},
    {Plant::Smear, "smear", Finding::Torn, "a publisher writes into what it has pushed before"},
    {Plant::Refer, "refer", Finding::Torn, "a message refers to another one than it says"},
    {Plant::Weak, "weak", Finding::Torn, "a weak pointer leads to another message"},
    {Plant::Trust, "trust", Finding::Torn, "a reader copies a slot, and does not look again"},
    {Plant::Skip, "skip", Finding::Lost, "a publisher leaves a number out"},
    {Plant::Miss, "miss", Finding::Lost, "a reader is told of too few that it missed"},
    {Plant::Overlook, "overlook", Finding::Lost, "an observer is not told what it missed"},
    {Plant::Blind, "blind", Finding::Lost,
     "an observer is not told that its topic has another type"},
    {Plant::More, "more", Finding::Lost, "a reader is told of too many that it missed"},
    {Plant::Ghost, "ghost", Finding::Lost, "a message is published that no look finds"},
    {Plant::Overrun, "overrun", Finding::Lost, "a publisher says Block and overwrites"},
    {Plant::Deaf, "deaf", Finding::Lost, "a reader never hears of publishers that come later"},
    {Plant::Twice, "twice", Finding::Twice, "a publisher uses a number again"},
    {Plant::TakeTwice, "take-twice", Finding::Twice, "an item is handed to a second taker"},
    {Plant::Drop, "drop", Finding::Lost, "an item is dropped before it reaches its taker"},
    {Plant::Spill, "spill", Finding::Lost, "a putter says Block and overwrites items"},
    {Plant::Forget, "forget", Finding::Lost, "a task is gone before its worker has done it"},
    {Plant::Share, "share", Finding::Twice, "a worker gives a task back and works on"},
    {Plant::Recount, "recount", Finding::Twice, "a worker is told of too few deliveries"},
    {Plant::Leak, "leak", Finding::Leaked, "a block is held by nobody, while others live"},
    {Plant::LeakAtEnd, "leak-at-end", Finding::Leaked,
     "a block is held by nobody, after all ended"},
    {Plant::Hoard, "hoard", Finding::Leaked, "a publisher has more blocks than it can need"},
    {Plant::Greed, "greed", Finding::Leaked, "a reader keeps more than it may"},
    {Plant::Cling, "cling", Finding::Leaked, "a topic is kept for an observer"},
    {Plant::Keep, "keep", Finding::Leaked, "a topic that no process uses keeps its type"},
    {Plant::Spoil, "spoil", Finding::Leaked, "the description of a topic is written"},
    {Plant::File, "file", Finding::Files, "a file of the segment stays"},
    {Plant::Wedge, "wedge", Finding::Wedged, "a node stops making progress"},
    {Plant::Doze, "doze", Finding::Wedged, "a reader sleeps on when a message comes"},
    {Plant::Stay, "stay", Finding::Wedged, "a node does not leave when it is told to"},
    {Plant::Crash, "crash", Finding::Crashed, "a node ends by itself"},
}};

}  // namespace lot::chaos
