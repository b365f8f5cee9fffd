// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <optional>
#include <string_view>
#include <utility>

#include "lot/detail/selection.hpp"

#include "selection/replies.hpp"
#include "selection/selector.hpp"
#include "transport/participant.hpp"
#include "transport/ring_ends.hpp"

namespace lot::selection {
namespace {

using segment::Atomics;

static_assert(sizeof(Bounds<Atomics>) == segment::kExtraBytes);

class SelectingPusher final : public detail::SelectingPusher {
 public:
  SelectingPusher(std::shared_ptr<transport::Participant> participant, std::string_view topic,
                  const detail::MessageType& type, const PusherOptions& options)
      : participant_(std::move(participant)),
        core_(transport::make_ring_pusher(participant_, topic, type, options,
                                          detail::Delivery::ToAll, segment::kExtraBytes)),
        replies_(participant_->segment(), participant_->registry(), core_->topic()) {}

  detail::PusherCore& core() noexcept override { return *core_; }

  bool accepts(const detail::ControlBlock& control, const void* object) const override {
    return core_->accepts(control, object);
  }

  std::optional<detail::SelectedReader> select(std::string_view node, std::size_t back,
                                               std::optional<std::uint64_t> answer) override {
    participant_->check_usable();
    const auto ring = core_->hold();
    const auto participant = only_reader(ring.writer, node);
    if (!participant) return std::nullopt;
    const auto selected =
        Selector<Atomics>(ring.writer)
            .select(
                *participant, back, [&] { return is_called(*participant, node); }, answer);
    if (!selected) return std::nullopt;
    return detail::SelectedReader{selected->participant, selected->cell, selected->round};
  }

  void deselect(const detail::SelectedReader& reader, std::size_t back) override {
    const auto ring = core_->hold();
    Selector<Atomics>(ring.writer).deselect(named(reader), back);
  }

  bool is_read_by(std::string_view node) override {
    const auto ring = core_->hold();
    return only_reader(ring.writer, node).has_value();
  }

  bool expects(std::string_view node) override {
    for (std::uint32_t k = 0; k < participant_->world().participants(); ++k) {
      if (replies_.wants(k) && is_called(k, node)) return true;
    }
    return false;
  }

  bool wants(const detail::SelectedReader& reader) override {
    return replies_.wants(reader.participant) &&
           Selector<Atomics>::is_there(core_->ring(), named(reader));
  }

  bool has_confirmed(const detail::SelectedReader& reader) override {
    return replies_.has_confirmed(reader.participant);
  }
  void ask(const detail::SelectedReader& reader) override { replies_.ask(reader.participant); }

 private:
  static Selector<Atomics>::Selected named(const detail::SelectedReader& reader) {
    return {reader.participant, reader.cell, reader.round};
  }

  bool is_called(std::uint32_t k, std::string_view node) const {
    // Acquire: edge "state".
    return participant_->world().participant_state(k).load(std::memory_order_acquire) != 0 &&
           participant_->world().name_of(k) == node;
  }

  /// The only participant with this node name that reads the ring and wants it. With several of
  /// them, one is perhaps dead, and the answer is none.
  std::optional<std::uint32_t> only_reader(ring::Writer<Atomics>& writer, std::string_view node) {
    std::optional<std::uint32_t> reader;
    bool several = false;
    writer.each_reader([&](std::uint32_t k, std::uint32_t) {
      if (k >= participant_->world().participants() || !is_called(k, node)) return;
      several = reader.has_value();
      reader = k;
    });
    return reader && !several && replies_.wants(*reader) ? reader : std::nullopt;
  }

  const std::shared_ptr<transport::Participant> participant_;
  const std::unique_ptr<transport::RingPusher> core_;
  TopicReplies replies_;
};

}  // namespace
}  // namespace lot::selection

namespace lot::detail {

std::unique_ptr<SelectingPusher> make_selecting_pusher(
    std::shared_ptr<transport::Participant> participant, std::string_view topic,
    const MessageType& type, const PusherOptions& options) {
  return std::make_unique<selection::SelectingPusher>(std::move(participant), topic, type, options);
}

}  // namespace lot::detail
