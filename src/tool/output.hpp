// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string_view>

#include "lot/stop_token.hpp"

/// Standard output for verbs that go on: it may be slow, and its reader may go. REQUIRES: SIGPIPE
/// is ignored.
namespace lot::tool {

/// Writes all of it, and waits where nothing reads. False: it was told to stop meanwhile, or no
/// process reads any more. A text is written whole while its reader reads; a short one is written
/// whole or not at all. Throws lot::Error.
bool write_out(std::string_view text, const StopToken& stop);
/// True for a pipe that no process reads any more.
bool output_is_gone();

}  // namespace lot::tool
