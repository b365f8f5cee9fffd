// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pthread.h>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "lot/detail/no_signals.hpp"
#include "lot/error.hpp"

namespace lot::gateway {

/// A thread of a route, which takes no signals. `name`: what the system shows. Throws lot::Error.
template <class Body>
std::thread begin_thread(const char* name, const std::string& topic, Body body) {
  const detail::NoSignals no_signals;
  try {
    std::thread thread(std::move(body));
    pthread_setname_np(thread.native_handle(), name);
    return thread;
  } catch (const std::system_error& e) {
    throw Error(e.code().value(), topic, "the system starts no thread for it", "");
  }
}

}  // namespace lot::gateway
