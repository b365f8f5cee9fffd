// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <thread>
#include <utility>

#include "frame.hpp"
#include "process.hpp"

namespace demo {

/// Takes pictures at a steady rate and hands each to publish(number, last), which sends it.
///
/// Like a real camera it does not wait for long: when sending is more than `depth` pictures behind,
/// it skips pictures and counts them.
template <class Publish>
void film(const Settings& settings, Control& control, Publish&& publish) {
  const CpuTime cpu;
  std::uint32_t sent = 0;
  std::uint32_t skipped = 0;
  const auto begin = Clock::now();
  bool last = false;
  for (std::uint32_t picture = 0; !last; ++picture) {
    const auto due = begin + picture * settings.period();
    std::this_thread::sleep_until(due);
    last = control.stop() || (!settings.until_told && picture + 1 >= settings.frames);
    if (!last && Clock::now() - due > settings.depth * settings.period()) {
      ++skipped;
      continue;
    }
    publish(sent, last);
    if (++sent % settings.report_every == 0) say("at", {{"frames", sent}});
  }
  const std::chrono::duration<double> seconds = Clock::now() - begin;
  say("done",
      {{"sent", sent}, {"skipped", skipped}, {"cpu", cpu.seconds()}, {"seconds", seconds.count()}});
}

}  // namespace demo
