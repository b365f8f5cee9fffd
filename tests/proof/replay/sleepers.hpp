// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <sys/types.h>
#include <vector>

/// Threads that sleep in a system call, and what they sleep on: the conductor's part of futex(2).
namespace lot::replay {

/// A word of memory, by whichever address a process sees it.
struct Place {
  /// Marks what is in no shared file.
  static constexpr std::uint64_t kOwn = std::uint64_t{1} << 63;

  std::uint64_t file;    ///< a shared file, or a process's own memory
  std::uint64_t offset;  ///< in the file, or the address
  bool operator==(const Place& other) const = default;
  bool is_shared() const { return (file & kOwn) == 0; }
};

/// A worker, as long as it lives.
struct Process {
  Process(pid_t id, unsigned number, unsigned which) : pid(id), worker(number), life(which) {}

  pid_t pid;
  unsigned worker;
  unsigned life;
  bool is_at_work = false;  ///< it has told something: it is in its main function

  /// Where the word at this address is. Looks into /proc after each change of the mappings.
  Place place_of(std::uint64_t address);
  void forget_mappings() { mappings_.clear(); }

 private:
  struct Mapping {
    std::uint64_t begin, end, offset, file;
  };
  void read_mappings();
  std::vector<Mapping> mappings_{};
};

struct Thread {
  pid_t id;
  unsigned number;  ///< in the order of their coming, over the whole run
  Process* process;
  std::uint64_t at_end = 0;  ///< address of the word that the kernel clears when the thread ends
  std::uint64_t robust = 0;  ///< its robust list

  bool sleeps = false;
  bool naps = false;  ///< it sleeps for a time, whatever happens
  std::vector<Place> words{};
  std::optional<std::uint64_t> until{};  ///< ns of the virtual clock
  std::uint64_t since = 0;               ///< its turn among the sleepers
};

/// Every sleeper of the run. Wakes come in the order of falling asleep.
class Sleepers {
 public:
  void sleep(Thread& thread, std::vector<Place> words, std::optional<std::uint64_t> until);
  void nap(Thread& thread, std::uint64_t until);
  /// Wakes that many sleepers of the word at most. Returns how many.
  long wake(const std::vector<Thread*>& threads, const Place& word, std::uint64_t most);
  /// Wakes those whose time is over.
  void wake_late(const std::vector<Thread*>& threads, std::uint64_t now);
  /// When the next one wakes by itself.
  static std::optional<std::uint64_t> next(const std::vector<Thread*>& threads);

 private:
  static void end(Thread& thread, long result);
  std::uint64_t turn_ = 0;
};

/// The words that the kernel marks when the thread dies, and of which it wakes one sleeper.
std::vector<Place> words_of_the_dead(const Thread& thread);

}  // namespace lot::replay
