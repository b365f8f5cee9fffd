// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <utility>

#include <pybind11/pybind11.h>

#include "lot/any_pusher.hpp"

#include "python/gil.hpp"
#include "python/held.hpp"
#include "python/part.hpp"

namespace lot::python {

/// A loan of a publisher or of a queue. Throws as their loan().
template <class Lender>
AnyLoan loan_of(Lender& lender) {
  const bool is_opaque = lender.type().description().root().kind == Kind::Opaque;
  return is_opaque ? lender.loan_zeroed() : lender.loan();
}

/// The loan that lend() makes, without the GIL, with these fields set.
template <class Lend>
pybind11::object build(Lend&& lend, const pybind11::kwargs& fields) {
  AnyLoan made;
  {
    const Released release;
    made = lend();
  }
  Part part(std::make_shared<Held>(std::move(made)));
  for (const auto& [name, value] : fields) {
    part.set_attribute(name.template cast<std::string>(), value);
  }
  return to_object(std::move(part));
}

/// A loan on its way to readers: it goes back to its part unless it was taken from here.
///
/// Threads: it is made and ends under the GIL.
class Taken {
 public:
  /// Throws BufferError, TypeError, ValueError.
  explicit Taken(const Part& part) : held_(*part.held()), loan_(take(part)) {}
  ~Taken() {
    if (loan_) held_.give_back(std::move(loan_));
  }
  Taken(const Taken&) = delete;
  Taken& operator=(const Taken&) = delete;

  AnyLoan& loan() noexcept { return loan_; }

 private:
  static AnyLoan take(const Part& part) {
    part.require_whole();
    return part.held()->take_loan();
  }

  Held& held_;
  AnyLoan loan_;
};

}  // namespace lot::python
