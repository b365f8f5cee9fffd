// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "lot/options.hpp"

#include "liveness/lock_file.hpp"
#include "segment/trust.hpp"

namespace lot::transport {

/// How long opening, leaving and ending wait for another process that does the same.
inline constexpr std::chrono::seconds kGatePatience{5};

/// What a joiner does where there is no segment.
enum class IfAbsent { Make, Throw };

/// Called in the gate, in the joiner's turn, when the segment is there and fits.
using Admit = std::function<void(const std::shared_ptr<liveness::LockFile>&)>;

/// Goes through the gate to the segment at `path`, which is made, made anew or found to be right,
/// and calls admit() before it leaves the gate. Throws lot::Error, and what admit() throws: then a
/// segment that this call has made is gone again.
///
/// Threads: any; two threads of a process that want the same segment take turns by themselves.
/// Crash:   a segment is absent or complete (segment::Segment). The kernel drops the gate's lock.
void pass_gate(const EngineOptions& options, const std::string& path, const segment::Trust& trust,
               IfAbsent if_absent, const Admit& admit);

/// Throws: the segment is in use and lets fewer users in than was asked for (*narrow*).
[[noreturn]] void refuse_narrow(const std::string& path, const std::string& reason);

/// Throws: the segment is in use, and is not the one that was asked for.
[[noreturn]] void refuse_stale(const std::string& path, const std::string& reason);

/// Throws: there is no memory for what a process needs to join.
[[noreturn, gnu::cold]] void refuse_without_memory(const std::string& path);

}  // namespace lot::transport
