// SPDX-License-Identifier: Apache-2.0
#include "python/gil.hpp"

#include <algorithm>
#include <atomic>
#include <unistd.h>
#include <vector>

#include <cxxabi.h>

namespace py = pybind11;

namespace lot::python {
namespace {

/// Threads that wait, each once for each of its waits. Under the GIL, as `ending`. Never destroyed:
/// a thread may wait while statics go.
std::vector<unsigned long>& waiting() {
  static auto* const threads = new std::vector<unsigned long>();
  return *threads;
}
unsigned long ending = 0;  ///< the thread that ends the interpreter; 0: it goes on
/// The interpreter has gone, with its GIL. Relaxed: a thread that sees it touches nothing of
/// Python.
std::atomic<bool> is_over{false};

}  // namespace

void stop_here() noexcept {
  for (;;) pause();
}

Released::~Released() {
  if (is_over.load(std::memory_order_relaxed)) stop_here();  // relaxed: see there
  try {
    PyEval_RestoreThread(state_);
  } catch (abi::__forced_unwind&) {
    stop_here();
  }
}

Waiting::Waiting() : thread_(PyThread_get_thread_ident()) { waiting().push_back(thread_); }

Waiting::~Waiting() {
  auto& threads = waiting();
  threads.erase(std::find(threads.begin(), threads.end(), thread_));
}

void Waiting::require_interpreter() const {
  if (ending == 0 || ending == thread_) return;
  PyErr_SetNone(PyExc_SystemExit);
  throw py::error_already_set();
}

void define_gil(py::module_& module) {
  // If it fails, a thread may look for a GIL that has gone, as each program's may.
  static_cast<void>(
      Py_AtExit([] { is_over.store(true, std::memory_order_relaxed); }));  // see there
  // Its last waits end. Gives the threads that wait.
  module.def("_end_waits", [] {
    ending = PyThread_get_thread_ident();
    py::set threads;
    for (const unsigned long thread : waiting()) threads.add(py::int_(thread));
    return threads;
  });
}

}  // namespace lot::python
