// SPDX-License-Identifier: Apache-2.0
#include "sleepers.hpp"

#include <algorithm>
#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <fstream>
#include <linux/futex.h>
#include <string>
#include <utility>

#include "tracing.hpp"

namespace lot::replay {

void Process::read_mappings() {
  std::ifstream file("/proc/" + std::to_string(pid) + "/maps");
  for (std::string line; std::getline(file, line);) {
    Mapping m{};
    char access[5] = {};
    std::uint64_t inode = 0;
    if (std::sscanf(line.c_str(), "%" SCNx64 "-%" SCNx64 " %4s %" SCNx64 " %*s %" SCNu64, &m.begin,
                    &m.end, access, &m.offset, &inode) != 5) {
      continue;
    }
    m.file = access[3] == 's' ? inode : 0;
    mappings_.push_back(m);
  }
}

Place Process::place_of(std::uint64_t address) {
  if (mappings_.empty()) read_mappings();
  for (const Mapping& m : mappings_) {
    if (address < m.begin || address >= m.end || m.file == 0) continue;
    return {m.file, address - m.begin + m.offset};
  }
  // Of no shared file: the address says it, within this process.
  return {Place::kOwn | static_cast<std::uint64_t>(pid), address};
}

void Sleepers::sleep(Thread& thread, std::vector<Place> words, std::optional<std::uint64_t> until) {
  thread.sleeps = true;
  thread.naps = false;
  thread.words = std::move(words);
  thread.until = until;
  thread.since = turn_++;
}

void Sleepers::nap(Thread& thread, std::uint64_t until) {
  sleep(thread, {}, until);
  thread.naps = true;
}

void Sleepers::end(Thread& thread, long result) {
  thread.sleeps = false;
  answer(thread.id, result);
}

long Sleepers::wake(const std::vector<Thread*>& threads, const Place& word, std::uint64_t most) {
  long woken = 0;
  while (static_cast<std::uint64_t>(woken) < most) {
    Thread* first = nullptr;
    for (Thread* t : threads) {
      if (t->sleeps && (first == nullptr || t->since < first->since) &&
          std::find(t->words.begin(), t->words.end(), word) != t->words.end()) {
        first = t;
      }
    }
    if (first == nullptr) return woken;
    const auto at = std::find(first->words.begin(), first->words.end(), word);
    // futex_waitv says which word; the other calls sleep on one, and say 0.
    end(*first, at - first->words.begin());
    ++woken;
  }
  return woken;
}

void Sleepers::wake_late(const std::vector<Thread*>& threads, std::uint64_t now) {
  for (Thread* t : threads) {
    if (t->sleeps && t->until && *t->until <= now) end(*t, t->naps ? 0 : -ETIMEDOUT);
  }
}

std::optional<std::uint64_t> Sleepers::next(const std::vector<Thread*>& threads) {
  std::optional<std::uint64_t> soonest;
  for (const Thread* t : threads) {
    if (t->sleeps && t->until && (!soonest || *t->until < *soonest)) soonest = t->until;
  }
  return soonest;
}

std::vector<Place> words_of_the_dead(const Thread& thread) {
  std::vector<Place> words;
  if (thread.robust == 0) return words;
  robust_list_head head{};
  if (!read_memory(thread.id, thread.robust, &head, sizeof(head))) return words;
  const auto look_at = [&](const void* entry) {
    const std::uint64_t address = (reinterpret_cast<std::uint64_t>(entry) & ~std::uint64_t{1}) +
                                  static_cast<std::uint64_t>(head.futex_offset);
    const auto word = read_word<std::uint32_t>(thread.id, address);
    const bool is_its = (word & FUTEX_TID_MASK) == static_cast<std::uint32_t>(thread.id);
    if (is_its && (word & FUTEX_WAITERS) != 0) words.push_back(thread.process->place_of(address));
  };
  constexpr int kMost = 2048;  // ROBUST_LIST_LIMIT
  robust_list* entry = head.list.next;
  for (int n = 0; n < kMost && reinterpret_cast<std::uint64_t>(entry) != thread.robust; ++n) {
    look_at(entry);
    const auto at = reinterpret_cast<std::uint64_t>(entry) & ~std::uint64_t{1};
    entry = read_word<robust_list*>(thread.id, at);
    if (entry == nullptr) break;
  }
  if (head.list_op_pending != nullptr) look_at(head.list_op_pending);
  return words;
}

}  // namespace lot::replay
