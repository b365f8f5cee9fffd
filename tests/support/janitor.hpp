// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::testing {

/// Starts a process that removes this test's files from /dev/shm when the test is killed (by its
/// watchdog, by Ctrl-C). A test that comes to its end has removed them itself. To be called before
/// there are threads.
bool start_janitor();

}  // namespace lot::testing
