// SPDX-License-Identifier: Apache-2.0
#include "lot/engine.hpp"

#include <memory>
#include <utility>

#include "lot/signals.hpp"

#include "c_interface/errors.hpp"
#include "c_interface/handles.hpp"

namespace lot::c_interface {
namespace {

template <class T>
void take_if_set(T& option, const T& given) {
  if (given != T()) option = given;
}
void take_if_set(std::string& option, const char* given) {
  if (given != nullptr) option = given;
}

EngineOptions options_of(const lot_engine_options* given) {
  EngineOptions options;
  if (given == nullptr) return options;
  take_if_set(options.segment, given->segment);
  take_if_set(options.directory, given->directory);
  take_if_set(options.size_bytes, given->size_bytes);
  take_if_set(options.permissions, given->permissions);
  take_if_set(options.group, given->group);
  take_if_set(options.user, given->user);
  options.persist = given->persist;
  options.lock_memory = given->lock_memory;
  take_if_set(options.name, given->name);
  take_if_set(options.processes, given->processes);
  take_if_set(options.blocks, given->blocks);
  take_if_set(options.topics, given->topics);
  take_if_set(options.channels, given->channels);
  take_if_set(options.readers, given->readers);
  return options;
}

}  // namespace
}  // namespace lot::c_interface

using lot::c_interface::guarded;
using lot::c_interface::require;

extern "C" {

int lot_engine_open(const lot_engine_options* options, lot_engine** engine) {
  return guarded([&] {
    require(engine, "engine");
    *engine = new lot_engine{lot::ShmEngine(lot::c_interface::options_of(options))};
    return LOT_OK;
  });
}

void lot_engine_close(lot_engine* engine) { delete engine; }

const char* lot_engine_path(const lot_engine* engine) { return engine->engine.path().c_str(); }

int lot_stop_new(lot_stop** stop) {
  return guarded([&] {
    require(stop, "stop");
    lot::StopSource source;
    auto token = source.get_token();
    *stop = new lot_stop{std::move(source), std::move(token)};
    return LOT_OK;
  });
}

int lot_stop_on_signals(lot_stop** stop) {
  return guarded([&] {
    require(stop, "stop");
    *stop = new lot_stop{std::nullopt, lot::stop_on_signals()};
    return LOT_OK;
  });
}

void lot_stop_request(lot_stop* stop) {
  if (stop != nullptr && stop->source) stop->source->request_stop();
}

bool lot_stop_requested(const lot_stop* stop) {
  return stop != nullptr && stop->token.stop_requested();
}

void lot_stop_release(lot_stop* stop) { delete stop; }

int lot_end_cleanly_on_signals(void) {
  return guarded([] {
    lot::end_cleanly_on_signals();
    return LOT_OK;
  });
}

}  // extern "C"
