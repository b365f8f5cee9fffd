// SPDX-License-Identifier: Apache-2.0

// The main() of every test: doctest's own. It is compiled once and linked into all of them.
#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>
