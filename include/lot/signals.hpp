// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "lot/stop_token.hpp"

namespace lot {

/// A token that SIGINT, SIGTERM and SIGHUP stop: for programs that end by returning from main(), so
/// that destructors run and engines leave no file.
///
///     const lot::StopToken stop = lot::stop_on_signals();      // Ctrl-C
///     while (auto frame = puller.pull(stop)) show(*frame);
///
/// All calls return one token. A signal that is ignored, or has a handler of another library, is
/// left alone. A signal that comes five seconds after the first ends the process at once, for a
/// program that does not look at the token. System calls that wait end with EINTR in the thread
/// that gets the signal.
///
/// Threads: at any time.
/// Fork:    a child has a token of its own, and its parent's handlers: a signal to the child stops
///          the child's. One that is made after the signal has stopped already.
/// Errors:  std::bad_alloc.
/// Memory:  a word, which is never given back.
/// Crash:   as end_cleanly_on_signals().
[[nodiscard]] StopToken stop_on_signals();

/// SIGINT, SIGTERM and SIGHUP end the process as they would without this, and leave no file: the
/// last process of a segment removes it first. One line at the beginning of main(), for programs
/// that do not catch these signals themselves. A program that catches them, and then lets its
/// engines go, does not need it.
///
/// A signal that is ignored or has a handler is left alone. Removing takes some milliseconds, and
/// five seconds at most, when another process is stopped in the midst of opening or leaving;
/// another signal that comes meanwhile changes nothing, and behind it ends the process at once. No
/// destructor need run, and no buffer be written: a program that has to finish work uses
/// stop_on_signals(). A main() that returns meanwhile waits for the end, so that the exit code is
/// the signal's. It knows of one copy of the library: the segment of another one in the process (a
/// plugin) stays for the next one to come.
///
/// Threads: at any time; it starts one, which sleeps until a signal comes.
/// Fork:    in a child they act as by default, until it calls this itself.
/// Errors:  lot::Error (EAGAIN) when the system starts no thread for it. It may be called again.
/// Memory:  the stack of that thread.
/// Crash:   killed by SIGKILL, the last one leaves its files to the next one, as always.
void end_cleanly_on_signals();

}  // namespace lot
