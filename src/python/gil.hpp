// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/pybind11.h>

namespace lot::python {

/// A piece of work without the GIL, which other threads of the program have meanwhile.
///
/// The interpreter may end before the work does, where this is a daemon thread. A thread that
/// asks for the GIL then is ended by pthread_exit(), whose unwinding no destructor lets pass: the
/// process would abort. So such a thread stops here for good, as it does in CPython from 3.14 on,
/// and the process ends with the main thread's status.
class Released {
 public:
  Released() : state_(PyEval_SaveThread()) {}
  ~Released();
  Released(const Released&) = delete;
  Released& operator=(const Released&) = delete;

 private:
  PyThreadState* state_;
};

/// Never returns: the interpreter has ended the thread.
[[noreturn]] void stop_here() noexcept;

/// A wait of a thread. At the end of the interpreter it ends by SystemExit, so that its thread ends
/// and lets go of its objects.
///
/// Threads: under the GIL.
class Waiting {
 public:
  Waiting();
  ~Waiting();
  Waiting(const Waiting&) = delete;
  Waiting& operator=(const Waiting&) = delete;

  /// Throws error_already_set (SystemExit) at the end of the interpreter.
  void require_interpreter() const;

 private:
  unsigned long thread_;
};

void define_gil(pybind11::module_& module);

}  // namespace lot::python
