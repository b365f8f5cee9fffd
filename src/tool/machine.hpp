// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "segment/system_limits.hpp"
#include "tool/commands.hpp"
#include "tool/places.hpp"

/// What `lot doctor` sees of the machine, as plain values: so a test can make up any machine.
namespace lot::tool {

/// A system call that LOT uses if it can.
enum class Call {
  Works,
  Missing,  ///< the kernel is too old, or a sandbox says so
  Refused   ///< a sandbox, by EPERM
};

/// The file system of the directory, as /proc/self/mountinfo says it.
struct Mount {
  std::string point;
  std::string type;     ///< "tmpfs"; empty: not known
  std::string options;  ///< of the file system: "rw,size=65536k,huge=advise"
};

struct SegmentSeen {
  std::string name;
  std::string path;
  Sight::Condition condition = Sight::Condition::Sound;
  std::string reason;       ///< why it is not sound
  bool is_wanted = false;   ///< programs with this environment would join it
  std::uint64_t bytes = 0;  ///< of the file
  std::uint64_t taken = 0;  ///< that the file system has for it
  std::size_t living = 0;   ///< processes
  std::size_t dead = 0;
  std::size_t hidden = 0;  ///< the living that /proc does not show here
  bool has_items = false;  ///< that wait to be taken
};

struct Machine {
  // What the environment asks for.
  std::string directory;
  std::string segment;
  std::string bad_options;            ///< the error of a variable that has no meaning
  std::vector<std::string> misspelt;  ///< "LOT_SEGEMENT: LOT_SEGMENT"
  std::uint64_t wanted_bytes = 0;     ///< LOT_SIZE; 0: the default
  bool locks_memory = false;          ///< LOT_MLOCK

  // The directory.
  std::string directory_error;  ///< why it can not be used; empty: it can
  bool strangers_may_remove = false;
  Mount mount;
  std::uint64_t total_bytes = 0;
  std::uint64_t free_bytes = 0;

  // What is in it.
  std::vector<SegmentSeen> segments;
  std::vector<Places::Obstacle> obstacles;

  // Limits of a process; segment::kUnlimited: none.
  std::uint64_t file_bytes = segment::kUnlimited;
  std::uint64_t locked_bytes = segment::kUnlimited;
  std::uint64_t address_bytes = segment::kUnlimited;
  std::uint64_t open_files = segment::kUnlimited;
  std::uint64_t threads = segment::kUnlimited;
  std::uint64_t group_threads = segment::kUnlimited;  ///< that the control group may still begin
  std::uint64_t real_time_priority = 0;
  bool may_lock_memory = false;                     ///< CAP_IPC_LOCK
  bool may_be_real_time = false;                    ///< CAP_SYS_NICE
  std::uint64_t group_bytes = segment::kUnlimited;  ///< memory of the control group

  // The kernel.
  std::string release;
  Call futex_waitv = Call::Works;
  Call lock_pi2 = Call::Works;
  Call robust_list = Call::Works;
  Call membarrier = Call::Works;
  Call populate = Call::Works;  ///< MADV_POPULATE_WRITE
  Call fallocate = Call::Works;
  Call file_locks = Call::Works;  ///< of open file descriptions
  std::uint64_t page_bytes = 4096;
  std::string huge_pages;  ///< shmem_enabled: "advise"; empty: the kernel has none

  // Memory.
  std::uint64_t available_bytes = segment::kUnlimited;
  bool is_strict = false;  ///< vm.overcommit_memory is 2
  std::uint64_t commit_left = segment::kUnlimited;

  // Where this process is.
  bool has_proc = true;
  bool is_root = false;
  bool in_pid_namespace = false;
  bool logind_removes = false;  ///< the user's files in /dev/shm go when the last session ends
};

/// Looks at this machine. Reads files below `root`, which is "" but in tests, and asks the kernel.
/// Writes nothing.
Machine look_at_machine(const Settings& settings, const std::string& root = "");

/// The file system that `directory` (a real path) lies on.
Mount mount_of(const std::string& directory, const std::string& mountinfo);
/// Names of the environment that look like a variable of LOT: "LOT_SEGEMENT: LOT_SEGMENT".
std::vector<std::string> misspelt_of(const std::vector<std::string>& names);
/// True when logind removes the IPC objects of a user whose last session ends.
bool logind_removes_ipc(const std::string& root, unsigned user, const std::string& user_name);

}  // namespace lot::tool
