// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <pybind11/pybind11.h>

#include "lot/detail/service.hpp"
#include "lot/engine.hpp"

#include "python/part.hpp"

namespace lot::python {

/// Says which call a client waits for, as detail::Ticket. The rest of a service is Python's:
/// lot/service.py.
///
/// Threads: under the GIL.
class Ticket {
 public:
  explicit Ticket(ShmEngine& engine) : its_(engine.make<detail::Ticket>()) {}

  Part message() const;
  /// 0: none.
  void wait_for(std::uint64_t number) const noexcept {
    its_->waits_for.store(number, std::memory_order_relaxed);  // as in ShmClient
  }

 private:
  ShmSharedPtr<detail::Ticket> its_;
};

void define_service(pybind11::module_& module);

}  // namespace lot::python
