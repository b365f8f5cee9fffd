// SPDX-License-Identifier: Apache-2.0
#include "lot/engine.hpp"

#include "transport/participant.hpp"

namespace lot {

namespace detail {

std::shared_ptr<transport::Participant> join(const EngineOptions& options) {
  return transport::Participant::join(options);
}

static_assert(sizeof(segment::ParticipantEntry::name) == kProcessNameBytes);
static_assert(segment::kTopicNameBytes == kTopicNameBytes);
void rename(transport::Participant& participant, std::string_view name) noexcept {
  participant.membership().rename(name);
}

}  // namespace detail

ShmEngine::ShmEngine(const EngineOptions& options)
    : participant_(detail::join(options)), maker_(detail::make_maker(participant_)) {}

ShmEngine::~ShmEngine() = default;

const std::string& ShmEngine::path() const noexcept { return participant_->segment().path(); }

}  // namespace lot
