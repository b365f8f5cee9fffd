// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "tells.hpp"

namespace lot::replay {

/// What must be so, of what the workers have told. Each channel counts its messages from 1, so what
/// a reader has had of a channel is a number.
///
///   - A reader gets the next message of a channel, or a later one, and as many count as missed as
///     lie in between. At the end: a push that said Ok is neither delivered nor missed.
///   - An item goes to one taker, in the order of its putter. A taker that is killed in a take
///     takes one with it at most.
///   - No worker sleeps for room while there is room, and not all sleep while there is a
///     message for one of them.
///
/// Each member that takes a tell returns what the worker is answered; text() is then the first
/// thing that was wrong, or "".
class Books {
 public:
  using Arguments = std::array<std::uint64_t, 5>;
  long hear(unsigned worker, Tell what, const Arguments& with);
  void died(unsigned worker);
  /// All workers have read what was left for them.
  void drained();
  /// The worker, which may be waiting for room, sleeps on a word of the segment, at the moment at
  /// which it falls asleep or a reader tells of a message: that reader has made room before, and
  /// has woken it.
  void sleeps(unsigned worker);
  /// No thread of any worker runs, and none will before its time is over: is there a worker that
  /// should not sleep?
  void all_asleep();

  void wrong(const std::string& what) {
    if (text_.empty()) text_ = what;
  }
  const std::string& text() const { return text_; }
  std::uint64_t operations() const { return operations_; }
  std::uint64_t messages() const { return messages_; }

 private:
  struct Channel {
    unsigned worker;
    std::uint64_t topic;
    std::uint64_t depth;
    std::uint64_t begun = 0, done = 0;  ///< pushes
    bool is_pushing = false;
    bool was_killed = false;  ///< while it was pushing: one more may be there
  };
  struct Source {
    std::uint64_t last;   ///< the number of the last message that came
    std::uint64_t slack;  ///< of the gaps, so many may be from before the reader came
  };
  struct Reader {
    unsigned worker;
    std::uint64_t topic;
    std::map<std::uint64_t, std::pair<std::uint64_t, std::uint64_t>> at_begin{};  ///< done, begun
    std::set<std::uint64_t> at_end{};  ///< channels that may have come before the reader was there
    std::map<std::uint64_t, Source> sources{};
    std::uint64_t gaps = 0, slack = 0, missed = 0;
    bool is_there = false, waits = false, has_gone = false;
  };
  struct Putter {
    std::uint64_t begun = 0, done = 0;
    std::set<std::uint64_t> taken{};
  };

  void subscribe(unsigned worker, std::uint64_t topic);
  void subscribed(Reader& reader);
  void pushed(Channel& channel, std::uint64_t number, bool is_done);
  void got(std::uint64_t reader, std::uint64_t channel, std::uint64_t number, std::uint64_t missed);
  void got_none(Reader& reader, std::uint64_t missed);
  void look_at_gaps(const Reader& reader);
  void took(unsigned worker, std::uint64_t channel, std::uint64_t number);
  /// The first message that the reader may not lack, less one.
  std::uint64_t begins_behind(const Reader& reader, std::uint64_t channel) const;
  bool is_sure_of(const Reader& reader, std::uint64_t channel) const;
  bool has_room(std::uint64_t channel) const;
  std::string places_of(const Reader& reader) const;
  void look_for_items();

  std::vector<Channel> channels_;
  std::vector<Reader> readers_;
  std::map<std::uint64_t, Putter> putters_;
  std::map<std::pair<unsigned, std::uint64_t>, std::uint64_t> last_taken_;  ///< by worker, channel
  std::set<unsigned> taking_;  ///< workers that are about to take an item
  std::uint64_t lost_takes_ = 0;
  std::uint64_t operations_ = 0, messages_ = 0;
  std::string text_;
};

}  // namespace lot::replay
