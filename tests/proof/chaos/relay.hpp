// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>

#include "lot/lot.hpp"

#include "inlet.hpp"
#include "job.hpp"
#include "outlet.hpp"

namespace lot::chaos {

/// Publishes what it receives on another topic: the same message, no copy.
template <class T>
class Relay final : public Job {
 public:
  Relay(Life& life, ShmEngine& engine, std::uint32_t from, std::uint32_t to)
      : life_(life), outlet_(life, engine, to), inlet_(life, engine, from, Role::Relay) {}

  void turn() override {
    inlet_.read(true, [this](const T& message, auto&& keep) { pass_on(message.stamp, keep()); });
    inlet_.rest();
  }
  void quiet() override { inlet_.quiet(); }
  bool settle() override { return inlet_.settle(); }

 private:
  void pass_on(const Stamp& stamp, const ShmSharedPtr<const T>& message) {
    if (life_.stage() > Stage::Awake) return;
    const Place place = outlet_.next();
    Relayed& r = life_.board.relayed_as(outlet_.topic(), stamp.serial);
    r.incarnation.store(place.incarnation);
    r.number.store(static_cast<std::uint32_t>(place.number));
    r.serial.store(stamp.serial, std::memory_order_release);
    if (outlet_.push(message) == Status::Ok) life_.count(Count::Relayed);
  }

  Life& life_;
  Outlet<T> outlet_;
  Inlet<T> inlet_;
};

/// Publishes what it saw in frames, by messages that refer to them.
class Annotator final : public Job {
 public:
  Annotator(Life& life, ShmEngine& engine, std::uint32_t from, std::uint32_t to)
      : life_(life), outlet_(life, engine, to), inlet_(life, engine, from, Role::Relay) {}

  void turn() override {
    inlet_.read(true, [this](const Frame&, auto&& keep) { annotate(keep()); });
    inlet_.rest();
  }
  void quiet() override {
    before_ = nullptr;
    inlet_.quiet();
  }
  bool settle() override { return inlet_.settle(); }

 private:
  void annotate(const ShmSharedPtr<const Frame>& frame) {
    if (life_.stage() > Stage::Awake) return;
    auto message = outlet_.loan();
    if (!message) return life_.no_memory("no block to loan");
    life_.doing(Doing::Filling, outlet_.topic());
    Stamp& stamp = message->stamp;
    stamp = {};
    stamp.serial = life_.new_serial();
    stamp.incarnation = outlet_.next().incarnation;
    stamp.number = outlet_.next().number;
    stamp.seal = stamp.sealed();
    message->now_seal = frame->stamp.seal;
    if (life_.has(Plant::Refer, 5)) message->now_seal ^= 1;
    message->before_seal = before_ ? before_->stamp.seal : 0;
    message->refs_seal = refs_seal(*message);
    try {
      message->now = frame;
      if (before_) message->before = before_;
    } catch (const OutOfMemory& e) {
      return life_.no_memory(e.what());
    }
    stamp.pushed_at = Life::now();
    outlet_.push(std::move(message));  // refused: this one is dropped
    before_ = frame;
  }

  Life& life_;
  Outlet<Seen> outlet_;
  Inlet<Frame> inlet_;
  ShmSharedPtr<const Frame> before_;
};

}  // namespace lot::chaos
