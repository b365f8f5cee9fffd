// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "lot/detail/selection.hpp"

#include "selection/replies.hpp"
#include "selection/selector.hpp"
#include "transport/participant.hpp"
#include "transport/ring_ends.hpp"

namespace lot::selection {
namespace {

using segment::Atomics;
using transport::Source;

/// True when the ring's publisher selects its readers. One that does not says nothing.
bool selects(const segment::Ring& ring) { return ring.extra != nullptr; }
bool selects(const Source& source) { return selects(source.reader.ring()); }

bool is_of(const registry::ChannelName& name, const detail::Origin& origin) {
  return name.channel == origin.channel && name.generation == origin.generation;
}
detail::Origin ring_of(const Source& source) {
  return {source.name.channel, source.name.generation, 0};
}

class SelectingPuller final : public detail::SelectingPuller, private transport::RingWatcher {
 public:
  SelectingPuller(std::shared_ptr<transport::Participant> participant, std::string_view topic,
                  const detail::MessageType& type, const PullerOptions& options)
      : participant_(std::move(participant)),
        core_(transport::make_ring_puller(participant_, topic, type, options,
                                          detail::Delivery::ToAll, this)) {}

  detail::PullerCore& core() noexcept override { return *core_; }

  detail::Origin origin() override { return core_->origin(); }

  std::optional<bool> is_ours(const detail::Origin& origin) override {
    if (const Source* const s = source_of(origin)) {
      if (!selects(*s)) return std::nullopt;
      return selection_of(s->name).is_ours(s->reader, origin.sequence);
    }
    const Left* const left = left_of(origin);
    return left != nullptr && lies_between(origin.sequence, left->said.from, left->said.to) == true;
  }

  std::string_view publisher(const detail::Origin& origin) override {
    if (const Source* const s = source_of(origin)) return s->publisher;
    const Left* const left = left_of(origin);
    return left != nullptr ? std::string_view(left->publisher) : std::string_view();
  }

  std::size_t depth(const detail::Origin& origin) override {
    const Source* const s = source_of(origin);
    return s != nullptr ? s->reader.ring().depth : 0;
  }

  bool has_publisher(std::string_view publisher) override {
    const auto sources = core_->sources();
    return std::any_of(sources.begin(), sources.end(),
                       [&](const Source& s) { return s.publisher == publisher; });
  }

  std::vector<detail::Origin> rings_of(std::string_view publisher) override {
    std::vector<detail::Origin> rings;
    for (const Source& s : core_->sources()) {
      if (s.publisher == publisher) rings.push_back(ring_of(s));
    }
    return rings;
  }

  bool has_remaining(std::string_view publisher) override {
    const auto sources = core_->sources();
    return std::any_of(sources.begin(), sources.end(), [&](const Source& s) {
      return s.publisher == publisher && selects(s) && Selection<Atomics>::has_remaining(s.reader);
    });
  }

  std::size_t resent(std::string_view publisher) override {
    std::size_t n = 0;
    for (const Source& s : core_->sources()) {
      if (s.publisher == publisher && selects(s)) n += selection_of(s.name).resent(s.reader);
    }
    for (Left& l : left_) {
      if (l.publisher == publisher) n += std::exchange(l.resent, 0);
    }
    return n;
  }

  std::vector<detail::Origin> join_anew(std::string_view publisher, std::uint64_t answer) override {
    std::vector<detail::Origin> joined;
    answer_ = answer;
    for (const Source& s : core_->sources()) {
      // Skips a ring whose publisher has selected this reader already, and one that has ended:
      // neither needs a new round.
      if (s.publisher != publisher || !selects(s) || s.reader.orphaned() ||
          Selection<Atomics>::is_selected(s.reader) || !core_->join_anew(s.name)) {
        continue;
      }
      joined.push_back(ring_of(s));
      selection_of(s.name) = {};
    }
    answer_ = 0;
    return joined;
  }

  void decline() override { replies(core_->topic()).decline(participant_->index()); }
  void confirm() override { replies(core_->topic()).confirm(participant_->index()); }

 private:
  /// What this reader knows of a ring that it reads.
  struct Known {
    registry::ChannelName name;
    Selection<Atomics> selection{};
  };
  /// A ring that has ended, and which of its messages were for this reader.
  struct Left {
    registry::ChannelName name;
    Selection<Atomics>::Said said;
    std::string publisher;
    std::size_t resent;
  };
  static constexpr std::size_t kLeft = 64;

  // Called while core_ is made, too.
  void announcing(std::uint32_t topic) noexcept override {
    replies(topic).begin(participant_->index());
  }
  void joining(const segment::Ring& ring, std::uint32_t cell) noexcept override {
    if (selects(ring)) begin_round(ring, cell, answer_);
  }
  /// Keeps what is_ours() needs for messages that the caller has kept.
  void leaving(const Source& source) override {
    if (!selects(source)) return;
    Selection<Atomics>& selection = selection_of(source.name);
    if (left_.size() == kLeft) left_.erase(left_.begin());
    left_.push_back({source.name, Selection<Atomics>::said_to(source.reader), source.publisher,
                     selection.resent(source.reader)});
    std::erase_if(known_, [&](const Known& k) { return k.name == source.name; });
  }

  TopicReplies replies(std::uint32_t topic) const {
    return {participant_->segment(), participant_->registry(), topic};
  }

  const Source* source_of(const detail::Origin& origin) const {
    for (const Source& s : core_->sources()) {
      if (is_of(s.name, origin)) return &s;
    }
    return nullptr;
  }
  const Left* left_of(const detail::Origin& origin) const {
    for (const Left& l : left_) {
      if (is_of(l.name, origin)) return &l;
    }
    return nullptr;
  }
  Selection<Atomics>& selection_of(const registry::ChannelName& name) {
    for (Known& k : known_) {
      if (k.name == name) return k.selection;
    }
    return known_.emplace_back(Known{name}).selection;
  }

  const std::shared_ptr<transport::Participant> participant_;
  std::vector<Known> known_;
  std::vector<Left> left_;                             ///< the last few rings that have ended
  std::uint64_t answer_ = 0;                           ///< with which it joins rings now
  const std::unique_ptr<transport::RingPuller> core_;  ///< goes first: it tells the rest
};

}  // namespace
}  // namespace lot::selection

namespace lot::detail {

std::unique_ptr<SelectingPuller> make_selecting_puller(
    std::shared_ptr<transport::Participant> participant, std::string_view topic,
    const MessageType& type, const PullerOptions& options) {
  return std::make_unique<selection::SelectingPuller>(std::move(participant), topic, type, options);
}

}  // namespace lot::detail
