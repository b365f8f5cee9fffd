// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

#include <doctest/doctest.h>

#include <lot/engine.hpp>

#include "support/processes.hpp"

namespace lot::testing {

inline constexpr QueueEngine kEngines[] = {QueueEngine::Ring, QueueEngine::Mutex};

/// A fixture of tests that hold for both queue engines, and leave nothing in their segment.
struct BothEngines {
  const Watchdog watchdog{100};
  const EngineOptions options = fresh();
  const int both = unsetenv("LOT_QUEUE");  // it would come before what a test says

  template <class Test>
  void with_each_engine(Test&& test) {
    for (const QueueEngine engine : kEngines) {
      CAPTURE(static_cast<int>(engine));
      ShmEngine keeper(options);  // so that the segment is there to be looked at
      test(engine);
      CHECK(leak_in(keeper.path()) == "");
    }
  }
};

}  // namespace lot::testing
