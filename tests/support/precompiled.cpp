// SPDX-License-Identifier: Apache-2.0

// CMake compiles support/precompiled.hpp for this file, and the tests use the result.
