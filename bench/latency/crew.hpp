// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <sys/types.h>
#include <vector>

#include "board.hpp"
#include "plan.hpp"

/// The processes of one arm: who starts them, where, and how they end.
namespace ab {

enum class Place {
  Host,
  Container,  ///< all nodes of an arm in one, apart from the host
  Containers  ///< each node in one of its own
};

/// The parent of a group of nodes: forks them and waits. Returns the exit status of its process.
int run_group(int board, unsigned arm, unsigned group);

/// Starts the groups of an arm, connects their networks, and kills whoever is left when it goes; so
/// do the groups themselves when this process dies.
///
/// A container has PID, mount, IPC, UTS and network namespaces of its own (bubblewrap); it sees the
/// system read-only, and of what can be written only `directory`, as its /dev/shm.
class Crew {
 public:
  Crew(const Board& board, const Plan& plan, unsigned arm, Place place,
       const std::string& directory);
  ~Crew();
  Crew(const Crew&) = delete;
  Crew& operator=(const Crew&) = delete;

  /// Why one of them has ended, or empty: all live.
  std::string ended();
  /// Waits for all of them; after a while they are killed.
  void join();

  /// Empty when containers can be had here; else why not. The first call tries it.
  static std::string unavailable(Place place, bool network);
  /// Of the two ends of a link, the publisher's address as the subscriber sees it; or, when
  /// messages go back over it, the subscriber's as the publisher sees it.
  static std::string address(Place place, unsigned publisher, unsigned subscriber,
                             bool back = false);

 private:
  struct Member {
    pid_t pid = -1;     ///< of what was started; its own process group
    pid_t inside = -1;  ///< in a container: its first process, seen from here
  };
  void start(unsigned group, Place place, const std::string& directory);
  void connect(const Plan& plan);
  void kill_all();

  const Board& board_;
  unsigned arm_;
  std::vector<Member> members_;
};

/// Runs a command to its end; throws with its name when it fails.
void must_run(const std::vector<std::string>& command);

}  // namespace ab
