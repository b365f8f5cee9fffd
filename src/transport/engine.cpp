// SPDX-License-Identifier: Apache-2.0
#include "lot/engine.hpp"

#include <cerrno>
#include <memory>
#include <string>
#include <utility>

#include "lot/error.hpp"

#include "registry/known_type.hpp"
#include "transport/participant.hpp"

namespace lot {

namespace {

/// How often subscribe_any() looks what a topic carries, while others change that.
constexpr unsigned kLooks = 100;

}  // namespace

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

ShmEngine::ShmEngine(const EngineOptions& options) : ShmEngine(detail::join(options)) {}

ShmEngine::ShmEngine(std::shared_ptr<transport::Participant> participant)
    : participant_(std::move(participant)), maker_(detail::make_maker(participant_)) {}

ShmEngine::~ShmEngine() = default;

AnyType ShmEngine::type_of(std::string_view topic) {
  participant_->check_usable();
  return AnyType(participant_->topics().type_of(topic));
}

AnyPuller ShmEngine::subscribe_any(std::string_view topic, const PullerOptions& options) {
  for (unsigned looks = 1;; ++looks) {
    const AnyType found = type_of(topic);
    if (!found) {
      throw Error(ENOENT, std::string(topic), "no process uses this topic",
                  "subscribe when a publisher or a subscriber is there");
    }
    const AnyType type = shared(found, topic);
    try {
      return {detail::make_puller(participant_, topic, type.known()->type(), options,
                                  detail::Delivery::ToAll),
              type};
    } catch (const Error& e) {
      // Others made the topic anew meanwhile, with another type.
      if (e.error_number() != EPROTOTYPE || looks == kLooks) throw;
    }
  }
}

AnyPuller ShmEngine::subscribe_any(std::string_view topic, const AnyType& type,
                                   const PullerOptions& options) {
  const AnyType mine = shared(type, topic);
  return {detail::make_puller(participant_, topic, mine.known()->type(), options,
                              detail::Delivery::ToAll),
          mine};
}

AnyPusher ShmEngine::advertise_any(std::string_view topic, const AnyType& type,
                                   const PusherOptions& options) {
  const AnyType mine = shared(type, topic);
  return {detail::make_pusher(participant_, topic, mine.known()->type(), options,
                              detail::Delivery::ToAll),
          mine, options.block_for};
}

AnyQueue ShmEngine::queue_any(std::string_view name, const AnyType& type,
                              const QueueOptions& options) {
  const AnyType item = shared(type, name);
  // The participant keeps the item's type, too, to its end.
  const auto its = participant_->topics().share(std::make_shared<const registry::KnownType>(
      detail::queue_type_name(item.name().c_str(), options.redeliver), *item.known()));
  return {
      detail::make_queue(participant_, name, its->type(), options,
                         options.redeliver ? detail::Delivery::ToWorker : detail::Delivery::ToOne),
      item};
}

AnyLoan ShmEngine::make_any(const AnyType& type) {
  const AnyType mine = shared(type, "message");
  const bool is_opaque = mine.description().root().kind == Kind::Opaque;
  return {maker_->loan(mine.known()->type(), true), mine, is_opaque};
}

AnyType ShmEngine::shared(const AnyType& type, std::string_view topic) {
  participant_->check_usable();
  if (!type) {
    throw Error(EINVAL, std::string(topic), "the topic is to carry no type",
                "take the type of a topic that is used (type_of), or of a message");
  }
  if (type.name().starts_with(detail::kQueueTypes)) {
    throw Error(EINVAL, std::string(topic), "this is a queue, not a topic (" + type.name() + ")",
                "use ShmEngine::queue(): an item is for the one process that takes it");
  }
  return AnyType(participant_->topics().share(type.known()));
}

const std::string& ShmEngine::path() const noexcept { return participant_->segment().path(); }

}  // namespace lot
