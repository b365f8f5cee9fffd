// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <sys/types.h>

namespace lot::chaos {

/// Starts processes each in a PID, IPC and mount namespace of its own: each of them is process 1,
/// its second thread is thread 2, and so on.
///
/// The supervisor's parentage is direct: what it kills is the node itself. (unshare() makes the
/// next child the first of a new PID namespace; setns() to one's own takes that back. Not clone():
/// the child's C library would go on believing in its parent's thread id, which robust locks are
/// about.)
class Namespaces {
 public:
  /// Without namespaces (`wanted` false) it is an ordinary fork().
  explicit Namespaces(bool wanted) : wanted_(wanted) {}
  ~Namespaces();
  Namespaces(const Namespaces&) = delete;
  Namespaces& operator=(const Namespaces&) = delete;

  /// Sees that it can be done, if need be in a user namespace of our own; the caller then goes on
  /// in a child, and `status` is what its parent exits with. Returns why it cannot, or "".
  std::string enter();
  /// After enter() has failed: from now on fork() is an ordinary one.
  void do_without() { wanted_ = false; }
  /// As fork(). In the child `SIGKILL` comes when the supervisor dies.
  pid_t fork();

 private:
  std::string enter_user_namespace();

  bool wanted_;
  int own_ = -1;  ///< our PID namespace
};

}  // namespace lot::chaos
