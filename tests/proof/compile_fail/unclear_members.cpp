// SPDX-License-Identifier: Apache-2.0

#include <lot/compliance.hpp>

// The library of this class promises that its bytes mean the same everywhere.
class Sealed {
 public:
  Sealed(int a, int b) : sum_(a + b) {}
  int sum() const { return sum_; }

 private:
  int sum_;
};
template <>
struct lot::is_trusted_message<Sealed> : std::true_type {};

struct Message {
  int stamp;
  Sealed seals[2];
};

static_assert(lot::assert_message<Message>());
