// SPDX-License-Identifier: Apache-2.0
#include "board.hpp"

#include <algorithm>
#include <cstring>
#include <new>
#include <sys/mman.h>
#include <system_error>

namespace lot::chaos {

Board& Board::make() {
  void* memory = mmap(nullptr, sizeof(Board), PROT_READ | PROT_WRITE,
                      MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED) throw std::system_error(errno, std::generic_category(), "mmap");
  // Default-initialised: fresh pages are zero already, and most of them are never touched.
  auto* board = static_cast<Board*>(memory);
  board->incarnations_begun = 1;
  return *board;
}

bool Doubt::lasts(std::chrono::nanoseconds most) {
  constexpr std::uint32_t kLooks = 20;
  const std::int64_t now =
      std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
  std::int64_t begun = 0;
  if (since.compare_exchange_strong(begun, now)) begun = now;
  return looks.fetch_add(1) >= kLooks && now - begun > most.count();
}

void Board::report(Finding finding, std::uint32_t slot, std::string_view text) {
  found[static_cast<std::size_t>(finding)].fetch_add(1);
  const std::uint32_t n = reports_begun.fetch_add(1);
  if (n >= kReports) return;
  Report& r = reports[n];
  r.finding = finding;
  r.slot = slot;
  r.life = slot < kMostNodes ? nodes[slot].life.load() : 0;
  std::memcpy(r.text.data(), text.data(), std::min(text.size(), r.text.size() - 1));
  r.written.store(1, std::memory_order_release);
}

void Board::forget_publishers() {
  for (auto& n : newest) n.store(0);
  for (Doubt& doubt : refused) doubt.forget();
  // Zeroes again.
  if (madvise(items.data(), sizeof(items), MADV_REMOVE) == -1) {
    throw std::system_error(errno, std::generic_category(), "madvise");
  }
  putters_begun.store(0);
}

std::uint64_t Board::total(Count count) const {
  std::uint64_t sum = 0;
  for (const NodeRecord& node : nodes) sum += node.counts[static_cast<std::size_t>(count)].load();
  return sum;
}

std::uint32_t Board::findings() const {
  std::uint32_t sum = 0;
  for (const auto& n : found) sum += n.load();
  return sum;
}

}  // namespace lot::chaos
