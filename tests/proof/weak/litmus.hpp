// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace lot::weak {

/// Runs each litmus test to its end: what C++20 allows must be seen, and nothing that it forbids.
/// `stops`: the first one that is wrong is the last one. How many are wrong.
unsigned run_litmus_tests(bool stops);

}  // namespace lot::weak
