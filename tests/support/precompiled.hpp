// SPDX-License-Identifier: Apache-2.0
#pragma once

// What nearly every test includes, read by the compiler once (tests/CMakeLists.txt). A test names
// what it uses all the same: the clang preset builds without this file.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include "lot/lot.hpp"

#include "support/processes.hpp"
