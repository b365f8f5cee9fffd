// SPDX-License-Identifier: Apache-2.0
#include "record/writing.hpp"

#include <algorithm>
#include <cerrno>
#include <new>
#include <utility>

namespace lot::record {
namespace {

using namespace std::chrono_literals;
using Steady = std::chrono::steady_clock;
using Topic = RecorderStatus::Topic;

/// What a kill may cost, where chunks are not full before.
constexpr auto kFlush = 1s;
/// Parts of a message as large as this go to the file from where they lie.
constexpr std::uint64_t kLarge = 64 << 10;

std::uint64_t nanoseconds(Duration time) {
  return static_cast<std::uint64_t>(std::max<Duration::rep>(time.count(), 0));
}

}  // namespace

Writing::Writing(const RecorderOptions& options, Ledger& ledger, const Clock& clock,
                 Backlog& backlog)
    : options_(options),
      ledger_(ledger),
      clock_(clock),
      backlog_(backlog),
      files_(options, ledger, clock),
      past_(nanoseconds(options.keep_last), options.keep_last_bytes),
      encoded_(kLarge) {}

void Writing::begin() { keeps_past() ? files_.try_out() : files_.open(); }

void Writing::run() noexcept {
  while (!backlog_.is_over()) {
    auto entries = backlog_.take(kFlush);
    const bool is_idle = entries.empty();
    for (; !entries.empty(); entries.pop_front()) {
      take(entries.front());
      const std::uint64_t held = entries.front().held;
      entries.front() = Entry();  // it is let go before its place is free
      backlog_.done(held);
      flush_now_and_then();
    }
    if (is_idle) look(clock_.now());
    flush_now_and_then();
  }
  carefully([&] { files_.close(); });
}

template <class Step>
bool Writing::carefully(Step&& step) noexcept {
  try {
    try {
      step();
      return true;
    } catch (const Error& e) {
      ledger_.went_wrong(e.what());
      if (!failure_) failure_ = e;
    } catch (const std::exception& e) {
      ledger_.went_wrong(e.what());
      if (!failure_) failure_.emplace(0, options_.path, e.what(), "");
    }
  } catch (const std::bad_alloc&) {
    // There is not even memory to say so.
  }
  return false;
}

void Writing::flush_now_and_then() {
  const auto now = Steady::now();
  if (now - flushed_ < kFlush) return;
  flushed_ = now;
  carefully([&] { files_.flush(); });
}

void Writing::take(Entry& entry) {
  if (entry.stream == nullptr) return pull_trigger();
  std::vector<mcap::View> payload;
  try {
    if (entry.message) {
      encode(entry.stream->program, entry.message.root(), encoded_);
      for (const Bytes& piece : encoded_.pieces()) payload.emplace_back(piece.data(), piece.size());
    } else {
      payload.emplace_back(entry.bytes);
    }
  } catch (const std::exception& e) {
    carefully([&] { ledger_.went_wrong(e.what()); });
    ledger_.add(entry.stream->line, &Topic::damaged, 1);
    return;
  }
  write_or_keep(entry.stream, entry.head, payload);
}

void Writing::write_or_keep(const std::shared_ptr<const Stream>& stream,
                            const mcap::MessageHead& head, std::span<const mcap::View> payload) {
  if (!keeps_past()) return write(stream, head, payload);
  look(head.log_time);
  if (files_.is_open()) return write(stream, head, payload);
  const bool is_kept = carefully([&] {
    Past::Kept kept{stream, head, {}};
    kept.bytes.reserve(mcap::size_of(payload));
    for (const mcap::View piece : payload) {
      kept.bytes.insert(kept.bytes.end(), piece.begin(), piece.end());
    }
    past_.add(std::move(kept));
    ledger_.keeps(past_);
  });
  if (!is_kept) ledger_.add(stream->line, &Topic::lost, 1);
}

void Writing::write(const std::shared_ptr<const Stream>& stream, const mcap::MessageHead& head,
                    std::span<const mcap::View> payload) {
  carefully([&] { files_.write(*stream, head, payload); });
}

void Writing::pull_trigger() {
  if (!keeps_past()) return;
  ledger_.triggered();
  const std::uint64_t now = clock_.now();
  look(now);
  if (past_.is_empty() && options_.keep_after <= Duration()) return;    // there is nothing to write
  if (!files_.is_open() && !carefully([&] { files_.open(); })) return;  // the past stays
  for (const Past::Kept& kept : past_.take()) {
    const mcap::View piece(kept.bytes);
    write(kept.stream, kept.head, std::span(&piece, 1));
  }
  ledger_.keeps(past_);
  writes_until_ = now + nanoseconds(options_.keep_after);
  if (options_.keep_after <= Duration()) carefully([&] { files_.close(); });
}

void Writing::look(std::uint64_t now) {
  if (!keeps_past()) return;
  past_.look(now);
  ledger_.keeps(past_);
  if (files_.is_open() && now > writes_until_) carefully([&] { files_.close(); });
}

}  // namespace lot::record
