// SPDX-License-Identifier: Apache-2.0
#include "subscription.hpp"

namespace lot::model {

void Subscription::join(Process& process) {
  process_ = &process;
  Segment& segment = process.segment();
  while (!process.lock_rings()) Policy::pause();
  segment.pullers[process.index()].fetch_add(1, std::memory_order_relaxed);
  version_ = segment.version.load(std::memory_order_acquire);
  for (std::uint32_t c = 0; c < process.channels(); ++c) {
    const Word writer = process.channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(writer) != ring::State::Live) continue;
    bool full = false;
    const auto reader =
        ring::Reader<Policy>::join(process.ring(c), ring::writer_generation(writer),
                                   process.index(), ring::Reader<Policy>::kFromTheStart, full);
    RL_ASSERT(!full);
    if (reader) begin(c, ring::writer_generation(writer), *reader);
  }
  process.unlock_rings();
}

void Subscription::end() {
  while (!process_->lock_rings()) Policy::pause();
  for (std::uint32_t c = 0; c < process_->channels(); ++c) {
    const Word writer = process_->channel_writer(c).load(std::memory_order_acquire);
    if (ring::writer_state(writer) < ring::State::Live) continue;
    ring::Ring<Policy> ring = process_->ring(c);
    if (ring.unsubscribe(process_->index())) ring.space->wake_all();
  }
  process_->segment().pullers[process_->index()].fetch_sub(1, std::memory_order_relaxed);
  process_->unlock_rings();
}

void Subscription::find_rings() {
  const std::uint32_t version = process_->segment().version.load(std::memory_order_acquire);
  for (std::uint32_t c = 0; c < process_->channels(); ++c) {
    const Word writer = process_->channel_writer(c).load(std::memory_order_acquire);
    const std::uint32_t generation = ring::writer_generation(writer);
    if (ring::writer_state(writer) < ring::State::Live ||
        std::any_of(sources_.begin(), sources_.end(), [&](const Source& s) {
          return s.channel == c && s.generation == generation;
        })) {
      continue;
    }
    const auto reader = ring::Reader<Policy>::take_awaited(process_->ring(c), process_->index());
    if (reader) begin(c, generation, *reader);
  }
  version_ = version;
}

void Subscription::begin(std::uint32_t channel, std::uint32_t generation,
                         const ring::Reader<Policy>& reader) {
  process_->move_in(channel, reader.cell());
  sources_.push_back({channel, generation, reader, process_});
}

bool Subscription::receive() {
  if (process_->segment().version.load(std::memory_order_acquire) != version_ &&
      process_->lock_rings()) {
    find_rings();
    process_->unlock_rings();
  }
  for (Source& source : sources_) {
    // Nobody is kept from the lock for nothing.
    if (source.reader.ring().arrived != nullptr && !source.reader.ready()) continue;
    const Source::Turn turn(source);
    Letter letter;
    Word b = source.reader.poll(missed_);
    while (!letter.copy(source.reader, b, missed_)) b = source.reader.poll(missed_);
    if (b == kNoBlock) continue;
    const std::int64_t number = ring::distance(source.reader.cursor(), Segment::kFirst);
    const std::uint64_t read = b == ring::kInSlot ? letter.read() : process_->read(b);
    RL_ASSERT(read == static_cast<std::uint64_t>(number));
    source.reader.done();
    ++received_;
    return true;
  }
  return false;
}

void Subscription::await_change() {
  const bool nothing = ring::settle(
      sources_, [](ring::Reader<Policy>&) {},
      [this](ring::Reader<Policy>& reader) {
        leave(reader);
        process_->collect();
      });
  if (nothing) sleep_on(sources_, process_->segment(), version_);
}

void Subscription::leave(ring::Reader<Policy>& reader) {
  for (std::uint32_t c = 0; c < process_->channels(); ++c) {
    if (reader.ring().writer == &process_->channel_writer(c)) process_->move_out(c, reader.cell());
  }
  reader.leave();
  reader.ring().space->wake_all();
}

}  // namespace lot::model
