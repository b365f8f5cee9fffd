// SPDX-License-Identifier: Apache-2.0
#include "waiting/hearing.hpp"

#include <algorithm>

namespace lot::waiting {

std::unique_ptr<Ear> Ear::claim(EarOwner& owner) {
  if (owner.has_lost_ears()) return nullptr;
  const auto index = owner.ear_segment().claim_ear(owner.ear_index());
  if (!index) return nullptr;
  try {
    return std::unique_ptr<Ear>(new Ear(owner, *index));
  } catch (...) {
    owner.ear_segment().free_ear(*index);
    throw;
  }
}

Ear::Ear(EarOwner& owner, std::uint32_t index)
    : owner_(owner),
      segment_(owner.ear_segment()),
      index_(index),
      shared_(segment_.ear(index)),
      first_(segment_.capacity().channels) {}

Ear::~Ear() {
  if (!owner_.has_lost_ears()) segment_.free_ear(index_);
}

void Ear::listen(Client& client, std::uint32_t channel) {
  Client*& first = first_[channel];
  if (first == nullptr) {
    first = &client;
  } else if (first != &client &&
             std::none_of(others_.begin(), others_.end(), [&](const Listener& other) {
               return other.channel == channel && other.client == &client;
             })) {
    others_.push_back({&client, channel});
  }
  segment_.listeners()[channel].add(index_);
}

bool Ear::watch_directory(Client& client, std::uint32_t version) {
  const bool is_first = watchers_.empty();
  if (!client.is_on_watch_) {
    watchers_.push_back({&client, version});
    client.is_on_watch_ = true;
    return is_first;
  }
  for (Watcher& watcher : watchers_) {
    if (watcher.client == &client) watcher.version = version;
  }
  return false;
}

void Ear::forget(Client& client) noexcept {
  std::erase_if(others_, [&](const Listener& other) { return other.client == &client; });
  std::replace(first_.begin(), first_.end(), &client, static_cast<Client*>(nullptr));
  for (const Listener& other : others_) {  // one of them may have been behind it
    if (first_[other.channel] == nullptr) first_[other.channel] = other.client;
  }
  std::erase_if(others_,
                [this](const Listener& other) { return first_[other.channel] == other.client; });
  if (!client.is_on_watch_) return;
  std::erase_if(watchers_, [&](const Watcher& watcher) { return watcher.client == &client; });
  client.is_on_watch_ = false;
}

void Ear::prepare_to_sleep(detail::FutexWaits& waits) {
  if (owner_.has_lost_ears()) return;
  sleeps_ = true;
  waits.push_back({&shared_.words->bell.word(), shared_.words->bell.sleep(rung_)});
  if (!watchers_.empty()) waits.push_back({&segment_.directory().version.word(), version_});
}

}  // namespace lot::waiting
