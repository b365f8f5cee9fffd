// SPDX-License-Identifier: Apache-2.0
/// A puller in a GLib main loop, as GTK and GStreamer programs have it, by its descriptor.
#include <glib-unix.h>

#include "numbers.hpp"

namespace {

constexpr std::uint64_t kNumbers = 300;

gboolean readable(gint, GIOCondition, gpointer count) {
  static_cast<example::Count*>(count)->pull_all();
  return G_SOURCE_CONTINUE;
}
gboolean tick(gpointer) { return G_SOURCE_CONTINUE; }  // a look at Ctrl-C now and then

}  // namespace

int main() {
  return example::run("glib", [] {
    const pid_t child =
        example::start("numbers", [] { return example::publish_numbers(kNumbers); });
    lot::ShmEngine engine;
    auto puller = engine.subscribe<example::Number>("/numbers");
    example::Count count(puller);
    const guint messages = g_unix_fd_add(puller.fd(), G_IO_IN, &readable, &count);
    const guint ticks = g_timeout_add(100, &tick, nullptr);
    while (!count.reached(kNumbers)) g_main_context_iteration(nullptr, TRUE);
    g_source_remove(messages);
    g_source_remove(ticks);
    std::printf("%ju numbers by GLib\n", static_cast<std::uintmax_t>(count.value()));
    return example::finish(child) && count.good() && count.value() == kNumbers;
  });
}
