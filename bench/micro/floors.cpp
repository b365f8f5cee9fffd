// SPDX-License-Identifier: Apache-2.0
#include <ctime>
#include <iterator>
#include <linux/futex.h>
#include <memory>
#include <sys/syscall.h>
#include <unistd.h>

#include "micro.hpp"

namespace bench {
namespace {

void await(const Line& line, std::uint64_t n) {
  while (line.value.load(std::memory_order_acquire) != n) spin();
}

void await(std::atomic<std::uint32_t>& word, std::uint32_t n) {
  timespec until{};
  clock_gettime(CLOCK_MONOTONIC, &until);
  until.tv_sec += 10;
  for (;;) {
    const std::uint32_t seen = word.load(std::memory_order_acquire);
    if (seen == n) return;
    syscall(SYS_futex, &word, FUTEX_WAIT_BITSET, seen, &until, nullptr, FUTEX_BITSET_MATCH_ANY);
  }
}

void hand_over(std::atomic<std::uint32_t>& word, std::uint32_t n) {
  word.store(n, std::memory_order_release);
  syscall(SYS_futex, &word, FUTEX_WAKE, 1, nullptr, nullptr, 0);
}

}  // namespace

void serve_lines(Lines& all, std::uint64_t count) {
  Lines::Pair& lines = all.pairs[all.served++ % Lines::kPairs];
  const std::uint64_t from = lines.pong.value.load(std::memory_order_relaxed);
  for (std::uint64_t n = from + 1; n <= from + count; ++n) {
    await(lines.ping, n);
    lines.pong.value.store(n, std::memory_order_release);
  }
}

double cross_lines(Lines& all, std::uint64_t count) {
  Lines::Pair& lines = all.pairs[all.crossed++ % Lines::kPairs];
  const std::uint64_t from = lines.ping.value.load(std::memory_order_relaxed);
  return time_ns(2 * count, [&] {
    for (std::uint64_t n = from + 1; n <= from + count; ++n) {
      lines.ping.value.store(n, std::memory_order_release);
      await(lines.pong, n);
    }
  });
}

void serve_futexes(Futexes& futexes, std::uint64_t count) {
  const std::uint32_t from = futexes.pong.load(std::memory_order_relaxed);
  for (std::uint32_t n = from + 1; n != from + 1 + static_cast<std::uint32_t>(count); ++n) {
    await(futexes.ping, n);
    hand_over(futexes.pong, n);
  }
}

double cross_futexes(Futexes& futexes, std::uint64_t count) {
  const std::uint32_t from = futexes.ping.load(std::memory_order_relaxed);
  return time_ns(2 * count, [&] {
    for (std::uint32_t n = from + 1; n != from + 1 + static_cast<std::uint32_t>(count); ++n) {
      hand_over(futexes.ping, n);
      await(futexes.pong, n);
    }
  });
}

void BareQueue::send(std::uint64_t from, std::uint64_t count) {
  std::uint64_t head = head_.value.load(std::memory_order_acquire);
  const std::uint64_t tail = tail_.value.load(std::memory_order_relaxed);
  for (std::uint64_t i = 0; i < count; ++i) {
    while (tail + i - head >= kDepth) {
      spin();
      head = head_.value.load(std::memory_order_acquire);
    }
    slots_[(tail + i) % kDepth].fill(from + i);
    tail_.value.store(tail + i + 1, std::memory_order_release);
  }
}

void BareQueue::receive(std::uint64_t from, std::uint64_t count) {
  std::uint64_t tail = tail_.value.load(std::memory_order_acquire);
  const std::uint64_t head = head_.value.load(std::memory_order_relaxed);
  for (std::uint64_t i = 0; i < count; ++i) {
    while (tail == head + i) {
      spin();
      tail = tail_.value.load(std::memory_order_acquire);
    }
    expect(slots_[(head + i) % kDepth].is(from + i), "the bare queue lost a message");
    head_.value.store(head + i + 1, std::memory_order_release);
  }
}

void OneLineRing::send(std::uint64_t from, std::uint64_t count) {
  constexpr std::uint64_t kAhead = 2;  // the line is here when its turn comes
  for (std::uint64_t n = from; n < from + count; ++n) {
    while (n - seen_head_ >= kDepth) {
      spin();
      seen_head_ = head_.value.load(std::memory_order_acquire);
    }
    Slot& slot = slots_[n % kDepth];
    Message message;
    message.fill(n);
    for (std::size_t w = 0; w < std::size(message.words); ++w) {
      slot.words[w].store(message.words[w], std::memory_order_relaxed);
    }
    slot.word.exchange(n + 1, std::memory_order_seq_cst);
    if (n + kAhead - seen_head_ < kDepth) {
      lot::detail::HardwareAtomics::prefetch_write(&slots_[(n + kAhead) % kDepth]);
    }
  }
}

void OneLineRing::receive(std::uint64_t from, std::uint64_t count) {
  for (std::uint64_t n = from; n < from + count; ++n) {
    Slot& slot = slots_[n % kDepth];
    while (slot.word.load(std::memory_order_acquire) != n + 1) spin();
    Message message;
    for (std::size_t w = 0; w < std::size(message.words); ++w) {
      message.words[w] = slot.words[w].load(std::memory_order_relaxed);
    }
    std::atomic_thread_fence(std::memory_order_acquire);
    expect(slot.word.load(std::memory_order_relaxed) == n + 1 && message.is(n),
           "the one-line ring lost a message");
    head_.value.store(n + 1, std::memory_order_release);
  }
}

void serve_one_lines(OneLineTable& table, std::uint64_t count) {
  for (const std::uint64_t end = table.served + count; table.served != end; ++table.served) {
    table.ping.receive(table.served, 1);
    table.pong.send(table.served, 1);
  }
}

double cross_one_lines(OneLineTable& table, std::uint64_t count) {
  return time_ns(2 * count, [&] {
    for (const std::uint64_t end = table.crossed + count; table.crossed != end; ++table.crossed) {
      table.ping.send(table.crossed, 1);
      table.pong.receive(table.crossed, 1);
    }
  });
}

double exchange(std::uint64_t count) {
  Line line;
  return time_ns(count, [&] {
    for (std::uint64_t n = 0; n < count; ++n) {
      expect(line.value.exchange(n + 1, std::memory_order_seq_cst) == n, "exchange");
    }
  });
}

double make_shared(std::uint64_t count) {
  struct Bytes {
    std::uint8_t bytes[128];
  };
  return time_ns(count, [&] {
    for (std::uint64_t n = 0; n < count; ++n) {
      auto p = std::make_shared<Bytes>();
      benchmark::DoNotOptimize(p.get());
      p.reset();
    }
  });
}

}  // namespace bench
