// SPDX-License-Identifier: Apache-2.0
#include <atomic>
#include <cstdint>
#include <cstring>
#include <string>

#include "micro.hpp"

/// Frames that one process writes and the other reads, each whole, in turn, beside the same through
/// bare buffers that protect nothing: one buffer, which stays in the cache, or as many as a queue
/// of that depth needs. All memory is warm. `faster` = bare / LOT: 0.85 means that LOT hands over
/// 85 of 100 frames.
namespace bench {
namespace {

constexpr std::uint64_t kFloor = 1;
constexpr std::uint64_t kArm = 2;
constexpr std::uint64_t kFrames = 12;  ///< of a block
constexpr std::uint64_t kMostBuffers = 5;
constexpr std::size_t kMostBytes = 16 << 20;

/// A turn passes from one side to the other by a line that both spin on.
struct Turns {
  Line written;
  Line read;
  alignas(kLine) std::uint8_t buffers[kMostBuffers][kMostBytes];
};

void await(const Line& line, std::uint64_t value) {
  while (line.value.load(std::memory_order_acquire) != value) spin();
}

// Floor and arm run the same instructions: where a copy of the loop lies may double its time.
[[gnu::noinline]] void write_frame(std::uint8_t* to, std::size_t bytes, std::uint64_t n) {
  std::memset(to, static_cast<int>(n % 251), bytes);
}

[[gnu::noinline]] void read_frame(const std::uint8_t* from, std::size_t bytes, std::uint64_t n) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < bytes; i += sizeof(sum)) {
    std::uint64_t word = 0;
    std::memcpy(&word, from + i, sizeof(word));
    sum += word & 0xff;
  }
  expect(sum == n % 251 * (bytes / sizeof(sum)), "the frame's bytes");
}

template <std::size_t kBytes>
struct Pixels {
  std::uint8_t bytes[kBytes];
};

struct Setting {
  std::uint32_t depth;
  std::uint64_t buffers;  ///< of the bare hand-over
  lot::Policy policy;
  std::uint32_t history = lot::PusherOptions::kAll;
};

lot::EngineOptions roomy() {
  lot::EngineOptions options = segment();
  options.size_bytes = 512 << 20;
  return options;
}

/// The reader's end. `n` counts the frames of both arms, so that no two follow with the same bytes.
template <std::size_t kBytes>
void read_all(Companion& here, Turns& turns, const Setting& setting) {
  lot::ShmEngine engine(roomy());
  auto in = engine.subscribe<Pixels<kBytes>>("/frames");
  here.meet();  // it may be published
  pin(1);
  std::uint64_t n = 0;
  for (std::uint64_t order; (order = here.hear()) != Companion::kStop; here.meet()) {
    for (std::uint64_t i = 0; i < kFrames; ++i) {
      ++n;
      if (order == kFloor) {
        await(turns.written, n);
        read_frame(turns.buffers[n % setting.buffers], kBytes, n);
      } else {
        const auto frame = in.borrow(10s);
        expect(static_cast<bool>(frame), "a frame was lost");
        read_frame(frame->bytes, kBytes, n);
      }
      turns.read.value.store(n, std::memory_order_release);
    }
  }
}

template <std::size_t kBytes>
void frames(benchmark::State& state, const Setting& setting) {
  if (!needs_two_cores(state)) return;
  const Shared<Turns> turns;
  Companion other([&](Companion& here) { read_all<kBytes>(here, *turns, setting); });
  lot::ShmEngine engine(roomy());
  lot::PusherOptions options;
  options.depth = setting.depth;
  options.policy = setting.policy;
  options.history = setting.history;
  auto out = engine.advertise<Pixels<kBytes>>("/frames", options);
  other.meet();
  expect(out.wait_for_readers(1, 10s), "a reader");
  pin(0);
  std::uint64_t n = 0;
  const auto block = [&](std::uint64_t order, auto&& publish) {
    other.tell(order);
    const double ns = time_ns(kFrames, [&] {
      for (std::uint64_t i = 0; i < kFrames; ++i) {
        publish(++n);
        await(turns->read, n);
      }
    });
    other.meet();
    return ns;
  };
  const auto arm_block = [&] {
    return block(kArm, [&](std::uint64_t number) {
      auto frame = out.loan();
      write_frame(frame->bytes, kBytes, number);
      expect(out.push(std::move(frame)) == lot::Status::Ok, "push");
    });
  };
  const auto floor_block = [&] {
    return block(kFloor, [&](std::uint64_t number) {
      write_frame(turns->buffers[number % setting.buffers], kBytes, number);
      turns->written.value.store(number, std::memory_order_release);
    });
  };
  arm_block();
  floor_block();
  Rounds rounds;
  for ([[maybe_unused]] auto _ : state) rounds.run(arm_block, floor_block);
  rounds.report_faster(state);
}

template <std::size_t kBytes>
bool enter(const char* size) {
  constexpr auto kOverwrite = lot::Policy::Overwrite;
  const struct {
    const char* name;
    Setting setting;
  } all[] = {{"overwrite/depth:1/bare:1", {1, 1, kOverwrite}},
             {"overwrite/depth:2/bare:1", {2, 1, kOverwrite}},
             {"overwrite/depth:4/bare:1", {4, 1, kOverwrite}},
             {"overwrite/depth:4/bare:5", {4, 5, kOverwrite}},
             {"overwrite/depth:4/history:0/bare:1", {4, 1, kOverwrite, 0}},
             {"overwrite/depth:4/history:1/bare:1", {4, 1, kOverwrite, 1}},
             {"block/depth:4/bare:1", {4, 1, lot::Policy::Block}},
             {"block/depth:4/history:0/bare:1", {4, 1, lot::Policy::Block, 0}}};
  for (const auto& one : all) {
    benchmark::RegisterBenchmark(
        (std::string("frames/") + size + '/' + one.name).c_str(),
        [setting = one.setting](benchmark::State& state) { frames<kBytes>(state, setting); });
  }
  return true;
}

[[maybe_unused]] const bool entered =
    enter<(4 << 20)>("4M") && enter<(8 << 20)>("8M") && enter<kMostBytes>("16M");

}  // namespace
}  // namespace bench
